"""What a recording lacks, and what it states twice or not at all: closed-form press of a neo-Hookean block."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from scipy.optimize import brentq
from threadpoolctl import threadpool_info, threadpool_limits

from form_drake import Recording, Stream, Unidentifiable, identify
from form_drake.identify import WeakOptions
from form_drake.motion import Sampling, body, fit_tracks
from form_drake.motion.tracks import bridged, sighted
from form_drake.records import Solver, degraded, restated, thinned, write_recording
from helpers.commands import refusal, run

C10, KAPPA, FRAMES = 1e4, 1e5, 61
SIZE = np.array([0.02, 0.02, 0.015])
QUICK = WeakOptions(draws=0)
BOX = replace(QUICK, fields=("box",))


def stresses(lateral, axial):
    """Principal Kirchhoff stresses [Pa] across and along the axis, and J."""
    J = lateral**2 * axial
    b = np.array([lateral**2, axial**2]) * J ** (-2.0 / 3.0)
    mean = (2.0 * b[0] + b[1]) / 3.0
    return 2.0 * C10 * (b - mean) + KAPPA * J * (J - 1.0), J


@pytest.fixture(scope="module")
def pressed():
    """(time, X, p_WQ, force, pressure) of a block pressed by a fifth between smooth plates."""
    time = np.linspace(0.0, 0.6, FRAMES)
    axial = 1.0 - 0.2 * np.sin(np.pi * time / 0.6) ** 2
    lateral = np.array([brentq(lambda s, a=a: stresses(s, a)[0][0], 0.8, 1.4) for a in axial])
    (_, along), J = stresses(lateral, axial)
    sides = [np.linspace(0.001, s - 0.001, 4) for s in SIZE]
    X = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    middle = np.array([0.01, 0.01, 0.0])
    stretch = np.stack([lateral, lateral, axial], axis=-1)[:, None]
    force = np.zeros((FRAMES, 3))
    force[:, 2] = -along / axial * SIZE[0] * SIZE[1]
    p = middle + stretch * (X - middle)
    pressure = np.repeat(-KAPPA * (J - 1.0)[:, None], len(X), axis=1)
    return time, X, p, force, pressure


def recording(pressed, **changes):
    time, X, p, force, _ = pressed
    rng = np.random.default_rng(0)
    facts = {
        "p_reference": X,
        "density": 1.0,
        "noise": 1e-6,
        "law": "neo-hookean",
        "geometry": {"shape": "box", "low": "0 0 0", "high": "0.02 0.02 0.015"},
        "contact": {"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        "forces": {"plate": Stream(time, force, 1e-3)},
    }
    seen = p + 1e-6 * rng.standard_normal(p.shape)
    return Recording.from_arrays(time, seen, **{**facts, **changes})


def deviations(answer):
    """By how many standard deviations values are off."""
    true = {"C10": C10, "kappa": KAPPA}
    found = answer.material.parameters()
    return {k: abs(found[k].value - v) / found[k].std for k, v in true.items()}


@pytest.mark.parametrize(
    ("lost", "share"), [([30], 1.0), (range(4, 61, 5), 1.0), (range(20, 41), 0.9)]
)
def test_frames_in_which_hardly_a_point_is_seen_are_no_measurement(pressed, lost, share):
    """Answers stay within their intervals, and the motion is that of the others."""
    time, X, p, *_ = pressed
    valid = np.ones(p.shape[:2], dtype=bool)
    valid[list(lost), : int(share * len(X))] = False
    made = recording(pressed, valid=valid)
    made = replace(made, p_WQ=np.where(valid[..., None], made.p_WQ, 0.0))
    assert max(deviations(identify(made, weak=QUICK)).values()) < 4.0
    told = sighted(made)
    assert told.frames == FRAMES - len(list(lost))
    fit = fit_tracks(told, body(told))
    shown = np.delete(np.arange(FRAMES), list(lost))
    x = Sampling.of(fit, time[shown], X, np.ones(len(X)), 1.0).motion(fit.c).x
    assert np.abs(x - p[shown]).max() < 5e-6


def test_points_that_come_and_go_are_no_motion(pressed):
    valid = np.zeros(pressed[2].shape[:2], dtype=bool)
    valid[np.arange(FRAMES), np.arange(FRAMES)] = True  # another one in each frame
    with pytest.raises(ValueError, match="in 0 of 61 frames half of the points are seen"):
        identify(recording(pressed, valid=valid))


def test_points_that_are_lost_for_a_while_lie_on_lines_from_frame_to_frame():
    u = np.arange(12.0).reshape(6, 2, 1) * np.ones(3)
    valid = np.ones((6, 2), dtype=bool)
    valid[2:4, 0] = valid[:, 1] = False
    found = bridged(np.where(valid[..., None], u, 0.0), valid)
    np.testing.assert_allclose(found[:, 0], u[:, 0])
    assert not found[:, 1].any()  # never seen


def test_a_pressure_acts_once(pressed):
    """The law's own, or the recorded one, which is then refused where there is none."""
    held = {"pressure": pressed[-1]}
    for made in (recording(pressed, **held), recording(pressed)):
        own = identify(made, weak=replace(BOX, pressure="law"))
        assert max(deviations(own).values()) < 4.0
    known = {"kappa": KAPPA}
    found = identify(recording(pressed, **held), weak=BOX, known=known)
    assert found.details["pressure"] == "supplied"
    C = found.material.parameters()["C10"]
    assert abs(C.value - C10) < 4.0 * C.std
    with pytest.raises(ValueError, match="pressure supplied: a recording holds none"):
        identify(recording(pressed), weak=replace(BOX, pressure="supplied"), known=known)


