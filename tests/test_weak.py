"""The weak momentum balance: exact motions that no solver of the package made, and refusals."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake import Recording, Stream, Unidentifiable, identify
from form_drake.diagnose import ProbeReading
from form_drake.identify import WeakOptions
from form_drake.identify.weak import weighed
from form_drake.identify.worth import noise_bias
from form_drake.laws import law_named
from form_drake.motion import Motion, Sampling, body, fit_tracks
from form_drake.motion.splines import Splines
from form_drake.weak.axial import AxialFields
from form_drake.weak.balance import balance
from form_drake.weak.bend_curl import BendCurlFields
from form_drake.weak.curl import CurlFields
from form_drake.weak.errors import from_forces
from form_drake.weak.force import Force, fast, followed, measured
from form_drake.weak.solve import Weights, solved
from form_drake.weak.stress import unit_stresses
from form_drake.weak.windows import bump, even, windows

ORACLES = Path(__file__).parent / "oracles"


def oracle(name):
    """A module of ``tests/oracles``, whose files import each other by name."""
    sys.path.insert(0, str(ORACLES))
    try:
        spec = spec_from_file_location(name, ORACLES / f"{name}.py")
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ORACLES))
    return module


@pytest.fixture(scope="module")
def exact():
    """``make`` of the exact motions, each made once."""
    return cache(oracle("exact_motion").make)


def recording(exact, case, seed=0, **changes):
    """The recording of an exact motion, and the true parameters."""
    arrays, facts, truth = exact(case, seed)
    plain = ("p_reference", "gravity", "body_force", "pressure")
    tools = [k[6:-5] for k in arrays if k.startswith("force_") and k.endswith("_time")]
    forces = {t: Stream(arrays[f"force_{t}_time"], arrays[f"force_{t}_value"]) for t in tools}
    fields = {k: arrays[k] for k in plain if k in arrays}
    fields |= {"density": float(arrays["density"]), "forces": forces}
    fields |= {k: facts[k] for k in ("geometry", "contact", "law", "known")}
    made = Recording.from_arrays(arrays["time"], arrays["p_WQ"], **{**fields, **changes})
    return made, truth


def errors(answer, truth):
    return {k: abs(answer.material.values[k] / v - 1.0) for k, v in truth.items()}


# --- windows and fields ---------------------------------------------------------------------------
def test_windows_let_no_position_or_speed_in():
    time = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 80))
    found = windows(time, even(time[0], time[-1], 0.4, 0.2))
    np.testing.assert_allclose(found.rate @ np.ones(80), 0.0, atol=1e-12)
    # a momentum that grows at a steady rate is balanced by a steady force
    np.testing.assert_allclose(found.rate @ time, -found.chi.sum(axis=1), rtol=1e-12)


def test_bump_vanishes_with_its_slope_at_both_ends():
    value, slope = bump(np.array([-1.0, 0.0, 1.0, 2.0]))
    np.testing.assert_array_equal(value, [0.0, 1.0, 0.0, 0.0])
    np.testing.assert_array_equal(slope, 0.0)


def test_every_pressure_cancels_against_curls(exact):
    made, _ = recording(exact, "neo-hookean")
    shape = body(made)
    fit = fit_tracks(made, shape)
    fields = CurlFields.of(shape)
    X, volume = shape.gauss(fields.breaks, 4)
    sampling = Sampling.of(fit, np.linspace(0.1, 0.3, 3), X, volume, 1000.0)
    motion = replace(sampling, hessian=fit.space.scalar.hessian(X)).motion(fit.c)
    # field by field and point by point, not only after integration
    sampled = fields.at(motion)
    along_x = sampled.gradient @ motion.inverse[:, None]
    size = np.abs(along_x).max()
    np.testing.assert_allclose(np.trace(along_x, axis1=3, axis2=4), 0.0, atol=1e-12 * size)
    p = np.random.default_rng(0).standard_normal(motion.J.shape)  # as rough as can be
    pressure = (p * motion.J)[..., None, None] * np.eye(3)
    rows = balance(fields, motion, np.zeros(3)).stress(pressure, np.eye(3))
    scale = np.sum(volume * np.abs(pressure[0, :, 0, 0])) * size
    np.testing.assert_allclose(rows, 0.0, atol=1e-12 * scale)


@pytest.mark.parametrize("sign", [1, -1])
def test_bending_fields_without_divergence_carry_the_pusher_and_keep_the_volume(sign):
    held, length = 0.01 + 0.08 * (sign > 0), 0.08
    fields = BendCurlFields(
        axis=2, push=0, middle=0.002, held=held, length=length, sign=sign,
        ramps=((0.3, 0.95), (0.4, 1.0)), tool="pusher", breaks=(),
    )  # fmt: skip

    def at(x):
        none, one = np.zeros((1, *x.shape, 3)), np.ones(len(x))
        return fields.at(Motion(np.zeros(1), x, x[None], x[None], none, none, one, one))

    x = np.random.default_rng(0).uniform([-0.006, -0.002, 0.011], [0.006, 0.002, 0.089], (40, 3))
    gradient, h = at(x).gradient[0], 1e-7
    moved = [(at(x + h * e).value[0] - at(x - h * e).value[0]) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(np.stack(moved, -1), gradient, atol=1e-5 * np.abs(gradient).max())
    np.testing.assert_allclose(np.trace(gradient, axis1=2, axis2=3), 0.0, atol=1e-12)
    ends = np.array([[0.004, 0.001, held], [0.004, 0.001, held - sign * 0.75 * length]])
    np.testing.assert_allclose(at(ends).value[0, :, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(at(ends).value[0, :, 1], [[1.0, 0.0, 0.0]] * 2, atol=1e-12)


def test_axial_fields_follow_both_ends_and_keep_the_volume():
    time = np.linspace(0.0, 1.0, 41)
    fields = AxialFields(
        axis=2,
        origin=np.zeros(3),
        time=time,
        start=0.01 * time**2,
        length=0.02 + 0.01 * np.sin(time),
        lateral=np.array([[0.5, 0.5, 0.0], [1.0, 0.0, 0.0]]),
        ramps=((0.0, 0.9), (0.1, 1.0)),
        sign=1,
        tool="plate",
        breaks=(),
    )
    x = np.random.default_rng(0).uniform(0.0, 0.03, (20, 3))

    def at(times, x):
        still = np.broadcast_to(x, (len(times), *x.shape))
        none = np.zeros((*still.shape, 3))
        one = np.ones(len(x))
        return fields.at(Motion(np.array(times), x, still, still, none, none, one, one))

    h = 1e-6
    before, after = at((0.5 - h, 0.5 + h), x).value
    rate = (after - before) / (2 * h)
    np.testing.assert_allclose(at([0.5], x).rate[0], rate, atol=1e-6 * np.abs(rate).max())
    gradient = at([0.5], x).gradient[0]
    np.testing.assert_allclose(np.trace(gradient, axis1=2, axis2=3), 0.0, atol=1e-9)
    ends = np.array(
        [[0.003, 0.001, 0.01 * 0.25], [0.003, 0.001, 0.01 * 0.25 + 0.02 + 0.01 * np.sin(0.5)]]
    )
    found = at([0.5], ends).value[0]
    np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-12)  # where an unknown force holds it
    np.testing.assert_allclose(found[:, 1], np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-12)


# --- exact motions --------------------------------------------------------------------------------
HOMOGENEOUS = ("mooney-rivlin", "yeoh", "gent")
INSIDE = (
    "neo-hookean",
    "fixed-corotated",
    "von-mises",
    "drucker-prager",
    "weakly-compressible",
    "newtonian",
    "bingham",
)


@pytest.fixture(scope="module")
def inside(exact):
    """Answers to motion inside, by law, each found once."""
    return cache(lambda law: identify(recording(exact, law)[0], weak=WeakOptions(draws=1)))


@pytest.mark.parametrize("law", INSIDE)
def test_motion_inside_gives_the_law(exact, inside, law):
    truth, answer = recording(exact, law)[1], inside(law)
    assert answer.method == "weak"
    assert max(errors(answer, truth).values()) < 5e-3


def test_the_rate_below_which_a_mud_flows_like_a_fluid_is_found(exact):
    made, truth = recording(exact, "bingham")
    known = dict(made.known)
    truth["epsilon"] = known.pop("epsilon")
    answer = identify(replace(made, known=known), weak=WeakOptions(draws=0))
    assert max(errors(answer, truth).values()) < 5e-3


@pytest.mark.parametrize("seed", range(2))
def test_noise_of_tracks_is_in_the_intervals_and_leaves_no_bias(exact, seed):
    made, truth = recording(exact, "neo-hookean")
    size = np.sqrt(np.mean((made.p_WQ - made.reference) ** 2))
    noise = 0.01 * size * np.random.default_rng(seed).standard_normal(made.p_WQ.shape)
    answer = identify(replace(made, p_WQ=made.p_WQ + noise), weak=WeakOptions(draws=2))
    assert max(errors(answer, truth).values()) < 0.03
    found = answer.material.parameters()
    for key, value in truth.items():
        assert abs(found[key].value - value) < 3.0 * found[key].std


@pytest.mark.parametrize("law", HOMOGENEOUS)
def test_homogeneous_stretches_and_forces_give_the_law(exact, law):
    made, truth = recording(exact, f"{law}-uniaxial")
    answer = identify(made, weak=WeakOptions(draws=0))
    assert max(errors(answer, truth).values()) < 1e-4
    assert answer.observed == "tracks and force"


@pytest.mark.parametrize("law", HOMOGENEOUS)
def test_homogeneous_stretches_alone_give_nothing(exact, law):
    made, truth = recording(exact, f"{law}-uniaxial", forces={}, contact={})
    with pytest.raises(Unidentifiable) as caught:
        identify(made)
    assert set(caught.value.keys) == set(truth)


def test_three_inclinations_give_the_granular_law_and_one_does_not(exact):
    made = [recording(exact, f"mu-i-{n}") for n in (1, 2, 3)]
    answer = identify([r for r, _ in made], weak=WeakOptions(draws=0))
    assert max(errors(answer, made[0][1]).values()) < 5e-3
    with pytest.raises(Unidentifiable, match="inclinations") as caught:
        identify(made[0][0])
    assert set(caught.value.keys) == {"mu_s", "delta_mu", "I_0"}


def test_a_measured_pressure_that_is_noise_gives_a_finite_stress():
    law, F = law_named("mu-i"), np.tile(np.eye(3), (2, 1, 1))
    L = np.zeros((2, 3, 3))
    L[:, 0, 2] = 1.0
    values = {"I_0": 0.3, "grain_diameter": 5e-3, "grain_density": 2500.0, "epsilon": 0.2}
    values |= {"mu_s": 1.0, "delta_mu": 1.0, "kappa": 1e4}
    T = unit_stresses(law, F, L, values, pressure=np.array([-1.0, 100.0]))
    assert np.isfinite(T).all() and T[0, 1, 0, 2] > 0.0


def test_known_nu_ties_the_moduli(exact):
    made, truth = recording(exact, "fixed-corotated")
    mu, lam = truth["mu"], truth["lam"]
    answer = identify(made, known={"nu": lam / (2 * (lam + mu))}, weak=WeakOptions(draws=0))
    assert max(errors(answer, truth).values()) < 3e-3
    assert np.linalg.matrix_rank(answer.material.covariance, tol=1e-9) == 1


def test_a_yield_stress_alone_is_no_known_strain(exact):
    made, truth = recording(exact, "von-mises")
    with pytest.raises(ValueError, match="tau_y is given while mu, lam is sought"):
        identify(made, known={"tau_y": truth["tau_y"]})
    moduli = {k: truth[k] for k in ("mu", "lam")}
    answer = identify(made, known=moduli, weak=WeakOptions(draws=0))
    assert errors(answer, truth)["tau_y"] < 5e-3


def test_effects_read_the_stress_that_yield_leaves(inside):
    answer = inside("von-mises")
    problem, values = answer.weak.problem, answer.material.values
    eta, theta = problem.coordinates(values)
    (reading,) = ProbeReading.of(problem, values)
    A = problem.rows(eta, theta)[0]
    stress = A @ theta
    np.testing.assert_allclose(
        reading.stress(reading.now()), stress, atol=1e-9 * np.abs(stress).max()
    )


def test_noise_that_lasts_is_that_of_draws(exact):
    """Of the rows while the body flows; as if it acted at its own time alone they seem noisier."""
    made, _ = recording(exact, "von-mises")
    rng = np.random.default_rng(0)
    noisy = replace(made, p_WQ=made.p_WQ + 2e-5 * rng.standard_normal(made.p_WQ.shape))
    found = weighed([noisy], law_named("von-mises"), made.known, WeakOptions(draws=0))
    problem, eta = found.problem.coarser, found.eta
    theta = problem.unknowns.theta(found.solution.theta)
    (probe,), (A, b) = problem.probes, problem.rows(eta, theta)
    drawn = []
    for seed in range(40):
        change = probe.fit.draw(np.random.default_rng(seed))
        moved = problem.disturbed(eta, problem.changes([(change, {})]), 0.01)
        drawn.append(((moved[1] - b) - (moved[0] - A) @ theta) / 0.01)
    power = np.mean(np.square(drawn), axis=0)
    lasting = problem.passed(eta, theta, [np.eye(len(b))])
    (own,) = problem.noise(eta, theta)
    force = np.diag(from_forces(probe))[probe.keep]
    claimed = [np.median(power / (np.diag(n) - force)) for n in (lasting, own)]
    assert claimed[0] == pytest.approx(1.0, abs=0.12)
    assert claimed[1] < claimed[0] - 0.08


def test_ordinary_least_squares_is_there(exact):
    made, truth = recording(exact, "neo-hookean")
    answer = identify(made, weak=WeakOptions(estimator="ols"))
    assert answer.details["estimator"] == "ols"
    assert max(errors(answer, truth).values()) < 2e-2


def test_a_sum_of_laws_keeps_the_one_that_acts(exact):
    made, truth = recording(exact, "yeoh-uniaxial")
    answer = identify(made, "yeoh+mooney-rivlin", weak=WeakOptions(draws=0))
    law = law_named("yeoh+mooney-rivlin")
    assert answer.material.values["C1"] == pytest.approx(truth["C1"], rel=1e-3)
    assert abs(answer.material.values["C01"]) < 1e-3 * truth["C1"]
    assert law.keys == ("C1", "C2", "C3", "kappa", "C01")


def test_error_bars_are_as_wide_as_the_errors(exact):
    made, truth = recording(exact, "yeoh-uniaxial")
    rng = np.random.default_rng(1)
    move = np.sqrt(np.mean((made.p_WQ - made.reference) ** 2))
    pulls = []
    for _ in range(6):
        forces = {
            k: Stream(
                s.time, s.value + 0.01 * np.abs(s.value).max() * rng.normal(size=s.value.shape)
            )
            for k, s in made.forces.items()
        }
        p_WQ = made.p_WQ + 0.01 * move * rng.normal(size=made.p_WQ.shape)
        answer = identify(replace(made, p_WQ=p_WQ, forces=forces), weak=WeakOptions(draws=2))
        std = np.sqrt(np.diag(answer.material.covariance))
        found = np.array([answer.material.values[k] for k in answer.material.keys])
        true = np.array([truth[k] for k in answer.material.keys])
        pulls.append((found - true) / std)
        assert abs(answer.material.values["kappa"] / truth["kappa"] - 1) < 0.03
    assert 0.3 < np.sqrt(np.mean(np.square(pulls))) < 2.5


def moving(made):
    """Poses of a tool that moves along x."""
    X_WT = np.tile(np.eye(4), (made.frames, 1, 1))
    X_WT[:, 0, 3] = np.linspace(0.0, 0.01, made.frames)
    return Stream(made.time, X_WT)


# --- refusals -------------------------------------------------------------------------------------
def test_lost_points_and_uneven_stamps_are_taken(exact):
    made, truth = recording(exact, "yeoh-uniaxial")
    rng = np.random.default_rng(0)
    frames = np.sort(rng.choice(made.frames, 45, replace=False))
    valid = rng.uniform(size=(45, made.points)) > 0.1
    p_WQ = np.where(valid[:, :, None], made.p_WQ[frames], np.nan)
    thin = replace(made, time=made.time[frames], p_WQ=p_WQ, valid=valid)
    answer = identify(thin, weak=WeakOptions(draws=0))
    assert max(errors(answer, truth).values()) < 2e-2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda r: {"forces": {}, "poses": {"pull_x": moving(r)}},
            "pull_x touches x\\+ and moves, but",
        ),
        (lambda r: {"p_WQ": r.p_WQ[:, :6], "p_reference": r.reference[:6]}, "6 points"),
        (lambda r: {"p_WQ": r.p_WQ * [1, 1, 0], "p_reference": r.reference * [1, 1, 0]}, "plane"),
        (lambda r: {"p_WQ": 1e3 * r.p_WQ, "p_reference": 1e3 * r.reference}, "millimetres"),
        (lambda r: {"geometry": {}}, "low and high"),
        (lambda r: {"density": None}, "density"),
        (lambda r: {"contact": {"x+": "glued"}}, "allowed are free"),
        (
            lambda r: {"forces": {k: Stream(s.time + 9, s.value) for k, s in r.forces.items()}},
            "clocks must overlap",
        ),
    ],
)
def test_bad_recordings_are_refused_in_one_line(exact, change, words):
    made, _ = recording(exact, "yeoh-uniaxial")
    with pytest.raises(ValueError, match=words) as caught:
        identify(replace(made, **change(made)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("late", [-0.04, 0.04])
def test_forces_may_be_stamped_late_for_others_to_find(exact, late):
    made, _ = recording(exact, "yeoh-uniaxial")
    forces = {k: Stream(s.time + late, s.value) for k, s in made.forces.items()}
    last = float(np.ptp(made.time))
    ends = even(0.0, last, 0.4 * last, 0.2 * last)
    inside = measured(made, 0.0, last)
    for name, found in measured(replace(made, forces=forces), 0.0, last).items():
        assert found.time == pytest.approx(forces[name].time - made.time[0])
        whole = inside[name].impulses(ends).sum(axis=1)  # of a force of one, over all of a window
        assert found.impulses(ends).sum(axis=1) == pytest.approx(whole, rel=1e-3)


@pytest.mark.parametrize("rate", [1000.0, 240.0, 20.0, 10.0, 5.0])
@pytest.mark.parametrize("gap", [0.0, 0.04, 0.1])
def test_impulses_of_a_force_are_its_own_however_it_is_sampled(rate, gap):
    """One that does not change, to what a trapezoidal rule leaves; one that does, to what is measured of it."""
    time, ends = np.arange(0.0, 2.0 + 1e-9, 1.0 / rate), even(0.0, 2.0, 0.16, 0.08)
    time = time[(time < 0.8) | (time > 0.8 + gap)]
    whole = np.sum(np.diff(ends, axis=1)) / len(ends) * 128.0 / 315.0  # of (1 - s^2)^4
    weights = Force(time, np.zeros((len(time), 3)), 0.0).impulses(ends)
    assert weights.sum(axis=1) == pytest.approx(whole, rel=0.025 if rate == 20.0 else 2e-3)
    if rate >= 240.0:
        swing, every = np.sin(2.0 * np.pi * time), np.linspace(0.0, 2.0, 20001)
        exact = Force(every, np.zeros((len(every), 3)), 0.0).impulses(ends)
        wanted, bow = exact @ np.sin(2.0 * np.pi * every), (2.0 * np.pi * gap) ** 2 / 8.0
        assert weights @ swing == pytest.approx(wanted, abs=(2e-3 + bow) * whole)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_how_much_of_a_force_frames_cannot_follow(noise):
    time = np.arange(0.0, 2.0, 1e-3)
    value = np.zeros((len(time), 3))
    value[:, 0] = np.sin(2.0 * time) + 0.1 * np.sin(2.0 * np.pi * 58.6 * time)
    swings = 0.1 / np.sqrt(2.0) / np.sqrt(np.mean(value**2) * 3.0)
    value += np.random.default_rng(3).normal(0.0, 1.0, value.shape) * noise
    assert fast(time, value, noise, 60.0) == pytest.approx(swings, rel=0.05)
    assert fast(time, value, noise, 200.0) < 0.02
    assert fast(time[::20], value[::20], noise, 60.0) is None


def test_of_a_force_frames_follow_all_but_jolts():
    time, frames = np.linspace(0.0, 1.0, 2001), np.linspace(0.0, 1.0, 61)
    splines = Splines.uniform(0.0, 1.0, 20, 3)
    smooth = splines.matrix(time) @ np.random.default_rng(0).standard_normal((splines.size, 3))
    assert np.abs(followed(Force(time, smooth, 0.0), frames, splines).missed).max() < 1e-3
    jolt = np.where(np.abs(time - 0.507) < 0.004, 1.0, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    missed = followed(Force(time, smooth + jolt, 0.0), frames, splines).missed
    near = np.abs(time - 0.507) < 0.1
    assert np.abs(missed[near]).max() > 0.5 and np.abs(missed[~near]).max() < 0.05
    assert np.abs(missed[:, :2]).max() < 1e-3
    assert followed(Force(time[::20], smooth[::20], 0.0), frames, splines).missed is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (WeakOptions(window=5.0), "longer than the recording"),
        (WeakOptions(window=-1.0), "positive width"),
        (WeakOptions(fields=("round",)), "choose from box, axial"),
        (WeakOptions(fields=("bend",)), "they need a touched face"),
    ],
)
def test_bad_options_are_refused_in_one_line(exact, options, words):
    made, _ = recording(exact, "yeoh-uniaxial")
    with pytest.raises(ValueError, match=words):
        identify(made, weak=options)


# --- a bent strip ---------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    """A strip bent by a pusher, from the finite element oracle's coarse mesh, nu stated."""
    folder, case = tmp_path_factory.mktemp("strip"), "bend-touching-a"
    command = [sys.executable, str(ORACLES / "finite_elements.py"), case, "--mesh", "coarse"]
    subprocess.run([*command, "--out", str(folder)], check=True, timeout=300)
    arrays = np.load(folder / f"{case}.npz")
    truth = json.loads((folder / f"{case}.truth.json").read_text())

    def stream(kind):
        return {"pusher": Stream(arrays[f"{kind}_pusher_time"], arrays[f"{kind}_pusher_value"])}

    made = Recording.from_arrays(
        arrays["time"],
        arrays["p_WQ"],
        p_reference=arrays["p_reference"],
        density=float(arrays["density"]),
        geometry={"shape": "box", "low": "-0.006 -0.002 0", "high": "0.006 0.002 0.085"},
        contact={"z+": "bonded clamp", "x+": "touched pusher", "other": "free"},
        poses=stream("pose"),
        forces=stream("force"),
        law="fixed-corotated",
        known={"nu": truth["nu"]},
    )
    return made, truth


