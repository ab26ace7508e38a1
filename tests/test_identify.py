"""Identification against trajectories that ``oracles/step_mpm.py`` made from known parameters."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from form_drake import LAWS, Material, Recording, Solver, Unidentifiable, Wall, identify, predict
from form_drake.identify.options import WeakOptions
from form_drake.identify.start import refuse_local_minimum
from form_drake.identify.trials import Rollouts
from form_drake.records import States

DATA = Path(__file__).parent / "data"
EXACT = 1e-10  # float64 rounding times the condition of the columns; 3e-12 is seen
PLACES = ("step", "x", "v", "C", "F", "L", "tau")


@cache
def oracle(folder, name):
    """A recording of the oracle's trajectory and the true parameters, given ones among them."""
    with np.load(DATA / folder / f"{name}.npz") as file:
        data = dict(file)
    nodes, dx, cells = int(data["nodes"]), float(data["dx"]), int(data["wall_cells"])
    ends = ((-1, (cells - 1) * dx), (1, (nodes - cells + 1) * dx))
    solver = Solver(
        dx=dx,
        nodes=(nodes,) * 3,
        dt=float(data["dt"]),
        gradient=str(data["gradient"]),
        precision="float64",
        walls=tuple(Wall(axis, side, at) for axis in range(3) for side, at in ends),
        mass_eps=float(data["mass_eps"]),
        gravity=tuple(data["gravity"]),
    )
    given = {k[6:]: float(v) for k, v in data.items() if k.startswith("given_")}
    rest = {"v_0": data["v0"], "volume": data["volume"], "density": float(data["density"])}
    rest |= {"solver": solver, "gravity": data["gravity"], "known": given, "law": name}
    if folder == "positions":
        time, x = data["step"] * solver.dt, data["x"]
        rest |= {"step": data["step"], "p_reference": data["x0"]}
    else:
        time, x = [0.0], data["x0"][None]
        rest["states"] = States(**{k: data[k] for k in PLACES})
    truth = json.loads((DATA / folder / "truth.json").read_text())[name]
    return Recording.from_arrays(time, x, **rest), truth


def errors(answer, truth):
    """Relative error of every true parameter."""
    return {k: abs(answer.material.values[k] / t - 1.0) for k, t in truth.items()}


def changed(recording, **arrays):
    return replace(recording, states=replace(recording.states, **arrays))


@pytest.mark.parametrize("observe", ["no-stress", "full"])
@pytest.mark.parametrize("name", LAWS)
def test_two_steps_give_every_parameter(name, observe):
    recording, truth = oracle("steps", name)
    answer = identify(recording, observe=observe)
    assert set(truth) == set(answer.material.keys)
    assert max(errors(answer, truth).values()) < EXACT
    assert all(answer.material.parameters()[k].std > 0 for k in truth)
    assert answer.misfit < 30


@pytest.mark.parametrize("name", LAWS)
def test_a_rigidly_falling_body_tells_nothing(name):
    recording, truth = oracle("steps", name)
    solver = recording.solver
    n, steps = recording.points, np.arange(3)
    v = np.array([0.3, -0.2, 0.1]) + steps[:, None] * solver.dt * np.array(solver.gravity)
    x = recording.p_WQ[0] + solver.dt * np.cumsum(v, axis=0)[:, None]
    still = np.zeros((3, n, 3, 3))
    states = States(
        step=steps, x=x, v=np.repeat(v[:, None], n, 1), C=still, F=still + np.eye(3), L=still
    )
    with pytest.raises(Unidentifiable) as caught:
        identify(replace(recording, states=states))
    linear = {t.key for t in LAWS[name].terms} & set(truth)
    assert linear <= set(caught.value.keys)
    assert all(key in str(caught.value) for key in caught.value.keys)


def test_positions_of_a_rigidly_falling_body_tell_nothing():
    recording, truth = oracle("positions", "fixed-corotated")
    t = recording.time[:20, None, None]
    v, g = np.array([0.3, 0.5, 0.1]), recording.gravity
    dt = recording.solver.dt
    falling = replace(
        recording,
        time=recording.time[:20],
        step=recording.step[:20],
        p_WQ=recording.reference + v * t + 0.5 * g * t * (t + dt),
        v_0=np.tile(v, (recording.points, 1)),
        solver=replace(recording.solver, mass_eps=0.0),  # which would slow light nodes
    )
    with pytest.raises(Unidentifiable) as caught:
        identify(falling, start={"mu": 3e3, "lam": 3e3})
    assert set(caught.value.keys) == set(truth)


