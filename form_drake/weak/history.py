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
    pairing: Callable[[slice], np.ndarray],
    chi: np.ndarray,
    back: Return,
    most: int,
    every: int = 1,
) -> list[Lasting]:
    """Those of every window.

    Args:
        F: deformation gradients, shape [times, points, 3, 3].
        elastic: their elastic parts, of the same shape.
        pairing: what the stress is multiplied by in the rows at some times, shape
            [times, fields, points, 3, 3].
        chi: the windows [s], shape [windows, times].
        back: the return to the yield surface.
        most: matrices that are returned at once.
        every: neighbouring times that make one look.
    """
    U = inverse(F) @ elastic
    points, windows, fields = F.shape[1], len(chi), pairing(slice(0, 1)).shape[1]
    held = np.zeros((points, windows, fields, 9))  # derivatives by U
    largest = np.zeros(windows)
    looks: list[dict[int, np.ndarray]] = [{} for _ in chi]
    flowing = np.zeros(chi.shape)
    count = max(1, most // points // max(1, fields // 9))
    for end in range(len(F), 1, -count):
        first = max(1, end - count)
        met = back(F[first:end] @ U[first - 1 : end - 1], first)
        flows, maps = _maps(F[first:end], U[first - 1 : end], met)
        pulls = _pulls(F[first:end], pairing(slice(first, end)), met)
        for n in range(end - 1, first - 1, -1):
            alive = np.flatnonzero(largest)
            both = held[:, alive].reshape(points, -1, 9) @ maps[n - first]
            onward, change = np.split(both.reshape(points, len(alive), fields, 18), 2, axis=-1)
            if flows[n - first]:
                rows = change.transpose(1, 2, 0, 3).reshape(len(alive), fields, points, 3, 3)
                for w, own in zip(alive, rows, strict=True):
                    looks[w][n // every] = looks[w].get(n // every, 0.0) + own
                flowing[alive, n] = 1.0
            held[:, alive] = onward
            inside = np.flatnonzero(chi[:, n])
            held[:, inside] += chi[inside, n][:, None, None] * pulls[n - first][:, None]
            some = np.union1d(alive, inside)
            size = np.abs(held[:, some]).max(axis=(0, 2, 3), initial=0.0)
            largest[some] = np.maximum(largest[some], size)
            gone = some[size <= FORGOTTEN * largest[some]]
            held[:, gone], largest[gone] = 0.0, 0.0
    place = np.arange(len(F)) // every
    return [_mean(found, row, place) for found, row in zip(looks, flowing, strict=True)]


def _maps(F: np.ndarray, U: np.ndarray, met: Tangent) -> tuple[np.ndarray, np.ndarray]:
    """At which times something flows, and what derivatives by U there lead to.

    Args:
        F: at the times, shape [times, points, 3, 3].
        U: at the time before and at the times, shape [times + 1, points, 3, 3].
        met: the return.

    Returns:
        shape [times]; and by the U before and by F, one after the other, from the entries of those by
        U, shape [times, points, 9, 18].
    """
    assert met.elastic_by_F is not None
    shape, own = F.shape[:2], inverse(F)
    flat = met.elastic_by_F.reshape(*shape, 9, 9)
    flows = np.abs(flat - np.eye(9)).max(axis=(1, 2, 3)) > FLOWS
    through = (own @ flat.reshape(*shape, 3, 27)).reshape(*shape, 9, 3, 3)
    onward = F.swapaxes(2, 3)[:, :, None] @ through
    change = through @ U[:-1].swapaxes(2, 3)[:, :, None]
    still = own[..., :, None, :, None] * U[1:].swapaxes(2, 3)[..., None, :, None, :]
    change -= still.reshape(change.shape)
    return flows, np.concatenate([m.reshape(*shape, 9, 9) for m in (onward, change)], axis=-1)


def _pulls(F: np.ndarray, pairing: np.ndarray, met: Tangent) -> np.ndarray:
    """Derivatives of what the rows integrate by the U before, shape [times, points, fields, 9]."""
    times, fields, points = pairing.shape[:3]
    flat = pairing.swapaxes(1, 2).reshape(times, points, fields, 9)
    by_trial = (flat @ met.by_F.reshape(times, points, 9, 9)).reshape(*flat.shape[:3], 3, 3)
    return (F.swapaxes(2, 3)[:, :, None] @ by_trial).reshape(flat.shape)


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
