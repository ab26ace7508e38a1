"""Points on two sides of a block, and the force: what a motion shows without any point inside."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from form_drake.bench import blind_faces
from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.race import raced
from form_drake.diagnose.score import scores
from form_drake.diagnose.sight import SETTLED, Sight, guessed
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.records import Stream
from helpers.diagnose import planned

DX, NOISE, PUSH = 0.004, 2e-5, 2e-3
LAW, TRUTH = LAWS["neo-hookean"], {"C10": 5e3, "kappa": 3e4}
START = {"C10": 9e3, "kappa": 2e4}
HIDDEN = {"density": 0.3, "force-delay": 4e-3}
EFFECTS = [CATALOGUE[n] for n in ("drag", "density", "force-gain", "force-delay", "added-mass")]


def block():
    """A bonded plate presses a block that is seen from two sides, and goes back."""
    low, size = np.array([-0.01, -0.01, 0.0]), np.full(3, 0.02)
    X = low + size * np.random.default_rng(0).uniform(size=(60, 3))
    X[:30, 0], X[30:, 1] = 0.01, 0.01
    t = np.linspace(0.0, 0.4, 61)
    down = 1.6e-3 * np.sin(np.pi * t / 0.4) ** 2 + 2e-4 * np.sin(50.0 * t)
    return replace(planned(X, t, 0.02 - down), law=LAW.name, noise=NOISE)


def seen(*causes):
    """What two cameras and a force sensor record, on a finer grid than the twin's."""
    (made,) = Scenes.of((block(),), DX / 1.25).rolled(Model(LAW, TRUTH, causes))
    rng, force = np.random.default_rng(1), made.forces["plate"]
    value = force.value + PUSH * rng.standard_normal(force.value.shape)
    p_WQ = made.p_WQ + NOISE * rng.standard_normal(made.p_WQ.shape)
    push = Stream(force.time, value, noise=PUSH)
    return replace(made, p_WQ=p_WQ, noise=NOISE, forces={"plate": push})


@cache
def fitted(name=None):
    causes = [Cause(CATALOGUE[name], HIDDEN[name], {})] if name else []
    return Sight.fitted(Scenes.of((seen(*causes),), DX, coarser=1.5), Model(LAW, START))


def test_nothing_stands_out_of_what_two_sides_show_and_the_moduli_are_found():
    sight = fitted()
    for key, true in TRUTH.items():
        assert sight.model.values[key] == pytest.approx(true, rel=0.03)
    assert scores(sight, EFFECTS)[0].score < 16.0
    assert sight.left @ sight.left < 1.1 * len(sight.left)


@pytest.mark.parametrize("lost_as", [np.nan, 0.0])
def test_what_is_lost_is_in_no_row(lost_as):
    whole = block()
    still = Stream(whole.time, np.zeros((len(whole.time), 3)), noise=PUSH)
    whole = replace(whole, forces={"plate": still})
    valid = np.random.default_rng(2).random(whole.p_WQ.shape[:2]) > 0.3
    lost = replace(whole, p_WQ=np.where(valid[..., None], whole.p_WQ, lost_as), valid=valid)
    sight = Sight(Scenes((lost,), (DX,)), Model(LAW, TRUTH), (whole,))
    assert len(sight.apart) < 0.8 * whole.p_WQ.size
    assert sight.apart == pytest.approx(np.zeros(len(sight.apart)))


def test_the_column_of_a_gain_that_acts_is_what_a_little_more_of_it_changes():
    """Columns are those of the motion that the search began with, in which it does not act."""
    sight, gain, step = fitted(), CATALOGUE["force-gain"], 0.02
    less, acting, more = (
        sight.near(sight.model.more(gain, size, {})) for size in (-0.3 - step, -0.3, -0.3 + step)
    )
    true = (less.apart - more.apart) / (2.0 * step)
    assert acting.slopes[:, -1] == pytest.approx(true, abs=0.02 * float(np.abs(true).max()))


def test_what_the_grid_has_wrong_is_taken_off():
    sight = fitted()
    plain = sight.uncorrected
    assert np.sum(sight.left**2) < np.sum(plain.left**2)
    fine = Sight.of(replace(sight.scenes, coarser=1.0), sight.model)
    assert sight.apart == pytest.approx(fine.apart, abs=1e-9)
    ways = fine, plain  # the moduli are nearest on the finer grid, and were not on the coarser one
    here, coarse = (np.linalg.lstsq(s.own_slopes, s.apart, rcond=None)[0] for s in ways)
    assert np.abs(here).max() < SETTLED < 0.2 * np.abs(coarse).max()


