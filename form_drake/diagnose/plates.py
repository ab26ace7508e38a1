"""Plates that may stand elsewhere than their recorded poses tell, and what that changes of a simulation.

A recorded pose may be off by a constant, as that of a robot which was not calibrated, and by a share of the
way, as of one that gives way. Where its stream states how much (``Stream.noise``), either is one more error
that simulations have; what they have wrong of a contact looks the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from form_drake.diagnose.columns import changed
from form_drake.diagnose.model import Model, Scenes
from form_drake.identify.problem import Problem
from form_drake.motion import body
from form_drake.motion.poses import Poses
from form_drake.mpm.ways import Path
from form_drake.records import Recording

STILL = 1e-6  # [m], which a tool that stands still may go
MOST = 0.1  # of a body's least edge, by which plates may be off


@dataclass(frozen=True)
class Elsewhere:
    """What a recording would be with a plate one standard deviation off.

    Attributes:
        of: which of several recordings.
        recording: simulated.
    """

    of: int
    recording: Recording


def require_placed(recording: Recording) -> None:
    """Refuse plates of which hardly anything is known, and those that never touch.

    Raises:
        ValueError: poses state that they are off by more than a tenth of the body's least edge, or a
            frictionless tool stays farther than that from the face on which it feels a force.
    """
    shape, time = body(recording), recording.time - recording.time[0]
    most = MOST * float(np.min(shape.high - shape.low))
    for name, pose in recording.poses.items():
        if pose.noise and pose.noise > most:
            raise ValueError(
                f"poses of {name} may be {pose.noise:.3g} m off, as they state (Stream.noise): up to"
                f" {most:.3g} m, a tenth of the body's least edge, can be reckoned with"
            )
    for face in shape.faces:
        if face.condition == "frictionless" and face.tool in recording.forces:
            path = Path.of(recording, shape, face)
            away = float(((path.at(time)[0] - path.face) @ face.normal).min())
            if away > most:
                raise ValueError(
                    f"{face.tool} stays {away:.3g} m off {face.name} and more, on which it is said to press:"
                    " its plane goes through the origin of its poses; are these of another frame of the tool,"
                    " or is the face free?"
                )


def elsewhere(recording: Recording, least: float = 0.0) -> list[Recording]:
    """The recording with a plate one standard deviation off, in each of the ways that it may be.

    That is as much as its poses state, and at least ``least`` [m].

    One that is frictionless holds the body where it stands, along its normal; one that is bonded took it
    where it stood at the first frame. None goes more than twice as far as it is said to.
    """
    ends, found = recording.time[[0, -1]], {}
    for face in body(recording).faces:
        pose = recording.poses.get(face.tool)
        if pose is None or not (off := max(pose.noise or 0.0, least)):
            continue
        p_WT = pose.value[:, :3, 3]
        way = p_WT - Poses(pose).at(ends[:1])[0, :3, 3]
        among = (pose.time >= ends[0]) & (pose.time <= ends[1])
        far = float(np.linalg.norm(way[among], axis=1).max(initial=0.0))
        if far > STILL:
            found[face.tool, "way"] = way * min(off / far, 1.0)
        if face.condition == "frictionless":
            normal = np.eye(3)[face.axis]
            found[face.tool, "xyz"[face.axis]] = np.tile(off * normal, (len(p_WT), 1))
    return [_shifted(recording, tool, by) for (tool, _), by in found.items()]


def _shifted(recording: Recording, tool: str, by: np.ndarray) -> Recording:
    pose = recording.poses[tool]
    value = pose.value.copy()
    value[:, :3, 3] += by
    return replace(recording, poses={**recording.poses, tool: replace(pose, value=value)})


def simulated(scenes: Scenes, model: Model, gives: float = 0.0) -> list[Elsewhere]:
    """Scenes with a plate off by one standard deviation, on the coarser grid, under the poses that are told.

    Args:
        scenes: of the recordings.
        model: to simulate with.
        gives: of the grid spacing, that any plate may be off by.

    Raises:
        ValueError: a simulation fails.
    """
    own = enumerate(zip(scenes.recordings, scenes.dx, strict=True))
    every = [(n, one) for n, (seen, dx) in own for one in elsewhere(seen, gives * dx)]
    if not every:
        return []
    which, moved = zip(*every, strict=True)
    try:
        made = replace(scenes.only(which), recordings=moved).rough.rolled(model)
    except ValueError as error:
        raise ValueError(f"with plates as far off as they may be, {error}") from None
    poses = (scenes.recordings[n].poses for n in which)
    told = (replace(one, poses=own) for one, own in zip(made, poses, strict=True))
    return [Elsewhere(*pair) for pair in zip(which, told, strict=True)]


def plate_errors(
    problem: Problem, twin: Problem, scenes: Scenes, model: Model, made: Sequence[Elsewhere]
) -> np.ndarray:
    """What plates that are off change of the rows of a twin, shape [rows, ways].

    Args:
        problem: probes of the data.
        twin: the same of the simulation.
        scenes: of all of them.
        model: of the simulation.
        made: by ``simulated``.

    Raises:
        ValueError: a simulation cannot be read.
    """
    columns = [changed(problem, twin, scenes, model, [e.of], [e.recording]) for e in made]
    rows = sum(int(p.keep.sum()) for p in problem.probes)
    return np.reshape(columns, (len(columns), rows)).T
