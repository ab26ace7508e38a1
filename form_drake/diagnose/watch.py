"""Whether a motion still goes as predicted, asked while it goes."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import interp1d
from scipy.special import chdtri

from form_drake.diagnose.channel import GRID
from form_drake.diagnose.ledger import RARE
from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.verify import COARSER, there, tracking_noise
from form_drake.records import Recording, Stream
from form_drake.weak.force import FEW, jitter

WINDOW = 0.1  # [s]
AMISS = 0.02  # of what is predicted, which moduli may have wrong

Excess = dict[str, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Alarm:
    """What first went another way than predicted.

    Attributes:
        channel: ``tracks``, or ``force of`` a tool.
        time: from which on it does, on the recording's clock [s].
        excess: mean square deviation of the last window that was compared, over its limit.
        where: place of the point that is farthest off, of tracks, in the body at rest [m]; else empty.
    """

    channel: str
    time: float
    excess: float
    where: tuple[float, ...] = ()

    def __str__(self) -> str:
        near = ", ".join(f"{1e3 * x:.1f}" for x in self.where)
        place = f" near ({near}) mm" if near else ""
        return f"{self.channel}{place} not as predicted from {self.time:.2f} s on"


@dataclass(frozen=True)
class Watch:
    """A prediction, and what it may have wrong.

    Attributes:
        predicted: the whole motion.
        coarse: the same on a coarser grid.
    """

    predicted: Recording
    coarse: Recording

    @classmethod
    def of(cls, plan: Recording, model: Model, dx: float | None = None) -> "Watch":
        """Simulate what is planned.

        Args:
            plan: the scene, whose tools move as planned; its points are those that will be tracked.
            model: of the specimen.
            dx: grid spacing [m]; None: chosen, see ``Scenes``.

        Raises:
            ValueError: the scene cannot be simulated.
        """
        scenes = Scenes.of((plan,), dx)
        (predicted,), (coarse,) = (s.rolled(model) for s in (scenes, scenes.times(COARSER)))
        return cls(predicted, coarse)

    @property
    def channels(self) -> tuple[str, ...]:
        return ("tracks", *(f"force of {tool}" for tool in self.predicted.forces))

    def excess(self, measured: Recording) -> Excess:
        """By channel, ends of windows [s] and mean squares of deviations, as a share of their limits.

        Either of shape [windows]; NaN where nothing of a window can be compared.

        Args:
            measured: so far, on the clock of the plan; stress-free positions that it does not state are the
                plan's.

        Raises:
            ValueError: points or tools are others than the predicted ones, or the recording begins after
                the end of what is predicted.
        """
        return self.look(measured)[0]

    def alarm(self, measured: Recording) -> Alarm | None:
        """The first channel that exceeds its limit in two windows running; None: none does.

        Raises:
            ValueError: see ``excess``.
        """
        return self.look(measured)[1]

    def look(self, measured: Recording) -> tuple[Excess, Alarm | None]:
        """``excess`` and ``alarm``.

        Raises:
            ValueError: see ``excess``.
        """
        every, found = Excess(), list[Alarm]()
        for name, time, square in self._squares(measured):
            ends, excess = every[name] = _windows(time, square)
            pairs = pairwise(zip(ends, excess, strict=True))
            start = next((a[0] for a, b in pairs if a[1] > 1.0 and b[1] > 1.0), None)
            if start is not None:
                where = self._farthest(square) if name == "tracks" else ()
                last = float(excess[np.isfinite(excess)][-1])
                found.append(Alarm(name, float(start - WINDOW), last, where))
        return every, min(found, key=lambda alarm: alarm.time, default=None)

    def _farthest(self, square: np.ndarray) -> tuple[float, ...]:
        each = np.nanmean(square, axis=(0, 2))
        return tuple(self.predicted.reference[int(np.nanargmax(each))].tolist())

    def _squares(self, measured: Recording) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Channel, stamps, and squares of deviations over what is to be expected of them."""
        if measured.p_WQ.shape[1:] != self.predicted.p_WQ.shape[1:]:
            raise ValueError(
                f"{measured.points} points are tracked, {self.predicted.points} are predicted"
            )
        begin, end = measured.time[0], self.predicted.time[-1]
        if begin > end:
            raise ValueError(
                f"the recording begins at {begin:g} s, the prediction ends at {end:g} s: stamps are wanted on"
                " the clock of the plan"
            )
        if measured.p_reference is None:  # the first frame is none: the body rests under its weight
            measured = replace(measured, p_reference=self.predicted.reference)
        u, *both = (r.p_WQ - r.reference for r in (measured, self.predicted, self.coarse))
        u = np.where(there(measured)[..., None], u, np.nan)
        yield (
            "tracks",
            measured.time,
            _square(measured.time, u, tracking_noise(measured), self.predicted.time, *both),
        )
        for tool, stream in self.predicted.forces.items():
            if tool not in measured.forces:
                raise ValueError(f"no force of {tool} is measured, it is predicted")
            seen: Stream = measured.forces[tool]
            size = seen.noise
            if size is None:
                size = jitter(seen) if len(seen.time) >= FEW else np.nan  # nothing is off as yet
            both = [np.asarray(s.value) for s in (stream, self.coarse.forces[tool])]
            time = np.asarray(seen.time)
            yield (
                f"force of {tool}",
                time,
                _square(time, np.asarray(seen.value), size, np.asarray(stream.time), *both),
            )


def _square(
    time: np.ndarray,
    seen: np.ndarray,
    noise: float,
    stamps: np.ndarray,
    fine: np.ndarray,
    coarse: np.ndarray,
) -> np.ndarray:
    """Squares of deviations over the variance of noise and of what a prediction may have wrong."""
    if not np.isfinite(noise):  # too few frames as yet to tell it
        noise = np.nan
    fine, coarse = (
        interp1d(stamps, a, axis=0, bounds_error=False, fill_value=np.nan)(time)
        for a in (fine, coarse)
    )
    wrong = (GRID * (fine - coarse)) ** 2 + (AMISS * fine) ** 2
    axes = tuple(range(1, seen.ndim))
    wrong = np.mean(wrong, axis=axes, keepdims=True)
    return np.asarray((seen - fine) ** 2 / np.maximum(noise**2 + wrong, 1e-300))


def _windows(time: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of whole windows [s], and their mean squares over what noise reaches in one of a thousand.

    NaN where there is none.
    """
    count = int((time[-1] - time[0]) / WINDOW + 1e-9)
    ends = time[0] + WINDOW * np.arange(1, count + 1)
    excess = np.full(count, np.nan)
    which = np.ceil((time - time[0]) / WINDOW - 1e-9).astype(int)  # a sample on an end is of one
    for n in range(count):
        own = square[np.maximum(which, 1) == n + 1]
        own = own[np.isfinite(own)]
        if len(own):
            excess[n] = np.sum(own) / chdtri(len(own), RARE)
    return ends, excess
