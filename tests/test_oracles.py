"""Checks of ``oracles/finite_elements.py`` against closed forms, beam theory and balances."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import logm, polar

sys.path.insert(0, str(Path(__file__).parent / "oracles"))
fe, laws, solver = (
    importlib.import_module(f"finite_elements{x}") for x in ("", "_laws", "_solver")
)

CLAY = {"E": 80e3, "nu": 0.3, "tau_y": 1e4}
RUBBER = {"E": 80e3, "nu": 0.45}
CUBE = [np.array([0.0, 0.4, 1.0]), np.array([0.0, 0.7, 1.0]), np.array([0.0, 0.5, 1.0])]


def body(edges, law, p, fixed, **more):
    """A solver without gravity unless ``more`` says otherwise; ``fixed`` of node positions."""
    mesh = solver.Mesh(edges)
    more = {"density": 1000.0, "gravity": np.zeros(3)} | more
    return solver.Solver(mesh, law, p, fixed=fixed(mesh.X), **more)


def faces(X):
    """Dofs on the faces of the unit cube."""
    return np.repeat(((X < 1e-9) | (X > 1 - 1e-9)).any(1, keepdims=True), 3, axis=1)


def driven(one, u):
    """Bring the free dofs into static balance with the fixed ones at u (N, 3)."""
    one.u, one.reaction, one.state = one.newton(u, one.fixed, 0.0, np.zeros_like(u), 0.0)


def stress(law, F, p):
    """P of one elastic gradient, from matrix functions."""
    mu, lam = p["E"] / 2 / (1 + p["nu"]), p["E"] * p["nu"] / (1 + p["nu"]) / (1 - 2 * p["nu"])
    turned, J = np.linalg.inv(F).T, np.linalg.det(F)
    if law is laws.fixed_corotated:
        return 2 * mu * (F - polar(F)[0]) + lam * (J - 1) * J * turned
    e = logm(F @ F.T) / 2
    return (2 * mu * e + lam * np.trace(e) * np.eye(3)) @ turned


def energy(one):
    """Kinetic and stored energy of a fixed-corotated body [J]."""
    mu, lam = laws.lame(one.p["E"], one.p["nu"])
    cells, mesh = one.mesh.cells, one.mesh
    F = (one.u[cells].mT @ mesh.gradient).reshape(-1, 3, 27, 3).transpose(0, 2, 1, 3) + np.eye(3)
    s, J = np.linalg.svd(F)[1], np.linalg.det(F)
    density = mu * ((s - 1) ** 2).sum(-1) + lam / 2 * (J - 1) ** 2
    kinetic = one.density / 2 * (one.v * (mesh.mass @ one.v)).sum()
    return kinetic, (mesh.weight * density).sum()


@pytest.mark.parametrize(("law", "p"), [("von-mises", CLAY), ("fixed-corotated", RUBBER)])
def test_tangent(law, p):
    """dP/dF is the central difference of P, at rest, beyond yield and with equal stretches."""
    rng = np.random.default_rng(0)
    F = np.eye(3) + 0.15 * rng.normal(size=(40, 3, 3))
    B = 0.1 * rng.normal(size=(40, 3, 3))
    H = np.eye(3) + B @ B.mT
    F[0], H[0], F[1], H[1] = np.eye(3), np.eye(3), np.diag([1, 1, 0.9]), np.eye(3)
    A = laws.LAWS[law](F, H, p, tangent=True)[2]
    for k, L in np.ndindex(3, 3):
        d = np.zeros((3, 3))
        d[k, L] = 1e-6
        ends = [laws.LAWS[law](F + sign * d, H, p)[0] for sign in (1, -1)]
        np.testing.assert_allclose(A[..., k, L], (ends[0] - ends[1]) / 2e-6, atol=1e-7 * A.max())


@pytest.mark.parametrize(("law", "p"), [("von-mises", CLAY), ("fixed-corotated", RUBBER)])
def test_patch(law, p):
    """Affinely moved faces move the inside affinely, under the homogeneous stress of the law."""
    law, p = laws.LAWS[law], {k: v for k, v in p.items() if k != "tau_y"}
    F = np.array([[1.1, 0.2, -0.1], [0.0, 0.85, 0.1], [0.15, 0.05, 1.05]])
    one = body(CUBE, law, p, faces)
    wanted = one.mesh.X @ (F - np.eye(3)).T
    noise = 0.02 * np.random.default_rng(0).normal(size=wanted.shape)
    driven(one, np.where(one.fixed, wanted, wanted + noise))
    np.testing.assert_allclose(one.u, wanted, atol=1e-12)
    P = one.stress(one.u)[0]
    np.testing.assert_allclose(P, np.tile(stress(law, F, p), (len(P), 1, 1)), rtol=1e-6)
    np.testing.assert_allclose(one.reaction.T @ one.mesh.X, P[0], rtol=1e-6)


def test_uniaxial_compression():
    """Elastic force E A log(z)/z and plateau sqrt(3/2) tau_y A/z under frictionless plates."""
    side, yields = 0.015, np.sqrt(1.5) * CLAY["tau_y"]
    edges = [np.array([0, side])] * 2 + [np.array([0, 0.01, 0.025])]
    nodes = np.flatnonzero(solver.Mesh(edges).X[:, 2] > 0.025 - 1e-9)
    plate = solver.Plate(nodes, lambda t: 0.025 * (1 - t))
    one = body(edges, laws.von_mises, CLAY, lambda X: X < 1e-9, plates=[plate])
    for t in np.arange(0.01, 0.3, 0.01):
        one.rest(t)
        tau = min(-CLAY["E"] * np.log(1 - t), yields)
        force = -one.reaction[nodes, 2].sum()
        assert force == pytest.approx(tau * side**2 / (1 - t), rel=1e-5)


def first_mode(one):
    """Angular frequency [1/s] and shape (N, 3) of the slowest mode towards x of a body at rest."""
    free, x = np.flatnonzero(~one.fixed.ravel()), np.zeros_like(one.u)
    one.factorise(one.u, 0.0, one.time, free)
    x[:, 0] = ~one.fixed[:, 0]
    for _ in range(8):
        load = one.density * (one.mesh.mass @ x).ravel()[free]
        y = np.zeros(x.size)
        y[free] = one.factors.solve(load)
        square = (x.ravel()[free] @ load) / (y[free] @ load)
        x = y.reshape(x.shape) / np.abs(y).max()
    return np.sqrt(square), x


def test_first_frequency():
    """The strip's first bending mode against a slender cantilever's."""
    omega, _ = first_mode(fe.bend(RUBBER, 1, fe.BEND))
    slender = 1.8751041**2 / fe.CLAMP**2 * np.sqrt(RUBBER["E"] * 0.012**2 / 12 / 1000)
    assert omega == pytest.approx(slender, rel=0.01)


def test_order_in_space():
    """A harmonic gradient field, an equilibrium of small strain, converges with third order."""

    def field(X):
        x, y, z = X.T
        wave = [np.cos(y) * np.cos(z), -np.sin(y) * np.cos(z), -np.cos(y) * np.sin(z)]
        root = np.sqrt(2)
        scale = np.exp(root * x)[:, None] * [root, 1.0, 1.0]
        return 1e-9 * scale * np.stack(wave, -1)

    points, errors = np.random.default_rng(0).uniform(size=(999, 3)), []
    for count in (1, 2, 4):
        one = body([np.linspace(0, 1, count + 1)] * 3, laws.fixed_corotated, RUBBER, faces)
        one.u = np.where(one.fixed, field(one.mesh.X), 0)
        force, _ = one.residual(one.u, np.zeros_like(one.u), 0.0)
        free = np.flatnonzero(~one.fixed.ravel())
        one.factorise(np.zeros_like(one.u), 0.0, 0.0, free)
        one.u.ravel()[free] -= one.factors.solve(force.ravel()[free])
        errors.append(np.linalg.norm(one.mesh.sampler(points) @ one.u - field(points)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders.min() > 2.7, errors


def swung(h):
    """A short strip 0.08 s after a start with its first mode's velocity, in steps of h [s]."""
    edges = [np.array([-0.006, 0.006]), np.array([-0.002, 0.002]), np.linspace(0, 0.06, 4)]
    one = body(
        edges, laws.fixed_corotated, RUBBER, lambda X: np.repeat(X[:, 2:] > 0.0599, 3, axis=1)
    )
    one.v = 0.2 * first_mode(one)[1]
    started = sum(energy(one))
    for _ in range(round(0.08 / h)):
        one.step(h)
    return one, sum(energy(one)) / started


