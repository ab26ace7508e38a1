"""The motion of a body: what the momentum balance reads, at quadrature points and over time."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from form_drake.motion.fit import Fit


@dataclass(frozen=True)
class Motion:
    """Motion of material points, from a fit of tracks or from elsewhere.

    Attributes:
        time: [s], shape [times].
        X: stress-free positions [m], shape [points, 3].
        x: positions [m], shape [times, points, 3].
        v: velocities [m/s], shape [times, points, 3].
        F: deformation gradients, shape [times, points, 3, 3].
        L: velocity gradients [1/s], shape [times, points, 3, 3].
        volume: reference volumes [m^3], shape [points].
        mass: [kg], shape [points].
        pressure: supplied Cauchy pressure [Pa], shape [times, points], or None.
        body_force: force per mass besides gravity [m/s^2], shape [times, points, 3], or None.
        second: second gradients d^2 x_i / dX_a dX_b [1/m], shape [times, points, 3, 3, 3], or None.
    """

    time: np.ndarray
    X: np.ndarray
    x: np.ndarray
    v: np.ndarray
    F: np.ndarray
    L: np.ndarray
    volume: np.ndarray
    mass: np.ndarray
    pressure: np.ndarray | None = None
    body_force: np.ndarray | None = None
    second: np.ndarray | None = None

    def at(self, times: np.ndarray | slice) -> "Motion":
        """The motion at some of its times, by their indices."""
        along = ("time", "x", "v", "F", "L", "pressure", "body_force", "second")
        values = {name: getattr(self, name) for name in along}
        return replace(self, **{k: v[times] for k, v in values.items() if v is not None})

    @cached_property
    def inverse(self) -> np.ndarray:
        """F^-1, shape of F."""
        return inverse(self.F)

    @cached_property
    def J(self) -> np.ndarray:
        """det F, shape [times, points]."""
        return determinant(self.F)


def cofactor(F: np.ndarray) -> np.ndarray:
    """Cofactors of 3 x 3 matrices, shape [..., 3, 3]: J F^-T."""
    found = np.empty(F.shape, F.dtype)
    for i in range(3):
        for j in range(3):
            found[..., i, j] = _minor(F, i, j)
    return found


def _minor(F: np.ndarray, i: int, j: int) -> np.ndarray:
    """The cofactor of an entry, shape [...]."""
    (a, b), (c, d) = (((k + 1) % 3, (k + 2) % 3) for k in (i, j))
    found: np.ndarray = F[..., a, c] * F[..., b, d] - F[..., a, d] * F[..., b, c]
    return found


def determinant(F: np.ndarray) -> np.ndarray:
    """Determinants of 3 x 3 matrices, shape [...]."""
    return (
        F[..., 0, 0] * _minor(F, 0, 0)
        + F[..., 0, 1] * _minor(F, 0, 1)
        + F[..., 0, 2] * _minor(F, 0, 2)
    )


def inverse(F: np.ndarray) -> np.ndarray:
    """Inverses of 3 x 3 matrices, shape [..., 3, 3]."""
    C = cofactor(F)
    J = np.sum(F[..., 0, :] * C[..., 0, :], axis=-1)
    found: np.ndarray = C.swapaxes(-1, -2) / J[..., None, None]
    return found


@dataclass(frozen=True)
class Displacement:
    """What is linear in the coefficients of a fit, at the times and points of a sampling.

    Attributes:
        value: [m], shape [times, points, 3].
        velocity: [m/s], of the same shape.
        gradient: du_i / dX_a, shape [times, points, 3, 3].
        rate: of the gradient [1/s], of the same shape.
        second: d^2 u_i / dX_a dX_b [1/m], shape [times, points, 3, 3, 3], or None.
    """

    value: np.ndarray
    velocity: np.ndarray
    gradient: np.ndarray
    rate: np.ndarray
    second: np.ndarray | None

    def plus(self, share: float, other: "Displacement") -> "Displacement":
        """With a share of another one added."""
        second = self.second
        if second is not None and other.second is not None:
            second = second + share * other.second
        return Displacement(
            value=self.value + share * other.value,
            velocity=self.velocity + share * other.velocity,
            gradient=self.gradient + share * other.gradient,
            rate=self.rate + share * other.rate,
            second=second,
        )


@dataclass(frozen=True)
class Sampling:
    """Where a fit is evaluated: its bases at quadrature points and times.

    Attributes:
        time: [s], shape [times].
        X: stress-free positions [m], shape [points, 3].
        volume: reference volumes [m^3], shape [points].
        density: mass per reference volume [kg/m^3].
        value: spatial basis, shape [points, space].
        gradient: its gradient [1/m], shape [points, space, 3].
        series: temporal basis, shape [times, series].
        rate: its derivative [1/s], of the same shape.
        pressure: as in ``Motion``.
        body_force: as in ``Motion``.
        hessian: second derivatives of the spatial basis [1/m^2], shape [points, space, 3, 3]; None:
            not needed.
    """

    time: np.ndarray
    X: np.ndarray
    volume: np.ndarray
    density: float
    value: np.ndarray
    gradient: np.ndarray
    series: sparse.csr_array
    rate: sparse.csr_array
    pressure: np.ndarray | None = None
    body_force: np.ndarray | None = None
    hessian: np.ndarray | None = None

    @classmethod
    def of(
        cls, fit: Fit, time: np.ndarray, X: np.ndarray, volume: np.ndarray, density: float
    ) -> "Sampling":
        """The bases of ``fit`` at points X and times (counted from its first frame)."""
        series, rate = (sparse.csr_array(fit.time.matrix(time, d)) for d in (0, 1))
        scalar = fit.space.scalar
        value, gradient = scalar.matrix(X), scalar.gradient(X)
        return cls(time, X, volume, density, value, gradient, series, rate)

    def motion(self, c: np.ndarray) -> Motion:
        """The motion with coefficients ``c`` [m], shape [space, 3, series]."""
        return self.moved(self.displaced(c))

    def displaced(self, c: np.ndarray) -> Displacement:
        """The displacement with coefficients ``c`` [m], shape [space, 3, series]."""
        u, G, *second = (self._along(c, *table) for table in self._tables)
        return Displacement(
            value=u(self.series),
            velocity=u(self.rate),
            gradient=G(self.series),
            rate=G(self.rate),
            second=second[0](self.series) if second else None,
        )

    def moved(self, by: Displacement) -> Motion:
        """The motion with a displacement."""
        F = np.eye(3) + by.gradient
        return Motion(
            time=self.time,
            X=self.X,
            x=self.X + by.value,
            v=by.velocity,
            F=F,
            L=by.rate @ inverse(F),
            volume=self.volume,
            mass=self.density * self.volume,
            pressure=self.pressure,
            body_force=self.body_force,
            second=by.second,
        )

    @cached_property
    def _tables(self) -> list[tuple[np.ndarray, tuple[int, ...]]]:
        """The spatial bases, functions first, and the shapes of what they give at a point."""
        bases = [b for b in (self.value, self.gradient, self.hessian) if b is not None]
        return [(np.moveaxis(b, 1, 0).reshape(b.shape[1], -1), b.shape[2:]) for b in bases]

    def _along(
        self, c: np.ndarray, table: np.ndarray, shape: tuple[int, ...]
    ) -> Callable[[sparse.csr_array], np.ndarray]:
        """What a basis in time makes of a spatial one, shape [times, points, 3, ...]."""
        flat = c.transpose(2, 1, 0).reshape(c.shape[2], -1)

        def spread(flat: np.ndarray) -> np.ndarray:
            found = (flat.reshape(-1, len(table)) @ table).reshape(len(flat), 3, len(self.X), -1)
            return found.swapaxes(1, 2).reshape(*found.shape[:1], len(self.X), 3, *shape)

        if 2 * len(self.time) < len(flat):  # fewer looks than series
            return lambda series: spread(series @ flat)
        values = spread(flat)
        return lambda series: self._at(series, values)

    @staticmethod
    def _at(series: sparse.csr_array, values: np.ndarray) -> np.ndarray:
        """Values at all times, shape [times, points, 3, ...]."""
        found: np.ndarray = series @ values.reshape(len(values), -1)
        return found.reshape(-1, *values.shape[1:])
