"""What noise leaves in the plastic strain, and how that reaches later rows.

With U = F^-1 F_e, a step is F_e = R(F U') from the U' before, R the return to the yield surface. An
error of F moves U by

    dU = F^-1 (D[dF U' + F dU'] - dF U),    D = dR / d(F U'),

which vanishes where nothing flows (D = 1), and fades where the body flows on. Rows are followed
back through these steps (the adjoint of the recursion), all rows of a window at once.

A step is taken for one return. Histories themselves go in strides of ``laws.memory.LARGEST``: where
frames are further apart, the derivatives are right to some tenths.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from form_drake.motion.motion import inverse
from form_drake.weak.tangent import Tangent

FORGOTTEN = 0.01  # share of the most that a window has held of U, below which nothing is left
FLOWS = 1e-3  # |D - 1|, below which nothing does

# trial elastic deformation gradients at times from the first on, [times, points, 3, 3] -> the return
# to the yield surface, of Kirchhoff stresses, with derivatives of the elastic part
Return = Callable[[np.ndarray, int], Tangent]


@dataclass(frozen=True)
class Lasting:
    """Derivatives of the rows of one window by F through U alone, where something flows.

    Attributes:
        shares: of the times in every look, shape [looks, times].
        rows: the mean of a look's times, shape [looks, fields, points, 3, 3].
    """

    shares: np.ndarray
    rows: np.ndarray


def lasting(
    F: np.ndarray,
    elastic: np.ndarray,
    pairing: Callable[[int], np.ndarray],
    chi: np.ndarray,
    back: Return,
    most: int,
    every: int = 1,
) -> list[Lasting]:
    """Those of every window.

    Args:
        F: deformation gradients, shape [times, points, 3, 3].
        elastic: their elastic parts, of the same shape.
        pairing: what the stress is multiplied by in a row at a time, shape [fields, points, 3, 3].
        chi: the windows [s], shape [windows, times].
        back: the return to the yield surface.
        most: matrices that are returned at once.
        every: neighbouring times that make one look.
    """
    own = inverse(F)
    U = own @ elastic
    points, windows, fields = F.shape[1], len(chi), len(pairing(0))
    held = np.zeros((points, windows, fields, 3, 3))  # derivatives by U
    largest = np.zeros(windows)
    looks: list[dict[int, np.ndarray]] = [{} for _ in chi]
    flowing = np.zeros(chi.shape)
    count = max(1, most // points)
    for end in range(len(F), 1, -count):
        first = max(1, end - count)
        met = back(F[first:end] @ U[first - 1 : end - 1], first)
        assert met.elastic_by_F is not None
        D, C = (a.reshape(*a.shape[:3], 9) for a in (met.elastic_by_F, met.by_F))
        for n in range(end - 1, first - 1, -1):
            alive = np.flatnonzero(largest)
            turned, before = (_each(a.swapaxes(1, 2)) for a in (F[n], U[n - 1]))
            mu = _each(own[n].swapaxes(1, 2)) @ held[:, alive]
            through = _pulled(mu, D[n - first])
            if np.abs(D[n - first] - np.eye(9)).max() > FLOWS:
                change = through @ before - mu @ _each(U[n].swapaxes(1, 2))
                for w, rows in zip(alive, change.transpose(1, 2, 0, 3, 4), strict=True):
                    looks[w][n // every] = looks[w].get(n // every, 0.0) + rows
                flowing[alive, n] = 1.0
            held[:, alive] = turned @ through
            inside = np.flatnonzero(chi[:, n])
            if len(inside):
                pull = turned @ _pulled(pairing(n).swapaxes(0, 1)[:, None], C[n - first])
                held[:, inside] += chi[inside, n][:, None, None, None] * pull
            size = np.abs(held).max(axis=(0, 2, 3, 4))
            largest = np.maximum(largest, size)
            gone = size <= FORGOTTEN * largest
            held[:, gone], largest[gone] = 0.0, 0.0
    place = np.arange(len(F)) // every
    return [_mean(found, row, place) for found, row in zip(looks, flowing, strict=True)]


def _mean(found: dict[int, np.ndarray], flowing: np.ndarray, place: np.ndarray) -> Lasting:
    """The looks of a window from their sums.

    Args:
        found: sums by look.
        flowing: whether a time is in one, shape [times].
        place: which look it would be in, shape [times].
    """
    shares = flowing * (place == np.array(list(found), dtype=int)[:, None])
    parts = [rows / share.sum() for rows, share in zip(found.values(), shares, strict=True)]
    return Lasting(shares, np.array(parts))


def _each(a: np.ndarray) -> np.ndarray:
    """A matrix of every point, for all windows and fields."""
    return a[:, None, None]


def _pulled(a: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Derivatives by a matrix from those by its image, shape of a.

    Args:
        a: by the image, shape [points, windows, fields, 3, 3].
        slope: of the image, shape [points, 9, 9], the matrix last.
    """
    flat = a.reshape(len(a), -1, 9) @ slope
    return flat.reshape(a.shape)
