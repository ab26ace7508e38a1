"""Coulomb's friction under a face that slides along its tool."""

from dataclasses import dataclass

import numpy as np

STIFF = 1e9  # normal matrix of a point that sticks [1/m^2]: it gives by a few micrometres
FAINT = 1e-6  # of the largest singular value, below which pressures do not show in the coefficients


@dataclass(frozen=True)
class Rubbed:
    """What friction does at points of a face, as forces in the units of a normal matrix.

    Attributes:
        force: along the face [1/m], shape [points, 2].
        most: largest size that it may have [1/m], shape [points].
    """

    force: np.ndarray
    most: np.ndarray


@dataclass(frozen=True)
class Rub:
    """A face of a body that its tool rubs.

    A point sticks elastically until friction has its largest size, and slides then: the return to the cone
    of Simo and Laursen (1992).

    Attributes:
        face: its index.
        along: displacements of points along the face by the coefficients, shape [points, 2, size].
        inward: those into the body, shape [points, size].
        friction: coefficient.
    """

    face: int
    along: np.ndarray
    inward: np.ndarray
    friction: float

    @property
    def none(self) -> Rubbed:
        """Before anything has pressed."""
        return Rubbed(np.zeros(self.along.shape[:2]), np.zeros(len(self.along)))

    def answer(self, step: np.ndarray, last: Rubbed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What friction does after a step of the coefficients.

        Args:
            step: since the last frame [m], shape [size].
            last: what it did there, and how large it may be now.

        Returns:
            Forces left over [1/m], shape [size]; their derivative [1/m^2], shape [size, size]; forces along
            the face, shape [points, 2].
        """
        trial = last.force - STIFF * (self.along @ step)
        size = np.maximum(np.linalg.norm(trial, axis=1), np.finfo(float).tiny)
        share = last.most / np.maximum(size, last.most)
        force, way = share[:, None] * trial, trial / size[:, None]
        sliding = (share < 1.0)[:, None, None] * way[:, :, None] * way[:, None, :]
        give = STIFF * share[:, None, None] * (np.eye(2) - sliding)
        flat = self.along.reshape(-1, self.along.shape[-1])
        slope = flat.T @ (give @ self.along).reshape(flat.shape)
        return -(flat.T @ force.ravel()), slope, force

    def after(self, force: np.ndarray, held: np.ndarray) -> Rubbed:
        """What the next frame begins with.

        Args:
            force: along the face, as of ``answer``.
            held: forces of the tool on the coefficients [1/m], shape [size].
        """
        pressure = np.linalg.lstsq(self.inward.T, held, rcond=FAINT)[0]
        return Rubbed(force, self.friction * np.maximum(pressure, 0.0))
