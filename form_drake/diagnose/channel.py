"""Errors of predictions of one kind of measurement, before and after effects are added.

What a simulator has wrong is measured too, as what a coarser grid changes. That direction is projected
out of the errors before and after alike, so that neither is blamed for it. Plates that may stand elsewhere
are taken to be where all channels of a recording together would have them. What noise adds to a mean square
is taken off, so that a gap far below the noise of one sample is seen where there are many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from form_drake.diagnose.match import Match

EXACT = 1e-9  # of the largest of some measurements, below which their noise is none
SEEN = 2.0  # times the floor, four standard deviations of a mean square, and
TOLD = 0.02  # share of itself, to which a noise is known
CLEAR = 3.0  # times what the grid changes: smaller gaps say nothing
WORSE = 1.05  # times the error before, and
GRID = 2.0  # times what the grid changes, which a simulation may have wrong: more is worse


@dataclass(frozen=True)
class Channel:
    """Errors of predictions of one kind of measurement in one recording, root mean squares beyond noise.

    Attributes:
        name: of the recording and what is measured.
        unit: of the errors.
        before: without the effects.
        after: with them.
        noise: of one measurement.
        samples: number of measurements, whose noise is independent; of the balance, of rows that noise
            fills on average.
        grid: what a coarser grid changes of the prediction.
    """

    name: str
    unit: str
    before: float
    after: float
    noise: float
    samples: float
    grid: float

    @property
    def floor(self) -> float:
        """Error whose square is a standard deviation of the mean square of noise, and of what is told of it."""
        return float(self.noise * (2.0 / self.samples + (2.0 * TOLD) ** 2) ** 0.25)

    @property
    def counts(self) -> bool:
        """Whether the gap is clear of noise and of what the grid changes."""
        return self.before > max(SEEN * self.floor, CLEAR * self.grid)

    @property
    def worse(self) -> bool:
        """Whether the effects make the error larger, by more than noise and grid would."""
        least = np.linalg.norm([WORSE * self.before, SEEN * self.floor, GRID * self.grid])
        return bool(self.after > least)

    @property
    def closure(self) -> float:
        """Share of the gap above the floor that is closed; errors below the floor are none."""
        gap = self.before - self.floor
        return (self.before - max(self.after, self.floor)) / max(gap, 1e-300)

    def to_json(self) -> dict[str, Any]:
        """As in ``discrepancy.json``."""
        return {
            "channel": self.name,
            "unit": self.unit,
            "before": self.before,
            "after": self.after,
            "noise": self.noise,
            "floor": self.floor,
            "grid": self.grid,
            "closure": self.closure if self.counts else None,
        }


Kind = tuple[str, str, float, Sequence[np.ndarray]]


def compared(kinds: Sequence[Kind]) -> list[Channel]:
    """Of what was measured in one recording, predicted without effects, on the coarse grid and with them.

    Args:
        kinds: name, unit and noise of every measurement, and these four; then what is predicted without
            effects on the coarse grid where a plate is off by one standard deviation, for every such way.
    """
    if not kinds:
        return []
    grids, gaps, ways = zip(*(_off_grid(values) for *_, values in kinds), strict=True)
    sizes = [max(noise, EXACT * float(np.abs(v[0]).max())) or 1.0 for *_, noise, v in kinds]
    A, b = (np.vstack([a / s for a, s in zip(x, sizes, strict=True)]) for x in (ways, gaps))
    took = np.linalg.solve(A.T @ A + np.eye(A.shape[1]), A.T @ b)
    found = []
    for (name, unit, noise, _), grid, gap, way in zip(kinds, grids, gaps, ways, strict=True):
        squares = np.mean((gap - way @ took) ** 2, axis=0)
        before, after = (_beyond(np.sqrt(square), noise) for square in squares)
        found.append(Channel(name, unit, before, after, noise, len(gap), grid))
    return found


def _off_grid(values: Sequence[np.ndarray]) -> tuple[float, np.ndarray, np.ndarray]:
    """What the grid changes, errors before and after without that, and what plates change, likewise."""
    seen, before, coarse, other, *elsewhere = (v.ravel() for v in values)
    grid = before - coarse
    along = grid / max(float(np.linalg.norm(grid)), 1e-300)
    every = np.stack([seen - before, seen - other, *(v - coarse for v in elsewhere)], axis=1)
    every -= np.outer(along, along @ every)
    return float(np.sqrt(np.mean(grid**2))), every[:, :2], every[:, 2:]


def of_balance(before: Match, after: Match) -> Channel:
    """Rows of the balance, in standard deviations, by the weights after."""
    grid = np.zeros(len(after.gap)) if after.grid is None else after.grid
    rows = after.by.white(np.stack([before.apart, after.apart, grid], axis=1))
    was, now, changed = np.sqrt(np.mean(rows**2, axis=0))
    noise = float(np.sqrt(after.chance_apart / len(rows)))
    was, now = _beyond(was, noise), _beyond(now, noise)
    samples = max(after.chance_apart, 1.0)
    return Channel("balance", "sigma", was, now, noise, samples, float(changed))


def _beyond(error: float, noise: float) -> float:
    """A root mean square less what noise adds to its square."""
    return float(np.sqrt(max(error**2 - noise**2, 0.0)))
