"""Solver physics against balances, symmetries and closed or independently solved answers."""

import threading
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.optimize import curve_fit

from form_drake.laws import LAWS
from form_drake.mpm.simulation import BlowUp, Body, Simulation, stable_dt
from form_drake.mpm.walls import NO_WALL, fold_tables, separating_bounds
from form_drake.records.solver import GRADIENTS, Solver, Wall

DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))
SOFT = {"C10": 2e3, "kappa": 2e4}
GRAVITY = np.array([1.0, -2.0, -9.81])
DENSITY = 1000.0


def lattice(counts, h):
    """Cell centres of a box of cubes with edge h [m], the box's corner at the origin."""
    return (np.indices(counts).reshape(3, -1).T + 0.5) * h


def simulation(solver, law, values, x, volume, *, density=DENSITY, device="cpu"):
    made = Simulation(solver, LAWS[law], Body(x, np.full(len(x), volume), density), device=device)
    made.set_material(values)
    made.reset(x, np.zeros_like(x))
    return made


def tossed(n=6, dx=0.1, **settings):
    """A stirred neo-Hookean cube in the middle of a cubic grid; simulation and start."""
    rng = np.random.default_rng(0)
    nodes, h = 15, dx / 2
    x = lattice((n, n, n), h) + (nodes - 1) / 2 * dx - n * h / 2
    x += rng.uniform(-0.1, 0.1, x.shape) * h
    r = x - x.mean(0)
    v = np.array([0.3, 0.2, -0.1]) + np.cross([1.0, -2.0, 1.5], r)
    v += 0.5 * np.sin(r @ rng.uniform(-8, 8, (3, 3)))
    settings = {"dt": 2e-3, "precision": "float64", "gravity": (0.0, 0.0, 0.0)} | settings
    device = settings.pop("device", "cpu")
    solver = Solver(dx=dx, nodes=(nodes,) * 3, **settings)
    made = simulation(solver, "neo-hookean", SOFT, x, h**3, device=device)
    made.reset(x, v)
    return made, x, v


def momenta(sim):
    """Linear and angular momentum, the latter with the affine part that APIC keeps."""
    s, m = sim.state(), sim.body.density * sim.body.volume[:, None]
    C = s.C * sim.solver.dx**2 / 4
    spin = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    return (m * s.v).sum(0), (m * (np.cross(s.x, s.v) + spin)).sum(0)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("gradient", GRADIENTS)
def test_momentum_in_free_flight(gradient, device):
    sim, _, _ = tossed(gradient=gradient, gravity=tuple(GRAVITY), device=device)
    mass, dt = sim.body.density * sim.body.volume.sum(), sim.solver.dt
    for _ in range(30):
        centre, (p0, l0) = sim.x.mean(0), momenta(sim)
        sim.step()
        p1, l1 = momenta(sim)
        impulse = mass * dt * GRAVITY
        # hundreds of float64 roundings of sums of this size
        assert p1 - p0 == pytest.approx(impulse, abs=1e-12 * np.linalg.norm(p0))
        assert l1 - l0 == pytest.approx(np.cross(centre, impulse), abs=1e-12 * np.linalg.norm(l0))


def neo_hookean_energy(F, values):
    J = np.linalg.det(F)
    first = np.einsum("nij,nij->n", F, F) * J ** (-2 / 3)
    return values["C10"] * (first - 3) + values["kappa"] / 2 * (J - 1) ** 2


def energy(sim, values):
    """Kinetic energy of v and of the affine motion, and stored energy [J]."""
    s, V = sim.state(), sim.body.volume
    affine = sim.solver.dx**2 / 4 * np.einsum("nij,nij->n", s.C, s.C)
    kinetic = sim.body.density * V * ((s.v**2).sum(1) + affine) / 2
    return float((kinetic + V * neo_hookean_energy(s.F, values)).sum())


