"""Plates that stand elsewhere than their poses tell: an error that a recording may state."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.diagnose import Model, Scenes
from form_drake.diagnose import sight as sight_module
from form_drake.diagnose.admitted import require_stated
from form_drake.diagnose.columns import twin_of
from form_drake.diagnose.match import Match
from form_drake.diagnose.motions import Block
from form_drake.diagnose.plates import Elsewhere, elsewhere, simulated
from form_drake.diagnose.score import scores
from form_drake.diagnose.sight import Sight
from form_drake.diagnose.verdict import LEAST
from form_drake.diagnose.verify import Check, Predicted
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.motion import body
from form_drake.records import Stream
from form_drake.weak.contact import OpenFields
from helpers.diagnose import problem_of

DX, OFF, NOISE = 0.004, 1e-4, 5e-6  # OFF [m]: of a press of 1.5 mm
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
MODEL = Model(LAW, TRUTH)
SOFT = Model(LAW, {k: 0.9 * v for k, v in TRUTH.items()})
BLOCK = Block(size=(0.02, 0.02, 0.02), points=120, rate=150.0, stamps=150.0, law=LAW.name)


def planned(plate, stated=OFF):
    probe = BLOCK.press(plate, 0.4)
    pose = replace(probe.poses["plate"], noise=stated)
    return replace(probe, poses={"plate": pose})


def moved(recording, by, tool="plate"):
    """With a tool that is so much higher [m], shape [stamps]."""
    pose = recording.poses[tool]
    value = pose.value.copy()
    value[:, 2, 3] += by
    return replace(recording, poses={**recording.poses, tool: replace(pose, value=value)})


def measured(probe, by=0.0):
    """What is recorded where the plate is elsewhere than its poses tell."""
    (made,) = Scenes.of((moved(probe, by),), DX / 1.25).rolled(MODEL)
    rng, force = np.random.default_rng(1), made.forces["plate"]
    size = 0.002 * float(np.abs(force.value).max())
    value = force.value + size * rng.standard_normal(force.value.shape)
    p_WQ = made.p_WQ + NOISE * rng.standard_normal(made.p_WQ.shape)
    push = Stream(force.time, value, noise=size)
    return replace(probe, p_WQ=p_WQ, noise=NOISE, forces={"plate": push})


def further(probe):
    """A plate that goes further than it tells: less by nothing at first, by OFF at the deepest."""
    way = probe.poses["plate"].value[:, 2, 3]
    return -OFF * (way[0] - way) / (way[0] - way.min())


def shifts(recording):
    told = recording.poses["plate"].value
    return [one.poses["plate"].value[:, :3, 3] - told[:, :3, 3] for one in elsewhere(recording)]


@pytest.mark.parametrize(("plate", "ways"), [("frictionless", 2), ("bonded", 1)])
def test_a_plate_may_be_off_by_a_share_of_its_way_and_one_that_holds_nothing_by_its_place(
    plate, ways
):
    probe = planned(plate)
    share, *place = shifts(probe)
    assert len(place) == ways - 1
    assert share[:, 2] == pytest.approx(further(probe)) and not share[:, :2].any()
    for whole in place:
        assert np.abs(whole[:, 2]) == pytest.approx(OFF) and np.ptp(whole, axis=0).max() == 0.0
    for exact in (replace(probe, poses={}), planned(plate, None), planned(plate, 0.0)):
        assert elsewhere(exact) == []


def test_what_a_tool_does_before_and_after_the_frames_is_no_part_of_its_way():
    probe = planned("bonded")
    pose = probe.poses["plate"]
    early, late = (pose.time[[0]] + t for t in (-0.2, 0.6))
    high = np.tile(np.eye(4), (1, 1, 1))
    high[:, 2, 3] = 0.3
    time, value = np.concatenate([early, pose.time, late]), np.concatenate([high, pose.value, high])
    longer = replace(probe, poses={"plate": Stream(time, value, noise=OFF)})
    (share,) = shifts(longer)
    assert share[1:-1, 2] == pytest.approx(further(probe), abs=1e-9)


def test_a_support_that_stands_still_is_not_carried_by_what_its_poses_jitter():
    probe = planned("bonded")
    still = np.tile(np.eye(4), (len(probe.time), 1, 1))
    still[:, 2, 3] = 1e-8 * np.random.default_rng(0).standard_normal(len(probe.time))
    floor = {"floor": Stream(probe.time, still, noise=OFF)}
    assert len(elsewhere(replace(probe, poses={**probe.poses, **floor}))) == 1
    little = moved(probe, 0.99 * (0.02 - probe.poses["plate"].value[:, 2, 3]))
    (share,) = shifts(little)  # it goes 15 um, and nobody would take it to go 115
    assert 1e-5 < np.abs(share).max() < 2e-5


def test_a_plate_is_off_a_body_where_no_error_of_its_place_would_do():
    names = {}
    for noise in (None, 3e-5, OFF):
        lifted = moved(planned("frictionless", noise), 3e-4)
        names[noise] = OpenFields.of(lifted, body(lifted)).names
    assert "off plate" in names[None] and "off plate" in names[3e-5]
    assert "off plate" not in names[OFF]


def test_a_plate_of_which_hardly_anything_is_known_is_refused():
    probe = replace(planned("bonded", 3e-3), noise=NOISE)
    with pytest.raises(ValueError, match=r"poses of plate may be 0\.003 m off.*up to 0\.002 m"):
        require_stated(probe, DX, held_back=True)


def test_a_plate_that_never_touches_is_refused_with_what_its_plane_is():
    flange = replace(moved(planned("frictionless", None), 0.1), noise=NOISE)
    with pytest.raises(ValueError, match=r"plate stays 0\.09\d+ m off z\+ and more.*another frame"):
        require_stated(flange, DX, held_back=True)
    require_stated(replace(planned("frictionless"), noise=NOISE), DX, held_back=True)


def test_what_is_simulated_is_told_under_the_recorded_poses():
    still, off = planned("bonded", None), planned("bonded")
    scenes = Scenes((still, off), (DX, DX), coarser=1.0)
    (made,) = simulated(scenes, MODEL)
    told = made.recording.poses["plate"].value
    assert made.of == 1 and np.array_equal(told, off.poses["plate"].value)
    (own,) = scenes.only([1]).rolled(MODEL)
    top = own.reference[:, 2] > 0.018
    change = (made.recording.p_WQ - own.p_WQ)[:, top, 2]
    assert change.min() == pytest.approx(-OFF, rel=0.15)


def test_a_simulation_that_fails_says_of_what_it_was():
    low = moved(planned("bonded", 1.9e-3), -0.0175 * np.linspace(0.0, 1.0, 61))
    with pytest.raises(ValueError, match="with plates as far off as they may be, "):
        simulated(Scenes((low,), (DX,)), MODEL)


def told(seen, after=SOFT):
    """Channels of tracks and of force: before, by the truth, and after."""
    scenes = Scenes((seen,), (DX,), coarser=1.5)
    before, coarse = tuple(scenes.rolled(MODEL)), tuple(scenes.rough.rolled(MODEL))
    check = Check(scenes, None, Predicted(before, coarse, None), "", simulated(scenes, MODEL))
    return check, check.channels(Predicted(tuple(scenes.rolled(after)), coarse, None))


@pytest.mark.parametrize(
    ("plate", "by"), [("bonded", further), ("frictionless", lambda probe: -0.7 * OFF)]
)
def test_no_prediction_is_blamed_for_a_plate_that_may_be_off(plate, by):
    """Tracks tell where it is: what the force shows beside that is still the specimen's."""
    own = {}
    for stated in (None, OFF, OFF / 10.0):  # of the last it is seven or ten times as far off
        probe = planned(plate, stated)
        _, own[stated] = told(measured(probe, by(probe)))
    (blamed, _), (tracks, force), (far, _) = own.values()
    assert blamed.counts and blamed.before > 10.0 * tracks.floor
    assert not tracks.counts and force.before < force.floor
    assert force.after > 2.0 * force.floor
    assert far.counts and far.before > 0.5 * blamed.before


