"""Effects of weight, inertia and what surrounds the body."""

from dataclasses import replace

import numpy as np

from form_drake.effects.effect import Effect, Reading, Shape, ball
from form_drake.effects.world import AddedMass, World

LIGHTEST = 0.1  # of its stated density, at least: through less, waves outrun any step


def _tilt(gravity: np.ndarray, shape: Shape) -> np.ndarray:
    """d gravity / d angle [m/s^2 per rad] of a small turn of gravity towards an azimuth; 0 without gravity.

    Across gravity that is not vertical, azimuths are those of the horizontal plane, tipped with it.
    """
    size = float(np.linalg.norm(gravity))
    if not size:
        return np.zeros(3)
    along, vertical = gravity / size, np.array([0.0, 0.0, np.copysign(1.0, gravity[2])])
    towards = np.array([np.cos(shape["azimuth"]), np.sin(shape["azimuth"]), 0.0])
    tipped = (towards @ along) / (1.0 + vertical @ along) * (vertical + along)
    return np.asarray(size * (towards - tipped))


def _tilt_column(reading: Reading, shape: Shape) -> np.ndarray:
    return reading.load(np.broadcast_to(_tilt(reading.gravity, shape), reading.v.shape))


def _tilt_world(scene: World, size: float, shape: Shape) -> World:
    if not np.any(scene.gravity):
        raise ValueError("gravity-tilt: there is no gravity to turn: state gravity [m/s^2]")
    turned = np.cos(size) * scene.gravity + np.sin(size) * _tilt(scene.gravity, shape)
    return replace(scene, gravity=turned)


GRAVITY_TILT = Effect(
    id="gravity-tilt",
    sentence="the base is not level: gravity points aside",
    unit="rad",
    prior=(1e-3, 0.3),
    column=_tilt_column,
    world=_tilt_world,
    shown=("rest on a turned base", "shake"),
    shapes={"azimuth": tuple(np.radians(np.arange(0.0, 180.0, 45.0)).tolist())},
)

DENSITY = Effect(
    id="density",
    sentence="the body is heavier or lighter than stated",
    unit="-",
    prior=(0.005, 1.0),
    column=lambda reading, shape: reading.mass(reading.m),
    world=lambda scene, size, shape: replace(scene, density=scene.density * (1.0 + size)),
    shown=("shake", "a balance"),
    same=("force-gain",),
    least=LIGHTEST - 1.0,
    trial=0.1,
)


def _mass_world(scene: World, size: float, shape: Shape) -> World:
    return replace(scene, masses=(*scene.masses, AddedMass(ball(shape), size)))


ADDED_MASS = Effect(
    id="added-mass",
    sentence="something heavy sits in or on the body",
    unit="kg",
    prior=(1e-5, 0.1),
    column=lambda reading, shape: reading.mass(ball(shape).spread(reading.X, reading.m)),
    world=_mass_world,
    shown=("shakes along two directions",),
    shapes={"x": (), "y": (), "z": (), "radius": ()},  # of the body, so given by who seeks it
    signed=False,
    trial=2e-3,
)

DRAG = Effect(
    id="drag",
    sentence="what surrounds the body resists its velocity",
    unit="1/s",
    prior=(0.1, 100.0),
    column=lambda reading, shape: reading.load(-reading.v / reading.scale),
    world=lambda scene, size, shape: replace(scene, drag=scene.drag + size),
    shown=("shake",),
    signed=False,
    trial=20.0,
)
