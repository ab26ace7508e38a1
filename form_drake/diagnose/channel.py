"""Errors of predictions of one kind of measurement, before and after effects are added.

What a simulator has wrong is measured too, as what a coarser grid changes. That direction is projected
out of the errors before and after alike, so that neither is blamed for it. Plates that may stand elsewhere
are taken to be where all channels of a recording together would have them, as far as they may be. What noise
adds to a mean square is taken off, so that a gap far below the noise of one sample is seen where there are
many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from form_drake.diagnose.match import Match

OFF = 3.0  # standard deviations, by which plates may be off at most
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


@dataclass(frozen=True)
class Kind:
    """One kind of measurement in a recording.

    Attributes:
        name: of the recording and what is measured.
        unit: of the values.
        noise: of one measurement.
        values: measured; predicted without effects, on a coarser grid, and with them.
        elsewhere: what plates change of a prediction that are off by one standard deviation, for every way.
    """

    name: str
    unit: str
    noise: float
    values: Sequence[np.ndarray]
    elsewhere: Sequence[np.ndarray] = ()

    @property
    def scale(self) -> float:
        """Noise, which is never quite none."""
        return max(self.noise, EXACT * float(np.abs(self.values[0]).max())) or 1.0

    @property
    def grid(self) -> np.ndarray:
        """What the grid changes, shape [samples]."""
        _, before, coarse, _ = self.values
        return np.asarray(before - coarse).ravel()

    @property
    def errors(self) -> np.ndarray:
        """Before and after, and what plates change; off what the grid does; shape [samples, 2 + ways]."""
        seen, before, _, after = self.values
        parts = (seen - before, seen - after, *self.elsewhere)
        every = np.stack([a.ravel() for a in parts], axis=1)
        along = self.grid / max(float(np.linalg.norm(self.grid)), 1e-300)
        return np.asarray(every - np.outer(along, along @ every))


def compared(kinds: Sequence[Kind]) -> list[Channel]:
    """Predictions of one recording beside what was measured."""
    if not kinds:
        return []
    errors = [kind.errors for kind in kinds]
    whole = np.vstack([a / kind.scale for a, kind in zip(errors, kinds, strict=True)])
    gaps, ways = whole[:, :2], whole[:, 2:]
    count = ways.shape[1]
    rows = np.vstack([ways, np.eye(count)]), np.vstack([gaps, np.zeros((count, 2))])
    off = np.linalg.lstsq(*rows, rcond=None)[0] if count else np.zeros((0, 2))
    off /= np.maximum(1.0, np.linalg.norm(off, axis=0) / OFF)
    found = []
    for kind, own in zip(kinds, errors, strict=True):
        squares = np.mean((own[:, :2] - own[:, 2:] @ off) ** 2, axis=0)
        before, after = (_beyond(float(np.sqrt(square)), kind.noise) for square in squares)
        size = float(np.sqrt(np.mean(kind.grid**2)))
        found.append(Channel(kind.name, kind.unit, before, after, kind.noise, len(own), size))
    return found


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
