"""A recorded probe again with another material: the tool goes where it went, or pushes as it pushed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydrake.math import RigidTransform
from pydrake.trajectories import PiecewisePose
from scipy.spatial import cKDTree

from form_drake.control import ForceServo
from form_drake.effects import CATALOGUE, Effect
from form_drake.effects.acting import known, sensed
from form_drake.laws import law_named
from form_drake.material import Material
from form_drake.mpm.exchange import Snapshot
from form_drake.mpm.tools import Motions
from form_drake.records import Recording, Stream
from form_drake.systems.scenario import Scenario
from form_drake.systems.station import Station, make_station
from form_drake.systems.touching import body_name

Drive = Literal["pose", "force"]
NEAR = 0.25  # of the particles' distance, within which a tracked point is a particle


@dataclass(frozen=True)
class Replay:
    """A predicted probe beside the measured one.

    Attributes:
        recording: the measured one with points, pose and force replaced by the predicted ones.
        shape_rms: root mean square distance of the points [m].
        force_rms: root mean square of the force's error as a share of the largest measured force; not a
            number where none was measured.
        peak_error: error of the largest force as a share of it, likewise.
    """

    recording: Recording
    shape_rms: float
    force_rms: float
    peak_error: float


def replay(
    scenario: Scenario,
    material: Material,
    recording: Recording,
    *,
    drive: Drive = "pose",
    effects: Mapping[str, Effect] = CATALOGUE,
    progress: Callable[[int, int], None] | None = None,
) -> Replay:
    """Simulate a recorded probe with a material, without the arm.

    Args:
        scenario: of the recording: specimen, tools, solver. Its material is not looked at.
        material: of the prediction.
        recording: whose tool poses, or forces, are applied.
        drive: ``pose`` moves the tool as recorded; ``force`` along its recorded path, as deep as
            the recorded force pushes it.
        effects: of which the material may name some, by id.
        progress: called with (steps done, steps).

    Raises:
        ValueError: the recording is not of this scenario, or lacks poses or forces of its tool; or a
            force drives that sensors with effects have told.
    """
    acting = known(material.effects, material.law, effects)
    told = {one.effect.id: sensed(recording, [one]).forces for one in acting}
    wrong = [name for name, forces in told.items() if forces is not recording.forces]
    if drive == "force" and wrong:
        raise ValueError(
            f"drive force: with {', '.join(wrong)} the recorded force is not what acted; choose pose"
        )
    start = None if recording.joints is None else recording.joints.value[0]
    station = make_station(scenario, start=start, material=material, effects=effects)
    tool = body_name(station.plant, station.tool.body())
    for name, streams in (("poses", recording.poses), ("force", recording.forces)):
        if tool not in streams:
            raise ValueError(f"the recording holds no {name} of {tool}, the scenario's tool")
    points = _particles(station, recording)
    period = scenario.solver.period
    path = _Path(station, recording, tool, period, drive)
    scene, solver = station.material.scene, scenario.solver
    last = round(float(recording.time[-1]) / period)
    wanted = {round(float(t) / period) for t in recording.time}
    snapshot, frames, forces, poses = scene.start(), [], [], []
    for k in range(last + 1):
        if k in wanted:
            frames.append(snapshot.p_WQ[points])
        if k == last:
            poses.append(path.at(k * period).GetAsMatrix4())
            break
        motions, X_WT = path.step(k * period, snapshot)
        damping = solver.damping if k * period < solver.settle else 0.0
        snapshot = scene.advance(snapshot, motions, period, damping)
        forces.append(path.force(snapshot))
        poses.append(X_WT.GetAsMatrix4())
        if progress is not None:
            progress(k + 1, last)
    begin = period * np.arange(len(forces))
    predicted = replace(
        recording,
        p_WQ=np.array(frames),
        valid=None,
        noise=None,
        poses={tool: Stream(np.append(begin, period * last), np.array(poses))},
        forces={tool: Stream(begin + 0.5 * period, np.array(forces))},
        source="prediction",
    )
    return _compared(recording, sensed(predicted, acting), tool)


def twin(scenario: Scenario, recording: Recording) -> Callable[[Mapping[str, float]], Recording]:
    """From values of the law's parameters to the probe simulated with them, driven by pose.

    For ``identify(..., twin=...)``: what reading such a motion does to the answer is taken off it.
    """
    law = law_named(scenario.specimen.law)
    density = scenario.specimen.material.get("density")

    def simulated(values: Mapping[str, float]) -> Recording:
        return replay(scenario, Material(law, dict(values), density), recording).recording

    return simulated


def _particles(station: Station, recording: Recording) -> np.ndarray:
    """The particle at each tracked point's place of rest."""
    if recording.on_surface:
        raise ValueError(
            "the recording holds points of a face that cameras have seen, and no particles: take one"
            " that was made without --perception"
        )
    rest = station.material.scene.rest
    distance, found = cKDTree(rest).query(recording.reference)
    spacing = float(np.cbrt(station.material.scene.simulation.body.volume).max())
    if distance.max() > NEAR * spacing:
        raise ValueError(
            f"a tracked point lies {1e3 * distance.max():.2g} mm from the nearest particle at rest:"
            " the recording is not of this scenario, or solver.dx was changed"
        )
    found = np.asarray(found)
    return found


