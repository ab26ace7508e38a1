"""The motion of a body: what the momentum balance reads, at quadrature points and over time."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from form_drake.motion.fit import Fit


@dataclass(frozen=True)
class Frame:
    """A motion at one time; shapes as in ``Motion`` without the times."""

    time: float
    X: np.ndarray
    x: np.ndarray
    v: np.ndarray
    F: np.ndarray
    L: np.ndarray
    second: np.ndarray | None


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

    def frame(self, n: int) -> Frame:
        """The motion at its n-th time."""
        second = None if self.second is None else self.second[n]
        return Frame(
            float(self.time[n]), self.X, self.x[n], self.v[n], self.F[n], self.L[n], second
        )

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
    rows = [np.cross(F[..., (i + 1) % 3, :], F[..., (i + 2) % 3, :]) for i in range(3)]
    return np.stack(rows, axis=-2)


def determinant(F: np.ndarray) -> np.ndarray:
    """Determinants of 3 x 3 matrices, shape [...]."""
    found: np.ndarray = np.sum(F[..., 0, :] * np.cross(F[..., 1, :], F[..., 2, :]), axis=-1)
    return found


def inverse(F: np.ndarray) -> np.ndarray:
    """Inverses of 3 x 3 matrices, shape [..., 3, 3]."""
    C = cofactor(F)
    J = np.sum(F[..., 0, :] * C[..., 0, :], axis=-1)
    found: np.ndarray = C.swapaxes(-1, -2) / J[..., None, None]
    return found


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
        rate: its derivative [1/s], shape [times, series].
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
    series: np.ndarray
    rate: np.ndarray
    pressure: np.ndarray | None = None
    body_force: np.ndarray | None = None
    hessian: np.ndarray | None = None

    @classmethod
    def of(
        cls, fit: Fit, time: np.ndarray, X: np.ndarray, volume: np.ndarray, density: float
    ) -> "Sampling":
        """The bases of ``fit`` at points X and times (counted from its first frame)."""
        series, rate = fit.time.matrix(time), fit.time.matrix(time, 1)
        scalar = fit.space.scalar
        value, gradient = scalar.matrix(X), scalar.gradient(X)
        return cls(time, X, volume, density, value, gradient, series, rate)

    def motion(self, c: np.ndarray) -> Motion:
        """The motion with coefficients ``c`` [m], shape [space, 3, series]."""
        now = np.einsum("aib,tb->tia", c, self.series, optimize=True)
        rate = np.einsum("aib,tb->tia", c, self.rate, optimize=True)
        F = np.eye(3) + self._spread(now, self.gradient)
        hessian = self.hessian
        return Motion(
            time=self.time,
            X=self.X,
            x=self.X + self._spread(now, self.value),
            v=self._spread(rate, self.value),
            F=F,
            L=self._spread(rate, self.gradient) @ inverse(F),
            volume=self.volume,
            mass=self.density * self.volume,
            pressure=self.pressure,
            body_force=self.body_force,
            second=None if hessian is None else self._spread(now, hessian),
        )

    def _spread(self, c: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Sums of functions at the points, shape [times, points, 3, ...], as one matrix product.

        Args:
            c: coefficients, shape [times, 3, space].
            basis: shape [points, space, ...].
        """
        flat = np.moveaxis(basis, 1, 0).reshape(basis.shape[1], -1)
        found = (c.reshape(-1, len(flat)) @ flat).reshape(*c.shape[:2], len(basis), -1)
        spread = np.ascontiguousarray(found.swapaxes(1, 2))
        return spread.reshape(*spread.shape[:3], *basis.shape[2:])
