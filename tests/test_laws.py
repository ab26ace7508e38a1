"""Laws against independent statements: potentials, objectivity, yield surfaces, oracle steps.

The stresses are compared with derivatives of potentials that are written down here in numpy, the
steps with states that ``oracles/step_mpm.py``, which shares no code with the package, has stored.
"""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.identify.columns import Columns
from form_drake.laws import LAWS, Constant, Term
from form_drake.laws.elastic import first_invariant
from form_drake.mpm.simulation import Body, Simulation
from form_drake.records.solver import GRADIENTS
from helpers.laws import (
    EYE,
    FIELDS,
    derivative,
    det,
    ended,
    gradients_of,
    invariants,
    oracle_solver,
    relative,
    rotations,
    stored,
    stored_state,
    volumetric,
)

PLASTIC = [name for name in LAWS if LAWS[name].flow == "plastic"]
NEED_DECOMPOSITION = [name for name in LAWS if LAWS[name].needs & {"rotation", "strain"}]
ROUND_OFF = 1e-11  # thousands of float64 roundings, relative to the largest entry


def simulation(name, **changes):
    data, values = stored(name)
    body = Body(data["x0"], data["volume"], float(data["density"]))
    made = Simulation(oracle_solver(name, **changes), LAWS[name], body)
    made.set_material(values)
    return made


@pytest.mark.parametrize("name", LAWS)
def test_one_step_reproduces_the_oracle(name):
    sim = simulation(name)
    for i in (0, 2):
        sim.restore(stored_state(name, i))
        sim.step()
        new, expected = sim.state(), stored_state(name, i + 1)
        for key in FIELDS:
            error = relative(getattr(new, key), getattr(expected, key))
            assert error < ROUND_OFF, f"{key} after step {stored(name)[0]['step'][i]}: {error:.1e}"


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("name", LAWS)
def test_rows_carry_the_force_that_the_solver_scatters(name, gradient):
    data, values = stored(name)
    sim = simulation(name, gradient=gradient, walls=(), mass_eps=0.0)
    state = replace(stored_state(name, 0), tau=np.zeros_like(data["tau"][0]))
    sim.reset(state.x, state.v, C=state.C, L=state.L, F=state.F)
    stressed, momenta = sim.state(), []
    for tau in (stressed.tau, np.zeros_like(stressed.tau)):
        sim.restore(replace(stressed, tau=tau))
        sim.step()
        velocity_and_mass = sim.grid.values.numpy()
        momenta.append(velocity_and_mass[:, :3] * velocity_and_mass[:, 3:])
    scattered = (momenta[0] - momenta[1]) / sim.solver.dt
    mass = float(data["density"]) * data["volume"]
    columns = Columns(sim.solver, LAWS[name], mass, data["volume"])
    terms = columns.forces(stressed.x, stressed.F, stressed.L, values)
    summed = np.tensordot(LAWS[name].theta(values), terms, 1)
    # the difference of momenta loses the digits by which they exceed dt times the force
    digits = np.max(np.abs(momenta[1])) / (sim.solver.dt * np.max(np.abs(summed)))
    assert relative(scattered, summed) < 1e-13 * max(digits, 1.0)
    assert np.max(np.abs(summed.sum(0))) < 1e-12 * np.abs(summed).sum()


def logarithmic(F, p):
    e = np.log(np.linalg.svd(F, compute_uv=False))
    return p["mu"] * (e**2).sum(1) + p["lam"] / 2 * e.sum(1) ** 2


def corotated(F, p):
    s = np.linalg.svd(F, compute_uv=False)
    return p["mu"] * ((s - 1) ** 2).sum(1) + volumetric(F, p["lam"])


def yeoh(F, p):
    x = invariants(F)[0] - 3
    return p["C1"] * x + p["C2"] * x**2 + p["C3"] * x**3 + volumetric(F, p["kappa"])


def mooney(F, p):
    first, second = invariants(F)
    return p["C10"] * (first - 3) + p["C01"] * (second - 3) + volumetric(F, p["kappa"])


def gent(F, p):
    room = 1 - (invariants(F)[0] - 3) / p["J_m"]
    return -p["mu"] * p["J_m"] / 2 * np.log(room) + volumetric(F, p["kappa"])


ENERGY = {
    "neo-hookean": lambda F, p: p["C10"] * (invariants(F)[0] - 3) + volumetric(F, p["kappa"]),
    "mooney-rivlin": mooney,
    "yeoh": yeoh,
    "gent": gent,
    "fixed-corotated": corotated,
    "von-mises": logarithmic,
    "drucker-prager": logarithmic,
    "newtonian": lambda F, p: volumetric(F, p["kappa"]),
    "bingham": lambda F, p: volumetric(F, p["kappa"]),
    "weakly-compressible": lambda F, p: volumetric(F, p["lam"]),
    "mu-i": lambda F, p: p["kappa"] / 2 * np.minimum(np.log(det(F)), 0) ** 2,
}


