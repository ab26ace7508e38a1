"""What an effect is worth: motions that were held back, predicted without it and with it.

What a simulator has wrong is measured too, as what a coarser grid changes. That direction is projected
out of the errors before and after alike, so that neither is blamed for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from form_drake.diagnose.model import Model, Scenes
from form_drake.motion.tracks import jitter
from form_drake.records import Recording
from form_drake.weak.force import measured

COARSER = 1.5  # times the spacing, of the grid that tells what one has wrong
SEEN = 2.0  # times the floor, and
CLEAR = 3.0  # times what the grid leaves: smaller gaps say nothing
WORSE = 1.05  # times the error before, and
GRID = 2.0  # times what the grid changes, which a simulation may have wrong: more is worse
LEFT = 0.2  # of what the grid changes, which its projection leaves


@dataclass(frozen=True)
class Channel:
    """Root mean square errors of one kind of measurement in one recording.

    Attributes:
        name: of the recording and what is measured.
        unit: of the errors.
        before: without the effects.
        after: with them.
        floor: of the measurement's noise.
        grid: what a coarser grid changes of the prediction.
    """

    name: str
    unit: str
    before: float
    after: float
    floor: float
    grid: float

    @property
    def counts(self) -> bool:
        """Whether the gap is clear of what the grid changes."""
        return self.before > max(SEEN * self.floor, CLEAR * LEFT * self.grid)

    @property
    def worse(self) -> bool:
        """Whether the effects make the error larger, by more than noise and grid would."""
        least = WORSE * max(self.before, self.floor)
        return self.after > float(np.hypot(least, GRID * self.grid))

    @property
    def closure(self) -> float:
        """Share of the gap above the floor that is closed."""
        return (self.before - self.after) / max(self.before - self.floor, 1e-300)

    def to_json(self) -> dict[str, Any]:
        """As in ``discrepancy.json``."""
        return {
            "channel": self.name,
            "unit": self.unit,
            "before": self.before,
            "after": self.after,
            "floor": self.floor,
            "grid": self.grid,
            "closure": self.closure if self.counts else None,
        }


@dataclass(frozen=True)
class Check:
    """Held-out motions, predicted.

    Attributes:
        scenes: of the recordings that were held back.
        before: predicted without the effects.
        coarse: the same on a coarser grid.
    """

    scenes: Scenes
    before: tuple[Recording, ...]
    coarse: tuple[Recording, ...]

    @classmethod
    def of(cls, scenes: Scenes, without: Model) -> "Check":
        """Simulate held-out scenes with a model without effects."""
        before, coarse = (s.rolled(without) for s in (scenes, scenes.times(COARSER)))
        return cls(scenes, tuple(before), tuple(coarse))

    @property
    def measured(self) -> tuple[Recording, ...]:
        """Recordings that were held back."""
        return self.scenes.recordings

    def channels(self, after: Sequence[Recording]) -> list[Channel]:
        """Errors of the model without effects and of another one's recordings."""
        found = []
        rows = zip(self.measured, self.before, self.coarse, after, strict=True)
        for n, (seen, before, coarse, other) in enumerate(rows, start=1):
            tools = [
                (
                    f"force of {tool} {n}",
                    "N",
                    f.noise,
                    [r.forces[tool].value for r in (seen, before, coarse, other)],
                )
                for tool, f in measured(seen, 0.0, float(np.ptp(seen.time))).items()
            ]
            u = [r.p_WQ - seen.reference for r in (seen, before, coarse, other)]
            for name, unit, noise, values in [
                (f"tracks {n}", "m", tracking_noise(seen), u),
                *tools,
            ]:
                found.append(_channel(name, unit, noise, values))
        return found


def tracking_noise(recording: Recording) -> float:
    """Standard deviation of a measured coordinate [m], stated or from the jitter of the tracks."""
    if recording.noise is not None:
        return float(recording.noise)
    valid = np.isfinite(recording.p_WQ).all(axis=2)
    return jitter(recording.time, recording.p_WQ - recording.reference, valid)


def _channel(name: str, unit: str, noise: float, values: Sequence[np.ndarray]) -> Channel:
    seen, before, coarse, other = values
    grid = np.nan_to_num(before - coarse).ravel()
    along = grid / max(float(np.linalg.norm(grid)), 1e-300)
    use = np.isfinite(seen).ravel()

    def rms(a: np.ndarray) -> float:
        flat = np.where(use, a.ravel(), 0.0)
        flat = flat - along * (along @ flat)
        return float(np.sqrt(flat @ flat / use.sum()))

    size = float(np.sqrt(np.mean(grid**2)))
    return Channel(name, unit, rms(seen - before), rms(seen - other), noise, size)
