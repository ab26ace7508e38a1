"""Scores of effects beside a matched twin: what is hidden stands out, and what is needless goes."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.diagnose import Cause, Model, Scenes
from form_drake.diagnose.lesser import lesser
from form_drake.diagnose.match import Match
from form_drake.diagnose.placebo import removals
from form_drake.diagnose.score import coherence, named_from, scores, shapes
from form_drake.diagnose.score import scored as one_scored
from form_drake.diagnose.search import matched
from form_drake.diagnose.verdict import Found, shed
from form_drake.diagnose.verify import Check
from form_drake.effects import CATALOGUE
from form_drake.motion import body
from helpers.diagnose import DX, LAW, PROBE, TRUTH, noisy, problem_of, rolled

START = {"mu": 19e3, "lam": 42e3}
NAMES = ("stiffening", "anisotropy", "eigenstrain", "drag", "density", "force-bias", "force-delay")
EFFECTS = [CATALOGUE[name] for name in NAMES]


def fitted(data):
    """A twin that has been brought near to the data from a wrong start."""
    return matched(Match.of(problem_of(data), Scenes.of((data,), DX), Model(LAW, START)))


@cache
def scored(name=None):
    """Scores where an effect of ``HIDDEN`` acts, or nothing does, and the twin that they are about."""
    causes = [Cause(CATALOGUE[name], *HIDDEN[name])] if name else []
    match = fitted(noisy(rolled(*causes), 0))
    return scores(match, EFFECTS), match


def test_nothing_stands_out_where_nothing_is_hidden():
    found, match = scored()
    assert max(s.score for s in found) < 12.0
    assert match.left @ match.left < 1.3 * len(match.left)
    for k, true in TRUTH.items():
        assert match.model.values[k] == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("needed", [True, False])
def test_what_has_become_needless_goes(needed):
    """A delay that was found first, and swelling beside it."""
    swelling = Cause(CATALOGUE["eigenstrain"], 5e-3, {})
    late = Cause(CATALOGUE["force-delay"], 4e-3, {})
    begun = fitted(noisy(rolled(swelling, *[late] * needed), 0))
    first, then = (replace(begun.model, causes=c) for c in ((late,), (late, swelling)))
    ranked = tuple(scores(begun, [late.effect, swelling.effect]))
    delay, strain = (next(s for s in ranked if s.effect is c.effect) for c in (late, swelling))
    passes = [
        Found(begun, ranked, best=delay),
        Found(begun.near(first), (strain,), best=strain, alike=("camera-scale",), doubt=20.0),
    ]
    match, left = shed(matched(begun.near(then)), passes, {})
    assert [c.effect.id for c in match.model.causes] == ["force-delay"] * needed + ["eigenstrain"]
    assert len(left) == 1 + needed
    told, *rest = left  # of the bare twin, with its own scores
    assert told.match is begun and told.ranked == ranked and told.doubt == 0.0
    assert told.gone == (() if needed else ("force-delay",))
    last = rest[0] if needed else told
    assert last.best is strain and last.alike == ("camera-scale",)
    assert match.model.causes[-1].coefficient == pytest.approx(5e-3, rel=0.1)


def test_what_each_of_two_effects_is_worth_is_told_without_it():
    swelling, late = (
        Cause(CATALOGUE["eigenstrain"], 5e-3, {}),
        Cause(CATALOGUE["force-delay"], 4e-3, {}),
    )
    begun = fitted(noisy(made := rolled(swelling, late), 0))
    match = matched(begun.near(replace(begun.model, causes=(swelling, late))))
    check = Check.of(Scenes.of((noisy(made, 1),), DX), begun)
    naming = SimpleNamespace(match=match, added=match.told.causes, verdict="named")
    after = check.predicted(match)
    assert check.shows(after)
    soft, slow = removals(naming, check, after)
    assert [soft.effect.id, slow.effect.id] == ["eigenstrain", "force-delay"]
    tracks, force, *_ = (c for c in slow.channels)
    assert (
        force.name == "force of plate 1" and force.before > 3.0 * force.after and not tracks.counts
    )
    tracks, *_ = soft.channels
    assert tracks.before > 3.0 * tracks.after
    assert not any(c.worse for one in (soft, slow) for c in one.channels)
    alone = SimpleNamespace(match=match, added=match.told.causes[:1], verdict="named")
    refused = SimpleNamespace(match=match, added=match.told.causes, verdict="unnamed")
    assert [*removals(alone, check, after), *removals(refused, check, after)] == []


HIDDEN = {
    "anisotropy": (4e3, {"azimuth": np.radians(45.0), "elevation": 0.0}),
    "force-delay": (4e-3, {}),
    "eigenstrain": (5e-3, {}),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_the_hidden_effect_stands_out(name):
    effect, (size, _) = CATALOGUE[name], HIDDEN[name]
    found, _ = scored(name)
    assert found[0].effect is effect and found[0].score > 2.0 * found[1].score
    assert 0.5 < found[0].coefficient / size < 2.0  # to first order, about moduli that took a part
    assert found[0].limit < size
    assert np.allclose(np.diag(coherence(found)), 1.0)


def test_simpler_statistics_leave_out_what_they_do_not_know():
    """All rows alike, by a least-squares fit of the law and one effect's column to what the data leave."""
    _, match = scored("force-delay")
    found = {way: {s.effect.id: s for s in every} for way, every in lesser(match, EFFECTS).items()}
    assert set(found) == {"ols", "diagonal", "gls"}
    column = match.raw.of(CATALOGUE["force-delay"], [{}])
    squares = []
    for columns in (match.slopes, np.column_stack([match.slopes, column])):
        _, (square,), *_ = np.linalg.lstsq(columns, match.rest, rcond=None)
        squares.append(square)
    spread = squares[0] / (len(match.rest) - match.slopes.shape[1])
    gain = (squares[0] - squares[1]) / spread
    assert found["ols"]["force-delay"].score == pytest.approx(gain, rel=1e-6)
    size = match.by.sizes
    own = match.seen_by(match.by, match.rest)
    left = [
        match.rest
        - match.slopes
        @ np.linalg.lstsq(match.slopes / size[:, None], match.rest / size, rcond=None)[0]
    ]
    assert found["diagonal"]["force-delay"].score < np.sum((left[0] / size) ** 2)
    assert found["gls"]["force-delay"].score < own.left @ own.left
    assert match.left @ match.left < own.left @ own.left  # a twin has what reading costs


