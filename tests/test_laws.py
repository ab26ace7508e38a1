"""Laws against independent statements: potentials, objectivity, yield surfaces, oracle steps.

The stresses are compared with derivatives of potentials that are written down here in numpy, the
steps with states that ``oracles/step_mpm.py``, which shares no code with the package, has stored.
"""

import json
from dataclasses import replace
from functools import cache, reduce
from itertools import permutations, product
from operator import add
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from form_drake.commands.inspect import List
from form_drake.identify.columns import Columns
from form_drake.laws import KAPPA, LAWS, Constant, Term, law_named, load
from form_drake.laws.elastic import GENT, MOONEY_RIVLIN, YEOH, first_invariant, linear_volume
from form_drake.laws.flow import BINGHAM, granular_pressure, viscous
from form_drake.laws.kernels import types, update
from form_drake.laws.values import checked_values
from form_drake.material import Material, derived, read_material
from form_drake.mpm.simulation import Body, Simulation, State
from form_drake.records.solver import GRADIENTS, Solver, Wall

STEPS = Path(__file__).parent / "data" / "steps"
EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "gent_thomas.py"
TRUTH = json.loads((STEPS / "truth.json").read_text())
EYE = np.eye(3)
FIELDS = ("x", "v", "C", "L", "F", "tau")
PLASTIC = [name for name in LAWS if LAWS[name].flow == "plastic"]
NEED_DECOMPOSITION = [name for name in LAWS if LAWS[name].needs & {"rotation", "strain"}]
ROUND_OFF = 1e-11  # thousands of float64 roundings, relative to the largest entry


def relative(a, b):
    """Largest difference, relative to the largest entry of b."""
    return np.max(np.abs(a - b)) / np.max(np.abs(b))


@cache
def stored(name):
    """The oracle's arrays and parameters of a law."""
    with np.load(STEPS / f"{name}.npz") as file:
        data = dict(file)
    given = {key[6:]: float(value) for key, value in data.items() if key.startswith("given_")}
    return data, TRUTH[name] | given


def oracle_solver(name, **changes):
    data, _ = stored(name)
    nodes, dx, cells = int(data["nodes"]), float(data["dx"]), int(data["wall_cells"])
    low, high = (cells - 1) * dx, (nodes - cells + 1) * dx
    settings = {
        "dx": dx,
        "nodes": (nodes,) * 3,
        "dt": float(data["dt"]),
        "gradient": str(data["gradient"]),
        "precision": "float64",
        "walls": tuple(
            Wall(axis, side, at) for axis in range(3) for side, at in ((-1, low), (1, high))
        ),
        "mass_eps": float(data["mass_eps"]),
        "gravity": tuple(data["gravity"]),
    }
    return Solver(**settings | changes)


def simulation(name, **changes):
    data, values = stored(name)
    body = Body(data["x0"], data["volume"], float(data["density"]))
    made = Simulation(oracle_solver(name, **changes), LAWS[name], body)
    made.set_material(values)
    return made


def stored_state(name, i):
    data, _ = stored(name)
    return State(**{key: data[key][i] for key in FIELDS})


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


def det(F):
    return np.linalg.det(F)


def invariants(F):
    b = np.einsum("nij,nkj->nik", F, F) * (det(F) ** (-2 / 3))[:, None, None]
    first = np.trace(b, axis1=1, axis2=2)
    return first, (first**2 - np.einsum("nij,nji->n", b, b)) / 2


def volumetric(F, modulus):
    return modulus / 2 * (det(F) - 1) ** 2


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


def derivative(potential, at, h):
    """Central differences of a scalar per point with respect to its 3x3 argument."""
    out = np.empty_like(at)
    for i in range(3):
        for j in range(3):
            step = np.zeros((3, 3))
            step[i, j] = h
            out[:, i, j] = (potential(at + step) - potential(at - step)) / (2 * h)
    return out


def expected_stress(name, F, L, p):
    """tau = dW/dF F^T + d(dissipation)/dL."""
    tau = derivative(lambda G: ENERGY[name](G, p), F, 1e-5) @ F.transpose(0, 2, 1)
    if name in DISSIPATION:
        tau = tau + derivative(lambda M: DISSIPATION[name](F, M, p), L, 1e-4)
    return tau


def rotations(rng, n):
    q = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    return q * np.linalg.det(q)[:, None, None]


