"""The twin that is nearest to the data: Marquardt's steps, of which every one teaches the next.

The columns of a twin are derivatives along its motion. What a step has really changed mends them
(Broyden 1965), also where it went too far.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Model
from form_drake.weak.solve import TINY

PASSES = 12  # coarse simulations, at most
FINE = 4  # simulations on the finer grid, at most
SETTLED = 0.5  # standard deviations that are no change
SAME = 0.5  # of a whitened gap's square that is left to gain, which is not worth a simulation
NOISE = 10.0  # of a whitened gap's square, by which a step may miss it through noise alone
WORSE = 1.05  # times the gap's square before, from which a step is taken back
MOST = np.log(2.0)  # largest change of a modulus in a pass, of its logarithm
FIRST, LARGER = 0.03, 10.0  # damping of a step that went too far, and by how much it grows


@dataclass(frozen=True)
class Search:
    """Where a search is.

    Attributes:
        match: the nearest twin so far.
        mended: what to add to its columns, shape [rows, unknowns].
        damping: of the next step.
    """

    match: Match
    mended: np.ndarray
    damping: float = 0.0

    @classmethod
    def of(cls, match: Match) -> "Search":
        return cls(match, np.zeros(match.slopes.shape))

    @cached_property
    def _columns(self) -> np.ndarray:
        """Whitened, shape [rows, unknowns]."""
        return self.match.by.white(self.match.slopes + self.mended)

    def _wanted(self, damping: float, columns: np.ndarray) -> np.ndarray:
        """Change of the unknowns: the law's, nonlinear ones last, then the causes'."""
        length = np.maximum(np.linalg.norm(columns, axis=0), TINY)
        ridge = np.sqrt(damping) * np.eye(len(length))
        rest = np.concatenate([self.match.gap, np.zeros(len(length))])
        found = np.linalg.lstsq(np.vstack([columns / length, ridge]), rest, rcond=None)[0]
        return np.asarray(found / length)

    def _change(self, damping: float, columns: np.ndarray) -> np.ndarray:
        """The same within the bounds of the unknowns."""
        own, *causes = np.split(self._wanted(damping, columns), self.match.parts)
        phi = self._phi
        least, most = np.exp(-MOST) - 1.0, np.exp(MOST) - 1.0
        own[: len(phi)] = np.clip(own[: len(phi)], least * np.abs(phi), most * np.abs(phi))
        own[len(phi) :] = np.clip(own[len(phi) :], -MOST, MOST)
        moves = [c.within(d) for c, d in zip(self.match.model.causes, causes, strict=True)]
        return np.concatenate([own, *moves])

    @property
    def _phi(self) -> np.ndarray:
        """The unknowns that the law is linear in."""
        return np.array([self.match.model.values[k] for k in self.match.problem.unknowns.keys])

    @property
    def settled(self) -> bool:
        """Whether a step would change no unknown, or gain nothing.

        By the twin's own columns: what steps teach has the noise of the data in it, whose product
        with itself does not vanish on average.
        """
        columns = self.match.explained
        gain = np.sum((columns @ self._wanted(0.0, columns)) ** 2)
        small = np.abs(self._change(0.0, columns)) < SETTLED * self.match.std
        return bool(gain < SAME or small.all())

    def model(self, change: np.ndarray) -> Model:
        """After a change of the unknowns."""
        match = self.match
        unknowns, model = match.problem.unknowns, match.model
        eta, _ = match.twin.coordinates(model.values)
        own, *causes = np.split(change, match.parts)
        phi, eta = self._phi + own[: len(self._phi)], eta + own[len(self._phi) :]
        theta = unknowns.theta(phi)
        values = {**model.values, **match.problem.values(eta)}
        values |= {t.key: float(v) for t, v in zip(unknowns.law.terms, theta, strict=True)}
        moved = [c.moved(d) for c, d in zip(model.causes, causes, strict=True)]
        return replace(model, values=values, causes=tuple(moved))

    def stepped(self) -> "Search":
        """After one more simulation."""
        match, change = self.match, self._change(self.damping, self._columns)
        damped = max(LARGER * self.damping, FIRST)
        try:
            after = match.near(self.model(change))
        except ValueError:  # the simulation does not stand the step
            if damped > LARGER**3:
                raise
            return replace(self, damping=damped)
        reached = float(np.sum(after.gap**2))
        surprise = reached - float(np.sum((match.gap - self._columns @ change) ** 2))
        taught = self.mended
        if surprise > NOISE:  # else what was missed is what noise of the data does to its columns
            weight = change / match.std**2
            missed = match.apart - after.apart - (match.slopes + self.mended) @ change
            taught = self.mended + np.outer(missed, weight) / (weight @ change)
        before = float(np.sum(match.gap**2))
        if reached > max(WORSE * before, before + 2.0 * SAME):
            return replace(self, mended=taught, damping=damped)
        less = self.damping / LARGER
        damping = less if less > FIRST / LARGER else 0.0
        return replace(self, match=after, mended=taught, damping=damping)

    def anchored(self) -> "Search":
        """The same place, with what the grid has wrong there."""
        match = self.match
        return replace(self, match=Match.of(match.problem, match.scenes, match.model))


def matched(start: Match, progress: Callable[[Search], None] = lambda search: None) -> Match:
    """The twin nearest to the data.

    Args:
        start: one of the same data.
        progress: hears where the search is.

    Raises:
        ValueError: the scenes cannot be simulated.
    """
    search, passes, fine = Search.of(start), 1, int(start.here)
    while True:
        progress(search)
        done = search.settled or passes == PASSES
        if done and (search.match.here or fine == FINE):
            return search.match
        if done:
            search, fine = search.anchored(), fine + 1
        else:
            search, passes = search.stepped(), passes + 1
