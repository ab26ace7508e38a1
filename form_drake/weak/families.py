"""Test fields that the faces of a body admit, by name or by choice."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from form_drake.motion import Body, Face, Fit, Sampling
from form_drake.motion.poses import Poses
from form_drake.records import Recording
from form_drake.weak.axial import AxialFields
from form_drake.weak.bend import BendFields
from form_drake.weak.bend_curl import BendCurlFields
from form_drake.weak.choice import MOST_ROWS, bent
from form_drake.weak.curl import CurlFields
from form_drake.weak.fields import BoxFields, Fields
from form_drake.weak.force import pressed
from form_drake.weak.grid import DEGREE, grid_fields
from form_drake.weak.reach import usable
from form_drake.weak.unknowns import Unknowns

BENT: dict[str, type[BendFields] | type[BendCurlFields]] = {
    "bend": BendFields,
    "bend-curl": BendCurlFields,
}
NAMES = ("box", "axial", *BENT, "grid", "potential")
BESIDE = 0.05  # of a strip's length, kept clear beside the pusher's centre
CELLS_ALONG = 8  # quadrature cells along a strip
# ramps as shares of what the pusher leaves: a single wide one hears a strip that rings least, and ends
# where the held end lets sections be free of stress across
BENDS = ((0.0, 0.95),)
RAMPS = ((0.0, 0.9), (0.05, 0.95), (0.1, 1.0))
CELLS = (4.5, 6.0, 8.0, 12.0)  # of a spatial grid along each axis of the body


def chosen_fields(
    wanted: Sequence[str | Fields],
    recording: Recording,
    shape: Body,
    fit: Fit,
    ends: np.ndarray,
    unknowns: Unknowns,
) -> tuple[Fields, ...]:
    """The named families, those given, or those that the faces of the body admit.

    Raises:
        ValueError: an unknown name, or a family that this body has not.
    """
    if not wanted:
        if unknowns.shears and axial(recording, shape, fit):
            wanted = ("axial",)
        else:
            wanted = ("potential",) if unknowns.pressure == "free" else ("box",)
        if bent(recording, shape):
            wanted = ("bend",)
    found: list[Fields] = []
    for name in wanted:
        if not isinstance(name, str):
            found.append(name)
            continue
        if name not in NAMES:
            raise ValueError(f"test fields {name!r}: choose from {', '.join(NAMES)}")
        family: Sequence[Fields]
        if name == "box":
            family = _box(recording, shape, ends)
        elif name == "axial":
            family = axial(recording, shape, fit)
        elif name in BENT:
            family = bend(recording, shape, BENT[name])
        elif name == "potential":
            family = [CurlFields.of(shape)]
        else:
            family = _grid(recording, shape, fit, ends)
        if not family or not sum(len(f.names) for f in family):
            raise ValueError(
                f"no {name} test fields: they need {_needs(name)}; the faces are stated as"
                f" {dict(recording.contact) or 'nothing'}"
            )
        found.extend(family)
    return tuple(found)


def _box(recording: Recording, shape: Body, ends: np.ndarray) -> list[Fields]:
    """Two elements along each axis, or one where that gives too many rows."""
    measured = frozenset(recording.forces)
    fine = BoxFields.of(shape, measured)
    width = float(ends[0, 1] - ends[0, 0])
    apart = (ends[-1, 0] - ends[0, 0]) / width * len(fine.names)
    return [fine if apart <= MOST_ROWS else BoxFields.of(shape, measured, spans=1)]


def _needs(name: str) -> str:
    if name == "axial":
        return "a face with a measured tool, and a free pair of faces across its axis"
    if name in BENT:
        return "a touched face whose tool has a force and poses, and a bonded end"
    return "room inside the body that no unknown force reaches"


def axial(recording: Recording, shape: Body, fit: Fit) -> list[Fields]:
    """Axial fields of every loaded axis whose lateral faces are free."""
    found: list[Fields] = []
    faces = {(f.axis, f.side): f for f in shape.faces}
    for face in shape.faces:
        if face.tool not in recording.forces or face.condition not in ("bonded", "frictionless"):
            continue
        laterals = [
            a
            for a in range(3)
            if a != face.axis and faces[a, 0].condition == faces[a, 1].condition == "free"
        ]
        opposite = faces[face.axis, 1 - face.side]
        if not laterals or opposite.condition in ("free", "touched"):
            continue
        shares = [np.eye(3)[a] for a in laterals]
        if set(laterals) == set(
            fit.space.symmetry.exchange
        ):  # else every row would stand there twice
            shares = [np.mean(shares, axis=0)]
        time, low = _mean_face(recording, shape, fit, opposite)
        _, high = _mean_face(recording, shape, fit, face)
        found.append(
            AxialFields(
                axis=face.axis,
                origin=0.5 * (shape.low + shape.high),
                time=time,
                start=low,
                length=np.abs(high - low),
                lateral=np.array(shares),
                ramps=RAMPS,
                sign=1 if face.side else -1,
                tool=face.tool,
                breaks=tuple(
                    np.linspace(a, z, 4 if n == face.axis else 2)
                    for n, (a, z) in enumerate(zip(shape.low, shape.high, strict=True))
                ),
            )
        )
    return found


def bend(
    recording: Recording, shape: Body, kind: type[BendFields] | type[BendCurlFields] = BendFields
) -> list[Fields]:
    """Bending fields of a strip with one bonded end that a tool with known poses pushes sideways."""
    found: list[Fields] = []
    bonded = [f for f in shape.faces if f.condition == "bonded"]
    for face in shape.faces:
        held = [f for f in bonded if f.axis != face.axis]
        measured = face.tool in recording.forces and face.tool in recording.poses
        if face.condition != "touched" or not measured or not held:
            continue
        axis, side = held[0].axis, held[0].side
        ends, length = (shape.low, shape.high), shape.high[axis] - shape.low[axis]
        reach = (
            _pushed(recording, face.tool, axis, ends[1 - side][axis], 1 if side else -1) / length
        )
        reach = max(reach, 0.0) + BESIDE
        ramps = tuple((reach + (1.0 - reach) * lo, reach + (1.0 - reach) * hi) for lo, hi in BENDS)
        breaks = [np.array([a, z]) for a, z in zip(*ends, strict=True)]
        breaks[axis] = np.linspace(ends[0][axis], ends[1][axis], CELLS_ALONG + 1)
        found.append(
            kind(
                axis=axis,
                push=face.axis,
                middle=float(0.5 * (shape.low + shape.high)[face.axis]),
                held=float(ends[side][axis]),
                length=float(length),
                sign=1 if side else -1,
                ramps=ramps,
                tool=face.tool,
                breaks=tuple(breaks),
            )
        )
    return found


def _pushed(recording: Recording, tool: str, axis: int, free: float, sign: int) -> float:
    """How far from the free end of a strip a tool pushes at most [m]; below zero it is beyond."""
    pose = Poses(recording.poses[tool]).at(recording.time)[:, axis, 3]
    pushes = pressed(recording, tool)
    return float(np.max(sign * (pose[pushes] if pushes.any() else pose) - sign * free))


def _mean_face(
    recording: Recording, shape: Body, fit: Fit, face: Face
) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and the position of a face along its axis [m], shape [times]."""
    X = shape.face_points(face)
    time = np.linspace(0.0, recording.time[-1] - recording.time[0], 2 * recording.frames)
    x = Sampling.of(fit, time, X, np.ones(len(X)), 1.0).motion(fit.c).x
    return time, x[:, :, face.axis].mean(axis=1)


