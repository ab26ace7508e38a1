"""Solver physics against balances and symmetries; its states, its steps, and what it refuses."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from form_drake.laws import LAWS
from form_drake.mpm.simulation import BlowUp, Body, Simulation, stable_dt
from form_drake.records.solver import GRADIENTS, Solver, Wall
from helpers.solver import DENSITY, DEVICES, SOFT, lattice, simulation

GRAVITY = np.array([1.0, -2.0, -9.81])


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


def test_number_of_nodes_is_bounded():
    Solver(0.1, (1000, 1000, 100))
    with pytest.raises(ValueError, match="at most 1e8 nodes"):
        Solver(0.1, (1000, 1000, 101))


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
