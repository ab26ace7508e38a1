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

from form_drake.diagnose import ProbeReading
from form_drake.effects import CATALOGUE, Effect, World
from form_drake.laws import LAWS
from form_drake.material import Material
from form_drake.motion import Motion, body
from form_drake.mpm.stage import Stage
from form_drake.records import Recording, Stream
from form_drake.weak.fields import Sampled
from form_drake.weak.force import measured
from form_drake.weak.probe import Probe
from form_drake.weak.windows import even, windows

SIZE, DX, SECONDS = np.full(3, 0.02), 0.004, 0.3
LOW = np.array([-0.01, -0.01, 0.0])
SOFT = Material(LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}, 1000.0)
THETA = np.array([20e3, 40e3])
TRIED = {  # size of the coefficient, and the shape
    "damping": (2.0, {}),
    "rate-dependence": (3.0, {"n": 0.7}),
    "stiffening": (3e3, {}),
    "anisotropy": (1e3, {"azimuth": 0.5, "elevation": 0.7}),
    "inclusion": (0.1, {"x": 0.0, "y": -0.001, "z": 0.01, "radius": 0.007}),
    "eigenstrain": (1e-3, {}),
    "gravity-tilt": (0.05, {"azimuth": 0.4}),
    "density": (0.1, {}),
    "added-mass": (2e-4, {"x": 0.001, "y": 0.002, "z": 0.01, "radius": 0.006}),
    "drag": (20.0, {}),
    "force-gain": (0.02, {}),
    "force-bias": (0.02, {"axis": 2}),
    "force-drift": (0.05, {"axis": 2}),
    "force-delay": (2e-3, {}),
    "camera-scale": (1e-3, {}),
    "camera-pose": (2e-3, {"axis": 0}),
}


@dataclass(frozen=True)
class SmoothFields:
    """e_d h(z) p(x, y): bumps between floor and plate, and a ramp from one to the other."""

    kinds: tuple = (
        *((h, p, d) for h in ("bump", "odd") for p in range(4) for d in range(3)),
        *(("ramp", 0, d) for d in range(3)),
    )
    edge: float = 0.5 * DX
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


def recording():
    """A block that a bonded plate presses twice and shakes a little."""
    X = LOW + SIZE * np.random.default_rng(0).uniform(0.1, 0.9, (4, 3))
    t = np.linspace(0.0, SECONDS, 151)
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    stroke = 1.2e-3 * np.sin(1.5 * np.pi * t / SECONDS) ** 2 + 2e-4 * np.sin(40.0 * t)
    pose[:, 2, 3] = SIZE[2] - stroke
    return Recording.from_arrays(
        t,
        np.tile(X, (len(t), 1, 1)),
        p_reference=X,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.02"},
        contact={"z-": "bonded floor", "z+": "bonded plate", "other": "free"},
        poses={"plate": Stream(t, pose)},
        forces={"plate": Stream(t, np.zeros((len(t), 3)))},
    )


STAGE = Stage(recording(), DX, apart=0.625, precision="float64")


def read(made: Recording, motion: Motion) -> ProbeReading:
    """What an observer reads who knows of no effect: the stated density."""
    motion = replace(motion, mass=SOFT.density * motion.volume)
    sampling = SimpleNamespace(motion=lambda c: motion)
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


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=lambda effect: effect.id)
def test_the_column_is_the_derivative_of_the_switch(effect, plain):
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
    assert abs(found(effect, shape, made, motion, left)) < 1e-6 * size


def test_every_effect_is_declared_in_full():
    assert set(TRIED) == set(CATALOGUE)
    for effect in CATALOGUE.values():
        size, shape = TRIED[effect.id]
        assert effect.prior[0] <= size <= effect.prior[1]
        assert set(shape) == set(effect.shapes) and effect.shown
        assert all(set(one) == set(effect.shapes) for one in effect.grid())


def test_an_effect_is_of_the_world_or_of_a_sensor():
    with pytest.raises(ValueError, match="either world or sensor is wanted"):
        replace(CATALOGUE["drag"], world=None)
    with pytest.raises(ValueError, match="two increasing sizes"):
        replace(CATALOGUE["drag"], prior=(1.0, 0.1))
