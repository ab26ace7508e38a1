"""Rows that tell how tools hold the body: none of them is a balance.

They make sense beside those of a twin, read in the same way. Stresses do not enter.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from form_drake.motion import Body, Face, Motion
from form_drake.records import Recording
from form_drake.weak.fields import Fields, Sampled
from form_drake.weak.windows import Windows

GRID = 6  # points along each edge of a face
OPEN = 5e-5  # [m] off the rest plane, from which nothing may touch,
SURE = 3.0  # and standard deviations of where the tool is
STIFFNESS = 1.0  # [N/m], by which a displacement has the unit of the other rows


@dataclass(frozen=True)
class HeldFields:
    """Displacements of bonded faces: means, slopes and bends over every face, along every axis.

    Args:
        points: on the faces [m], shape [points, 3].
        weights: of the displacements of the points, shape [fields, points, 3].
        names: of the fields.
    """

    points: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)
    names: tuple[str, ...] = field(repr=False)
    material: bool = True
    fixed: bool = True
    tools: tuple[str, ...] = ()

    @classmethod
    def of(cls, body: Body) -> "HeldFields | None":
        """Of the bonded faces of a body; None: it has none."""
        faces = [f for f in body.faces if f.condition == "bonded"]
        if not faces:
            return None
        points = [body.face_points(f, GRID) for f in faces]
        weights, names = [], []
        for n, face in enumerate(faces):
            for label, mode in _modes(body, face, points[n]).items():
                for d in range(3):
                    one = np.zeros((len(faces), GRID**2, 3))
                    one[n, :, d] = mode / GRID**2
                    weights.append(one.reshape(-1, 3))
                    names.append(f"{'xyz'[d]} {label} of {'xyz'[face.axis]}{'-+'[face.side]}")
        return cls(np.concatenate(points), np.array(weights), tuple(names))

    @property
    def breaks(self) -> tuple[np.ndarray, ...]:
        return ()

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        return {}

    def at(self, motion: Motion) -> Sampled:
        value = np.zeros((len(self.names), len(motion.X), 3))
        value[:, len(motion.X) - len(self.points) :] = self.weights
        shape = (len(motion.time), *value.shape)
        return Sampled(np.broadcast_to(value, shape), np.broadcast_to(0.0, (*shape, 3)))

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.names), dtype=bool)


def _modes(body: Body, face: Face, points: np.ndarray) -> dict[str, np.ndarray]:
    """Functions on a face, by name, each of about unit size, shape [points]."""
    scaled = 2.0 * (points - body.low) / (body.high - body.low) - 1.0
    a, b = np.delete(scaled, face.axis, axis=1).T
    return {"mean": np.ones(len(a)), "slope 1": a, "slope 2": b, "bend": a**2 + b**2 - 2.0 / 3.0}


@dataclass(frozen=True)
class OpenFields:
    """Force that tools should not feel: across frictionless faces, and any where they are off the body.

    Args:
        time: [s], shape [times].
        tools: that of every field.
        axes: along which it should feel none.
        open: whether it should feel none, shape [fields, times].
        names: of the fields.
    """

    time: np.ndarray = field(repr=False)
    tools: tuple[str, ...]
    axes: tuple[int, ...]
    open: np.ndarray = field(repr=False)
    names: tuple[str, ...]
    material: bool = True
    fixed: bool = True

    @classmethod
    def of(cls, recording: Recording, body: Body) -> "OpenFields | None":
        """Of the frictionless tools whose force and pose are measured; None: there are none."""
        time = recording.time - recording.time[0]
        found = []
        for face in body.faces:
            tool = face.tool
            known = tool in recording.forces and tool in recording.poses
            if face.condition != "frictionless" or not known:
                continue
            pose = recording.poses[tool]
            plane = (body.low, body.high)[face.side][face.axis]
            place = np.asarray(pose.value)[:, face.axis, 3]
            away = (2 * face.side - 1) * (place - plane) > OPEN + SURE * (pose.noise or 0.0)
            off = np.interp(time, pose.time - recording.time[0], away.astype(float)) == 1.0
            for axis in range(3):
                if axis != face.axis:
                    found.append(
                        (tool, axis, np.ones(len(time), bool), f"across {tool} {'xyz'[axis]}")
                    )
            if off.any():
                found.append((tool, face.axis, off, f"off {tool}"))
        if not found:
            return None
        tools, axes, open_, names = zip(*found, strict=True)
        return cls(time, tools, axes, np.array(open_), names)

    @property
    def breaks(self) -> tuple[np.ndarray, ...]:
        return ()

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        found = {t: np.zeros((len(motion.time), len(self.names), 3)) for t in self.tools}
        alone = self.alone(motion.time)
        for n, (tool, axis) in enumerate(zip(self.tools, self.axes, strict=True)):
            found[tool][:, n, axis] = alone[:, n]
        return found

    def alone(self, time: np.ndarray) -> np.ndarray:
        """Whether each field is open at times of a grid [s], shape [grid, fields]."""
        nearest = np.abs(time[:, None] - self.time).argmin(axis=1)
        return self.open.T[nearest]

    def at(self, motion: Motion) -> Sampled:
        shape = (len(motion.time), len(self.names), len(motion.X), 3)
        return Sampled(np.broadcast_to(0.0, shape), np.broadcast_to(0.0, (*shape, 3)))

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.names), dtype=bool)


def tests(fields: Sequence[Fields], windows: Windows) -> np.ndarray:
    """Which rows are those of a balance, shape [windows * fields]."""
    return _rows(fields, windows, lambda f: not isinstance(f, HeldFields | OpenFields))


def held(fields: Sequence[Fields], windows: Windows) -> np.ndarray:
    """Which rows tell how far held faces have gone, shape [windows * fields]."""
    return _rows(fields, windows, lambda f: isinstance(f, HeldFields))


def seeing(fields: Sequence[Fields], windows: Windows) -> np.ndarray:
    """Which rows see anything: windows in which a tool is never off say nothing of that."""

    def sees(f: Fields) -> bool | np.ndarray:
        if not isinstance(f, OpenFields):
            return True
        return np.asarray(windows.chi @ f.alone(windows.time).astype(float) > 0.0)

    return _rows(fields, windows, sees)


def _rows(
    fields: Sequence[Fields], windows: Windows, of: Callable[[Fields], bool | np.ndarray]
) -> np.ndarray:
    parts = [np.broadcast_to(np.asarray(of(f)), (len(windows), len(f.names))) for f in fields]
    return np.concatenate(parts, axis=1).ravel()
