"""The motion of a whole body from points on its surface, with the covariance of what is not seen."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from form_drake.interior.faces import Hold, holds
from form_drake.interior.knots import chosen_cells
from form_drake.motion import Body
from form_drake.motion.drift import centred
from form_drake.motion.space import Space, Symmetry
from form_drake.motion.tracks import noise_of, tracks
from form_drake.records import Recording

SQUARE = 1e-6  # share by which sides of a box may differ that are the same


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
        one_sided: mirrored axes of whose two faces one is seen.
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
    one_sided: tuple[int, ...]

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
        symmetry = _stated(recording, body)
        one_sided = _one_sided(recording, symmetry)
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
            one_sided=tuple(a for a in one_sided if a in symmetry.mirrors),
        )

    def undrifted(self, white: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """Whitened displacements less what they share with a drift of the body along mirrored axes.

        A body keeps its symmetry about a centre that moves, and one face tells a drift hardly from a bulge:
        nothing is concluded from what either could have made.

        Args:
            white: of the seen points, shape [points, 3, n].
            valid: which points are seen, shape [all points].
        """
        drift = self.whitening[valid][:, :, list(self.space.symmetry.mirrors)].reshape(
            white[..., 0].size, -1
        )
        Q, flat = np.linalg.qr(drift)[0], white.reshape(len(drift), -1)
        return np.asarray(flat - Q @ (Q.T @ flat)).reshape(white.shape)

    @cached_property
    def white(self) -> np.ndarray:
        """Whitened displacements [m], shape of u."""
        return np.einsum("pij,fpj->fpi", self.whitening, self.u, optimize=True)


def _stated(recording: Recording, body: Body) -> Symmetry:
    """The symmetry that a recording states, refused where its box has not got it."""
    symmetry = Symmetry.stated(str(recording.geometry.get("symmetry", "")))
    if axes := list(symmetry.exchange):
        a, b = (body.high - body.low)[axes]
        if abs(a / b - 1.0) > SQUARE:
            names = "".join("xyz"[axis] for axis in axes)
            raise ValueError(
                f"symmetry {names}: the box is {a:.6g} m along {names[0]} and {b:.6g} m along {names[1]}; axes"
                f" change places where both are the same: leave {names} out of the stated symmetry"
            )
    return symmetry


def _one_sided(recording: Recording, symmetry: Symmetry) -> list[int]:
    """Axes of whose two faces one is seen; refused where it is not stated that the other is as that."""
    seen = set() if recording.face is None else {int(f) for f in recording.face}
    alone = [face for face in sorted(seen) if face ^ 1 not in seen]
    for face in alone:
        if face // 2 not in symmetry.mirrors:
            axis = "xyz"[face // 2]
            raise ValueError(
                f"face {axis}{'-+'[face % 2]} is seen and {axis}{'+-'[face % 2]} is not: track that as well,"
                f' or state in the geometry that the motion is mirrored, as "symmetry": "{axis}"'
            )
    return [face // 2 for face in alone]


def _whitening(recording: Recording, used: np.ndarray, noise: float) -> np.ndarray:
    """As of ``Seen``, for the points ``used`` [points]; without their covariance, errors are alike."""
    if recording.covariance is None or noise <= 0.0:
        return np.tile(np.eye(3), (int(used.sum()), 1, 1))
    size, axes = np.linalg.eigh(recording.covariance[used])
    return np.asarray((axes * (noise / np.sqrt(size))[:, None]) @ axes.swapaxes(1, 2))