class _Path:
    """How the tool moves in every step, and what stands still."""

    def __init__(
        self, station: Station, recording: Recording, tool: str, period: float, drive: Drive
    ):
        self.touching, self._tool, self._period = station.material.touching, tool, period
        stream, force = recording.poses[tool], recording.forces[tool]
        self._path = PiecewisePose.MakeLinear(
            stream.time, [RigidTransform(X) for X in stream.value]
        )
        self._span = stream.time[0], stream.time[-1]
        X_BT = station.tool.GetFixedPoseInBodyFrame()
        context = station.plant.CreateDefaultContext()
        self._still, self._held = [], []
        for t in self.touching:
            body = station.plant.get_body(t.body)
            self._still.append(station.plant.EvalBodyPoseInWorld(context, body) @ t.X_BG)
            self._held.append(X_BT.inverse() @ t.X_BG)
        self._servo = None
        if drive == "force":
            p_WT = [np.interp(force.time, stream.time, p) for p in stream.value[:, :3, 3].T]
            self._servo = ForceServo.of(force.time, force.value, np.stack(p_WT, axis=1))
        self._offset = np.zeros(3)

    def step(self, time: float, snapshot: Snapshot) -> tuple[Motions, RigidTransform]:
        """Motions of all tools from ``time`` [s] on, and X_WT then."""
        X, X1 = (self._pose(t) for t in (time, time + self._period))
        if self._servo is not None:
            before = self._offset
            self._offset = self._servo.moved(
                time, self._period, before, self.force(snapshot), X1.translation() - X.translation()
            )
            X, X1 = _shifted(X, before), _shifted(X1, self._offset)
        return self._motions(X, X1), X

    def at(self, time: float) -> RigidTransform:
        """X_WT as far as the tool has come by a time [s]."""
        return _shifted(self._pose(time), self._offset)

    def force(self, snapshot: Snapshot) -> np.ndarray:
        """On the moving tool [N], in W."""
        own = [t.name == self._tool for t in self.touching]
        total: np.ndarray = snapshot.force[own].sum(axis=0)
        return total

    def _pose(self, time: float) -> RigidTransform:
        """X_WT as recorded; at rest before and after."""
        return self._path.GetPose(float(np.clip(time, *self._span)))

    def _motions(self, X_WT: RigidTransform, X_next: RigidTransform) -> Motions:
        h = self._period
        turn = (X_next.rotation() @ X_WT.rotation().inverse()).ToAngleAxis()
        omega = turn.angle() * turn.axis() / h
        p, R, v, w = [], [], [], []
        for t, still, held in zip(self.touching, self._still, self._held, strict=True):
            moves = t.name == self._tool
            X, X1 = (X_WT @ held, X_next @ held) if moves else (still, still)
            p.append(X.translation())
            R.append(X.rotation().matrix())
            v.append((X1.translation() - X.translation()) / h)
            w.append(omega if moves else np.zeros(3))
        return Motions(np.array(p), np.array(R), np.array(v), np.array(w))


def _shifted(X: RigidTransform, by: np.ndarray) -> RigidTransform:
    return RigidTransform(X.rotation(), X.translation() + by)


def _compared(recording: Recording, predicted: Recording, tool: str) -> Replay:
    force, measured = predicted.forces[tool], recording.forces[tool]
    largest = float(np.linalg.norm(measured.value, axis=1).max()) or np.nan
    felt = np.stack([np.interp(measured.time, force.time, f) for f in force.value.T], axis=1)
    error = np.linalg.norm(felt - measured.value, axis=1)
    away = predicted.p_WQ - recording.p_WQ
    if recording.valid is not None:
        away = away[recording.valid]
    peak = float(np.linalg.norm(felt, axis=1).max() / largest - 1.0)
    return Replay(
        predicted,
        float(np.sqrt((away**2).sum(axis=-1).mean())),
        float(np.sqrt(np.mean(error**2)) / largest),
        peak,
    )
