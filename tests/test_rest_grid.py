"""The grid over the rest shape of a solid, and particles that are boxes."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from form_drake.laws import LAWS, law_named
from form_drake.material import Material
from form_drake.mpm.bodies import block
from form_drake.mpm.exchange import Scene, region_around
from form_drake.mpm.simulation import BlowUp, Body, Simulation
from form_drake.mpm.solids import Solid
from form_drake.mpm.tools import Motions, Tool
from form_drake.records.solver import Solver, Wall

DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))
DX = 5e-3
SOFT = {"mu": 30.8e3, "lam": 46.2e3}


def stamped(size, *, total, spacing=DX / 2, depth=0.1, times=3):
    """A block on a floor that holds it, stamped on by a plate and left; where it ends, the first force on the plate."""
    body = block(np.array([0.0, 0.0, 0.5 * size[2]]), size, spacing, 1000.0)
    room = 0.0 if total else 0.02
    box = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * size
    tools = [Tool("floor", Solid.half_space(), "tied" if total else "stick", plate=total)]
    tools += [Tool("plate", Solid.half_space(), plate=total)]
    scene = Scene(
        [Material(LAWS["fixed-corotated"], SOFT, 1000.0)],
        [body],
        tools,
        region=box + room * np.array([[-1.0], [1.0]]),
        dx=DX,
        gravity=np.zeros(3),
        gradient="mls",
        total=total,
    )
    turn = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])])
    speed = depth * size[2] / 0.05

    def where(high, v):
        p, v = ([[0.0, 0.0, 0.0], [0.0, 0.0, a]] for a in (high, v))
        return Motions(np.array(p), turn, np.array(v), np.zeros((2, 3)))

    scene.tie(where(size[2], 0.0))
    end = first = scene.advance(scene.start(), where(size[2], 0.0), 0.05, 200.0)
    for _ in range(times):
        for way in (-1.0, 1.0):
            for n in range(25):
                high = size[2] - speed * 0.002 * (n if way < 0.0 else 25 - n)
                end = scene.advance(end, where(high, way * speed), 0.002, 60.0)
    end = scene.advance(end, where(size[2] + 0.002, 0.0), 0.2, 100.0)
    return end.p_WQ - body.x, first.force[1, 2]


def test_over_the_rest_shape_nothing_is_left_of_a_way():
    """What crosses rows of nodes on a grid in space does not come back; on one that stays, it does."""
    size = np.array([0.0425, 0.044, 0.0345])
    gone, _ = stamped(size, total=True)
    lost, _ = stamped(size, total=False)
    assert np.sqrt(np.mean(gone**2)) < 1e-6
    assert 10.0 * np.abs(gone).max() < np.abs(lost).max()


def test_a_plate_that_touches_a_block_of_flat_particles_bears_nothing():
    """Boxes of particles fill a block, and no balls: these would reach 40 um into the plate."""
    size = np.array([0.03, 0.03, 0.0285])
    gone, force = stamped(size, total=True, spacing=2.4e-3, times=0)
    pressed = 1e-3 * SOFT["mu"] * size[0] * size[1]
    assert np.abs(gone).max() < 3e-6 and abs(force) < pressed * 1e-2


@pytest.mark.parametrize("device", DEVICES)
def test_a_turning_block_is_not_strained_over_the_rest_shape(device):
    """A quarter turn and more, about an axis that is none of the grid's."""
    cube = np.full(3, 0.03)
    body, spin = block(np.zeros(3), cube, DX / 2, 1000.0), np.array([30.0, 40.0, 20.0])
    firm = Material(LAWS["fixed-corotated"], SOFT, 1000.0)
    region = np.stack([-cube / 2, cube / 2])
    still = {"gravity": np.zeros(3), "total": True, "device": device}
    scene = Scene([firm], [body], [], region=region, dx=DX, **still)
    made, start = scene.simulation, scene.start().state
    C = np.tile(np.cross(spin, np.eye(3)).T, (len(body.x), 1, 1))
    made.reset(start.x, np.cross(spin, body.x), C=C)
    made.advance(0.04)
    F = made.state().F
    assert np.abs(F.swapaxes(1, 2) @ F - np.eye(3)).max() < 0.02  # it swells by its spin
    turned = Rotation.from_rotvec(0.04 * spin).apply(body.x)
    assert np.abs(made.x + scene.corner - turned).max() < 3e-4


