"""What an effect is worth: motions that were held back, predicted without it and with it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from form_drake.diagnose.channel import Channel, Kind, compared, of_balance
from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Scenes
from form_drake.diagnose.noise import most
from form_drake.diagnose.plates import Elsewhere, simulated
from form_drake.diagnose.prepare import problem_of
from form_drake.diagnose.verdict import LEAST, WRONG
from form_drake.identify.problem import Problem
from form_drake.motion.tracks import jitter, placed, valid_points
from form_drake.records import Recording
from form_drake.weak.force import measured

COARSER = 1.5  # times the spacing, of the grid that tells what one has wrong
SURE = 3.0  # standard deviations, by which a change is another than was predicted

Rolled = tuple[Recording, ...]


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
        elsewhere: predicted without the effects on the coarser grid, where plates are off.
    """

    scenes: Scenes
    problem: Problem | None
    before: Predicted
    unread: str = ""
    elsewhere: Sequence[Elsewhere] = ()

    @classmethod
    def of(cls, scenes: Scenes, fitted: Match, coarse: Rolled | None = None) -> "Check":
        """Simulate held-out scenes with a model without effects.

        Args:
            scenes: of the recordings that were held back.
            fitted: to the other recordings.
            coarse: what it gives on the coarser grid; None: that is simulated too.

        Raises:
            ValueError: a recording does not state its scene, or a simulation fails.
        """
        scenes = replace(scenes, coarser=COARSER)
        rolled, problem, whose = _rolled(scenes, fitted, coarse), None, "as measured"
        off = simulated(scenes, fitted.told)
        try:
            problem = problem_of(scenes, fitted.problem.unknowns)
            whose = "as predicted without the effects"
            before = _read(problem, scenes, fitted, *rolled, off)
            return cls(scenes, problem, before, "", off)
        except ValueError as error:
            return cls(scenes, problem, Predicted(*rolled, None), f"{whose}, {error}", off)

    @property
    def measured(self) -> tuple[Recording, ...]:
        """Recordings that were held back."""
        return self.scenes.recordings

    def predicted(self, fitted: Match, coarse: Rolled | None = None) -> Predicted:
        """What a model with effects predicts.

        Raises:
            ValueError: a simulation fails, or cannot be read.
        """
        rolled = _rolled(self.scenes, fitted, coarse)
        if self.problem is None:
            return Predicted(*rolled, None)
        try:
            return _read(self.problem, self.scenes, fitted, *rolled)
        except ValueError:
            if self.before.match is None:  # no more than without the effects
                return Predicted(*rolled, None)
            raise

    def finer(
        self, without: Match, fitted: Match | None, after: Predicted
    ) -> tuple["Check", Predicted]:
        """The same on a finer grid, of which this one is the coarser, if as much can be read there.

        Where bodies yield, say, what a grid has wrong goes down slowly.

        Args:
            without: that this was made with.
            fitted: with effects; None: there are none.
            after: predicted with it here.

        Returns:
            The check and what is predicted there; or this one with ``after``.
        """
        try:
            finer = Check.of(self.scenes.times(1.0 / COARSER), without, self.before.recordings)
            told = finer.before
            if fitted is not None:
                told = finer.predicted(fitted, after.recordings)
        except ValueError:
            return self, after
        pairs = ((self.before, finer.before), (after, told))
        less = any(here.match is not None and there.match is None for here, there in pairs)
        return (self, after) if less else (finer, told)

    def stands(self, after: Predicted) -> bool:
        """Whether rows bear out what effects predict, no channel is worse, and one is better if any counts."""
        if not self.bears_out(after):
            return False
        if after is self.before:
            return True
        channels = self.channels(after)
        counting = [c.closure for c in channels if c.counts]
        return not any(c.worse for c in channels) and (not counting or max(counting) > 0.0)

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
        was, change = self._change(after)
        square = float(change @ change)
        if square > LEAST:
            unsure = SURE * float(np.hypot(1.0 / np.sqrt(square), WRONG))
            if abs(float(was @ change) / square - 1.0) > min(unsure, 0.5):
                return False
        return left < most(after.match.chance_apart) + WRONG**2 * (float(was @ was) - left)

    def shows(self, after: Predicted) -> bool:
        """Whether effects change held-out motion by more than noise may: else it says nothing of them."""
        if any(c.counts for c in self.channels(after)):
            return True
        _, change = self._change(after)
        return float(change @ change) > LEAST

    def _change(self, after: Predicted) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the gap before, and what effects change of them, whitened by the weights after."""
        if self.before.match is None or after.match is None:
            return np.zeros(0), np.zeros(0)
        before = self.before.match
        both = np.stack([before.apart, before.explains(after.match)], axis=1)
        was, change = after.match.by.white(both).T
        return was, change

    def channels(self, after: Predicted, before: Predicted | None = None) -> list[Channel]:
        """Errors of tracks, forces and the balance, by one model and by another.

        Args:
            after: by the other.
            before: by the one; None: by that without effects.
        """
        before, found = before or self.before, []
        every = (before.recordings, before.coarse, after.recordings)
        rows = zip(self.measured, *every, strict=True)
        for n, (seen, *made) in enumerate(rows):
            still = self.before.coarse[n]
            off = [one.recording for one in self.elsewhere if one.of == n]
            kinds = []
            for name, unit, noise, part in _parts(seen):
                changes = [part(one) - part(still) for one in off]
                values = [part(one) for one in (seen, *made)]
                kinds.append(Kind(f"{name} {n + 1}", unit, noise, values, changes))
            found += compared([kind for kind in kinds if kind.values[0].size])
        if before.match is not None and after.match is not None:
            found.append(of_balance(before.match, after.match))
        return found


def _parts(seen: Recording) -> Iterator[tuple[str, str, float, Callable[[Recording], np.ndarray]]]:
    """Kinds of measurements in a recording: name, unit, noise and where a prediction has them."""
    use = there(seen)
    yield "tracks", "m", tracking_noise(seen), lambda one: one.p_WQ[use]
    for tool, felt in measured(seen, 0.0, float(np.ptp(seen.time))).items():
        yield f"force of {tool}", "N", felt.noise, partial(_force, tool)


def _force(tool: str, recording: Recording) -> np.ndarray:
    return recording.forces[tool].value


def _rolled(scenes: Scenes, fitted: Match, coarse: Rolled | None) -> tuple[Rolled, Rolled]:
    """What a model gives on the fine and on the coarse grid, unless that is known."""
    fine = tuple(scenes.rolled(fitted.told))
    return fine, tuple(scenes.rough.rolled(fitted.told)) if coarse is None else coarse


def _read(
    problem: Problem,
    scenes: Scenes,
    fitted: Match,
    fine: Rolled,
    coarse: Rolled,
    elsewhere: Sequence[Elsewhere] | None = None,
) -> Predicted:
    match = Match.of(problem, scenes, fitted.told, coarse, elsewhere).anchored(fine)
    return Predicted(fine, coarse, match.doubted(fitted.root))


def there(recording: Recording) -> np.ndarray:
    """Which points are measured when, of those whose stress-free position is known, shape [frames, points]."""
    return np.asarray(valid_points(recording) & placed(recording))


def tracking_noise(recording: Recording) -> float:
    """Standard deviation of a measured coordinate [m], stated or from the jitter of the tracks."""
    if recording.noise is not None:
        return float(recording.noise)
    return jitter(recording.time, recording.p_WQ - recording.reference, there(recording))