def test_a_bent_strip_gives_its_stiffness(strip):
    made, truth = strip
    answer = identify(made, weak=WeakOptions(draws=0))
    assert answer.material.parameters()["E"].value == pytest.approx(truth["E"], rel=5e-3)
    assert all("bend" in name for name in answer.details["probes"][0]["fields"])


def test_a_bent_strip_gives_its_stiffness_to_fields_that_no_pressure_works_on(strip):
    """They hear shear, so that the coarse mesh and the tracks tell less: the interval says by how much."""
    made, truth = strip
    wanted = WeakOptions(fields=("bend-curl",), pressure="free")
    E = identify(made, weak=wanted).material.parameters()["E"]
    assert E.value == pytest.approx(truth["E"], rel=1e-2)
    assert abs(E.value - truth["E"]) < 2.0 * E.std < 0.03 * truth["E"]


def test_an_error_that_all_rows_share_is_part_of_their_covariance():
    """Each probe has its own, and another that the first one knows nothing of."""
    rng = np.random.default_rng(0)
    parts = [rng.standard_normal((n, 2 * n)) for n in (7, 12)]
    noise, rows = [p @ p.T for p in parts], np.eye(19)
    errors = [5.0 * rng.standard_normal(19), np.append(rng.standard_normal(7), np.zeros(12))]
    by = Weights(tuple(map(np.linalg.cholesky, noise)), 0.0)
    by = by.beside(errors[0][:, None]).beside(errors[1][:, None])
    whole, found = np.zeros((19, 19)), by.white(rows)
    for n, own in enumerate((slice(0, 7), slice(7, 19))):
        whole[own, own] = noise[n] + sum(np.outer(e[own], e[own]) for e in errors)
        some = np.arange(2, 6)
        part = whole[own, own][np.ix_(some, some)]
        assert by.of(n).covariance(some) == pytest.approx(part, rel=1e-12)
    assert found.T @ found == pytest.approx(np.linalg.inv(whole), rel=1e-9, abs=1e-12)
    assert by.coloured(found) == pytest.approx(rows, abs=1e-9)
    assert by.sizes == pytest.approx(np.sqrt(np.diag(whole)))


