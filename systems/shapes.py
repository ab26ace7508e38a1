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
    exact = _exact(shape)
    if exact is not None:
        return exact
    made = _surface(shape)
    made.merge_vertices()
    if not made.is_watertight:
        raise ValueError(f"{type(shape).__name__}: its surface must be closed to touch material")
    if not made.is_winding_consistent:
        raise ValueError(
            f"{type(shape).__name__}: its triangles look to both sides of its surface: turn them outwards"
        )
    if made.volume < 0.0:
        made.invert()
    return Solid.mesh(made.vertices, made.faces, spacing)


def edges(shape: Shape) -> np.ndarray:
    """Edge lengths of the box along its frame that a shape fills [m], shape [3].

    Raises:
        ValueError: as of ``solid``.
    """
    exact = _exact(shape)
    return np.asarray(_surface(shape).extents if exact is None else 2.0 * exact.reach)


def _exact(shape: Shape) -> Solid | None:
    """What needs no surface."""
    match shape:
        case Box():
            return Solid.box(shape.size())
        case Cylinder():
            return Solid.cylinder(shape.radius(), shape.length())
        case Sphere():
            return Solid.sphere(shape.radius())
        case HalfSpace():
            return Solid.half_space()
    return None


def _surface(shape: Shape) -> trimesh.Trimesh:
    match shape:
        case Capsule():
            return trimesh.creation.capsule(shape.length(), shape.radius(), count=[SEGMENTS] * 2)
        case Ellipsoid():
            made = trimesh.creation.icosphere(subdivisions=5)
            return made.apply_scale([shape.a(), shape.b(), shape.c()])
        case Mesh() | Convex():
            return _loaded(shape)
    raise ValueError(f"a {type(shape).__name__} cannot touch material")


def _loaded(shape: Mesh | Convex) -> trimesh.Trimesh:
    name, source = type(shape).__name__, shape.source()
    if not source.is_path():
        raise ValueError(f"{name}: its mesh must be a file to touch material")
    path = Path(source.path())
    try:
        made = trimesh.load(path, force="mesh", process=True)
    except NotImplementedError:
        raise ValueError(f"{name}: {path.name} is of a kind that is not read: take .obj") from None
    if path.suffix.lower() == ".gltf":  # y is up in such a file, z in Drake
        made.apply_transform(trimesh.transformations.rotation_matrix(0.5 * np.pi, [1, 0, 0]))
    made.apply_scale(np.asarray(shape.scale3()).ravel())
    return made.convex_hull if isinstance(shape, Convex) else made


def friction(inspector: SceneGraphInspector, geometry: GeometryId) -> float:
    """Coulomb's dynamic coefficient of a geometry; 0 where none is stated."""
    properties = inspector.GetProximityProperties(geometry)
    if properties is None or not properties.HasProperty("material", "coulomb_friction"):
        return 0.0
    return float(properties.GetProperty("material", "coulomb_friction").dynamic_friction())
