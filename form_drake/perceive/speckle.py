"""Speckle, as it is sprayed on a specimen: a bitmap of soft discs."""

import numpy as np

LOW, HIGH = 40.0, 215.0  # grey values of ground and discs


def speckle(
    shape: tuple[int, int],
    radius: float,
    rng: np.random.Generator,
    *,
    cover: float = 0.5,
    edge: float = 0.25,
) -> np.ndarray:
    """Grey values of a bitmap, float32, shape [rows, columns].

    Args:
        shape: rows and columns of texels.
        radius: of the discs, the mean of those that are drawn within a tenth of it [texels].
        rng: draws places and radii.
        cover: share of the ground that the discs would cover if none overlapped.
        edge: half the width of their rims, as a share of the radius.

    Raises:
        ValueError: discs smaller than a texel.
    """
    if not radius >= 1.0:
        raise ValueError(f"speckle of {radius:g} texels: one is wanted at least")
    rows, columns = shape
    count = int(cover * rows * columns / (np.pi * radius**2))
    middle = rng.uniform(0.0, [columns, rows], (count, 2))
    found = np.zeros(shape, np.float32)
    for (x, y), r in zip(middle, radius * rng.uniform(0.9, 1.1, count), strict=True):
        reach = int(r * (1.0 + edge)) + 2
        left, top = max(int(x) - reach, 0), max(int(y) - reach, 0)
        part = found[top : int(y) + reach + 1, left : int(x) + reach + 1]
        j, i = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
        rim = (r - np.hypot(i - x, j - y)) / (edge * r)
        np.maximum(part, np.clip(0.5 + 0.5 * rim, 0.0, 1.0), out=part)
    return LOW + (HIGH - LOW) * found
