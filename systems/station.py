"""A scenario as one diagram: arm, tool, soft material and sensors, with the ports of the real robot."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Box, MakeRenderEngineVtk, Meshcat, RenderEngineVtkParams, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import (
    LoadModelDirectivesFromString,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import BodyIndex, Frame
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Demultiplexer

from form_drake.effects import CATALOGUE, Effect
from form_drake.material import Material
from form_drake.motion.body import Face
from form_drake.mpm.exchange import region_around
from form_drake.systems.arm import add_package, arm_joints, exclude_held_tool, scoped_frame
from form_drake.systems.force import Sensor, ToolForce
from form_drake.systems.material import MaterialSystem
from form_drake.systems.panda import add_panda, apply_panda
from form_drake.systems.scenario import Scenario
from form_drake.systems.soft import AddMaterial
from form_drake.systems.touching import Contact, body_name
from form_drake.systems.viewer import View, add_viewer

ARM = "panda"


@dataclass(frozen=True)
class Station:
    """A diagram and the parts that a simulation may look into.

    Attributes:
        diagram: see ``make_station``.
        plant: of it.
        material: of it.
        tool: the tool frame T.
    """

    diagram: Diagram
    plant: MultibodyPlant
    material: MaterialSystem
    tool: Frame


class ToolPose(LeafSystem):
    """X_WT from the arm's joint angles.

    Ports: in ``position`` [rad]; out ``X_WT``.
    """

    def __init__(self, plant: MultibodyPlant, tool: Frame, model: str = ARM):
        super().__init__()
        self._plant, self._tool = plant, tool
        self._context = plant.CreateDefaultContext()
        self._index = [j.position_start() for j in arm_joints(plant, model)]
        self.DeclareVectorInputPort("position", 7)
        self.DeclareAbstractOutputPort("X_WT", Value[RigidTransform], self._calc)

    def _calc(self, context: Context, output: Value) -> None:
        q = self._plant.GetPositions(self._context)
        q[self._index] = self.get_input_port().Eval(context)
        self._plant.SetPositions(self._context, q)
        output.set_value(self._tool.CalcPoseInWorld(self._context))


def make_station(
    scenario: Scenario,
    *,
    hardware: bool = False,
    start: Sequence[float] | None = None,
    material: Material | None = None,
    effects: Mapping[str, Effect] = CATALOGUE,
    meshcat: Meshcat | None = None,
    view: View | None = None,
) -> Station:
    """The station of a scenario.

    Input ports: ``panda.position`` [rad]. Output ports: ``panda.position_measured`` [rad],
    ``panda.velocity_measured`` [rad/s], ``panda.torque_external`` [N m], ``tool.X_WT``,
    ``tool.force`` (sensor at the tool) and ``tool.force_from_torque`` [N], of the material on the
    tool at the tool frame's origin, in W; for every camera ``<camera>.color_image``,
    ``<camera>.depth_image_32f`` and ``<camera>.image_time``. In simulation only:
    ``material.particles`` (``Snapshot``), ``tool.force_ideal`` and ``query_object``.

    Args:
        scenario: what it holds.
        hardware: the real arm instead of the simulated one.
        start: joint angles by default [rad], with which tools hold material that is bonded to them.
        material: simulated instead of the scenario's.
        effects: of which materials may name some, by id.
        meshcat: that shows it.
        view: what it shows of the material.

    Raises:
        ValueError: ``hardware``, or a scenario that does not fit together.
    """
    if hardware:
        raise ValueError("hardware=True: no driver of the real arm yet; use hardware=False")
    builder = DiagramBuilder()
    plant, scene_graph = _plant(scenario, builder)
    tool = scoped_frame(plant, scenario.probe.tool)
    held = plant.GetModelInstanceName(tool.model_instance())
    exclude_held_tool(plant, scene_graph, arm=ARM, tool=held)
    driver = replace(scenario.panda, compensated=sorted({*scenario.panda.compensated, held}))
    apply_panda(plant, driver)
    plant.Finalize()
    for joint, angle in zip(arm_joints(plant, ARM), () if start is None else start, strict=False):
        joint.set_default_angle(angle)
    panda = add_panda(builder, plant, driver)
    material = material or scenario.specimen.made()
    soft = _soft(scenario, material, effects, builder, plant, scene_graph)
    _export_arm(scenario, builder, plant, panda, tool)
    _export_force(scenario, builder, soft, body_name(plant, tool.body()))
    builder.ExportOutput(soft.GetOutputPort("particles"), "material.particles")
    builder.ExportOutput(scene_graph.get_query_output_port(), "query_object")
    _cameras(scenario, builder, plant, scene_graph)
    if meshcat is not None:
        add_viewer(builder, plant, scene_graph, soft, meshcat, view)
    diagram = builder.Build()
    diagram.set_name(scenario.name)
    return Station(diagram, plant, soft, tool)


def _plant(scenario: Scenario, builder: DiagramBuilder) -> tuple[MultibodyPlant, SceneGraph]:
    config = MultibodyPlantConfig(
        time_step=scenario.solver.period,
        use_sampled_output_ports=False,
        discrete_contact_approximation="sap",
    )
    plant, scene_graph = AddMultibodyPlant(config, builder)
    parser = Parser(plant)
    try:
        add_package(parser, scenario.packages)
        ProcessModelDirectives(directives(scenario), parser)
    except (RuntimeError, ValueError) as error:
        what = str(error).strip().splitlines()[0]
        if "when downloading" in what:
            what = f"{what.split(',')[0]}: it cannot be had; state packages.NAME=FOLDER with a copy"
        raise ValueError(
            f"scenario {scenario.name}: arm {scenario.arm}, cell {scenario.cell}: {what}"
        ) from None
    return plant, scene_graph


def directives(scenario: Scenario) -> ModelDirectives:
    """The model directives of the scenario's arm and cell."""
    named = (scenario.arm, scenario.cell)
    files = (f if "://" in f else Path(f).resolve().as_uri() for f in named)
    parts = (f"- add_directives: {{file: '{file}'}}\n" for file in files)
    return LoadModelDirectivesFromString("directives:\n" + "".join(parts))


