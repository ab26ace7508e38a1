"""B-spline bases on an interval and on a box, as dense matrices."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline


@dataclass(frozen=True)
class Splines:
    """B-splines on an interval.

    Attributes:
        breaks: ends of the spans, increasing, shape [spans + 1].
        degree: polynomial degree.
    """

    breaks: np.ndarray
    degree: int

    @classmethod
    def graded(
        cls, low: float, high: float, spans: int, degree: int, held: tuple[bool, bool]
    ) -> "Splines":
        """Spans that shrink towards the ends that are held, where strain concentrates."""
        s = np.linspace(0.0, 1.0, spans + 1)
        if held == (True, True):
            s = 0.5 * (1.0 - np.cos(np.pi * s))
        elif held[1]:
            s = np.sin(0.5 * np.pi * s)
        elif held[0]:
            s = 1.0 - np.cos(0.5 * np.pi * s)
        return cls(low + (high - low) * s, degree)

    @classmethod
    def uniform(cls, low: float, high: float, spans: int, degree: int) -> "Splines":
        return cls(np.linspace(low, high, spans + 1), degree)

    @property
    def size(self) -> int:
        """Number of basis functions."""
        return len(self.breaks) - 1 + self.degree

    @property
    def knots(self) -> np.ndarray:
        ends = np.ones(self.degree)
        return np.concatenate([self.breaks[0] * ends, self.breaks, self.breaks[-1] * ends])

    @cached_property
    def grams(self) -> tuple[np.ndarray, ...]:
        """Integrals of products of values, slopes and curvatures, the interval scaled to length one."""
        node, weight = np.polynomial.legendre.leggauss(self.degree + 1)
        half = 0.5 * np.diff(self.breaks)[:, None]
        x = (self.breaks[:-1, None] + half * (node + 1.0)).ravel()
        length = self.breaks[-1] - self.breaks[0]
        share = ((half * weight) / length).ravel()[:, None]
        values = [self.matrix(x, d) * length**d for d in range(3)]
        return tuple(v.T @ (v * share) for v in values)

    def matrix(self, x: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Values or derivatives of all functions at ``x``, shape [len(x), size].

        Points beyond the interval see the polynomials of the outermost spans.
        """
        if derivative > self.degree:
            return np.zeros((len(x), self.size))
        curve = BSpline(self.knots, np.eye(self.size), self.degree)
        found: np.ndarray = (curve.derivative(derivative) if derivative else curve)(x)
        return found


@dataclass(frozen=True)
class Tensor:
    """Products of B-splines along the three axes of a box."""

    axes: tuple[Splines, Splines, Splines]

    @property
    def size(self) -> int:
        """Number of basis functions."""
        return int(np.prod([a.size for a in self.axes]))

    def matrix(self, X: np.ndarray, derivatives: tuple[int, int, int] = (0, 0, 0)) -> np.ndarray:
        """Values or partial derivatives at X [m], shape [points, size]."""
        a, b, c = (
            s.matrix(X[:, i], d)
            for i, (s, d) in enumerate(zip(self.axes, derivatives, strict=True))
        )
        return np.einsum("pi,pj,pk->pijk", a, b, c, optimize=True).reshape(len(X), self.size)

    @cached_property
    def roughness(self) -> np.ndarray:
        """Integral of the squared second derivatives over the box, lengths in units of its sides.

        Returns:
            Matrix K with c^T K c the integral of a field with coefficients c, shape [size, size].
        """
        (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = (axis.grams for axis in self.axes)
        none = np.kron(b0, c0)
        once = np.kron(b1, c0) + np.kron(b0, c1)
        twice = np.kron(b2, c0) + np.kron(b0, c2) + 2.0 * np.kron(b1, c1)
        total = a2[:, None, :, None] * none[:, None]
        for along, others in ((2.0 * a1, once), (a0, twice)):
            total += along[:, None, :, None] * others[:, None]
        return np.asarray(total.reshape(self.size, self.size))

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """Gradients at X [1/m], shape [points, size, 3]."""
        return np.stack([self.matrix(X, d) for d in ((1, 0, 0), (0, 1, 0), (0, 0, 1))], axis=-1)

    def hessian(self, X: np.ndarray) -> np.ndarray:
        """Second derivatives at X [1/m^2], shape [points, size, 3, 3]."""
        found = np.empty((len(X), self.size, 3, 3))
        one = np.eye(3, dtype=int)
        for a in range(3):
            for b in range(a, 3):
                i, j, k = (one[a] + one[b]).tolist()
                found[:, :, a, b] = found[:, :, b, a] = self.matrix(X, (i, j, k))
        return found
