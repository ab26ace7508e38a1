"""The material point method as a part of a Drake diagram."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import SceneGraph, Shape
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import (
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, State

from form_drake.material import Material
from form_drake.mpm.bodies import block, filled
from form_drake.mpm.exchange import Scene, Snapshot
from form_drake.mpm.model import Body
from form_drake.mpm.tools import Motions, Tool
from form_drake.systems.shapes import friction, solid

PERIOD = 1e-3
MOST_PARTICLES = 2_000_000
ROOM = 1.0  # of a body's longest edge, left around it by default

Contact = float | Literal["stick", "bonded"]


@dataclass(frozen=True)
class Touching:
    """A collision geometry G of a body B of the plant that touches material.

    Attributes:
        body: index of B.
        name: of B.
        X_BG: pose of the geometry.
        tool: its shape and contact.
    """

    body: BodyIndex
    name: str
    X_BG: RigidTransform
    tool: Tool


class MaterialSystem(LeafSystem):
    """Soft bodies among the bodies of a plant.

    All state is a snapshot in the Context, so that a cloned Context goes on from where it was. Once
    a period the particles are advanced with the bodies moving as they do at its begin; the mean
    wrenches of the period act on the plant during that same period if the plant does not sample its
    output ports.

    Ports:
        body_poses, body_spatial_velocities: of the plant.
        applied_spatial_force: on the plant.
        particles: ``Snapshot``.
        <name>.wrench: moment about a touching body's origin and force on it [N m, N], in W.

    Args:
        scene: the bodies; its tools are ``touching``, in the same order.
        touching: what touches them.
        period: [s].
        settle: rate [1/s] at which velocities decay, and the time [s] until which they do.
    """

    def __init__(
        self,
        scene: Scene,
        touching: Sequence[Touching],
        *,
        period: float = PERIOD,
        settle: tuple[float, float] = (0.0, 0.0),
    ):
        super().__init__()
        self.scene, self.touching = scene, tuple(touching)
        self.period, self._settle = period, settle
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        )
        self._snapshot = self.DeclareAbstractState(Value[object](scene.start()))
        ticket = {self.abstract_state_ticket(self._snapshot)}
        self.DeclareAbstractOutputPort(
            "applied_spatial_force",
            Value[list[ExternallyAppliedSpatialForce]],
            self._apply,
            ticket,
        )
        self.DeclareAbstractOutputPort(
            "particles",
            lambda: Value[object](None),
            lambda context, out: out.set_value(self.snapshot(context)),
            ticket,
        )
        for name in dict.fromkeys(t.name for t in self.touching):
            self.DeclareVectorOutputPort(
                f"{name}.wrench",
                6,
                lambda context, out, name=name: out.SetFromVector(self._wrench(context, name)),
                ticket,
            )
        self.DeclareInitializationUnrestrictedUpdateEvent(self._check)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._advance)

    def snapshot(self, context: Context) -> Snapshot:
        """The bodies, at the time of the Context."""
        return context.get_abstract_state(int(self._snapshot)).get_value()

    def motions(self, context: Context) -> Motions:
        """How the geometries move now, in W."""
        poses, velocities = self._poses.Eval(context), self._velocities.Eval(context)
        X = [poses[t.body] @ t.X_BG for t in self.touching]
        arms = [poses[t.body].rotation() @ t.X_BG.translation() for t in self.touching]
        V = [velocities[t.body].Shift(r) for t, r in zip(self.touching, arms, strict=True)]
        return Motions(
            np.array([x.translation() for x in X]),
            np.array([x.rotation().matrix() for x in X]),
            np.array([v.translational() for v in V]),
            np.array([v.rotational() for v in V]),
        )

    def _check(self, context: Context, state: State) -> EventStatus:
        """Refuse tools that start inside of material.

        Raises:
            ValueError: names them and says how deep.
        """
        if self.snapshot(context).state.step == 0:
            deep = self.scene.overlaps(self.motions(context))
            if deep:
                told = ", ".join(f"{name} by {1e3 * depth:.2g} mm" for name, depth in deep.items())
                raise ValueError(f"material overlaps at the start: {told}; move one of them away")
        return EventStatus.DidNothing()

    def _advance(self, context: Context, state: State) -> EventStatus:
        rate, until = self._settle
        damping = rate if context.get_time() < until else 0.0
        motions = self.motions(context)
        new = self.scene.advance(self.snapshot(context), motions, self.period, damping)
        state.get_mutable_abstract_state(int(self._snapshot)).set_value(new)
        return EventStatus.Succeeded()

    def _apply(self, context: Context, out: Value) -> None:
        snapshot, forces = self.snapshot(context), []
        for t, f, m in zip(self.touching, snapshot.force, snapshot.moment, strict=True):
            if t.body == BodyIndex(0):
                continue
            applied = ExternallyAppliedSpatialForce()
            applied.body_index = t.body
            applied.p_BoBq_B = t.X_BG.translation()
            applied.F_Bq_W = SpatialForce(tau=m, f=f)
            forces.append(applied)
        out.set_value(forces)

    def _wrench(self, context: Context, name: str) -> np.ndarray:
        snapshot, poses = self.snapshot(context), self._poses.Eval(context)
        total = SpatialForce.Zero()
        for t, f, m in zip(self.touching, snapshot.force, snapshot.moment, strict=True):
            if t.name == name:
                arm = poses[t.body].rotation() @ t.X_BG.translation()
                total += SpatialForce(tau=m, f=f).Shift(-arm)
        return total.get_coeffs()


def touching(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    bodies: Sequence[RigidBody] | None,
    contact: Mapping[str, Contact],
    spacing: float,
) -> list[Touching]:
    """The collision geometries of some bodies of a plant, or of all.

    Raises:
        ValueError: a contact is stated for a body that has no collision geometry, or a shape that
            cannot touch material.
    """
    inspector = scene_graph.model_inspector()
    if bodies is None:
        bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
    found = []
    for body in bodies:
        for geometry in plant.GetCollisionGeometriesForBody(body):
            stated = contact.get(body.name(), friction(inspector, geometry))
            shape = solid(inspector.GetShape(geometry), spacing)
            tool = Tool(inspector.GetName(geometry), shape, stated)
            X_BG = inspector.GetPoseInFrame(geometry)
            found.append(Touching(body.index(), body.name(), X_BG, tool))
    unknown = set(contact) - {t.name for t in found}
    if unknown:
        raise ValueError(
            f"contact of {', '.join(sorted(unknown))}: no such body has collision geometry; those"
            f" that have are {', '.join(sorted({t.name for t in found})) or 'none'}"
        )
    return found


def _reaches(plant: MultibodyPlant, touching: Touching, region: np.ndarray) -> bool:
    """Whether a geometry moves, or stands where material may go."""
    body = plant.get_body(touching.body)
    if not plant.IsAnchored(body):
        return True
    X_WB = plant.EvalBodyPoseInWorld(plant.CreateDefaultContext(), body)
    middle = (X_WB @ touching.X_BG).inverse().multiply(region.mean(axis=0))
    reach = 0.5 * float(np.linalg.norm(np.ptp(region, axis=0)))
    return float(touching.tool.solid.distance(middle[None])[0]) < reach


def particles(shape: Shape, X_WM: RigidTransform, spacing: float) -> Body:
    """Particles that fill a shape whose geometry frame stands at X_WM."""
    outline = solid(shape, 0.5 * spacing)
    if outline.kind == "half-space":
        raise ValueError("a half-space cannot be filled with material: choose a finite shape")
    count = np.prod(2.0 * outline.reach / spacing)
    if count > MOST_PARTICLES:
        raise ValueError(
            f"{2e3 * outline.reach} mm filled by particles every {1e3 * spacing:.3g} mm would be"
            f" {count:.2g} of them, at most {MOST_PARTICLES:.0e}: enlarge dx or take a smaller body"
        )
    if outline.kind == "box":
        body = block((0.0, 0.0, 0.0), 2.0 * outline.size, spacing, 1.0)
    else:
        body = filled(outline, 2.0 * outline.reach, spacing, 1.0)
    return Body(X_WM.multiply(body.x.T).T, body.volume, 1.0)


def AddMaterial(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    material: Material | Sequence[Material],
    shape: Shape | Sequence[Shape],
    X_WM: RigidTransform | Sequence[RigidTransform],
    *,
    dx: float | None = None,
    bodies: Sequence[RigidBody] | None = None,
    contact: Mapping[str, Contact] | None = None,
    region: np.ndarray | None = None,
    period: float = PERIOD,
    settle: tuple[float, float] = (0.0, 0.0),
    mass_scale: float = 1.0,
    precision: str = "float32",
    device: str = "cpu",
) -> MaterialSystem:
    """Add soft bodies to a finalized plant and connect them to it, wrenches fed back.

    Args:
        builder: of the diagram that holds plant and scene graph.
        plant: finalized, with ``use_sampled_output_ports`` false.
        scene_graph: that the plant registered its geometry with.
        material: of the soft body, or of each of several.
        shape: of it when free of stress; its frame is M.
        X_WM: where it is.
        dx: grid spacing [m]; by default a sixth of the shortest edge.
        bodies: of the plant that touch it; by default all that have collision geometry.
        contact: by name of a body: a Coulomb coefficient, ``stick``, or ``bonded`` for what lies
            inside its geometry; by default the dynamic friction of the geometry.
        region: lower and upper corner of where it may go [m], shape [2, 3].
        period: of the exchange with the plant [s].
        settle: see ``MaterialSystem``.
        mass_scale: see ``Scene``.
        precision: of the particles.
        device: Warp device.

    Raises:
        ValueError: the plant is not finalized or samples its ports, another system already feeds
            its applied_spatial_force port, or a stated shape, contact or region does not fit.
    """
    if not plant.is_finalized():
        raise ValueError("AddMaterial needs a finalized plant: call plant.Finalize() before")
    if plant.has_sampled_output_ports():
        raise ValueError(
            "the plant samples its output ports, so that wrenches would come a step late: call"
            " plant.SetUseSampledOutputPorts(False) before Finalize()"
        )
    force = plant.get_applied_spatial_force_input_port()
    if builder.IsConnectedOrExported(force):
        raise ValueError(
            "the plant's applied_spatial_force port is in use: add an"
            " ExternallyAppliedSpatialForceMultiplexer, or give all materials to one AddMaterial"
        )
    materials, shapes, poses = (
        list(v) if isinstance(v, Sequence) else [v] for v in (material, shape, X_WM)
    )
    if not len(materials) == len(shapes) == len(poses):
        raise ValueError(
            f"{len(materials)} materials, {len(shapes)} shapes, {len(poses)} poses: one of each for"
            " every body"
        )
    edges = [np.min(2.0 * solid(s, 1e-3).reach) for s in shapes]
    dx = float(min(edges)) / 6.0 if dx is None else dx
    filled_with = [particles(s, X, 0.5 * dx) for s, X in zip(shapes, poses, strict=True)]
    if region is None:
        x = np.concatenate([b.x for b in filled_with])
        reach = ROOM * float(np.ptp(x, axis=0).max())
        region = np.stack([x.min(axis=0) - reach, x.max(axis=0) + reach])
    found = touching(plant, scene_graph, bodies, contact or {}, 0.5 * dx)
    found = [t for t in found if _reaches(plant, t, region)]
    scene = Scene(
        materials,
        filled_with,
        [t.tool for t in found],
        region=region,
        dx=dx,
        gravity=plant.gravity_field().gravity_vector(),
        mass_scale=mass_scale,
        precision=precision,
        device=device,
    )
    system = builder.AddSystem(MaterialSystem(scene, found, period=period, settle=settle))
    system.set_name("material")
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), system.GetInputPort(name))
    builder.Connect(system.GetOutputPort("applied_spatial_force"), force)
    return system
