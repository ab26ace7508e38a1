"""What an effect is: a column of the balance and a switch of the simulation, declared once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Protocol

import numpy as np

from form_drake.effects.world import Ball, World
from form_drake.laws import Law, Values

Shape = Mapping[str, float]
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]


def ball(shape: Shape) -> Ball:
    """The ball in the body that shape parameters x, y, z, radius [m] state."""
    return Ball(np.array([shape[axis] for axis in "xyz"]), shape["radius"])


class Reading(Protocol):
    """A measured motion, and the integrals of the balance A theta = b along it.

    Every method gives what a source adds to A theta - b, one number for each row [N m s].
    """

    @property
    def law(self) -> Law: ...

    @property
    def values(self) -> Values:
        """Parameters of the law that have been identified."""
        ...

    @property
    def X(self) -> np.ndarray:
        """Stress-free positions of the quadrature points [m], shape [points, 3]."""
        ...

    @property
    def v(self) -> np.ndarray:
        """Velocities [m/s], shape [times, points, 3]."""
        ...

    @property
    def gravity(self) -> np.ndarray:
        """[m/s^2], shape [3]."""
        ...

    def stress(self, tau: np.ndarray) -> np.ndarray:
        """A Kirchhoff stress [Pa], shape [times, points, 3, 3]."""
        ...

    def added(self, name: str, values: Values) -> np.ndarray:
        """The stress of an addition to the law, its one coefficient being one."""
        ...

    def now(self) -> np.ndarray:
        """The Kirchhoff stress of the law as it is [Pa], shape [times, points, 3, 3]."""
        ...

    def shared(self, share: np.ndarray) -> np.ndarray:
        """A share of that stress, which differs from point to point, shape [points]."""
        ...

    def stretched(self, factor: float) -> np.ndarray:
        """The same, were every deformation gradient multiplied by a factor."""
        ...

    def load(self, per_mass: np.ndarray) -> np.ndarray:
        """A force per mass [m/s^2], shape [times, points, 3]."""
        ...

    @property
    def m(self) -> np.ndarray:
        """Mass of the quadrature points as the density states it [kg], shape [points]."""
        ...

    def mass(self, m: np.ndarray) -> np.ndarray:
        """Masses that move with the quadrature points [kg], shape [points]."""
        ...

    def force(self, change: Change) -> np.ndarray:
        """What ``change`` (time [s], force [N, samples x 3]) gives in place of every measured force."""
        ...

    def moved(self, displacement: Change) -> np.ndarray:
        """Tracks that are displaced by ``displacement`` (X, x) [m], to first order."""
        ...


@dataclass(frozen=True)
class Effect:
    """A cause of disagreement between simulation and measurement, with one coefficient.

    Attributes:
        id: as on the command line.
        sentence: what it is, for a report.
        unit: of the coefficient.
        prior: from the least to the largest size that is likely.
        column: (reading, shape) -> what a coefficient of one adds to A theta - b.
        world: (world, coefficient, shape) -> the scene with the effect; None: it is the sensors'.
        sensor: (recording, coefficient, shape) -> what sensors with the effect record of a motion;
            None: it is the world's. The recording's ``p_WQ`` and ``forces`` are arrays as of
            ``form_drake.records.Recording``.
        shown: motions that show it.
        shapes: values of the shape parameters among which it is sought, by name.
        signed: whether the coefficient may be negative.
        fits: whether it can be missing beside a law.
    """

    id: str
    sentence: str
    unit: str
    prior: tuple[float, float]
    column: Callable[[Reading, Shape], np.ndarray] = field(repr=False)
    world: Callable[[World, float, Shape], World] | None = field(default=None, repr=False)
    sensor: Callable[[Any, float, Shape], Any] | None = field(default=None, repr=False)
    shown: tuple[str, ...] = ()
    shapes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    signed: bool = True
    fits: Callable[[Law], bool] = field(default=lambda law: True, repr=False)

    def __post_init__(self) -> None:
        if (self.world is None) == (self.sensor is None):
            raise ValueError(f"effect {self.id}: either world or sensor is wanted")
        if not 0.0 < self.prior[0] < self.prior[1] < np.inf:
            raise ValueError(f"effect {self.id}: prior {self.prior} must be two increasing sizes")

    def grid(self) -> list[dict[str, float]]:
        """All combinations of the shape parameters."""
        return [
            dict(zip(self.shapes, values, strict=True)) for values in product(*self.shapes.values())
        ]
