"""The twin that is nearest to the data: Marquardt's steps, of which every one teaches the next.

The columns of a twin are derivatives along its motion. What a step has really changed mends them
(Broyden 1965), also where it went too far.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Model
from form_drake.diagnose.projected import Projected
from form_drake.weak.solve import TINY

PASSES = 12  # coarse simulations, at most
FINE = 4  # simulations on the finer grid, at most
NEAR = 0.03  # of the rows, from where what the grid has wrong is found
SETTLED = 0.5  # standard deviations that are no change
SAME = 0.5  # of a whitened gap's square that is left to gain, which is not worth a simulation
GAINED, IDLE = 0.003, 2  # of it, that a step must gain; steps that may gain less in a row
AMISS = 0.05  # the same, of what exceeds one for each row: the model is another
NOISE = 10.0  # of a whitened gap's square, by which a step may miss it through noise alone
WORSE = 1.05  # times the gap's square before, from which a step is taken back
FIRST, LARGER = 0.03, 10.0  # damping of a step that went too far, and by how much it grows

M = TypeVar("M", bound=Projected)


@dataclass(frozen=True)
class Search(Generic[M]):
    """Where a search is.

    Attributes:
        match: the nearest twin so far.
        mended: what to add to its columns, shape [rows, unknowns].
        damping: of the next step.
        idle: steps in a row that have gained next to nothing.
    """

    match: M
    mended: np.ndarray
    damping: float = 0.0
    idle: int = 0

    @classmethod
    def of(cls, match: M) -> "Search[M]":
        return cls(match, np.zeros(match.slopes.shape))

    @property
    def lighter(self) -> "Search[M]":
        """The same, see ``Projected.lighter``."""
        return replace(self, match=self.match.lighter)

    @cached_property
    def _columns(self) -> np.ndarray:
        """Whitened, shape [rows, unknowns]."""
        return self.match.white(self.match.slopes + self.mended)

    def _change(self, damping: float, columns: np.ndarray) -> np.ndarray:
        """Change of the unknowns within their bounds: the law's, nonlinear ones last, then the causes'.

        Where a bound cuts one of them, the others are sought again beside it.
        """
        found, free = np.zeros(columns.shape[1]), np.ones(columns.shape[1], bool)
        while free.any():
            rest = self.match.gap - columns[:, ~free] @ found[~free]
            found[free] = _least(columns[:, free], rest, damping)
            cut = self._within(found)
            free &= cut == found
            if np.array_equal(cut, found):
                break
            found = cut
        return found

    def _within(self, change: np.ndarray) -> np.ndarray:
        own, *causes = np.split(change, self.match.parts)
        moves = [c.within(d) for c, d in zip(self.match.model.causes, causes, strict=True)]
        return np.concatenate([self.match.within(own), *moves])

    @property
    def settled(self) -> bool:
        """Whether a step would change no unknown, or gain nothing.

        Far from where the grid's error is known: whether it would change little. By the twin's own
        columns: what steps teach has the noise of the data in it, whose product with itself does not
        vanish on average.
        """
        if self.idle >= IDLE:
            return True
        columns = self.match.explained
        if self.match.far:
            step = columns @ self._change(0.0, columns)
            return bool(np.linalg.norm(step) < NEAR * self.match.size)
        gain = np.sum((columns @ _least(columns, self.match.gap)) ** 2)
        small = np.abs(self._change(0.0, columns)) < SETTLED * self.match.std
        return bool(gain < SAME or small.all())

    @property
    def _worth(self) -> float:
        """What a step must take of the gap's square: more where it is far above one for each row."""
        gap = self.match.gap
        square = float(gap @ gap)
        return max(SAME, GAINED * square, AMISS * (square - len(gap)))

    def model(self, change: np.ndarray) -> Model:
        """After a change of the unknowns.

        Moduli and what multiplies forces are known as a product, which goes as columns say.
        """
        own, *causes = np.split(change, self.match.parts)
        model = self.match.model
        moved = [c.moved(d) for c, d in zip(model.causes, causes, strict=True)]
        after = replace(model, values=self.match.valued(own), causes=tuple(moved))
        return replace(after, values=self._scaled(after, model.shown / after.shown)).whole

    def _scaled(self, after: Model, share: float) -> dict[str, float]:
        """Values of the law, those of its terms changed by a share of what they are."""
        if share == 1.0:
            return dict(after.values)
        before, terms = self.match.model.values, {t.key for t in after.law.terms}
        return {
            k: before[k] + share * (v - before[k]) if k in terms else v
            for k, v in after.values.items()
        }

    def _change_to(self, model: Model) -> np.ndarray:
        """What columns say of a model: the change of the unknowns that keeps the product."""
        before = self.match.model
        values = self._scaled(model, model.shown / before.shown)
        return self.match.towards(replace(model, values=values))

    def anchored(self: "Search[Match]") -> "Search[Match]":
        """With what the grid has wrong here; columns of the law that are made anew need no mending."""
        match, mended = self.match.anchored(), self.mended.copy()
        if match.bending:
            mended[:, : match.parts[0]] = 0.0
        return replace(self, match=match, mended=mended, idle=0)

    def stepped(self) -> "Search[M]":
        """After one more simulation."""
        match, damped = self.match, max(LARGER * self.damping, FIRST)
        model = self.model(self._change(self.damping, self._columns))
        change = self._change_to(model)  # shares that add up to one, and firm moduli, may be others
        try:
            after = match.near(model)
        except ValueError:  # the simulation does not stand the step
            if damped > LARGER**3:
                raise
            return replace(self, damping=damped)
        expected = float(np.sum((match.gap - self._columns @ change) ** 2)) - match.chance_apart
        surprise = after.excess - expected
        taught = self.mended
        if surprise > NOISE:  # else what was missed is what noise of the data does to its columns
            weight = change / match.std**2
            missed = -after.explains(match) - (match.slopes + self.mended) @ change
            taught = self.mended + np.outer(missed, weight) / max(weight @ change, TINY)
        before, gained = float(np.sum(match.gap**2)), match.excess - after.excess
        idle = self.idle + 1 if gained < self._worth else 0
        if gained < -max((WORSE - 1.0) * before, 2.0 * SAME):
            return replace(self, mended=taught, damping=damped, idle=idle)
        less = self.damping / LARGER
        damping = less if less > FIRST / LARGER else 0.0
        taught = np.where(after.anew, 0.0, taught)
        return replace(self, match=after, mended=taught, damping=damping, idle=idle)


def _least(columns: np.ndarray, gap: np.ndarray, damping: float = 0.0) -> np.ndarray:
    """Least squares; what no row sees stays where it is."""
    norms = np.linalg.norm(columns, axis=0)
    length = np.maximum(norms, TINY)
    ridge = np.sqrt(damping) * np.eye(len(length))
    rest = np.concatenate([gap, np.zeros(len(length))])
    found = np.linalg.lstsq(np.vstack([columns / length, ridge]), rest, rcond=None)[0]
    return np.where(norms > TINY, found / length, 0.0)


def matched(start: Match, *, rough: bool = False) -> Match:
    """The twin nearest to the data.

    Args:
        start: one of the same data.
        rough: whether what the grid has wrong may be that of a model which is another, where far more
            than that is missing.

    Raises:
        ValueError: the scenes cannot be simulated.
    """
    search = Search.of(start)
    passes, fine = 1, 0
    while True:
        done = search.settled or passes == PASSES
        if done and (search.match.here or fine == FINE or (rough and search.match.gross)):
            return search.match
        if done:
            search, fine = search.anchored(), fine + 1
        else:
            search, passes = search.stepped(), passes + 1