def test_order_in_time():
    """Steps halved make a swing's error a quarter; a little energy is lost, none won."""
    found = [swung(h) for h in (8e-3, 4e-3, 2e-3)]
    u = [one.u for one, _ in found]
    assert np.abs(u[-1]).max() > 1e-3
    assert np.log2(np.abs(u[0] - u[1]).max() / np.abs(u[1] - u[2]).max()) > 1.8
    assert 0.9999 < found[-1][1] < 1


def test_momentum_of_free_flight():
    """A thrown, twisted and squeezed block keeps its momentum and nearly its spin and energy."""
    one = body(
        [CUBE[0] * 0.02] * 3, laws.fixed_corotated, RUBBER, lambda X: np.zeros(X.shape, bool)
    )
    X, turn = one.mesh.X - 0.01, np.array([3.0, -5.0, 8.0])
    one.v = np.array([1.0, 2.0, 3.0]) + np.cross(turn, X) - 4 * X * [1, 0, 0]

    def momenta():
        p = one.density * (one.mesh.mass @ one.v)
        return p.sum(0), np.cross(one.mesh.X + one.u, p).sum(0)

    (p, spin), started = momenta(), sum(energy(one))
    for _ in range(40):
        one.step(5e-4)
    np.testing.assert_allclose(momenta()[0], p, rtol=1e-8)
    np.testing.assert_allclose(momenta()[1], spin, rtol=0.02)
    assert 0.99 < sum(energy(one)) / started < 1