def test_predictions_with_other_effects_are_judged_by_the_same_plates():
    probe = planned("frictionless")
    check, (tracks, _) = told(measured(probe, further(probe)))
    scenes = check.scenes
    rolled, coarse = tuple(scenes.rolled(SOFT)), tuple(scenes.rough.rolled(SOFT))
    other = Predicted(rolled, coarse, None)
    again, force = check.channels(check.before, other)
    assert again.after < tracks.floor and force.after < force.floor
    assert force.before > 2.0 * force.floor


def test_rows_have_one_more_error_where_plates_may_be_off():
    seen = measured(planned("bonded"))
    scenes = Scenes((seen,), (DX,), coarser=1.5)
    match = Match.of(problem_of(seen), scenes, MODEL)
    (made,) = simulated(scenes, MODEL)
    other = twin_of(match.problem, scenes, MODEL, [made.recording])
    eta, theta = match.twin.coordinates(TRUTH)
    (A, b), (B, c) = match.twin.rows(eta, theta), other.rows(eta, theta)
    change = (c - B @ theta) - (b - A @ theta)
    *_, whole = match.by.shared.T
    assert whole == pytest.approx(change)
    unstated = replace(seen, poses=planned("bonded", None).poses)
    plain = Match.of(problem_of(unstated), Scenes((unstated,), (DX,), coarser=1.5), MODEL).by
    size = float(np.linalg.norm(plain.white(change)))
    assert np.linalg.norm(match.white(change)) == pytest.approx(size / np.hypot(1.0, size))
    assert plain.shared.shape[1] == match.by.shared.shape[1] - 1 and size > 1.0


