"""Test fields psi(x, t): the weights of the momentum balance in space.

A field vanishes where an unknown force acts on the body and is a constant vector where a measured
one does. Material fields are functions of the stress-free position X alone; spatial ones of x.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from form_drake.motion import Body, Face, Motion
from form_drake.motion.splines import Splines, Tensor


@dataclass(frozen=True)
class Sampled:
    """Test fields at the points and times of a motion.

    Attributes:
        value: psi, shape [times, fields, points, 3].
        gradient: d psi_i / d X_j of material fields, d psi_i / d x_j of spatial ones [1/m], shape
            [times, fields, points, 3, 3].
        rate: d psi / dt [1/s] at fixed X of material fields, at fixed x of spatial ones, shape
            [times, fields, points, 3]; None: zero.
    """

    value: np.ndarray
    gradient: np.ndarray
    rate: np.ndarray | None = None


class Fields(Protocol):
    """A family of test fields.

    Attributes:
        names: one for each field.
        material: gradients are those along X (see ``Sampled``).
        fixed: material fields that no motion changes.
        tools: those whose force the fields see.
    """

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def material(self) -> bool: ...

    @property
    def fixed(self) -> bool: ...

    @property
    def breaks(self) -> tuple[np.ndarray, ...]:
        """Ends of quadrature cells along each axis, in stress-free coordinates [m]."""
        ...

    @property
    def tools(self) -> tuple[str, ...]: ...

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        """Value of every field where each tool acts, shape [times, fields, 3]."""
        ...

    def at(self, motion: Motion) -> Sampled:
        """The fields at all points and times of a motion."""
        ...

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        """Which fields may be used while held faces are at these points [m], shape [fields]."""
        ...


@runtime_checkable
class Mirrored(Protocol):
    """Fields that some mirrors of the body leave as they are."""

    def even(self, axis: int, middle: float, near: float) -> bool:
        """Whether they stay as they are when mirrored along an axis about ``middle`` (within ``near``) [m]."""
        ...


@runtime_checkable
class Exchanged(Protocol):
    """Fields that an exchange of two axes may leave as they are."""

    def exchanged(self, a: int, b: int) -> bool:
        """Whether those that are even along two axes stay as they are when the two change places."""
        ...


@dataclass(frozen=True)
class BoxFields:
    """Material B-splines over the reference box, tied or dropped at its faces.

    Args:
        body: the specimen.
        basis: scalar basis.
        weights: combinations of scalar functions times directions, shape [fields, size, 3].
        names: of the fields.
        ends: value of every field at each tool, shape [fields, 3].

    Beyond the ends of the basis a field keeps the value that it has there.
    """

    basis: Tensor
    weights: np.ndarray = field(repr=False)
    names: tuple[str, ...] = field(repr=False)
    ends: dict[str, np.ndarray] = field(repr=False)
    material: bool = True
    fixed: bool = True

    @classmethod
    def of(
        cls,
        body: Body,
        measured: frozenset[str],
        spans: int | tuple[int, int, int] = 2,
        degree: int = 2,
        clear: float = 0.0,
    ) -> "BoxFields":
        """All fields that the faces of a body admit.

        Args:
            body: the specimen.
            measured: tools whose force is known.
            spans: elements per axis.
            degree: of the splines.
            clear: distance from held faces [m] at which the fields end there, smoothly: what
                strains a layer at a plate is not seen; zero: they end at the faces.
        """
        count = (spans, spans, spans) if isinstance(spans, int) else spans
        ends = np.stack([body.low, body.high], axis=1)
        for face in body.faces:
            if face.condition in ("bonded", "frictionless"):
                ends[face.axis, face.side] += (1 - 2 * face.side) * clear
        a, b, c = (Splines.uniform(e[0], e[1], n, degree) for e, n in zip(ends, count, strict=True))
        basis, flat = Tensor((a, b, c)), 2 if clear else 1
        free = np.ones((basis.size, 3), dtype=bool)
        for face in body.faces:
            free[np.ix_(_on(basis, face, flat), np.array(_held(face), dtype=int))] = False
        weights, names = [], []
        for n, d in np.argwhere(free):
            one = np.zeros((basis.size, 3))
            one[n, d] = 1.0
            weights.append(one)
            names.append(f"{'xyz'[d]} at {_where(basis, n)}")
        tools: dict[str, list[tuple[int, int]]] = {}
        for face in body.faces:
            if face.tool not in measured or face.condition not in ("bonded", "frictionless"):
                continue
            for d in _held(face):
                on = _on(basis, face, flat)
                tied = on & ~_held_elsewhere(basis, body, face, d, flat)
                if tied.sum() == on.sum():
                    one = np.zeros((basis.size, 3))
                    one[tied, d] = 1.0
                    tools.setdefault(face.tool, []).append((len(weights), d))
                    weights.append(one)
                    names.append(f"{'xyz'[d]} with {face.tool}")
        at_tools = {}
        for tool, rows in tools.items():
            at_tools[tool] = np.zeros((len(weights), 3))
            for row, d in rows:
                at_tools[tool][row, d] = 1.0
        return cls(basis, np.array(weights).reshape(-1, basis.size, 3), tuple(names), at_tools)

    @property
    def breaks(self) -> tuple[np.ndarray, ...]:
        return tuple(a.breaks for a in self.basis.axes)

    @property
    def tools(self) -> tuple[str, ...]:
        return tuple(self.ends)

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        return {k: np.broadcast_to(e, (len(motion.time), *e.shape)) for k, e in self.ends.items()}

    @cached_property
    def _last(self) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
        return {}

    def at(self, motion: Motion) -> Sampled:
        key = motion.X.tobytes()
        if key not in self._last:
            low, high = (np.array([a.breaks[n] for a in self.basis.axes]) for n in (0, -1))
            X = np.clip(motion.X, low, high)
            value, slope = self.basis.matrix(X), self.basis.gradient(X)
            slope *= np.where(motion.X == X, 1.0, 0.0)[:, None, :]
            self._last.clear()
            self._last[key] = (
                np.einsum("fnd,qn->fqd", self.weights, value, optimize=True).copy(),
                np.einsum("fnd,qna->fqda", self.weights, slope, optimize=True).copy(),
            )  # in the order in which all who ask flatten them
        both = (np.broadcast_to(a, (len(motion.time), *a.shape)) for a in self._last[key])
        return Sampled(*both)

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.names), dtype=bool)


def _on(basis: Tensor, face: Face, flat: int) -> np.ndarray:
    """Which scalar functions do not vanish on a face, with ``flat - 1`` derivatives, shape [size]."""
    shape = tuple(a.size for a in basis.axes)
    index = np.indices(shape)[face.axis].ravel()
    found: np.ndarray = index >= shape[face.axis] - flat if face.side else index < flat
    return found


def _held(face: Face) -> list[int]:
    """Directions in which a face carries an unknown or a tool's force."""
    if face.condition == "free":
        return []
    return [face.axis] if face.condition == "frictionless" else [0, 1, 2]


def _held_elsewhere(basis: Tensor, body: Body, face: Face, d: int, flat: int) -> np.ndarray:
    """Functions of ``face`` that another face holds in direction ``d``."""
    other = np.zeros(basis.size, dtype=bool)
    for neighbour in body.faces:
        if neighbour.axis != face.axis and d in _held(neighbour):
            other |= _on(basis, neighbour, flat)
    return other


def _where(basis: Tensor, n: int) -> str:
    shape = tuple(a.size for a in basis.axes)
    return " ".join(f"{i}/{s - 1}" for i, s in zip(np.unravel_index(n, shape), shape, strict=True))
