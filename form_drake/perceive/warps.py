"""Warps of a small part of a picture: where its pixels go, to second order.

A warp is 12 numbers, (u, u_x, u_y, u_xx, u_xy, u_yy) and the same of v: a pixel at d from the middle
goes to d + (u + u_x d_x + u_y d_y + u_xx d_x^2 / 2 + u_xy d_x d_y + u_yy d_y^2 / 2, ...) from it [px].
"""

import numpy as np

SIZE = 12
AFFINE = (0, 1, 2, 6, 7, 8)  # that a first-order warp has


def monomials(d: np.ndarray) -> np.ndarray:
    """What the numbers of a warp multiply, shape [..., 6].

    Args:
        d: places in the part [px], shape [..., 2].
    """
    x, y = d[..., 0], d[..., 1]
    return np.stack([np.ones_like(x), x, y, 0.5 * x * x, x * y, 0.5 * y * y], axis=-1)


def warped(warp: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Where places go [px].

    Args:
        warp: shape [..., 12].
        d: places from the middle, shape [..., 2].
    """
    terms = monomials(d)
    moved = [np.sum(terms * half, axis=-1) for half in (warp[..., :6], warp[..., 6:])]
    return d + np.stack(moved, axis=-1)


def affine(shift: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Warps of first order, shape [..., 12].

    Args:
        shift: of the middle [px], shape [..., 2].
        slope: of the shift, shape [..., 2, 2].
    """
    found = np.zeros((*shift.shape[:-1], SIZE))
    found[..., 0], found[..., 6] = shift[..., 0], shift[..., 1]
    found[..., 1:3], found[..., 7:9] = slope[..., 0, :], slope[..., 1, :]
    return found
