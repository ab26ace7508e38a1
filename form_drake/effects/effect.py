"""What an effect is: a column of the balance and a switch of the simulation, declared once."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Protocol

import numpy as np

from form_drake.effects.world import Ball, World
from form_drake.laws import Law, Values
from form_drake.laws.memory import Memory

Shape = Mapping[str, float]
Change = Callable[[np.ndarray, np.ndarray], np.ndarray]
FAR = 10.0  # times what was, or is likely at most, that a search goes to at once
SOFT, LIGHT = 1e4, 0.02  # shear modulus [Pa] and mass [kg] for which trials are stated
PLACE = {"x", "y", "z", "radius"}  # shape parameters of an effect that acts in a ball
CONDITIONS = ("free", "unknown", "bonded", "frictionless", "touched")  # of faces


def ball(shape: Shape) -> Ball:
    """The ball in the body that shape parameters x, y, z, radius [m] state."""
    return Ball(np.array([shape[axis] for axis in "xyz"]), shape["radius"])


class HasFaces(Protocol):
    """A body whose faces say how they are held."""

    @property
    def faces(self) -> Sequence[Any]: ...


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

    def remembered(self, memory: Memory) -> np.ndarray:
        """The stress of one remembered part in place of the law's, its share being one."""
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

    @property
    def scale(self) -> float:
        """By how much a quasi-static scene has more mass, and gravity less."""
        ...

    def mass(self, m: np.ndarray) -> np.ndarray:
        """Masses that move with the quadrature points [kg], shape [points]."""
        ...

    def once(self, name: str, make: Callable[[], np.ndarray]) -> np.ndarray:
        """What ``make`` gives, which is made at its first call and remembered by name."""
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
        unit: of the coefficient: factors with spaces between, and one slash at most.
        prior: from the least to the largest size that is likely, in that unit, as all coefficients here.
        column: (reading, shape) -> what a coefficient of one adds to A theta - b [N m s], shape [rows]; None:
            it is found by simulating with a coefficient of ``trial``.
        world: (world, coefficient, shape) -> the scene with the effect; None: it is the sensors'.
        sensor: (recording, coefficient, shape) -> what sensors with the effect record of a motion;
            None: it is the world's. The recording's ``p_WQ`` and ``forces`` are arrays as of
            ``form_drake.records.Recording``.
        shown: motions that show it.
        shapes: values of the shape parameters among which it is sought, by name; they are refined
            from the best. None for those of a place, which is sought in the body: x, y, z, radius.
            A radius is positive, and what has positive values alone.
        floors: least values of shape parameters, by name.
        parts: shapes -> shapes, and the shares in which columns of these add up to those of the former, shape
            [these, shapes]; None: each stands for itself.
        signed: whether the coefficient may be negative.
        least: coefficient that every one is above; of a signed effect, else it is zero.
        most: largest coefficient that there can be.
        share: whether the coefficient is a share of the stress: all of them add up to one at most.
        bends: whether it acts by how large the stress is: the law's columns are others beside it then.
        trial: coefficient with which an effect is simulated that has no column, or has one that is
            sharper than tracks are read; small, for a body of ``LIGHT`` whose shear modulus is ``SOFT``.
        faces: conditions of faces that it needs one of; empty: none.
        fits: whether it can be missing beside a law.
        same: ids of effects that no recording tells from it: they are of one class whatever columns show.
        compounds: whether it multiplies the forces that tools feel, as moduli do: more of it is added to what it
            has changed already, and it is known as a product with them.
        whole: whether what it changes is no sum of what parts of it do. Of a ball that is stiffer little is
            strained. Where it acts it is simulated, by a ``trial``. What has no column is such.
    """

    id: str
    sentence: str
    unit: str
    prior: tuple[float, float]
    column: Callable[[Reading, Shape], np.ndarray] | None = field(repr=False)
    world: Callable[[World, float, Shape], World] | None = field(default=None, repr=False)
    sensor: Callable[[Any, float, Shape], Any] | None = field(default=None, repr=False)
    shown: tuple[str, ...] = ()
    shapes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)
    parts: Callable[[Sequence[Shape]], tuple[list[Shape], np.ndarray]] | None = field(
        default=None, repr=False
    )
    signed: bool = True
    least: float = -np.inf
    most: float = np.inf
    share: bool = False
    bends: bool = False
    trial: float = 0.0
    faces: tuple[str, ...] = ()
    fits: Callable[[Law], bool] = field(default=lambda law: True, repr=False)
    same: tuple[str, ...] = ()
    compounds: bool = False
    whole: bool = False

    def __post_init__(self) -> None:
        if (self.world is None) == (self.sensor is None):
            raise ValueError(f"effect {self.id}: either world or sensor is wanted")
        if self.column is None and not self.trial > 0.0:
            raise ValueError(f"effect {self.id}: column or trial is wanted")
        if self.whole and not self.trial > 0.0:
            raise ValueError(f"effect {self.id}: one that acts as a whole wants a trial")
        if self.compounds and not (self.sensor and self.column and self.lower >= -1.0):
            raise ValueError(
                f"effect {self.id}: one that compounds wants a sensor, a column and no coefficient below -1"
            )
        object.__setattr__(self, "whole", self.whole or self.column is None)
        if len(self.prior) != 2 or not 0.0 < self.prior[0] < self.prior[1] < np.inf:
            raise ValueError(f"effect {self.id}: prior {self.prior} must be two increasing sizes")
        if "radius" in self.shapes and set(self.shapes) != PLACE:
            raise ValueError(
                f"effect {self.id}: shapes of a place are x, y, z and radius, got {', '.join(self.shapes)}"
            )
        for key, values in self.shapes.items():
            if len(set(values)) < 2 and "radius" not in self.shapes:
                raise ValueError(f"effect {self.id}: shape {key} wants two values or more")

    @property
    def columnless(self) -> bool:
        """Whether simulations alone tell what it changes, as what holds or lets go of a face.

        That need not be linear in its size.
        """
        return self.column is None

    @property
    def lower(self) -> float:
        """What every coefficient is above."""
        return self.least if self.signed else 0.0

    def check(self, size: float, shape: Shape) -> None:
        """Refuse what nobody can state of it; searches may pass through that.

        Raises:
            ValueError: shape parameters are not its own, or one or the coefficient is out of bounds.
        """
        if set(shape) != set(self.shapes):
            raise ValueError(
                f"effect {self.id}: shape {sorted(shape)} is given,"
                f" {sorted(self.shapes) or 'none'} is wanted"
            )
        if size != 0.0 and not self.lower < size <= self.most:
            most = f" and at most {self.most:g}" if self.most < np.inf else ""
            raise ValueError(
                f"effect {self.id}: coefficient {size:g} is given, one above {self.lower:g}{most} is"
                " wanted"
            )
        for key, value in shape.items():
            if self.positive(key) and not value > 0.0:
                raise ValueError(f"effect {self.id}: {key} must be positive, got {value:g}")
            if value < self.floors.get(key, -np.inf):
                raise ValueError(
                    f"effect {self.id}: {key} must be {self.floors[key]:g} or more, got {value:g}"
                )

    def bounded(self, size: float, now: float = 0.0) -> float:
        """A coefficient within what there can be; one beyond the least is half-way to it from ``now``.

        It is not ten times larger at once than it was or than is likely. What multiplies forces takes less
        than half of them away.
        """
        far = FAR * max(abs(now), self.prior[1])
        size = min(max(size, -far), far, self.most)
        lower = now - 0.5 * (1.0 + now) if self.compounds else self.lower
        return size if size > lower else 0.5 * (now + lower)

    def tried(self, modulus: float, mass: float) -> float:
        """``trial`` for a body, which goes with these as the unit does.

        Args:
            modulus: of the body [Pa].
            mass: its own [kg].
        """
        sizes = {"Pa": modulus / SOFT, "kg": mass / LIGHT}
        over, _, under = self.unit.partition("/")
        grown, shrunk = (np.prod([sizes.get(u, 1.0) for u in p.split()]) for p in (over, under))
        return float(self.trial * grown / shrunk)

    def grid(self) -> list[dict[str, float]]:
        """All combinations of the shape parameters."""
        return [
            dict(zip(self.shapes, values, strict=True)) for values in product(*self.shapes.values())
        ]

    def concerns(self, body: HasFaces) -> bool:
        """Whether a body has a face that it needs."""
        return not self.faces or any(f.condition in self.faces for f in body.faces)

    def width(self, shape: Shape, key: str) -> float:
        """How far a shape parameter is known: spacing of its grid, or half the radius of a place."""
        values = np.unique(self.shapes[key])
        if len(values) < 2:
            return 0.5 * shape["radius"]
        middles, apart = 0.5 * (values[1:] + values[:-1]), np.diff(values)
        return float(np.interp(shape[key], middles, apart))

    def positive(self, key: str) -> bool:
        """Whether a shape parameter is a size."""
        return key == "radius" or (len(self.shapes[key]) > 0 and min(self.shapes[key]) > 0.0)
