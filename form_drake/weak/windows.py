"""Windows in time: bumps that vanish at both ends, so that no acceleration is needed (eq. 9)."""

from dataclasses import dataclass

import numpy as np

POWER = 4


@dataclass(frozen=True)
class Windows:
    """Bumps chi_w sampled on one time grid.

    The derivative is corrected so that, with the grid's own quadrature, a constant momentum
    contributes nothing and a steadily growing one exactly its rate: absolute position and speed
    cannot leak in.

    Attributes:
        time: the grid [s], shape [times].
        ends: first and last moment of each window [s], shape [windows, 2].
        chi: bumps times quadrature weights [s], shape [windows, times].
        rate: their derivatives times quadrature weights, shape [windows, times].
    """

    time: np.ndarray
    ends: np.ndarray
    chi: np.ndarray
    rate: np.ndarray

    def __len__(self) -> int:
        return len(self.ends)


def bump(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(1 - s^2)^4 inside (-1, 1) and its derivative."""
    inside = np.maximum(1.0 - s**2, 0.0)
    return inside**POWER, -2.0 * POWER * s * inside ** (POWER - 1)


def trapezoid(time: np.ndarray) -> np.ndarray:
    """Weights of the trapezoidal rule [s]."""
    step = np.diff(time)
    return 0.5 * (np.append(step, 0.0) + np.append(0.0, step))


def windows(time: np.ndarray, ends: np.ndarray) -> Windows:
    """Windows with the given ends on a time grid.

    Raises:
        ValueError: a window reaches beyond the grid or holds too few of its times.
    """
    middle, half = ends.mean(axis=1), 0.5 * np.diff(ends, axis=1)[:, 0]
    s = (time - middle[:, None]) / half[:, None]
    slack = 1e-9 * (time[-1] - time[0])
    if ends.min() < time[0] - slack or ends.max() > time[-1] + slack:
        raise ValueError(
            f"windows from {ends.min():.4g} to {ends.max():.4g} s reach beyond the recorded"
            f" {time[0]:.4g} to {time[-1]:.4g} s"
        )
    if np.sum(np.abs(s) < 1.0, axis=1).min() < 6:
        raise ValueError("a window holds fewer than 6 times: make it wider")
    weights = trapezoid(time)
    chi, slope = bump(s)
    return Windows(time, ends, chi * weights, _corrected(s, chi, slope, weights, half))


def _corrected(
    s: np.ndarray, chi: np.ndarray, slope: np.ndarray, weights: np.ndarray, half: np.ndarray
) -> np.ndarray:
    """slope / half times weights with sum = 0 and first moment = -sum of chi."""
    rate = slope / half[:, None] * weights
    inside = np.maximum(1.0 - s**2, 0.0) ** (POWER - 1)
    shapes = np.stack([inside * weights, inside * s * weights], axis=1)
    moments = np.stack([np.ones_like(s), s * half[:, None]], axis=1)
    wanted = np.stack([np.zeros(len(s)), -np.sum(chi * weights, axis=1)], axis=1)
    gap = wanted - np.einsum("wmt,wt->wm", moments, rate)
    share = np.linalg.solve(np.einsum("wmt,wnt->wmn", moments, shapes), gap[:, :, None])[:, :, 0]
    found: np.ndarray = rate + np.einsum("wn,wnt->wt", share, shapes)
    return found


def even(first: float, last: float, width: float, stride: float) -> np.ndarray:
    """Ends of windows of one width spread over [first, last], shape [windows, 2].

    Raises:
        ValueError: the window is longer than the recording.
    """
    if width > (last - first) * (1.0 + 1e-9):
        raise ValueError(
            f"a window of {width:.4g} s is longer than the recording's {last - first:.4g} s"
        )
    count = 1 + int((last - first - width) / stride + 1e-9)
    starts = first + np.linspace(0.0, last - first - width, max(count, 1))
    return np.stack([starts, starts + width], axis=1)