def _soft(
    scenario: Scenario,
    material: Material,
    effects: Mapping[str, Effect],
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
) -> MaterialSystem:
    specimen, solver = scenario.specimen, scenario.solver
    corners = specimen_corners(scenario)
    halfway = {}
    for face in specimen.clamped:
        at = Face.named(face)
        halfway[at.axis] = float(corners[at.side, at.axis])
    return AddMaterial(
        builder,
        plant,
        scene_graph,
        material,
        Box(*np.ptp(corners, axis=0)),
        RigidTransform(corners.mean(axis=0)),
        dx=solver.dx,
        bodies=_named_bodies(plant, specimen.contact),
        contact={body: _contact(word) for body, word in specimen.contact.items()},
        region=region_around(corners, np.array(solver.room), solver.dx, halfway),
        grid=solver.grid,
        per_cell=solver.per_cell,
        period=solver.period,
        settle=(solver.damping, solver.settle),
        mass_scale=solver.mass_scale,
        effects=effects,
        precision=solver.precision,
        device=solver.device,
    )


def specimen_corners(scenario: Scenario) -> np.ndarray:
    """Corners of the specimen's part outside of clamps, free of stress [m], shape [2, 3].

    Raises:
        ValueError: a clamped face that is none, or that leaves nothing free.
    """
    specimen = scenario.specimen
    size, p_WM = np.array(specimen.size), np.array(specimen.p_WM)
    corners = np.stack([p_WM - size / 2, p_WM + size / 2])
    for face, length in specimen.clamped.items():
        try:
            at = Face.named(face)
        except ValueError as error:
            raise ValueError(f"specimen.clamped: {error}") from None
        corners[at.side, at.axis] += (1 - 2 * at.side) * length
    if np.any(corners[1] <= corners[0]):
        raise ValueError(f"specimen.clamped: {specimen.clamped} m leave nothing of {size} m free")
    return corners


