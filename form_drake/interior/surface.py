"""The motion of a whole body from points on its surface, with the covariance of what is not seen."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from form_drake.interior.faces import Grip, grips
from form_drake.interior.knots import chosen_cells
from form_drake.interior.resistance import Resistance
from form_drake.interior.statics import Held, Rows, Statics
from form_drake.motion import Body, Fit
from form_drake.motion.drift import centred
from form_drake.motion.fit import unfollowed
from form_drake.motion.knots import chosen_time
from form_drake.motion.smoothing import Smoothing, Spread
from form_drake.motion.space import Symmetry
from form_drake.motion.tracks import noise_of, tracks
from form_drake.records import Recording

LOOKS = 12  # frames that stand for all, where not each is needed
SLIDES = 1.1  # times the squared error of a face that slides, up to which a bonded one sticks
SHOWN = 1e-3  # share of a function that is no doubt left or no freedom
UNSETTLED = 0.1  # share of the frames that may not settle
SAGS = 3  # rounds in which points find the places free of stress that sag to where they are seen


def fit_surface(
    recording: Recording, body: Body, resistance: Resistance, *, symmetric: bool = True
) -> Fit:
    """Fit the tracks of a surface, and what is behind it.

    Args:
        recording: of tracks on faces of the body.
        body: the specimen.
        resistance: of its material, as far as that is known.
        symmetric: whether the symmetries that the recording states are taken.

    Raises:
        ValueError: too few points or frames, or no motion inside passes through them.
    """
    X, u, valid, time, used = tracks(recording, body, throughout=False)
    stated = recording.noise
    noise = noise_of(recording.time, u, valid) if stated is None else stated
    stated_symmetry = Symmetry.stated(recording.geometry.get("symmetry", ""))
    _covered(recording, stated_symmetry)
    symmetry = stated_symmetry if symmetric else Symmetry()
    u = centred(symmetry, body, X, u)
    root = alike(recording, used, noise)
    space, held_out = chosen_cells(X, u, valid, root, body, noise, symmetry)
    seen = _Seen(X, u, valid, root, max(noise, held_out))
    gravity = np.zeros(3) if recording.gravity is None else np.asarray(recording.gravity, float)
    statics = Statics(space, body, resistance, body.density * gravity)
    held = grips(recording, body)
    sticks = _sticks(statics, seen, held)
    if recording.p_reference is None and resistance.weighs and gravity.any():
        seen = _sunk(statics, seen, held, sticks)
    return _fit(statics, seen, time, noise, _frames(statics, seen, held, sticks))


def _covered(recording: Recording, symmetry: Symmetry) -> None:
    """Refuse a body of which one side is never seen, and not stated to be as the other."""
    seen = set() if recording.face is None else {int(f) for f in recording.face}
    for face in sorted(seen):
        if face // 2 not in symmetry.mirrors and face ^ 1 not in seen:
            axis = "xyz"[face // 2]
            raise ValueError(
                f"face {axis}{'-+'[face % 2]} is seen and {axis}{'+-'[face % 2]} is not: track that as well,"
                f' or state in the geometry that the motion is mirrored, as "symmetry": "{axis}"'
            )


@dataclass(frozen=True)
class _Seen:
    """Points of the surface.

    Attributes:
        X: stress-free positions [m], shape [points, 3].
        u: displacements [m], shape [frames, points, 3].
        valid: which are seen, shape [frames, points].
        root: that makes their errors alike, shape [points, 3, 3].
        sd: to how much a motion must then follow them [m].
    """

    X: np.ndarray
    u: np.ndarray
    valid: np.ndarray
    root: np.ndarray
    sd: float

    def matrix(self, statics: Statics) -> np.ndarray:
        """Displacements of the points by the coefficients, errors made alike, [points, 3, size]."""
        return np.asarray(self.root @ statics.values(self.X))

    @cached_property
    def alike(self) -> np.ndarray:
        """Displacements with errors made alike [m], shape of u."""
        return np.einsum("pij,fpj->fpi", self.root, self.u, optimize=True)

    def rows(self, D: np.ndarray, n: int) -> Rows:
        """Of a frame."""
        seen = self.valid[n]
        return Rows.of(D[seen], self.alike[n, seen], self.sd)


def alike(recording: Recording, seen: np.ndarray, noise: float) -> np.ndarray:
    """Roots that turn the errors of points into independent ones of the size of the noise [points, 3, 3].

    Args:
        recording: of the points; without their covariance, errors are alike as they are.
        seen: which of its points are used, shape [points].
        noise: standard deviation of a coordinate [m].
    """
    count = int(seen.sum())
    if recording.covariance is None or noise <= 0.0:
        return np.tile(np.eye(3), (count, 1, 1))
    size, axes = np.linalg.eigh(recording.covariance[seen])
    return np.asarray((axes * (noise / np.sqrt(size))[:, None]) @ axes.swapaxes(1, 2))


def _frames(statics: Statics, seen: _Seen, held: list[Grip], sticks: bool) -> list[Held]:
    """Every frame after the one before it."""
    D = seen.matrix(statics)
    own = [grip.rows(statics, sticks) for grip in held]
    last, found = statics.rest, []
    for n in range(len(seen.u)):
        last = statics.held(sum((grip(n) for grip in own), seen.rows(D, n)), last)
        found.append(last)
    lost = sum(not frame.settled for frame in found)
    if lost > UNSETTLED * len(found):
        raise ValueError(
            f"in {lost} of {len(found)} frames no motion inside the body balances the forces of"
            f" {statics.resistance.law.name} and passes through the points of its surface: are the"
            " faces held as the recording states?"
        )
    return found


def _sticks(statics: Statics, seen: _Seen, held: list[Grip]) -> bool:
    """Whether bonded faces stick to their tools, or slide along them: what fits the points better."""
    if not any(grip.face.condition == "bonded" for grip in held):
        return False
    size = np.linalg.norm(seen.u, axis=(1, 2))
    steps = np.linspace(0.0, size.max(), LOOKS + 1)[1:]
    looks = np.unique([int(np.argmax(size >= step)) for step in steps])  # the way to the largest
    few = replace(seen, u=seen.u[looks], valid=seen.valid[looks])
    own = [
        Grip(g.face, None if g.moved is None else g.moved[looks], g.presses[looks]) for g in held
    ]
    statics = replace(statics, resistance=Resistance.plain())
    D = seen.matrix(statics)
    left = []
    for sticks in (True, False):
        last = _frames(statics, few, own, sticks)[-1]
        rest = (few.alike[-1] - D @ last.y)[few.valid[-1]]
        left.append(float(np.sum(rest**2)))
    return left[0] <= SLIDES * left[1]


def _sunk(statics: Statics, seen: _Seen, held: list[Grip], sticks: bool) -> _Seen:
    """Points where they were before their own weight had moved them to where they are seen first."""
    size = float(np.max(statics.body.high - statics.body.low))
    x, X = seen.X, seen.X
    rows = Rows.of(statics.values(x), np.zeros(x.shape), size)  # so that nothing floats away
    for grip in held:
        rows = rows + grip.rows(statics, sticks)(0)
    y = statics.held(rows, statics.rest).y
    for _ in range(SAGS):
        X = x - statics.values(X) @ y
    return replace(seen, X=X, u=seen.u + (x - X))


def _fit(statics: Statics, seen: _Seen, time: np.ndarray, noise: float, frames: list[Held]) -> Fit:
    """Splines in time through the frames, and their covariance.

    What the surface shows of the coefficients is as uncertain as its points. What it does not show is
    what the balance makes it, and as uncertain as that: by how much points had to pull at it, in each
    frame, is told by what they show.
    """
    looks = frames[:: max(1, len(frames) // LOOKS)]
    stiffness = np.mean([f.stiffness for f in looks], axis=0)
    normal = np.mean([f.rows.normal for f in looks], axis=0)
    factor = np.linalg.cholesky(normal + 0.5 * (stiffness + stiffness.T))
    half = solve_triangular(factor, normal, lower=True)
    told, turn = np.linalg.eigh(solve_triangular(factor, half.T, lower=True))
    told = np.clip(told, 0.0, 1.0)
    root = solve_triangular(factor, turn, lower=True, trans="T") / seen.sd
    z = np.array([seen.sd * (turn.T @ (factor.T @ f.y)) for f in frames])
    pulls = turn.T @ solve_triangular(factor, np.array([f.pull for f in frames]).T, lower=True)
    doubt = np.sqrt(np.sum(pulls**2, axis=0) / np.sum(told * (1.0 - told)))
    splines = chosen_time(time, z, noise)
    Q, R = np.linalg.qr(splines.matrix(time))
    back = np.linalg.inv(R)
    D = seen.matrix(statics).reshape(-1, len(z[0]))
    follows = ((Q @ (Q.T @ z)) @ root.T @ D.T).reshape(seen.u.shape)
    rest = np.where(seen.valid[..., None], seen.alike - follows, 0.0)
    freedom = max(1.0 - told.sum() / len(D), SHOWN)
    spread = (
        Spread(np.sqrt(told)[:, None], noise * back),
        Spread(np.sqrt(told)[:, None], back @ Q.T @ unfollowed(rest, noise, freedom)),
    )
    unseen = Spread(np.sqrt(1.0 - told)[:, None], back @ Q.T @ (seen.sd * doubt)[:, None])
    misfit = float(np.sqrt(np.mean(rest[seen.valid] ** 2) / freedom))
    c = statics.space.tied(root @ (Q.T @ z).T @ back.T)
    return Fit(
        statics.space,
        splines,
        c,
        noise,
        misfit,
        seen.sd,
        (root,),
        spread,
        Smoothing.none(len(told)),
        spread,
        (unseen,),
    )