def test_motion_that_never_yields_does_not_tell_the_yield_stress():
    recording, _ = oracle("steps", "von-mises")
    s = recording.states
    F = s.F.copy()
    for i, j in s.pairs():
        F[j] = F[i] + recording.solver.dt * (s.L[j] @ F[i])
    with pytest.raises(Unidentifiable, match="tau_y") as caught:
        identify(changed(recording, F=F))
    assert caught.value.keys == ("tau_y",)


@pytest.mark.parametrize(
    "name, key",
    [("fixed-corotated", "mu"), ("von-mises", "tau_y"), ("gent", "J_m"), ("mu-i", "I_0")],
)
def test_a_known_value_is_kept_and_the_rest_found(name, key):
    recording, truth = oracle("steps", name)
    answer = identify(recording, known={key: truth[key]})
    assert answer.material.parameters()[key].std is None
    assert max(errors(answer, truth).values()) < EXACT


def test_a_known_column_moves_to_the_right_hand_side():
    recording, truth = oracle("steps", "fixed-corotated")
    wrong = identify(recording, observe="full", known={"mu": 0.5 * truth["mu"]})
    assert wrong.material.values["mu"] == 0.5 * truth["mu"]
    assert abs(wrong.material.values["lam"] / truth["lam"] - 1.0) > 1e-3
    assert wrong.residual > 1.0  # Pa, against 1e-9 for the truth


def test_a_bulk_modulus_is_found_where_the_motion_tells_it():
    recording, truth = oracle("steps", "newtonian")
    answer = identify(replace(recording, known={}))
    truth = truth | {"kappa": recording.known["kappa"]}
    assert set(answer.material.keys) == set(truth)
    assert max(errors(answer, truth).values()) < EXACT


def test_the_rate_below_which_a_mud_flows_like_a_fluid_is_found():
    recording, truth = oracle("steps", "bingham")
    answer = identify(replace(recording, known={}))
    truth = truth | {k: recording.known[k] for k in ("kappa", "epsilon")}
    assert set(answer.material.keys) == set(truth)
    assert max(errors(answer, truth).values()) < 1e-3


def test_missing_given_constants_are_named():
    recording, _ = oracle("steps", "mu-i")
    with pytest.raises(ValueError, match=r"mu-i needs given values for .*grain_density.*--known"):
        identify(replace(recording, known={}))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"law": "rubber"}, "unknown law 'rubber': choose one of neo-hookean"),
        ({"stride": 2}, "--stride applies to positions only"),
        ({"start": {"mu": 1.0}}, "--start applies to positions only"),
        ({"add_noise": 1e-3}, "--add-noise applies to positions only"),
        ({"known": {"tau_y": 1.0}}, "fixed-corotated has no parameter 'tau_y'"),
        ({"known": {"E": 1e4}}, "E alone is given"),
        ({"known": {"mu": float("nan")}}, "mu: a finite number"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, message):
    recording, _ = oracle("steps", "fixed-corotated")
    with pytest.raises(ValueError, match=message):
        identify(recording, **options)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"stride": 0}, "stride: a whole number from 1"),
        ({"stride": 101}, "stride 101 leaves fewer than two of 101 frames"),
        ({"add_noise": -1e-3}, "noise: must .*not be negative"),
        ({"position_noise": -1e-3}, "noise: must .*not (be )?negative"),
        ({"start": {"mu": 1e3}}, "--start lacks lam"),
        ({"start": {"mu": 1e3, "lam": -1.0}}, "--start: lam must be positive"),
        ({"observe": "full"}, "no two consecutive solver states|no stresses"),
        ({"law": "bingham"}, "bingham needs given values for kappa"),
        ({"weak": WeakOptions(estimator="ols")}, "--estimator applies to the weak form"),
        (
            {"weak": [WeakOptions(seed=3, free=(0,), window=0.1)]},
            "--window, --traction-free applies to the weak form",
        ),
    ],
)
def test_options_that_do_not_fit_positions_are_refused(options, message):
    recording, _ = oracle("positions", "fixed-corotated")
    with pytest.raises(ValueError, match=message):
        identify(recording, **options)


