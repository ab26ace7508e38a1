"""Rigid tools in the material point method: impulses, friction, holding."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.laws import LAWS
from form_drake.material import Material
from form_drake.mpm.bodies import block
from form_drake.mpm.exchange import Scene
from form_drake.mpm.model import stable_dt
from form_drake.mpm.simulation import Simulation
from form_drake.mpm.solids import Solid
from form_drake.mpm.tools import Grip, Motions, Tool
from form_drake.records.solver import Solver

DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))
DX = 5e-3
SIZE = np.array([0.03, 0.03, 0.025])
SOFT = {"mu": 30.8e3, "lam": 46.2e3}
G = 9.81


def pressed(tools, motion, *, steps, device="cpu", law="fixed-corotated", values=SOFT, v=None):
    """A block among tools on a fine step; the simulation and its momentum over the steps."""
    n = (48, 16, 16)
    centre = np.array([0.04, 0.04, 0.02 + SIZE[2] / 2])
    body = block(centre, SIZE, DX / 2, 1000.0)
    dt = 0.5 * stable_dt(LAWS[law], values, 1000.0, DX)
    solver = Solver(dx=DX, nodes=n, dt=dt, precision="float64", gravity=(0.0, 0.0, -G))
    made = Simulation(solver, LAWS[law], body, tools=tools, device=device)
    made.set_material(values)
    made.reset(body.x, np.zeros_like(body.x) if v is None else np.tile(v, (len(body.x), 1)))
    made.tools.move(motion)
    made.step(steps)
    return made


def at(*places, **velocity):
    made = Motions.at_rest(places)
    return replace(made, **{k: np.asarray(v, dtype=float) for k, v in velocity.items()})


FLOOR = (0.0, 0.0, 0.02)


@pytest.mark.parametrize("device", DEVICES)
def test_momentum_with_tools(device):
    """What the material gains, its tools lose; angular momentum too, about any point."""
    tools = (
        Tool("floor", Solid.half_space(), 0.4),
        Tool("ball", Solid.sphere(0.01), "stick"),
        Tool("clamp", Solid.box([0.01, 0.05, 0.05]), "bonded"),
    )
    place = [FLOOR, (0.045, 0.04, 0.053), (0.055, 0.04, 0.035)]
    moving = at(
        *place,
        v_WT=[[0, 0, 0], [0.05, 0, -0.2], [0.1, 0.0, 0.05]],
        w_WT=[[0, 0, 0], [3.0, -5.0, 2.0], [0.0, 2.0, 0.0]],
    )
    made = pressed(tools, moving, steps=60, device=device)
    mass, duration = made.body.mass, 60 * made.dt
    momentum = (mass[:, None] * made.v).sum(axis=0)
    given, _ = made.tools.impulses()
    weight = mass.sum() * duration * np.array([0.0, 0.0, -G])
    scale = np.abs(given).max()
    assert np.all(np.abs(given).max(axis=1) > 1e-3 * scale)  # every tool does touch
    assert momentum + given.sum(axis=0) - weight == pytest.approx(0.0, abs=1e-12 * scale)


def test_moment_is_taken_about_the_origin_of_the_tool():
    """The same floor stated with its origin elsewhere has the moment that the shift makes."""
    moved = np.array([0.03, -0.02, 0.02])
    moments, forces = [], []
    for origin in (np.array(FLOOR), moved):
        made = pressed((Tool("floor", Solid.half_space(), 0.5),), at(origin), steps=40)
        force, moment = made.tools.impulses()
        forces.append(force[0])
        moments.append(moment[0])
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)
    shifted = moments[0] + np.cross(np.array(FLOOR) - moved, forces[0])
    assert moments[1] == pytest.approx(shifted, rel=1e-6, abs=1e-9 * np.abs(moments[0]).max())


@pytest.mark.parametrize("mu", [0.0, 0.2, 0.5])
def test_sliding_block_is_slowed_by_coulomb(mu):
    """Deceleration mu g of a block that slides on the floor, from its momentum."""
    made = pressed((Tool("floor", Solid.half_space(), mu),), at(FLOOR), steps=0, v=[1.0, 0.0, 0.0])
    made.step(200)
    before = made.v[:, 0].mean()
    made.step(600)
    slowed = (before - made.v[:, 0].mean()) / (600 * made.dt)
    assert slowed == pytest.approx(mu * G, rel=0.05, abs=1e-9)


def test_stick_holds_on_a_slope():
    """Gravity along the surface: a sticking floor holds the block, a smooth one lets it go."""
    speeds = {}
    for contact in (0.0, "stick"):
        tools = (Tool("floor", Solid.half_space(), contact),)
        made = pressed(tools, at(FLOOR), steps=0)
        made._clock.assign(np.array([[made.dt, 0.3 * G, 0.0, -G]]))
        made.step(800)
        speeds[contact] = made.v[:, 0].mean()
    assert speeds[0.0] == pytest.approx(0.3 * G * 800 * made.dt, rel=0.02)
    assert abs(speeds["stick"]) < 0.02 * speeds[0.0]


def scene(tau_y, shift=(0.0, 0.0), **options):
    """A block between plate and floor, the grid shifted by parts of a cell in x and z."""
    dx = 2.5e-3
    off = dx * np.array([shift[0], 0.0, shift[1]])
    centre = np.array([0.0, 0.0, SIZE[2] / 2])
    E, nu = 80e3, 0.3
    law = LAWS["von-mises"]
    values = {"mu": E / (2 + 2 * nu), "lam": E * nu / ((1 + nu) * (1 - 2 * nu)), "tau_y": tau_y}
    tools = (Tool("plate", Solid.box([0.064, 0.064, 0.006])), Tool("floor", Solid.half_space()))
    return Scene(
        [Material(law, values, density=1000.0)],
        [block(centre, SIZE, 1.25e-3, 1.0)],
        tools,
        region=np.array([[-0.03, -0.03, -0.002], [0.03, 0.03, 0.03]]) - off,
        dx=dx,
        gravity=np.array([0.0, 0.0, -G]),
        mass_scale=40.0,
        **options,
    )


def press(made, opening, speed, tick=2e-3):
    """Plate force [N] when the opening [m] is reached from the rest height."""
    snapshot = made.start()
    gap = SIZE[2] + 2e-4
    forces = []
    while gap > opening:
        motion = at((0, 0, gap + 0.003), (0, 0, 0), v_WT=[[0, 0, -speed], [0, 0, 0]])
        snapshot = made.advance(snapshot, motion, tick)
        gap -= speed * tick
        forces.append(snapshot.force[:, 2])
    return np.array(forces), snapshot


def test_yielding_block_against_the_closed_form():
    """Frictionless press beyond yield: sqrt(3/2) tau_y V / H wherever the grid lies.

    The floor carries the weight besides.
    """
    tau_y, forces = 10e3, []
    H = 0.0195 + 0.03 * 2e-3 * 6
    for shift in ((0.0, 0.0), (0.5, 0.25), (0.25, 0.5), (0.0, 0.75)):
        history, _ = press(scene(tau_y, shift), 0.0195, 0.03)
        plate, floor = history[-12:].mean(axis=0)
        assert plate == pytest.approx(np.sqrt(1.5) * tau_y * SIZE.prod() / H, rel=0.04)
        assert -floor == pytest.approx(plate + 1000.0 * SIZE.prod() * G, rel=0.03)
        forces.append(plate)
    assert np.ptp(forces) < 0.03 * np.mean(forces)


def test_snapshots_replay_bit_for_bit():
    made = scene(1e3)
    motion = at((0, 0, SIZE[2] + 0.0028), (0, 0, 0), v_WT=[[0, 0, -0.05], [0, 0, 0]])
    first = made.advance(made.start(), motion, 4e-3)
    second = made.advance(first, motion, 4e-3)
    made.advance(second, motion, 4e-3)
    again = made.advance(first, motion, 4e-3)
    assert np.array_equal(again.p_WQ, second.p_WQ)
    assert np.array_equal(again.force, second.force)


def test_overlap_and_region_are_said():
    made = scene(1e3)
    deep = made.overlaps(at((0, 0, SIZE[2] + 0.002), (0, 0, 0)))
    assert deep == {"plate": pytest.approx(1e-3, abs=1e-9)}
    body = block((0.0, 0.0, 0.05), SIZE, 2.5e-3, 1.0)
    with pytest.raises(ValueError, match="enlarge the region"):
        Scene(
            [], [body], (), region=np.array([[-0.1] * 3, [0.05] * 3]), dx=5e-3, gravity=np.zeros(3)
        )


@pytest.mark.parametrize("total", [False, True])
def test_drag_slows_a_fall_that_no_tool_stops(total):
    """v = -g / c (1 - exp(-c t)), of a block that meets nothing."""
    body = block((0.0, 0.0, 0.0), SIZE, DX / 2, 1000.0)
    made = Scene(
        [Material(LAWS["fixed-corotated"], SOFT, 1000.0)],
        [body],
        (),
        region=np.array([[-0.05] * 3, [0.05] * 3]),
        dx=DX,
        gravity=np.array([0.0, 0.0, -G]),
        drag=20.0,
        total=total,
        precision="float64",
    )
    still = Motions.at_rest(np.empty((0, 3)))
    end = made.advance(made.start(), still, 0.04, damping=10.0)
    speed = -G / 30.0 * (1.0 - np.exp(-30.0 * 0.04))
    assert end.state.v[:, 2] == pytest.approx(speed, rel=0.01)  # of first order in the step


def test_two_bodies_push_each_other():
    """Two blocks of two laws fall onto each other; both keep their law and momentum is kept."""
    laws = (LAWS["fixed-corotated"], LAWS["neo-hookean"])
    bodies = [
        block((0.04, 0.04, z), (0.02, 0.02, 0.02), DX / 2, rho)
        for z, rho in ((0.025, 1000.0), (0.055, 500.0))
    ]
    solver = Solver(dx=DX, nodes=(16, 16, 24), dt=1e-4, precision="float64", gravity=(0, 0, 0))
    made = Simulation(solver, laws, bodies)
    made.set_material(SOFT, 0)
    made.set_material({"C10": 15e3, "kappa": 70e3}, 1)
    v = np.zeros_like(made.body.x)
    v[len(bodies[0].x) :, 2] = -0.5
    made.reset(made.body.x, v)
    start = (made.body.mass[:, None] * v).sum(axis=0)
    made.step(400)
    momentum = (made.body.mass[:, None] * made.v).sum(axis=0)
    assert momentum == pytest.approx(start, abs=1e-12)
    lower = made.v[: len(bodies[0].x), 2].mean()
    assert lower < -0.05  # was pushed


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Tool("t", Solid.sphere(1.0), -0.1), "coefficient of at least 0"),
        (lambda: Tool("t", Solid.sphere(1.0), "glue"), "0, stick and bonded"),
        (lambda: Tool("t", Solid.half_space(), "tied"), "tool t: only a plate ties"),
        (lambda: Tool("t", Solid.sphere(1.0), plate=True), "a plate is a half-space, not a sphere"),
        (lambda: Solid.sphere(0.0), "positive"),
        (lambda: Solid("cone"), "choose one of"),
        (lambda: Solid.mesh(np.eye(3) * 100, [[0, 1, 2]], 1e-3), "larger spacing"),
    ],
)
def test_bad_tools_are_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def rested(contact, grip, gravity, below=0.0):
    """A block on a half-space after a third of a second of calming; how far it has gone [m], and the force."""
    body = block(np.array([0.0, 0.0, 0.5 * SIZE[2]]), SIZE, DX / 2, 1000.0)
    region = np.stack([body.x.min(0) - 0.02, body.x.max(0) + 0.02])
    floor = Tool("floor", Solid.half_space(), contact, plate=True)
    soft = Material(LAWS["fixed-corotated"], SOFT, 1000.0)
    over = {"gravity": np.array(gravity), "total": True}
    scene = Scene([soft], [body], [floor], region=region, dx=DX, **over)
    still = Motions.at_rest(np.array([[0.0, 0.0, below]]))
    scene.tie(still)
    scene.simulation.tools.grip(0, grip)
    end = scene.advance(scene.start(), still, 0.33, 60.0)
    first = body.x[:, 2] < body.x[:, 2].min() + 1e-9
    return end.p_WQ - body.x, scene.advance(end, still, 0.02, 60.0).force[0], first


def test_a_layer_shears_as_its_compliance_says():
    """The traction of the block's weight, which acts sideways, times the compliance."""
    compliance = 2e-6
    gone, force, first = rested("tied", Grip(compliance=compliance), [2.0, 0.0, 0.0])
    traction = 1000.0 * SIZE[2] * 2.0
    assert force[0] == pytest.approx(traction * SIZE[0] * SIZE[1], rel=0.02)
    firm, _, _ = rested("tied", Grip(), [2.0, 0.0, 0.0])
    slid = (gone - firm)[first, 0].mean()
    assert slid == pytest.approx(compliance * traction, rel=0.03)


