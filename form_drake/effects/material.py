"""Effects of the material: stresses that the declared law leaves out."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.linalg import qr

from form_drake.effects.effect import Effect, Reading, Shape, ball
from form_drake.effects.world import Inclusion, World
from form_drake.laws import ADDITIONS, Law
from form_drake.laws.memory import Memory

SMALL = 1e-5  # of a stretch, in differences


def _added(name: str, key: str, **more: Any) -> Effect:
    """An addition to the law; shape parameters are its given constants."""

    addition = ADDITIONS[name]

    def column(reading: Reading, shape: Shape) -> np.ndarray:
        return reading.added(name, shape)

    def fits(law: Law) -> bool:
        has = {term.response for term in law.terms}
        if has & {t.response for t in addition.terms} or set(addition.keys) & set(law.keys):
            return False
        return law.flow in addition.adds_to

    def world(scene: World, size: float, shape: Shape) -> World:
        return scene.added(name, **{key: size}, **shape)

    return Effect(id=name, column=column, world=world, fits=fits, **more)


DAMPING = _added(
    "damping",
    "eta",
    sentence="the material resists the rate at which it is deformed (Kelvin-Voigt damping)",
    unit="Pa s",
    prior=(1.0, 1e3),
    trial=20.0,
    shown=("fast press", "shake"),
    signed=False,
)

RATE_DEPENDENCE = _added(
    "rate-dependence",
    "eta_n",
    sentence="the material resists deformation more the faster it goes, by a power of the rate",
    unit="Pa s",
    prior=(1.0, 1e4),
    trial=20.0,
    shown=("presses at speeds ten times apart",),
    shapes={"n": (0.3, 0.5, 0.7)},
    signed=False,
)

STIFFENING = _added(
    "stiffening",
    "C2",
    sentence="the material is stiffer where it is strained further",
    unit="Pa",
    prior=(10.0, 1e6),
    trial=2e3,
    shown=("presses of two depths",),
)

AZIMUTHS = np.radians(np.arange(0.0, 180.0, 22.5))
ELEVATIONS = np.radians((-60.0, -30.0, 0.0, 30.0, 60.0, 90.0))


def _quartic(directions: np.ndarray) -> np.ndarray:
    """Products of four components of directions (azimuth, elevation), shape [directions, 15]."""
    azimuth, elevation = directions.T
    flat = np.cos(elevation)
    a = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    every = combinations_with_replacement(a, 4)
    return np.stack([np.prod(some, axis=0) for some in every], axis=1)


@cache
def _fibres() -> np.ndarray:
    """Fifteen directions, of which the stress of a fibre along any other is a sum, shape [15, 2]."""
    tried = np.stack(np.meshgrid(AZIMUTHS, ELEVATIONS), axis=-1).reshape(-1, 2)
    _, _, order = qr(_quartic(tried).T, pivoting=True)
    return tried[order[:15]]


def _by_fibres(shapes: Sequence[Shape]) -> tuple[list[Shape], np.ndarray]:
    """Stress is of fourth order in a direction of unit length, the 1 of I4 - 1 being its square."""
    own = np.array([[shape["azimuth"], shape["elevation"]] for shape in shapes])
    each: list[Shape] = [{"azimuth": a, "elevation": e} for a, e in _fibres().tolist()]
    return each, np.linalg.solve(_quartic(_fibres()).T, _quartic(own).T)


ANISOTROPY = _added(
    "anisotropy",
    "k_f",
    sentence="the material is stiffer along one direction",
    unit="Pa",
    prior=(10.0, 1e6),
    shown=("a press with the specimen turned", "shake"),
    shapes={"azimuth": tuple(AZIMUTHS.tolist()), "elevation": tuple(ELEVATIONS.tolist())},
    parts=_by_fibres,
    signed=False,
)


def _remembering(made: Callable[[float, Shape], Memory], **more: Any) -> Effect:
    """A share of the stress answers to a part of the deformation, ``made`` of share and shape."""

    def column(reading: Reading, shape: Shape) -> np.ndarray:
        return reading.remembered(made(1.0, shape))

    def world(scene: World, size: float, shape: Shape) -> World:
        return replace(scene, memories=(*scene.memories, made(size, shape)))

    return Effect(
        column=column,
        world=world,
        unit="-",
        prior=(0.003, 1.0),
        signed=False,
        most=1.0,
        share=True,
        bends=True,
        fits=_elastic,
        **more,
    )


def _elastic(law: Law) -> bool:
    return law.flow == "elastic"


RELAXATION = _remembering(
    lambda share, shape: Memory(share, rate=1.0 / shape["time"]),
    id="relaxation",
    sentence="a share of the stress fades with time",
    trial=0.02,
    shown=("press, hold and release",),
    shapes={"time": (0.05, 0.15, 0.5, 1.5)},
)

STRAINS = (0.005, 0.01, 0.02, 0.03, 0.045, 0.065)  # |dev e|
YIELD = _remembering(
    lambda share, shape: Memory(share, strain=shape["strain"]),
    id="yield",
    sentence="a share of the stress grows no more beyond a strain: the body yields",
    trial=0.02,
    shown=("press, release and wait",),
    shapes={"strain": STRAINS},
)
HARDENING = _remembering(
    lambda share, shape: Memory(share, strain=shape["strain"], growth=shape["growth"]),
    id="hardening",
    sentence="the body yields, and the more it has yielded the more it bears",
    trial=0.02,
    shown=("presses of two depths, each with release",),
    shapes={"strain": STRAINS, "growth": (0.2, 1.0)},
)


def _swelling_column(reading: Reading, shape: Shape) -> np.ndarray:
    up, down = (reading.stretched(1.0 + s * SMALL) for s in (-1.0, 1.0))
    return reading.stress((up - down) / (2.0 * SMALL))


EIGENSTRAIN = Effect(
    id="eigenstrain",
    sentence="the body has swollen: it would be larger if nothing held it",
    unit="-",
    prior=(1e-5, 0.1),
    column=_swelling_column,
    world=lambda scene, size, shape: replace(scene, swelling=scene.swelling + size),
    trial=3e-4,
    shown=("press", "a look at the bonded edge"),
    least=-1.0,
    bends=True,
)


def _inclusion_column(reading: Reading, shape: Shape) -> np.ndarray:
    return reading.shared(ball(shape).share(reading.X))


def _inclusion_world(scene: World, size: float, shape: Shape) -> World:
    return replace(scene, inclusions=(*scene.inclusions, Inclusion(ball(shape), 1.0 + size)))


INCLUSION = Effect(
    id="inclusion",
    sentence="a part of the body is stiffer or softer than the rest",
    unit="-",
    prior=(0.02, 20.0),
    column=_inclusion_column,
    world=_inclusion_world,
    shown=("a press beside the middle",),
    least=-1.0,
    trial=0.5,
    whole=True,
    bends=True,
    shapes={"x": (), "y": (), "z": (), "radius": ()},  # of the body, so given by who seeks it
)
