"""A probe run: the arm follows the scenario's path, everything measured is recorded."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.trajectories import Trajectory

from form_drake.control import Follow, smooth
from form_drake.effects import CATALOGUE, Effect
from form_drake.effects.acting import known, sensed
from form_drake.records import Recording, Stream
from form_drake.systems.arm import Arm
from form_drake.systems.behind import steps_between
from form_drake.systems.follower import PathFollower
from form_drake.systems.force import draws
from form_drake.systems.identifier import Answer, Identifier
from form_drake.systems.motion import timed_path
from form_drake.systems.page import write_page
from form_drake.systems.recorder import FORCES, ParticleTracks, Recorder, Source
from form_drake.systems.scenario import Scenario
from form_drake.systems.seeing import add_cameras
from form_drake.systems.station import (
    Station,
    directives,
    make_station,
    specimen_corners,
    tool_rotation,
)
from form_drake.systems.touching import body_name
from form_drake.systems.viewer import View


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
    arm = _arm(scenario)
    R_WT = tool_rotation(scenario)
    places = [w.p_WT for w in waypoints]

    def X_WT(time: float) -> RigidTransform:
        return RigidTransform(R_WT, smooth(stamps, places, time))

    return timed_path(arm, X_WT, float(stamps[-1]))


def _arm(scenario: Scenario) -> Arm:
    return Arm.load(directives(scenario), tool=scenario.probe.tool, packages=scenario.packages)


def begun(scenario: Scenario, motion: Trajectory) -> np.ndarray:
    """Joint angles with which the tool holds what is bonded to it [rad], shape [7].

    Of a specimen that hangs from it the arm bears the weight, and gives way by it, while the glue sets.
    """
    q, specimen = motion.value(0.0).ravel(), scenario.specimen
    if list(specimen.contact.values()) != ["bonded"]:
        return q
    arm, volume = _arm(scenario), np.prod(np.ptp(specimen_corners(scenario), axis=0))
    gravity = arm.plant.gravity_field().gravity_vector()
    weight = specimen.made().density * volume * gravity
    return q + arm.jacobian(q)[3:].T @ weight / np.array(scenario.panda.stiffness)


@dataclass(frozen=True)
class Run:
    """A station with an arm that follows the probe.

    Attributes:
        scenario: of it.
        station: of it.
        recorder: of what is measured.
        diagram: station, follower, recorder and perhaps identifier.
        duration: of the probe [s].
    """

    scenario: Scenario
    station: Station
    recorder: Recorder
    diagram: Diagram
    duration: float

    def write_page(self, path: Path) -> tuple[int, int]:
        """Write what Meshcat has shown as one page; frames and points per frame of it."""
        viewer = self.station.diagram.GetSubsystemByName("particle_viewer")
        return write_page(viewer, path, self.scenario.name)


def prepare(
    scenario: Scenario,
    meshcat: Meshcat | None = None,
    view: View | None = None,
    *,
    seen: bool = False,
    answers: float | None = None,
    wait: bool = True,
    told: Callable[[Answer], None] = lambda _: None,
    effects: Mapping[str, Effect] = CATALOGUE,
) -> Run:
    """Plan the probe and connect arm, station and recorder.

    Args:
        scenario: of the probe.
        meshcat: that shows it.
        view: what it shows of the material.
        seen: whether two cameras follow points of a face, instead of particles that are known.
        answers: time [s] between identifications while the probe moves; None: none.
        wait: whether the probe waits for them.
        told: called with every answer.
        effects: of which the scenario may name some, by id.
    """
    builder = DiagramBuilder()
    motion = planned(scenario)
    start = begun(scenario, motion)
    station = make_station(scenario, start=start, effects=effects, meshcat=meshcat, view=view)
    _long_enough(scenario, motion.end_time(), scenario.stereo.rate if seen else None)
    source = builder.AddSystem(station.diagram)
    follow = Follow(until_force=scenario.probe.until_force)
    follower = PathFollower(motion, follow, period=scenario.solver.period)
    builder.AddNamedSystem("follower", follower)
    builder.Connect(follower.GetOutputPort("position"), source.GetInputPort("panda.position"))
    builder.Connect(source.GetOutputPort("tool.force"), follower.GetInputPort("force"))
    sight = _seen(builder, scenario, station, motion, meshcat, seen)
    recorder = _add_recorder(builder, scenario, station, sight, effects)
    if answers is not None:
        identifier = Identifier(every=answers, period=scenario.solver.period, wait=wait, told=told)
        builder.AddNamedSystem("identifier", identifier)
        builder.Connect(recorder.GetOutputPort("recording"), identifier.get_input_port())
    return Run(scenario, station, recorder, builder.Build(), motion.end_time())


def _long_enough(scenario: Scenario, duration: float, rate: float | None) -> None:
    """Refuse a probe of which hardly a frame would be recorded."""
    solver, rate = scenario.solver, rate or scenario.measure.rate
    every = steps_between(rate, solver.period) * solver.period
    if duration < solver.settle + every:
        raise ValueError(
            f"scenario {scenario.name}: the probe ends at {duration:g} s, and is recorded from"
            f" solver.settle={solver.settle:g} s on, every {every:g} s: two frames at least are wanted"
        )


def _seen(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: Station,
    motion: Trajectory,
    meshcat: Meshcat | None,
    seen: bool,
) -> Source:
    """Who tells where points are: the simulation, or two cameras."""
    measure = scenario.measure
    if seen:  # of all particles
        scenario = replace(scenario, measure=replace(measure, points=0, noise=0.0))
    chosen = tracked(scenario, station)
    header = _header(scenario, station, chosen)
    if seen:
        return add_cameras(builder, scenario, station, header, motion.end_time(), meshcat)
    tracks = ParticleTracks(chosen, measure.noise, measure.seed, scenario.solver.period)
    builder.AddNamedSystem("tracks", tracks)
    particles = station.diagram.GetOutputPort("material.particles")
    builder.Connect(particles, tracks.get_input_port())
    return Source(tracks, header, measure.rate)


def _add_recorder(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: Station,
    source: Source,
    effects: Mapping[str, Effect],
) -> Recorder:
    solver, made = scenario.solver, scenario.specimen.made()
    acting = known(made.effects, made.law, effects)
    recorder = Recorder(
        source.header,
        body_name(station.plant, station.tool.body()),
        begin=solver.settle,
        rate=source.rate,
        period=solver.period,
        rig=source.rig,
        sensed=lambda recording: sensed(recording, acting),
        off=scenario.measure.place * draws(scenario.measure.seed, "place", 0).standard_normal(3),
    )
    builder.AddNamedSystem("recorder", recorder)
    builder.Connect(source.tracks.get_output_port(), recorder.GetInputPort("sight"))
    for port in ("tool.X_WT", "panda.position_measured", *FORCES.values()):
        builder.Connect(station.diagram.GetOutputPort(port), recorder.GetInputPort(port))
    return recorder


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
    simulator = finish(run, begin(run), progress)
    context = run.recorder.GetMyContextFromRoot(simulator.get_context())
    found: Recording = run.recorder.GetOutputPort("recording").Eval(context)
    return found


def finish(
    run: Run, simulator: Simulator, progress: Callable[[int, int], None] | None = None
) -> Simulator:
    """Simulate to the end of the probe, what happens at its last instant included, and identify."""
    steps = round(run.duration / run.scenario.solver.period)
    for k in range(1, steps + 1):
        simulator.AdvanceTo(k * run.scenario.solver.period)
        if progress is not None:
            progress(k, steps)
    simulator.AdvancePendingEvents()
    if run.diagram.HasSubsystemNamed("identifier"):
        identifier = run.diagram.GetSubsystemByName("identifier")
        identifier.conclude(identifier.GetMyMutableContextFromRoot(simulator.get_mutable_context()))
    return simulator


def tracked(scenario: Scenario, station: Station) -> np.ndarray:
    """Indices of the particles that are tracked, drawn by the seed."""
    count = len(station.material.scene.rest)
    wanted = scenario.measure.points or count
    rng = np.random.default_rng(scenario.measure.seed)
    return np.sort(rng.choice(count, size=min(wanted, count), replace=False))


def _header(scenario: Scenario, station: Station, chosen: np.ndarray) -> Recording:
    """All that is known before the probe: specimen, tool and sensors."""
    measure, specimen = scenario.measure, scenario.specimen
    tool = body_name(station.plant, station.tool.body())
    rest = station.material.scene.rest[chosen]
    low, high = (" ".join(f"{v:.9g}" for v in corner) for corner in specimen_corners(scenario))
    none = np.zeros(1)
    return Recording.from_arrays(
        none,
        rest[None],
        noise=measure.noise or None,
        p_reference=rest,
        density=specimen.made().density,
        mass_scale=scenario.solver.mass_scale,
        gravity=station.plant.gravity_field().gravity_vector(),
        law=specimen.law,
        known=specimen.told(),
        poses={tool: Stream(none, np.eye(4)[None], measure.place or None)},
        forces={
            tool: Stream(none, np.zeros((1, 3)), max(measure.sensor.noise) or None),
            f"{tool}:joint-torque": Stream(none, np.zeros((1, 3))),
        },
        geometry={"shape": "box", "low": low, "high": high},
        contact=dict(specimen.faces),
        source=f"form-drake simulate {scenario.name}",
    )


def truth(scenario: Scenario) -> dict[str, Any]:
    """What the recording must not hold: the law, values and effects that were simulated."""
    material = scenario.specimen.made()
    found = {"law": material.law.name, "values": material.values, "density": material.density}
    effects = [asdict(effect) for effect in scenario.specimen.effects]
    return found | ({"effects": effects} if effects else {})


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