def _named_bodies(plant: MultibodyPlant, contact: dict[str, str]) -> list:
    every = [plant.get_body(BodyIndex(n)) for n in range(plant.num_bodies())]
    named = {body_name(plant, body): body for body in every}
    lost = [name for name in contact if name not in named]
    if lost:
        raise ValueError(f"specimen.contact: the cell has no body {', '.join(lost)}")
    return [named[name] for name in contact]


def _contact(word: str) -> Contact:
    try:
        return float(word)
    except ValueError:
        return word  # type: ignore[return-value]  # Tool refuses what it does not know


def _export_arm(
    scenario: Scenario,
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    panda: Diagram,
    tool: Frame,
) -> None:
    builder.ExportInput(panda.GetInputPort("position"), f"{ARM}.position")
    for name in ("position_measured", "velocity_measured", "torque_external"):
        builder.ExportOutput(panda.GetOutputPort(name), f"{ARM}.{name}")
    pose = builder.AddNamedSystem("tool_pose", ToolPose(plant, tool))
    torque = builder.AddNamedSystem("torque_sensor", Sensor(7, scenario.measure.torque, "torque"))
    noise = np.broadcast_to(scenario.measure.torque.noise, 7)
    sd = noise if noise.all() else None
    force = builder.AddNamedSystem("tool_force", ToolForce(plant, tool, sd=sd))
    measured = panda.GetOutputPort("position_measured")
    builder.Connect(measured, pose.get_input_port())
    builder.Connect(measured, force.GetInputPort("position"))
    builder.Connect(panda.GetOutputPort("torque_external"), torque.get_input_port())
    builder.Connect(torque.get_output_port(), force.GetInputPort("torque_external"))
    builder.ExportOutput(pose.get_output_port(), "tool.X_WT")
    builder.ExportOutput(force.GetOutputPort("force"), "tool.force_from_torque")


def _export_force(
    scenario: Scenario, builder: DiagramBuilder, material: MaterialSystem, body: str
) -> None:
    if not material.HasOutputPort(f"{body}.wrench"):
        raise ValueError(
            f"specimen.contact: the tool {body} is not among {', '.join(scenario.specimen.contact)}"
        )
    ideal = builder.AddNamedSystem("moment_and_force", Demultiplexer([3, 3]))
    sensor = builder.AddNamedSystem("force_sensor", Sensor(3, scenario.measure.sensor))
    builder.Connect(material.GetOutputPort(f"{body}.wrench"), ideal.get_input_port())
    force = ideal.get_output_port(1)  # the same about any point, the tool frame's origin too
    builder.Connect(force, sensor.get_input_port())
    builder.ExportOutput(force, "tool.force_ideal")
    builder.ExportOutput(sensor.get_output_port(), "tool.force")


def _cameras(
    scenario: Scenario, builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph
) -> None:
    from pydrake.lcm import DrakeLcm
    from pydrake.systems.sensors import ApplyCameraConfig

    if scenario.cameras and not scene_graph.HasRenderer("vtk"):
        scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    for name, config in deepcopy(scenario.cameras).items():
        config.name, config.renderer_name, config.renderer_class = name, "vtk", ""
        try:
            ApplyCameraConfig(
                config=config,
                builder=builder,
                plant=plant,
                scene_graph=scene_graph,
                lcm=DrakeLcm("memq://null"),  # pictures go to ports alone
            )
        except (RuntimeError, ValueError) as error:
            raise ValueError(f"cameras.{name}: {' '.join(str(error).split())[:300]}") from None
        sensor = builder.GetSubsystemByName(f"rgbd_sensor_{name}")
        for port in ("color_image", "depth_image_32f", "image_time"):
            builder.ExportOutput(sensor.GetOutputPort(port), f"{name}.{port}")


def tool_rotation(scenario: Scenario):
    """R_WT of the probe."""
    return RollPitchYaw(np.radians(scenario.probe.rpy_deg)).ToRotationMatrix()
