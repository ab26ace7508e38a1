"""Pictures as quintic splines: grey values and their slopes between pixels."""

from math import perm

import numpy as np
from scipy.ndimage import gaussian_filter, spline_filter

ORDER = 5
MARGIN = 3.0  # pixels from the rim of a picture, within which none is read
# pixels, by which pictures are smoothed: without, what is finer than pixels shifts points by hundredths
# of a pixel, neighbours alike; with more, noise does
SMOOTH = 0.75


def seen_in(picture: np.ndarray) -> np.ndarray:
    """Coefficients of a picture's spline, smoothed: in these parts are cut out and sought."""
    return coefficients(gaussian_filter(picture.astype(float), SMOOTH, mode="mirror"))


def coefficients(picture: np.ndarray) -> np.ndarray:
    """Of the spline through the grey values of a picture, shape [rows, columns]."""
    found: np.ndarray = spline_filter(picture.astype(float), ORDER, mode="mirror")
    return found


def read(c: np.ndarray, at: np.ndarray) -> dict[str, np.ndarray]:
    """Grey values and their derivatives [1/px, 1/px^2]: ``""``, x, y, xx, xy, yy, each of shape [...].

    Args:
        c: coefficients.
        at: places x, y [px], ``MARGIN`` pixels from the rim at least, shape [..., 2].
    """
    first = np.floor(at).astype(int) - 2
    across, down = (_weights((at - np.floor(at))[..., axis]) for axis in range(2))
    found = {name: np.zeros(at.shape[:-1]) for name in ("", "x", "y", "xx", "xy", "yy")}
    for j in range(6):
        for i in range(6):
            node = c[first[..., 1] + j, first[..., 0] + i]
            for name in found:
                found[name] += (
                    across[name.count("x")][..., i] * down[name.count("y")][..., j] * node
                )
    return found


def _weights(t: np.ndarray) -> list[np.ndarray]:
    """Of the six nodes about a place, t beyond the third, and two derivatives, shape [..., 6]."""
    found = []
    for n in range(3):
        power = [perm(k, n) * t ** max(k - n, 0) for k in range(ORDER + 1)]
        found.append(np.stack(power, axis=-1) @ _POWERS)
    return found


_POWERS = (  # of t, in the weights of the nodes -2 to 3 (Unser 1999)
    np.array(
        [
            [1, 26, 66, 26, 1, 0],
            [-5, -50, 0, 50, 5, 0],
            [10, 20, -60, 20, 10, 0],
            [-10, 20, 0, -20, 10, 0],
            [5, -20, 30, -20, 5, 0],
            [-1, 5, -10, 10, -5, 1],
        ]
    )
    / 120.0
)