def squared_rate(L):
    D = (L + L.transpose(0, 2, 1)) / 2
    d = D - np.trace(D, axis1=1, axis2=2)[:, None, None] / 3 * EYE
    return 2 * (d**2).sum((1, 2))


def bingham(F, L, p):
    squared = squared_rate(L)
    rate = np.sqrt(squared + p["epsilon"] ** 2)
    return det(F) * (p["eta"] / 2 * squared + p["tau_y"] * rate)


def frictional(F, L, p):
    J = det(F)
    pressure = -p["kappa"] * np.log(J) / J
    rate = np.sqrt(squared_rate(L) + p["epsilon"] ** 2)
    per_rate = p["grain_diameter"] * np.sqrt(p["grain_density"] / pressure)  # I / rate
    grown = rate - p["I_0"] / per_rate * np.log(per_rate * rate + p["I_0"])
    return J * pressure * (p["mu_s"] * rate + p["delta_mu"] * grown)


DISSIPATION = {
    "newtonian": lambda F, L, p: det(F) * p["eta"] / 2 * squared_rate(L),
    "bingham": bingham,
    "mu-i": frictional,
}


def expected_stress(name, F, L, p):
    """tau = dW/dF F^T + d(dissipation)/dL."""
    tau = derivative(lambda G: ENERGY[name](G, p), F, 1e-5) @ F.transpose(0, 2, 1)
    if name in DISSIPATION:
        tau = tau + derivative(lambda M: DISSIPATION[name](F, M, p), L, 1e-4)
    return tau


def updated(name, F, L, *, flows, decomposition="series", precision="float64"):
    """F and Kirchhoff stress after the kernel that ends a step, with the stored parameters."""
    settings = {"decomposition": decomposition, "precision": precision}
    return ended(LAWS[name], stored(name)[1], F, L, flows=flows, **settings)


@pytest.mark.parametrize("name", LAWS)
def test_stress_is_the_derivative_of_the_potential(name):
    F, L = gradients_of(name)
    _, tau = updated(name, F, L, flows=False)
    # central differences: h^2 of truncation and 1e-16 / h of round-off, both about 1e-10
    assert relative(tau, expected_stress(name, F, L, stored(name)[1])) < 1e-8


