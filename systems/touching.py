"""What of a plant touches material: collision geometries, their contact and where they are."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JacobianWrtVariable, RigidBody

from form_drake.mpm.bodies import spatial_inertia
from form_drake.mpm.model import Body
from form_drake.mpm.tools import Motions, Tool
from form_drake.systems.material import Touching
from form_drake.systems.shapes import friction, solid

Contact = float | Literal["stick", "bonded"]


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
            name = body_name(plant, body)
            stated = contact.get(name, friction(inspector, geometry))
            try:
                shape = solid(inspector.GetShape(geometry), spacing)
            except ValueError as error:
                raise ValueError(f"body {name}: {error}; leave it out of bodies") from None
            tool = Tool(inspector.GetName(geometry), shape, stated)
            X_BG = inspector.GetPoseInFrame(geometry)
            found.append(Touching(body.index(), name, X_BG, tool))
    unknown = set(contact) - {t.name for t in found}
    if unknown:
        raise ValueError(
            f"contact of {', '.join(sorted(unknown))}: no such body has collision geometry; those"
            f" that have are {', '.join(sorted({t.name for t in found})) or 'none'}"
        )
    return found


def body_name(plant: MultibodyPlant, body: RigidBody) -> str:
    """Of a body: with its model's, where bodies of several models share it."""
    alone = plant.NumBodiesWithName(body.name()) == 1
    return body.name() if alone else body.scoped_name().get_full()


def reaches(plant: MultibodyPlant, touching: Touching, region: np.ndarray) -> bool:
    """Whether a geometry moves, or stands where material may go."""
    body = plant.get_body(touching.body)
    if not plant.IsAnchored(body):
        return True
    X_WB = plant.EvalBodyPoseInWorld(plant.CreateDefaultContext(), body)
    middle = (X_WB @ touching.X_BG).inverse().multiply(region.mean(axis=0))
    reach = 0.5 * float(np.linalg.norm(np.ptp(region, axis=0)))
    return touching.tool.solid.within(middle, reach)


def rubbing(touching: Sequence[Touching], friction: float) -> list[Touching]:
    """Geometries, those that are stated to be frictionless with a friction after all.

    Raises:
        ValueError: none is.
    """
    smooth = [t.tool.contact == 0.0 for t in touching]
    if friction and not any(smooth):
        names = ", ".join(sorted({t.name for t in touching}))
        raise ValueError(f"tool-friction: none of {names} is stated to be frictionless")
    return [
        replace(t, tool=replace(t.tool, contact=friction)) if own and friction else t
        for t, own in zip(touching, smooth, strict=True)
    ]


def default_motions(plant: MultibodyPlant, touching: Sequence[Touching]) -> Motions:
    """Where geometries are in the plant's default Context, at rest."""
    context = plant.CreateDefaultContext()
    X = [plant.EvalBodyPoseInWorld(context, plant.get_body(t.body)) @ t.X_BG for t in touching]
    p = np.array([x.translation() for x in X]).reshape(-1, 3)
    still = Motions.at_rest(p)
    return replace(still, R_WT=np.array([x.rotation().matrix() for x in X]).reshape(-1, 3, 3))


def bearable(
    plant: MultibodyPlant, touching: Sequence[Touching], still: Motions, body: Body
) -> np.ndarray:
    """Inertia of the material that moving bodies hold, by their own, shape [geometries].

    Material follows them in a period, and they its push in the next: they would throw each other.

    Args:
        plant: of the bodies.
        touching: their geometries.
        still: where these are by default.
        body: particles in W.

    Raises:
        ValueError: it is as much as that, or more: names one, and says what it holds.
    """
    shares = np.zeros(len(touching))
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    for n, t in enumerate(touching):
        holder = plant.get_body(t.body)
        if t.tool.contact != "bonded" or plant.IsAnchored(holder):
            continue
        away = body.x - still.p_WT[n]
        inside = t.tool.solid.distance(away @ still.R_WT[n]) < 0.0
        J = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, holder.body_frame(), t.X_BG.translation(), world, world
        )
        added = J.T @ spatial_inertia(body.mass[inside], away[inside]) @ J
        share = np.linalg.eigvals(np.linalg.solve(plant.CalcMassMatrix(context), added)).real.max()
        if share >= 1.0:
            raise ValueError(
                f"{t.name} holds {1e3 * body.mass[inside].sum():.3g} g of material, whose inertia is"
                f" {share:.3g} times its own: make it heavier than what it holds"
            )
        shares[n] = share
    return shares
