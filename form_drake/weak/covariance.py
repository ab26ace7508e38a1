"""Covariance of the rows from the noise of the tracks."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from form_drake.weak.history import Lasting
from form_drake.weak.noise import Bases, Moments, Slopes, by_functions
from form_drake.weak.windows import Windows
from form_drake.workers import parted

SMALL = 1e-5  # correlation below which windows are taken to share no noise
TOGETHER = 2**22  # numbers in what is multiplied at once
# of a sum, on so many cores at most: the same on every machine, so that its last digits are
PARTS = 4


def track_noise(parts: Iterable["Part"]) -> np.ndarray:
    """Covariance of all rows [(N m s)^2], windows outermost."""
    return np.asarray(sum(_covariance(part) for part in parts))


@dataclass(frozen=True)
class Part:
    """Independent moments of the error of a motion, and how rows follow them.

    Attributes:
        windows: of the rows.
        scale: standard deviations, shape [moments or 1, functions].
    """

    windows: tuple["Window", ...]
    scale: np.ndarray

    @property
    def fields(self) -> int:
        """Rows of each window."""
        return int(self.windows[0].slopes.shape[2])

    def combined(self, gain: np.ndarray) -> np.ndarray:
        """Covariance of few combinations of the rows [(N m s)^2], shape [combinations, combinations].

        Products of all rows, of which there are many, are not needed for it. ``gain`` has the shape
        [combinations, rows].
        """
        total, windows = np.zeros((len(gain),) * 2), range(len(self.windows))
        own = gain.reshape(len(gain), len(windows), -1)
        for some in self.together(len(gain)):
            flat = self.pulled(windows, own, some).reshape(len(gain), -1)
            total += flat @ flat.T
        return total

    def variances(self) -> np.ndarray:
        """Of all rows [(N m s)^2]: the diagonal of their covariance."""
        alone, found = np.eye(self.fields)[:, None], np.zeros((len(self.windows), self.fields))

        def summed(own: slice) -> None:
            for some in self.together(self.fields):
                for n in range(own.start, own.stop):
                    flat = self.pulled([n], alone, some).reshape(self.fields, -1)
                    found[n] += np.einsum("rk,rk->r", flat, flat)

        parted(summed, len(self.windows), 1)
        return found.ravel()

    def together(self, rows: int) -> list[slice]:
        """Moments that are looked at together, for so many rows."""
        moments, functions = self.windows[0].pull.shape[1], self.scale.shape[1]
        count = max(1, TOGETHER // (rows * functions))
        return [slice(n, n + count) for n in range(0, moments, count)]

    def pulled(self, some: Sequence[int], gain: np.ndarray, moments: slice) -> np.ndarray:
        """Combinations of the rows of some windows by moments, shape [combinations, functions, moments].

        ``gain`` has the shape [combinations, windows, fields].
        """
        own = [self.windows[n].slopes @ gain[:, w].T for w, n in enumerate(some)]
        pull = np.concatenate([self.windows[n].pull[:, moments] for n in some])
        slopes = np.concatenate(own).transpose(2, 1, 0)
        scale = self.scale if len(self.scale) == 1 else self.scale[moments]
        return np.asarray((slopes @ pull) * scale.T)


def parts_of(
    bases: Bases,
    families: list[Slopes],
    every: int,
    span: Windows,
    history: Sequence["Past"] = (),
) -> Iterator[Part]:
    """Parts of the error of a motion.

    Args:
        bases: of the fit, at the times of the windows.
        families: slopes at every ``every``-th time, for each family of fields.
        every: see there.
        span: the windows.
        history: how every window remembers the motion before its end; empty: not at all.
    """
    parts = [np.concatenate(p, axis=2) for p in zip(*(f.parts for f in families), strict=True)]
    looks = len(parts[0])
    groups = np.minimum(np.rint(np.arange(len(span.time)) / every).astype(int), looks - 1)
    for one in bases.moments:
        if not one.series.any():  # no noise
            continue
        own = parts if one.mix is None else [one.mix.T @ p for p in parts]
        windows = [
            _window(own, groups, chi, rate, one)
            for chi, rate in zip(span.chi, span.rate, strict=True)
        ]
        if history:
            pairs = zip(windows, history, strict=True)
            windows = [past.joined(window, one) for window, past in pairs]
        yield Part(tuple(windows), one.scale)


class Window(NamedTuple):
    """How moments move the rows of a window.

    Attributes:
        pull: of the moments, shape [looks, moments].
        slopes: of the rows at the looks, shape [looks, functions, fields].
    """

    pull: np.ndarray
    slopes: np.ndarray


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
        own = self.slopes if moments.mix is None else moments.mix.T @ self.slopes
        pull = np.concatenate([window.pull, self.shares @ moments.series])
        return Window(pull, np.concatenate([window.slopes, own]))


def _covariance(part: Part) -> np.ndarray:
    """Products of the rows of all windows: by pairs of them where that is less."""
    m, many = part.fields, part.windows[0].pull.shape[1]
    looks = max(len(window.pull) for window in part.windows)
    common = looks**2 * (m + (many if len(part.scale) > 1 else 0))
    if common + looks * m**2 < many * m**2:
        return _by_pair(part)
    return _by_moment(part)


def _by_pair(part: Part) -> np.ndarray:
    """Looks are summed first, for two windows at a time that share noise."""
    windows, scale, m = part.windows, part.scale**2, part.fields
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


def _by_moment(part: Part) -> np.ndarray:
    """The same, a few moments at a time."""
    windows = part.windows
    moments, functions = windows[0].pull.shape[1], part.scale.shape[1]
    rows = part.fields * len(windows)
    scale = np.broadcast_to(part.scale, (moments, functions))
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
    return Window(np.concatenate(pulls), np.concatenate([part[first:last] for part in parts]))
