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
SMALL = 1e-5  # share of the largest entry below which noise of far moments is left out

# (F, L, indices of times) -> Kirchhoff stress [Pa] and the F it belongs to, [times, points, 3, 3]
Stress = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the integrands of A theta - b at some times, for one family of fields.

    Attributes:
        F: with respect to F, shape [times, fields, points, 3, 3].
        rate: with respect to dF/dt, same shape; None: the stress reads no rate.
        x: with respect to x, shape [times, fields, points, 3]; None: material fields.
        v: of the momentum, times chi', with respect to v, shape [times, fields, points, 3].
    """

    F: np.ndarray
    rate: np.ndarray | None
    x: np.ndarray | None
    v: np.ndarray


def slopes(
    fields: Fields, motion: Motion, at: np.ndarray, stress: Stress, gravity: np.ndarray, rates: bool
) -> list[Slopes]:
    """Derivatives at each of the times ``at`` (indices)."""
    F, L = motion.F[at], motion.L[at]
    transposed = inverse(F).swapaxes(-1, -2)

    def pushed(dF: np.ndarray, dL: np.ndarray) -> np.ndarray:
        tau, paired = stress(F + dF, L + dL, at)
        if fields.material:
            tau = tau @ inverse(paired).swapaxes(-1, -2)
        return motion.volume[:, None, None] * tau

    none = np.zeros((3, 3))
    still = pushed(none, none)
    units = np.eye(9).reshape(9, 3, 3)
    by_F = np.stack([(pushed(STEP * E, none) - still) / STEP for E in units], axis=-1)
    speed = STEP * max(float(np.abs(L).max()), 1e-3)
    by_L = [(pushed(none, speed * E) - still) / speed for E in units] if rates else None
    weight = forces(motion, gravity)
    found = []
    for n, i in enumerate(at):
        sampled = fields.at(motion.frame(int(i)))
        gradient = sampled.gradient.reshape(len(sampled.gradient), -1, 9)
        shape = sampled.gradient.shape
        slope = np.einsum("fqs,qsu->fqu", gradient, by_F[n].reshape(-1, 9, 9), optimize=True)
        slope = slope.reshape(shape)
        rate = None
        if by_L is not None:
            units_L = np.stack([u[n] for u in by_L], axis=-1).reshape(-1, 9, 9)
            by = np.einsum("fqs,qsu->fqu", gradient, units_L, optimize=True).reshape(shape)
            rate = by @ transposed[n]
            slope = slope - L[n].swapaxes(-1, -2) @ rate
        x = None if fields.material else _along_x(fields, motion, int(i), still[n], weight[i])
        v = -motion.mass[:, None] * sampled.value
        found.append(Slopes(slope, rate, x, v))
    return found


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
    fit: Fit,
    sampling: Sampling,
    families: list[list[Slopes]],
    every: int,
    span: Windows,
) -> np.ndarray:
    """Covariance of all rows, windows outermost, from the noise of the tracks [(N m s)^2].

    Args:
        fit: of the tracks.
        sampling: its bases on the grid of the windows.
        families: slopes at every ``every``-th time, for each family of fields.
        every: see there.
        span: the windows.
    """
    value = sampling.value @ fit.space_root
    gradient = np.einsum("qae,ab->qbe", sampling.gradient, fit.space_root)
    series, rate = sampling.series @ fit.time_root, sampling.rate @ fit.time_root
    groups = np.minimum(
        np.rint(np.arange(len(sampling.time)) / every).astype(int), len(families[0]) - 1
    )
    parts = [
        [
            np.concatenate(p)
            for p in zip(*(_spatial(s[c], value, gradient) for s in families), strict=True)
        ]
        for c in range(len(families[0]))
    ]
    blocks = [
        _window(parts, groups, span.chi[w], span.rate[w], series, rate) for w in range(len(span))
    ]
    m = blocks[0][0].shape[0]
    total = np.zeros((m * len(span),) * 2)
    for w, (K, first) in enumerate(blocks):
        for u in range(w, len(span)):
            M, start = blocks[u]
            lo, hi = max(first, start), min(first + K.shape[1], start + M.shape[1])
            if lo >= hi:
                continue
            block = K[:, lo - first : hi - first].reshape(m, -1) @ (
                M[:, lo - start : hi - start].reshape(m, -1).T
            )
            total[w * m : (w + 1) * m, u * m : (u + 1) * m] = block
            total[u * m : (u + 1) * m, w * m : (w + 1) * m] = block.T
    return fit.noise**2 * total


def _spatial(s: Slopes, value: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, ...]:
    """Slopes by whitened coefficients of c, of dc/dt, and of dc/dt under chi', [fields, 3 space]."""

    def chain(by: np.ndarray | None, basis: np.ndarray) -> np.ndarray:
        if by is None:
            return np.zeros((len(s.F), 3, basis.shape[1]))
        if by.ndim == 4:
            rows = by.transpose(0, 2, 1, 3).reshape(len(by) * 3, -1)
            return (rows @ basis.transpose(0, 2, 1).reshape(-1, basis.shape[1])).reshape(
                len(by), 3, -1
            )
        found: np.ndarray = by.transpose(0, 2, 1) @ basis
        return found

    now = chain(s.F, gradient) + chain(s.x, value)
    return tuple(p.reshape(len(p), -1) for p in (now, chain(s.rate, gradient), chain(s.v, value)))


def _window(
    parts: list[list[np.ndarray]],
    groups: np.ndarray,
    chi: np.ndarray,
    chi_rate: np.ndarray,
    series: np.ndarray,
    rate: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Rows of a window by whitened noise, shape [fields, moments, 3 space], and the first moment."""
    inside = np.flatnonzero(chi > 0)
    pulls = []
    for c in np.unique(groups[inside]):
        own = inside[groups[inside] == c]
        pulls.append((c, chi[own] @ series[own], chi[own] @ rate[own], chi_rate[own] @ rate[own]))
    size = sum(np.abs(a) + np.abs(b) + np.abs(d) for _, a, b, d in pulls)
    seen = np.flatnonzero(size > SMALL * size.max())
    first, last = int(seen[0]), int(seen[-1]) + 1
    K = np.zeros((len(parts[0][0]), last - first, parts[0][0].shape[1]))
    for c, by_c, by_rate, by_momentum in pulls:
        for part, pull in zip(parts[c], (by_c, by_rate, by_momentum), strict=True):
            K += part[:, None, :] * pull[None, first:last, None]
    return K, first
