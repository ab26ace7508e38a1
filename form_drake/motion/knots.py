"""Which splines follow a motion: chosen inside one recording, by error at left-out tracks.

A linear fit gives that error in closed form, residual / (1 - leverage).

Motion of few degrees of freedom stands out of the noise as few modes, sums of products of a field and
a time series (singular vectors of the tracks as a matrix). Each gathers what all frames, or all
points, tell of it. Bases are chosen by the modes: frame by frame the noise would hide what a basis
cannot follow, while the balance, which gathers frames too, would see it as a bias.
"""

from functools import cache
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from form_drake.motion.body import Body
from form_drake.motion.splines import Splines, Tensor

# (spans, degree) along one axis in the order in which they are tried
LADDER = (
    *((1, d) for d in range(1, 6)),
    *((n, 5) for n in (2, 3, 4, 6, 8)),
)
CLIMBS = (*np.eye(3, dtype=int), *(2 * np.eye(3, dtype=int)), np.ones(3, dtype=int))
TIME_DEGREE = 4
# A basis is enlarged while the error at left-out tracks stays below this share of the least: the
# balance knows what noise does to it, but not what a basis cannot follow.
SLACK = 1.1
RIDGE = 1e-8  # weight of the roughness against the mean square misfit
KEPT = 0.95  # share of the tracks, best first: one that stands alone says little of the others
LARGEST = 0.6  # functions for each track
LOOKS = 24  # frames by which spatial bases are compared
PASSES = 30  # of filling points that are missing from some frames


def normal(Phi: np.ndarray, space: Tensor, weight: np.ndarray | None = None) -> np.ndarray:
    """Normal matrix of a spatial fit with the roughness that settles what no track tells."""
    own = Phi if weight is None else weight[:, None] * Phi
    found: np.ndarray = own.T @ own + RIDGE * len(Phi) * space.roughness()
    return found


def filled(space: Tensor, X: np.ndarray, u: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Displacements with the missing ones replaced by the fit's own, until they agree."""
    if valid.all():
        return u
    u, Phi = u.copy(), space.matrix(X)
    hat = np.linalg.solve(normal(Phi, space), Phi.T)
    for _ in range(PASSES):
        c = hat @ u.transpose(1, 0, 2).reshape(len(X), -1)
        u[~valid] = (Phi @ c).reshape(len(X), -1, 3).transpose(1, 0, 2)[~valid]
    return u


def press(space: Tensor, X: np.ndarray, u: np.ndarray, valid: np.ndarray) -> float:
    """Trimmed root mean square error [m] at left-out tracks; infinite for a dependent basis."""
    Phi = space.matrix(X)
    try:
        root = np.linalg.cholesky(normal(Phi, space))
    except np.linalg.LinAlgError:
        return float("inf")
    Q = solve_triangular(root, Phi.T, lower=True).T
    leverage = np.minimum(np.sum(Q**2, axis=1), 1.0 - 1e-9)
    flat = u.transpose(1, 0, 2).reshape(len(Phi), -1)
    error = ((flat - Q @ (Q.T @ flat)) / (1.0 - leverage)[:, None]).reshape(len(Phi), -1, 3)
    seen = valid.T[:, :, None]
    square = np.sum(error**2 * seen, axis=(1, 2)) / np.maximum(3.0 * seen.sum(axis=(1, 2)), 1.0)
    return float(np.sqrt(np.mean(np.sort(square)[: int(KEPT * len(square))])))


def modes(y: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Singular triplets U, S, V^T of what stands out of white noise; the first in any case.

    White noise of n x m entries has singular values up to noise (sqrt n + sqrt m) (Marchenko, Pastur).

    Args:
        y: shape [frames, series].
        noise: standard deviation of an entry.
    """
    U, S, Vt = np.linalg.svd(y, full_matrices=False)
    count = max(1, int(np.sum(S > noise * (np.sqrt(y.shape[0]) + np.sqrt(y.shape[1])))))
    return U[:, :count], S[:count], Vt[:count]


def _looked_at(u: np.ndarray, valid: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Fields by which bases are compared: modes, or some frames where points are missing."""
    if not valid.all():
        every = max(1, len(u) // LOOKS)
        return u[::every], valid[::every]
    _, S, Vt = modes(u.reshape(len(u), -1), noise)
    return (S[:, None] * Vt).reshape(-1, *u.shape[1:]), np.ones((len(S), u.shape[1]), dtype=bool)


def chosen_space(
    X: np.ndarray, u: np.ndarray, valid: np.ndarray, body: Body, noise: float
) -> Tensor:
    """Climbs the ladder where the held-out error is least, while it stays near the least found.

    ``noise`` is the standard deviation of a coordinate [m].
    """
    u, valid = _looked_at(u, valid, noise)

    held = [
        (body.faces[2 * n].condition == "bonded", body.faces[2 * n + 1].condition == "bonded")
        for n in range(3)
    ]

    @cache
    def splines(n: int, rung: int) -> Splines:
        return Splines.graded(body.low[n], body.high[n], *LADDER[rung], held[n])

    def tensor(rungs: tuple[int, ...]) -> Tensor:
        a, b, c = (splines(n, r) for n, r in enumerate(rungs))
        return Tensor((a, b, c))

    @cache
    def error(rungs: tuple[int, ...]) -> float:
        basis = tensor(rungs)
        if basis.size > LARGEST * len(X):
            return np.inf
        return press(basis, X, filled(basis, X, u, valid), valid)

    best = np.zeros(3, dtype=int)
    lowest = error((0, 0, 0))
    if not np.isfinite(lowest):
        raise ValueError(f"{len(X)} points do not determine even a linear motion; track more")
    floor = 1e-9 * float(np.sqrt(np.mean(u[valid] ** 2)))
    while lowest > floor:
        nexts = [tuple((best + climb).tolist()) for climb in CLIMBS]
        tried = {r: error(r) for r in nexts if max(r) < len(LADDER)}
        if not tried:
            break
        candidate = min(tried, key=lambda r: tried[r])
        if not tried[candidate] < SLACK * lowest:
            break
        best, lowest = np.array(candidate), min(lowest, tried[candidate])
    return tensor(tuple(best))


def chosen_time(time: np.ndarray, y: np.ndarray, noise: float) -> Splines:
    """Halves spans where the residual of the modes stands out of the noise.

    Args:
        time: stamps [s].
        y: series of whitened coefficients [m], shape [frames, series].
        noise: standard deviation that each series holds [m].
    """
    left, size, _ = modes(y, noise)
    y = left * size
    breaks = np.linspace(time[0], time[-1], 5)
    while True:
        splines = Splines(breaks, TIME_DEGREE)
        B = splines.matrix(time)
        Q = np.linalg.qr(B)[0]
        leverage = np.sum(Q**2, axis=1)
        energy = np.sum((y - Q @ (Q.T @ y)) ** 2, axis=1)
        new = list(breaks)
        for a, b in pairwise(breaks):
            inside = (time >= a) & (time <= b)
            expected = noise**2 * np.sum(1.0 - leverage[inside]) * y.shape[1]
            spread = noise**2 * np.sqrt(2.0 * np.sum(1.0 - leverage[inside]) * y.shape[1])
            middle = 0.5 * (a + b)
            halves = np.sum(inside & (time < middle)), np.sum(inside & (time > middle))
            if (
                min(halves) >= 2
                and len(new) + TIME_DEGREE < len(time)
                and np.sum(energy[inside]) > expected + 3.0 * spread
            ):
                new.append(middle)
        if len(new) == len(breaks):
            return splines
        breaks = np.sort(np.array(new))