@pytest.mark.parametrize("name", LAWS)
def test_moduli_at_rest(name):
    values, h = stored(name)[1], 1e-6
    K, G = LAWS[name].moduli(values)
    shear = EYE + h * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]])
    F = np.stack([EYE * (1 - h), shear])
    _, tau = updated(name, F, np.zeros_like(F), flows=False)
    # the first correction to the linear law is of the order of the strain
    assert -np.trace(tau[0]) / 3 == pytest.approx(3 * K * h, rel=1e-4)
    assert tau[1][0, 1] == pytest.approx(2 * G * h, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_objectivity(name):
    F, L = gradients_of(name)
    Q = rotations(np.random.default_rng(5), len(F))
    Qt = Q.transpose(0, 2, 1)
    _, tau = updated(name, F, L, flows=False)
    _, turned = updated(name, Q @ F, Q @ L @ Qt, flows=False)
    assert relative(turned, Q @ tau @ Qt) < ROUND_OFF
    assert relative(tau, tau.transpose(0, 2, 1)) < ROUND_OFF


@pytest.mark.parametrize("name", NEED_DECOMPOSITION)
def test_series_agrees_with_singular_values(name):
    F, L = gradients_of(name)
    for flows in (False, True):
        series = updated(name, F, L, flows=flows)
        svd3 = updated(name, F, L, flows=flows, decomposition="svd3")
        for a, b in zip(series, svd3, strict=True):
            assert relative(a, b) < 1e-9  # what Warp's iterative svd3 leaves


@pytest.mark.parametrize("name", NEED_DECOMPOSITION)
def test_extreme_stretches(name):
    rng = np.random.default_rng(8)
    stretch = np.exp(rng.uniform(-2.5, 2.5, (200, 3)))  # 0.08 to 12
    F = rotations(rng, 200) * stretch[:, None, :] @ rotations(rng, 200)
    tau = updated(name, F, np.zeros_like(F), flows=False)[1]
    expected = oracle_stress(name, F)
    size = np.max(np.abs(expected), axis=(1, 2))
    # b = F F^T is conditioned by the square of the ratio of stretches, here up to (12 / 0.08)^2
    assert np.max(np.max(np.abs(tau - expected), axis=(1, 2)) / size) < 1e-9


def oracle_stress(name, F):
    """Stress in principal axes by numpy's singular values."""
    p = stored(name)[1]
    U, s, _ = np.linalg.svd(F)
    if name == "fixed-corotated":
        principal = 2 * p["mu"] * (s - 1) * s + p["lam"] * (s.prod(1) * (s.prod(1) - 1))[:, None]
    else:
        e = np.log(s)
        principal = 2 * p["mu"] * e + p["lam"] * e.sum(1, keepdims=True)
    return U * principal[:, None, :] @ U.transpose(0, 2, 1)


def deviator_size(a):
    d = a - np.trace(a, axis1=1, axis2=2)[:, None, None] / 3 * EYE
    return np.sqrt((d**2).sum((1, 2)))


def allowed_size(name, tau):
    p = stored(name)[1]
    if name == "von-mises":
        return np.full(len(tau), p["tau_y"])
    return -p["alpha"] * np.trace(tau, axis1=1, axis2=2)


@pytest.mark.parametrize("name", PLASTIC)
def test_return_map(name):
    F, L = gradients_of(name, 400)
    _, trial = updated(name, F, L, flows=False)
    new, tau = updated(name, F, L, flows=True)
    pressed = np.trace(trial, axis1=1, axis2=2) < 0 if name == "drucker-prager" else det(F) > 0
    beyond = pressed & (deviator_size(trial) > allowed_size(name, trial))
    inside = pressed & ~beyond
    assert beyond.sum() > 50 and inside.sum() > 5
    scale = np.max(np.abs(trial))
    assert np.array_equal(new[inside], F[inside])
    on = deviator_size(tau)[beyond] - allowed_size(name, tau)[beyond]
    assert np.max(np.abs(on)) < ROUND_OFF * scale
    assert det(new[pressed]) == pytest.approx(det(F[pressed]), rel=ROUND_OFF)
    again, tau_again = updated(name, new, L, flows=True)
    assert relative(again, new) < ROUND_OFF and relative(tau_again, tau) < ROUND_OFF
    # radial: the returned deviator is parallel to that of the trial state
    d, d0 = (t - np.trace(t, axis1=1, axis2=2)[:, None, None] / 3 * EYE for t in (tau, trial))
    cosine = (d * d0).sum((1, 2))[beyond] / (deviator_size(d) * deviator_size(d0))[beyond]
    assert cosine == pytest.approx(1.0, abs=1e-9)


def test_cone_apex():
    rng = np.random.default_rng(4)
    stretch = np.exp(np.abs(rng.uniform(0.001, 0.3, (100, 3))))
    U, Vt = rotations(rng, 100), rotations(rng, 100)
    F = U * stretch[:, None, :] @ Vt
    new, tau = updated("drucker-prager", F, np.zeros_like(F), flows=True)
    assert relative(new, U @ Vt) < ROUND_OFF
    # round-off in the strain times the moduli
    assert np.max(np.abs(tau)) < 1e-12 * stored("drucker-prager")[1]["mu"]


def test_fluids_keep_only_their_volume():
    F, L = gradients_of("newtonian")
    for name in ("newtonian", "bingham", "weakly-compressible", "mu-i"):
        new, _ = updated(name, F, L, flows=True)
        J = np.minimum(det(F), 1.0) if name == "mu-i" else det(F)
        assert relative(new, np.cbrt(J)[:, None, None] * EYE) < ROUND_OFF


def test_rotation_of_inverted_element_is_proper():
    rng = np.random.default_rng(6)
    U, V = rotations(rng, 50), rotations(rng, 50)
    s = np.array([1.2, 0.9, -0.3])
    F = U * s @ V
    _, tau = updated("fixed-corotated", F, np.zeros_like(F), flows=False)
    p = stored("fixed-corotated")[1]
    J = s.prod()
    principal = 2 * p["mu"] * (s - 1) * s + p["lam"] * J * (J - 1)
    assert relative(tau, U * principal @ U.transpose(0, 2, 1)) < 1e-9


@pytest.mark.parametrize("name", ["von-mises"])
def test_float32_series(name):
    F, L = gradients_of(name)
    _, tau = updated(name, F, L, flows=False, precision="float32")
    expected = expected_stress(name, F, L, stored(name)[1])
    assert relative(tau, expected) < 3e-6  # some tens of float32 roundings of 6e-8


@pytest.mark.parametrize("name", LAWS)
def test_every_parameter_says_what_excites_it(name):
    defaults = {Term("a", "Pa", first_invariant).excited, Constant("a", "-", "shape").excited}
    for p in LAWS[name].parameters:
        assert p.excited not in defaults
        assert 0 < len(p.excited) < 60 and p.excited[0].islower() and p.excited[-1] != "."
        told = isinstance(p, Constant) and p.role == "given"
        assert (p.excited == "state its value") == (told or (name, p.key) == ("mu-i", "kappa"))
