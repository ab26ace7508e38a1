"""Plates that stand elsewhere than their poses tell: an error that a recording may state."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.diagnose import Model, Scenes
from form_drake.diagnose.columns import twin_of
from form_drake.diagnose.match import Match
from form_drake.diagnose.motions import Block
from form_drake.diagnose.plates import elsewhere, simulated
from form_drake.diagnose.score import scores
from form_drake.diagnose.sight import Sight
from form_drake.diagnose.verify import Check, Predicted
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.motion import body
from form_drake.weak.contact import OpenFields
from helpers.diagnose import problem_of

DX, OFF, NOISE = 0.004, 1e-4, 5e-6  # OFF [m]: of a press of 1.5 mm
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
BLOCK = Block(size=(0.02, 0.02, 0.02), points=120, rate=150.0, stamps=150.0, law=LAW.name)


def planned(plate, stated=OFF):
    probe = BLOCK.press(plate, 0.4)
    pose = replace(probe.poses["plate"], noise=stated)
    return replace(probe, poses={"plate": pose})


def measured(probe, *, off):
    """What is recorded where the plate goes further than its poses tell, by OFF at most."""
    (other, *_) = elsewhere(planned(probe.contact["z+"].split()[0])) if off else (probe,)
    (made,) = Scenes.of((other,), DX / 1.25).rolled(Model(LAW, TRUTH))
    rng, force = np.random.default_rng(1), made.forces["plate"]
    size = 0.002 * float(np.abs(force.value).max())
    push = replace(
        force, value=force.value + size * rng.standard_normal(force.value.shape), noise=size
    )
    p_WQ = made.p_WQ + NOISE * rng.standard_normal(made.p_WQ.shape)
    return replace(probe, p_WQ=p_WQ, noise=NOISE, forces={"plate": push})


@pytest.mark.parametrize(("plate", "ways"), [("frictionless", 2), ("bonded", 1)])
def test_a_plate_may_be_off_by_a_share_of_its_way_and_one_that_holds_nothing_by_its_place(
    plate, ways
):
    probe = planned(plate)
    told = probe.poses["plate"].value[:, :3, 3]
    moved = [one.poses["plate"].value[:, :3, 3] - told for one in elsewhere(probe)]
    assert len(moved) == ways
    for way in moved:
        assert np.linalg.norm(way, axis=1).max() == pytest.approx(OFF)
        assert not way[:, :2].any()
    assert moved[0][0] == pytest.approx(0.0)  # bonded faces are held from there on
    for whole in moved[1:]:
        assert np.ptp(whole, axis=0) == pytest.approx(0.0, abs=1e-12)
    for still in (replace(probe, poses={}), planned(plate, None), planned(plate, 0.0)):
        assert elsewhere(still) == []


def test_a_plate_is_off_a_body_where_no_error_of_its_place_would_do():
    probe = planned("frictionless", None)
    pose = probe.poses["plate"]
    value = pose.value.copy()
    value[:, 2, 3] += 3e-4
    names = {}
    for noise in (None, 3e-5, OFF):
        lifted = replace(probe, poses={"plate": replace(pose, value=value, noise=noise)})
        names[noise] = OpenFields.of(lifted, body(lifted)).names
    assert "off plate" in names[None] and "off plate" in names[3e-5]
    assert "off plate" not in names[OFF]


def test_what_is_simulated_is_told_under_the_recorded_poses():
    still, moved = planned("bonded", None), planned("bonded")
    scenes = Scenes((still, moved), (DX, DX), coarser=1.0)
    ((n, made),) = simulated(scenes, Model(LAW, TRUTH))
    assert n == 1 and np.array_equal(made.poses["plate"].value, moved.poses["plate"].value)
    (own,) = scenes.only([1]).rolled(Model(LAW, TRUTH))
    top = made.reference[:, 2] > 0.018
    further = (made.p_WQ - own.p_WQ)[:, top, 2]
    assert np.abs(further).max() == pytest.approx(OFF, rel=0.15)


@pytest.mark.parametrize("plate", ["bonded", "frictionless"])
def test_no_prediction_is_blamed_for_a_plate_that_may_be_off(plate):
    """Tracks tell where it is: what the force shows beside that is still the specimen's."""
    model, soft = Model(LAW, TRUTH), Model(LAW, {k: 0.9 * v for k, v in TRUTH.items()})
    gaps = {}
    for stated in (None, OFF):
        seen = measured(planned(plate, stated), off=True)
        scenes = Scenes((seen,), (DX,), coarser=1.5)
        before, coarse, softer = (
            tuple(s.rolled(m)) for s, m in ((scenes, model), (scenes.rough, model), (scenes, soft))
        )
        check = Check(scenes, None, Predicted(before, coarse, None), "", simulated(scenes, model))
        gaps[stated] = check.channels(Predicted(softer, coarse, None))
    (blamed, _), (told, force) = gaps.values()
    assert blamed.counts and blamed.before > 20.0 * told.before
    assert not told.counts and force.before < force.floor
    assert force.after > 2.0 * force.floor


def test_rows_have_one_more_error_where_plates_may_be_off():
    seen = measured(planned("bonded"), off=False)
    scenes, model = Scenes((seen,), (DX,), coarser=1.5), Model(LAW, TRUTH)
    match = Match.of(problem_of(seen), scenes, model)
    ((_, own),) = simulated(scenes, model)
    moved = twin_of(match.problem, scenes, model, [own])
    eta, theta = match.twin.coordinates(TRUTH)
    (A, b), (B, c) = match.twin.rows(eta, theta), moved.rows(eta, theta)
    change = (c - B @ theta) - (b - A @ theta)
    assert match.by.shared[:, 0] == pytest.approx(change)
    unstated = replace(seen, poses=planned("bonded", None).poses)
    plain = Match.of(problem_of(unstated), Scenes((unstated,), (DX,), coarser=1.5), model).by
    size = float(np.linalg.norm(plain.white(change)))
    assert np.linalg.norm(match.white(change)) == pytest.approx(size / np.hypot(1.0, size))
    assert plain.shared is None and size > 1.0


def test_two_sides_name_nothing_where_a_plate_may_go_further_than_told():
    effects = [CATALOGUE[n] for n in ("density", "force-gain", "camera-scale", "stiffening")]
    best = []
    for stated in (None, OFF):
        seen = measured(planned("bonded", stated), off=True)
        sight = Sight.fitted(Scenes.of((seen,), DX, coarser=1.5), Model(LAW, TRUTH))
        best.append(scores(sight, effects)[0].score)
    blamed, told = best
    assert blamed > 1e4 and told < 1e-3 * blamed
