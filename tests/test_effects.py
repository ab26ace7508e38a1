"""The contract of every effect: its column is the derivative of its switch.

A block between bonded plates is simulated with an effect and without. All particles are read, so
that no fit of tracks is in between, with test fields that vanish smoothly before the plates, where
the grid blurs what is held. What the rows without it leave is taken for the simulator's own error,
as by a twin. The coefficient is then found beside the moduli.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.bench import effects as bench_effects
from form_drake.diagnose import Cause, Model, ProbeReading, Scenes
from form_drake.diagnose.match import Match
from form_drake.diagnose.prepare import probe
from form_drake.diagnose.score import scored
from form_drake.diagnose.search import matched
from form_drake.effects import CATALOGUE, Effect, World, load
from form_drake.effects.acting import known, placed
from form_drake.effects.world import Ball
from form_drake.identify.problem import Problem
from form_drake.laws import LAWS, Constant
from form_drake.material import Acting, Material
from form_drake.motion import Motion, body
from form_drake.mpm.bodies import block, by_material
from form_drake.mpm.stage import Stage
from form_drake.records import Recording, Stream
from form_drake.weak.fields import Sampled
from form_drake.weak.force import measured
from form_drake.weak.probe import Probe
from form_drake.weak.unknowns import Unknowns
from form_drake.weak.windows import even, windows

SIZE, DX, SECONDS = np.array([0.02, 0.02, 0.03]), 0.004, 0.3
GRID = 0.0045  # of what is found by simulating it again and again [m]
LOW = np.array([-0.01, -0.01, 0.0])
SOFT = Material(LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}, 1000.0)
THETA = np.array([20e3, 40e3])
TRIED = {  # size of the coefficient, and the shape
    "damping": (2.0, {}),
    "rate-dependence": (3.0, {"n": 0.7}),
    "relaxation": (0.1, {"time": 0.1}),
    "yield": (0.2, {"strain": 0.01}),
    "hardening": (0.2, {"strain": 0.01, "growth": 0.5}),
    "stiffening": (3e3, {}),
    "anisotropy": (4e3, {"azimuth": 0.5, "elevation": 0.7}),
    "inclusion": (0.1, {"x": 0.0, "y": -0.001, "z": 0.015, "radius": 0.0085}),
    "eigenstrain": (1e-3, {}),
    "gravity-tilt": (0.05, {"azimuth": 0.4}),
    "density": (0.1, {}),
    "added-mass": (2e-4, {"x": 0.001, "y": 0.002, "z": 0.015, "radius": 0.006}),
    "drag": (20.0, {}),
    "tool-friction": (0.06, {}),
    "adhesion": (300.0, {}),
    "floor-slip": (3e-8, {"slippery": 0.0}),
    "force-gain": (0.02, {}),
    "force-bias": (0.02, {"azimuth": 0.3, "elevation": 1.2}),
    "force-drift": (0.05, {"azimuth": 0.3, "elevation": 1.2}),
    "force-delay": (2e-3, {}),
    "camera-scale": (1e-3, {}),
    "camera-pose": (2e-3, {"azimuth": 0.2, "elevation": 0.4}),
}


@dataclass(frozen=True)
class SmoothFields:
    """e_d h(z) p(x, y): bumps between floor and plate, and a ramp from one to the other."""

    kinds: tuple = (
        *((h, p, d) for h in ("bump", "odd") for p in range(4) for d in range(3)),
        *(("ramp", 0, d) for d in range(3)),
    )
    edge: float = 1.0 * DX
    material = fixed = True
    breaks = ()
    tools = ("plate",)

    @property
    def names(self):
        return tuple(f"{h} {p} {'xyz'[d]}" for h, p, d in self.kinds)

    def acting(self, motion):
        end = np.array([np.eye(3)[d] * (h == "ramp") for h, _, d in self.kinds])
        return {"plate": np.broadcast_to(end, (len(motion.time), *end.shape))}

    def inside(self, boundary):
        return np.ones(len(self.kinds), dtype=bool)

    def at(self, motion):
        size = SIZE[2] - 2.0 * self.edge
        s = np.clip((motion.X[:, 2] - LOW[2] - self.edge) / size, 0.0, 1.0)
        y = 2.0 * s - 1.0
        bump, slope = (1.0 - y**2) ** 3, -12.0 * y * (1.0 - y**2) ** 2
        along = {
            "bump": (bump, slope),
            "odd": (y * bump, 2.0 * bump + y * slope),
            "ramp": (s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2),
        }
        x, z = (motion.X - LOW)[:, :2].T / SIZE[0] * 2.0 - 1.0
        one, none, unit = np.ones_like(x), np.zeros_like(x), np.full_like(x, 2.0 / SIZE[0])
        across = [
            (one, none, none),
            (x, unit, none),
            (z, none, unit),
            (x * z, z * unit, x * unit),
        ]
        value = np.zeros((len(self.kinds), len(x), 3))
        gradient = np.zeros((*value.shape, 3))
        for n, (h, p, d) in enumerate(self.kinds):
            (f, df), (q, qx, qy) = along[h], across[p]
            value[n, :, d] = f * q
            gradient[n, :, d] = np.stack([f * qx, f * qy, df / size * q], axis=-1)
        shape = (len(motion.time),)
        return Sampled(*(np.broadcast_to(a, (*shape, *a.shape)) for a in (value, gradient)))


def standing(top, height, X, t, stamps):
    """A block on a floor that holds it, and the way of the plate above it [m]."""
    pose = np.tile(np.eye(4), (len(stamps), 1, 1))
    pose[:, 2, 3] = height
    return Recording.from_arrays(
        t,
        np.tile(X, (len(t), 1, 1)),
        p_reference=X,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.03"},
        contact={"z-": "bonded floor", "z+": f"{top} plate", "other": "free"},
        poses={"plate": Stream(stamps, pose)},
        forces={"plate": Stream(stamps, np.zeros((len(stamps), 3)), noise=1e-3)},
    )


def recording():
    """A bonded plate presses twice and shakes a little."""
    X = LOW + SIZE * np.random.default_rng(0).uniform(0.1, 0.9, (4, 3))
    t = np.linspace(0.0, SECONDS, 151)
    stroke = 1.2e-3 * np.sin(1.5 * np.pi * t / SECONDS) ** 2 + 2e-4 * np.sin(40.0 * t)
    return standing("bonded", SIZE[2] - stroke, X, t, t)


STAGE = Stage(recording(), 1.4 * DX, precision="float64")


def read(made: Recording, motion: Motion) -> ProbeReading:
    """What an observer reads who knows of no effect: the stated density."""
    motion = replace(motion, mass=SOFT.density * motion.volume)
    sampling = SimpleNamespace(displaced=lambda c: None, moved=lambda by: motion)
    fields, span = SmoothFields(), windows(motion.time, even(0.0, SECONDS, 0.1, 0.03))
    keep = np.ones(len(span) * len(fields.names), dtype=bool)
    forces = measured(made, 0.0, SECONDS)
    gravity = np.asarray(made.gravity)
    fit = SimpleNamespace(c=None)
    shape = body(made)
    probe = Probe("", shape, fit, sampling, sampling, (fields,), span, forces, gravity, keep)
    return ProbeReading(probe, SOFT.law, SOFT.values)


def rows(reading):
    probe = reading.probe
    along = probe.along(probe.motion)
    A = probe.columns(along, reading.law, reading.values, np.ones(len(THETA), dtype=bool))
    return A, probe.rest(along, {})


@pytest.fixture(scope="module")
def plain():
    """The block without any effect, and what its rows leave."""
    made, motion = STAGE.moving(STAGE.world(SOFT))
    A, b = rows(read(made, motion))
    left = b - A @ THETA
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(b)
    return made, motion, left


def seen(effect: Effect, size: float, shape, made: Recording, motion: Motion):
    """What sensors with an effect tell of a motion."""
    told = effect.sensor(replace(made, p_WQ=motion.x, p_reference=motion.X), size, shape)
    origin, *ends = (
        effect.sensor(replace(made, p_WQ=x + np.zeros_like(made.p_WQ)), size, shape).p_WQ[0, 0]
        for x in (np.zeros(3), *np.eye(3))
    )
    turn = np.stack(ends, axis=-1) - origin[:, None]
    rate = turn @ motion.L @ np.linalg.inv(turn)
    other = replace(motion, x=told.p_WQ, v=motion.v @ turn.T, F=turn @ motion.F, L=rate)
    return replace(made, forces=told.forces), other


def found(effect: Effect, shape, made: Recording, motion: Motion, left: np.ndarray) -> float:
    """The coefficient, beside the moduli."""
    reading = read(made, motion)
    A, b = rows(reading)
    column = effect.column(reading, shape)
    columns = np.column_stack([A * THETA, column * TRIED[effect.id][0]])
    return np.linalg.lstsq(columns, b - left, rcond=None)[0][-1] * TRIED[effect.id][0]


@pytest.fixture(scope="module")
def stiffer(plain):
    """The block without any effect, of other moduli, and what the rows of a twin leave of it.

    The twin has the moduli that the first one's error lets the data show, not the true ones.
    """
    data = STAGE.moving(STAGE.world(replace(SOFT, values={"mu": 20.4e3, "lam": 39e3})))
    A, b = rows(read(*data))
    theta = np.linalg.lstsq(A, b - plain[2], rcond=None)[0]
    assert 0.0 < np.abs(theta / [20.4e3, 39e3] - 1.0).max() < 0.02
    near = replace(SOFT, values={"mu": theta[0], "lam": theta[1]})
    A, b = rows(read(*STAGE.moving(STAGE.world(near))))
    return *data, b - A @ theta


COLUMNS = [e for e in CATALOGUE.values() if e.column is not None]


@pytest.mark.parametrize("effect", COLUMNS, ids=lambda effect: effect.id)
def test_the_column_is_the_derivative_of_the_switch(effect, plain, stiffer):
    made, motion, left = plain
    size, shape = TRIED[effect.id]
    if effect.world is None:
        other = seen(effect, size, shape, made, motion)
    else:
        world: World = effect.world(STAGE.world(SOFT), size, shape)
        other, particles = STAGE.moving(world)
        # an observer sees all of the deformation, not only what is elastic
        other = other, replace(particles, F=particles.F * (1.0 + world.swelling))
    assert found(effect, shape, *other, left) == pytest.approx(size, rel=0.05)
    assert abs(found(effect, shape, *stiffer)) < 0.05 * size


def loose():
    """A frictionless plate presses and leaves."""
    X = LOW + SIZE * np.random.default_rng(0).uniform(0.04, 0.96, (200, 3))
    t, stamps = np.linspace(0.0, SECONDS, 46), np.linspace(0.0, SECONDS, 151)
    stroke = 2.5e-3 * np.sin(np.pi * (0.1 + 0.9 * stamps / SECONDS)) ** 2
    return standing("frictionless", SIZE[2] + 4e-4 - stroke, X, t, stamps)


def begun(model, *causes):
    """A twin, on the grid of the data, of what is not its material and may act."""
    scenes = replace(Scenes.of((loose(),), GRID), coarser=1.0)
    (made,) = scenes.rolled(Model(SOFT.law, {"mu": 20.4e3, "lam": 39e3}, causes))
    own = probe(replace(made, noise=1e-6), "press", GRID)
    problem = Problem.of([own], Unknowns.of(SOFT.law, {}, "law"), "borne")
    return matched(Match.of(problem, scenes, model))


@pytest.fixture(scope="module")
def untouched():
    """Nothing acts, and nothing is believed to."""
    return begun(Model(SOFT.law, SOFT.values))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("tool-friction", {}),
        ("adhesion", {}),
        ("floor-slip", {"slippery": 0.0}),
        ("floor-slip", {"slippery": 5.0}),
    ],
)
def test_contact_is_found_by_simulating_it(name, shape, untouched):
    """Their columns are differences of simulations: begun from another size, the true one is found."""
    effect, (size, _) = CATALOGUE[name], TRIED[name]
    more = Model(SOFT.law, SOFT.values).more(effect, effect.trial, shape)
    hidden = begun(more, Cause(effect, size, shape))
    assert hidden.model.causes[0].coefficient == pytest.approx(size, rel=0.05)
    assert abs(scored(untouched, effect, [shape]).coefficient) < 0.05 * size


def test_every_effect_is_declared_in_full():
    assert set(TRIED) == set(CATALOGUE)
    for effect in CATALOGUE.values():
        size, shape = TRIED[effect.id]
        assert effect.prior[0] <= size <= effect.prior[1]
        assert set(shape) == set(effect.shapes) and effect.shown
        assert all(set(one) == set(effect.shapes) for one in effect.grid())


def test_masses_are_scaled_as_the_body_is(plain):
    """A quasi-static scene has ten times the mass and a tenth of the gravity: the same weight."""
    reading = read(*plain[:2])
    motion = replace(reading.motion, mass=10.0 * reading.motion.mass, v=0.0 * reading.v)
    held = SimpleNamespace(displaced=lambda c: None, moved=lambda by: motion)
    probe = replace(reading.probe, sampling=held, rough=held, gravity=0.1 * reading.gravity)
    still = replace(reading.motion, v=0.0 * reading.v)
    alone = SimpleNamespace(displaced=lambda c: None, moved=lambda by: still)
    plainly = replace(reading.probe, sampling=alone, rough=alone)
    one, other = (ProbeReading(p, SOFT.law, SOFT.values) for p in (probe, plainly))
    assert (reading.scale, one.scale) == (1.0, pytest.approx(10.0))
    for name in ("density", "added-mass"):
        shape = TRIED[name][1]
        columns = [CATALOGUE[name].column(reading, shape) for reading in (one, other)]
        np.testing.assert_allclose(*columns, atol=1e-12 * np.abs(columns[1]).max())


def test_a_drag_is_of_the_true_mass(plain):
    """Of a quasi-static scene, too, which moves ten times as much."""
    reading, drag = read(*plain[:2]), CATALOGUE["drag"]
    motion = replace(reading.motion, mass=10.0 * reading.motion.mass)
    held = SimpleNamespace(displaced=lambda c: None, moved=lambda by: motion)
    heavy = ProbeReading(replace(reading.probe, sampling=held, rough=held), SOFT.law, SOFT.values)
    column = drag.column(reading, {})
    np.testing.assert_allclose(drag.column(heavy, {}), column, atol=1e-12 * np.abs(column).max())
    dragged = drag.world(STAGE.world(SOFT), 20.0, {})
    (scene, scaled) = (
        Stage(replace(STAGE.recording, mass_scale=k), DX)._set(dragged).scene for k in (1.0, 10.0)
    )
    assert (scene.drag, scaled.drag) == (20.0, 2.0)


def test_a_turned_camera_sees_no_other_size():
    pose, x = CATALOGUE["camera-pose"], np.random.default_rng(0).normal(size=(4, 5, 3))
    seen = Recording.from_arrays(np.arange(4.0), x)
    shape = {"azimuth": 0.3, "elevation": 0.5}
    turned = pose.sensor(seen, 0.2, shape).p_WQ
    np.testing.assert_allclose(
        np.linalg.norm(turned[:, 1:] - turned[:, :1], axis=2),
        np.linalg.norm(x[:, 1:] - x[:, :1], axis=2),
    )
    along = np.array([np.cos(0.5) * np.cos(0.3), np.cos(0.5) * np.sin(0.3), np.sin(0.5)])
    slight = (pose.sensor(seen, 1e-6, shape).p_WQ - x) / 1e-6
    np.testing.assert_allclose(slight, np.cross(along, x), atol=1e-5)


def test_an_effect_without_a_shape_is_named_once():
    twice = [Acting("density", -0.8), Acting("density", -0.8)]
    with pytest.raises(ValueError, match="effect density is named twice"):
        known(twice, SOFT.law, CATALOGUE)
    assert (
        len(
            known([Acting("relaxation", 0.2, {"time": t}) for t in (0.1, 1.0)], SOFT.law, CATALOGUE)
        )
        == 2
    )


def test_an_addition_does_not_fit_a_law_that_has_a_constant_of_its_name():
    law = SOFT.law
    own = replace(law, parameters=(*law.parameters, Constant("n", "-", "given")))
    assert CATALOGUE["rate-dependence"].fits(law) and not CATALOGUE["rate-dependence"].fits(own)
    assert CATALOGUE["damping"].fits(own)


def test_without_gravity_nothing_tilts(plain):
    """No row sees it, so that it is not sought; stated, it is a mistake."""
    tilt, reading = CATALOGUE["gravity-tilt"], read(*plain[:2])
    free = replace(reading, probe=replace(reading.probe, gravity=np.zeros(3)))
    assert not tilt.column(free, {"azimuth": 0.4}).any()
    with pytest.raises(ValueError, match="gravity-tilt: there is no gravity to turn"):
        tilt.world(replace(STAGE.world(SOFT), gravity=np.zeros(3)), 0.1, {"azimuth": 0.4})


@pytest.mark.parametrize("gravity", [[9.81, 0.0, 0.0], [0.0, 0.0, 9.81], [3.0, -4.0, 0.5]])
def test_gravity_turns_every_way_by_the_stated_angle(gravity):
    """Also towards an azimuth that it points along already."""
    still, size = replace(STAGE.world(SOFT), gravity=np.array(gravity)), np.linalg.norm(gravity)
    turned = [
        CATALOGUE["gravity-tilt"].world(still, 0.1, {"azimuth": azimuth}).gravity / size
        for azimuth in (0.0, 0.5 * np.pi)
    ]
    assert np.linalg.norm(turned, axis=1) == pytest.approx(1.0)
    assert turned @ still.gravity / size == pytest.approx(np.cos(0.1))
    assert np.dot(*turned) == pytest.approx(np.cos(0.1) ** 2)  # across each other


def test_a_fibre_is_a_sum_of_fifteen(plain):
    reading, shape = read(*plain[:2]), {"elevation": -0.4, "azimuth": 1.3}
    effect = CATALOGUE["anisotropy"]
    own_shapes, shares = effect.parts([shape])
    found = np.stack([effect.column(reading, one) for one in own_shapes], axis=1) @ shares[:, 0]
    own = reading.added("anisotropy", shape)
    assert found == pytest.approx(own, rel=1e-9, abs=1e-9 * np.abs(own).max())


def test_some_effects_fit_some_laws():
    fits = {
        name: {law for law in LAWS if CATALOGUE[name].fits(LAWS[law])}
        for name in ("anisotropy", "damping", "stiffening", "drag")
    }
    assert "von-mises" in fits["damping"] and "von-mises" not in fits["anisotropy"]
    assert "gent" in fits["stiffening"] and "yeoh" not in fits["stiffening"]
    assert "newtonian" not in fits["damping"] and fits["drag"] == set(LAWS)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"contact": {"z-": "touched floor", "other": "free"}}, "face z- is touched: only faces"),
        ({"contact": {"z-": "bonded floor"}}, "face x- is unknown: only faces"),
        ({"contact": {"other": "free"}}, "all faces are free: a block that nothing holds"),
        ({"poses": {}}, "plate presses z.: to simulate it, add its poses"),
        ({"late": True}, "poses of plate are stamped .* they must cover the frames"),
    ],
)
def test_scenes_that_cannot_be_simulated_are_refused(changes, message):
    made = recording()
    if changes.pop("late", False):
        pose = made.poses["plate"]
        changes = {"poses": {"plate": Stream(pose.time[20:], pose.value[20:])}}
    if "contact" in changes:
        changes |= {"forces": {}, "poses": {}}
    stage = Stage(replace(made, **changes), DX)
    with pytest.raises(ValueError, match=message):
        stage.rolled(stage.world(SOFT))


@pytest.mark.parametrize(
    "stroke, message",
    [
        (0.031, "floor and plate meet 0.0.* s after the first frame"),
        (30.0, "floor and plate meet 0.002 s after the first frame"),  # poses in mm
        (0.0295, "the simulated body turns inside out 0.0.* s after the first frame"),
    ],
)
def test_a_plate_that_goes_too_far_is_no_press(stroke, message):
    t = np.linspace(0.0, 0.1, 11)
    X = LOW + SIZE * np.random.default_rng(0).uniform(0.1, 0.9, (4, 3))
    pressed = standing("bonded", SIZE[2] - stroke * np.sin(5.0 * np.pi * t), X, t, t)
    with pytest.raises(ValueError, match=message):
        Stage(pressed, 2.0 * DX).rolled(STAGE.world(SOFT))


def test_a_scene_leaves_out_nothing_that_is_stated():
    made = recording()
    with pytest.raises(ValueError, match="states body_force"):
        Stage(replace(made, body_force=np.zeros(made.p_WQ.shape)), DX)
    with pytest.raises(ValueError, match=r"the material has effects \(drag\)"):
        STAGE.world(replace(SOFT, effects=(Acting("drag", 5.0, {}),)))


def test_an_effect_is_of_the_world_or_of_a_sensor():
    with pytest.raises(ValueError, match="either world or sensor is wanted"):
        replace(CATALOGUE["drag"], world=None)
    with pytest.raises(ValueError, match="two increasing sizes"):
        replace(CATALOGUE["drag"], prior=(1.0, 0.1))
    with pytest.raises(ValueError, match="must be two increasing sizes"):
        replace(CATALOGUE["drag"], prior=(0.1, 1.0, 5.0))
    with pytest.raises(ValueError, match="acts as a whole wants a trial"):
        replace(CATALOGUE["inclusion"], trial=0.0)


@pytest.mark.parametrize(
    ("name", "more", "told"),
    [
        ("drag", {}, "one that compounds wants a sensor"),
        ("camera-scale", {}, "no coefficient below -1"),
        ("force-gain", {"least": -2.0}, "no coefficient below -1"),
    ],
)
def test_what_multiplies_forces_is_a_share_more_of_what_is_measured(name, more, told):
    with pytest.raises(ValueError, match=f"effect {name}: .*{told}"):
        replace(CATALOGUE[name], compounds=True, **more)


def test_no_step_takes_half_of_a_force_away():
    gain = CATALOGUE["force-gain"]
    for now in (0.0, -0.4, -0.9, 3.0):
        for wanted in (-50.0, -1.0, now - 0.6 * (1.0 + now)):
            assert 0.5 * (1.0 + now) < 1.0 + gain.bounded(wanted, now) < 1.0 + now
        near = now - 0.4 * (1.0 + now)
        assert gain.bounded(near, now) == near


def test_a_delay_is_one_however_fast_the_force_goes():
    """25 ms late at 5 Hz: to first order the force would be 28 % too large."""
    time = np.linspace(3.0, 4.0, 121)
    force = np.sin(10.0 * np.pi * (time - 3.0))[:, None] * np.array([0.0, 0.0, 8.0])
    still = np.zeros((len(time), 1, 3))
    recording = Recording(time=time, p_WQ=still, forces={"plate": Stream(time, force)})
    late = CATALOGUE["force-delay"].sensor(recording, 0.025, {}).forces["plate"].value
    wanted = 8.0 * np.sin(10.0 * np.pi * np.maximum(time - 3.025, 0.0))
    assert late[:, 2] == pytest.approx(wanted, abs=2e-3)


def test_a_shape_of_one_value_cannot_be_sought():
    with pytest.raises(ValueError, match="shape n wants two values or more"):
        replace(CATALOGUE["rate-dependence"], shapes={"n": (0.5,)})


@pytest.mark.parametrize(
    "name, size, changes, told",
    [
        (
            "tool-friction",
            -0.01,
            {},
            "tool-friction: coefficient -0.01 is given, one above 0 is want",
        ),
        ("density", -2.0, {}, "coefficient -2 is given, one above -0.9 is wanted"),
        ("eigenstrain", -1.0, {}, "coefficient -1 is given, one above -1 is wanted"),
        ("yield", 1.5, {}, "coefficient 1.5 is given, one above 0 and at most 1 is wanted"),
        ("relaxation", 0.5, {"time": 0.0}, "relaxation: time must be positive, got 0"),
        ("hardening", 0.5, {"growth": -1.5}, "hardening: growth must be positive, got -1.5"),
        ("inclusion", 2.0, {"radius": -1e-3}, "inclusion: radius must be positive, got -0.001"),
    ],
)
def test_sizes_and_shapes_that_cannot_be_are_refused(name, size, changes, told):
    with pytest.raises(ValueError, match=told):
        known([Acting(name, size, {**TRIED[name][1], **changes})], SOFT.law, CATALOGUE)


def test_what_is_tried_can_be_stated():
    for name, (size, shape) in TRIED.items():
        (one,) = known([Acting(name, size, shape)], SOFT.law, CATALOGUE)
        assert (one.effect, one.coefficient) == (CATALOGUE[name], size)


def test_an_effect_that_the_law_has_is_refused():
    with pytest.raises(ValueError, match="stiffening does not fit law yeoh, which has it already"):
        known([Acting("stiffening", 100.0)], LAWS["yeoh"], CATALOGUE)


def test_shares_of_the_stress_add_up_to_all_of_it_at_most():
    both = [Acting("relaxation", 0.8, {"time": 0.1}), Acting("yield", 0.8, {"strain": 0.01})]
    with pytest.raises(ValueError, match="effects relaxation, yield: together they take more"):
        known(both, SOFT.law, CATALOGUE)
    causes = [Cause(CATALOGUE[one.id], one.coefficient, one.shape) for one in both]
    causes.append(Cause(CATALOGUE["drag"], 20.0, {}))
    model = Model(SOFT.law, SOFT.values, tuple(causes)).whole
    assert [c.coefficient for c in model.causes] == [0.5, 0.5, 20.0]
    assert len(known(model.material(1000.0).effects, SOFT.law, CATALOGUE)) == 3


def test_a_ball_has_its_volume_wherever_it_lies_between_particles():
    """Of a radius of 1.2 particles; without the mean over what they stand for half of it may be lost."""
    lattice = np.stack(np.meshgrid(*[np.arange(-4.0, 5.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    places = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3))
    held = {
        name: [Ball(place, 1.2).share(lattice, edges).sum() for place in places]
        for name, edges in (("points", None), ("boxes", np.ones(3)))
    }
    true = 4.0 / 3.0 * np.pi * 1.2**3 * (1.0 + 0.25**2 / 4.0)  # with what fades at its edge
    np.testing.assert_allclose(held["boxes"], true, rtol=0.01)
    assert min(held["points"]) < 0.9 * true or max(held["points"]) > 1.1 * true


def test_a_ball_outside_of_the_body_is_refused():
    far = {"x": 0.0, "y": 0.0, "z": 10.0, "radius": 5.0}
    away, near = (
        known([Acting("inclusion", 2.0, s)], SOFT.law, CATALOGUE) for s in (far, {**far, "z": 5.0})
    )
    with pytest.raises(ValueError, match=r"inclusion: a ball of 5 m .* lies outside of the body"):
        placed(away, LOW, LOW + SIZE)
    placed(near, LOW, LOW + SIZE)


def test_a_body_that_gives_way_is_not_simulated():
    with pytest.raises(
        ValueError, match=r"bulk modulus -6666[.]67 Pa: must be positive, change mu, lam"
    ):
        Stage(recording(), DX).world(SOFT.changed({"lam": -20e3}))


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("fits=lambda law: law.nothing", "effect 'own': fits fails at law .*: AttributeError"),
        ("shapes={'radius': ()}", "shapes of a place are x, y, z and radius, got radius"),
        (
            "shapes={**dict.fromkeys(('x', 'y', 'z', 'radius'), ()), 'time': (0.1, 0.2)}",
            "got x, y, z, radius, time",
        ),
        ("id=['a']", "effect .'a'.: an id is made of lower-case words"),
        ("id=5", "effect 5: an id is made of lower-case words"),
        ("unit=None", "unit must be a text, got None"),
        ("shown='press'", "shown must be a tuple of texts, got 'press'"),
        ("faces=('glued',)", "faces may hold free, unknown, bonded, .*, got 'glued'"),
        ("shapes={'time': ('a', 'b')}", "shape time must be a tuple of finite numbers"),
        ("shapes={'time': [0.1, 0.2]}", "shape time must be a tuple of finite numbers"),
        ("trial=float('nan')", "trial must be of numbers, got nan"),
        ("trial=float('inf')", "trial must be finite, got inf"),
        ("most=None", "most must be of numbers, got None"),
        ("least='a'", "least must be of numbers, got 'a'"),
        ("parts=5", "parts must be a function, got 5"),
        ("fits=None", "fits must be a function, got None"),
        ("signed=None", "signed must be True or False, got None"),
        ("same=('nosuch',)", "same may hold ids, got 'nosuch'"),
        ("signed=False, most=-1.0", "no coefficient is above 0 and at most -1"),
        ("floors={'time': 0.0}", "floors are of shapes, got time"),
    ],
)
def test_an_effect_of_ones_own_that_cannot_be_sought_is_one_line(tmp_path, more, told):
    path = tmp_path / "own.py"
    told_of = {"id": "'own'", "sentence": "'it is'", "unit": "'-'"}
    given = ", ".join(f"{k}={v}" for k, v in told_of.items() if not more.startswith(f"{k}="))
    path.write_text(
        "from form_drake.effects import Effect\n"
        f"one = Effect({given}, prior=(0.1, 1.0), column=len, world=lambda w, c, s: w, {more})\n"
    )
    with pytest.raises(ValueError, match=f"{path}.*{told}"):
        load(path, CATALOGUE)


def test_a_size_that_is_not_told_has_its_line_in_the_bench():
    one = {"true": 2.0, "found": 2.5, "errors": {"mu": 0.01}, "without": 90.0, "left": 10.0}
    cases = {"drag/1": one | {"std": 0.1}, "adhesion/1": one | {"std": None}}
    _, told, untold = bench_effects.table({"cases": cases}).splitlines()
    assert told.split()[1:6] == ["2", "2.5", "0.1", "+25.0", "%"]
    assert untold.split()[1:6] == ["2", "2.5", "-", "+25.0", "%"]


def test_numbers_of_numpy_are_numbers(tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        "import numpy as np\nfrom form_drake.effects import Effect\n"
        "one = Effect(id='own', sentence='it is', unit='-', prior=(np.float32(0.1), np.int64(1)), column=len,"
        " world=lambda w, c, s: w, shapes={'angle': tuple(np.linspace(0.0, 1.0, 3))}, same=('two',))\n"
        "two = Effect(id='two', sentence='it is', unit='-', prior=(0.1, 1.0), column=len, sensor=len)\n"
    )
    assert sorted(load(path, CATALOGUE)) == ["own", "two"]


def test_soft_inclusions_that_leave_no_stiffness_together_are_refused():
    place = {"x": 0.0, "y": 0.0, "z": 0.01, "radius": 0.006}
    once = CATALOGUE["inclusion"].world(STAGE.world(SOFT), -0.6, place)
    middle = np.array([0.0, 0.0, 0.01])
    whole = block(middle, np.full(3, 0.02), 0.002, 1000.0)
    assert by_material(once, whole)
    with pytest.raises(ValueError, match="together they leave the body no stiffness"):
        by_material(CATALOGUE["inclusion"].world(once, -0.6, place), whole)
