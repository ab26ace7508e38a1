"""Tensor functions of the deformation gradient, as Warp functions generic in precision.

Two decompositions are offered. ``series`` needs no singular values: the rotation from the
invariants of the stretch (Cayley-Hamilton), the Hencky strain by the inverse hyperbolic tangent
series of Z = (b - I)(b + I)^-1. ``svd3`` uses Warp's built-in singular value decomposition with
stretches clamped at 0.05, as the simulator behind the shared NCLaw data does.
"""

from functools import cache
from typing import Any

import warp as wp


@wp.func
def deviator(a: Any):
    """a - tr(a)/3 I."""
    return a - wp.trace(a) / a.dtype(3.0) * wp.identity(n=3, dtype=a.dtype)


@wp.func
def norm(a: Any):
    """Frobenius norm."""
    return wp.sqrt(wp.ddot(a, a))


@wp.func
def isochoric_b(F: Any, J: Any):
    """Left Cauchy-Green tensor without volume change, J^(-2/3) F F^T."""
    return wp.pow(J, type(J)(-2.0) / type(J)(3.0)) * (F * wp.transpose(F))


@wp.func
def rotation_svd3(F: Any):
    """Polar rotation U V^T of F from its singular value decomposition."""
    U, _s, V = wp.svd3(F)
    return U * wp.transpose(V)


@wp.func
def log_stretches(s: Any):
    """Logarithms of the singular values, clamped below."""
    floor = s.dtype(0.05)
    return wp.vector(
        wp.log(wp.max(s[0], floor)), wp.log(wp.max(s[1], floor)), wp.log(wp.max(s[2], floor))
    )


@wp.func
def hencky_svd3(F: Any):
    """Hencky strain U log(s) U^T."""
    U, s, _V = wp.svd3(F)
    return U * wp.diag(log_stretches(s)) * wp.transpose(U)


def _rotation_series(tolerance: float):
    """Warp function F -> R without singular values; the SVD answers for inverted F.

    By Cayley-Hamilton R (F^T F + i2 I) = i1 F + cof F, with i1 and i2 the first two invariants of
    the stretch. i1 is the largest root of a quartic, found by Newton's iteration from its series
    about equal stretches, and exact to round-off once a relative step is below ``tolerance``.
    """

    @wp.func
    def rotate(F: Any):
        J = wp.determinant(F)
        if J <= type(J)(1.0e-6):
            return rotation_svd3(F)
        half, two = type(J)(0.5), type(J)(2.0)
        cofactor = wp.matrix_from_rows(
            wp.cross(F[1], F[2]), wp.cross(F[2], F[0]), wp.cross(F[0], F[1])
        )
        C = wp.transpose(F) * F
        size, area = wp.trace(C), wp.ddot(cofactor, cofactor)
        i1 = wp.sqrt(type(J)(3.0) * size) * type(J)(0.75) * (type(J)(1.0) + area / (size * size))
        i2 = half * (i1 * i1 - size)
        for _ in range(40):
            step = (i2 * i2 - area - two * J * i1) / (two * (i1 * i2 - J))
            i1 -= step
            i2 = half * (i1 * i1 - size)
            if wp.abs(step) <= type(J)(tolerance) * i1:
                break
        return (i1 * F + cofactor) * wp.inverse(C + i2 * wp.identity(n=3, dtype=F.dtype))

    return rotate


def _odd_series(terms: int):
    """Warp function (Z, Z^2) -> Z + Z^3/3 + Z^5/5 + ..., the matrix atanh."""

    @wp.func
    def series(Z: Any, Z2: Any):
        identity = wp.identity(n=3, dtype=Z.dtype)
        total = identity / Z.dtype(float(2 * terms - 1))
        for k in range(1, terms):
            total = Z2 * total + identity / Z.dtype(float(2 * (terms - k) - 1))
        return Z * total

    return series


def _hencky_series(short: int, middle: int, long: int):
    """Numbers of terms that reach round-off for |Z| < 0.08, 0.25 and 0.6."""
    near, beyond, far = _odd_series(short), _odd_series(middle), _odd_series(long)

    @wp.func
    def hencky(F: Any):
        J = wp.determinant(F)
        identity = wp.identity(n=3, dtype=F.dtype)
        if J <= type(J)(1.0e-6):
            return hencky_svd3(F)
        b = isochoric_b(F, J)
        Z = (b - identity) * wp.inverse(b + identity)
        size = norm(Z)
        if size > type(J)(0.6):
            return hencky_svd3(F)
        strain = identity
        if size < type(J)(0.08):
            strain = near(Z, Z * Z)
        elif size < type(J)(0.25):
            strain = beyond(Z, Z * Z)
        else:
            strain = far(Z, Z * Z)
        return deviator(strain) + wp.log(J) / type(J)(3.0) * identity

    return hencky


def _taylor(terms: int):
    @wp.func
    def series(a: Any):
        identity = wp.identity(n=3, dtype=a.dtype)
        total = identity
        for k in range(terms):
            total = identity + a * total / a.dtype(float(terms - k))
        return total

    return series


def _exponential(short: int, long: int):
    """Numbers of terms that reach round-off for |a| < 0.03 and up to about one."""
    near, far = _taylor(short), _taylor(long)

    @wp.func
    def exponential(a: Any):
        if norm(a) < a.dtype(0.03):
            return near(a)
        return far(a)

    return exponential


@cache
def rotation(decomposition: str, precision: str):
    """Warp function F -> R of the polar decomposition F = R U, exact to round-off."""
    if decomposition == "svd3":
        return rotation_svd3
    return _rotation_series(1.0e-4 if precision == "float32" else 1.0e-8)


@cache
def hencky(decomposition: str, precision: str):
    """Warp function F -> Hencky strain 1/2 log(F F^T) [-], exact to round-off."""
    if decomposition == "svd3":
        return hencky_svd3
    return _hencky_series(*((3, 5, 14) if precision == "float32" else (7, 12, 30)))


@cache
def exponential(precision: str):
    """Warp function a -> exp(a) by Taylor's series, for |a| up to about one."""
    return _exponential(*((3, 8) if precision == "float32" else (8, 16)))
