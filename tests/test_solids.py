"""Shapes of tools and bodies: distances, meshes, and what fills them."""

import numpy as np
import pytest
import trimesh

from form_drake.mpm.bodies import filled
from form_drake.mpm.solids import Solid


def meshed(solid):
    if solid.kind == "box":
        made = trimesh.creation.box(2.0 * solid.size)
    elif solid.kind == "sphere":
        made = trimesh.creation.icosphere(subdivisions=5, radius=solid.size[0])
    else:
        made = trimesh.creation.cylinder(solid.size[0], 2.0 * solid.size[2], sections=256)
    return Solid.mesh(made.vertices, made.faces, 1e-3)


SOLIDS = (Solid.box([0.02, 0.03, 0.04]), Solid.cylinder(0.01, 0.016), Solid.sphere(0.012))


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda s: s.kind)
def test_baked_mesh_is_the_shape(solid):
    """A mesh's distance agrees with the exact one where particles touch."""
    rng = np.random.default_rng(0)
    p = rng.uniform(-1.3, 1.3, (4000, 3)) * solid.size
    exact = solid.distance(p)
    near = np.abs(exact) < 3e-3
    assert near.sum() > 300
    error = np.abs(meshed(solid).distance(p) - exact)[near]
    assert np.median(error) < 2e-5
    assert error.max() < 4e-4  # beside edges: a fraction of the 1 mm cells


def test_distance_is_the_nearest_point():
    """Against the distance to points sampled on the surface, and its sign inside."""
    solid = Solid.cylinder(0.01, 0.03)
    surface = trimesh.creation.cylinder(0.01, 0.03, sections=512)
    points, _ = trimesh.sample.sample_surface(surface, 60000, seed=0)
    p = np.random.default_rng(1).uniform(-0.025, 0.025, (200, 3))
    nearest = np.min(np.linalg.norm(p[:, None] - points[None], axis=2), axis=1)
    inside = (np.hypot(p[:, 0], p[:, 1]) < 0.01) & (np.abs(p[:, 2]) < 0.015)
    assert solid.distance(p) == pytest.approx(np.where(inside, -nearest, nearest), abs=3e-4)


def test_filled_keeps_the_volume():
    body = filled(Solid.sphere(0.01), [0.02] * 3, 1e-3, 1000.0)
    assert body.volume.sum() == pytest.approx(4 / 3 * np.pi * 1e-6, rel=0.01)
    assert np.linalg.norm(body.x, axis=1).max() < 0.01
