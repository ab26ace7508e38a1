"""The linear algebra of naming: what is left beside what law and known causes explain.

It is the same whatever the rows are: those of a balance, or what is seen of a motion.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from form_drake.diagnose.model import Model
from form_drake.effects import Effect, Shape
from form_drake.motion import Body
from form_drake.weak.solve import TINY


class Projected(ABC):
    """Data beside a twin, in rows whose covariance is the unit matrix."""

    model: Model

    @property
    @abstractmethod
    def bodies(self) -> list[Body]:
        """The specimen in every probe."""

    @property
    @abstractmethod
    def gap(self) -> np.ndarray:
        """What the twin leaves of the data, shape [rows]."""

    @property
    @abstractmethod
    def explained(self) -> np.ndarray:
        """Columns of the law's unknowns, and of the causes', shape [rows, unknowns]."""

    @abstractmethod
    def learn(self, wanted: Sequence[tuple[Effect, Sequence[Shape]]]) -> None:
        """Make the columns of effects that will be asked for, on all cores."""

    @abstractmethod
    def columns(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        """An effect's columns, shape [rows, shapes]."""

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal, of what law and causes explain, shape [rows, unknowns]."""
        return np.asarray(np.linalg.qr(self.explained[:, self._seen])[0])

    @property
    def _seen(self) -> np.ndarray:
        """Which unknowns change any row, as the radius of a point mass does not, shape [unknowns]."""
        return np.asarray(np.linalg.norm(self.explained, axis=0) > TINY)

    @cached_property
    def left(self) -> np.ndarray:
        """What they leave of the gap, whitened, shape [rows]."""
        return self.off(self.gap)

    def off(self, a: np.ndarray) -> np.ndarray:
        """What they leave of whitened columns."""
        return np.asarray(a - self.basis @ (self.basis.T @ a))
