"""What stands out of white noise in a matrix of tracks, and how much noise there is."""

import numpy as np


def modes(y: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Singular triplets U, S, V^T of what stands out of white noise; the first in any case.

    White noise of n x m entries has singular values up to noise (sqrt n + sqrt m) (Marchenko, Pastur).

    Args:
        y: shape [frames, series].
        noise: standard deviation of an entry.
    """
    U, S, Vt = np.linalg.svd(y, full_matrices=False)
    count = max(1, int(np.sum(S > noise * edge(*y.shape))))
    return U[:, :count], S[:count], Vt[:count]


def edge(rows: float, columns: float) -> float:
    """The largest singular value of a matrix of unit white noise (Marchenko, Pastur)."""
    return float(np.sqrt(rows) + np.sqrt(columns))


def white_noise(u: np.ndarray) -> float:
    """White noise of one coordinate [m]: the middle singular value of the tracks beside the modes.

    Motion fills a few singular values, noise all of them, and its middle one is known (Gavish and
    Donoho, "The optimal hard threshold for singular values is 4/sqrt(3)", 2014).

    Args:
        u: displacements [m], shape [frames, points, 3].
    """
    rows, columns = u.reshape(len(u), -1).shape
    S = np.linalg.svd(u.reshape(rows, columns), compute_uv=False)
    found = float(np.median(S)) / _middle(rows, columns)
    rest = S[S <= found * edge(rows, columns)]
    filled = len(S) - len(rest)
    return float(np.median(rest)) / _middle(rows - filled, columns - filled)


def _middle(rows: int, columns: int) -> float:
    """Median singular value of a matrix of unit white noise (Marchenko, Pastur)."""
    share = min(rows, columns) / max(rows, columns)
    x = np.linspace((1.0 - np.sqrt(share)) ** 2, (1.0 + np.sqrt(share)) ** 2, 2001)
    x = 0.5 * (x[1:] + x[:-1])
    below = np.cumsum(np.sqrt((x[-1] - x) * (x - x[0])) / x)
    return float(np.sqrt(np.interp(0.5 * below[-1], below, x) * max(rows, columns)))
