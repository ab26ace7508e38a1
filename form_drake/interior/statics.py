"""Statics of a body whose displacements are splines, with what is seen of it as data.

In every frame the coefficients y minimise

    |D y - d|^2 / (2 sd^2) + (W(y) - W(z)) / (TRUST^2 V G),

W the work of the law's stress along the change from the last frame less that of the weight, V the
volume, G the shear modulus, and z the coefficients that balance alone would give while its tools stand
where y has them: what is seen is followed, forces balance wherever it is not, and what a tool pushes
with is free.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from form_drake.interior.resistance import Past, Resistance
from form_drake.interior.rub import Rub, Rubbed
from form_drake.motion import Body
from form_drake.motion.space import Space
from form_drake.weak.ready import halved, quadrature_cells

EXACT = 1e-6  # [m] to which a face is as its tool has it
TRUST = 1e-3  # strain to which the balance is trusted


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

    def __mul__(self, share: float) -> "Rows":
        return Rows(share * self.normal, share * self.right)


@dataclass(frozen=True)
class Grip:
    """What a tool or a support does to a face that it holds.

    Attributes:
        rows: of the displacements that it leaves, as if they had been seen.
        pushes: directions of forces on the coefficients that it may have beside those that keep the
            rows, orthonormal, shape [size, pushes].
        rub: its friction; None: none.
    """

    rows: Rows
    pushes: np.ndarray
    rub: Rub | None = None

    def force(self, y: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Of the tool on the coefficients [1/m], shape [size]."""
        kept = self.rows.right - self.rows.normal @ y
        return np.asarray(kept + self.pushes @ (self.pushes.T @ push))


@dataclass(frozen=True)
class Held:
    """Coefficients in a frame.

    Attributes:
        y: [m], shape [size].
        alone: those that balance alone would give, the tools standing as in y [m], shape [size].
        push: of the tools along the directions that are free to them [1/m], shape [size].
        rows: what is seen of it.
        past: memory of the quadrature points.
        slope: of the law's forces [1/m^2], shape [size, size].
        stiffness: that of the balance and of what holds faces, as a normal matrix [1/m^2], shape
            [size, size].
        pull: of the points that are seen, in the same units [1/m], shape [size].
        settled: whether the last step was small.
        rubbed: what friction does, by the index of the face.
        ahead: how far y has moved, from where the next frame begins [m], shape [size].
    """

    y: np.ndarray
    alone: np.ndarray
    push: np.ndarray
    rows: Rows
    past: Past
    slope: np.ndarray
    stiffness: np.ndarray
    pull: np.ndarray
    settled: bool
    rubbed: dict[int, Rubbed]
    ahead: np.ndarray


