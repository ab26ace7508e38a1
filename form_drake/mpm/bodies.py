"""Particle sets of simple bodies and rigid initial motions."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from form_drake.effects.world import World
from form_drake.material import Material
from form_drake.mpm.model import Body
from form_drake.mpm.solids import Solid

LEVELS = 8  # of stiffness across the edge of an inclusion


def block(
    centre: Sequence[float],
    size: Sequence[float],
    spacing: float | Sequence[float],
    density: float,
) -> Body:
    """A box filled by a lattice of cells of about ``spacing`` [m], one particle in each centre.

    Its second moments are short by one over the square of the number of particles along an edge: a strip
    of so many across bends so much too easily, whatever the grid.

    Args:
        centre: of the box [m].
        size: edge lengths [m].
        spacing: wanted distance of particles [m], or along each axis; rounded so that the lattice fills
            the box.
        density: [kg/m^3].
    """
    size = np.asarray(size, dtype=float)
    counts = np.maximum(1, np.round(size / np.asarray(spacing)).astype(int))
    axes = [(np.arange(n) + 0.5) / n - 0.5 for n in counts]
    unit = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    volume = np.full(len(unit), float(np.prod(size)) / len(unit))
    return Body(np.asarray(centre) + unit * size, volume, density, size / counts)


def rigid_velocity(x: np.ndarray, v: ArrayLike, omega: ArrayLike) -> np.ndarray:
    """Velocities [m/s] of points moving rigidly about their centroid, shape [points, 3]."""
    return np.asarray(v) + np.cross(np.asarray(omega), x - x.mean(axis=0))


def spatial_inertia(mass: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Of particles about a point, rotation above translation, shape [6, 6].

    Args:
        mass: of the particles [kg], shape [particles].
        r: their places from the point [m], shape [particles, 3].
    """
    turned = np.cross(np.eye(3), r[:, None])  # by a rate about each axis
    moved = np.concatenate([turned, np.tile(np.eye(3), (len(r), 1, 1))], axis=1)
    found: np.ndarray = np.einsum("n,nai,nbi->ab", mass, moved, moved)
    return found


def filled(solid: Solid, size: Sequence[float], spacing: float, density: float) -> Body:
    """A solid filled by a cubic lattice, its volume shared out evenly.

    Args:
        solid: whose inside is filled, in its frame.
        size: edge lengths of a centred box around it [m].
        spacing: distance of particles [m].
        density: [kg/m^3].

    Raises:
        ValueError: no particle fits inside.
    """
    fine = block((0.0, 0.0, 0.0), size, 0.5 * spacing, density)
    coarse = block((0.0, 0.0, 0.0), size, spacing, density)
    volume = float(fine.volume[solid.distance(fine.x) < 0.0].sum())
    x = coarse.x[solid.distance(coarse.x) < 0.0]
    if not len(x):
        raise ValueError(f"no particle of spacing {spacing} m fits into the {solid.kind}")
    return Body(x, np.full(len(x), volume / len(x)), density)


def by_material(world: World, whole: Body) -> list[tuple[Material, Body]]:
    """A body with what a world has put into it, in parts by material.

    Args:
        world: its material, inclusions and masses.
        whole: the body; places in the world are in its coordinates.
    """
    density = np.full(len(whole.x), world.density)
    for one in world.masses:
        density += one.mass * one.ball.spread(whole.x, whole.volume) / whole.volume
    plain = Material(world.law, dict(world.values), world.density)
    factor = np.ones(len(whole.x))
    for part in world.inclusions:
        share = np.round(part.ball.share(whole.x, 2.0 * whole.half) * LEVELS) / LEVELS
        factor += (part.factor - 1.0) * share
    if not factor.min() > 0.0:
        raise ValueError("inclusions overlap where together they leave the body no stiffness")
    found = []
    for f in np.unique(factor):
        stiffer = {t.key: float(f) * world.values[t.key] for t in world.law.terms}
        own = factor == f
        part = Body(whole.x[own], whole.volume[own], density[own], whole.edges)
        found.append((plain.changed(stiffer), part))
    return found