def test_a_tied_face_stays_where_it_was_tied():
    """The middle of the first layer then goes by what half of the layer shears."""
    gone, force, first = rested("tied", Grip(), [2.0, 0.0, 0.0])
    traction = force[0] / (SIZE[0] * SIZE[1])
    sheared = traction * (DX / 4.0) / SOFT["mu"]
    assert gone[first, 0].mean() == pytest.approx(sheared, rel=0.1)


@pytest.mark.parametrize("strength, holds", [(300.0, True), (20.0, False)])
def test_adhesion_bears_a_block_that_weighs_less(strength, holds):
    """Gravity pulls a block off the surface by 50 Pa of traction."""
    gone, force, _ = rested(0.0, Grip(0.0, adhesion=strength), [0.0, 0.0, 2.0])
    assert bool(gone[:, 2].max() < 1e-3) is holds
    wanted = 1000.0 * SIZE.prod() * 2.0 if holds else 0.0
    assert force[2] == pytest.approx(wanted, rel=0.02, abs=1e-6)


def test_a_branch_with_its_tools_is_bit_for_bit():
    floor = Tool("floor", Solid.half_space(), 0.4)
    coming = replace(at([0.04, 0.04, 0.0201]), v_WT=np.array([[0.0, 0.0, 0.1]]))
    made = pressed([floor], coming, steps=5)
    state, there = made.state(), made.tools.motions
    ends = []
    for _ in range(2):
        made.restore(state)
        made.tools.move(there)
        made.step(10)
        ends.append(made.x)
    np.testing.assert_array_equal(*ends)
    assert there.p_WT[0, 2] > 0.0201


