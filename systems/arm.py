"""The arm as a planner sees it: its joints, their limits, the tool, and what stands around it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from types import MappingProxyType

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import ModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.planning import RobotDiagramBuilder
from pydrake.systems.framework import Context, Diagram

JOINTS = 7
# Wrist and gripper down, elbow up: the start of the paper's inverse kinematics (notes-setup.md, 1).
HOME = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.8])


def add_package(parser: Parser, others: Mapping[str, str] = MappingProxyType({})) -> None:
    """Makes ``package://form_drake/...`` known: models, tools and scenarios of this package.

    Args:
        parser: to be told.
        others: folders of further packages by name; they go before those that Drake knows.

    Raises:
        ValueError: no such folder.
    """
    known = parser.package_map()
    with as_file(files("form_drake") / "models" / "package.xml") as path:
        if not known.Contains("form_drake"):
            known.AddPackageXml(str(path))
    for name, folder in others.items():
        if not Path(folder).is_dir():
            raise ValueError(f"package {name}: {folder} is no folder")
        if known.Contains(name):
            known.Remove(name)
        known.Add(name, str(Path(folder).resolve()))


def exclude_held_tool(
    plant: MultibodyPlant, scene_graph: SceneGraph, *, arm: str = "panda", tool: str
) -> None:
    """No collisions among a held tool, the hand and the fingers that hold it.

    Args:
        plant: holds both models; not necessarily finalized.
        scene_graph: where their geometry is registered.
        arm: name of the arm's model.
        tool: name of the tool's model.
    """
    hand = {"panda_hand", "panda_leftfinger", "panda_rightfinger"}
    models = (plant.GetModelInstanceByName(name) for name in (arm, tool))
    bodies, held = ([plant.get_body(i) for i in plant.GetBodyIndices(m)] for m in models)
    held += [b for b in bodies if b.name() in hand]
    shapes = [g for b in held for g in plant.GetCollisionGeometriesForBody(b)]
    scene_graph.collision_filter_manager().Apply(
        CollisionFilterDeclaration().ExcludeWithin(GeometrySet(shapes))
    )


@dataclass(frozen=True)
class Limits:
    """What the arm can do, joint by joint.

    Attributes:
        lower: smallest joint angles [rad], shape [7].
        upper: largest joint angles [rad], shape [7].
        velocity: largest speeds [rad/s], shape [7].
        acceleration: largest accelerations [rad/s^2], shape [7].
        torque: largest joint torques, gravity included [N m], shape [7].
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray

    def scaled(self, fraction: float) -> "Limits":
        """The same positions; speeds, accelerations and torques times ``fraction``.

        Raises:
            ValueError: ``fraction`` is not in (0, 1].
        """
        if not 0.0 < fraction <= 1.0:
            raise ValueError(f"the fraction of the joint limits is {fraction:g}: give 0 < it <= 1")
        rest = (fraction * a for a in (self.velocity, self.acceleration, self.torque))
        return Limits(self.lower, self.upper, *rest)