def test_a_score_counts_what_a_possible_size_explains():
    """Nothing can be softer than without stiffness, however much the column alone would take."""
    tried, columns = [{"n": 0.0}, {"n": 1.0}], np.eye(4)[:, :2]
    for left, (n, size, score) in {
        (-3.0, 2.0, 0.0, 1.0): (0, -1.0, 5.0),
        (-3.0, 2.5, 0.0, 1.0): (1, 2.5, 6.25),
    }.items():
        match = SimpleNamespace(
            columns=lambda effect, shapes: columns, off=lambda a: a, left=np.array(left)
        )
        best = one_scored(match, CATALOGUE["inclusion"], tried)
        assert (best.shape, best.coefficient) == (tried[n], pytest.approx(size))
        assert best.score == pytest.approx(score - 2.0 * np.log(2.0))


@pytest.mark.parametrize(("there", "limit"), [(0.0, 5.0 / 25.0), (2.0, 5.0 / 25.0), (4.0, 0.1)])
def test_a_limit_is_that_of_the_best_shape_or_their_median_where_nothing_is_seen(there, limit):
    """In standard deviations at the last shape, which rows see best."""
    effect = CATALOGUE["anisotropy"]
    tried = effect.grid()[:49]
    columns = np.eye(60)[:, : len(tried)] * np.linspace(1.0, 50.0, len(tried))
    left = there * np.eye(60)[len(tried) - 1]
    match = SimpleNamespace(columns=lambda effect, shapes: columns, off=lambda a: a, left=left)
    best = one_scored(match, effect, tried)
    assert best.score == pytest.approx(max(there**2 - 2.0 * np.log(len(tried)), 0.0))
    assert best.limit == pytest.approx(limit, rel=0.05)
    assert not there or best.shape == tried[-1]


@pytest.mark.parametrize("name", ["anisotropy", "drag"])
def test_an_effect_is_named_from_the_size_that_scores_its_threshold(name):
    """A score is less by what it gains from the number of shapes that are tried."""
    effect = CATALOGUE[name]
    tried = effect.grid()
    columns = np.eye(60)[:, : len(tried)]
    left = named_from(effect, 20.0) * columns[:, -1]
    match = SimpleNamespace(columns=lambda effect, shapes: columns, off=lambda a: a, left=left)
    assert one_scored(match, effect, tried).score == pytest.approx(20.0)


def test_places_lie_inside_the_body():
    shape = body(PROBE)
    tried = shapes(CATALOGUE["inclusion"], shape)
    places = np.array([[one[k] for k in "xyz"] for one in tried])
    assert len(tried) == 125 and np.all((places > shape.low) & (places < shape.high))
    assert tried[0]["radius"] == pytest.approx(0.004)
    assert shapes(CATALOGUE["drag"], shape) == [{}]