@pytest.mark.parametrize("device", DEVICES)
def test_a_grip_that_turns_takes_a_strip_with_it(device):
    """By a quarter turn, about an axis beside it; then nothing of it is strained."""
    size, axis = np.array([0.015, 0.015, 0.06]), np.array([0.01, 0.0, 0.03])
    body = block(np.zeros(3), size, DX / 2, 1000.0)
    jaw = Tool("jaw", Solid.box([0.02, 0.02, 0.01]), "bonded")
    region = np.stack([-size / 2, size / 2])
    firm = Material(LAWS["fixed-corotated"], SOFT, 1000.0)
    still = {"gravity": np.zeros(3), "total": True, "device": device}
    scene = Scene([firm], [body], [jaw], region=region, dx=DX, **still)

    def where(angle, rate):
        turn = Rotation.from_rotvec([0.0, angle, 0.0])
        p = axis + turn.apply([-0.01, 0.0, 0.0])
        spin = np.array([0.0, rate, 0.0])
        return Motions(p[None], turn.as_matrix()[None], np.cross(spin, p - axis)[None], spin[None])

    with pytest.raises(ValueError, match="jaw at rest: call tie first"):
        scene.advance(scene.start(), where(0.0, 0.0), 0.002)
    scene.tie(where(0.0, 0.0))
    end, rate, steps = scene.start(), 0.5 * np.pi / 0.2, 100
    for n in range(steps):
        end = scene.advance(end, where(rate * 0.002 * n, rate), 0.002, 60.0)
    end = scene.advance(end, where(0.5 * np.pi, 0.0), 0.6, 20.0)
    turned = axis + Rotation.from_rotvec([0.0, 0.5 * np.pi, 0.0]).apply(body.x - axis)
    assert np.abs(end.p_WQ - turned).max() < 3e-4  # speeds are held, not places
    F = end.state.F[body.x[:, 2] < 0.015]
    assert np.abs(F.swapaxes(1, 2) @ F - np.eye(3)).max() < 2e-3


@pytest.mark.parametrize("device", DEVICES)
def test_what_hangs_from_a_flat_jaw_is_at_rest_where_the_jaw_ends(device):
    """Displacements of a heavy bar are exact, and the jaw bears its weight."""
    size, stiffness, pull = np.array([0.008, 0.008, 0.03]), 80e3, 40.0
    body = block(np.zeros(3), size, 2e-3, 1000.0)
    bar = Material(LAWS["fixed-corotated"], {"mu": stiffness / 2, "lam": 0.0}, 1000.0)
    jaw, ends = Tool("jaw", Solid.box([0.05, 0.05, 0.02]), "bonded"), np.stack([-size, size]) / 2
    region = region_around(ends, np.full(3, 0.004), 0.004, {2: ends[1, 2]})
    weight = {"gravity": np.array([0.0, 0.0, -pull]), "precision": "float64"}
    scene = Scene(
        [bar], [body], [jaw], region=region, dx=0.004, total=True, device=device, **weight
    )
    still = Motions.at_rest(ends[1] * [0.0, 0.0, 1.0] + [0.0, 0.0, 0.01])
    scene.tie(still)
    end = scene.advance(scene.start(), still, 0.4, 60.0)
    end = scene.advance(end, still, 2e-3)
    below = ends[1, 2] - body.x[:, 2]
    sag = 1000.0 * pull / stiffness * (size[2] * below - below**2 / 2)
    gone = end.p_WQ - body.x
    assert np.abs(gone[:, 2] + sag).max() < 2e-3 * sag.max()
    assert end.force[0] == pytest.approx(
        [0.0, 0.0, -1000.0 * pull * size.prod()], rel=1e-4, abs=1e-9
    )


@pytest.mark.parametrize("device", DEVICES)
def test_a_strip_that_a_cylinder_bends_and_holds_comes_to_rest(device):
    """Contact takes energy: the force does not go on to swing."""
    size, radius, stroke = np.array([0.042, 0.015, 0.085]), 0.01, 0.02
    body, dt, pushed = block(np.zeros(3), size, DX / np.array([4, 2, 2]), 1000.0), 1e-3, 0.25
    hand = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    tools = [
        Tool("jaw", Solid.box([0.05, 0.06, 0.025]), "bonded"),
        Tool("pusher", Solid.cylinder(radius, 0.06)),
    ]
    stiff = Material(LAWS["fixed-corotated"], {"mu": 27.6e3, "lam": 248e3}, 1000.0)
    region = region_around(np.stack([-size, size]) / 2, np.full(3, 0.03), DX, {2: size[2] / 2})
    still = {"gravity": np.zeros(3), "total": True, "device": device}
    scene = Scene([stiff], [body], tools, region=region, dx=DX, **still)

    def where(x, v=0.0):
        p = np.array([[0.0, 0.0, size[2] / 2 + 0.0125], [x, 0.0, 0.01 - size[2] / 2]])
        v_WT = np.array([[0.0, 0.0, 0.0], [v, 0.0, 0.0]])
        return Motions(p, np.stack([np.eye(3), hand]), v_WT, np.zeros((2, 3)))

    def smooth(t):
        return t * t * (3.0 - 2.0 * t)

    begin = size[0] / 2 + radius + 2e-4
    scene.tie(where(begin))
    now, forces = scene.start(), []
    ways = begin - stroke * smooth(np.minimum(np.arange(351) * dt / pushed, 1.0))
    for x, to in pairwise(ways):
        now = scene.advance(now, where(x, (to - x) / dt), dt)
        forces.append(now.force[1, 0])
    held = np.array(forces[int(pushed / dt) :])
    assert held[50:].std() < 0.05 * held.mean()


