"""What is added to a law: stresses against potentials, yield beside them, energy that they take."""

import numpy as np
import pytest

from form_drake.identify import identify
from form_drake.laws import ADDITIONS, LAWS, law_named
from form_drake.material import Material, read_material
from form_drake.mpm.bodies import block
from form_drake.mpm.model import stable_dt
from form_drake.mpm.simulation import Simulation
from form_drake.records import Recording, Solver, States
from form_drake.weak.stress import elastic_part, unit_stresses

SOFT = {"mu": 20e3, "lam": 30e3}
SOLVER = Solver(dx=4e-3, nodes=(11,) * 3, dt=1e-4, precision="float64")
VALUES = {"azimuth": 0.7, "elevation": -0.4, "n": 0.6}


def fields(n=60):
    rng = np.random.default_rng(2)
    return np.eye(3) + 0.2 * rng.standard_normal((n, 3, 3)), rng.normal(scale=3.0, size=(n, 3, 3))


def gamma(L, epsilon):
    D = 0.5 * (L + L.swapaxes(-1, -2))
    d = D - np.trace(D, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)
    return np.sqrt(2.0 * np.sum(d**2, axis=(-1, -2)) + epsilon**2)


def direction():
    z, e = VALUES["azimuth"], VALUES["elevation"]
    return np.array([np.cos(e) * np.cos(z), np.cos(e) * np.sin(z), np.sin(e)])


def along(F):
    f = F @ direction()
    return 0.125 * (np.sum(f**2, axis=-1) - 1.0) ** 2


def stretched(F):
    b = np.einsum("...ij,...kj->...ik", F, F) * np.linalg.det(F)[..., None, None] ** (-2 / 3)
    return (np.trace(b, axis1=-2, axis2=-1) - 3.0) ** 2


# energies by F and dissipation potentials by L per unit of the coefficient
ENERGY = {"stiffening": stretched, "anisotropy": along}
DISSIPATION = {
    "damping": lambda L: 0.5 * gamma(L, 0.0) ** 2,
    "rate-dependence": lambda L: gamma(L, 1e-2) ** 1.6 / 1.6,
}


def slope(potential, at, h):
    found = np.empty_like(at)
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = h
        found[..., i, j] = (potential(at + step) - potential(at - step)) / (2.0 * h)
    return found


@pytest.mark.parametrize("name", ADDITIONS)
def test_an_addition_is_the_derivative_of_a_potential(name):
    F, L = fields()
    law = law_named(f"neo-hookean+{name}")
    T = unit_stresses(law, F, L, dict.fromkeys(law.keys, 1.0) | VALUES)[-1]
    if name in ENERGY:
        expected = slope(ENERGY[name], F, 1e-5) @ F.swapaxes(-1, -2)
    else:
        expected = np.linalg.det(F)[:, None, None] * slope(DISSIPATION[name], L, 1e-5)
    np.testing.assert_allclose(T, expected, atol=1e-7 * np.abs(T).max())
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    again = unit_stresses(law, turn @ F, turn @ L @ turn.T, dict.fromkeys(law.keys, 1.0) | VALUES)
    np.testing.assert_allclose(again[-1], turn @ T @ turn.T, atol=1e-11 * np.abs(T).max())


def test_additions_are_no_laws_and_fit_only_some():
    for name in ADDITIONS:
        with pytest.raises(ValueError, match="only adds to a law with stiffness"):
            law_named(name)
    for names in ("newtonian+damping", "von-mises+anisotropy", "von-mises+neo-hookean+damping"):
        with pytest.raises(ValueError, match="only elastic laws may be added to each other"):
            law_named(names)