def test_an_impulse_where_a_tool_touches_is_taken_there():
    """What friction gives to the material's angular momentum, the tool's moment loses."""
    body = block(np.array([0.04, 0.04, 0.02 + SIZE[2] / 2]), SIZE, DX / 2, 1000.0)
    dt = 0.2 * stable_dt(LAWS["fixed-corotated"], SOFT, 1000.0, DX)
    solver = Solver(dx=DX, nodes=(32, 16, 16), dt=dt, precision="float64", gravity=(0.0,) * 3)
    tool = Tool("floor", Solid.half_space(), 0.4)
    made = Simulation(solver, LAWS["fixed-corotated"], body, tools=[tool])
    made.set_material(SOFT)
    made.reset(body.x, np.tile([0.3, 0.0, -0.2], (len(body.x), 1)))
    made.tools.move(Motions.at_rest(np.array([[0.0, 0.0, 0.0201]])))

    def spin(state, mass=body.mass):
        """Of particles and their affine motion, about the origin."""
        own = np.cross(state.x, state.v) * mass[:, None]
        D = DX**2 / 4.0
        skew = np.stack([state.C[:, k - 1, k - 2] - state.C[:, k - 2, k - 1] for k in range(3)], 1)
        return (own + D * mass[:, None] * skew).sum(0)

    before = spin(made.state())
    made.step(20)
    gained, moment = spin(made.state()) - before, made.tools.impulses()[1][0]
    # the tool's origin stands above that of the grid
    moment = moment + np.cross([0.0, 0.0, 0.0201], made.tools.impulses()[0][0])
    assert np.abs(moment).max() > 1e-6
    assert gained == pytest.approx(-moment, rel=1e-6, abs=1e-12)
