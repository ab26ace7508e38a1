"""Motion from tracked points: a space-time spline whose knots the recording itself chooses.

Displacements of the tracks are fitted by products of B-splines in the stress-free coordinates and
in time. Every choice is made by the error at held-out tracks or frames, which a linear fit gives
in closed form: residual / (1 - leverage).
"""

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import solve_triangular

from form_drake.motion.body import Body
from form_drake.motion.splines import Splines, Tensor
from form_drake.records import Recording

# (spans, degree) along one axis in the order in which they are tried
OUTSIDE = 0.02  # of the box, by which points may lie beyond it
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


@dataclass(frozen=True)
class Fit:
    """Displacements u(X, t) = sum c_ab phi_a(X) B_b(t) of a body.

    Attributes:
        space: basis over the reference box.
        time: basis over the recorded time.
        c: coefficients [m], shape [space.size, 3, time.size].
        noise: standard deviation of one measured coordinate [m], stated or estimated.
        misfit: root mean square residual of the tracks, per degree of freedom left [m].
        held_out: root mean square error at held-out tracks [m].
        space_root: R with R R^T the covariance of c along space per unit noise.
        time_root: the same along time.
    """

    space: Tensor
    time: Splines
    c: np.ndarray
    noise: float
    misfit: float
    held_out: float
    space_root: np.ndarray
    time_root: np.ndarray

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Noise of the coefficients [m], shape of c."""
        z = rng.standard_normal(self.c.shape)
        return self.noise * np.einsum(
            "ab,bic,dc->aid", self.space_root, z, self.time_root, optimize=True
        )

    def with_coefficients(self, c: np.ndarray) -> "Fit":
        return replace(self, c=c)

    def describe(self) -> dict[str, object]:
        """Facts for a report."""
        return {
            "space_basis": [f"{len(s.breaks) - 1} x degree {s.degree}" for s in self.space.axes],
            "time_spans": len(self.time.breaks) - 1,
            "shortest_time_span": float(np.diff(self.time.breaks).min()),
            "noise": self.noise,
            "track_misfit": self.misfit,
            "held_out_error": self.held_out,
        }


def fit_tracks(recording: Recording, body: Body) -> Fit:
    """Fit the tracks of a recording.

    Raises:
        ValueError: too few points or frames, or points on one plane.
    """
    X, u, valid, time = _tracks(recording, body)
    space = _chosen_space(X, u, valid, body)
    u = _filled(space, X, u, valid)
    c, root = _projected(space, X, u, valid)
    rest = u - space.matrix(X) @ c
    freedom = 1.0 - space.size / valid.any(axis=0).sum()
    spread = float(np.sqrt(np.mean(rest[valid] ** 2) / max(freedom, 1e-3)))
    stated = recording.noise
    jitter = _jitter(recording.time, u, valid)
    white = np.linalg.solve(root, c.reshape(len(time), space.size, 3)).reshape(len(time), -1)
    splines = _chosen_time(time, white, stated or min(spread, jitter))
    B = splines.matrix(time)
    gamma, time_root = _least_squares(B, c.reshape(len(time), -1))
    c_ab = gamma.reshape(splines.size, space.size, 3).transpose(1, 2, 0)
    left = u - space.matrix(X) @ np.einsum("aib,tb->tai", c_ab, B, optimize=True)
    count = valid.sum() * (1.0 - space.size * splines.size / (len(X) * len(time)))
    misfit = float(np.sqrt(np.sum(left[valid] ** 2) / 3.0 / max(count, 1.0)))
    held = _press(space, X, u, valid)
    noise = min(misfit, jitter) if stated is None else stated
    return Fit(space, splines, c_ab, noise, misfit, held, root, time_root)


def _tracks(
    recording: Recording, body: Body
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stress-free positions, displacements, validity and time of the points ever seen."""
    valid = np.isfinite(recording.p_WQ).all(axis=2)
    if recording.valid is not None:
        valid &= recording.valid
    if recording.p_reference is None and not valid[0].all():
        raise ValueError(
            "points are missing from the first frame, so it gives no stress-free positions: state"
            " p_reference"
        )
    edge = OUTSIDE * (body.high - body.low)
    inside = (recording.reference >= body.low - edge) & (recording.reference <= body.high + edge)
    _check_units(recording.reference, body, inside.all(axis=1))
    seen = (valid.sum(axis=0) >= 0.5 * recording.frames) & inside.all(axis=1)
    X = recording.reference[seen]
    if len(X) < 8:
        raise ValueError(f"{len(X)} points are seen in half of the frames: 8 or more are needed")
    if recording.frames < 8:
        raise ValueError(f"{recording.frames} frames: 8 or more are needed")
    flat = np.linalg.svd((X - X.mean(axis=0)) / (body.high - body.low), compute_uv=False)
    if flat[-1] < 1e-3 * flat[0]:
        raise ValueError(
            "all points lie on one plane: motion inside the body needs points throughout it, or a"
            " reconstruction of the interior"
        )
    u = np.where(valid[:, :, None], recording.p_WQ - recording.reference, 0.0)
    return X, u[:, seen], valid[:, seen], recording.time - recording.time[0]