def test_pusher():
    """The pushed strip takes up the pusher's work and is entered by less than 5 um."""
    one = fe.bend(RUBBER, 1, fe.TOUCHING)
    one.time, x, force = 0.3, [0.016], [0.0]
    for _ in range(80):
        one.step(5e-3)
        origin, on_tool, contact = fe.tool(one)
        x.append(origin[0])
        force.append(on_tool[0])
        surface = one.pusher.forces(one.u, one.time)[0] - origin
        assert np.hypot(surface[:, 0], surface[:, 2]).min() > fe.RADIUS - 5e-6
        if force[-1]:
            assert np.linalg.norm((contact - origin)[[0, 2]]) == pytest.approx(fe.RADIUS, rel=1e-3)
    work = -np.trapezoid(force, x)
    assert 2 * sum(energy(one)) == pytest.approx(work, rel=0.01)


@pytest.mark.parametrize("case", ["press-a", "press-bonded-a"])
def test_files(case, tmp_path, monkeypatch):
    """The command writes what it says, and no point leaves the gap of floor and plate."""
    options = ["--mesh", "coarse", "--step", "0.01", "--points", "20", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["finite_elements.py", case, *options])
    fe.main()
    with np.load(tmp_path / f"{case}.npz") as file:
        data = dict(file)
    steps, frames = len(data["force_plate_time"]), len(data["time"])
    assert data["p_WQ"].shape == (frames, 20, 3) and data["p_reference"].shape == (20, 3)
    assert data["pose_plate_value"].shape == (steps, 4, 4)
    assert data["force_plate_value"].shape == (steps, 3)
    assert data["p_WQ"][..., 2].min() > 0
    assert (data["p_WQ"][:, :, 2].max(1) < data["pose_plate_value"][:, 2, 3]).all()
    assert json.loads((tmp_path / f"{case}.truth.json").read_text()) == fe.PARAMETERS[case]
    kind = "bonded" if "bonded" in case else "frictionless"
    assert json.loads((tmp_path / f"{case}.json").read_text())["contact"]["z+"] == f"{kind} plate"
    assert data["force_plate_value"][-1, 2] > 1
