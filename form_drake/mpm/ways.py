"""How the planes that hold faces of a block go, with their tools."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from form_drake.motion import Body, Face
from form_drake.motion.poses import Poses
from form_drake.mpm.tools import Motions
from form_drake.records import Recording

# places [m] and orientations, shapes [times, 3] and [times, 3, 3]
Way = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Path:
    """How the plane of a face moves with its tool.

    Attributes:
        tool: its name; "" where it stands still.
        face: middle of the face of the body in its rest shape [m], shape [3].
        p: place of the middle of the plane in the tool's frame [m], shape [3].
        R: from the plane's frame, whose z points out of the tool, to the tool's, shape [3, 3].
        poses: of the tool by time from the first frame on [s]; None: it stands still.
    """

    tool: str
    face: np.ndarray
    p: np.ndarray
    R: np.ndarray
    poses: Poses | None

    @classmethod
    def of(cls, recording: Recording, shape: Body, face: Face) -> "Path":
        ends = (shape.low, shape.high)
        middle = 0.5 * (shape.low + shape.high)
        middle[face.axis] = ends[face.side][face.axis]
        inward = np.zeros(3)
        inward[face.axis] = -1.0 if face.side else 1.0
        across = np.eye(3)[(face.axis + 1) % 3]
        R = np.stack([across, np.cross(inward, across), inward], axis=1)
        pose = recording.poses.get(face.tool)
        if pose is None:
            return cls(face.tool, middle, middle, R, None)
        poses = Poses(replace(pose, time=pose.time - recording.time[0]))
        (first,) = poses.at(np.zeros(1))
        p = first[:3, :3].T @ (middle - first[:3, 3])
        if face.condition != "bonded":  # its plane holds the tool's origin
            p[...] -= (first[:3, :3].T @ inward) * (inward @ (middle - first[:3, 3]))
        return cls(face.tool, middle, p, first[:3, :3].T @ R, poses)

    def coming(self, share: np.ndarray) -> Way:
        """The same on the way from the rest shape to where it begins, at shares of that way."""
        p, R = self.at(np.zeros(len(share)))
        return self.face + share[:, None] * (p - self.face), R

    def at(self, time: np.ndarray) -> Way:
        """Places [m] and orientations of the plane, shapes [times, 3] and [times, 3, 3]."""
        if self.poses is None:
            shape = (len(time), 1)
            return np.tile(self.p, shape), np.tile(self.R, (*shape, 1))
        X = self.poses.at(time)
        return X[:, :3, 3] + X[:, :3, :3] @ self.p, X[:, :3, :3] @ self.R


def require_apart(paths: Sequence[Path], time: np.ndarray) -> None:
    """Refuse planes of one axis that meet at times [s] from the first frame on.

    Raises:
        ValueError: two do.
    """
    ways = [path.at(time) for path in paths]
    for (one, (p, R)), (other, (q, S)) in combinations(zip(paths, ways, strict=True), 2):
        facing = R[0, :, 2] @ S[0, :, 2] < -0.5
        left = np.sum((q - p) * R[:, :, 2], axis=1)  # between them [m]
        if facing and np.any(left <= 0.0):
            names = " and ".join(path.tool or "the support" for path in (one, other))
            raise ValueError(
                f"{names} meet {time[np.argmax(left <= 0.0)]:.3g} s after the first frame, where the body"
                " should be between them: check the poses and their units [m]"
            )


def followed(way: Way, steps: np.ndarray) -> Way:
    """Corners of a way that goes straight for every step [s] and is the curve on average.

    A body cannot follow the corners: it would see chords, that lie inside of the curve by a twelfth of
    its second differences.
    """
    p, R = way
    before, after = steps[:-1, None], steps[1:, None]
    bend = 2.0 * np.diff(np.diff(p, axis=0) / steps[:, None], axis=0) / (before + after)
    return np.concatenate([p[:1], p[1:-1] - before * after * bend / 12.0, p[-1:]]), R


def motions_of(ways: Sequence[Way], steps: np.ndarray) -> list[Motions]:
    """Places of planes at all times but the last, and velocities that lead to where they are next."""
    p, R = (np.stack(a, axis=1) for a in zip(*ways, strict=True))
    over = np.maximum(steps, 1e-300)[:, None, None]
    turns = (R[1:] @ R[:-1].swapaxes(-1, -2)).reshape(-1, 3, 3)
    w = Rotation.from_matrix(turns).as_rotvec().reshape(p[1:].shape) / over
    return [Motions(*a) for a in zip(p[:-1], R[:-1], np.diff(p, axis=0) / over, w, strict=True)]