def _grid(recording: Recording, shape: Body, fit: Fit, ends: np.ndarray) -> list[Fields]:
    """The widest grid with rows in half of the windows, cut down to the fields ever usable."""
    corners = np.stack(np.meshgrid(*zip(shape.low, shape.high, strict=True), indexing="ij"), -1)
    X = corners.reshape(-1, 3)
    time = np.linspace(0.0, recording.time[-1] - recording.time[0], 24)
    x = Sampling.of(fit, time, X, np.ones(len(X)), 1.0).motion(fit.c).x.reshape(-1, 3)
    for cells in CELLS:
        spacing = (shape.high - shape.low) / cells
        beyond = 0.5 * (DEGREE + 1) * spacing  # of free faces, where fields need not vanish
        low, high = (
            end
            + side * beyond * [f.condition == "free" for f in shape.faces if f.side == (side > 0)]
            for end, side in ((x.min(axis=0), -1), (x.max(axis=0), 1))
        )
        breaks = tuple(
            np.linspace(a, z, int(np.ceil(0.5 * cells)) + 1)
            for a, z in zip(shape.low, shape.high, strict=True)
        )
        grid = grid_fields(low, high, spacing, breaks)
        try:
            rows = usable(shape, fit, [grid], ends).reshape(len(ends), -1)
        except ValueError:
            continue
        if rows.any(axis=1).mean() >= 0.5:
            ever = rows.any(axis=0).reshape(-1, 3).any(axis=1)
            return [replace(grid, centres=grid.centres[ever])]
    return []
