"""What an effect is worth: motions that were held back, predicted without it and with it.

What a simulator has wrong is measured too, as what a coarser grid changes. That direction is projected
out of the errors before and after alike, so that neither is blamed for it. What noise adds to a mean square
is taken off, so that a gap far below the noise of one sample is seen where there are many.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Scenes
from form_drake.diagnose.noise import most
from form_drake.diagnose.prepare import problem_of, require_throughout
from form_drake.diagnose.verdict import LEAST, WRONG
from form_drake.identify.problem import Problem
from form_drake.motion.tracks import jitter, placed, valid_points
from form_drake.records import Recording
from form_drake.weak.force import measured

COARSER = 1.5  # times the spacing, of the grid that tells what one has wrong
EXACT = 1e-4  # of the grid spacing, below which a noise that nobody states is none
SEEN = 2.0  # times the floor, four standard deviations of a mean square, and
TOLD = 0.02  # share of itself, to which a noise is known
CLEAR = 3.0  # times what the grid changes: smaller gaps say nothing
WORSE = 1.05  # times the error before, and
GRID = 2.0  # times what the grid changes, which a simulation may have wrong: more is worse
SURE = 3.0  # standard deviations, by which a change is another than was predicted


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
class Predicted:
    """Held-out motions as a model has them.

    Attributes:
        recordings: simulated.
        coarse: the same on a coarser grid.
        match: their rows beside those of the data; what the unknowns of the model may have wrong is an
            error of them. None: tracks and forces alone are compared.
    """

    recordings: tuple[Recording, ...]
    coarse: tuple[Recording, ...]
    match: Match | None


@dataclass(frozen=True)
class Check:
    """Held-out motions, predicted.

    Attributes:
        scenes: of the recordings that were held back.
        problem: they, read for the balance; None: they cannot be.
        before: predicted without the effects.
        unread: why the balance of the one or of the other cannot be; "": it is.
    """

    scenes: Scenes
    problem: Problem | None
    before: Predicted
    unread: str = ""

    @classmethod
    def of(cls, scenes: Scenes, fitted: Match) -> "Check":
        """Simulate held-out scenes with a model without effects.

        Args:
            scenes: of the recordings that were held back.
            fitted: to the other recordings.

        Raises:
            ValueError: a recording does not state its scene, or a simulation fails.
        """
        scenes = replace(scenes, coarser=COARSER)
        rolled, problem, whose = _rolled(scenes, fitted), None, "as measured"
        try:
            problem = problem_of(scenes, fitted.problem.unknowns)
            whose = "as predicted without the effects"
            return cls(scenes, problem, _read(problem, scenes, fitted, *rolled))
        except ValueError as error:
            return cls(scenes, problem, Predicted(*rolled, None), f"{whose}, {error}")

    @property
    def measured(self) -> tuple[Recording, ...]:
        """Recordings that were held back."""
        return self.scenes.recordings

    def predicted(self, fitted: Match) -> Predicted:
        """What a model with effects predicts.

        Raises:
            ValueError: a simulation fails, or cannot be read.
        """
        rolled = _rolled(self.scenes, fitted)
        if self.problem is None:
            return Predicted(*rolled, None)
        return _read(self.problem, self.scenes, fitted, *rolled)

    def bears_out(self, after: Predicted) -> bool:
        """Whether the rows change by as much as effects predict, and no more is left than may be.

        How much of the predicted change is there is known but for noise and what simulations of
        effects have wrong; half of it, or half as much again, is never right. Too small a change is
        no matter of them.
        """
        if after.match is None:
            return True
        left = float(np.sum(after.match.gap**2))
        if self.before.match is None:
            return left < most(after.match.chance_apart)
        before, now = self.before.match.apart, after.match.apart
        was, change = after.match.by.white(np.stack([before, before - now], axis=1)).T
        square = float(change @ change)
        if square > LEAST:
            unsure = SURE * float(np.hypot(1.0 / np.sqrt(square), WRONG))
            if abs(float(was @ change) / square - 1.0) > min(unsure, 0.5):
                return False
        return left < most(after.match.chance_apart) + WRONG**2 * (float(was @ was) - left)

    def channels(self, after: Predicted) -> list[Channel]:
        """Errors of the model without effects and of another one: of tracks, forces and the balance."""
        found = []
        every = (self.before.recordings, self.before.coarse, after.recordings)
        rows = zip(self.measured, *every, strict=True)
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
            use = there(seen)
            u = [(r.p_WQ - seen.reference)[use] for r in (seen, before, coarse, other)]
            tracks = (f"tracks {n}", "m", tracking_noise(seen), u)
            found += [_channel(*one) for one in (tracks, *tools) if one[-1][0].size]
        if self.before.match is not None and after.match is not None:
            found.append(_balance(self.before.match, after.match))
        return found


Rolled = tuple[Recording, ...]


def _rolled(scenes: Scenes, fitted: Match) -> tuple[Rolled, Rolled]:
    """What a model gives on the fine and on the coarse grid."""
    fine, coarse = (tuple(s.rolled(fitted.told)) for s in (scenes, scenes.rough))
    return fine, coarse


def _read(
    problem: Problem, scenes: Scenes, fitted: Match, fine: Rolled, coarse: Rolled
) -> Predicted:
    match = Match.of(problem, scenes, fitted.told, coarse).anchored(fine)
    return Predicted(fine, coarse, match.doubted(fitted.root))


def _balance(before: Match, after: Match) -> Channel:
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


def there(recording: Recording) -> np.ndarray:
    """Which points are measured when, of those whose stress-free position is known, shape [frames, points]."""
    return np.asarray(valid_points(recording) & placed(recording))


def require_stated(recording: Recording, dx: float | None, *, held_back: bool) -> None:
    """Refuse a recording that could not be simulated, or compared with its simulation.

    Args:
        recording: with the forces of one source.
        dx: grid spacing [m]; None: chosen, see ``Scenes``.
        held_back: whether it is compared sample by sample, which takes the noise of its tracks; the
            others are read, and held against simulations that are never exact.

    Raises:
        ValueError: a face, poses, stress-free positions, a common clock or the noise are not stated, or
            points to be read lie on faces alone.
    """
    if not held_back:
        require_throughout(recording)
    scenes = Scenes.of((recording,), dx)
    _ = scenes.spacings  # refuses faces and poses that no stage can hold
    measured(recording, 0.0, float(np.ptp(recording.time)))
    lost = int(np.sum(~np.isfinite(recording.reference).all(axis=1)))
    if lost:
        raise ValueError(
            f"{lost} points have no stress-free position: state p_reference, or leave them out"
        )
    noise = tracking_noise(recording)
    if held_back and not np.isfinite(noise):
        raise ValueError("how noisy its tracks are cannot be told: state noise [m]")
    if not held_back and not recording.noise and noise < EXACT * scenes.dx[0]:
        raise ValueError(
            f"its tracks seem exact, to {noise:.1g} m, and no simulation is: state the noise that they stand"
            " for (noise [m])"
        )


def tracking_noise(recording: Recording) -> float:
    """Standard deviation of a measured coordinate [m], stated or from the jitter of the tracks."""
    if recording.noise is not None:
        return float(recording.noise)
    return jitter(recording.time, recording.p_WQ - recording.reference, there(recording))


def _channel(name: str, unit: str, noise: float, values: Sequence[np.ndarray]) -> Channel:
    """Of what was measured, predicted without effects, on the coarse grid and with them."""
    seen, before, coarse, other = (v.ravel() for v in values)
    grid = before - coarse
    along = grid / max(float(np.linalg.norm(grid)), 1e-300)

    def error(a: np.ndarray) -> float:
        return _beyond(np.sqrt(np.mean((a - along * (along @ a)) ** 2)), noise)

    size = float(np.sqrt(np.mean(grid**2)))
    errors = error(seen - before), error(seen - other)
    return Channel(name, unit, *errors, noise, len(seen), size)
