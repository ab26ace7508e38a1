"""Motion from tracked points: a space-time spline whose knots the recording itself chooses.

Displacements of the tracks are fitted by products of B-splines in the stress-free coordinates and
in time, whose knots ``form_drake.motion.knots`` and ``pace`` choose. What stands out of the noise (its modes)
and the rest are smoothed in space, each as its own size asks for.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from form_drake.motion.body import Body
from form_drake.motion.drift import centred
from form_drake.motion.knots import chosen_space, filled, press
from form_drake.motion.lasting import lasting
from form_drake.motion.modes import edge
from form_drake.motion.pace import chosen_time, moments
from form_drake.motion.smoothing import Smoothing, Spread, smoothing_of
from form_drake.motion.space import RIDGE, Space, paired
from form_drake.motion.splines import Splines
from form_drake.motion.tracks import jitter, noise_of, placed, tracks
from form_drake.records import Recording

FAINT = 0.01  # of the largest mode that the fields leave, below which one is left out
CLEAR = 1.05  # times the largest singular value that noise alone would give
# Motion is followed down to this share of what its spatial basis leaves of it, were the noise less.
FOLLOWED = 0.1


@dataclass(frozen=True)
class Fit:
    """Displacements u(X, t) = sum c_ab phi_a(X) B_b(t) of a body.

    Attributes:
        space: fields over the reference box.
        time: basis over the recorded time.
        c: coefficients of the splines [m], shape [space.scalar.size, 3, time.size].
        noise: standard deviation of one measured coordinate [m], stated or estimated.
        misfit: root mean square residual of the tracks, per degree of freedom left [m].
        held_out: root mean square error at held-out tracks [m].
        roots: R of every block of the space, with R R^T the covariance of the coefficients of its
            functions per unit noise, were none of it smoothed or held by the ridge.
        spread: parts of the covariance, see there.
        smoothing: of the coefficients.
        response: parts of the covariance that the noise of the tracks alone has, were the smoothing
            given and its bias known.
        doubt: parts of the covariance of what no track tells. No rows are weighed by it, which would
            trust those in which a guess of it happens to cancel.
        lasting: whether errors of the tracks last from frame to frame.
    """

    space: Space
    time: Splines
    c: np.ndarray
    noise: float
    misfit: float
    held_out: float
    roots: tuple[np.ndarray, ...]
    spread: tuple[Spread, ...]
    smoothing: Smoothing
    response: tuple[Spread, ...]
    doubt: tuple[Spread, ...] = ()
    lasting: bool = False

    @property
    def responding(self) -> "Fit":
        """The same with the covariance of its response, for what a fit ``like`` it is compared with."""
        return replace(self, spread=self.response)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Noise of the coefficients [m], shape of c."""
        white = np.zeros((self.space.size, self.time.size))
        for part in self.spread:
            z = rng.standard_normal((len(part.scale), part.time_root.shape[1]))
            error = part.scale * z
            white += (error if part.mix is None else part.mix @ error) @ part.time_root.T
        return self.space.tied(by_root(self.space, self.roots, white))

    def deviation(self, time: float, X: np.ndarray) -> np.ndarray:
        """Standard deviation of positions [m], of what no track tells too, shape [points, 3].

        Args:
            time: from the first frame on [s].
            X: stress-free positions [m], shape [points, 3].
        """
        basis, Phi = self.time.matrix(np.array([time]))[0], self.space.scalar.matrix(X)
        ends = np.cumsum([R.shape[1] for R in self.roots])
        square = np.zeros(X.shape)
        for part in (*self.spread, *self.doubt):
            along = np.broadcast_to(
                (basis @ part.time_root) ** 2, (len(part.scale), part.time_root.shape[1])
            )
            size = np.sum(part.scale**2 * along, axis=1)
            for block, R, end in zip(self.space.blocks, self.roots, ends, strict=True):
                own, D = slice(end - R.shape[1], end), block.matrix(Phi) @ R
                mixed = D**2 @ size[own] if part.mix is None else (D @ part.mix[own]) ** 2 @ size
                square[:, block.axes] += mixed
        return np.sqrt(square)

    def describe(self) -> dict[str, object]:
        """Facts for a report."""
        return {
            "space_basis": [
                f"{len(s.breaks) - 1} x degree {s.degree}" for s in self.space.scalar.axes
            ],
            "symmetry": self.space.symmetry.describe(),
            "time_spans": len(self.time.breaks) - 1,
            "shortest_time_span": float(np.diff(self.time.breaks).min()),
            "noise": self.noise,
            "track_misfit": self.misfit,
            "held_out_error": self.held_out,
        }


