"""The linear algebra of naming: what is left beside what law and known causes explain.

It is the same whatever the rows are: those of a balance, or what is seen of a motion.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np

from form_drake.diagnose.model import Cause, Model
from form_drake.effects import Effect, Shape
from form_drake.laws import Values
from form_drake.motion import Body
from form_drake.weak.solve import TINY

SLIGHT = 1e-3  # of a standard deviation, in differences
SINGULAR = 1e-15  # of the largest singular value, from which a combination of unknowns is seen


class Projected(ABC):
    """Data beside a twin, in rows that ``white`` makes independent, of unit variance."""

    model: Model
    entire = True  # whether columns of what acts as a whole are changes of all of it

    @property
    @abstractmethod
    def bodies(self) -> list[Body]:
        """The specimen in every probe."""

    @property
    @abstractmethod
    def apart(self) -> np.ndarray:
        """What the twin leaves of the data, not whitened, shape [rows]."""

    @property
    @abstractmethod
    def own_slopes(self) -> np.ndarray:
        """Columns of the law's unknowns, not whitened, shape [rows, unknowns]."""

    @abstractmethod
    def white(self, a: np.ndarray) -> np.ndarray:
        """Rows whose covariance is the unit matrix."""

    @abstractmethod
    def learn(self, wanted: Sequence[tuple[Effect, Sequence[Shape]]]) -> None:
        """Make the columns of effects that will be asked for, on all cores."""

    @abstractmethod
    def changes(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        """An effect's columns, not whitened, shape [rows, shapes]."""

    @abstractmethod
    def near(self, model: Model) -> Self:
        """That of a model which is not far, by one coarse simulation."""

    @abstractmethod
    def within(self, change: np.ndarray) -> np.ndarray:
        """A change of the law's unknowns, cut so that none leaves its bounds or goes far at once."""

    @abstractmethod
    def valued(self, change: np.ndarray) -> Values:
        """Values of the law after a change of its unknowns."""

    @abstractmethod
    def turned(self, values: Values) -> np.ndarray:
        """Change of the law's unknowns that gives it other values."""

    def towards(self, model: Model) -> np.ndarray:
        """Change of all unknowns that gives a model with the same causes."""
        pairs = zip(self.model.causes, model.causes, strict=True)
        return np.concatenate([self.turned(model.values), *(a.towards(b) for a, b in pairs)])

    @property
    def far(self) -> bool:
        """Whether what the grid has wrong is not known, or of a model that is another."""
        return False

    @property
    @abstractmethod
    def size(self) -> float:
        """Of the rows, in standard deviations."""

    def on(self, coarser: float) -> Self:
        """With a twin on another grid, times as coarse, where there is one."""
        return self

    @property
    def lighter(self) -> Self:
        """The same with all that it was asked for, without what that was made from."""
        return self

    def columns(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        """An effect's columns, whitened, shape [rows, shapes]."""
        return self.white(self.changes(effect, shapes))

    def explains(self, after: Self) -> np.ndarray:
        """What another twin explains that this one leaves, not whitened, shape [rows].

        Without the data's noise: as if they were what the other twin makes.
        """
        return self.apart - after.apart

    @cached_property
    def gap(self) -> np.ndarray:
        """Whitened, shape [rows]."""
        return self.white(self.apart)

    @cached_property
    def explained(self) -> np.ndarray:
        """Columns of the law's unknowns, and of the causes', whitened, shape [rows, unknowns]."""
        return self.white(self.slopes)

    @cached_property
    def slopes(self) -> np.ndarray:
        """The same, not whitened."""
        own = self.own_slopes
        self.learn([(c.effect, c.beside) for c in self.model.causes if self._kept(c) is None])
        return np.hstack([own, *(self._slopes(cause) for cause in self.model.causes)])

    def _kept(self, cause: Cause) -> np.ndarray | None:
        """Columns of a cause's unknowns that were made beside another twin; None: they are made."""
        return None

    @property
    def anew(self) -> np.ndarray:
        """Which unknowns have columns that are simulated beside this very twin, shape [unknowns]."""
        whole = self.entire
        causes = [
            np.full(c.unknowns, whole and c.effect.whole and self._kept(c) is None)
            for c in self.model.causes
        ]
        return np.concatenate([np.zeros(self.own_slopes.shape[1], dtype=bool), *causes])

    def _slopes(self, cause: Cause) -> np.ndarray:
        """Columns of a cause's coefficient and shape parameters, shape [rows, unknowns]."""
        kept = self._kept(cause)
        if kept is not None:
            return kept
        columns = self.changes(cause.effect, cause.beside)
        if cause.effect.whole and self.entire:  # as it is, nothing is changed
            columns[:, 1:] *= [dict(shape) != dict(cause.shape) for shape in cause.beside[1:]]
        turns = (columns[:, 2::2] - columns[:, 1::2]) / np.ptp(cause.ends, axis=1)
        return np.hstack([columns[:, :1], cause.coefficient * turns])

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

    @property
    def chance(self) -> float:
        """Square of ``left`` if nothing but noise were missing."""
        return self.chance_apart - self.basis.shape[1]

    @property
    def chance_apart(self) -> float:
        """The same of ``gap``."""
        return float(len(self.gap))

    @property
    def excess(self) -> float:
        """Square of ``gap`` beyond what noise gives.

        Noise of the tracks may enter the rows with the moduli: by the square alone, a model with smaller
        ones would be nearer.
        """
        return float(self.gap @ self.gap) - self.chance_apart

    @property
    def excess_left(self) -> float:
        """The same of ``left``."""
        return float(self.left @ self.left) - self.chance

    @property
    def parts(self) -> list[int]:
        """Where the unknowns of one cause end and those of the next begin."""
        counts = [c.unknowns for c in self.model.causes]
        first = self.explained.shape[1] - sum(counts)
        return np.cumsum([first, *counts])[:-1].tolist()

    def worth(self, n: int = -1) -> float:
        """What the gap's square would grow by without the n-th cause, all else refitted to first order.

        What acts as a whole may change nothing with its size, as a plate that sticks fast anyway, and much
        by being there: the twin is simulated without it.
        """
        begin, cause = self.parts[n], self.model.causes[n]
        others = np.arange(len(self._seen))
        others = others[self._seen & ((others < begin) | (others >= begin + cause.unknowns))]
        own = cause.coefficient * self.explained[:, begin]
        if cause.effect.whole:
            own = self.near(self.model.without(cause)).gap - self.gap
        basis = np.linalg.qr(self.explained[:, others])[0]
        own = own - basis @ (basis.T @ own)
        return float(own @ own)

    @cached_property
    def std(self) -> np.ndarray:
        """Of the unknowns; infinite where no row sees one."""
        return np.where(self._seen, np.linalg.norm(self.root, axis=1), np.inf)

    @cached_property
    def root(self) -> np.ndarray:
        """R of the covariance R R^T of the unknowns that are seen, shape [unknowns, unknowns]."""
        length = np.maximum(np.linalg.norm(self.explained, axis=0), TINY)
        _, s, Vt = np.linalg.svd(self.explained / length, full_matrices=False)
        told = s > SINGULAR * s.max(initial=0.0)
        return np.asarray(Vt[told].T / s[told] / length[:, None] * self._seen[:, None])

    @property
    def told(self) -> Model:
        """The model with the covariance of its values, its causes with their standard deviations.

        Of shapes those that are seen.
        """
        own, *parts = np.split(self.std, self.parts)
        causes = []
        for cause, (size, *shape) in zip(self.model.causes, parts, strict=True):
            spread = zip(cause.effect.shapes, map(float, shape), strict=True)
            seen = {key: std for key, std in spread if np.isfinite(std)}
            causes.append(cause.known(float(size), seen))
        keys, slopes = self._told(own)
        rows = np.zeros((len(keys) + len(causes), len(self.std)))
        rows[: len(keys), : len(own)] = slopes
        rows[np.arange(len(keys), len(rows)), self.parts] = 1.0
        root = rows @ self.root
        return replace(self.model, causes=tuple(causes), keys=keys, covariance=root @ root.T)

    def _told(self, std: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
        """Parameters that go with the law's unknowns, and their derivatives, shape [keys, unknowns]."""
        keys, slopes = list(self.model.law.keys), np.zeros((len(self.model.law.keys), len(std)))
        for k in np.flatnonzero(np.isfinite(std)):
            step = np.zeros(len(std))
            step[k] = SLIGHT * std[k]
            more, less = self.valued(step), self.valued(-step)
            slopes[:, k] = [(more[key] - less[key]) / (2.0 * step[k]) for key in keys]
        seen = np.flatnonzero(slopes.any(axis=1))
        return tuple(keys[n] for n in seen), slopes[seen]
