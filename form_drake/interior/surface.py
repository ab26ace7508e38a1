"""The motion of a whole body from points on its surface, with the covariance of what is not seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from form_drake.interior.faces import Hold, holds
from form_drake.interior.knots import chosen_cells
from form_drake.interior.resistance import Resistance
from form_drake.interior.statics import Held, Rows, Statics
from form_drake.motion import Body, Fit
from form_drake.motion.drift import centred
from form_drake.motion.fit import unfollowed
from form_drake.motion.knots import chosen_time
from form_drake.motion.smoothing import Smoothing, Spread
from form_drake.motion.space import Space, Symmetry
from form_drake.motion.tracks import noise_of, tracks
from form_drake.records import Recording

LOOKS = 12  # frames that stand for all, where not each is needed
SLIDES = 1.1  # times the squared error of a face that slides, up to which a bonded one sticks
FRICTIONS = (0.0, 0.1, 0.2, 0.3)  # that are tried
SHOWN = 1e-3  # share of a function that is no doubt left or no freedom
UNSETTLED = 0.1  # share of the frames that may not settle
SAGS = 3  # rounds in which points find the places free of stress that sag to where they are seen


@dataclass(frozen=True)
class Seen:
    """Points on the surface of a body, and all that does not depend on what it is made of.

    Attributes:
        body: the specimen.
        space: of its displacements.
        X: stress-free positions of the points, or those in the first frame [m], shape [points, 3].
        u: displacements from there [m], shape [frames, points, 3].
        valid: which are seen, shape [frames, points].
        whitening: makes the errors of a point independent and as large as the noise, shape
            [points, 3, 3].
        time: from the first frame on [s], shape [frames].
        noise: standard deviation of a whitened coordinate [m].
        sd: error at left-out points, to which a motion must follow them [m].
        holds: what tools and supports say.
        force: weight per volume [N/m^3], shape [3].
        bent: whether that has bent the body in the first frame, of which X is then made.
    """

    body: Body
    space: Space
    X: np.ndarray
    u: np.ndarray
    valid: np.ndarray
    whitening: np.ndarray
    time: np.ndarray
    noise: float
    sd: float
    holds: tuple[Hold, ...]
    force: np.ndarray
    bent: bool

    @classmethod
    def of(cls, recording: Recording, body: Body, *, symmetric: bool = True) -> "Seen":
        """What a recording of tracks on faces of a body holds.

        Args:
            recording: of the tracks.
            body: the specimen.
            symmetric: whether the symmetries that the recording states are taken.

        Raises:
            ValueError: too few points or frames, or a side of the body that nothing tells of.
        """
        X, u, valid, time, used = tracks(recording, body, throughout=False)
        stated = recording.noise
        noise = noise_of(recording.time, u, valid) if stated is None else stated
        symmetry = Symmetry.stated(recording.geometry.get("symmetry", ""))
        _covered(recording, symmetry)
        symmetry = symmetry if symmetric else Symmetry()
        u = centred(symmetry, body, X, u)
        white = _whitening(recording, used, noise)
        space, held_out = chosen_cells(X, u, valid, white, body, noise, symmetry)
        gravity = np.zeros(3) if recording.gravity is None else np.asarray(recording.gravity, float)
        return cls(
            body=body,
            space=space,
            X=X,
            u=u,
            valid=valid,
            whitening=white,
            time=time,
            noise=noise,
            sd=max(noise, held_out),
            holds=tuple(holds(recording, body)),
            force=body.density * gravity,
            bent=recording.p_reference is None and bool(gravity.any()),
        )

    @cached_property
    def white(self) -> np.ndarray:
        """Whitened displacements [m], shape of u."""
        return np.einsum("pij,fpj->fpi", self.whitening, self.u, optimize=True)

    def friction(self, resistance: Resistance) -> float:
        """Coulomb's coefficient under bonded faces; infinite where they stick.

        With it, balance alone comes nearest to the points, on the way to the largest displacement.
        """
        if not any(hold.face.condition == "bonded" for hold in self.holds):
            return 0.0
        statics, seen = self._statics(resistance)
        return _friction(statics, seen)

    def fit(self, resistance: Resistance, friction: float | None = None) -> Fit:
        """The motion of the whole body, as far as its material is known.

        Args:
            resistance: of the material.
            friction: of bonded faces; None: as ``friction`` finds it.

        Raises:
            ValueError: no motion inside passes through the points.
        """
        friction = self.friction(resistance) if friction is None else friction
        statics, seen = self._statics(resistance)
        frames = _frames(statics, seen, friction)
        lost = sum(not frame.settled for frame in frames)
        if lost > UNSETTLED * len(frames):
            raise ValueError(
                f"in {lost} of {len(frames)} frames no motion inside the body balances the forces of"
                f" {resistance.law.name} and passes through the points of its surface: are the faces held"
                " as the recording states?"
            )
        return _fit(statics, seen, frames)

    def _statics(self, resistance: Resistance) -> tuple[Statics, "Seen"]:
        """Of the material, and what is seen from where it is free of stress."""
        statics = Statics(self.space, self.body, resistance, self.force)
        return statics, _sunk(statics, self) if self.bent and resistance.weighs else self


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


def _whitening(recording: Recording, used: np.ndarray, noise: float) -> np.ndarray:
    """As of ``Seen``, for the points ``used`` [points]; without their covariance, errors are alike."""
    if recording.covariance is None or noise <= 0.0:
        return np.tile(np.eye(3), (int(used.sum()), 1, 1))
    size, axes = np.linalg.eigh(recording.covariance[used])
    return np.asarray((axes * (noise / np.sqrt(size))[:, None]) @ axes.swapaxes(1, 2))


def _frames(statics: Statics, seen: Seen, friction: float) -> list[Held]:
    """Every frame after the one before it."""
    D = seen.whitening @ statics.values(seen.X)
    own = [hold.grip(statics, friction) for hold in seen.holds]
    last, found = statics.rest, []
    for n, valid in enumerate(seen.valid):
        rows = Rows.of(D[valid], seen.white[n, valid], seen.sd)
        last = statics.held(rows, [grip for hold in own if (grip := hold(n))], last)
        found.append(last)
    return found


def _few(seen: Seen) -> Seen:
    """Frames on the way to the largest displacement that stand for all."""
    size = np.linalg.norm(seen.u, axis=(1, 2))
    steps = np.linspace(0.0, size.max(), LOOKS + 1)[1:]
    looks = np.unique([int(np.argmax(size >= step)) for step in steps])
    holds = tuple(hold.at(looks) for hold in seen.holds)
    return replace(seen, u=seen.u[looks], valid=seen.valid[looks], holds=holds)


def _friction(statics: Statics, seen: Seen) -> float:
    few = _few(seen)
    D = seen.whitening @ statics.values(seen.X)

    def off(friction: float) -> float:
        frames = _frames(statics, few, friction)
        rest = [(few.white[n] - D @ f.alone)[few.valid[n]] for n, f in enumerate(frames)]
        return float(sum(np.log(np.mean(r**2)) for r in rest if len(r)))

    sticking = off(np.inf)
    sliding, friction = _least(off, FRICTIONS)
    return np.inf if sticking <= sliding + len(few.u) * np.log(SLIDES) else friction


def _least(function: Callable[[float], float], places: Sequence[float]) -> tuple[float, float]:
    """The least value at four even places, and where a parabola through it and its neighbours is least.

    There is one least value: on the far side of the greater of the inner two none is looked for.
    """
    inner = function(places[1]), function(places[2])
    k = 1 if inner[0] <= inner[1] else 2
    outer = function(places[0 if k == 1 else 3])
    left, here, right = (outer, *inner) if k == 1 else (*inner, outer)
    bend, step = left - 2.0 * here + right, places[1] - places[0]
    shift = 0.5 * (left - right) / bend if bend > 0.0 else float(np.sign(left - right))
    least = float(np.clip(places[k] + step * shift, places[0], places[-1]))
    return min(left, here, right), least


def _sunk(statics: Statics, seen: Seen) -> Seen:
    """Points where they were before the weight had moved them to where they are seen first."""
    size = float(np.max(statics.body.high - statics.body.low))
    x, X = seen.X, seen.X
    rows = Rows.of(statics.values(x), np.zeros(x.shape), size)  # so that nothing floats away
    own = [hold.grip(statics, np.inf)(0) for hold in seen.holds]
    y = statics.held(rows, [grip for grip in own if grip], statics.rest).y
    for _ in range(SAGS):
        X = x - statics.values(X) @ y
    return replace(seen, X=X, u=seen.u + (x - X))


def _fit(statics: Statics, seen: Seen, frames: list[Held]) -> Fit:
    """Splines in time through the frames, and their covariance.

    What the surface shows of the coefficients is as uncertain as its points. What it does not show is
    what the balance makes it, and as uncertain as that: by how much points had to pull at it, in each
    frame, beyond what their noise does, is told by what they show.
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
    by_noise = (seen.noise / seen.sd) ** 2 * np.sum(told * (1.0 - told) ** 2)
    beyond = np.maximum(np.sum(pulls**2, axis=0) - by_noise, 0.0)
    doubt = np.sqrt(beyond / np.sum(told**2 * (1.0 - told)))
    splines = chosen_time(seen.time, z, seen.noise)
    Q, R = np.linalg.qr(splines.matrix(seen.time))
    back = np.linalg.inv(R)
    D = (seen.whitening @ statics.values(seen.X)).reshape(-1, len(z[0]))
    follows = ((Q @ (Q.T @ z)) @ root.T @ D.T).reshape(seen.u.shape)
    rest = np.where(seen.valid[..., None], seen.white - follows, 0.0)
    freedom = max(1.0 - told.sum() / len(D), SHOWN)
    spread = (
        Spread(np.sqrt(told)[:, None], seen.noise * back),
        Spread(np.sqrt(told)[:, None], back @ Q.T @ unfollowed(rest, seen.noise, freedom)),
    )
    unseen = Spread(np.sqrt(1.0 - told)[:, None], back @ Q.T @ (seen.sd * doubt)[:, None])
    return Fit(
        space=statics.space,
        time=splines,
        c=statics.space.tied(root @ (Q.T @ z).T @ back.T),
        noise=seen.noise,
        misfit=float(np.sqrt(np.mean(rest[seen.valid] ** 2) / freedom)),
        held_out=seen.sd,
        roots=(root,),
        spread=spread,
        smoothing=Smoothing.none(len(told)),
        response=spread,
        doubt=(unseen,),
    )
