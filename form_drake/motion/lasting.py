"""Tracking error that lasts from frame to frame, as a period of rest shows it."""

import numpy as np

from form_drake.motion.smoothing import Spread

LEAST = 8  # frames of an interval of rest that tell
SURE = 4.0  # standard deviations of white noise, by which an error is one that lasts
LONGEST = 0.98  # of an error that is left after a frame: a rest shows no longer ones
FAINT = 1e-6  # share that counts as nothing
ROUNDS = 8  # of estimates


def lasting(white: np.ndarray, time: np.ndarray, rest: np.ndarray | None) -> Spread | None:
    """The part of a tracking error that is alike in neighbouring frames; None: none stands out.

    Nothing moves at rest: what the fitted functions follow then is error. White noise is without
    covariance from one frame to the next; what has some fades by the same share with every frame
    (Ornstein, Uhlenbeck), each function by itself. Its variance is taken a standard deviation larger than it
    is seen, since a rest is short.

    Args:
        white: coefficients in which white noise is white, shape [frames, functions].
        time: of the frames, evenly spaced [s], shape [frames].
        rest: intervals in which nothing moves [s], shape [intervals, 2]; None: there are none.

    Returns:
        With a time root for the frames, shape [frames, moments].
    """
    still = [white[own] for own in intervals(time, rest)]
    still = [y - y.mean(axis=0) for y in still]
    if not still:
        return None
    frames = sum(map(len, still)) / len(still)  # of an interval
    square = sum(np.sum(y**2, axis=0) for y in still) / (len(still) * (frames - 1.0))
    count = frames * len(still)
    chance = float(np.median(square)) / np.sqrt(count)  # of a covariance of white noise
    seen = [_covariance(still, lag) for lag in (1, 2)]
    if (seen[0] + square / frames).sum() <= SURE * chance * np.sqrt(len(square)):
        return None
    kept, variance = 0.0, np.zeros(len(square))
    for _ in range(ROUNDS):  # the mean of an interval, which is taken off, has errors too
        mean = (np.maximum(square - variance, 0.0) + variance * _summed(kept, frames)) / frames
        one, two = (own + mean for own in seen)
        kept = min(max(two.sum() / one.sum(), one.sum() / (square + mean).sum()), LONGEST)
        variance = np.minimum(_shared(one, chance) / kept, square + mean)  # no more than there is
    told = count / _summed(kept, frames) * variance.sum() ** 2 / np.sum(variance**2)
    variance *= 1.0 + np.sqrt(2.0 / told)
    apart = np.abs(time[:, None] - time) / np.median(np.diff(time))
    size, axes = np.linalg.eigh(kept**apart)
    large = size > FAINT * size[-1]
    return Spread(np.sqrt(variance)[:, None], axes[:, large] * np.sqrt(size[large]))


def intervals(time: np.ndarray, rest: np.ndarray | None) -> list[np.ndarray]:
    """Which frames lie in every interval of rest that is long enough to tell, shape [frames] each."""
    own = [(time >= a) & (time <= b) for a, b in (rest if rest is not None else ())]
    return [frames for frames in own if frames.sum() >= LEAST]


def _shared(one: np.ndarray, chance: float) -> np.ndarray:
    """Covariances of functions, drawn to their mean as far as chance has them apart; their sum is kept."""
    apart = max(float(np.var(one)) - chance**2, 0.0)
    found = one.mean() + apart / (apart + chance**2) * (one - one.mean())
    found = np.maximum(found, 0.0)
    return np.asarray(found * (one.sum() / found.sum()))


def _summed(kept: float, frames: float) -> float:
    """Variance of the sum of so many frames by frames, of an error of unit variance."""
    lags = np.arange(1.0, frames)
    return float(1.0 + 2.0 * np.sum((1.0 - lags / frames) * kept**lags))


def _covariance(still: list[np.ndarray], lag: int) -> np.ndarray:
    """Of every function with itself some frames later, shape [functions]."""
    pairs = sum(len(y) - lag for y in still)
    return np.asarray(sum(np.sum(y[lag:] * y[:-lag], axis=0) for y in still) / pairs)
