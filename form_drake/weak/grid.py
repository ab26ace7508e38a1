"""Test fields on a grid fixed in space: B-splines N_i e_d of a chosen width (eq. 6 of the paper)."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from form_drake.motion import Motion
from form_drake.weak.fields import Sampled

DEGREE = 3  # smooth between quadrature points


@dataclass(frozen=True)
class GridFields:
    """Tensor B-splines of one width on grid points fixed in space.

    Attributes:
        centres: of the splines [m], shape [splines, 3].
        spacing: knot spacing along every axis [m], shape [3]; a support is DEGREE + 1 wide.
        breaks: as in ``Fields``.
    """

    centres: np.ndarray
    spacing: np.ndarray
    breaks: tuple[np.ndarray, ...]
    material: bool = False
    fixed: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(
            f"{'xyz'[d]} about {' '.join(f'{1e3 * v:.3g}' for v in c)} mm"
            for c in self.centres
            for d in range(3)
        )

    @property
    def tools(self) -> tuple[str, ...]:
        return ()

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        return {}

    @property
    def reach(self) -> np.ndarray:
        """Half width of a support along every axis [m], shape [3]."""
        return 0.5 * (DEGREE + 1) * self.spacing

    def at(self, motion: Motion) -> Sampled:
        knots = np.arange(DEGREE + 2) - 0.5 * (DEGREE + 1)
        spline = BSpline.basis_element(knots, extrapolate=False)
        value, slope = [], []
        for a in range(3):
            own, index = np.unique(self.centres[:, a], return_inverse=True)
            s = (motion.x[:, None, :, a] - own[:, None]) / self.spacing[a]
            value.append(np.nan_to_num(spline(s))[:, index])
            slope.append(np.nan_to_num(spline.derivative(1)(s))[:, index] / self.spacing[a])
        t, n, q = value[0].shape
        found, gradient = np.zeros((t, n, 3, q, 3)), np.zeros((t, n, 3, q, 3, 3))
        for d in range(3):
            found[:, :, d, :, d] = value[0] * value[1] * value[2]
            for c in range(3):
                parts = [slope[a] if a == c else value[a] for a in range(3)]
                gradient[:, :, d, :, d, c] = parts[0] * parts[1] * parts[2]
        return Sampled(found.reshape(t, 3 * n, q, 3), gradient.reshape(t, 3 * n, q, 3, 3))

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        """Which fields vanish at points of the boundary [m], shape [fields]."""
        apart = np.abs(boundary - self.centres[:, None]) >= self.reach * (1.0 - 1e-9)
        found: np.ndarray = np.repeat(apart.any(axis=2).all(axis=1), 3)
        return found


def grid_fields(
    low: np.ndarray,
    high: np.ndarray,
    spacing: np.ndarray,
    breaks: tuple[np.ndarray, ...],
) -> GridFields:
    """Fields whose supports fill the box [low, high], every second knot [m]."""
    room = high - low - (DEGREE + 1) * spacing
    steps = [
        middle + 2.0 * step * (np.arange(n) - 0.5 * (n - 1))
        for middle, step, n in zip(
            0.5 * (low + high),
            spacing,
            1 + np.maximum(room / (2.0 * spacing), 0.0).astype(int),
            strict=True,
        )
    ]
    centres = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    return GridFields(centres, spacing, breaks)