@dataclass(frozen=True)
class Arm:
    """A seven-joint arm in a scene of its own that nothing moves but the planner.

    The contexts live here: constraints of Drake's programs hold bare pointers to them.

    Attributes:
        diagram: plant and scene graph.
        plant: the arm, its tool and what stands around, finalized.
        root: context of ``diagram``.
        model: name of the arm's model instance.
        tool: the frame T that is to be moved.
    """

    diagram: Diagram
    plant: MultibodyPlant
    root: Context
    model: str
    tool: Frame

    @classmethod
    def load(
        cls,
        directives: ModelDirectives,
        *,
        tool: str = "press_plate::tool",
        model: str = "panda",
        packages: Mapping[str, str] = MappingProxyType({}),
    ) -> "Arm":
        """An arm in the scene that model directives describe.

        Args:
            directives: Drake model directives; every free body but the arm must be welded.
            tool: scoped name of the tool frame.
            model: name of the arm's model instance.
            packages: see ``add_package``.

        Raises:
            ValueError: the scene has joints besides the arm's and its fingers', or no such frame.
        """
        builder = RobotDiagramBuilder(time_step=0.0)
        add_package(builder.parser(), packages)
        ProcessModelDirectives(directives, builder.parser())
        plant = builder.plant()
        plant.Finalize()
        instance = plant.GetModelInstanceByName(model)
        if plant.num_positions() != plant.num_positions(instance):
            raise ValueError("the planner's scene has moving bodies besides the arm: weld them")
        frame = scoped_frame(plant, tool)
        held = plant.GetModelInstanceName(frame.model_instance())
        if held not in (model, "WorldModelInstance"):
            exclude_held_tool(plant, builder.scene_graph(), arm=model, tool=held)
        diagram = builder.Build()
        return cls(diagram, plant, diagram.CreateDefaultContext(), model, frame)

    @cached_property
    def context(self) -> Context:
        """The plant's part of ``root``."""
        return self.plant.GetMyMutableContextFromRoot(self.root)

    @cached_property
    def index(self) -> np.ndarray:
        """Which of the plant's positions are the arm's joints, shape [7]."""
        joints = arm_joints(self.plant, self.model)
        return np.array([j.position_start() for j in joints])

    @cached_property
    def limits(self) -> Limits:
        """The model's limits."""
        p, i = self.plant, self.index
        arrays = (
            p.GetPositionLowerLimits(),
            p.GetPositionUpperLimits(),
            p.GetVelocityUpperLimits(),
            p.GetAccelerationUpperLimits(),
            p.GetEffortUpperLimits(),
        )
        return Limits(*(a[i] for a in arrays))

    def whole(self, q: np.ndarray) -> np.ndarray:
        """All of the plant's positions with the arm's at q [rad], shape [..., 7] -> [..., n]."""
        rest = self.plant.GetDefaultPositions()
        found = np.broadcast_to(rest, (*np.shape(q)[:-1], len(rest))).copy()
        found[..., self.index] = q
        return found

    def place(self, q: np.ndarray) -> Context:
        """The plant's context with the arm at q [rad], shape [7], and at rest."""
        self.plant.SetPositions(self.context, self.whole(q))
        self.plant.SetVelocities(self.context, np.zeros(self.plant.num_velocities()))
        return self.context

    def pose(self, q: np.ndarray) -> RigidTransform:
        """X_WT at joint angles q [rad], shape [7]."""
        return self.tool.CalcPoseInWorld(self.place(q))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """J of V_WT = J v, rotation above translation, in W; shape [6, 7]."""
        world = self.plant.world_frame()
        J = self.plant.CalcJacobianSpatialVelocity(
            self.place(q), JacobianWrtVariable.kV, self.tool, np.zeros(3), world, world
        )
        return J[:, self.index]

    def nearest(self, q: np.ndarray, within: float) -> tuple[float, str, str]:
        """Smallest distance [m] between two bodies at q and their names.

        Args:
            q: joint angles [rad], shape [7].
            within: pairs farther apart than this [m] are not looked at.

        Returns:
            Distance and names; (within, "", "") where no pair is nearer.
        """
        query = self.plant.get_geometry_query_input_port().Eval(self.place(q))
        pairs = query.ComputeSignedDistancePairwiseClosestPoints(within)
        if not pairs:
            return within, "", ""
        least = min(pairs, key=lambda pair: pair.distance)
        frame = query.inspector().GetFrameId
        a, b = (self.plant.GetBodyFromFrameId(frame(g)).name() for g in (least.id_A, least.id_B))
        return least.distance, a, b


def arm_joints(plant: MultibodyPlant, model: str) -> list:
    """The seven joints ``panda_joint1..7`` of a model."""
    instance = plant.GetModelInstanceByName(model)
    return [plant.GetJointByName(f"panda_joint{i + 1}", instance) for i in range(JOINTS)]


def scoped_frame(plant: MultibodyPlant, name: str) -> Frame:
    """The frame ``model::frame``.

    Raises:
        ValueError: no such model or frame.
    """
    model, _, frame = name.rpartition("::")
    if not plant.HasModelInstanceNamed(model):
        raise ValueError(f"the tool frame {name!r} names no model of the scene: write model::frame")
    instance = plant.GetModelInstanceByName(model)
    if not plant.HasFrameNamed(frame, instance):
        names = sorted(plant.get_frame(i).name() for i in plant.GetFrameIndices(instance))
        raise ValueError(f"{model} has no frame {frame!r}; it has: {', '.join(names)}")
    return plant.GetFrameByName(frame, instance)
