"""Quadratic B-splines on a uniform grid: the one spatial basis of solver and identification.

A particle at x [m] on a grid of spacing dx [m] (node i at i dx) touches the 27 nodes
``base + (a, b, c)``, a, b, c in {0, 1, 2}. ``weights`` and ``gradients`` return a 3x3 matrix whose
row k holds, for the k-th of the three nodes along each axis, the value [-] or derivative [1/m] of
the one-dimensional spline. All functions are generic in the precision of their arguments.
"""

from typing import Any

import numpy as np
import warp as wp


@wp.func
def base_node(s: Any):
    """First node of the stencil; ``s`` = x / dx per axis [-]."""
    half = s.dtype(0.5)
    return wp.vec3i(
        int(wp.floor(s[0] - half)), int(wp.floor(s[1] - half)), int(wp.floor(s[2] - half))
    )


@wp.func
def weights(f: Any):
    """Spline values at ``f`` = x / dx - base in [0.5, 1.5); row = node, column = axis."""
    half = f.dtype(0.5)
    one = f.dtype(1.0)
    three_halves = f.dtype(1.5)
    three_quarters = f.dtype(0.75)
    w = wp.identity(n=3, dtype=f.dtype)
    for axis in range(3):
        w[0, axis] = half * (three_halves - f[axis]) * (three_halves - f[axis])
        w[1, axis] = three_quarters - (f[axis] - one) * (f[axis] - one)
        w[2, axis] = half * (f[axis] - half) * (f[axis] - half)
    return w


@wp.func
def gradients(f: Any, inverse_dx: Any):
    """Spline derivatives [1/m] at ``f``; row = node, column = axis."""
    half = f.dtype(0.5)
    one = f.dtype(1.0)
    three_halves = f.dtype(1.5)
    g = wp.identity(n=3, dtype=f.dtype)
    for axis in range(3):
        g[0, axis] = (f[axis] - three_halves) * inverse_dx
        g[1, axis] = f.dtype(-2.0) * (f[axis] - one) * inverse_dx
        g[2, axis] = (f[axis] - half) * inverse_dx
    return g


def splines(f: np.ndarray) -> np.ndarray:
    """Values of the three splines on the host, as a last axis, at ``f`` as of ``weights``."""
    return np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], axis=-1)