def test_rows_of_other_recordings_do_not_have_it():
    seen, plain = measured(planned("bonded")), measured(planned("bonded", None))
    one, other = (problem_of(r) for r in (plain, seen))
    both = replace(one, probes=(*one.probes, *other.probes))
    scenes = Scenes((plain, seen), (DX, DX), coarser=1.5)
    made = simulated(scenes, MODEL)
    assert [e.of for e in made] == [1] and isinstance(made[0], Elsewhere)
    *_, whole = Match.of(both, scenes, MODEL, elsewhere=made).by.shared.T
    count = int(one.probes[0].keep.sum())
    assert not whole[:count].any() and (whole[count:] != 0.0).mean() > 0.9


@pytest.mark.parametrize(("stated", "gives"), [(OFF, 0.0), (None, sight_module.GIVES)])
def test_two_sides_name_nothing_where_a_plate_may_go_further_than_told(stated, gives, monkeypatch):
    """On a coarser grid what it changes is known less well, and a gain of the force scores 27."""
    effects = [CATALOGUE[n] for n in ("density", "force-gain", "camera-scale", "stiffening")]
    probe = planned("bonded", stated)
    seen = measured(probe, further(probe))
    monkeypatch.setattr(sight_module, "GIVES", gives)
    sight = Sight.fitted(Scenes.of((seen,), DX, coarser=1.25), MODEL)
    (best, *_) = scores(sight, effects)
    told = sight.scenes.recordings[0].poses["plate"]
    firm = replace(seen, poses={"plate": replace(told, noise=None)})
    monkeypatch.setattr(sight_module, "GIVES", 0.0)
    blamed = replace(sight, scenes=replace(sight.scenes, recordings=(firm,)))
    (worst, *_) = scores(blamed, effects)
    assert worst.score > 30.0 * LEAST and best.score < LEAST
