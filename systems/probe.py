"""A probe run: the arm follows the scenario's path, everything measured is recorded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.trajectories import Trajectory

from form_drake.records import Recording, Stream
from form_drake.systems.arm import Arm
from form_drake.systems.follower import Follow, PathFollower
from form_drake.systems.motion import timed_path
from form_drake.systems.page import write_page
from form_drake.systems.scenario import Scenario, Waypoint
from form_drake.systems.station import (
    Station,
    directives,
    make_station,
    specimen_corners,
    tool_rotation,
)
from form_drake.systems.viewer import View

FORCES = {"sensor": "tool.force", "joint-torque": "tool.force_from_torque"}


def smooth(waypoints: Sequence[Waypoint], time: float) -> np.ndarray:
    """Place [m] at a time: 3u^2 - 2u^3 between waypoints, at rest at each."""
    stamps = [w.time for w in waypoints]
    n = int(np.clip(np.searchsorted(stamps, time, side="right") - 1, 0, len(stamps) - 2))
    u = np.clip((time - stamps[n]) / (stamps[n + 1] - stamps[n]), 0.0, 1.0)
    a, b = (np.array(waypoints[i].p_WT) for i in (n, n + 1))
    place: np.ndarray = a + (3.0 * u**2 - 2.0 * u**3) * (b - a)
    return place


def planned(scenario: Scenario) -> Trajectory:
    """The arm's motion [rad] along the waypoints, within its limits.

    Raises:
        ValueError: waypoints out of order, a pose that is not reachable, or a limit that is
            exceeded; the message says where.
    """
    waypoints = scenario.probe.waypoints
    stamps = np.array([w.time for w in waypoints])
    if len(stamps) < 2 or stamps[0] != 0.0 or np.any(np.diff(stamps) <= 0.0):
        raise ValueError(f"probe.waypoints: times must increase from 0, got {stamps.tolist()}")
    if any(len(w.p_WT) != 3 for w in waypoints):
        raise ValueError("probe.waypoints: p_WT are three numbers [m]")
    arm = Arm.load(directives(scenario), tool=scenario.probe.tool)
    R_WT = tool_rotation(scenario)
    return timed_path(arm, lambda t: RigidTransform(R_WT, smooth(waypoints, t)), float(stamps[-1]))


@dataclass(frozen=True)
class Run:
    """A station with an arm that follows the probe.

    Attributes:
        scenario: of it.
        station: of it.
        diagram: station and follower.
        duration: of the probe [s].
    """

    scenario: Scenario
    station: Station
    diagram: Diagram
    duration: float

    def write_page(self, path: Path) -> tuple[int, int]:
        """Write what Meshcat has shown as one page; frames and points per frame of it."""
        viewer = self.station.diagram.GetSubsystemByName("particle_viewer")
        return write_page(viewer, path, self.scenario.name)


def prepare(scenario: Scenario, meshcat: Meshcat | None = None, view: View | None = None) -> Run:
    """Plan the probe and connect it to the station.

    Args:
        scenario: of the probe.
        meshcat: that shows it.
        view: what it shows of the material.
    """
    motion = planned(scenario)
    builder = DiagramBuilder()
    station = make_station(scenario, meshcat=meshcat, view=view)
    builder.AddSystem(station.diagram)
    follow = Follow(until_force=scenario.probe.until_force)
    follower = PathFollower(motion, follow, period=scenario.solver.period)
    builder.AddNamedSystem("follower", follower)
    source = station.diagram
    builder.Connect(follower.GetOutputPort("position"), source.GetInputPort("panda.position"))
    builder.Connect(source.GetOutputPort("tool.force"), follower.GetInputPort("force"))
    diagram = builder.Build()
    return Run(scenario, station, diagram, motion.end_time())


def begin(run: Run) -> Simulator:
    """A simulator with the arm at the first waypoint, initialised."""
    simulator = Simulator(run.diagram)
    context = simulator.get_mutable_context()
    plant = run.station.plant
    own = plant.GetMyMutableContextFromRoot(context)
    follower = run.diagram.GetSubsystemByName("follower")
    q = follower.GetOutputPort("position").Eval(follower.GetMyContextFromRoot(context))
    for i, angle in enumerate(q):
        plant.GetJointByName(f"panda_joint{i + 1}").set_angle(own, angle)
    simulator.Initialize()
    return simulator


def record(run: Run, progress: Callable[[int, int], None] | None = None) -> Recording:
    """Simulate the probe and record it.

    Args:
        run: from ``prepare``.
        progress: called with (steps done, steps).

    Returns:
        Tracked points from when the specimen has settled, forces by source, tool poses and joints;
        nothing of the truth.
    """
    scenario, simulator = run.scenario, begin(run)
    measure, period = scenario.measure, scenario.solver.period
    every = max(round(1.0 / (measure.rate * period)), 1)
    first, last = round(scenario.solver.settle / period), round(run.duration / period)
    eval_ = _evaluator(run, simulator)
    chosen = tracked(run)
    frames: list[np.ndarray] = []
    stamps: list[float] = []
    signals: dict[str, list[Any]] = {name: [] for name in ("X_WT", "q", *FORCES)}
    for k in range(1, last + 1):
        simulator.AdvanceTo(k * period)
        if k >= first:
            signals["X_WT"].append(eval_("tool.X_WT").GetAsMatrix4())
            signals["q"].append(eval_("panda.position_measured"))
            for source, port in FORCES.items():
                signals[source].append(eval_(port))
            if (k - first) % every == 0:
                frames.append(eval_("material.particles").p_WQ[chosen])
                stamps.append(k * period)
        if progress is not None:
            progress(k, last)
    time = period * np.arange(first, last + 1)
    return _recording(run, chosen, np.array(stamps), np.array(frames), time, signals)


def tracked(run: Run) -> np.ndarray:
    """Indices of the particles that are tracked, outside of clamps and drawn by the seed."""
    corners = specimen_corners(run.scenario)
    X = run.station.material.scene.rest
    free = np.flatnonzero(np.all((X >= corners[0]) & (X <= corners[1]), axis=1))
    wanted = run.scenario.measure.points or len(free)
    rng = np.random.default_rng(run.scenario.measure.seed)
    return np.sort(rng.choice(free, size=min(wanted, len(free)), replace=False))


def _evaluator(run: Run, simulator: Simulator) -> Callable[[str], Any]:
    diagram = run.station.diagram
    context = diagram.GetMyContextFromRoot(simulator.get_context())
    return lambda name: diagram.GetOutputPort(name).Eval(context)


def _recording(
    run: Run,
    chosen: np.ndarray,
    stamps: np.ndarray,
    frames: np.ndarray,
    time: np.ndarray,
    signals: dict[str, list[Any]],
) -> Recording:
    scenario, measure = run.scenario, run.scenario.measure
    specimen, solver = scenario.specimen, scenario.solver
    tool = run.station.tool.body().name()
    middle = time - 0.5 * solver.period  # wrenches are means over a period
    sd = {"sensor": max(measure.sensor.noise) or None, "joint-torque": None}
    forces = {
        tool if source == "sensor" else f"{tool}:{source}": Stream(
            middle, np.array(signals[source]), sd[source]
        )
        for source in FORCES
    }
    rng = np.random.default_rng((measure.seed, 1))
    low, high = (" ".join(f"{v:.9g}" for v in corner) for corner in specimen_corners(scenario))
    values = {k: v for k, v in scenario.specimen.material.items() if k in specimen.known}
    return Recording.from_arrays(
        stamps,
        frames + rng.normal(0.0, measure.noise, frames.shape) if measure.noise else frames,
        noise=measure.noise or None,
        p_reference=run.station.material.scene.rest[chosen],
        density=specimen.made().density,
        mass_scale=solver.mass_scale,
        gravity=run.station.plant.gravity_field().gravity_vector(),
        law=specimen.law,
        known=values,
        poses={tool: Stream(time, np.array(signals["X_WT"]))},
        forces=forces,
        joints=Stream(time, np.array(signals["q"])),
        geometry={"shape": "box", "low": low, "high": high},
        contact=dict(specimen.faces),
        source=f"form-drake simulate {scenario.name}",
    )


def truth(scenario: Scenario) -> dict[str, Any]:
    """What the recording must not hold: the law and values that were simulated."""
    material = scenario.specimen.made()
    return {"law": material.law.name, "values": material.values, "density": material.density}


def largest_force(recording: Recording) -> float:
    """Of the sensor at the tool [N]."""
    (tool,) = recording.poses
    return float(np.linalg.norm(recording.forces[tool].value, axis=1).max())


def shown(live: Callable[[str], None] | None = None) -> Meshcat:
    """A Meshcat to draw into.

    Args:
        live: called with its address.
    """
    meshcat = Meshcat()
    if live is not None:
        live(meshcat.web_url())
    return meshcat