@pytest.mark.parametrize("device", DEVICES)
def test_what_is_viscous_lags_too_little_to_be_seen(monkeypatch, device):
    """Diffusion alone would allow an eighth of the acoustic step; springs in series allow a third of it."""
    cube, law = np.full(3, 0.02), law_named("fixed-corotated+damping")
    body = block(np.zeros(3), cube, DX / 2, 1000.0)
    material = Material(law, {**SOFT, "eta": 400.0}, 1000.0)
    region, free = np.stack([-cube / 2, cube / 2]), {"gravity": np.zeros(3), "total": True}
    sheared = np.eye(3)
    sheared[0, 2] = 0.05

    def creeping():
        """Shear of a free block that was let go of, and steps."""
        scene = Scene([material], [body], [], region=region, dx=DX, device=device, **free)
        made, start = scene.simulation, scene.start().state
        F = np.tile(sheared, (len(body.x), 1, 1))
        made.reset(start.x + body.x @ (sheared - np.eye(3)).T, 0.0 * start.x, F=F, T=F)
        told = []
        for _ in range(10):
            made.advance(1e-3)
            told.append(np.mean(made.state().F[:, 0, 2] + made.state().F[:, 2, 0]))
        return np.array(told), made.state().step

    shear, steps = creeping()
    monkeypatch.setattr("form_drake.mpm.model.SLOWER", 1e3)
    exact, most = creeping()
    assert exact[-1] < 0.6 * exact[0]
    assert 2.3 * steps < most
    assert np.abs(shear - exact)[3:].max() < 0.01 * exact[0]  # 3 ms are three lags


def test_a_grid_over_the_rest_shape_meets_no_walls():
    solver = Solver(dx=DX, nodes=(16, 16, 16), walls=(Wall(2, -1, 4 * DX),))
    body = block(np.full(3, 0.04), np.full(3, 0.03), DX / 2, 1000.0)
    with pytest.raises(ValueError, match="meets no walls"):
        Simulation(solver, LAWS["fixed-corotated"], body, total=True)


@pytest.mark.parametrize("counts", [None, (8, 5, 3), (5, 17, 3), (3, 5, 21), (11, 2, 2)])
def test_eight_particles_at_a_time_give_what_one_at_a_time_gives(counts):
    """Single precision on the CPU goes by lines of particles, double precision by particles."""
    rng = np.random.default_rng(3)
    x = 0.02 + 0.02 * rng.random((300, 3))  # in no line
    nodes = (12, 12, 12)
    if counts is not None:
        x = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
        x = rng.permutation(0.75 * DX + x * np.array([0.57, 0.5, 0.41]) * DX)
        nodes = tuple(max(int(n) + 3, 4) for n in np.floor(x.max(axis=0) / DX - 0.5))  # no more
    count = len(x)
    body = Body(x, np.full(count, 2.7e-8), 900.0 + 200.0 * rng.random(count))
    velocity = 2.0 * rng.normal(size=x.shape)
    ends = {}
    for precision in ("float32", "float64"):
        solver = Solver(dx=DX, nodes=nodes, gradient="mls", precision=precision, walls=())
        made = Simulation(solver, LAWS["fixed-corotated"], body, total=True)
        made.set_material(SOFT)
        made.reset(x, velocity)
        made.advance(0.004)
        ends[precision] = made.state()
    one, other = ends.values()
    for name in ("x", "v", "C", "L", "F", "T", "tau"):
        exact = getattr(other, name)
        assert np.abs(getattr(one, name) - exact).max() < 1e-4 * np.abs(exact).max(), name


def test_a_particle_that_leaves_is_named():
    """A body thrown away by far is a break-down, whatever steps it."""
    x = 0.02 + 0.01 * np.random.default_rng(0).random((20, 3))
    solver = Solver(dx=DX, nodes=(12, 12, 12), gradient="mls", dt=1.0, walls=())
    made = Simulation(solver, LAWS["fixed-corotated"], Body(x, np.full(20, 1e-8), 1e3), total=True)
    made.set_material(SOFT)
    made.reset(x, np.full_like(x, 1e7))
    with pytest.raises(BlowUp, match=r"step 1: particle \d+ left the domain"):
        made.step()


def test_a_body_that_flies_apart_is_stopped_near_by():
    """And its material is named among the causes."""
    x = 0.02 + 0.01 * np.random.default_rng(0).random((20, 3))
    solver = Solver(dx=DX, nodes=(12, 12, 12), gradient="mls", dt=1e-2, walls=())
    made = Simulation(solver, LAWS["fixed-corotated"], Body(x, np.full(20, 1e-8), 1e3), total=True)
    made.set_material({key: 0.0 for key in SOFT})
    made.reset(x, np.full_like(x, 10.0))
    made.step(9)
    with pytest.raises(BlowUp, match=r"left the domain .* its material is unstable"):
        made.step(3)
