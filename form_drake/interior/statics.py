"""Statics of a body whose displacements are splines, with what is seen of it as data.

In every frame the coefficients y minimise

    |D y - d|^2 / (2 sd^2) + (W(y) - W(z)) / (TRUST^2 V G),

W the work of the law's stress along the change from the last frame less that of the weight, V the
volume, G the shear modulus, and z the coefficients that balance alone would give while its tools stand
where y has them: what is seen is followed, forces balance wherever it is not, and what a tool pushes
with is free. Newton's steps take the law's own slope, plastic flow included.
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

TRUST = 1e-3  # strain to which the balance is trusted
ROUNDS = 40  # of Newton's steps in a frame
FLOAT = 1e-6  # share of what is seen that keeps a body which nothing holds from floating away
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
        stiffness: that of the balance, as a normal matrix [1/m^2], shape [size, size].
        pull: forces that are left over, in the same units [1/m], shape [size].
        settled: whether the last step was small.
        rubbed: what friction does, by the index of the face.
        ahead: how far y has moved, from where the next frame begins [m], shape [size].
    """

    y: np.ndarray
    alone: np.ndarray
    push: np.ndarray
    rows: Rows
    past: Past
    stiffness: np.ndarray
    pull: np.ndarray
    settled: bool
    rubbed: dict[int, Rubbed]
    ahead: np.ndarray


@dataclass(frozen=True)
class Forces:
    """What a law answers to some coefficients, in the units of a normal matrix.

    Attributes:
        left: forces that are left over [1/m], shape [size].
        slope: their derivative [1/m^2], shape [size, size].
        past: what the quadrature points have gone through then.
        rubs: forces of friction along faces, by their index.
    """

    left: np.ndarray
    slope: np.ndarray
    past: Past
    rubs: dict[int, np.ndarray]

    def equation(
        self, rows: Rows, y: np.ndarray, push: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right side of the step from y to where rows, forces and push agree."""
        return rows.normal + self.slope, rows.right - rows.normal @ y - self.left + push


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
        X, _ = self._quadrature
        G = self.space.scalar.gradient(X)
        (block,) = self.space.blocks
        parts = [block.matrix(G[..., k]) for k in range(3)]
        return np.stack(parts, axis=2).reshape(len(X), 9, -1)

    @cached_property
    def _short(self) -> np.ndarray:
        return self._slopes.astype(np.float32)

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
        size = self.space.size
        none, past = np.zeros(size), Past.none(len(self._quadrature[0]))
        return Held(
            none, none, none, Rows.none(size), past, np.zeros((size, size)), none, True, {}, none
        )

    def _forces(self, y: np.ndarray, grips: Sequence[Grip], last: Held) -> Forces:
        _, share = self._quadrature
        flat, weigh = self._slopes.reshape(-1, self.space.size), share[:, None] / TRUST**2
        F = np.eye(3) + (flat @ y).reshape(-1, 3, 3)
        P, elastic = self.resistance.answer(F, last.past)
        left = flat.T @ (weigh * P.reshape(-1, 9)).ravel() - self._load / TRUST**2
        K = self._stiffness(F, last.past)
        rubs: dict[int, np.ndarray] = {}
        for rub in (grip.rub for grip in grips if grip.rub):
            before = last.rubbed.get(rub.face, rub.none)
            more, own, rubs[rub.face] = rub.answer(y - last.y, before)
            left, K = left + more, K + own
        return Forces(left, K, Past(F, elastic), rubs)

    def _stiffness(self, F: np.ndarray, past: Past) -> np.ndarray:
        """Derivative of the law's forces, shape [size, size]."""
        _, share = self._quadrature
        weigh, size = share[:, None, None] / TRUST**2, self.space.size
        short = self._short  # slopes need fewer digits
        stiff = (weigh * self.resistance.slope(F, past)).astype(np.float32)
        return (short.reshape(-1, size).T @ (stiff @ short).reshape(-1, size)).astype(float)

    def held(self, rows: Rows, grips: Sequence[Grip], last: Held) -> Held:
        """The frame after ``last``.

        Args:
            rows: of what is seen.
            grips: of the tools.
            last: the frame before.

        Raises:
            ValueError: no motion passes through what is seen without folding the body.
        """
        size = self.space.size
        flat = self._slopes.reshape(-1, size)
        own = sum((grip.rows for grip in grips), Rows.none(size))
        seen, floating = own + rows, own + rows * FLOAT
        B = np.concatenate([np.zeros((size, 0)), *(grip.pushes for grip in grips)], axis=1)
        y, alone = last.y + last.ahead, (last.alone if B.shape[1] else last.y) + last.ahead
        push, strains, damped = B @ (B.T @ last.push), [np.inf, np.inf], [1.0, 1.0]
        for _ in range(ROUNDS):
            found = self._forces(y, grips, last)
            A, right = found.equation(seen, y, push)
            if B.shape[1]:
                other = self._forces(alone, grips, last).equation(floating, alone, push)
                steps = _together((A, right), other, B, B.T @ (alone - y))
            else:
                steps = (np.linalg.solve(A, right),) * 2 + (push,)
            before, strains = strains, [float(np.abs(flat @ s).max()) for s in steps[:2]]
            if not np.isfinite(strains).all():
                raise ValueError(
                    "no motion inside the body passes through the points of its surface"
                )
            damped = [_damped(*each) for each in zip(damped, strains, before, strict=True)]
            shares = [
                d * min(1.0, LONGEST / max(strain, LONGEST))
                for d, strain in zip(damped, strains, strict=True)
            ]
            y, alone = y + shares[0] * steps[0], alone + shares[1] * steps[1]
            push = push + min(shares) * steps[2]
            if max(strains) < CLOSE:
                break
        stiffness = found.slope - _borne(B, floating.normal + found.slope)
        left, settled = found.left - push, max(strains) < CLOSE
        rubs = [(grip.rub, grip.force(y, push)) for grip in grips if grip.rub]
        rubbed = {rub.face: rub.after(found.rubs[rub.face], held) for rub, held in rubs}
        return Held(y, alone, push, seen, found.past, stiffness, left, settled, rubbed, y - last.y)


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


Equation = tuple[np.ndarray, np.ndarray]


def _damped(share: float, strain: float, before: float) -> float:
    """The share of a step to take: half of the last one where that has not led as far as it should."""
    return 0.5 * share if strain > (1.0 - 0.5 * share) * before else min(1.0, 1.2 * share)


def _together(
    one: Equation, other: Equation, B: np.ndarray, apart: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps of two states, and of the push on both that brings them together along B."""
    (A, a), (C, c) = one, other
    size = len(a)
    like = float(np.trace(A)) / size  # so that all entries are alike in size
    B, apart = like * B, like * apart
    none = np.zeros_like(A)
    corner = np.zeros((B.shape[1],) * 2)
    whole = np.block([[A, none, -B], [none, C, -B], [B.T, -B.T, corner]])
    found = np.linalg.solve(whole, np.concatenate([a, c, apart]))
    return found[:size], found[size : 2 * size], B @ found[2 * size :]


def _borne(B: np.ndarray, K: np.ndarray) -> np.ndarray:
    """The stiffness that pushes along B take over, shape [size, size]."""
    if not B.shape[1]:
        return np.zeros_like(K)
    return np.asarray(B @ np.linalg.solve(B.T @ np.linalg.solve(K, B), B.T))
