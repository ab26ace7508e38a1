"""What effects may change of a simulated scene: a plain description, from which it is made anew."""

from dataclasses import dataclass, replace

import numpy as np

from form_drake.laws import Law, Values, law_named
from form_drake.laws.memory import Memory

EDGE = 0.25  # of a ball's radius, over which it fades
PARTS = (np.indices((3, 3, 3)).reshape(3, -1).T - 1.0) / 3.0  # of a box, where it is looked at


@dataclass(frozen=True)
class Ball:
    """A part of the body.

    Attributes:
        centre: in stress-free coordinates [m], shape [3].
        radius: [m].
    """

    centre: np.ndarray
    radius: float

    def share(self, X: np.ndarray, edges: np.ndarray | None = None) -> np.ndarray:
        """How far points belong to it, from 1 inside to 0 outside, shape [points].

        Args:
            X: stress-free positions [m], shape [points, 3].
            edges: of the boxes about points, of which the mean is taken [m], shape [points, 3]; None: none is.
        """
        if edges is not None:
            return np.asarray(np.mean([self.share(X + part * edges) for part in PARTS], axis=0))
        apart = np.linalg.norm(X - self.centre, axis=1) / self.radius
        return np.clip((1.0 + 0.5 * EDGE - apart) / EDGE, 0.0, 1.0)

    def meets(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether it reaches into a box, of which two corners are given [m], shape [3]."""
        apart = self.centre - np.clip(self.centre, low, high)
        return bool(np.linalg.norm(apart) < (1.0 + 0.5 * EDGE) * self.radius)

    def spread(self, X: np.ndarray, volume: np.ndarray) -> np.ndarray:
        """Shares of what is spread in it evenly, whose sum is one, shape [points].

        Args:
            X: stress-free positions [m], shape [points, 3].
            volume: that each stands for [m^3], shape [points].

        Raises:
            ValueError: it holds none of the points.
        """
        share = self.share(X) * volume
        if not share.sum() > 0.0:
            raise ValueError(f"a ball of {self.radius} m about {self.centre} m holds no material")
        return np.asarray(share / share.sum())


@dataclass(frozen=True)
class Inclusion:
    """A ball of the body whose moduli are others, by a factor."""

    ball: Ball
    factor: float


@dataclass(frozen=True)
class AddedMass:
    """A mass [kg] that is spread in a ball of the body."""

    ball: Ball
    mass: float


@dataclass(frozen=True)
class World:
    """A body of one material, and what acts on it beside the tools.

    Attributes:
        law: of the body.
        values: of the law's parameters.
        density: mass per stress-free volume [kg/m^3].
        gravity: [m/s^2], shape [3].
        drag: force per mass and velocity [1/s], against the velocity in the world.
        swelling: stretch that the body has where it is free of stress, less one.
        inclusions: in the body.
        masses: that it carries.
        friction: Coulomb's coefficient on faces that are stated to be frictionless.
        adhesion: tension that they bear [Pa].
        slipping: shear compliance of the bond to supports whose force is not measured [m/Pa].
        slippery: inverse of the friction coefficient with them; zero or less: nothing slides.
        memories: of its stress, see ``form_drake.laws.memory``.
    """

    law: Law
    values: Values
    density: float
    gravity: np.ndarray
    drag: float = 0.0
    swelling: float = 0.0
    inclusions: tuple[Inclusion, ...] = ()
    masses: tuple[AddedMass, ...] = ()
    friction: float = 0.0
    adhesion: float = 0.0
    slipping: float = 0.0
    slippery: float = 0.0
    memories: tuple[Memory, ...] = ()

    def added(self, name: str, **values: float) -> "World":
        """The world with an addition to the law, see ``form_drake.laws.ADDITIONS``."""
        return replace(
            self, law=law_named(f"{self.law.name}+{name}"), values={**self.values, **values}
        )