def gradients_of(name, n=200, seed=3):
    """Rotated deformation gradients with stretches of 0.7 to 1.4, and velocity gradients [1/s]."""
    rng = np.random.default_rng(seed)
    stretch = np.exp(rng.uniform(-0.35, 0.35, (n, 3)))
    if name == "mu-i":
        stretch = np.exp(-rng.uniform(0.01, 0.1, (n, 3)))
    F = rotations(rng, n) * stretch[:, None, :] @ rotations(rng, n)
    return F, rng.normal(scale=3.0, size=(n, 3, 3))


def updated(name, F, L, *, flows, decomposition="series", precision="float64"):
    """F and Kirchhoff stress after the kernel that ends a step, with the stored parameters."""
    settings = {"decomposition": decomposition, "precision": precision}
    return ended(LAWS[name], stored(name)[1], F, L, flows=flows, **settings)


def ended(law, values, F, L, *, flows=False, decomposition="series", precision="float64"):
    """F and Kirchhoff stress after the kernel that ends a step, for any law and parameters."""
    t, kernel = types(precision), update(law, decomposition, precision)
    F_ = wp.array(F, dtype=t.mat, device="cpu")
    tau = wp.zeros(len(F), dtype=t.mat, device="cpu")
    constants = np.stack([law.shape_vector(values), law.radius_vector(values)])
    inputs = [
        wp.array([int(flows)], dtype=int, device="cpu"),
        F_,
        wp.array(L, dtype=t.mat, device="cpu"),
        wp.array(law.theta(values), dtype=t.real, device="cpu"),
        wp.array(constants, dtype=t.vec4, device="cpu"),
        tau,
    ]
    wp.launch(kernel, dim=len(F), inputs=inputs, device="cpu")
    return F_.numpy().astype(float), tau.numpy().astype(float)


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


ADDABLE = [
    (a, b)
    for a, b in permutations(LAWS, 2)
    if LAWS[a].flow == LAWS[b].flow and LAWS[a].flow in ("elastic", "fluid")
]
SHARED = {first_invariant, linear_volume, viscous}  # responses that more than one law declares


def single_values(law, seed=0):
    """Positive values of the size that keeps Gent's stress finite."""
    rng = np.random.default_rng([seed, *law.name.encode()])
    return {k: rng.uniform(0.5, 2.0) + 20.0 * k.endswith("J_m") for k in law.keys}


def values_of_sum(laws, each):
    """Values of the sum at given values of its summands; where terms coincide they add up."""
    values, columns = {}, {}
    for law, own in zip(laws, each, strict=True):
        taken = set(values)
        for p in law.parameters:
            response = getattr(p, "response", None)
            if response in columns:
                values[columns[response]] += own[p.key]
                continue
            key = f"{law.name}.{p.key}" if p.key in taken else p.key
            values[key] = own[p.key]
            if response in SHARED:
                columns[response] = key
    return values


def assert_sum(laws):
    law, each = reduce(add, laws), [single_values(one) for one in laws]
    values = values_of_sum(laws, each)
    assert law.keys == tuple(values)
    F, L = gradients_of(law.name)
    tau = ended(law, values, F, L)[1]
    summed = sum(ended(one, own, F, L)[1] for one, own in zip(laws, each, strict=True))
    assert relative(tau, summed) < 1e-12
    moduli = [one.moduli(own) for one, own in zip(laws, each, strict=True)]
    assert law.moduli(values) == pytest.approx(np.sum(moduli, axis=0), rel=1e-14)


@pytest.mark.parametrize("names", ADDABLE, ids="+".join)
def test_the_stress_of_a_sum_is_the_sum_of_stresses(names):
    assert_sum([LAWS[name] for name in names])


def test_three_laws_are_added_in_any_order_of_brackets():
    laws = [YEOH, GENT, MOONEY_RIVLIN]
    assert_sum(laws)
    law = law_named("yeoh+gent+mooney-rivlin")
    assert law is (YEOH + GENT) + MOONEY_RIVLIN is YEOH + (GENT + MOONEY_RIVLIN)
    assert law is law_named(" yeoh + gent + mooney-rivlin ") and law.summands == tuple(laws)
    assert law.wave_speed(values_of_sum(laws, map(single_values, laws)), 1000.0) > 0


@pytest.mark.parametrize(
    "name, keys, sought",
    [
        ("yeoh+gent", "C1 C2 C3 kappa mu J_m", "C1 C2 C3 kappa mu J_m"),
        ("neo-hookean+yeoh", "C10 kappa C2 C3", "C10 kappa C2 C3"),
        ("yeoh+neo-hookean", "C1 C2 C3 kappa", "C1 C2 C3 kappa"),
        ("fixed-corotated+gent", "mu lam gent.mu J_m", "mu lam gent.mu J_m"),
        ("newtonian+bingham", "eta kappa tau_y epsilon", "eta tau_y epsilon"),
        ("newtonian+weakly-compressible", "eta kappa", "eta kappa"),
    ],
)
def test_names_in_a_sum(name, keys, sought):
    law = law_named(name)
    assert " ".join(law.keys) == keys and " ".join(law.sought) == sought
    assert all(law.parameter(k).excited for k in law.keys)


