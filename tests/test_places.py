"""Effects that sit at a place in the body: balls that are stiffer or heavier than the rest."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.diagnose.kept import GROWN, MOVED
from form_drake.diagnose.search import Search
from form_drake.effects import CATALOGUE
from helpers.twins import BLOCK, MODEL, begun, beside

BALL, MASS = CATALOGUE["inclusion"], CATALOGUE["added-mass"]
PLACE = {"x": -0.004, "y": 0.003, "z": 0.013, "radius": 0.005}
SEEN = 0.9  # coherence with what is simulated at the place
UNTOLD = 3.0**2  # of squares, whitened: three standard deviations of one unknown


def coherence(one, other):
    return one @ other / np.linalg.norm(one) / np.linalg.norm(other)


@pytest.mark.parametrize("effect", [BALL, MASS], ids=lambda e: e.id)
def test_a_column_at_a_place_is_that_of_places_around(effect):
    """Along the motion alone a ball would have another: tracks do not show how little is strained in it."""
    match = begun("bonded", 0.7)
    size, more = match.raw._more(effect, PLACE)
    true = match.white(match.apart - match.near(more).apart) / size
    found = match.columns(effect, [PLACE])[:, 0]
    assert coherence(found, true) > SEEN
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(true), rel=0.5)
    along = match.columns(replace(effect, id="along", trial=0.0, whole=False), [PLACE])[:, 0]
    assert coherence(along, true) < 0.7


def test_columns_of_a_ball_that_acts_are_what_another_ball_changes():
    acting = begun("bonded", 0.4).near(MODEL.more(BALL, 3.0, PLACE))
    (cause,), first = acting.model.causes, acting.parts[0]
    for n, step in enumerate((0.4, 1e-3, 1e-3, 1e-3, 1e-3)):
        other = replace(acting.model, causes=(cause.moved(np.eye(5)[n] * step),))
        true = acting.white(acting.apart - acting.near(other).apart) / step
        found = acting.explained[:, first + n]
        assert coherence(found, true) > SEEN
        assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(true), rel=0.15)
    assert acting.anew.tolist() == [False] * first + [True] * 5


def test_columns_of_a_ball_serve_twins_of_much_the_same_ball():
    acting = begun("bonded", 0.4).near(MODEL.more(BALL, 3.0, PLACE))
    (cause,), first = acting.model.causes, acting.parts[0]
    widths = np.append(3.0, cause.widths)

    def columns(match, *change):
        moved = match.model.causes[0].moved(widths * change)
        there = match.near(replace(match.model, causes=(moved,)))
        return there, there.slopes[:, first:]

    own = acting.slopes[:, first:]
    near, same = columns(acting, 0.9 * GROWN, 0.0, 0.0, 0.9 * MOVED, 0.0)
    assert np.array_equal(same, own) and not near.anew.any()
    far, others = columns(near, 0.0, 0.0, 0.0, 0.9 * MOVED, 0.0)  # from where they were made
    assert not np.array_equal(others, own) and far.anew[first:].all()
    assert not columns(acting, 1.1 * GROWN, 0.0, 0.0, 0.0, 0.0)[0].kept.of(far.model.causes[0])


def test_a_stiff_ball_is_found_from_a_soft_guess_beside_it():
    """In three steps as near as the true one: its size enters less and less, and trades with its radius."""
    ball = MODEL.more(BALL, 5.0, PLACE)
    match = beside(BLOCK.press("bonded", 0.7), ball)
    guess = {**PLACE, "x": -0.002, "z": 0.011, "radius": 0.0045}
    search = Search.of(match.near(MODEL.more(BALL, 0.5, guess)))
    for _ in range(3):
        search = search.stepped()
    (found,) = search.match.model.causes
    true = match.near(ball).excess
    assert true < 0.01 * match.excess and search.match.excess < true + UNTOLD
    assert [found.shape[k] for k in "xyz"] == pytest.approx([PLACE[k] for k in "xyz"], abs=6e-4)
    assert found.shape["radius"] == pytest.approx(PLACE["radius"], rel=0.2)
    assert 2.5 < found.coefficient < 10.0
