"""Statics of a body whose displacements are splines, with what is seen of it as data.

In every frame the coefficients y minimise, to first order,

    |D y - d|^2 / (2 sd^2) + W / (TRUST^2 V G),

W the work of the law's stress along the change from the last frame less that of the weight, V the
volume and G the shear modulus: what is seen is followed, and forces balance wherever it is not.
Newton's steps take the law's own slope, plastic flow included.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from form_drake.interior.resistance import Past, Resistance
from form_drake.motion import Body
from form_drake.motion.space import Space
from form_drake.weak.ready import halved, quadrature_cells

GAUSS = 3  # points along each axis of a cell
TRUST = 1e-3  # strain to which the balance is trusted
ROUNDS = 25  # of Newton's steps in a frame
CLOSE = 1e-4  # change of a deformation gradient in a step, below which it is the last
LONGEST = 0.2  # change of a deformation gradient in a step


@dataclass(frozen=True)
class Rows:
    """What is seen of a frame, gathered: normal matrix and right side of the coefficients.

    Attributes:
        normal: D^T D / sd^2 [1/m^2], shape [size, size].
        right: D^T d / sd^2 [1/m], shape [size].
    """

    normal: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, D: np.ndarray, d: np.ndarray, sd: float) -> "Rows":
        """Rows D [..., size] of what is seen, d [m], with a standard deviation [m]."""
        flat = D.reshape(-1, D.shape[-1])
        return cls(flat.T @ flat / sd**2, flat.T @ d.ravel() / sd**2)

    @classmethod
    def none(cls, size: int) -> "Rows":
        """Nothing is seen."""
        return cls(np.zeros((size, size)), np.zeros(size))

    def __add__(self, other: "Rows") -> "Rows":
        return Rows(self.normal + other.normal, self.right + other.right)


@dataclass(frozen=True)
class Held:
    """Coefficients in a frame.

    Attributes:
        y: [m], shape [size].
        rows: what is seen of it.
        past: memory of the quadrature points.
        stiffness: that of the balance, as a normal matrix [1/m^2], shape [size, size].
        pull: forces that are left over, in the same units [1/m], shape [size].
        settled: whether the last step was small.
    """

    y: np.ndarray
    rows: Rows
    past: Past
    stiffness: np.ndarray
    pull: np.ndarray
    settled: bool


@dataclass(frozen=True)
class Statics:
    """A box of a material.

    Attributes:
        space: of the displacements, joined.
        body: the box.
        resistance: of the material.
        force: weight per volume [N/m^3], shape [3].
    """

    space: Space
    body: Body
    resistance: Resistance
    force: np.ndarray

    @cached_property
    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Points [m] and shares of the volume; of those that symmetry makes alike, one."""
        symmetry, body = self.space.symmetry, self.body
        cells = quadrature_cells(self.space, (), body, symmetry.mirrors)
        X, share = body.gauss(cells, GAUSS)
        if symmetry.exchange:
            middle = 0.5 * (body.low + body.high)
            across = (X - middle)[:, symmetry.exchange]
            X, share = halved(X, share, across)
        return X, share / share.sum()

    @cached_property
    def _slopes(self) -> np.ndarray:
        """dF / dy at the points, shape [points, 9, size]."""
        X, _ = self._quadrature
        G = self.space.scalar.gradient(X)
        (block,) = self.space.blocks
        parts = [block.matrix(G[..., k]) for k in range(3)]
        return np.stack(parts, axis=2).reshape(len(X), 9, -1)

    def values(self, X: np.ndarray) -> np.ndarray:
        """Displacements at points [m] by the coefficients, shape [points, 3, size]."""
        (block,) = self.space.blocks
        return block.matrix(self.space.scalar.matrix(X))

    @cached_property
    def _load(self) -> np.ndarray:
        """Of the weight by the modulus, shape [size]; none while the modulus is not known."""
        if not self.resistance.weighs:
            return np.zeros(self.space.size)
        X, share = self._quadrature
        load = np.einsum("p,pin,i->n", share, self.values(X), self.force)
        return np.asarray(load) / self.resistance.modulus

    @property
    def rest(self) -> Held:
        """Before anything has moved."""
        none = np.zeros(self.space.size)
        past = Past.none(len(self._quadrature[0]))
        return Held(none, Rows.none(len(none)), past, np.zeros((len(none), len(none))), none, True)

    def held(self, rows: Rows, last: Held) -> Held:
        """The frame after ``last``.

        Raises:
            ValueError: no motion passes through what is seen without folding the body.
        """
        _, share = self._quadrature
        slopes, size = self._slopes, self.space.size
        flat, weigh = slopes.reshape(-1, size), share[:, None] / TRUST**2
        y = last.y
        for _ in range(ROUNDS):
            F = np.eye(3) + (flat @ y).reshape(-1, 3, 3)
            P, slope, elastic = self.resistance.answer(F, last.past)
            pull = flat.T @ (weigh * P.reshape(-1, 9)).ravel() - self._load / TRUST**2
            stiffness = flat.T @ ((weigh[..., None] * slope) @ slopes).reshape(-1, size)
            step = np.linalg.solve(rows.normal + stiffness, rows.right - rows.normal @ y - pull)
            strain = float(np.abs(flat @ step).max())
            if not np.isfinite(strain):
                raise ValueError(
                    "no motion inside the body passes through the points of its surface"
                )
            settled = strain < CLOSE
            y = y + min(1.0, LONGEST / max(strain, LONGEST)) * step
            if settled:
                break
        return Held(y, rows, Past(F, elastic), stiffness, pull, settled)