def test_a_merged_parameter_is_signed_if_one_is():
    assert law_named("yeoh+fixed-corotated").parameter("kappa").signed
    assert law_named("fixed-corotated+yeoh").parameter("lam").signed
    assert not law_named("yeoh+gent").parameter("kappa").signed


def test_the_equation_of_a_sum_counts_nothing_twice():
    law = law_named("fixed-corotated+gent")
    shear = "gent.mu / (1 - (I1 - 3) / J_m) dev b"
    assert law.equation == f"2 mu (F - R) F^T + lam J (J - 1) I + {shear}"
    assert law_named("neo-hookean+mooney-rivlin").equation.endswith(
        " + 2 dev[0 b + C01 (I1 b - b b)]"
    )


@pytest.mark.parametrize("law", [GENT, BINGHAM], ids=lambda law: law.name)
def test_every_summand_reads_its_own_constants(law):
    laws = [law] + [replace(law, name=f"{law.name}-{n}") for n in (2, 3, 4)]
    assert_sum(laws)
    with pytest.raises(ValueError, match=r"has 5 constants .*: a law or a sum of laws may have 4"):
        reduce(add, [*laws, replace(law, name="fifth")])


@pytest.mark.parametrize("names", sorted(set(product(LAWS, LAWS)) - set(ADDABLE)), ids="+".join)
def test_impossible_sums_are_refused(names):
    first, second = names
    reason = "added to itself" if first == second else "only elastic laws may be added"
    with pytest.raises(ValueError, match=reason) as caught:
        law_named("+".join(names))
    assert "\n" not in str(caught.value) and first in str(caught.value)


def test_other_sums_are_refused():
    with pytest.raises(ValueError, match="unknown law 'rubber': choose one of neo-hookean"):
        law_named("yeoh+rubber")
    with pytest.raises(ValueError, match="read no pressure"):
        BINGHAM + replace(LAWS["newtonian"], name="dry", pressure=granular_pressure)
    with pytest.raises(TypeError):
        YEOH + 1


def test_columns_of_a_sum_are_those_that_the_solver_obeys():
    laws = [YEOH, GENT, replace(GENT, name="second")]
    law, data = reduce(add, laws), stored("neo-hookean")[0]
    # a tenth of the stiffness for which the oracle's time step was chosen
    scaled = [{k: v * 1e3 for k, v in single_values(one).items()} for one in laws]
    values = values_of_sum(laws, scaled) | {"J_m": 20.0, "second.J_m": 5.0}
    solver = oracle_solver("neo-hookean")
    sim = Simulation(solver, law, Body(data["x0"], data["volume"], float(data["density"])))
    sim.set_material(values)
    start = stored_state("neo-hookean", 0)
    sim.reset(start.x, start.v, C=start.C, L=start.L, F=start.F)
    one = sim.state()
    sim.step()
    columns = Columns(solver, law, float(data["density"]) * data["volume"], data["volume"])
    A, b, free = columns.rows(one.x, one.v, one.C, one.L, one.F, sim.state().v, values)
    assert free.sum() > 100
    assert relative((A @ law.theta(values))[free], b[free]) < 1e-10


def test_material_of_a_sum(tmp_path):
    law = law_named("fixed-corotated+gent")
    values = {"mu": 1e4, "lam": 2e4, "gent.mu": 3e4, "J_m": 7.0}
    keys, covariance = ("mu", "gent.mu"), np.array([[4.0, 1.0], [1.0, 9.0]])
    Material(law, values, 900.0, keys, covariance).write(tmp_path / "m.yaml")
    assert "law: fixed-corotated+gent" in (tmp_path / "m.yaml").read_text()
    back = read_material(tmp_path / "m.yaml")
    assert back.law is law and back.values == values and back.keys == keys
    assert np.array_equal(back.covariance, covariance)
    shown = back.parameters()
    assert shown["gent.mu"].std == pytest.approx(3.0)
    assert shown["K"].value == pytest.approx(2e4 + 2e4 / 3)
    assert shown["E"].value == pytest.approx(9 * 8e4 / 3 * 4e4 / (8e4 + 4e4))
    assert back.changed({"gent.mu": "5e4"}).values["gent.mu"] == 5e4