def _check_units(X: np.ndarray, body: Body, inside: np.ndarray) -> None:
    size, spread = float(np.max(body.high - body.low)), float(np.max(np.ptp(X, axis=0)))
    if not 0.02 < spread / size < 50.0 or inside.mean() < 0.2:
        raise ValueError(
            f"points span {spread:.4g} m, the stated box {size:.4g} m, and {inside.sum()} of"
            f" {len(X)} points lie in it; lengths are metres: are some in millimetres?"
        )


def _normal(Phi: np.ndarray, space: Tensor, weight: np.ndarray | None = None) -> np.ndarray:
    """Normal matrix of a spatial fit with the roughness that settles what no track tells."""
    own = Phi if weight is None else weight[:, None] * Phi
    found: np.ndarray = own.T @ own + RIDGE * len(Phi) * space.roughness()
    return found


def _least_squares(Phi: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solution of Phi c = y and R with R R^T = (Phi^T Phi)^-1."""
    Q, R = np.linalg.qr(Phi)
    return np.linalg.solve(R, Q.T @ y), np.linalg.inv(R)


def _projected(
    space: Tensor, X: np.ndarray, u: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of every frame, shape [frames, size, 3], and the root of their covariance.

    A point seen in part of the frames weighs in the covariance by that share.
    """
    T, P = valid.shape
    Phi = space.matrix(X)
    flat = np.linalg.solve(_normal(Phi, space), Phi.T @ u.transpose(1, 0, 2).reshape(P, -1))
    root = np.linalg.cholesky(_normal(Phi, space, np.sqrt(valid.mean(axis=0))))
    inverse = solve_triangular(root, np.eye(len(root)), lower=True).T
    return flat.reshape(-1, T, 3).transpose(1, 0, 2), inverse


def _jitter(time: np.ndarray, u: np.ndarray, valid: np.ndarray) -> float:
    """Noise of one coordinate [m] from its deviation from the cubic through four neighbours.

    The median over frames, so that moments of fast motion do not count.
    """
    offsets = np.array([-2, -1, 1, 2])
    middle = np.arange(2, len(time) - 2)
    t = time[middle[:, None] + offsets] - time[middle, None]
    weights = np.stack(
        [
            np.prod([-t[:, j] / (t[:, i] - t[:, j]) for j in range(4) if j != i], axis=0)
            for i in range(4)
        ],
        axis=1,
    )
    error = u[middle] - np.einsum(
        "fk,fkpi->fpi", weights, u[middle[:, None] + offsets], optimize=True
    )
    error /= np.sqrt(1.0 + np.sum(weights**2, axis=1))[:, None, None]
    sure = valid[middle] & valid[middle[:, None] + offsets].all(axis=1)
    square = np.array(
        [np.mean(e[s] ** 2) if s.any() else np.nan for e, s in zip(error, sure, strict=True)]
    )
    return float(np.sqrt(np.nanmedian(square)))


def _filled(space: Tensor, X: np.ndarray, u: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Displacements with the missing ones replaced by the fit's own, until they agree."""
    if valid.all():
        return u
    u, Phi = u.copy(), space.matrix(X)
    hat = np.linalg.solve(_normal(Phi, space), Phi.T)
    for _ in range(PASSES):
        c = hat @ u.transpose(1, 0, 2).reshape(len(X), -1)
        u[~valid] = (Phi @ c).reshape(len(X), -1, 3).transpose(1, 0, 2)[~valid]
    return u


def _press(space: Tensor, X: np.ndarray, u: np.ndarray, valid: np.ndarray) -> float:
    """Trimmed root mean square error [m] at left-out tracks; infinite for a dependent basis."""
    Phi = space.matrix(X)
    try:
        root = np.linalg.cholesky(_normal(Phi, space))
    except np.linalg.LinAlgError:
        return float("inf")
    Q = solve_triangular(root, Phi.T, lower=True).T
    leverage = np.minimum(np.sum(Q**2, axis=1), 1.0 - 1e-9)
    flat = u.transpose(1, 0, 2).reshape(len(Phi), -1)
    error = ((flat - Q @ (Q.T @ flat)) / (1.0 - leverage)[:, None]).reshape(len(Phi), -1, 3)
    seen = valid.T[:, :, None]
    square = np.sum(error**2 * seen, axis=(1, 2)) / np.maximum(3.0 * seen.sum(axis=(1, 2)), 1.0)
    return float(np.sqrt(np.mean(np.sort(square)[: int(KEPT * len(square))])))


def _chosen_space(X: np.ndarray, u: np.ndarray, valid: np.ndarray, body: Body) -> Tensor:
    """Climbs the ladder along the axis that lowers the held-out error most, while it falls."""
    every = max(1, len(u) // LOOKS)
    u, valid = u[::every], valid[::every]

    held = [
        (body.faces[2 * n].condition == "bonded", body.faces[2 * n + 1].condition == "bonded")
        for n in range(3)
    ]

    def tensor(rungs: tuple[int, ...]) -> Tensor:
        a, b, c = (
            Splines.graded(body.low[n], body.high[n], *LADDER[r], held[n])
            for n, r in enumerate(rungs)
        )
        return Tensor((a, b, c))

    @cache
    def error(rungs: tuple[int, ...]) -> float:
        basis = tensor(rungs)
        if basis.size > LARGEST * len(X):
            return np.inf
        return _press(basis, X, _filled(basis, X, u, valid), valid)

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


def _chosen_time(time: np.ndarray, y: np.ndarray, noise: float) -> Splines:
    """Halves spans where the residual of whitened coefficients stands out of the noise.

    Args:
        time: stamps [s].
        y: series of whitened coefficients [m], shape [frames, series].
        noise: standard deviation that each series holds [m].
    """
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


def supplied(
    recording: Recording, value: np.ndarray | None, fit: Fit, time: np.ndarray, X: np.ndarray
) -> np.ndarray | None:
    """A field given at the tracked points, at other points and times.

    Args:
        recording: whose points and frames.
        value: shape [frames, points, ...]; None gives None.
        fit: of the tracks; its basis carries the field through space.
        time: from the first frame on [s], shape [times].
        X: stress-free positions [m], shape [others, 3].
    """
    if value is None:
        return None
    valid = np.isfinite(value).reshape(*value.shape[:2], -1).all(axis=(0, 2))
    Phi = fit.space.matrix(recording.reference[valid])
    normal = _normal(Phi, fit.space)
    flat = value[:, valid].swapaxes(0, 1).reshape(len(Phi), -1)
    c = fit.space.matrix(X) @ np.linalg.solve(normal, Phi.T @ flat)
    series = c.reshape(len(X), len(value), -1).swapaxes(0, 1)
    found = make_interp_spline(recording.time - recording.time[0], series, k=3)(time)
    return np.asarray(found).reshape(len(time), len(X), *value.shape[2:])


__all__ = ["Fit", "fit_tracks", "supplied"]