def _one_column(A, b, sigma):
    """One column, each entry with noise of its own."""
    return SimpleNamespace(
        unknowns=SimpleNamespace(keys=("eta",)),
        probes=(SimpleNamespace(drawn=lambda rng: sigma * rng.standard_normal(A.shape)),),
        rows=lambda _: (A, b),
        reduced=lambda A, b: (A, b),
        changes=lambda drawn: drawn,
        disturbed=lambda _, drawn, part: (A + part * drawn[0], b),
    )


def test_noise_of_columns_meets_what_noise_has_left_of_the_rows():
    """The variance that is of second order is known."""
    theta, sigma, rows = 3.0, 0.02, 100
    A = 1.0 + sigma * np.random.default_rng(1).standard_normal((rows, 1))
    b = np.full(rows, theta)
    by = Weights((theta * sigma * np.eye(rows),), 0.0)
    _, found = noise_bias(_one_column(A, b, sigma), np.zeros(0), A, by, 400, 0)
    left = b - A[:, 0] * solved(A, b, by).theta
    wanted = sigma**2 * (left @ left) / np.sum(A**2) ** 2
    assert found[0, 0] == pytest.approx(wanted, rel=0.15)


def test_noise_bias_that_grows_slower_than_the_variance():
    """An answer sinks to 1 / (1 + the variance): a line leads back two thirds of the way."""
    theta, sigma, rows = 3.0, 0.5, 400
    n = np.random.default_rng(1).standard_normal(rows)
    n -= n.mean()
    A = 1.0 + sigma * n[:, None] / n.std()
    b = np.full(rows, theta)
    by = Weights((theta * sigma * np.eye(rows),), 0.0)
    sunk = solved(A, b, by).theta[0]
    assert sunk == pytest.approx(theta / (1.0 + sigma**2))
    bias, found = noise_bias(_one_column(A, b, sigma), np.zeros(0), A, by, 200, 0)
    assert abs(sunk - bias[0] - theta) < np.sqrt(found[0, 0]) < abs(sunk - theta)
    assert sunk - bias[0] > sunk + 0.75 * (theta - sunk)
