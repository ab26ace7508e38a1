"""Soft bodies added to a plant, in the lines of ``AddMultibodyPlantSceneGraph``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.geometry import SceneGraph, Shape
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import DiagramBuilder

from form_drake.effects import CATALOGUE, Effect, World
from form_drake.effects.acting import changed, known, placed
from form_drake.laws.values import check_moduli
from form_drake.material import Material
from form_drake.mpm.bodies import block, by_material, filled
from form_drake.mpm.exchange import Scene
from form_drake.mpm.model import Body
from form_drake.systems.material import PERIOD, MaterialSystem
from form_drake.systems.shapes import edges, solid
from form_drake.systems.touching import (
    Contact,
    bearable,
    default_motions,
    reaches,
    rubbing,
    touching,
)

MOST_PARTICLES = 2_000_000
ROOM = 1.0  # of a body's longest edge, left around it by default

GRIDS = ("rest", "space")


def particles(shape: Shape, X_WM: RigidTransform, spacing: float | np.ndarray) -> Body:
    """Particles that fill a shape whose geometry frame stands at X_WM, ``spacing`` apart along its axes."""
    spacing = np.broadcast_to(spacing, 3)
    outline = solid(shape, 0.5 * float(spacing.min()))
    if outline.kind == "half-space":
        raise ValueError("a half-space cannot be filled with material: choose a finite shape")
    count = np.prod(2.0 * outline.reach / spacing)
    if count > MOST_PARTICLES:
        raise ValueError(
            f"{2e3 * outline.reach} mm filled by particles every {1e3 * spacing.min():.3g} mm would be"
            f" {count:.2g} of them, at most {MOST_PARTICLES:.0e}: enlarge dx or take a smaller body"
        )
    if outline.kind == "box":
        body = block((0.0, 0.0, 0.0), 2.0 * outline.size, spacing, 1.0)
    else:
        body = filled(outline, 2.0 * outline.reach, spacing, 1.0)
    turned = np.abs(X_WM.rotation().matrix())
    along = body.edges is not None and np.allclose(turned, np.round(turned))
    edges = np.round(turned) @ body.edges if along else None
    return Body(X_WM.multiply(body.x.T).T, body.volume, 1.0, edges)


def _apart(
    shapes: Sequence[Shape], poses: Sequence[RigidTransform], bodies: Sequence[Body]
) -> None:
    """Refuse bodies that lie in each other: on one grid they would never come apart.

    Raises:
        ValueError: a particle of one is inside of another.
    """
    if len(bodies) < 2:
        return
    for n, (shape, X_WM) in enumerate(zip(shapes, poses, strict=True)):
        outline = solid(shape, float(np.cbrt(bodies[n].volume.min())))
        for k, other in enumerate(bodies):
            p_MQ = X_WM.inverse().multiply(other.x.T).T
            if k != n and np.any(outline.distance(p_MQ) < 0.0):
                raise ValueError(f"bodies {n} and {k} overlap: move one of them, X_WM says where")


def over_rest(materials: Sequence[Material], grid: str) -> bool:
    """Whether the grid lies over the rest shape.

    Raises:
        ValueError: it cannot, or ``grid`` is unknown.
    """
    if grid not in GRIDS:
        raise ValueError(f"grid {grid!r}: choose from {', '.join(GRIDS)}")
    solid = len(materials) == 1 and materials[0].law.flow in ("elastic", "plastic")
    if grid == "rest" and not solid:
        names = ", ".join(m.law.name for m in materials)
        raise ValueError(f"a grid over the rest shape is for one solid, got {names}: choose space")
    return grid == "rest"


def _counts(per_cell: Sequence[int]) -> np.ndarray:
    """Particles in a cell along three axes.

    Raises:
        ValueError: these are no three positive whole numbers.
    """
    counts = np.asarray(per_cell)
    if counts.shape != (3,) or np.any(counts < 1) or np.any(counts != np.round(counts)):
        raise ValueError(
            f"particles per cell {list(per_cell)}: three whole numbers are wanted, as [2, 2, 2]"
        )
    return counts


def acted(
    materials: Sequence[Material],
    bodies: Sequence[Body],
    gravity: np.ndarray,
    effects: Mapping[str, Effect],
) -> tuple[list[tuple[Material, Body]], dict[str, Any], float]:
    """Parts of bodies by material, what else a ``Scene`` needs, and the friction of frictionless tools.

    Raises:
        ValueError: effects of one body among several, one that a file cannot state, that lies outside
            of the body, or that a station cannot show.
    """
    if not any(m.effects for m in materials):
        return list(zip(materials, bodies, strict=True)), {"gravity": gravity}, 0.0
    if len(materials) > 1:
        raise ValueError(f"effects act on one body alone, here are {len(materials)}")
    (material,), (body,) = materials, bodies
    if material.density is None:
        raise ValueError(f"a material of law {material.law.name} states no density")
    plain = World(material.law, material.values, material.density, np.asarray(gravity))
    acting = known(material.effects, material.law, effects)
    placed(acting, (body.x - body.half).min(axis=0), (body.x + body.half).max(axis=0))
    world = changed(plain, acting)
    if world.adhesion or world.slipping or world.slippery:
        raise ValueError(
            "adhesion and floor-slip act at faces of a block that plates hold, as predict simulates"
            " it: state the contact of the tools of a station instead"
        )
    own = {k: getattr(world, k) for k in ("gravity", "drag", "swelling", "memories")}
    return by_material(world, body), own, world.friction


def _ready(builder: DiagramBuilder, plant: MultibodyPlant, period: float) -> None:
    """Refuse a plant to which no material can be added, as ``AddMaterial`` says."""
    if not plant.is_finalized():
        raise ValueError("AddMaterial needs a finalized plant: call plant.Finalize() before")
    if plant.has_sampled_output_ports():
        raise ValueError(
            "the plant samples its output ports, so that wrenches would come a step late: call"
            " plant.SetUseSampledOutputPorts(False) before Finalize()"
        )
    if not 0.0 < period < np.inf:
        raise ValueError(f"period: a positive number of seconds is wanted, got {period:g}")
    steps = period / plant.time_step() if plant.time_step() else 1.0
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
        raise ValueError(
            f"period {period:g} s: one or several steps of the plant are wanted, which are"
            f" {plant.time_step():g} s: forces of the material would act longer than they were"
        )
    fed = builder.connection_map()
    if any(isinstance(to, MaterialSystem) and fed[to, n][0] is plant for to, n in fed):
        raise ValueError("the plant has material: give all to one AddMaterial, so that it meets")
    force = plant.get_applied_spatial_force_input_port()
    if builder.IsConnectedOrExported(force) and (plant, force.get_index()) not in fed:
        raise ValueError(
            "the plant's applied_spatial_force port is an input of the diagram: feed it by a system in it"
        )


def _connect(builder: DiagramBuilder, plant: MultibodyPlant, material: MaterialSystem) -> None:
    """Connect material and plant; wrenches act beside those that another system has fed it."""
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), material.GetInputPort(name))
    wrenches = material.GetOutputPort("applied_spatial_force")
    force = plant.get_applied_spatial_force_input_port()
    others = builder.connection_map().get((plant, force.get_index()))
    if others is not None:
        source, n = others
        both = builder.AddSystem(ExternallyAppliedSpatialForceMultiplexer(2))
        builder.Disconnect(source.get_output_port(n), force)
        builder.Connect(source.get_output_port(n), both.get_input_port(0))
        builder.Connect(wrenches, both.get_input_port(1))
        wrenches = both.get_output_port()
    builder.Connect(wrenches, force)


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
    grid: str = "space",
    per_cell: Sequence[int] = (2, 2, 2),
    period: float = PERIOD,
    settle: tuple[float, float] = (0.0, 0.0),
    mass_scale: float = 1.0,
    effects: Mapping[str, Effect] = CATALOGUE,
    precision: str = "float32",
    device: str = "cpu",
) -> MaterialSystem:
    """Add soft bodies to a finalized plant and connect them to it, wrenches fed back.

    Args:
        builder: of the diagram that holds plant and scene graph.
        plant: finalized, with ``use_sampled_output_ports`` false; what already feeds its
            ``applied_spatial_force`` goes on to act.
        scene_graph: that the plant registered its geometry with.
        material: of the soft body, or of each of several; effects act in one alone.
        shape: of it when free of stress; its frame is M.
        X_WM: where it is.
        dx: grid spacing [m]; by default a sixth of the shortest edge.
        bodies: of the plant that touch it; by default all that have collision geometry.
        contact: by name of a body, as MODEL::BODY where several have it: a Coulomb coefficient,
            ``stick``, or ``bonded`` for what lies inside its geometry; by default the dynamic friction
            of the geometry.
        region: lower and upper corner of where it may go [m], shape [2, 3].
        grid: over the ``rest`` shape, for one solid that stays in one piece; or in ``space``, for all that
            flows, and bodies that meet.
        per_cell: particles in a cell of the grid along each axis of a shape.
        period: of the exchange with the plant [s], one or several of its steps.
        settle: see ``MaterialSystem``.
        mass_scale: see ``Scene``.
        effects: of which materials may name some, by id.
        precision: of the particles.
        device: Warp device.

    Raises:
        ValueError: the plant is not finalized or samples its ports, its steps do not fit into the
            period, it has material already, or an applied_spatial_force port that is exported; a
            number, shape, contact or region does not fit, bodies overlap, one of the plant's holds
            more than it weighs, or a modulus is not positive.
    """
    _ready(builder, plant, period)
    materials, shapes, poses = (
        list(v) if isinstance(v, Sequence) else [v] for v in (material, shape, X_WM)
    )
    if not len(materials) == len(shapes) == len(poses):
        raise ValueError(
            f"{len(materials)} materials, {len(shapes)} shapes, {len(poses)} poses: one of each for"
            " every body"
        )
    for one in materials:
        check_moduli(one.law, one.values)
    dx = float(min(edges(s).min() for s in shapes)) / 6.0 if dx is None else dx
    for name, value in (("dx", dx), ("mass_scale", mass_scale)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"{name}: a positive number is wanted, got {value}")
    apart = dx / _counts(per_cell)
    filled_with = [particles(s, X, apart) for s, X in zip(shapes, poses, strict=True)]
    _apart(shapes, poses, filled_with)
    if region is None:
        x = np.concatenate([b.x for b in filled_with])
        reach = ROOM * float(np.ptp(x, axis=0).max())
        region = np.stack([x.min(axis=0) - reach, x.max(axis=0) + reach])
    region = np.asarray(region, dtype=float)
    if region.shape != (2, 3):
        raise ValueError(f"region: two corners are wanted, shape [2, 3], got {region.shape}")
    found = touching(plant, scene_graph, bodies, contact or {}, 0.5 * dx)
    rest = over_rest(materials, grid)  # whose region holds the body at rest alone
    found = [t for t in found if rest or reaches(plant, t, region)]
    gravity = plant.gravity_field().gravity_vector()
    parts, acting, friction = acted(materials, filled_with, gravity, effects)
    found = rubbing(found, friction)
    scene = Scene(
        [m for m, _ in parts],
        [b for _, b in parts],
        [t.tool for t in found],
        region=region,
        dx=dx,
        mass_scale=mass_scale,
        **acting,
        total=rest,
        precision=precision,
        device=device,
    )
    still, whole = default_motions(plant, found), scene.simulation.body
    scene.bear(bearable(plant, found, still, replace(whole, x=scene.rest)))
    scene.tie(still)
    system = builder.AddSystem(MaterialSystem(scene, found, period=period, settle=settle))
    system.set_name("material")
    _connect(builder, plant, system)
    return system
