"""Splines in time, as dense as the motion asks for and the frames allow, and their frequencies."""

from itertools import pairwise

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, eigvals_banded

from form_drake.motion.modes import modes
from form_drake.motion.splines import Splines

TIME_DEGREE = 4
WORST = 100.0  # condition of a basis in time
LOUD = 4.0  # times the noise of a frame, that a fit may hold half-way between two
SLOWEST = 2.0  # half waves in the recording, below which moments belong to the slowest octave


def chosen_time(time: np.ndarray, y: np.ndarray, noise: float) -> Splines:
    """Halves spans where the residual of the modes stands out of the noise.

    Args:
        time: stamps [s].
        y: series of whitened coefficients [m], shape [frames, series].
        noise: standard deviation that each series holds [m].
    """
    left, size, _ = modes(y, noise)
    y = left * size
    breaks = np.linspace(time[0], time[-1], 5)
    while True:
        splines = Splines(breaks, TIME_DEGREE)
        Q = np.linalg.qr(splines.matrix(time))[0]
        leverage = np.sum(Q**2, axis=1)
        energy = np.sum((y - Q @ (Q.T @ y)) ** 2, axis=1)
        excess: dict[float, float] = {}
        for a, b in pairwise(breaks):
            inside = (time >= a) & (time <= b)
            count = max(np.sum(1.0 - leverage[inside]), 0.0) * y.shape[1]
            expected, spread = noise**2 * count, noise**2 * np.sqrt(2.0 * count)
            middle = 0.5 * (a + b)
            halves = np.sum(inside & (time < middle)), np.sum(inside & (time > middle))
            over = float(np.sum(energy[inside])) - expected
            if min(halves) >= 1 and over > 3.0 * spread:
                excess[middle] = over
        last, finer = breaks, np.sort(np.append(breaks, list(excess)))
        if _told(finer, time):
            breaks = finer
        else:  # samples are too few for all: the worst first
            for middle in sorted(excess, key=excess.__getitem__, reverse=True):
                more = np.sort(np.append(breaks, middle))
                breaks = more if _told(more, time) else breaks
        if len(breaks) == len(last):
            return splines


def _told(breaks: np.ndarray, time: np.ndarray) -> bool:
    """Whether samples at ``time`` [s] tell all splines well apart, and tell what is between samples."""
    if len(breaks) + TIME_DEGREE > len(time):
        return False
    splines = Splines(breaks, TIME_DEGREE)
    values, between = (splines.matrix(t) for t in (time, 0.5 * (time[1:] + time[:-1])))
    gram = values.T @ values
    band = np.array([np.pad(np.diagonal(gram, n), (n, 0)) for n in range(TIME_DEGREE, -1, -1)])
    least, *_, most = eigvals_banded(band)
    if not most < WORST**2 * least:
        return False
    back = cho_solve_banded((cholesky_banded(band), False), between.T)
    return bool(np.sum(between.T * back, axis=0).max() <= LOUD**2)


def moments(splines: Splines, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Series of a basis, orthonormal in the samples, whose rates are orthogonal; the slowest first.

    Args:
        splines: the basis.
        time: stamps of the samples [s].

    Returns:
        The series, shape [frames, moments]; their coefficients in the basis, shape [size, moments];
        the octave of their frequency, counted from one wave in the recording, shape [moments].
    """
    Q, R = np.linalg.qr(splines.matrix(time))
    back = np.linalg.inv(R)
    square, turn = np.linalg.eigh(back.T @ splines.grams[1] @ back)
    waves = np.sqrt(np.maximum(len(time) * square, 0.0)) / np.pi
    return Q @ turn, back @ turn, np.floor(np.log2(np.maximum(waves / SLOWEST, 1.0)))
