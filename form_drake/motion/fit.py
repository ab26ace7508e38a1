"""Motion from tracked points: a space-time spline whose knots the recording itself chooses.

Displacements of the tracks are fitted by products of B-splines in the stress-free coordinates and
in time, whose knots ``form_drake.motion.knots`` chooses.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import solve_triangular

from form_drake.motion.body import Body
from form_drake.motion.knots import chosen_space, chosen_time, filled, normal, press
from form_drake.motion.splines import Splines, Tensor
from form_drake.records import Recording

NEAR = np.array([-2, -1, 1, 2])  # neighbours of a stamp
OUTSIDE = 0.02  # of the box, by which points may lie beyond it


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


def fit_tracks(recording: Recording, body: Body, like: Fit | None = None) -> Fit:
    """Fit the tracks of a recording.

    Args:
        recording: of the tracks.
        body: the specimen.
        like: fit whose bases are taken; None: they are chosen.

    Raises:
        ValueError: too few points or frames, or points on one plane.
    """
    X, u, valid, time = _tracks(recording, body)
    space = chosen_space(X, u, valid, body) if like is None else like.space
    u = filled(space, X, u, valid)
    c, root = _projected(space, X, u, valid)
    rest = u - space.matrix(X) @ c
    freedom = 1.0 - space.size / valid.any(axis=0).sum()
    spread = float(np.sqrt(np.mean(rest[valid] ** 2) / max(freedom, 1e-3)))
    stated = recording.noise
    jitter = _jitter(recording.time, u, valid)
    white = np.linalg.solve(root, c.reshape(len(time), space.size, 3)).reshape(len(time), -1)
    if like is None:
        splines = chosen_time(time, white, stated or min(spread, jitter))
    else:
        splines = like.time
    B = splines.matrix(time)
    gamma, time_root = _least_squares(B, c.reshape(len(time), -1))
    c_ab = gamma.reshape(splines.size, space.size, 3).transpose(1, 2, 0)
    left = u - space.matrix(X) @ np.einsum("aib,tb->tai", c_ab, B, optimize=True)
    count = valid.sum() * (1.0 - space.size * splines.size / (len(X) * len(time)))
    misfit = float(np.sqrt(np.sum(left[valid] ** 2) / 3.0 / max(count, 1.0)))
    held = press(space, X, u, valid)
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
    flat = np.linalg.solve(normal(Phi, space), Phi.T @ u.transpose(1, 0, 2).reshape(P, -1))
    root = np.linalg.cholesky(normal(Phi, space, np.sqrt(valid.mean(axis=0))))
    inverse = solve_triangular(root, np.eye(len(root)), lower=True).T
    return flat.reshape(-1, T, 3).transpose(1, 0, 2), inverse


def neighbours(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the cubic through four neighbours of every stamp, shape [middles, 4], and its index."""
    middle = np.arange(2, len(time) - 2)
    t = time[middle[:, None] + NEAR] - time[middle, None]
    weights = [
        np.prod([-t[:, j] / (t[:, i] - t[:, j]) for j in range(4) if j != i], axis=0)
        for i in range(4)
    ]
    return np.stack(weights, axis=1), middle


def _jitter(time: np.ndarray, u: np.ndarray, valid: np.ndarray) -> float:
    """Noise of one coordinate [m] from its deviation from the cubic through four neighbours.

    The median over frames, so that moments of fast motion do not count.
    """
    weights, middle = neighbours(time)
    error = u[middle] - np.einsum("fk,fkpi->fpi", weights, u[middle[:, None] + NEAR], optimize=True)
    error /= np.sqrt(1.0 + np.sum(weights**2, axis=1))[:, None, None]
    sure = valid[middle] & valid[middle[:, None] + NEAR].all(axis=1)
    square = np.array(
        [np.mean(e[s] ** 2) if s.any() else np.nan for e, s in zip(error, sure, strict=True)]
    )
    return float(np.sqrt(np.nanmedian(square)))


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
    flat = value[:, valid].swapaxes(0, 1).reshape(len(Phi), -1)
    c = fit.space.matrix(X) @ np.linalg.solve(normal(Phi, fit.space), Phi.T @ flat)
    series = c.reshape(len(X), len(value), -1).swapaxes(0, 1)
    found = make_interp_spline(recording.time - recording.time[0], series, k=3)(time)
    return np.asarray(found).reshape(len(time), len(X), *value.shape[2:])