def test_rows_under_a_recorded_pressure_are_as_noisy_as_they_are_told_to_be(pressed):
    """The noise moves the pressure's work too, and the bulk modulus has no part in it."""
    made = recording(pressed, pressure=pressed[-1], noise=2e-5)
    found = identify(made, weak=BOX, known={"kappa": KAPPA})
    problem, eta, theta = found.weak.problem, np.zeros(0), found.weak.theta
    rng, (A, b), drawn = np.random.default_rng(1), problem.rows(np.zeros(0)), []
    for _ in range(30):
        changes = problem.changes([p.drawn(rng) for p in problem.probes])
        moved = problem.disturbed(eta, changes, 0.1)
        drawn.append(((moved[1] - b) - (moved[0] - A) @ theta) / 0.1)
    power = np.mean(np.square(drawn), axis=0)
    (noise,) = problem.noise(eta, theta)
    assert power.sum() / np.trace(noise) == pytest.approx(1.0, abs=0.15)


def test_noise_that_is_added_is_another_in_every_probe_and_is_told(pressed, monkeypatch):
    seen, made = [], recording(pressed)

    def asked(ready, *words):
        seen.append([r.p_WQ - made.p_WQ for r in ready])
        threads.append({p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"})
        return identified(ready, *words)

    identification = import_module("form_drake.identify")  # the function has its name
    threads, identified = [], identification.identify_weak
    monkeypatch.setattr(identification, "identify_weak", asked)
    other = replace(made, p_WQ=made.p_WQ + 1e-9)
    with threadpool_limits(2, user_api="blas"):
        found = identify([made, other], weak=BOX, add_noise=1e-5, seed=3)
    assert found.details["added_noise"] == 1e-5 and "NOISE ADDED: 1e-05 m" in str(found)
    assert threads == [{1}]
    identify(made, weak=BOX, add_noise=1e-5, seed=3)
    (first, second), (alone,) = seen
    assert np.array_equal(first, alone)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.05


def test_a_report_that_lies_in_the_folder_is_of_the_run(pressed, here, capsys):
    """So that the next run takes its place."""
    with pytest.raises(ValueError, match=r"written to a file that ends in [.]h5"):
        write_recording(recording(pressed), here / "press")
    write_recording(recording(pressed), here / "press.h5")
    for _ in range(2):
        told = ("press.h5", "--fields", "box", "--report", "runs/identify/seen/it.html")
        code, _, said = run(capsys, "identify", *told)
        assert code == 0, said
    (here / "runs/identify/mine.txt").touch()
    assert "no earlier run has made (mine.txt)" in refusal(capsys, "identify", "press.h5")


def test_gravity_that_only_a_solver_states_acts(pressed):
    solver = Solver(dx=1e-3, nodes=(40,) * 3, dt=None, gravity=(0.0, 0.0, -9.81))
    every = (
        recording(pressed, gravity=np.array(solver.gravity)),
        recording(pressed, solver=solver, gravity=None),
    )
    one, other = (identify(r, weak=BOX).weak.problem.probes[0].gravity for r in every)
    assert one == pytest.approx([0.0, 0.0, -9.81]) and other == pytest.approx(one)


def test_a_sum_of_stiffnesses_has_no_poisson_ratio_to_state(pressed):
    with pytest.raises(ValueError, match="has no parameter 'nu'"):
        identify(recording(pressed), "fixed-corotated+yeoh", weak=BOX, known={"nu": 0.45})


def test_fewer_rows_than_unknowns_determine_none(pressed):
    one = replace(QUICK, ends=((0.1, 0.3),), fields=("axial",))
    with pytest.raises(Unidentifiable):
        identify(recording(pressed), weak=replace(one, pressure="law"))


def test_a_force_tells_of_one_face(pressed):
    contact = {"z-": "frictionless plate", "z+": "frictionless plate", "other": "free"}
    with pytest.raises(ValueError, match="force of plate: contact names it on several faces"):
        identify(recording(pressed, contact=contact))


def test_probes_are_of_one_material_and_not_of_one_motion(pressed):
    made = recording(pressed)
    moved = replace(made, p_WQ=made.p_WQ + 1e-9)
    for other, words in (
        (made, "recording 2: the same motion as recording 1"),
        (replace(moved, law="yeoh"), "law: the recordings declare neo-hookean and yeoh"),
        (replace(moved, density=2.0), "density: the recordings declare 1.0 and 2.0"),
        (replace(moved, known={"kappa": 1e4}), "known kappa: the recordings declare"),
    ):
        first = replace(made, known={"kappa": KAPPA}) if "known" in words else made
        with pytest.raises(ValueError, match=words):
            identify([first, other], weak=QUICK)


def test_what_follows_from_the_rest_is_not_known_beside_it(pressed):
    made = recording(pressed, law="fixed-corotated", known={"nu": 0.45})
    for key in ("mu", "lam"):
        with pytest.raises(ValueError, match=f"nu and {key} are both known"):
            identify(made, known={key: 1e4})
    with pytest.raises(ValueError, match="needs consecutive solver states"):
        identify(made, method="step")


def test_noise_that_is_added_or_stated_is_that_of_covariances_too(pressed):
    made = recording(pressed)
    size = np.tile(np.diag([1.0, 4.0, 9.0]) * 1e-12, (made.points, 1, 1))
    made = replace(made, covariance=size)
    noisier = degraded(made, 3e-6, 0)
    np.testing.assert_allclose(noisier.covariance, size + 9e-12 * np.eye(3))
    other = restated(made, 1e-5)
    np.testing.assert_allclose(np.trace(other.covariance[0]) / 3.0, 1e-10)
    np.testing.assert_allclose(
        other.covariance[0] / size[0][0, 0],
        other.covariance[0, 0, 0] / size[0, 0, 0] * np.diag([1.0, 4.0, 9.0]),
        atol=1e-9,
    )


def test_fewer_frames_hold_fewer_pressures(pressed):
    few = thinned(recording(pressed, pressure=pressed[-1]), 2)
    assert few.pressure.shape == few.p_WQ.shape[:2]