@dataclass(frozen=True)
class Forces:
    """What a law and friction answer to some coefficients, in the units of a normal matrix.

    Attributes:
        left: forces that are left over [1/m], shape [size].
        past: what the quadrature points have gone through then.
        rubs: forces of friction along faces, by their index.
        rubbing: the derivative of what friction leaves over [1/m^2], shape [size, size].
    """

    left: np.ndarray
    past: Past
    rubs: dict[int, np.ndarray]
    rubbing: np.ndarray


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
        X, share = body.gauss(cells, _few(cells, body))
        if symmetry.exchange:
            middle = 0.5 * (body.low + body.high)
            across = (X - middle)[:, symmetry.exchange]
            X, share = halved(X, share, across)
        return X, share / share.sum()

    @cached_property
    def _slopes(self) -> np.ndarray:
        """dF / dy at the points, shape [points, 9, size]."""
        return slopes(self.space, self._quadrature[0])

    @cached_property
    def _short(self) -> np.ndarray:
        return self._slopes.astype(np.float32)

    def values(self, X: np.ndarray) -> np.ndarray:
        """Displacements at points [m] by the coefficients, shape [points, 3, size]."""
        return values(self.space, X)

    @cached_property
    def _load(self) -> np.ndarray:
        """Of the weight by the modulus, shape [size]; none while the modulus is not known."""
        if not self.resistance.weighs:
            return np.zeros(self.space.size)
        X, share = self._quadrature
        # along a mirrored axis one half would pull against the other
        even = [i not in self.space.symmetry.mirrors for i in range(3)]
        load = np.einsum("p,pin,i->n", share, self.values(X), self.force * even)
        return np.asarray(load) / self.resistance.modulus

    @property
    def rest(self) -> Held:
        """Before anything has moved."""
        size = self.space.size
        none, past = np.zeros(size), Past.none(len(self._quadrature[0]))
        slope = self.slope(none, past)
        return Held(none, none, none, Rows.none(size), past, slope, slope, none, True, {}, none)

    def strains(self, y: np.ndarray) -> np.ndarray:
        """Change of F at the quadrature points, shape [points, 3, 3]."""
        return np.asarray(self._slopes.reshape(-1, self.space.size) @ y).reshape(-1, 3, 3)

    def forces(self, y: np.ndarray, grips: Sequence[Grip], last: Held) -> Forces:
        """What resists when the frame after ``last`` is at y [m], shape [size]."""
        _, share = self._quadrature
        flat, F = self._slopes.reshape(-1, self.space.size), np.eye(3) + self.strains(y)
        P, elastic = self.resistance.answer(F, last.past)
        left = flat.T @ (share[:, None] * P.reshape(-1, 9)).ravel() - self._load
        left, rubbing = left / TRUST**2, np.zeros((self.space.size,) * 2)
        rubs: dict[int, np.ndarray] = {}
        for rub in (grip.rub for grip in grips if grip.rub):
            before = last.rubbed.get(rub.face, rub.none)
            more, own, rubs[rub.face] = rub.answer(y - last.y, before)
            left, rubbing = left + more, rubbing + own
        return Forces(left, Past(F, elastic), rubs, rubbing)

    def slope(self, y: np.ndarray, past: Past) -> np.ndarray:
        """Derivative of the law's forces at y [m], shape [size, size], on from ``past`` [1/m^2]."""
        short, size = self._short, self.space.size  # slopes need fewer digits
        stiff = self._stiff(y, past).astype(np.float32)
        return (short.reshape(-1, size).T @ (stiff @ short).reshape(-1, size)).astype(float)

    def _stiff(self, y: np.ndarray, past: Past) -> np.ndarray:
        """Derivative of stress by F at the points, times their shares, shape [points, 9, 9] [1/m^2]."""
        _, share = self._quadrature
        slope = self.resistance.slope(np.eye(3) + self.strains(y), past)
        return np.asarray(share[:, None, None] / TRUST**2 * slope)

    @cached_property
    def unfolded(self) -> np.ndarray:
        """Quadrature points, and of those that an exchange of axes makes alike both, shape [points, 3]."""
        X, _ = self._quadrature
        if not (axes := list(self.space.symmetry.exchange)):
            return X
        middle, other = 0.5 * (self.body.low + self.body.high), X.copy()
        other[:, axes] = middle[axes] + (X - middle)[:, axes[::-1]]
        return np.concatenate([X, other])

    def stiff(self, y: np.ndarray, past: Past) -> np.ndarray:
        """Derivative of stress by F at ``unfolded``, times their shares, shape [points, 9, 9] [1/m^2]."""
        found = self._stiff(y, past)
        if not (axes := list(self.space.symmetry.exchange)):
            return found
        order = np.arange(3)
        order[axes] = axes[::-1]
        swap = np.arange(9).reshape(3, 3)[np.ix_(order, order)].ravel()
        return np.concatenate([found, found[:, swap][:, :, swap]]) / 2.0


def values(space: Space, X: np.ndarray) -> np.ndarray:
    """Displacements at points [m] by the coefficients of a joined space, shape [points, 3, size]."""
    (block,) = space.blocks
    return block.matrix(space.scalar.matrix(X))


def slopes(space: Space, X: np.ndarray) -> np.ndarray:
    """The same of their gradients, shape [points, 9, size]."""
    G = space.scalar.gradient(X)
    (block,) = space.blocks
    parts = [block.matrix(G[..., k]) for k in range(3)]
    return np.stack(parts, axis=2).reshape(len(X), 9, -1)


def _few(breaks: Sequence[np.ndarray], body: Body) -> list[np.ndarray]:
    """Gauss points of every cell along each axis.

    Cubic splines are so smooth that two do, and three in the cells at the ends of the body
    (Schillinger, Hossain and Hughes 2014).
    """
    rims = (
        np.isclose(ends[:-1], low) | np.isclose(ends[1:], high)
        for ends, low, high in zip(breaks, body.low, body.high, strict=True)
    )
    return [np.where(rim, 3, 2) for rim in rims]
