"""The material point method as a part of a Drake diagram."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from form_drake.mpm.exchange import Scene, Snapshot
from form_drake.mpm.tools import Motions, Tool

PERIOD = 1e-3


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

    Raises:
        ValueError: one of these is negative.
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
        if not min(settle) >= 0.0:
            raise ValueError(f"settle: rate [1/s] and time [s] must not be negative, got {settle}")
        self.scene, self.touching = scene, tuple(touching)
        self.period, self._settle = period, settle
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        )
        self._snapshot = self.DeclareAbstractState(Value[object](scene.start()))
        ticket = {self.abstract_state_ticket(self._snapshot)}
        posed = ticket | {self.input_port_ticket(self._poses.get_index())}
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
                posed,
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
            np.array([x.translation() for x in X]).reshape(-1, 3),
            np.array([x.rotation().matrix() for x in X]).reshape(-1, 3, 3),
            np.array([v.translational() for v in V]).reshape(-1, 3),
            np.array([v.rotational() for v in V]).reshape(-1, 3),
        )

    def _check(self, context: Context, state: State) -> EventStatus:
        """Refuse tools that start inside of material, or elsewhere than where they hold it.

        Raises:
            ValueError: names them and says how deep.
        """
        if self.snapshot(context).state.step == 0:
            motions = self.motions(context)
            deep, astray = self.scene.overlaps(motions), self.scene.astray(motions)
            if deep:
                told = ", ".join(f"{name} by {1e3 * depth:.2g} mm" for name, depth in deep.items())
                raise ValueError(f"material overlaps at the start: {told}; move one of them away")
            if astray:
                raise ValueError(
                    f"{', '.join(astray)} is bonded where the plant's defaults put it, and starts"
                    " elsewhere: set these before AddMaterial, or choose grid space"
                )
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
