"""Plates that may stand elsewhere than their recorded poses tell, and what that changes of a simulation.

A recorded pose may be off by a constant, as that of a robot which was not calibrated, and by a share of the
way, as of one that gives way. Where its stream states how much (``Stream.noise``), either is one more error
that simulations have.
"""

from dataclasses import replace

import numpy as np

from form_drake.diagnose.columns import changed
from form_drake.diagnose.model import Model, Scenes
from form_drake.identify.problem import Problem
from form_drake.motion import body
from form_drake.records import Recording

Elsewhere = tuple[int, Recording]  # which of several recordings, and what it would be


def elsewhere(recording: Recording) -> list[Recording]:
    """The recording with a plate one standard deviation off, in each of the ways that it may be.

    One that is frictionless holds the body where it stands, along its normal; one that is bonded took it
    where it stood at first.
    """
    ways: dict[str, list[np.ndarray]] = {}
    for face in body(recording).faces:
        pose = recording.poses.get(face.tool)
        if pose is None or not pose.noise:
            continue
        p_WT = pose.value[:, :3, 3]
        far = float(np.linalg.norm(p_WT - p_WT[0], axis=1).max())
        own = ways.setdefault(face.tool, [p_WT - p_WT[0]] if far > 0.0 else [])
        if face.condition == "frictionless":
            own.append(np.broadcast_to(face.normal, p_WT.shape))
    return [_shifted(recording, tool, one) for tool, own in ways.items() for one in own]


def _shifted(recording: Recording, tool: str, way: np.ndarray) -> Recording:
    """With a tool that goes so much further, as much as its noise at most."""
    pose = recording.poses[tool]
    assert pose.noise is not None
    value = pose.value.copy()
    value[:, :3, 3] += way * (pose.noise / np.linalg.norm(way, axis=1).max())
    return replace(recording, poses={**recording.poses, tool: replace(pose, value=value)})


def simulated(scenes: Scenes, model: Model) -> list[Elsewhere]:
    """Scenes with a plate off by one standard deviation, on the coarser grid, under the poses that are told.

    Raises:
        ValueError: a simulation fails.
    """
    every = [(n, one) for n, own in enumerate(scenes.recordings) for one in elsewhere(own)]
    if not every:
        return []
    which, moved = zip(*every, strict=True)
    others = replace(scenes.only(which), recordings=moved)
    made = others.rough.rolled(model)
    poses = (scenes.recordings[n].poses for n in which)
    told = (replace(one, poses=own) for one, own in zip(made, poses, strict=True))
    return list(zip(which, told, strict=True))


def plate_errors(problem: Problem, twin: Problem, scenes: Scenes, model: Model) -> np.ndarray:
    """What plates that are off change of the rows of a twin, shape [rows, ways].

    Raises:
        ValueError: a simulation fails, or cannot be read.
    """
    made = simulated(scenes, model)
    columns = [changed(problem, twin, scenes, model, [n], [one]) for n, one in made]
    rows = sum(int(p.keep.sum()) for p in problem.probes)
    return np.reshape(columns, (len(columns), rows)).T