def test_young_modulus_is_no_input_of_a_sum():
    known = {"E": 1e4, "nu": 0.3}
    assert set(checked_values(LAWS["fixed-corotated"], known)) == {"mu", "lam"}
    with pytest.raises(ValueError, match="has no parameter 'E'"):
        checked_values(law_named("fixed-corotated+gent"), known)
    assert checked_values(law_named("yeoh+gent"), {"kappa": "3"}) == {"kappa": 3.0}


@pytest.mark.parametrize("name", LAWS)
def test_every_parameter_says_what_excites_it(name):
    defaults = {Term("a", "Pa", first_invariant).excited, Constant("a", "-", "shape").excited}
    for p in LAWS[name].parameters:
        assert p.excited not in defaults
        assert 0 < len(p.excited) < 60 and p.excited[0].islower() and p.excited[-1] != "."
        told = isinstance(p, Constant) and p.role == "given"
        assert (p.excited == "state its value") == (told or (name, p.key) == ("mu-i", "kappa"))


def test_list_laws_says_that_they_may_be_added(capsys):
    List("laws").run()
    assert "yeoh+gent" in capsys.readouterr().err
    List("laws", json=True).run()
    assert capsys.readouterr().err == ""


def test_a_law_from_a_file():
    (law,) = load(EXAMPLE)
    assert law is law_named("gent-thomas") and len(EXAMPLE.read_text().splitlines()) <= 25
    values = {"C2": 3e4, "kappa": 2e5}
    F, L = gradients_of("gent-thomas")

    def energy(F):
        return values["C2"] * np.log(invariants(F)[1] / 3) + volumetric(F, values["kappa"])

    tau = derivative(energy, F, 1e-5) @ F.transpose(0, 2, 1)
    assert relative(ended(law, values, F, L)[1], tau) < 1e-8
    K, G = law.moduli(values)
    h = 1e-6
    small = EYE + h * np.array([np.eye(3), [[0, 1, 0], [0, 0, 0], [0, 0, 0]]])
    strained = ended(law, values, small, np.zeros_like(small))[1]
    assert np.trace(strained[0]) / 3 == pytest.approx(3 * K * h, rel=1e-4)
    assert strained[1][0, 1] == pytest.approx(G * h, rel=1e-4)


def test_a_law_from_a_file_can_be_added():
    (law,) = load(EXAMPLE)
    assert law_named("yeoh+gent-thomas").keys == ("C1", "C2", "C3", "kappa", "gent-thomas.C2")
    assert_sum([LAWS["neo-hookean"], law])
    (again,) = load(EXAMPLE)
    assert again is not law and law_named("gent-thomas") is again
    assert_sum([again, GENT])


HEAD = """from form_drake.laws import KAPPA, LAWS, Constant, Law, Term
def made(name="own", parameters=(KAPPA,), moduli=lambda v: (v["kappa"], 0.0), **more):
    return Law(name=name, parameters=parameters, moduli=moduli, equation="", **more)
"""
RESPONSE = """from typing import Any
import warp as wp
@wp.func
def own_response({}):
    return {}
law = made(parameters=(Term("A", "Pa", own_response), KAPPA))
"""
WRONG_FILES = {
    "syntax": ("law = (", r"own.py, line 4: '\(' was never closed"),
    "failing": ("1 / 0", "own.py, line 4: ZeroDivisionError: division by zero"),
    "inside": ("law = made(needs=frozenset({'speed'}))", "line 3: ValueError: own: needs may hold"),
    "no law": ("LAWS['yeoh'] + LAWS['gent']", "declares no law"),
    "only known laws": ("law = LAWS['yeoh']", "declares no law"),
    "taken": ("law = made('gent')", "law 'gent': the name is taken by a law of this package"),
    "twice": ("a, b = made(), made()", "two laws of this name"),
    "plus": ("law = made('my+law')", "lower-case words joined by hyphens"),
    "upper case": ("law = made('Own')", "lower-case words joined by hyphens"),
    "key": ("law = made(parameters=(KAPPA, Constant('a.b', '-', 'shape')))", "parameter 'a.b'"),
    "keys": ("law = made(parameters=(KAPPA, KAPPA))", "two parameters have one name"),
    "stressless": ("law = made(parameters=())", "it has no Term"),
    "function": ("law = made(parameters=(Term('a', 'Pa', made),))", "put @wp.func before it"),
    "flow": ("law = made(flow='gas')", "flow 'gas': choose elastic"),
    "plastic": ("law = made(flow='plastic')", "a plastic law needs radius"),
    "moduli": ("law = made(moduli=lambda v: (v['K'], 0.0))", "moduli fails .*: KeyError: 'K'"),
    "nan": ("law = made(moduli=lambda v: (float('nan'), 0.0))", "moduli gives nan and 0.0"),
    "viscosity": (
        "law = made(parameters=(KAPPA, LAWS['newtonian'].parameter('eta')))",
        "a law with a viscosity must state it",
    ),
    "binary": ("\0", "own.py"),
    "rotation": (
        RESPONSE.format("q: Any, s: Any", "q.R"),
        r"read q.R: state needs=frozenset\(\['rotation'",
    ),
    "strain": (
        RESPONSE.format("q: Any, s: Any", "q.e"),
        r"read q.e: state needs=frozenset\(\['strain'",
    ),
    "rate": (
        RESPONSE.format("q: Any, s: Any", "q.L"),
        r"read q.L: state needs=frozenset\(\['rate'",
    ),
    "pressure": (RESPONSE.format("q: Any, s: Any", "q.p * q.F"), "read q.p: state a pressure"),
    "scalar": (
        RESPONSE.format("q: Any, s: Any", "q.J"),
        "to a matrix of 3 by 3, cannot be built: .*types",
    ),
    "argument": (RESPONSE.format("q: Any", "q.F"), r"each from \(q, s\) to .*for 'own_response'"),
    "endless": (
        RESPONSE.format("q: Any, s: Any", "q.F / (q.J - type(q.J)(1.0))"),
        "not finite at rest",
    ),
}