def test_a_recording_must_state_what_is_needed():
    recording, _ = oracle("steps", "fixed-corotated")
    with pytest.raises(ValueError, match="declares no law: choose --law from neo-hookean"):
        identify(replace(recording, law=None))
    for name in ("solver", "volume", "density"):
        with pytest.raises(ValueError, match=f"the recording states no {name}"):
            identify(replace(recording, **{name: None}))
    with pytest.raises(ValueError, match="no stresses"):
        identify(changed(recording, tau=None), observe="full")
    plastic, _ = oracle("steps", "von-mises")
    with pytest.raises(ValueError, match="states no fixed solver step"):
        solver = replace(plastic.solver, dt=None)
        identify(replace(plastic, solver=solver), observe="full")
    blank = np.full_like(recording.states.tau, np.nan)
    with pytest.raises(ValueError, match="no stresses"):
        identify(changed(recording, tau=blank), observe="full")
    positions, _ = oracle("positions", "fixed-corotated")
    with pytest.raises(ValueError, match="no initial velocities"):
        identify(replace(positions, v_0=None), initial_velocity="known")


@pytest.mark.parametrize("motion", ["known", "rigid"])
def test_positions_give_both_moduli_from_a_start_without_truth(motion):
    recording, truth = oracle("positions", "fixed-corotated")
    answer = identify(recording, initial_velocity=motion)
    spread = answer.material.parameters()
    for key, error in errors(answer, truth).items():
        # the file's float32 rounding, 1.5e-8 m, is the noise: std 5e-9 and 2e-8
        assert error < 5.0 * spread[key].std / truth[key] < 2e-7
    assert answer.details["position_noise"] == pytest.approx(1.5e-8, rel=0.1)
    assert answer.details["initial_velocity"] == motion


def test_the_rigid_initial_motion_is_found():
    recording, _ = oracle("positions", "fixed-corotated")
    twist = identify(replace(recording, v_0=None)).details["initial_twist"]
    arm = recording.reference - recording.reference.mean(axis=0)
    value = np.array(twist["value"])
    found = value[:3] + np.cross(value[3:], arm)
    assert np.abs(found - recording.v_0).max() < 10.0 * max(twist["std"])


def test_stride_uses_fewer_frames():
    recording, truth = oracle("positions", "fixed-corotated")
    sparse = identify(recording, stride=10)
    assert sparse.rows == 11 * recording.points * 3
    for key, error in errors(sparse, truth).items():
        assert error < 5.0 * sparse.material.parameters()[key].std / truth[key]


def test_points_that_were_not_measured_are_left_out():
    recording, truth = oracle("positions", "fixed-corotated")
    valid = np.random.default_rng(0).random(recording.p_WQ.shape[:2]) < 0.5
    p_WQ = np.where(valid[:, :, None], recording.p_WQ, np.nan)
    answer = identify(replace(recording, p_WQ=p_WQ, valid=valid))
    assert answer.rows == 3 * valid.sum()
    assert max(errors(answer, truth).values()) < 2e-7


NOISE, SEEDS = 1e-3, 8
START = {"mu": 2e3, "lam": 4e4}


@cache
def noisy(seed, **options):
    recording, _ = oracle("positions", "fixed-corotated")
    return identify(recording, add_noise=NOISE, seed=seed, start=START, **options)


def test_intervals_cover_the_truth_as_often_as_they_say():
    _, truth = oracle("positions", "fixed-corotated")
    scaled = []
    for seed in range(SEEDS):
        material = noisy(seed).material
        assert material.keys == ("mu", "lam")
        off = np.array([material.values[k] - truth[k] for k in material.keys])
        scaled.append(off @ np.linalg.solve(material.covariance, off))
    # the sum has the chi-square distribution with 16 degrees of freedom; ends at 0.1 % and 99.9 %
    assert 3.9 < sum(scaled) < 39.3


def test_the_noise_is_estimated_and_the_degradation_is_said():
    levels = [noisy(seed).details["position_noise"] for seed in range(SEEDS)]
    # 8 x 14544 residuals: relative standard deviation of their mean 0.002
    assert np.mean(levels) == pytest.approx(NOISE, rel=0.01)
    assert noisy(0).details["added_noise"] == NOISE
    assert "NOISE ADDED: 0.001 m" in str(noisy(0))
    assert noisy(0).material.values != noisy(1).material.values


def test_stated_noise_scales_the_error_bars():
    # stated and added noise are independent: variances 1 + 1 and 4 + 1
    single = noisy(0, position_noise=NOISE).material.covariance
    assert np.allclose(noisy(0, position_noise=2 * NOISE).material.covariance, 2.5 * single)


