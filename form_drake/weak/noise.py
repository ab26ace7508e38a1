"""Covariance of the rows from the noise of the tracks and of the measured forces."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from form_drake.motion import Fit, Motion, Sampling
from form_drake.motion.motion import inverse
from form_drake.weak.balance import forces
from form_drake.weak.fields import Fields
from form_drake.weak.windows import Windows

STEP = 1e-6  # of strain, in the differences below
TOGETHER = 64  # points whose slopes stay in the cache
SMALL = 1e-5  # share of the largest entry below which noise of far moments is left out

# (F, L, indices of times) -> Kirchhoff stress [Pa] and the F it belongs to, [times, points, 3, 3]
Stress = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Moments:
    """One part of the error of a fit along time, see ``form_drake.motion.fit.Spread``.

    Attributes:
        scale: shape [functions].
        series: [m], shape [times, moments].
        rate: [m/s], shape [times, moments].
    """

    scale: np.ndarray
    series: np.ndarray
    rate: np.ndarray


@dataclass(frozen=True)
class Bases:
    """Functions of a fit whose coefficients have unit covariance, in the blocks of its space.

    Attributes:
        axes: components of each block.
        value: shape [points, axes, functions], for each block.
        gradient: [1/m], shape [points, axes, 3, functions], for each block.
        moments: parts of the error along time.
    """

    axes: tuple[tuple[int, ...], ...]
    value: tuple[np.ndarray, ...]
    gradient: tuple[np.ndarray, ...]
    moments: tuple[Moments, ...]

    @classmethod
    def of(cls, fit: Fit, sampling: Sampling) -> "Bases":
        """Those of a fit at the points and times of a sampling."""
        value, gradient = [], []
        for block, root in zip(fit.space.blocks, fit.roots, strict=True):
            value.append(block.matrix(sampling.value) @ root)
            along = [block.matrix(sampling.gradient[:, :, d]) @ root for d in range(3)]
            gradient.append(np.stack(along, axis=2))
        moments = [
            Moments(part.scale, sampling.series @ part.time_root, sampling.rate @ part.time_root)
            for part in fit.spread
        ]
        axes = tuple(block.axes for block in fit.space.blocks)
        return cls(axes, tuple(value), tuple(gradient), tuple(moments))


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the integrands of A theta - b at some time, for one family of fields.

    They are by the whitened coefficients of the fit, shape [fields, functions].

    Attributes:
        now: by those of the motion.
        momentum: of the momentum, times chi', by those of its rate.
        rate: by those of its rate; None: the stress reads no rate.
    """

    now: np.ndarray
    momentum: np.ndarray
    rate: np.ndarray | None

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """Those that there are."""
        both = (self.now, self.momentum)
        return both if self.rate is None else (*both, self.rate)


def slopes(
    fields: Fields,
    motion: Motion,
    at: np.ndarray,
    stress: Stress,
    gravity: np.ndarray,
    rates: bool,
    bases: Bases,
) -> list[Slopes]:
    """Derivatives at each of the times ``at`` (indices)."""
    F, L = motion.F[at], motion.L[at]

    def pushed(dF: np.ndarray, dL: np.ndarray) -> np.ndarray:
        tau, paired = stress(F + dF, L + dL, at)
        if fields.material:
            tau = tau @ inverse(paired).swapaxes(-1, -2)
        return motion.volume[:, None, None] * tau

    none = np.zeros((3, 3))
    still = pushed(none, none)
    by_F = _differences(lambda E: pushed(E, none), still, STEP)
    by_rate = None
    if rates:
        speed = STEP * max(float(np.abs(L).max()), 1e-3)
        # L = dF/dt F^-1
        by_L = _differences(lambda E: pushed(none, E), still, speed)
        by_rate = by_L @ inverse(F).swapaxes(-1, -2)[:, :, None]
        by_F = by_F - L.swapaxes(-1, -2)[:, :, None] @ by_rate
    weight, momentum = forces(motion, gravity), None
    found = []
    for n, i in enumerate(at):
        sampled = fields.at(motion.frame(int(i)))
        gradient = sampled.gradient.reshape(len(sampled.gradient), -1, 9).swapaxes(0, 1)
        now = _by_gradient(gradient, by_F[n], bases)
        rate = None if by_rate is None else _by_gradient(gradient, by_rate[n], bases)
        if not fields.material:
            now += _by_value(_along_x(fields, motion, int(i), still[n], weight[i]), bases)
        if momentum is None or not fields.fixed:
            momentum = _by_value(-motion.mass[:, None] * sampled.value, bases)
        found.append(Slopes(now, momentum, rate))
    return found


def _differences(
    pushed: Callable[[np.ndarray], np.ndarray], still: np.ndarray, step: float
) -> np.ndarray:
    """Derivatives of 3 x 3 matrices by the entries of another, shape [times, points, 9, 3, 3]."""
    units = np.eye(9).reshape(9, 3, 3)
    found = np.stack([(pushed(step * E) - still) / step for E in units], axis=-1)
    return found.reshape(*found.shape[:2], 9, 3, 3)


