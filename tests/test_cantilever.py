"""A clamped rod that sags and rings: against the elastica and beam theory."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import curve_fit

from form_drake.laws import LAWS
from form_drake.mpm.simulation import stable_dt
from form_drake.records.solver import GRADIENTS, Solver, Wall
from helpers.solver import DENSITY, lattice, simulation

LENGTH, DIAMETER, YOUNG, G = 0.06, 0.008, 240e3, 9.81
AREA, INERTIA = np.pi * DIAMETER**2 / 4, np.pi * DIAMETER**4 / 64
WEIGHT = DENSITY * G * AREA


def rod(h):
    """Particles of a round rod on a square lattice, and the volume of each.

    The volumes sum to the exact area and the lattice is stretched until the particles' own second
    moment is exact: quadratic splines carry a linear strain, which the points integrate alone.
    """
    n = round(DIAMETER / h)
    x, y, z = (lattice((round(LENGTH / h), n, n), h) - [0, DIAMETER / 2, DIAMETER / 2]).T
    inside = y**2 + z**2 < DIAMETER**2 / 4
    stretch = np.sqrt(INERTIA / AREA / np.mean(z[inside] ** 2))
    points = np.stack([x, stretch * y, stretch * z], 1)[inside]
    return points, AREA * LENGTH / len(points)


@cache
def elastica_drop(at):
    """Drop of the material point at this length of a heavy clamped elastica."""

    def slopes(s, y):
        return [y[1], -WEIGHT / (YOUNG * INERTIA) * (LENGTH - s) * np.cos(y[0]), np.sin(y[0])]

    def ends(a, b):
        return [a[0], b[1], a[2]]

    s = np.linspace(0, LENGTH, 41)
    solution = solve_bvp(lambda s, y: np.array(slopes(s, y)), ends, s, np.zeros((3, 41)), tol=1e-8)
    return float(solution.sol(at)[2])


def clamped_rod(dx, nu, gradient, gravity, phase):
    """The rod, clamped at x = (3 + phase) dx by a stick wall, its axis on a half-node line."""
    points, volume = rod(dx / 2)
    clamp, room = (3 + phase) * dx, int(np.ceil(0.024 / dx))
    axis = np.array([clamp, 3.5 * dx, (room + 2.5) * dx])
    half = int(np.ceil(DIAMETER / 2 / dx))
    values = {"C10": YOUNG / 4 / (1 + nu), "kappa": YOUNG / 3 / (1 - 2 * nu)}
    axis[1] = (half + 1.5) * dx
    nodes = (int((clamp + LENGTH) / dx) + 4, 2 * half + 4, room + half + 7)
    solver = Solver(
        dx,
        nodes,
        stable_dt(LAWS["neo-hookean"], values, DENSITY, dx),
        gradient,
        precision="float64",
        walls=(Wall(0, -1, clamp, "stick"),),
        gravity=(0.0, 0.0, -gravity),
    )
    sim = simulation(solver, "neo-hookean", values, points + axis, volume)
    return sim, points


def settle(sim, seconds, rate):
    """Let the body come to rest under a drag of ``rate`` [1/s] that acts every 20 steps."""
    keep = np.exp(-rate * 20 * sim.solver.dt)
    for _ in range(round(seconds / sim.solver.dt / 20)):
        sim.step(20)
        s = sim.state()
        sim.restore(replace(s, v=keep * s.v, C=keep * s.C, L=keep * s.L))


def elastica_error(dx, nu, phase):
    sim, points = clamped_rod(dx, nu, "exact", G, phase)
    settle(sim, 0.25, 2 * 2 * np.pi * 4.5)
    last = points[:, 0] > points[:, 0].max() - 1e-9
    drop = np.mean(sim.body.x[last, 2] - sim.x[last, 2])
    error = drop / elastica_drop(points[:, 0].max()) - 1
    return error


@pytest.mark.parametrize("phase", [0.0, 0.5])
@pytest.mark.parametrize("nu", [0.3, 0.45])
def test_cantilever_at_two_cells(nu, phase):
    error = elastica_error(0.004, nu, phase)
    print(f"tip at two cells, nu {nu}, clamp at {phase} dx: {error:+.1%} of the elastica's drop")
    assert abs(error) < 0.05  # of which shear is +1.4 %


@pytest.mark.slow
@pytest.mark.parametrize("nu", [0.3, 0.45])
def test_cantilever_at_four_cells(nu):
    assert abs(elastica_error(0.002, nu, 0.5)) < 0.03


def first_bending(nu):
    """Frequency [Hz] of the clamped rod: Euler-Bernoulli, lowered by shear (Dunkerley)."""
    slender = 1.875104**2 / (2 * np.pi) * np.sqrt(YOUNG * INERTIA / DENSITY / AREA) / LENGTH**2
    shear = 0.9 * YOUNG / 2 / (1 + nu)  # 0.9: shear coefficient of the circle
    return (slender**-2 + (np.sqrt(shear / DENSITY) / 4 / LENGTH) ** -2) ** -0.5


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_vibration_of_the_clamped_rod(gradient):
    nu = 0.3
    sim, points = clamped_rod(0.004, nu, gradient, 0.0, 0.5)
    s, beta = points[:, 0], 1.875104 / LENGTH
    shape = np.cosh(beta * s) - np.cos(beta * s)
    shape -= 0.734096 * (np.sinh(beta * s) - np.sin(beta * s))
    v = np.zeros_like(points)
    v[:, 2] = 0.0005 * 2 * np.pi * 4.8 * shape  # 1 mm at the tip
    sim.reset(sim.body.x, v)
    last, t, z = s > s.max() - 1e-9, [], []
    for _ in range(round(2.2 / 4.8 / sim.solver.dt / 20)):
        sim.step(20)
        t.append(len(t) * 20 * sim.solver.dt)
        z.append(np.mean(sim.x[last, 2] - sim.body.x[last, 2]))

    def ringing(t, a, decay, omega, phase):
        return a * np.exp(-decay * t) * np.sin(omega * t + phase)

    (_, decay, omega, _), _ = curve_fit(ringing, t, z, [0.001, 0.3, 30.0, 0.0])
    loss = 1 - np.exp(-decay * 2 * np.pi / omega)
    beam = first_bending(nu)
    print(f"{gradient}: {omega / 2 / np.pi:.3f} Hz (beam {beam:.3f}), {loss:.1%} lost per period")
    # a stiffness within 5 %, as the cantilever's, is a frequency within 2.5 %
    assert omega / 2 / np.pi == pytest.approx(beam, rel=0.025)
    # an independent APIC prototype lost 5.0 (exact) and 7.6 % (mls) per period at this dx
    assert 0 <= loss < {"exact": 0.05, "mls": 0.076}[gradient]