def test_what_the_grid_may_leave_at_a_point_weighs_no_more_than_noise():
    """It keeps its course in time: other motions of that point, and other points, weigh what they did."""
    sight = fitted()
    (own,), (coarse,) = sight.scenes.spacings, sight.scenes.rough.spacings
    share, places = 1.5 * own / (coarse - own), sight._labels[:, 2]
    most = np.argmax(np.bincount(places, sight.grid**2))
    left = share * np.where(places == most, sight.grid, 0.0)
    assert np.linalg.norm(left) > 10.0 and np.linalg.norm(sight.white(left)) < 1.0
    still = np.where(places == most, np.roll(sight.grid, len(sight.grid) // 7), 0.0)
    across = still - left * (left @ still) / (left @ left)
    assert np.linalg.norm(sight.white(across)) > 0.8 * np.linalg.norm(across)


@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_stands_out_of_what_two_sides_show(name):
    """A mass at the top is nearly like a density from there: their simulations tell them apart."""
    found, size = scores(fitted(name), EFFECTS), HIDDEN[name]
    first, *others = raced(fitted(name), [s for s in found if s.score > 16.0])
    assert first.score.effect.id == name
    assert all(other.left > 2.0 * first.left + 16.0 for other in others)
    (own,) = (s for s in found if s.effect.id == name)
    assert 0.5 < own.coefficient / size < 2.0  # to first order, about moduli that took a part
    assert own.limit < size


def test_what_a_strong_effect_changes_is_simulated_before_it_is_named():
    """To first order force that comes late, and any damping, do nearly as well."""
    size, shape = 150.0, {"n": 0.5}
    hidden = seen(Cause(CATALOGUE["rate-dependence"], size, shape))
    sight = Sight.fitted(Scenes.of((hidden,), DX, coarser=1.5), Model(LAW, START))
    rivals = [CATALOGUE[n] for n in ("rate-dependence", "damping", "force-delay", "drag")]
    found = scores(sight, rivals)
    assert found[2].score > 0.8 * found[0].score
    first, *others = raced(sight, found)
    (cause,) = first.search.match.told.causes
    assert cause.effect.id == "rate-dependence" and first.left < 0.01 * sight.excess_left
    assert all(other.left > 10.0 * first.left for other in others)
    assert cause.coefficient == pytest.approx(size, rel=0.05)
    assert cause.shape["n"] == pytest.approx(0.5, abs=0.05)


def test_a_stiffness_is_guessed_from_force_and_points():
    model = guessed(seen(), LAW, {})
    for found, true in zip(LAW.moduli(model.values), LAW.moduli(TRUTH), strict=True):
        assert 0.25 < found / true < 4.0
    still = replace(seen(), forces={})
    with pytest.raises(ValueError, match="no measured force is on a tool that touches the body"):
        guessed(still, LAW, {})


def test_what_is_known_of_the_law_stays():
    model = Model(LAW, TRUTH)
    sight = Sight(None, model, (), given=("kappa",))
    (free,) = set(TRUTH) - {"kappa"}
    assert sight._keys == [free]
    assert sight.valued(np.array([0.1])) == pytest.approx(TRUTH | {free: TRUTH[free] * np.exp(0.1)})
    assert sight.turned({**TRUTH, free: TRUTH[free] * np.exp(0.1)}) == pytest.approx([0.1])


def test_two_sides_refuse_a_ratio_that_ties_moduli():
    law = LAWS["fixed-corotated"]
    push = Stream(block().time, np.zeros((len(block().time), 3)), noise=PUSH)
    seen = replace(block(), law=law.name, known={"nu": 0.4}, forces={"plate": push})
    with pytest.raises(ValueError, match="declare nu as known, which two sides cannot hold"):
        blind_faces.ranking([seen], law)


def test_a_case_that_two_sides_show_is_ranked(monkeypatch):
    monkeypatch.setattr(blind_faces, "CATALOGUE", {e.id: e for e in EFFECTS})
    sight = fitted("density")
    monkeypatch.setattr(Sight, "fitted", lambda *_: sight)
    press = seen(Cause(CATALOGUE["density"], HIDDEN["density"], {}))
    told = blind_faces.ranking([press], LAW)
    (named,) = told["effects"]
    assert told["verdict"] == "named" and {"density", "force-gain"} <= set(named["class"])
    assert set(told["passes"][0]["scores"]) == set(told["limits"]) == {e.id for e in EFFECTS}
    assert told["lesser"]["uncorrected"].keys() == told["before"]["limits"].keys()
    json.dumps(told)
