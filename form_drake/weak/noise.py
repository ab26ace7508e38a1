"""How the noise of tracks moves the integrands of the rows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from form_drake.motion import Fit, Motion, Sampling
from form_drake.motion.smoothing import Spread
from form_drake.weak.contact import STIFFNESS, HeldFields
from form_drake.weak.fields import Fields, Sampled
from form_drake.weak.integrals import forces, runs
from form_drake.weak.tangent import Tangent

# indices of times -> the stress there, first Piola's where fields are material, else Kirchhoff's
Tangents = Callable[[np.ndarray, bool], Tangent]


@dataclass(frozen=True)
class Moments:
    """One part of the error of a fit along time, see ``form_drake.motion.fit.Spread``.

    Attributes:
        scale: shape [moments or 1, parts].
        series: [m], shape [times, moments].
        rate: [m/s], shape [times, moments].
        mix: shape [functions, parts]; None: every function is a part.
    """

    scale: np.ndarray
    series: np.ndarray
    rate: np.ndarray
    mix: np.ndarray | None


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
    def of(cls, fit: Fit, sampling: Sampling, parts: Sequence[Spread]) -> "Bases":
        """Those of a fit at the points and times of a sampling, with some parts of its error."""
        value, gradient = [], []
        for block, root in zip(fit.space.blocks, fit.roots, strict=True):
            value.append(block.matrix(sampling.value) @ root)
            along = [block.matrix(sampling.gradient[:, :, d]) @ root for d in range(3)]
            gradient.append(np.stack(along, axis=2))
        moments = []
        for part in parts:
            series, rate = (basis @ part.time_root for basis in (sampling.series, sampling.rate))
            moments.append(Moments(part.scale.T, series, rate, part.mix))
        axes = tuple(block.axes for block in fit.space.blocks)
        return cls(axes, tuple(value), tuple(gradient), tuple(moments))


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the integrands of A theta - b, for one family of fields.

    They are by the whitened coefficients of the fit, shape [times, functions, fields].

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

    @classmethod
    def joined(cls, parts: Sequence["Slopes"]) -> "Slopes":
        """Those at successive times as one."""
        now, momentum, *rate = (
            np.concatenate(p) for p in zip(*(part.parts for part in parts), strict=True)
        )
        return cls(now, momentum, rate[0] if rate else None)


def slopes(
    fields: Fields,
    motion: Motion,
    at: np.ndarray,
    tangents: Tangents,
    gravity: np.ndarray,
    rates: bool,
    bases: Bases,
) -> Slopes:
    """Derivatives at the times ``at`` (indices)."""
    looks = motion.at(at)
    if isinstance(fields, HeldFields):
        now = _by_value(-STIFFNESS * fields.at(looks).value, bases).swapaxes(1, 2).copy()
        return Slopes(now, np.zeros_like(now), np.zeros_like(now) if rates else None)
    met, volume = tangents(at, fields.material), motion.volume[:, None, None]
    still, by_F, by_rate = volume * met.stress, volume[..., None] * met.by_F, None
    if met.by_L is not None:
        # L = dF/dt F^-1
        by_rate = volume[..., None] * met.by_L @ looks.inverse.swapaxes(-1, -2)[:, :, None]
        by_F = by_F - looks.L.swapaxes(-1, -2)[:, :, None] @ by_rate
    weight, found, momentum = forces(looks, gravity), [], None
    for own in runs(looks, fields):
        run = looks.at(own)
        sampled = fields.at(run)
        now = _by_gradient(sampled.gradient, by_F[own], bases)
        if not fields.material:
            now += _by_value(_along_x(fields, run, sampled, still[own], weight[own]), bases)
        if momentum is None or not fields.fixed:
            momentum = _by_value(-motion.mass[:, None] * sampled.value, bases)
        momentum = momentum[: len(now)]
        rate = now[:0] if by_rate is None else _by_gradient(sampled.gradient, by_rate[own], bases)
        found.append((now, momentum, rate))
    now, momentum, rate = (
        np.concatenate(p).swapaxes(1, 2).copy() for p in zip(*found, strict=True)
    )
    return Slopes(now, momentum, rate if rates else None)


def _by_gradient(gradient: np.ndarray, slope: np.ndarray, bases: Bases) -> np.ndarray:
    """Chain rule through F, shape [times, fields, functions].

    Args:
        gradient: of the fields, shape [times, fields, points, 3, 3].
        slope: of the stress by F, shape [times, points, 9, 3, 3].
    """
    times, count, points = gradient.shape[:3]
    flat = gradient.reshape(times, count, points, 9).swapaxes(1, 2)
    by = flat @ slope.reshape(times, points, 9, 9)
    return by_functions(by.reshape(times, points, count, 3, 3).swapaxes(1, 2), bases)


def by_functions(rows: np.ndarray, bases: Bases) -> np.ndarray:
    """Slopes by the coefficients of a fit from those by F, shape [times, fields, functions].

    ``rows`` has the shape [times, fields, points, 3, 3].
    """
    times, count = rows.shape[:2]
    found = []
    for axes, along in zip(bases.axes, bases.gradient, strict=True):
        flat = along.reshape(-1, along.shape[-1])
        found.append(rows[:, :, :, axes].reshape(times * count, len(flat)) @ flat)
    joined = np.concatenate(found, axis=1)
    return joined.reshape(times, count, joined.shape[1])


def _by_value(slope: np.ndarray, bases: Bases) -> np.ndarray:
    """Chain rule through x or v, shape [times, fields, functions].

    ``slope`` has the shape [times, fields, points, 3].
    """
    times, count = slope.shape[:2]
    found = [
        slope[..., axes].reshape(times * count, -1) @ value.reshape(-1, value.shape[-1])
        for axes, value in zip(bases.axes, bases.value, strict=True)
    ]
    return np.concatenate(found, axis=1).reshape(times, count, -1)


def _along_x(
    fields: Fields, motion: Motion, here: Sampled, tau: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """d (V tau : grad psi - m g . psi) / d x, shape [times, fields, points, 3]."""
    h = 1e-7 * float(np.ptp(motion.X, axis=0).max())
    slope = []
    for step in h * np.eye(3):
        there = fields.at(replace(motion, x=motion.x + step))
        work = np.einsum("tfqij,tqij->tfq", there.gradient - here.gradient, tau, optimize=True)
        work -= np.einsum("tfqi,tqi->tfq", there.value - here.value, weight, optimize=True)
        slope.append(work / h)
    return np.stack(slope, axis=-1)
