"""Measured tool forces as right-hand sides c_j, with their noise (eq. 9 of the paper)."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.special import chdtri

from form_drake.motion.body import Body
from form_drake.motion.splines import Splines
from form_drake.motion.tracks import NEAR, neighbours
from form_drake.records import Recording, Stream
from form_drake.weak.windows import bump, trapezoid

SHORTEST = 64  # samples of a force of which swings are told
SAMPLED = 0.5  # of the time between frames, longest between samples of it
# a tool presses with more than so many times the noise, at least this share of the largest force, and with
# the larger share in any case
HEARD, PRESSED, SURELY = 4.0, 0.01, 0.05
FEW = 12  # samples from which their jitter tells their noise
# of half a window: between samples that are too few to sample it, the same where they are uneven, and
# between those that are put in
FAR, FAR_UNEVEN, FINE = 0.8, 0.25, 0.1
EVEN = 0.5  # of the usual time between samples, by which the times between them differ at most
CLOCKS = 0.05  # [s] by which a force may be stamped late or early


@dataclass(frozen=True)
class Force:
    """Force of the material on a tool.

    Attributes:
        time: stamps from the first frame on [s], shape [samples].
        value: f_T_W [N], shape [samples, 3].
        noise: standard deviation of one component [N], stated or estimated.
        fast: share of its rms that swings faster than half the frame rate; None: not known.
        missed: what a motion fitted to the frames does not follow of it [N], shape of value.
    """

    time: np.ndarray
    value: np.ndarray
    noise: float
    fast: float | None = None
    missed: np.ndarray | None = None

    def impulses(self, ends: np.ndarray) -> np.ndarray:
        """Weights w with int chi f dt = w f, shape [windows, samples].

        Before the first stamp and after the last one, the force is what it was there, and goes straight from
        one to the next that is far from it.
        """
        middle, half = ends.mean(axis=1)[:, None], 0.5 * np.diff(ends, axis=1)
        before, after = (_beyond(self.time, float(t)) for t in (ends.min(), ends.max()))
        time = np.concatenate([before, self.time, after])
        fine = _filled(time, float(half.min()))
        found: np.ndarray = bump((fine - middle) / half)[0] * trapezoid(fine)
        if len(fine) > len(time):
            found = (_straight(time, fine).T @ found.T).T
        held = found[:, len(before) : len(before) + len(self.time)]
        held[:, 0] += found[:, : len(before)].sum(axis=1)
        held[:, -1] += found[:, len(time) - len(after) :].sum(axis=1)
        return held


def _filled(time: np.ndarray, half: float) -> np.ndarray:
    """Stamps, and others between those that are too far apart to sample a bump of this half-width [s]."""
    if len(time) < 2:
        return time
    step = np.diff(time)
    even = np.ptp(step) < EVEN * np.median(step)  # such serve a bump also where they are few
    far = step > (FAR if even else FAR_UNEVEN) * half
    if not far.any():
        return time
    count = np.where(far, np.ceil(step / (FINE * half)), 1.0).astype(int)
    parts = [
        np.linspace(a, z, n, endpoint=False)
        for (a, z), n in zip(pairwise(time), count, strict=True)
    ]
    return np.append(np.concatenate([np.zeros(0), *parts]), time[-1:])


def _straight(time: np.ndarray, fine: np.ndarray) -> csr_array:
    """Weights of samples in what lies straight between them, shape [fine, samples]."""
    n = np.clip(np.searchsorted(time, fine, "right") - 1, 0, len(time) - 2)
    share = (fine - time[n]) / (time[n + 1] - time[n])
    rows = np.tile(np.arange(len(fine)), 2)
    weights = np.concatenate([1.0 - share, share])
    return csr_array((weights, (rows, np.concatenate([n, n + 1]))), shape=(len(fine), len(time)))


def followed(force: Force, frames: np.ndarray, splines: Splines) -> Force:
    """The same, with what is ``missed`` of it.

    A motion knows frames, and between them is what its splines in time make of these. Made of a force that
    jolts between two frames, they err by as much as they do of the motion, as far as that goes with the force:
    under a tool that holds a whole face. A strip that is touched somewhere swings in its own time.

    Args:
        force: sampled oftener than the frames; of others nothing is told.
        frames: stamps of those [s].
        splines: of the motion in time.
    """
    step = float(np.median(np.diff(force.time))) if len(force.time) > 1 else np.inf
    if step > SAMPLED * float(np.median(np.diff(frames))):
        return force
    seen = np.stack([np.interp(frames, force.time, v) for v in force.value.T], axis=1)
    c = np.linalg.lstsq(splines.matrix(frames), seen, rcond=None)[0]
    within = np.clip(force.time, frames[0], frames[-1])
    return replace(force, missed=force.value - splines.matrix(within) @ c)


def _beyond(time: np.ndarray, end: float) -> np.ndarray:
    """Stamps from those of a force to a time that they do not cover, in order, no further apart."""
    if time[0] <= end <= time[-1]:
        return np.zeros(0)
    near = time[0] if end < time[0] else time[-1]
    step = float(np.median(np.diff(time))) if len(time) > 1 else abs(end - near)
    count = int(np.ceil(abs(end - near) / step - 1e-9))
    return np.sort(np.linspace(near, end, count + 1)[1:])


def jitter(stream: Stream) -> float:
    """Noise of one component from the deviation of every sample from the cubic through its neighbours.

    The median, so that jolts do not count. Stamps need not be even.
    """
    time = np.asarray(stream.time, dtype=float)
    if len(time) < FEW:
        return 0.0
    weights, middle = neighbours(time)
    value = np.asarray(stream.value, dtype=float)
    error = value[middle] - np.einsum("sk,skd->sd", weights, value[middle[:, None] + NEAR])
    square = np.mean(error**2, axis=1) / (1.0 + np.sum(weights**2, axis=1))
    # the median of a mean over three components lies below it
    return float(np.sqrt(np.median(square) * 3.0 / chdtri(3, 0.5)))


def fast(time: np.ndarray, value: np.ndarray, noise: float, rate: float) -> float | None:
    """Share of a force's rms that swings faster than frames can follow, its noise taken off.

    Frames take motion of that kind for slow motion.

    Args:
        time: stamps [s], shape [samples].
        value: [N], shape [samples, 3].
        noise: of one component [N].
        rate: of the frames [Hz].

    Returns:
        None where the force is sampled too coarsely to tell.
    """
    from scipy.signal import butter, sosfiltfilt  # slow to import, and few forces need it

    step = float(np.median(np.diff(time))) if len(time) > SHORTEST else np.inf
    if step * rate > SAMPLED:
        return None
    even = np.arange(time[0], time[-1], step)
    force = np.stack([np.interp(even, time, v) for v in np.transpose(value)])
    swing = sosfiltfilt(butter(4, 0.5 * rate, "high", fs=1.0 / step, output="sos"), force)
    heard = 3.0 * noise**2 * (1.0 - rate * step)
    whole = np.sum(np.mean(force**2, axis=1)) - 3.0 * noise**2
    if whole <= 0.0:
        return None
    return float(np.sqrt(max(np.sum(np.mean(swing**2, axis=1)) - heard, 0.0) / whole))


def measured(recording: Recording, first: float, last: float) -> dict[str, Force]:
    """Forces of a recording on the clock of its frames; a clock that differs is for others to find.

    Raises:
        ValueError: the stamps of a force do not cover the frames, but for ``CLOCKS``.
    """
    found = {}
    for name, stream in recording.forces.items():
        time = np.asarray(stream.time, dtype=float) - recording.time[0]
        step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        apart = max(CLOCKS, 1.5 * step)
        if time[0] > first + apart or time[-1] < last - apart:
            start = recording.time[0]
            raise ValueError(
                f"force of {name} is stamped {time[0] + start:.4g} to {time[-1] + start:.4g} s, the"
                f" frames {first + start:.4g} to {last + start:.4g} s: the clocks must overlap"
            )
        spread = jitter(stream) if stream.noise is None else stream.noise
        value = np.asarray(stream.value, dtype=float)
        share = fast(time, value, spread, 1.0 / float(np.median(np.diff(recording.time))))
        found[name] = Force(time, value, spread, share)
    return found


def holding(shape: Body) -> set[str]:
    """Tools that hold a whole face: quasi-static motion goes with their force."""
    return {face.tool for face in shape.faces if face.condition in ("bonded", "frictionless")}


def pressed(recording: Recording, tool: str) -> np.ndarray:
    """Whether a tool is pushed back, in every frame."""
    last = float(recording.time[-1] - recording.time[0])
    force = measured(recording, 0.0, last)[tool]
    size = np.linalg.norm(force.value, axis=1)
    now = np.interp(recording.time - recording.time[0], force.time, size)
    least, most = PRESSED * size.max(), SURELY * size.max()
    return np.asarray(now > np.clip(HEARD * force.noise, least, most))