def test_a_plastic_law_yields_as_without_what_is_added(tmp_path):
    both, plain = law_named("damping+von-mises"), LAWS["von-mises"]
    values = SOFT | {"tau_y": 1e3}
    assert both.flow == "plastic" and set(both.keys) == {"eta", "mu", "lam", "tau_y"}
    np.testing.assert_array_equal(
        both.radius_vector(values | {"eta": 5.0}), plain.radius_vector(values)
    )
    F = np.repeat(fields(20)[0][None], 3, axis=0)
    r = plain.radius_vector(values)
    np.testing.assert_array_equal(elastic_part(both, F, r), elastic_part(plain, F, r))
    made = Material(both, values | {"eta": 5.0}, 1000.0)
    assert made.parameters()["E"].value == Material(plain, values).parameters()["E"].value
    made.write(tmp_path / "made.yaml")
    assert read_material(tmp_path / "made.yaml").values == made.values
    text = (tmp_path / "made.yaml").read_text().replace("5.0", "7.0", 1)
    (tmp_path / "made.yaml").write_text(text)
    assert read_material(tmp_path / "made.yaml").values["eta"] == 7.0


def test_damping_bounds_the_step_and_a_fibre_the_speed_of_sound():
    base, damped = LAWS["fixed-corotated"], law_named("fixed-corotated+damping")
    plain = stable_dt(base, SOFT, 1000.0, 1e-3)
    assert stable_dt(damped, SOFT | {"eta": 1.0}, 1000.0, 1e-3) == plain
    assert stable_dt(damped, SOFT | {"eta": 1e3}, 1000.0, 1e-3) == 1000.0 * 1e-6 / 6e3
    fibres = law_named("fixed-corotated+anisotropy")
    values = SOFT | VALUES | {"k_f": 40e3}
    square = (fibres.wave_speed(values, 1000.0) ** 2 - base.wave_speed(SOFT, 1000.0) ** 2) * 1000.0
    h, a = 1e-6, direction()
    F = np.eye(3) + h * np.outer(a, a)
    T = unit_stresses(fibres, F[None], np.zeros((1, 3, 3)), values)[-1, 0]
    assert square == pytest.approx(40e3 * (a @ T @ a) / h, rel=1e-4)


def shaken(law, values, steps=240):
    """A free block that rings, and its recording of every step."""
    body = block((0.02, 0.02, 0.02), (0.016,) * 3, 2e-3, 1000.0)
    sim = Simulation(SOLVER, law, body)
    sim.set_material(values)
    F = np.tile(np.diag([1.1, 1.0, 0.92]), (len(body.x), 1, 1))
    middle = body.x.mean(axis=0)
    sim.reset(middle + (body.x - middle) @ F[0].T, np.zeros_like(body.x), F=F)
    states = []
    for _ in range(steps):
        states.append(sim.state())
        sim.step()
    return body, states


def test_damping_takes_energy():
    law, kinetic = law_named("fixed-corotated+damping"), []
    for eta in (1e-9, 2.0):
        body, states = shaken(law, SOFT | {"eta": eta})
        kinetic.append([0.5 * np.sum(body.mass[:, None] * s.v**2) for s in states])
    assert max(kinetic[1][120:]) < 0.5 * max(kinetic[0][120:])


def recorded(law, values):
    """Some pairs of solver states of the ringing block."""
    body, states = shaken(law, values, 62)
    pairs = [n for first in (10, 30, 50) for n in (first, first + 1, first + 2)]
    held = {k: np.array([getattr(states[n], k) for n in pairs]) for k in "xvCFL"}
    return Recording.from_arrays(
        [0.0],
        body.x[None],
        states=States(step=np.array(pairs), **held),
        solver=SOLVER,
        volume=body.volume,
        density=1000.0,
        v_0=np.zeros_like(body.x),
    )


MAGNITUDES = {"damping": 2.0, "rate-dependence": 1.5, "stiffening": 4e3, "anisotropy": 24e3}


@pytest.mark.parametrize("name", ADDITIONS)
def test_what_was_added_is_found_and_nothing_where_it_was_not(name):
    base, both = LAWS["fixed-corotated"], law_named(f"fixed-corotated+{name}")
    key = both.terms[-1].key
    given = {k: VALUES[k] for k in both.constants("given")}
    size = MAGNITUDES[name]
    answer = identify(recorded(both, SOFT | given | {key: size}), both.name, known=given)
    for k, true in (SOFT | {key: size}).items():
        assert answer.material.values[k] == pytest.approx(true, rel=1e-6)
    without = identify(recorded(base, SOFT), both.name, known=given)
    assert abs(without.material.values[key]) < 1e-6 * size
