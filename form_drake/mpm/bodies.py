"""Particle sets of simple bodies and rigid initial motions."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from form_drake.mpm.simulation import Body
from form_drake.mpm.solids import Solid


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
