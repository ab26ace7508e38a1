"""What rigid tools and supports say of the faces that they hold."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from form_drake.interior.rub import Rub
from form_drake.interior.statics import EXACT, Grip, Rows, Statics
from form_drake.motion import Body, Face
from form_drake.motion.poses import Poses
from form_drake.records import Recording
from form_drake.weak.force import pressed

POINTS = 10  # along each side of a face
TINY = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class Hold:
    """A face and the tool that holds it, in every frame.

    Attributes:
        face: of the body.
        moved: where the tool carries points of the face [m], shape [frames, points, 3]; None: not known,
            as while a tool comes nearer before it touches.
        turned: what turns of the tool about the middle of the face add to that, shape [frames, points, 3].
        presses: whether it holds the face at all, shape [frames].
    """

    face: Face
    moved: np.ndarray | None
    turned: np.ndarray
    presses: np.ndarray

    def at(self, frames: np.ndarray) -> "Hold":
        """In some of the frames, by their indices."""
        moved = None if self.moved is None else self.moved[frames]
        turned, presses = self.turned[frames], self.presses[frames]
        return replace(self, moved=moved, turned=turned, presses=presses)

    def grip(self, statics: Statics, friction: float) -> Callable[[int], Grip | None]:
        """What it does in a frame; None while it does not press.

        A tool that presses keeps its face as it is but for rigid displacements: how it has moved is not
        taken from its pose, which is known less well than the points, and so its push is free.

        Args:
            statics: of the body.
            friction: coefficient of a bonded face; infinite: it sticks.
        """
        X = statics.body.face_points(self.face, POINTS)
        bonded, axis = self.face.condition == "bonded", self.face.axis
        axes = [0, 1, 2] if bonded and np.isinf(friction) else [axis]
        every = statics.values(X)
        D = every[:, axes]
        flat = D.reshape(-1, D.shape[-1])
        pushes = np.zeros((flat.shape[1], 0))
        targets = np.zeros((len(self.presses), len(flat)))
        if self.moved is None:
            U = _spanned(_rigid(X)[:, axes].reshape(len(flat), -1))
            pushes = _spanned(flat.T @ U)
            flat = flat - U @ (U.T @ flat)
        else:
            targets = self.moved[..., axes].reshape(len(self.moved), -1)
        whole, rub = flat.T @ flat / EXACT**2, None
        if bonded and 0.0 < friction < np.inf:
            along = every[:, [a for a in range(3) if a != axis]]
            inward = (1.0 - 2.0 * self.face.side) * every[:, axis]
            rub = Rub(self.face.index, along, inward, friction)

        def grip(n: int) -> Grip | None:
            rows = Rows(whole, flat.T @ targets[n] / EXACT**2)
            return Grip(rows, pushes, rub) if self.presses[n] else None

        return grip


def _spanned(A: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span those of a matrix."""
    U, S, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, S > TINY * S[0]])


def _rigid(X: np.ndarray) -> np.ndarray:
    """Displacements of points [m] that are translated or turned a little, shape [points, 3, 6]."""
    turned = np.cross(np.eye(3), (X - X.mean(axis=0))[:, None]).swapaxes(1, 2)
    return np.concatenate([np.tile(np.eye(3), (len(X), 1, 1)), turned / np.ptp(X)], axis=2)


def holds(recording: Recording, body: Body) -> list[Hold]:
    """The faces that tools and supports hold: bonded ones, and those that slide on a plane."""
    found = []
    for face in body.faces:
        if face.condition not in ("bonded", "frictionless"):
            continue
        X = body.face_points(face, POINTS)
        moved = carried(recording, face.tool, X)
        turned = moved - moved.mean(axis=1, keepdims=True)
        if face.tool in recording.forces:
            found.append(Hold(face, None, turned, pressed(recording, face.tool)))
        else:
            always = np.ones(recording.frames, dtype=bool)
            found.append(Hold(face, moved, turned, always))
    return found


def carried(recording: Recording, tool: str, X: np.ndarray) -> np.ndarray:
    """Displacements of points that a tool carries from the first frame on [m], shape [frames, points, 3]."""
    stream = recording.poses.get(tool)
    if stream is None:
        return np.zeros((recording.frames, *X.shape))
    X_WT = Poses(stream).at(recording.time)
    first = np.linalg.inv(X_WT[0])
    p_TX = X @ first[:3, :3].T + first[:3, 3]
    return np.asarray(p_TX @ X_WT[:, :3, :3].swapaxes(1, 2) + X_WT[:, None, :3, 3] - X)