@pytest.mark.parametrize("name", WRONG_FILES)
def test_wrong_files_of_laws_are_refused(tmp_path, name):
    text, message = WRONG_FILES[name]
    (tmp_path / "own.py").write_text(HEAD + text)
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path / "own.py")
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["own.py"]
    with pytest.raises(ValueError, match="unknown law"):
        law_named("own")


def test_names_of_own_laws(tmp_path):
    for file in ("a.py", "b.py"):
        (tmp_path / file).write_text(HEAD + "law = made('mine')")
    with pytest.raises(ValueError, match="No such file"):
        load(tmp_path / "c.py")
    with pytest.raises(ValueError, match="Is a directory"):
        load(tmp_path)
    load(tmp_path / "a.py")
    assert law_named("mine").keys == ("kappa",) and "mine" not in LAWS
    with pytest.raises(ValueError, match=r"'mine': the name is taken by .*a\.py"):
        load(tmp_path / "b.py")
    (tmp_path / "a.py").write_text(HEAD + "law = made('other')")
    load(tmp_path / "a.py")
    assert law_named("other")
    with pytest.raises(ValueError, match="unknown law 'mine'"):
        law_named("mine")


def test_a_law_that_reads_pressure_reads_it_in_a_sum(tmp_path):
    text = """import warp as wp
from typing import Any
@wp.func
def friction(q: Any, s: Any):
    return q.p * wp.identity(n=3, dtype=q.F.dtype)
@wp.func
def squeeze(J: Any):
    return wp.max(type(J)(1.0) - J, type(J)(0.0))
law = made("dusty", parameters=(Term("m", "-", friction, guess=(0.1,)), KAPPA), pressure=squeeze)
"""
    (tmp_path / "own.py").write_text(HEAD + text)
    (law,) = load(tmp_path / "own.py")
    values, F = {"m": 5.0, "kappa": 1e4}, np.diag([0.9, 0.9, 0.9])[None]
    L = np.zeros_like(F)
    alone = ended(law, values, F, L)[1]
    (J,) = np.linalg.det(F)
    assert alone[0] == pytest.approx((5e4 * (1 - J) - 1e4 * J * (1 - J)) * np.eye(3))
    total = ended(law_named("damping+dusty"), values | {"eta": 3.0}, F, L)[1]
    assert total == pytest.approx(alone)


def test_names_of_own_parameters_mean_nothing_to_the_package():
    shape = Constant("alpha", "-", "shape", guess=(2.0,))
    own = replace(GENT, name="own", parameters=(GENT.parameter("mu"), shape, KAPPA))
    values = {"mu": 1e3, "alpha": 2.0, "kappa": 1e5}
    assert checked_values(own, values) == values
    assert list(derived(own)) == ["E", "nu"]
    sand = law_named("drucker-prager+damping")
    assert {"E", "nu", "K", "friction_angle"} == set(derived(sand))
    with pytest.raises(ValueError, match="alpha: must be below sqrt"):
        checked_values(sand, {"alpha": 0.9})