def _by_gradient(gradient: np.ndarray, slope: np.ndarray, bases: Bases) -> np.ndarray:
    """Chain rule through F.

    Args:
        gradient: of the fields, shape [points, fields, 9].
        slope: of the stress by F, shape [points, 9, 3, 3].
    """
    points, count = gradient.shape[:2]
    found = [np.zeros((count, own.shape[-1])) for own in bases.gradient]
    for first in range(0, points, TOGETHER):
        own = slice(first, first + TOGETHER)
        by = gradient[own] @ slope[own].reshape(-1, 9, 9)
        rows = by.reshape(-1, count, 3, 3).swapaxes(0, 1)
        for n, (axes, along) in enumerate(zip(bases.axes, bases.gradient, strict=True)):
            flat = along[own].reshape(-1, along.shape[-1])
            found[n] += rows[:, :, axes].reshape(count, -1) @ flat
    return np.concatenate(found, axis=1)


def _by_value(slope: np.ndarray, bases: Bases) -> np.ndarray:
    """Chain rule through x or v; slope of shape [fields, points, 3]."""
    found = [
        slope[:, :, axes].reshape(len(slope), -1) @ value.reshape(-1, value.shape[-1])
        for axes, value in zip(bases.axes, bases.value, strict=True)
    ]
    return np.concatenate(found, axis=1)


def _along_x(
    fields: Fields, motion: Motion, i: int, tau: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """d (V tau : grad psi - m g . psi) / d x, shape [fields, points, 3]."""
    frame = motion.frame(i)
    h = 1e-6 * float(np.ptp(motion.X, axis=0).max())
    slope = []
    for a in range(3):
        step = np.zeros(3)
        step[a] = h
        up, down = (fields.at(replace(frame, x=frame.x + s * step)) for s in (1.0, -1.0))
        work = np.einsum("fqij,qij->fq", up.gradient - down.gradient, tau)
        work -= np.einsum("fqi,qi->fq", up.value - down.value, weight)
        slope.append(work / (2.0 * h))
    return np.stack(slope, axis=-1)


def track_noise(
    bases: Bases, families: list[list[Slopes]], every: int, span: Windows
) -> np.ndarray:
    """Covariance of all rows [(N m s)^2], windows outermost.

    Args:
        bases: of the fit, at the times of the windows.
        families: slopes at every ``every``-th time, for each family of fields.
        every: see there.
        span: the windows.
    """
    looks = len(families[0])
    groups = np.minimum(np.rint(np.arange(len(span.time)) / every).astype(int), looks - 1)
    parts = [
        [np.concatenate(p) for p in zip(*(s[c].parts for s in families), strict=True)]
        for c in range(looks)
    ]
    m = len(parts[0][0])
    total = np.zeros((m * len(span),) * 2)
    for one in bases.moments:
        if not one.series.any():  # no noise
            continue
        total += _covariance(
            [_window(parts, groups, span.chi[w], span.rate[w], one) for w in range(len(span))]
        )
    return total


def _covariance(blocks: list[tuple[np.ndarray, int]]) -> np.ndarray:
    """Products of the rows of all windows, as of ``_window``."""
    m = len(blocks[0][0])
    total = np.zeros((m * len(blocks),) * 2)
    for w, (K, first) in enumerate(blocks):
        for u in range(w, len(blocks)):
            M, start = blocks[u]
            lo, hi = max(first, start), min(first + K.shape[1], start + M.shape[1])
            if lo >= hi:
                continue
            block = K[:, lo - first : hi - first].reshape(m, -1) @ (
                M[:, lo - start : hi - start].reshape(m, -1).T
            )
            total[w * m : (w + 1) * m, u * m : (u + 1) * m] = block
            total[u * m : (u + 1) * m, w * m : (w + 1) * m] = block.T
    return total


def _window(
    parts: list[list[np.ndarray]],
    groups: np.ndarray,
    chi: np.ndarray,
    chi_rate: np.ndarray,
    moments: Moments,
) -> tuple[np.ndarray, int]:
    """Rows of a window by whitened noise, shape [fields, moments, functions], and the first moment.

    ``parts`` are those of ``Slopes`` at every look, the last of which may be missing.
    """
    inside = np.flatnonzero(chi > 0)
    pulls = []
    for c in np.unique(groups[inside]):
        own = inside[groups[inside] == c]
        by_rate = chi[own] @ moments.rate[own]
        pulls.append(
            (c, chi[own] @ moments.series[own], chi_rate[own] @ moments.rate[own], by_rate)
        )
    size = sum(np.abs(a) + np.abs(b) + np.abs(d) for _, a, b, d in pulls)
    seen = np.flatnonzero(size > SMALL * size.max())
    first, last = int(seen[0]), int(seen[-1]) + 1
    K = np.zeros((len(parts[0][0]), last - first, parts[0][0].shape[1]))
    for c, *weights in pulls:
        for part, pull in zip(parts[c], weights, strict=False):
            K += part[:, None, :] * pull[None, first:last, None]
    return K * moments.scale, first
