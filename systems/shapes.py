"""Drake's geometries as solids that touch material."""

from pathlib import Path

import numpy as np
import trimesh
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    HalfSpace,
    Mesh,
    SceneGraphInspector,
    Shape,
    Sphere,
)

from form_drake.mpm.solids import Solid

SEGMENTS = 48  # around a round shape that becomes a mesh


def solid(shape: Shape, spacing: float) -> Solid:
    """The solid of a Drake shape, in its geometry frame.

    Args:
        shape: box, cylinder, sphere, half-space, capsule, ellipsoid, mesh or convex mesh.
        spacing: of the grid that a mesh's distance is baked on [m].

    Raises:
        ValueError: another shape, or a mesh file that holds no closed surface.
    """
    match shape:
        case Box():
            return Solid.box(shape.size())
        case Cylinder():
            return Solid.cylinder(shape.radius(), shape.length())
        case Sphere():
            return Solid.sphere(shape.radius())
        case HalfSpace():
            return Solid.half_space()
        case Capsule():
            made = trimesh.creation.capsule(shape.length(), shape.radius(), count=[SEGMENTS] * 2)
        case Ellipsoid():
            made = trimesh.creation.icosphere(subdivisions=5)
            made.apply_scale([shape.a(), shape.b(), shape.c()])
        case Mesh() | Convex():
            made = _loaded(shape)
        case _:
            raise ValueError(f"a {type(shape).__name__} cannot touch material")
    made.merge_vertices()
    if not made.is_watertight:
        raise ValueError(f"{type(shape).__name__}: its surface must be closed to touch material")
    return Solid.mesh(made.vertices, made.faces, spacing)


def _loaded(shape: Mesh | Convex) -> trimesh.Trimesh:
    source = shape.source()
    if not source.is_path():
        raise ValueError(f"{type(shape).__name__}: its mesh must be a file to touch material")
    made = trimesh.load(Path(source.path()), force="mesh", process=True)
    made.apply_scale(np.asarray(shape.scale3()).ravel())
    return made.convex_hull if isinstance(shape, Convex) else made


def friction(inspector: SceneGraphInspector, geometry: GeometryId) -> float:
    """Coulomb's dynamic coefficient of a geometry; 0 where none is stated."""
    properties = inspector.GetProximityProperties(geometry)
    if properties is None or not properties.HasProperty("material", "coulomb_friction"):
        return 0.0
    return float(properties.GetProperty("material", "coulomb_friction").dynamic_friction())