def transfer_factor(q):
    """What one APIC transfer leaves of a wave with phase q per cell, particles dense.

    s^2 + 4 s'^2 with s = sinc(q/2)^3, the transform of the quadratic spline; 1 - q^4/40 + ...
    """
    s = np.sinc(q / 2 / np.pi) ** 3
    slope = 1.5 * s * (1 / np.tan(q / 2) - 2 / q)
    return s**2 + 4 * slope**2


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_energy_of_a_free_vibration(gradient):
    dx, cells = 0.1, 10
    values = {"C10": 3e3, "kappa": 4e3}  # nu = 0: a wave along the bar, nothing across
    h, wave = dx / 2, np.pi / (cells * dx)
    x = lattice((2 * cells, 4, 4), h) + 2.5 * dx
    speed = np.sqrt((values["kappa"] + 8 / 3 * values["C10"]) / DENSITY)
    dt, omega = 0.4 * dx / speed, wave * speed
    solver = Solver(dx, (17, 9, 9), dt, gradient, precision="float64", gravity=(0.0, 0.0, 0.0))
    sim = simulation(solver, "neo-hookean", values, x, h**3)
    v = np.zeros_like(x)
    v[:, 0] = 0.01 * speed * np.cos(wave * (x[:, 0] - 2.5 * dx))
    sim.reset(x, v)
    steps = round(3 * 2 * np.pi / omega / dt)
    total = [energy(sim, values)]
    for _ in range(steps // 10):
        sim.step(10)
        total.append(energy(sim, values))
    total = np.array(total) / total[0]
    print(f"{gradient}: energy {total.max():.3f} at most, {total[-1]:.3f} after three periods")
    # a symplectic Euler step keeps H of an oscillation to within omega dt / 2
    assert total.max() < 1 + omega * dt / 2
    # v loses 1 - transfer_factor per step; half of the energy is kinetic and goes as v squared
    lost = steps * (1 - transfer_factor(np.pi / cells))
    assert total[-1] > 1 - 2 * lost - omega * dt / 2


QUARTER_TURNS = (
    np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
)


def turned_wall(wall, turn, nodes, dx):
    """The wall after a quarter turn about the middle of a cubic grid."""
    axis = int(np.flatnonzero(turn[:, wall.axis])[0])
    sign = int(turn[axis, wall.axis])
    middle = (nodes - 1) / 2 * dx
    return Wall(axis, sign * wall.side, middle + sign * (wall.position - middle), wall.kind)


@pytest.mark.parametrize("turn", QUARTER_TURNS, ids=["z", "y"])
@pytest.mark.parametrize("kinds", [(), ("separate", "separate"), ("stick", "slip")])
def test_quarter_turn(turn, kinds):
    on_nodes = kinds == ("separate", "separate")
    places = ((2, -1, 0.5), (0, 1, 0.9)) if on_nodes else ((2, -1, 0.52), (0, 1, 0.91))
    walls = tuple(Wall(*p, kind) for p, kind in zip(places, kinds, strict=False))
    turned = tuple(turned_wall(w, turn, 15, 0.1) for w in walls)
    middle, results = 0.7, []
    for t, w in ((np.eye(3), walls), (turn, turned)):
        sim, x, v = tossed(walls=w, gravity=tuple(t @ GRAVITY))
        sim.reset(middle + (x - middle) @ t.T, v @ t.T)
        sim.step(60)
        results.append(sim.x)
    assert np.max(np.abs(results[0] - results[0].mean(0) - (x - x.mean(0)))) > 0.02
    error = np.max(np.abs(middle + (results[0] - middle) @ turn.T - results[1]))
    assert error < 1e-11  # round-off of float64, grown over 60 steps


def test_arbitrary_turn():
    axis, angle = np.array([1.0, 2.0, 2.0]) / 3.0, 0.6
    K = np.cross(np.eye(3), axis)
    turn = np.eye(3) - np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    middle, results = 0.7, []
    for t in (np.eye(3), turn):
        sim, x, v = tossed(n=8, dt=1e-3)
        sim.reset(middle + (x - middle) @ t.T, v @ t.T)
        sim.step(60)
        results.append(sim.x)
    moved = np.max(np.linalg.norm(results[0] - x, axis=1))
    error = np.max(np.linalg.norm(middle + (results[0] - middle) @ turn.T - results[1], axis=1))
    assert error < 0.05 * moved


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


def spline(d):
    a = np.abs(d)
    return np.where(a < 0.5, 0.75 - a**2, np.where(a < 1.5, (1.5 - a) ** 2 / 2, 0.0))


def slope(d):
    a = np.abs(d)
    return np.where(a < 0.5, -2 * d, np.where(a < 1.5, -np.sign(d) * (1.5 - a), 0.0))


def discrete_poiseuille(cells, ratio):
    """Flux over the analytic one, of APIC with two particles per cell between walls at half-nodes.

    Fourier modes sin(k y) of the odd continuation; ``ratio`` = viscosity dt / (density dx^2). Per
    step a node mode v becomes (transfer - ratio diffusion) v + forcing.
    """
    particles, nodes = (np.arange(2 * cells) + 0.5) / 2, np.arange(cells) + 0.5
    weight = spline(nodes[:, None] - particles) - spline(nodes[:, None] + particles)
    weight -= spline(nodes[:, None] + particles - 2 * cells)
    forcing, flux = weight.sum(1) / 2, 0.0
    for k in np.arange(1, cells + 1, 2) * np.pi / cells:
        d = np.arange(-2.5, 4.0)[:, None] - np.array([0.25, 0.75])
        wave = np.exp(1j * k * d)
        value, moment, rate = ((f * wave).sum(0) for f in (spline(d), d * spline(d), slope(d)))
        transfer = np.mean(np.abs(value) ** 2 + 4 * np.abs(moment) ** 2)
        diffusion = np.mean(np.abs(rate) ** 2)
        amount = np.sum(np.sin(k * nodes) * forcing) / np.sum(np.sin(k * nodes) ** 2)
        nodal = amount * ratio / (1 - transfer + ratio * diffusion)
        at = value * np.exp(1j * k * particles.reshape(cells, 2))
        flux += nodal * np.mean(at.imag)
    return 12 * flux / cells**2


def channel_flux(cells, ratio, offset, length, device="cpu"):
    """Mean velocity over the analytic one in the middle of a slab between two stick walls."""
    eta, density, gap, pull, width = 3.44, 1260.0, 0.01, 1e-3, 2
    dx = gap / cells
    dt = ratio * density * dx**2 / eta
    h, low = dx / 2, (3 + offset) * dx
    corner = np.array([4 * dx, 3 * dx, low])
    x = lattice((2 * cells * length, 2 * width, 2 * cells), h) + corner
    walls = (
        Wall(1, -1, 3 * dx, "slip"),
        Wall(1, 1, (3 + width) * dx, "slip"),
        Wall(2, -1, low, "stick"),
        Wall(2, 1, low + gap, "stick"),
    )
    nodes = (cells * length + 9, width + 7, cells + 9)
    solver = Solver(dx, nodes, dt, precision="float64", walls=walls, gravity=(pull, 0.0, 0.0))
    values = {"eta": eta, "kappa": density * (0.3 * dx / dt) ** 2}
    sim = simulation(solver, "newtonian", values, x, h**3, density=density, device=device)
    sim.step(round(8 * gap**2 * density / eta / np.pi**2 / dt))  # e^-8 from steady
    middle = np.abs(x[:, 0] - x[:, 0].mean()) < gap
    return sim.v[middle, 0].mean() / (density * pull * gap**2 / 12 / eta)


@pytest.mark.parametrize("device", DEVICES)
def test_poiseuille_flow_knows_no_grid_phase(device):
    phases = (
        0.0,
        0.05,
        0.1,
        0.25,
        0.5,
        0.75,
        0.9,
        0.95,
    )  # low and high wall near a node, either side
    flux = [channel_flux(6, 0.15, phase, 6, device) for phase in phases]
    print(f"flux over the exact one, wall at {phases} dx:", np.round(flux, 3))
    assert max(flux) - min(flux) < 0.02
    # APIC's numerical viscosity at six cells takes 3.6 % (see discrete_poiseuille)
    assert 0.95 < min(flux) and max(flux) < 1.0


@pytest.mark.parametrize("ratio", [0.05, 0.15])
def test_poiseuille_flow_has_only_the_viscosity_of_the_transfer(ratio):
    expected = discrete_poiseuille(4, ratio)
    # the ends, six gaps away from the middle, are felt in the fourth digit
    assert channel_flux(4, ratio, 0.5, 12) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("gap", [1.0, 2.0, 2.3, 4.0])
def test_fold_extends_a_flow_that_vanishes_on_the_plane(gap):
    for low in 5 + np.arange(0, 1, 0.05):
        high = low + gap
        walls = (Wall(0, -1, low, "stick"), Wall(0, 1, high, "slip"))
        parents, table = fold_tables(Solver(1.0, (16, 4, 4), walls=walls))[0]
        below, above = np.arange(16) - low, high - np.arange(16)
        free = (below >= 0.5 - 1e-6) & (above >= 0.5 - 1e-6)
        assert np.array_equal(parents[:, 0] == -1, free)
        assert free[parents[parents >= 0]].all()
        for depth, other in ((below, above), (above, below)):
            # ghosts of this plane alone that a particle in front of it can reach
            reached = (depth > -1.5) & (depth < 0.5 - 1e-6) & (other >= 0.5 - 1e-6)
            for g in np.flatnonzero(reached & (parents[:, 0] >= 0)):
                two = parents[g] >= 0
                held, slides, shares = table[g].reshape(3, 2)[:, two]
                if np.sum(np.abs(held)) < 1.6 - 1e-9:  # beyond, the extrapolation is limited
                    assert held @ depth[parents[g, two]] == pytest.approx(depth[g], abs=1e-12)
                if depth is above:
                    assert np.sum(slides) == pytest.approx(1.0, abs=1e-12)
                assert np.sum(shares) == pytest.approx(1.0, abs=1e-12)
                assert np.min(shares) > 0


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("kind", ["slip", "stick"])
def test_fold_does_not_depend_on_the_order_of_the_nodes(kind, device):
    """A layer .3 cells behind a wall, whose nearer ghosts are too heavy for what is in front.

    The deeper ones are not: what they hand over must not count for the nearer ones.
    """
    dx, phi, out = 1.0, 0.6, []
    low, high = 6 - phi, 9 + phi
    walls = (Wall(2, -1, low, kind), Wall(2, 1, high, kind))
    solver = Solver(dx, (16, 16, 16), 1e-3, precision="float64", walls=walls, gravity=(0, 0, 0))
    x = lattice((4, 4, 1), 0.5) + np.array([6.5, 6.5, 0])
    for height, normal in ((low - 0.3, 1.0), (high + 0.3, -1.0)):
        x[:, 2] = height
        sim = simulation(solver, "neo-hookean", SOFT, x, 0.125, device=device)
        sim.reset(x, np.tile([1.0, 0.0, normal], (len(x), 1)))
        sim.step()
        out.append(sim.v * [1, 1, normal])
    assert np.max(np.abs(out[0])) > 0.01
    assert out[1] == pytest.approx(out[0], abs=1e-13)


def test_number_of_nodes_is_bounded():
    Solver(0.1, (1000, 1000, 100))
    with pytest.raises(ValueError, match="at most 1e8 nodes"):
        Solver(0.1, (1000, 1000, 101))


def test_separating_walls_lie_on_nodes_and_the_tighter_one_counts():
    grid = Solver(0.1, (12, 12, 12))
    for position in (0.35, 0.3102, 0.2898):
        with pytest.raises(ValueError, match=r"whole multiples of dx = 0.1 m, such as 0\.[34] m"):
            replace(grid, walls=(Wall(2, -1, position),))
        replace(grid, walls=(Wall(2, -1, position, "slip"), Wall(0, 1, position, "stick")))
    places = ((0, -1, 0.3), (0, -1, 0.2), (2, -1, 0.29995), (1, 1, 0.8), (1, 1, 0.90005))
    for order in (places, places[::-1]):
        low, high = separating_bounds(replace(grid, walls=tuple(Wall(*p) for p in order)))
        assert list(low) == [3, -1, 3]
        assert list(high) == [NO_WALL, 8, NO_WALL]


def box_walls(low, high, kind):
    return tuple(
        Wall(axis, side, float(at[axis]), kind)
        for axis in range(3)
        for side, at in ((-1, low), (1, high))
        if (axis, side) != (2, 1)
    )


def tank(counts, offset, floor_cells, values, kind="slip"):
    """A block of fluid in one corner of an open box; simulation and box corner."""
    dx, density = 0.005, 1260.0
    h, low = dx / 2, (3.0 + offset) * dx * np.ones(3)
    high = low + np.array([*floor_cells, 0]) * dx
    x = lattice(2 * np.array(counts), h) + low
    nodes = (floor_cells[0] + 8, floor_cells[1] + 8, counts[2] + 8)
    dt = stable_dt(LAWS["newtonian"], values, density, dx)
    solver = Solver(dx, nodes, dt, precision="float64", walls=box_walls(low, high, kind))
    return simulation(solver, "newtonian", values, x, h**3, density=density), low


@pytest.mark.parametrize("cells", [2, 3])  # between two walls of one axis
@pytest.mark.parametrize("kind", ["slip", "stick"])
@pytest.mark.parametrize("offset", [0.0, 0.05, 0.25, 0.4, 0.5, 0.75])
def test_column_at_rest(offset, kind, cells):
    values = {"eta": 3.44, "kappa": 1260.0 * 64}
    sim, low = tank((cells, cells, 8), offset, (cells, cells), values, kind)
    height, weight, dx = 0.04, 1260.0 * 9.81, sim.solver.dx
    expected = weight * (height - (sim.body.x[:, 2] - low[2]))
    J = 1 - expected / values["kappa"]
    sim.reset(sim.body.x, np.zeros_like(sim.body.x), F=np.cbrt(J)[:, None, None] * np.eye(3))
    sim.step(round(0.2 / sim.solver.dt))
    s = sim.state()
    pressure = -values["kappa"] * (np.linalg.det(s.F) - 1)
    error = np.sqrt(np.mean((pressure - expected) ** 2)) / (weight * height)
    moved = (s.x - sim.body.x) / dx
    # the body force of a cut cell has no reaction of the wall's own: of the order of one cell in
    # eight of height, more of it close to half-way; none of it where the planes lie on nodes or
    # half-way between
    limits = {0.0: 0.01, 0.05: 0.025, 0.25: 0.125, 0.4: 0.27, 0.5: 0.01, 0.75: 0.125}
    assert error < limits[offset]
    assert np.max(np.abs(moved)) < 0.05  # nodes that are just fixed let particles sink .3 to 3 dx
    # 0.01 mm of level; 0.025 mm where a plane lies close to a node or to half-way
    assert abs(moved[:, 2].mean()) < (0.005 if offset in (0.05, 0.4) else 0.002)


def test_sliding_body_feels_no_drag():
    dx, floor = 0.1, 0.325
    x = lattice((6, 6, 6), dx / 2) + np.array([0.3, 0.3, floor])
    walls = (Wall(2, -1, floor, "slip"),)
    solver = Solver(dx, (16, 10, 10), 2e-3, precision="float64", walls=walls)
    sim = simulation(solver, "neo-hookean", SOFT, x, (dx / 2) ** 3)
    sim.reset(x, np.tile([1.0, 0.2, 0.0], (len(x), 1)))
    sim.step(300)
    assert sim.v[:, :2].mean(0) == pytest.approx([1.0, 0.2], rel=1e-12)  # round-off
    assert sim.x[:, 0].mean() - x[:, 0].mean() == pytest.approx(0.6, rel=1e-12)
    # static compression at mid-height, up to the bounce of a body that was let go at rest
    sag = DENSITY * 9.81 * 0.3**2 / (SOFT["kappa"] + 8 / 3 * SOFT["C10"])
    assert abs(sim.x[:, 2].mean() - x[:, 2].mean()) < sag


def test_dam_break_keeps_its_volume():
    values = {"eta": 0.5, "kappa": 1260.0 * 25}
    sim, low = tank((4, 2, 8), 0.25, (8, 2), values)
    sim.step(round(1.0 / sim.solver.dt))
    s, dx = sim.state(), sim.solver.dx
    J = np.linalg.det(s.F)
    weight = 1260.0 * 9.81 * 0.04 / values["kappa"]  # compression below the column, 1.6 %
    level = 2 * (s.x[:, 2].mean() - low[2])
    # J averaged over cells loses 22 % while its pressure looks right: so measure the level itself
    assert level == pytest.approx(4 * dx, rel=0.02)
    assert J.mean() == pytest.approx(1.0, abs=weight)
    assert np.max(np.abs(J - 1)) < 0.1
    assert np.ptp(s.x[:, 0]) > 7 * dx


STATE = ("x", "v", "C", "L", "F", "tau")


def assert_same(a, b):
    for key in STATE:
        assert np.array_equal(getattr(a, key), getattr(b, key)), key
    assert a.step == b.step


WALLED = (Wall(2, -1, 0.53, "stick"), Wall(0, 1, 0.9, "separate"))


def test_restored_state_continues_bit_for_bit():
    sim, _, _ = tossed(walls=WALLED)
    sim.step(17)
    middle = sim.state()
    sim.step(33)
    end = sim.state()
    assert end.step == 50
    sim.restore(middle)
    assert_same(sim.state(), middle)
    sim.step(33)
    assert_same(sim.state(), end)
    other, _, _ = tossed(walls=WALLED)
    other.restore(middle)
    other.step(33)
    assert_same(other.state(), end)


def test_branches_do_not_touch_each_other():
    sim, _, _ = tossed()
    sim.step(10)
    root = sim.state()
    copies = {key: getattr(root, key).copy() for key in STATE}
    ends = []
    for push in (0.0, 0.5, 0.0):
        sim.restore(replace(root, v=root.v + push * np.eye(3)[0]))
        sim.step(25)
        ends.append(sim.state())
    assert_same(ends[0], ends[2])
    shift = (ends[1].x - ends[0].x).mean(0)
    assert shift == pytest.approx([0.5 * 25 * sim.solver.dt, 0, 0], abs=1e-12)  # round-off
    for key in STATE:
        assert np.array_equal(getattr(root, key), copies[key])


def test_graphs_equal_single_launches():
    ends = []
    for advance in ("graph", "one", "launch"):
        sim, _, _ = tossed(walls=WALLED)
        if advance == "graph":
            sim.step(47)
        else:
            for _ in range(47):
                sim.step() if advance == "one" else sim._launch_step()
        ends.append(sim.state())
    assert_same(ends[0], ends[1])
    assert_same(ends[0], ends[2])


def test_threads_equal_serial():
    starts = (0.0, 0.4)
    sims = [tossed(walls=WALLED)[0] for _ in starts]
    roots = [replace(s.state(), v=s.v + push) for s, push in zip(sims, starts, strict=True)]

    def run(sim, root):
        sim.restore(root)
        sim.step(400)

    serial, threaded = [], []
    for sim, root in zip(sims, roots, strict=True):
        run(sim, root)
        serial.append(sim.state())
    threads = [threading.Thread(target=run, args=pair) for pair in zip(sims, roots, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    threaded = [sim.state() for sim in sims]
    for a, b in zip(serial, threaded, strict=True):
        assert_same(a, b)


def test_adaptive_step_agrees_with_a_fine_one():
    coarse, x, _ = tossed(dt=None)
    middle, _, _ = tossed(dt=2e-3)
    fine, _, _ = tossed(dt=1e-3)
    for _ in range(5):
        coarse.advance(0.04)
        middle.advance(0.04)
        fine.advance(0.04)
    moved = np.max(np.abs(fine.x - x))
    errors = [np.max(np.abs(sim.x - fine.x)) / moved for sim in (coarse, middle)]
    # 6.7 and 2 ms against 1 ms: by first order 5.7 times the error
    assert 2e-3 < coarse._dt < stable_dt(LAWS["neo-hookean"], SOFT, DENSITY, 0.1)
    assert errors[0] < 6 * errors[1] < 0.1


def test_adaptive_step_follows_a_free_fall():
    g, dx, duration = 9.81, 0.1, 0.8
    x = lattice((4, 4, 4), dx / 2) + np.array([3, 3, 38]) * dx
    solver = Solver(dx, (9, 9, 44), precision="float64")
    sim = simulation(solver, "neo-hookean", SOFT, x, (dx / 2) ** 3)
    z, made, spans = x[:, 2].mean(), sim.step, []

    def step(steps):
        made(steps)
        spans.append((steps, sim.dt, np.max(np.linalg.norm(sim.v, axis=1))))

    sim.step = step
    sim.advance(duration)
    steps, dt, speed = np.array(spans).T
    sound = 0.4 * dx / stable_dt(LAWS["neo-hookean"], SOFT, DENSITY, dx)
    assert np.sum(steps * dt) == pytest.approx(duration, rel=1e-14)
    assert speed[-1] == pytest.approx(g * duration, rel=1e-10)
    assert np.all((sound + speed) * dt <= 0.4 * dx * (1 + 1e-12))
    assert np.sum(steps) < 1.3 * np.trapezoid(sound + g * np.linspace(0, 0.8), dx=0.8 / 49) / 0.04
    # symplectic Euler falls g dt^2 / 2 too far per step, whatever the speed
    late = g / 2 * np.sum(steps * dt**2)
    assert late < g / 2 * duration * 0.4 * dx / sound
    assert z - sim.x[:, 2].mean() == pytest.approx(g / 2 * duration**2 + late, rel=1e-12)


@pytest.mark.parametrize("duration", [-0.1, np.nan, np.inf])
def test_advance_needs_a_duration(duration):
    for dt in (None, 2e-3):
        sim, _, _ = tossed(dt=dt)
        with pytest.raises(ValueError, match="duration"):
            sim.advance(duration)


def test_advance_needs_whole_fixed_steps():
    sim, _, _ = tossed()
    with pytest.raises(ValueError, match="whole number"):
        sim.advance(0.0031)


def test_steps_go_on_only():
    sim, _, _ = tossed()
    with pytest.raises(ValueError, match="-1 steps: at least 0 are wanted"):
        sim.step(-1)
    with pytest.raises(ValueError, match="-2 steps"):
        sim.run([3, 1])
    assert sim.state().step == 3


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_a_state_is_taken_as_it_is_given(gradient):
    """``mls`` has one matrix for C and L: C counts."""
    sim, x, v = tossed(gradient=gradient)
    C, L = (np.tile(a * np.eye(3), (len(x), 1, 1)) for a in (1.0, 9.0))
    sim.reset(x, v, C=C, L=L)
    np.testing.assert_array_equal(sim.state().C, C)
    np.testing.assert_array_equal(sim.state().L, C if gradient == "mls" else L)
    sim.restore(replace(sim.state(), C=2.0 * C))
    np.testing.assert_array_equal(sim.state().C, 2.0 * C)


@pytest.mark.parametrize("kind", ["separate", "slip", "stick"])
def test_gravity_knows_no_mass_that_is_added_to_nodes(kind):
    """Nor does a wall that is far away change that."""
    settings = {"gravity": (0.0, 0.0, -9.81), "mass_eps": 0.1}
    sim, x, _ = tossed(walls=(Wall(0, -1, 0.2, kind),), **settings)
    sim.reset(x, np.zeros_like(x))
    sim.step()
    assert sim.v[:, 2] == pytest.approx(-9.81 * sim.dt)


def test_step_without_any_dt_is_refused():
    sim, _, _ = tossed(dt=None)
    with pytest.raises(ValueError, match="dt"):
        sim.step()


def test_blow_up_names_the_time_step():
    limit = stable_dt(LAWS["neo-hookean"], SOFT, DENSITY, 0.1, cfl=1.0)
    sim, _, _ = tossed(dt=8 * limit)
    with pytest.raises(BlowUp, match=r"step \d+: particle \d+ .* time step .* exceeds") as error:
        sim.step(400)
    assert f"{8 * limit:.3g} s" in str(error.value)


def test_blow_up_is_seen_where_particles_are_held():
    limit = stable_dt(LAWS["neo-hookean"], SOFT, DENSITY, 0.1, cfl=1.0)
    sim, _, _ = tossed(dt=8 * limit, margin=2.0)
    with pytest.raises(BlowUp):
        sim.step(2000)


def test_blow_up_names_the_step_and_particle_that_left():
    sim, x, _ = tossed(dt=2e-3)
    speed, end = 4.0, (15 - 1.5) * 0.1
    sim.reset(x, np.tile([speed, 0.0, 0.0], (len(x), 1)))
    left = np.floor((end - x[:, 0]) / (speed * 2e-3)).astype(int) + 1
    step = left.min()
    first = int(np.flatnonzero(left == step)[0])
    sim.step(step - 1)
    with pytest.raises(BlowUp, match=f"step {step}: particle {first} .* wall is missing"):
        sim.step()
    with pytest.raises(BlowUp):
        sim.step()
    sim.reset(x, np.zeros_like(x))
    sim.step()


def test_what_single_precision_cannot_hold_is_refused():
    x = lattice((2, 2, 2), 0.05) + 0.3
    body = Body(x, np.full(8, 1e-4), DENSITY)
    made = Simulation(Solver(0.1, (8, 8, 8), 1e-3), LAWS["fixed-corotated"], body)
    with pytest.raises(ValueError, match=r"a parameter of 1e\+39 is more than float32 holds"):
        made.set_material({"mu": 1e4, "lam": 1e39})


def test_no_material_is_refused():
    solver = Solver(0.1, (8, 8, 8), 1e-3, precision="float64")
    x = lattice((2, 2, 2), 0.05) + 0.3
    sim = Simulation(solver, LAWS["neo-hookean"], Body(x, np.full(8, 1e-4), DENSITY))
    with pytest.raises(ValueError, match="material"):
        sim.step()
    with pytest.raises(ValueError, match="kappa"):
        sim.set_material({"C10": 1.0})


@pytest.mark.parametrize("device", DEVICES)
def test_float32_agrees_with_float64(device):
    exact, _, _ = tossed(walls=WALLED)
    rough, _, _ = tossed(walls=WALLED, precision="float32", device=device)
    exact.step(100)
    rough.step(100)
    error = np.max(np.abs(rough.x - exact.x))
    # 100 steps each add a rounding of positions of order one
    assert error < 100 * 2.0**-24
