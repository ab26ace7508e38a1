"""Flat plates at the faces of a body over its rest shape."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from form_drake.diagnose.motions import Block
from form_drake.effects import CATALOGUE, World
from form_drake.laws import LAWS, law_named
from form_drake.material import Material
from form_drake.mpm import settling, simulation, stage, ways
from form_drake.mpm.bodies import block
from form_drake.mpm.exchange import Scene
from form_drake.mpm.pace import Pace
from form_drake.mpm.pencils import Pencils
from form_drake.mpm.plates import Face
from form_drake.mpm.solids import Solid
from form_drake.mpm.stage import Stage
from form_drake.mpm.tools import Grip, Motions, Tool
from form_drake.records import Stream

DX, SIZE = 5e-3, np.array([0.02, 0.025, 0.03])
SOFT = {"mu": 20e3, "lam": 30e3}
DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))


def standing(
    contact, *, grip=None, spacing=DX / 2, gravity=(0.0, 0.0, 0.0), device="cpu", **options
):
    """A block on a plate, and where the plate is."""
    body = block(np.array([0.0, 0.0, 0.5 * SIZE[2]]), SIZE, spacing, 1000.0)
    floor = Tool("floor", Solid.half_space(), contact, plate=True)
    region = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * SIZE
    soft = Material(LAWS["fixed-corotated"], SOFT, 1000.0)
    still = {"gravity": np.array(gravity), "total": True, "device": device, **options}
    scene = Scene([soft], [body], [floor], region=region, dx=DX, **still)
    rest = Motions.at_rest(np.zeros(3))
    scene.tie(rest)
    if grip is not None:
        scene.simulation.tools.grip(0, grip)
    return scene, rest


def thrown(scene, v):
    """The block at rest in its shape, moving [m/s]."""
    start, made = scene.start(), scene.simulation
    made.reset(start.state.x, np.tile(v, (len(scene.rest), 1)))
    return type(start)(made.state(), start.force, start.moment, start.p_WQ)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("contact", ["tied", 0.3])
def test_what_a_plate_gives_it_is_given(contact, device):
    """Momentum of the block and of the plate, to round-off; the plate turns and goes on."""
    scene, rest = standing(contact, precision="float64", device=device)
    begin, mass = thrown(scene, [0.4, 0.1, -0.3]), scene.simulation.body.mass
    way = Motions(rest.p_WT, rest.R_WT, np.array([[0.0, 0.1, 0.05]]), np.array([[1.0, 2.0, 0.5]]))
    end = scene.advance(begin, way, 0.01)
    gained = mass @ (end.state.v - begin.state.v)
    assert np.abs(gained).max() > 1e-4
    assert gained == pytest.approx(-0.01 * end.force[0], rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("spacing", [DX / 2, DX / 3, DX / 4])
def test_ends_of_particles_go_where_a_plate_goes(spacing):
    """By a turn and a way, whatever the number of particles in a cell."""
    scene, rest = standing("tied", spacing=spacing, precision="float64")
    now, steps, dt = scene.start(), 40, 5e-4
    turn = Rotation.from_rotvec([0.0, 0.02, 0.03])
    R, p = rest.R_WT[0], np.zeros(3)
    for _ in range(steps):
        w = turn.as_rotvec() / (steps * dt)
        way = Motions(p[None], R[None], np.array([[0.1, 0.0, 0.0]]), w[None])
        now = scene.advance(now, way, dt)
        R, p = Rotation.from_rotvec(w * dt).as_matrix() @ R, p + dt * way.v_WT[0]
    layer = scene.rest[:, 2] < scene.rest[:, 2].min() + 1e-9
    down = np.array([0.0, 0.0, -scene.simulation.body.half[0, 2]])
    ends = now.p_WQ + now.state.T @ down
    wanted = (scene.rest + down) @ R.T + p
    assert np.abs(ends - wanted)[layer].max() < 1e-6


def test_a_plate_gives_a_block_no_energy():
    """A heavy block sways on what holds it for two dozen periods, each weaker than the one before."""
    scene, rest = standing("tied", gravity=(9.81, 0.0, 0.0))
    now, ways = scene.start(), []
    for _ in range(900):
        now = scene.advance(now, rest, 1e-3)
        ways.append((now.p_WQ - scene.rest)[:, 0].mean())
    swing = [np.ptp(part) for part in np.array_split(ways, 6)]
    assert swing[0] > 5e-4 and np.all(np.diff(swing) < 1e-3 * swing[0])


def test_what_is_held_stays_where_it_is_held(monkeypatch):
    """Under a plate that goes down and up, for sixteen thousand steps in single precision."""
    monkeypatch.setattr(simulation, "REST", 0.4)  # more steps than are needed
    size = (0.042, 0.0335, 0.0335)
    pressed = Block(size=size, points=60).press("frictionless")
    law, values = LAWS["neo-hookean"], {"C10": 18.4e3, "kappa": 226e3}
    plain = World(law, values, pressed.density, np.array([0.0, 0.0, -9.81]))
    play = Stage(pressed, size[1] / 4.0)._set(plain)
    (*_, last), _, _ = play._run
    rest, down = play.scene.rest, np.array([0.0, 0.0, -play.scene.simulation.body.half[0, 2]])
    layer = rest[:, 2] < rest[:, 2].min() + 1e-9
    gone = (last.p_WQ + last.state.T @ down - rest - down)[layer]
    assert last.state.step > 15000 and np.abs(gone).max() < 4e-6


def test_what_was_pressed_stands_again_as_before():
    """Once the plate has left: stresses that the grid hardly sees do not hold it in another shape."""
    size, law = (0.042, 0.0335, 0.0335), law_named("neo-hookean+damping")
    material = {"C10": 19.3e3, "kappa": 120e3, "eta": 150.0}
    plain = World(law, material, 1000.0, np.array([0.0, 0.0, -9.81]))
    one = Block(size=size, points=200)
    pressed, alone = one.press("frictionless", 1.2, opens=True), one.shake()
    came, stood = (Stage(r, size[1] / 5.0).rolled(plain).p_WQ for r in (pressed, alone))
    sunk = (stood[0] - alone.reference)[:, 2]
    assert -60e-6 < sunk.min() < -40e-6
    assert np.abs(came[-1] - stood[0]).max() < 1e-7


def test_longer_steps_press_as_shorter_ones(monkeypatch):
    """Nothing is pushed by a depth: forces lag by no more than a step, a hundredth of this press."""
    scene, _ = standing("tied")
    half, found = Tool("plate", Solid.half_space(), plate=True), []
    region = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * SIZE
    body = replace(scene.simulation.body, x=scene.rest)
    soft = Material(LAWS["fixed-corotated"], SOFT, 1000.0)
    turn = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])])
    for cfl in (0.4, 0.1):
        both = [*scene.tools, half]
        made = Scene([soft], [body], both, region=region, dx=DX, gravity=np.zeros(3), total=True)
        limit = made.simulation.pace.stable(cfl=cfl)
        monkeypatch.setattr(made.simulation.pace, "stable", lambda limit=limit: limit)
        now, dt, forces = made.start(), 1e-3, []
        for n in range(60):
            p = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, SIZE[2] - 0.03 * dt * n]])
            v = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.03]])
            way = Motions(p, turn, v, np.zeros((2, 3)))
            if not n:
                made.tie(way)
                now = made.start()
            now = made.advance(now, way, dt)
            forces.append(now.force[1, 2])
        found.append(np.array(forces))
    assert np.abs(found[0] - found[1]).max() < 0.02 * found[1].max()
    assert found[0].mean() == pytest.approx(found[1].mean(), rel=1e-2)


def test_forces_of_long_steps_are_those_of_short_ones(monkeypatch):
    """They are stamped when their stresses were; by the middle of their steps they would be 0.3 % off."""
    pressed = Block(size=(0.02, 0.025, 0.03), points=60).press("bonded", 0.6)
    plain = World(LAWS["neo-hookean"], {"C10": 18e3, "kappa": 90e3}, 1000.0, np.zeros(3))
    found = []
    for cfl in (simulation.REST, 0.15):
        monkeypatch.setattr(simulation, "REST", cfl)
        found.append(next(iter(Stage(pressed, DX).rolled(plain).forces.values())).value)
    assert np.abs(found[0] - found[1]).max() < 1.5e-3 * np.abs(found[1]).max()


def test_how_many_steps_what_is_viscous_makes_moves_no_elastic_body(monkeypatch):
    """Velocities that particles give nodes anew are lost by the time and not by the step."""
    pressed = Block(points=60).press("bonded", 0.8)
    plain = World(LAWS["neo-hookean"], {"C10": 8.2e3, "kappa": 6.3e4}, 1000.0, np.zeros(3))
    found, stable = [], Pace.stable
    for share in (1.0, 0.25):
        monkeypatch.setattr(Pace, "stable", lambda self, *a, share=share: share * stable(self, *a))
        found.append(Stage(pressed, 8.4e-3).rolled(plain).p_WQ)
    assert np.abs(found[0] - found[1]).max() < 5e-7  # 7e-6 if by the step


def test_long_steps_stand_a_deep_press(monkeypatch):
    """Of a body that yields and keeps its volume, stiffest to waves of pressure."""
    pressed = Block(size=(0.03, 0.03, 0.025), points=60).press("frictionless", 0.6, depth=0.3)
    values = {"mu": 16e3, "lam": 200e3, "tau_y": 1e3}
    plain = World(LAWS["von-mises"], values, 1000.0, np.array([0.0, 0.0, -9.81]))
    found = []
    for cfl in (simulation.REST, 0.3):
        monkeypatch.setattr(simulation, "REST", cfl)
        found.append(Stage(pressed, DX).rolled(plain).p_WQ)
    assert np.abs(found[0] - found[1]).max() < 1e-4


def test_friction_slows_what_slides():
    """By the coefficient times gravity."""
    scene, rest = standing(0.2, gravity=(0.0, 0.0, -9.81))
    now = scene.advance(scene.start(), rest, 0.2, 200.0)
    state, mass = now.state, scene.simulation.body.mass
    thrown = {"v": state.v + np.array([0.3, 0.0, 0.0]), "grid": np.zeros((0, 3))}
    going = replace(now, state=replace(state, **thrown))
    later = scene.advance(going, rest, 0.1)
    slowed = (mass @ (going.state.v - later.state.v))[0] / mass.sum()
    assert slowed == pytest.approx(0.2 * 9.81 * 0.1, rel=0.03)


@pytest.mark.parametrize(("friction", "gained"), [(0.5, 0.0), (0.2, 3.0 - 0.2 * 9.81)])
def test_what_is_tied_slides_where_friction_holds_no_more(friction, gained):
    """On a floor that speeds up: by what its acceleration of 3 m/s^2 has beyond friction."""
    scene, rest = standing("tied", gravity=(0.0, 0.0, -9.81))
    made, begin = scene.simulation, scene.advance(scene.start(), rest, 0.2, 200.0)
    made.tools.grip(0, Grip(friction, compliance=1e-9))

    def moved(now, steps):
        for n in steps:
            way = np.array([[-1.5e-6 * n**2, 0.0, 0.0]]), np.array([[-3e-3 * (n + 0.5), 0.0, 0.0]])
            now = scene.advance(now, replace(rest, p_WT=way[0], v_WT=way[1]), 1e-3)
        return now

    half = moved(begin, range(50))
    end = moved(half, range(50, 100))
    share = made.body.mass / made.body.mass.sum()
    left = share @ (end.state.v - half.state.v)[:, 0] + 0.15  # of what the floor gained meanwhile
    assert left == pytest.approx(0.05 * gained, rel=0.02, abs=2e-3)
    again = moved(half, range(50, 100))  # a snapshot holds where things are held
    assert np.array_equal(again.p_WQ, end.p_WQ) and np.array_equal(again.force, end.force)


def test_columns_share_out_a_face():
    """Areas add up to the face, and what the columns do is what the ends of its particles do."""
    body = block(np.array([0.04, 0.04, 0.05]), SIZE, DX / 2, 1000.0)
    nodes = (20, 20, 20)
    for normal, axis, side in (
        (np.array([0.0, 0.0, 1.0]), 2, -1.0),
        (np.array([-1.0, 0.0, 0.0]), 0, 1.0),
    ):
        face = Face.of(body.x, body.half, DX, nodes, normal)
        across = [a for a in range(3) if a != axis]
        assert face.area.sum() == pytest.approx(SIZE[across].prod(), rel=1e-12)
        middle = np.array([0.04, 0.04, 0.05])
        assert face.place[:, axis] == pytest.approx(middle[axis] + side * 0.5 * SIZE[axis])
        x = DX * np.stack(np.unravel_index(face.node, nodes), axis=-1)
        slope = np.array([0.3, -0.2, 0.5])
        assert (x @ slope) @ face.share == pytest.approx(face.place @ slope, rel=1e-12)


@pytest.mark.parametrize("device", DEVICES)
def test_a_column_that_rounding_alone_weighs_is_at_no_plate(monkeypatch, device):
    """Outer particles are half-way between nodes but for a last digit, which single precision drops."""
    body = block(np.array([0.0, 0.0, 0.5 * SIZE[2]]), SIZE, DX / 2, 1000.0)
    body = replace(body, x=body.x + np.array([0.25 * DX * (1.0 - 1e-15), 0.0, 0.0]))
    floor = Tool("floor", Solid.half_space(), "tied", plate=True)
    region = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]]) * SIZE
    soft = Material(LAWS["fixed-corotated"], SOFT, 1000.0)
    still = {"gravity": np.array([3.0, 0.0, -9.81]), "total": True, "device": device}
    found, rest = [], Motions.at_rest(np.zeros(3))
    for own in (Pencils.of, lambda *_: None):  # the way of the CPU, and that of any device
        monkeypatch.setattr(Pencils, "of", own)
        scene = Scene([soft], [body], [floor], region=region, dx=DX, **still)
        scene.tie(rest)
        found.append(scene.advance(scene.start(), rest, 0.02).force[0])
    assert found[0] == pytest.approx(found[1], rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("device", DEVICES)
def test_a_recorded_press_is_the_same_on_every_device(device):
    """Force and places beside those of double precision on the CPU."""
    size = (0.02, 0.025, 0.03)
    pressed = Block(size=size, points=60).press("frictionless", 0.3)
    plain = World(LAWS["neo-hookean"], {"C10": 18e3, "kappa": 90e3}, 1000.0, np.zeros(3))
    found, exact = (
        Stage(pressed, size[0] / 4.0, precision=precision, device=on).rolled(plain)
        for precision, on in (("float32", device), ("float64", "cpu"))
    )
    force, wanted = (next(iter(r.forces.values())).value for r in (found, exact))
    assert np.abs(wanted).max() > 0.1 and force == pytest.approx(
        wanted, abs=1e-3 * np.abs(wanted).max()
    )
    assert found.p_WQ == pytest.approx(exact.p_WQ, abs=1e-5)


def test_a_plate_across_the_grid_is_refused():
    scene, rest = standing("tied")
    R = Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()[None]
    with pytest.raises(ValueError, match="plates lie along the axes of the grid"):
        scene.tie(Motions(rest.p_WT, R, rest.v_WT, rest.w_WT))
    with pytest.raises(ValueError, match="over its rest shape alone"):
        standing("tied", total=False)


def test_a_body_that_yields_meets_its_plates_as_one_that_does_not():
    """A plate stands a little deep from the first frame on: no wave of its coming is remembered."""
    begun = replace(Block(points=40).press("frictionless"), noise=0.0)
    begun = replace(begun, time=begun.time[:2], p_WQ=begun.p_WQ[:2])
    law, values = LAWS["neo-hookean"], {"C10": 6e3, "kappa": 30e3}
    yielding = CATALOGUE["yield"].world
    forces = []
    for strain in (1.0, 0.02):
        plain = World(law, values, begun.density, np.array([0.0, 0.0, -9.81]))
        made = Stage(begun, 5e-3).rolled(yielding(plain, 1.0, {"strain": strain}))
        forces.append(made.forces["plate"].value[0, 2])
    assert forces[0] > 0.05 and forces[1] == pytest.approx(forces[0], rel=1e-4)


@pytest.mark.parametrize("why", ["large", "viscous", "heavy", "small"])
def test_a_block_is_at_rest_before_the_first_frame(why, monkeypatch):
    """Also one that sinks slowly; one that is soon at rest is left as it is."""
    size, mu = (0.1, 2e3) if why == "large" else (0.02, 20e3)
    scale, eta = 100.0 if why == "heavy" else 1.0, 5e3 if why == "viscous" else 0.0
    one = Block(size=(size,) * 3, points=40).shake()
    still = Stream(one.time, np.tile(np.eye(4), (len(one.time), 1, 1)))
    one = replace(one, poses={"floor": still}, mass_scale=scale)
    one = replace(one, time=one.time[:40], p_WQ=one.p_WQ[:40])
    law = law_named("fixed-corotated+damping" if eta else "fixed-corotated")
    values = {"mu": mu, "lam": 2.0 * mu} | ({"eta": eta} if eta else {})
    world = World(law, values, 1000.0, np.array([0.0, 0.0, -9.81]))
    made = Stage(one, size / 4.0).rolled(world)
    sunk = np.abs(made.p_WQ[0] - one.reference).max()
    assert np.abs(made.p_WQ - made.p_WQ[0]).max() < max(5e-3 * sunk, 3e-5 * size)
    if why == "small":
        monkeypatch.setattr(stage, "rested", lambda scene, snapshot, still: snapshot)
        np.testing.assert_array_equal(Stage(one, size / 4.0).rolled(world).p_WQ, made.p_WQ)


def test_a_block_that_slides_has_its_shape_at_rest_and_one_that_does_not_come_to_rest_is_refused(
    monkeypatch,
):
    loose = Block(points=40).press("frictionless")
    loose = replace(loose, contact={"z-": "frictionless floor", "other": "free"}, forces={})
    loose = replace(loose, time=loose.time[:20], p_WQ=loose.p_WQ[:20])
    plain = World(LAWS["neo-hookean"], {"C10": 6e3, "kappa": 30e3}, 1e3, np.array([0.1, 0, -9.81]))
    slid = Stage(loose, 5e-3).rolled(plain).p_WQ
    shape = slid - slid.mean(axis=1, keepdims=True)
    assert np.ptp(slid.mean(axis=1)[:, 0]) > 1e-3
    assert np.abs(shape - shape[0]).max() < 0.05 * np.abs(slid[0] - loose.reference).max()
    monkeypatch.setattr(settling, "LONGEST", 0.0)
    with pytest.raises(ValueError, match="the body does not come to rest"):
        Stage(loose, 5e-3).rolled(plain)


def test_a_stiff_block_on_a_shaken_floor_lags_as_if_the_floor_went_by_a_curve(monkeypatch):
    """Which it follows in straight strides, whose corners the block is too slow for."""
    shaken = Block(size=(0.02, 0.02, 0.02), points=60).shake()
    last = 60
    shaken = replace(shaken, time=shaken.time[:last], p_WQ=shaken.p_WQ[:last])
    plain = World(
        LAWS["neo-hookean"], {"C10": 18e3, "kappa": 150e3}, shaken.density, np.array([0, 0, -9.81])
    )
    floor = shaken.poses["floor"]
    way = np.stack([np.interp(shaken.time, floor.time, floor.value[:, d, 3]) for d in range(3)], 1)
    lags = []
    for period in (stage.PERIOD, stage.PERIOD / 4.0):
        monkeypatch.setattr(stage, "PERIOD", period)
        made = Stage(shaken, 5e-3).rolled(plain)
        lag = (made.p_WQ - way[:, None])[:, :, 0]
        lags.append((lag - lag[0])[:, made.reference[:, 2] > 0.01])
    assert np.sqrt(np.mean(lags[1] ** 2)) > 1e-6
    assert np.sum(lags[0] * lags[1]) / np.sum(lags[1] ** 2) == pytest.approx(1.0, abs=5e-3)


def test_a_steady_way_is_followed_however_its_strides_differ():
    """And one that bends evenly is outside of itself by as much as its chords are inside."""
    steps = np.array([2e-3, 2e-3, 1e-3, 1.5e-3, 2e-3])
    time, R = np.append(0.0, np.cumsum(steps)), np.tile(np.eye(3), (6, 1, 1))
    p = time[:, None] * np.array([0.05, 0.0, -0.02])
    assert ways.followed((p, R), steps)[0] == pytest.approx(p, abs=1e-15)
    even, a = np.arange(6) * 2e-3, 0.8
    bent = np.column_stack([0.5 * a * even**2, 0.0 * even, 0.0 * even])
    found, _ = ways.followed((bent, R), np.full(5, 2e-3))
    means = 0.5 * (found[1:-2, 0] + found[2:-1, 0])
    wanted = a * (even[2:-1] ** 3 - even[1:-2] ** 3) / 6.0 / 2e-3
    assert means == pytest.approx(wanted, rel=1e-9)