def test_the_same_seed_gives_the_same_answer():
    recording, _ = oracle("positions", "fixed-corotated")
    again = identify(recording, add_noise=NOISE, seed=3, start=START)
    assert again.material.values == noisy(3).material.values


def test_a_noisy_first_frame_is_no_rest_shape():
    recording, _ = oracle("positions", "fixed-corotated")
    noise = np.random.default_rng(0).normal(0.0, 1e-4, recording.p_WQ.shape)
    bare = replace(recording, p_WQ=recording.p_WQ + noise, p_reference=None)
    with pytest.raises(ValueError, match=r"noise of 0\.0001 m.*p_reference"):
        identify(replace(bare, noise=1e-4))
    with pytest.raises(ValueError, match=r"no rollout comes nearer than .* m.*p_reference"):
        identify(bare, start=START)


def test_the_first_frame_must_lie_at_the_rest_shape():
    recording, _ = oracle("positions", "fixed-corotated")
    moved = replace(recording, p_reference=recording.p_reference + np.array([0.0, 0.05, 0.0]))
    with pytest.raises(ValueError, match=r"first frame lies 0\.05 m from p_reference"):
        identify(moved)


@pytest.mark.parametrize("start", [{"mu": 1e-6, "lam": 1e8}, {"mu": 1e6, "lam": 1e-6}])
def test_a_start_that_leads_nowhere_is_refused(start):
    recording, _ = oracle("positions", "fixed-corotated")
    with pytest.raises(ValueError, match=r"--start|does not determine"):
        identify(recording, start=start)


def test_an_answer_worse_than_a_scanned_guess_is_refused():
    recording, _ = oracle("positions", "fixed-corotated")
    right = identify(recording, start=START)
    rollouts = Rollouts(recording, LAWS["fixed-corotated"], {})
    refuse_local_minimum(rollouts, right, None)
    wrong = replace(right, material=right.material.changed({"mu": 10.0, "lam": 2e6}))
    with pytest.raises(ValueError, match=r"scanned guess is .* leave out --start"):
        refuse_local_minimum(rollouts, wrong, None)
    rollouts.close()


def test_gravity_comes_from_the_solver():
    recording, truth = oracle("positions", "fixed-corotated")
    answer = identify(replace(recording, gravity=None, v_0=None), start=START)
    assert max(errors(answer, truth).values()) < 2e-7


def test_nothing_is_left_to_identify():
    for folder in ("steps", "positions"):
        recording, truth = oracle(folder, "fixed-corotated")
        with pytest.raises(ValueError, match="nothing is left to identify"):
            identify(recording, known=truth)


def test_a_declared_value_that_the_law_does_not_hold_is_refused():
    recording, _ = oracle("steps", "fixed-corotated")
    with pytest.raises(ValueError, match="declares nu as known, which fixed-corotated"):
        identify(replace(recording, known={"nu": 0.4}))


def test_the_exact_gradient_needs_velocity_gradients():
    recording, _ = oracle("steps", "von-mises")
    with pytest.raises(ValueError, match="no velocity gradients L"):
        identify(changed(recording, L=None))


def test_a_law_that_does_not_fit_is_called_so():
    recording, _ = oracle("steps", "fixed-corotated")
    answer = identify(replace(recording, known={}), "mooney-rivlin")
    assert answer.misfit > 1e6
    assert "DOES NOT FIT" in str(answer)


def test_an_unmeasured_start_is_named():
    recording, _ = oracle("positions", "fixed-corotated")
    valid = np.ones(recording.p_WQ.shape[:2], dtype=bool)
    valid[:3] = False
    with pytest.raises(ValueError, match="no point is valid in the first frames"):
        identify(replace(recording, valid=valid), start=START)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"gravity": np.array([0.0, 0.0, -9.0])}, "gravity .* differ"),
        ({"time": np.arange(101) * 0.01}, "frame .* is stamped"),
        ({"law": "rubber"}, "unknown law 'rubber'"),
    ],
)
def test_facts_stated_twice_must_agree(change, message):
    recording, _ = oracle("positions", "fixed-corotated")
    with pytest.raises(ValueError, match=message):
        replace(recording, **change)


def test_a_body_that_gives_way_is_not_predicted():
    recording, _ = oracle("positions", "fixed-corotated")
    soft = Material(LAWS["fixed-corotated"], {"mu": 3.0, "lam": -3.0}, 1000.0)
    with pytest.raises(ValueError, match="bulk modulus -1 Pa: must be positive, change mu, lam"):
        predict(recording, soft)