def fit_tracks(
    recording: Recording, body: Body, like: Fit | None = None, *, symmetric: bool = True
) -> Fit:
    """Fit the tracks of a recording.

    Args:
        recording: of the tracks.
        body: the specimen.
        like: fit whose bases and smoothing are taken; None: they are chosen.
        symmetric: whether symmetries that the tracks support are taken.

    Raises:
        ValueError: too few points or frames, or points on one plane.
    """
    X, u, valid, time, _ = tracks(recording, body)
    stated = recording.noise
    noise = noise_of(recording.time, u, valid) if stated is None else stated
    space = like.space if like else chosen_space(X, u, valid, body, noise, symmetric=symmetric)
    u = centred(space.symmetry, body, X, filled(space, X, u, valid))
    white, roots, roughness = _projected(space, X, u, valid)
    Phi = space.scalar.matrix(X)

    def left(white: np.ndarray) -> np.ndarray:
        c = space.tied(by_root(space, roots, white.T))
        return u - np.einsum("pa,ait->tpi", Phi, c, optimize=True)

    freedom = max(1.0 - space.size / (3.0 * valid.any(axis=0).sum()), 1e-3)
    rest = left(white)
    spread = float(np.sqrt(np.mean(rest[valid] ** 2) / freedom))
    if stated is None:
        # what neither the fields follow nor time smooths: noise, or waves as short as the points
        noise = min(spread, jitter(recording.time, rest, valid) / np.sqrt(freedom))
    follow = max(noise, FOLLOWED * spread)
    splines = chosen_time(time, white, follow) if like is None else like.time
    Q, back, octaves = moments(splines, time)
    z = Q.T @ white
    count = max(1.0 - space.size * splines.size / (3.0 * len(X) * len(time)), 1e-3)
    misfit = float(np.sqrt(np.mean(left(Q @ z)[valid] ** 2) / count))
    told = np.maximum(1.0 - RIDGE * len(X) * roughness, 0.0)  # the rest the ridge holds, not data
    smoothing, parts = (
        (like.smoothing, ()) if like else smoothing_of(z, roughness, told, follow, octaves)
    )
    z, response = smoothing(z), smoothing.spread(told)
    response, parts = (
        tuple(replace(part, time_root=noise * back @ part.time_root) for part in own)
        for own in (response, parts or response)
    )
    series = unfollowed(rest, noise, freedom)
    parts = (*parts, Spread(np.sqrt(told)[:, None], back @ Q.T @ series))
    stays = lasting(white, time, _intervals(recording))
    if stays is not None:
        scale = np.sqrt(told)[:, None] * stays.scale
        root = smoothing.alike(scale[:, 0] ** 2)(Q.T @ stays.time_root)
        own = (Spread(scale, back @ root),)
        response, parts = (*response, *own), (*parts, *own)
    c = space.tied(by_root(space, roots, z.T @ back.T))
    held, *_ = press(space, X, u, valid)
    lasts = stays is not None
    return Fit(
        space, splines, c, noise, misfit, held, roots, parts, smoothing, response, lasting=lasts
    )


def _intervals(recording: Recording) -> np.ndarray | None:
    """Intervals of rest, from the first frame on [s]."""
    return None if recording.rest is None else recording.rest - recording.time[0]


def by_root(space: Space, roots: tuple[np.ndarray, ...], white: np.ndarray) -> np.ndarray:
    """Coefficients of all functions [m] from whitened ones, shape [space.size, n]."""
    ends = np.cumsum([len(R) for R in roots])[:-1]
    return np.concatenate([R @ w for R, w in zip(roots, np.split(white, ends), strict=True)])


def unfollowed(rest: np.ndarray, noise: float, freedom: float) -> np.ndarray:
    """Series of what the fields leave of the tracks and noise does not explain [m].

    Waves shorter than the distance of the tracks look like noise that is independent from track to
    track, but stays in time. Its covariance in time is that of the modes of the residual, whose
    sizes noise has enlarged (Benaych-Georges and Nadakuditi, "The singular values and vectors of low
    rank perturbations of large rectangular random matrices", 2012).

    Args:
        rest: residual of the tracks [m], shape [frames, points, 3].
        noise: standard deviation of a coordinate [m].
        freedom: share of the coordinates that the fields leave free.

    Returns:
        Root of the covariance, shape [frames, modes].
    """
    y = rest.reshape(len(rest), -1)
    U, S, _ = np.linalg.svd(y, full_matrices=False)
    rows, columns = len(y), freedom * y.shape[1]
    above = S**2 - noise**2 * (rows + columns)
    square = 0.5 * (above + np.sqrt(np.maximum(above**2 - 4.0 * noise**4 * rows * columns, 0.0)))
    sure = S > CLEAR * noise * edge(rows, columns)
    kept = sure & (S > FAINT * S[0])
    return U[:, kept] * np.sqrt(square[kept] / columns)


def _projected(
    space: Space, X: np.ndarray, u: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """Whitened coefficients [frames, size], their roots, see ``Fit``, and their roughness [size].

    A point seen in part of the frames weighs in the covariance by that share. The columns of a root
    share no roughness.
    """
    Phi, seen = space.scalar.matrix(X), np.sqrt(valid.mean(axis=0))
    found = {}
    for group in space.alike:
        D = group[0].matrix(Phi)
        solver = cho_factor(space.normal(D, group[0]))
        factor = np.linalg.cholesky(space.normal(D * seen[:, None, None], group[0]))
        inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
        own, turn = np.linalg.eigh(inverse @ space.roughness(group[0]) @ inverse.T)
        for block in group:
            y = cho_solve(solver, paired(D, u[:, :, block.axes]))
            found[block.axes] = turn.T @ (factor.T @ y), inverse.T @ turn, np.maximum(own, 0.0)
    white, roots, roughness = zip(*(found[block.axes] for block in space.blocks), strict=True)
    return np.concatenate(white).T, tuple(roots), np.concatenate(roughness)


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
    valid &= placed(recording)
    scalar = fit.space.scalar
    Phi = scalar.matrix(recording.reference[valid])
    flat = value[:, valid].swapaxes(0, 1).reshape(len(Phi), -1)
    normal = Phi.T @ Phi + RIDGE * len(Phi) * scalar.roughness
    c = scalar.matrix(X) @ np.linalg.solve(normal, Phi.T @ flat)
    series = c.reshape(len(X), len(value), -1).swapaxes(0, 1)
    found = make_interp_spline(recording.time - recording.time[0], series, k=3)(time)
    return np.asarray(found).reshape(len(time), len(X), *value.shape[2:])
