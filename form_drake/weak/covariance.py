"""Covariance of the rows from the noise of the tracks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from form_drake.weak.history import Lasting
from form_drake.weak.noise import Bases, Moments, Slopes, by_functions
from form_drake.weak.windows import Windows
from form_drake.workers import parted

SMALL = 1e-5  # correlation below which windows are taken to share no noise
TOGETHER = 2**22  # numbers in what is multiplied at once
PARTS = (
    4  # of a sum, on so many cores at most: the same on every machine, so that its last digits are
)


def track_noise(
    bases: Bases,
    families: list[Slopes],
    every: int,
    span: Windows,
    history: Sequence["Past"] = (),
) -> np.ndarray:
    """Covariance of all rows [(N m s)^2], windows outermost.

    Args:
        bases: of the fit, at the times of the windows.
        families: slopes at every ``every``-th time, for each family of fields.
        every: see there.
        span: the windows.
        history: how every window remembers the motion before its end; empty: not at all.
    """
    parts = [np.concatenate(p, axis=2) for p in zip(*(f.parts for f in families), strict=True)]
    looks, _, m = parts[0].shape
    groups = np.minimum(np.rint(np.arange(len(span.time)) / every).astype(int), looks - 1)
    total = np.zeros((m * len(span),) * 2)
    for one in bases.moments:
        if one.series.any():  # else no noise
            own = parts if one.mix is None else [one.mix.T @ p for p in parts]
            windows = [
                _window(own, groups, chi, rate, one)
                for chi, rate in zip(span.chi, span.rate, strict=True)
            ]
            if history:
                windows = [
                    past.joined(window, one) for window, past in zip(windows, history, strict=True)
                ]
            total += _covariance(windows, one, m)
    return total


Window = tuple[np.ndarray, np.ndarray]  # pull of the moments [looks, moments], slopes at the looks


@dataclass(frozen=True)
class Past:
    """Slopes of the rows of a window by what lasts of the motion.

    Attributes:
        shares: of the times in every look, shape [looks, times].
        slopes: shape [looks, functions, fields].
    """

    shares: np.ndarray
    slopes: np.ndarray

    @classmethod
    def of(cls, own: Lasting, bases: Bases) -> "Past":
        """From the derivatives by F."""
        some = len(own.rows) > 0
        slopes = by_functions(own.rows, bases).swapaxes(1, 2) if some else np.zeros((0, 0, 0))
        return cls(own.shares, slopes)

    def joined(self, window: Window, moments: Moments) -> Window:
        """A window together with its past."""
        if not len(self.slopes):
            return window
        pull, now = window
        own = self.slopes if moments.mix is None else moments.mix.T @ self.slopes
        return np.concatenate([pull, self.shares @ moments.series]), np.concatenate([now, own])


def _covariance(windows: list[Window], moments: Moments, m: int) -> np.ndarray:
    """Products of the rows of all windows, as of ``_window``: by pairs of them where that is less."""
    looks, many = max(len(pull) for pull, _ in windows), moments.series.shape[1]
    common = looks**2 * (m + (many if len(moments.scale) > 1 else 0))
    if common + looks * m**2 < many * m**2:
        return _by_pair(windows, moments.scale, m)
    return _by_moment(windows, moments.scale, m)


def _by_pair(windows: list[Window], scale: np.ndarray, m: int) -> np.ndarray:
    """Looks are summed first, for two windows at a time that share noise."""
    scale = scale**2
    slopes = [np.ascontiguousarray(own.swapaxes(0, 1)) for _, own in windows]
    sizes = [_common(pull, scale, pull).max(axis=(1, 2), initial=0.0) for pull, _ in windows]
    total = np.zeros((len(windows), m, len(windows), m))
    for w, (pull, _) in enumerate(windows):
        for v, (other, _) in enumerate(windows[: w + 1]):
            common = _common(pull, scale, other)
            share = np.abs(common).max(axis=(1, 2), initial=0.0)
            if np.all(share <= SMALL * np.sqrt(sizes[w] * sizes[v])):
                continue
            theirs = (common @ slopes[v]).reshape(-1, m)
            block = slopes[w].reshape(-1, m).T @ theirs
            total[w, :, v] = block
            total[v, :, w] = block.T
    return total.reshape(m * len(windows), -1)


def _common(pull: np.ndarray, scale: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Covariance of two pulls in every function, shape [functions, looks, looks]."""
    if len(scale) == 1:
        return scale[0, :, None, None] * (pull @ other.T)
    pairs = (pull[:, None] * other).reshape(-1, len(scale))
    return (scale.T @ pairs.T).reshape(-1, len(pull), len(other))


def _by_moment(windows: list[Window], scale: np.ndarray, m: int) -> np.ndarray:
    """The same, a few moments at a time."""
    moments, functions, rows = windows[0][0].shape[1], scale.shape[1], m * len(windows)
    scale = np.broadcast_to(scale, (moments, functions))
    slopes = [np.ascontiguousarray(own.T) for _, own in windows]
    count = max(1, TOGETHER // (rows * functions))
    sums = np.zeros((PARTS, rows, rows))

    def summed(some: slice) -> None:
        for n in range(some.start, some.stop):
            for first in range(n * count, moments, PARTS * count):
                own = slice(first, first + count)
                ways = zip(slopes, windows, strict=True)
                pulled = np.stack([part @ pull[:, own] for part, (pull, _) in ways])
                pulled *= scale[own].T
                flat = pulled.reshape(rows, -1)
                sums[n] += flat @ flat.T

    parted(summed, PARTS, 1)
    return np.asarray(sums.sum(axis=0))


def _window(
    parts: list[np.ndarray],
    groups: np.ndarray,
    chi: np.ndarray,
    chi_rate: np.ndarray,
    moments: Moments,
) -> Window:
    """How the moments pull at the looks of a window, and the slopes, [looks, functions, fields].

    ``parts`` are those of ``Slopes``; looks of one follow those of the other.
    """
    inside = np.flatnonzero(chi > 0)
    first, last = groups[inside[0]], groups[inside[-1]] + 1
    looks = (groups[inside] == np.arange(first, last)[:, None]).astype(float)
    pulls = [
        looks @ (weight[inside, None] * series[inside])
        for weight, series in (
            (chi, moments.series),
            (chi_rate, moments.rate),
            (chi, moments.rate),
        )
    ][: len(parts)]
    return np.concatenate(pulls), np.concatenate([part[first:last] for part in parts])
