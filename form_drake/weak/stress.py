"""Stress of every term of a law along a motion, and the elastic strain that plastic flow leaves."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.laws.kernels import flow, responses, types, yield_measures
from form_drake.laws.memory import LARGEST
from form_drake.workers import parted

PRECISION, DECOMPOSITION = "float64", "series"
ALONE = 2**12  # matrices that are worth a thread
LEAST_STRAIN = 1e-3  # of the largest, below which rounding tells what is left of it


@cache
def _history(law: Law):
    """Kernel (F[time, point], r) -> elastic F[time, point], from the stress-free state on.

    F moves straight from one time to the next, in strides no longer than ``LARGEST``: the return to
    the yield surface is of first order in them.
    """
    t, keep = types(PRECISION), flow(law, DECOMPOSITION, PRECISION)
    largest = wp.constant(t.real(LARGEST))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(F: wp.array2d(dtype=t.mat), r: t.vec4, out: wp.array2d(dtype=t.mat)):
        i = wp.tid()
        start, _e = keep(F[0, i], r)
        out[0, i] = start
        for n in range(1, F.shape[0]):
            last = F[n - 1, i]
            stride = F[n, i] - last
            count = 1 + int(wp.sqrt(wp.ddot(stride, stride)) / largest)
            elastic = out[n - 1, i]
            for k in range(1, count + 1):
                now = F[n - 1, i] + t.real(k) / t.real(count) * stride
                new, _e = keep(now * wp.inverse(last) * elastic, r)
                elastic, last = new, now
            out[n, i] = elastic

    return kernel


def unit_stresses(
    law: Law, F: np.ndarray, L: np.ndarray, values: Values, pressure: np.ndarray | None = None
) -> np.ndarray:
    """Kirchhoff stress per unit of each term.

    Args:
        law: whose terms.
        F: elastic deformation gradients, shape [..., 3, 3].
        L: velocity gradients [1/s], shape [..., 3, 3].
        values: the constants of the law and, where it reads pressure, ``kappa``.
        pressure: supplied Cauchy pressure [Pa], shape [...]; None: the law's own.

    Returns:
        shape [terms, ..., 3, 3].
    """
    t, shape = types(PRECISION), F.shape[:-2]
    F, L = (np.asarray(a, dtype=float).reshape(-1, 3, 3) for a in (F, L))
    p = np.zeros(0) if pressure is None else np.asarray(pressure, dtype=float).ravel()
    kappa, s = t.real(values.get("kappa", 0.0)), t.vec4(*law.shape_vector(values))
    kernel = _loaded(responses(law, DECOMPOSITION, PRECISION))
    found = np.empty((len(law.terms), len(F), 3, 3))

    def part(own: slice) -> None:
        out = wp.empty((len(found), len(F[own])), dtype=t.mat, device="cpu")
        held = wp.array(np.ascontiguousarray(p[own]), dtype=t.real, device="cpu")
        inputs = [_matrices(F[own]), _matrices(L[own]), kappa, held, s, out]
        wp.launch(kernel, dim=out.shape[1], inputs=inputs, device="cpu")
        found[:, own] = out.numpy()

    parted(part, len(F), ALONE)
    return found.reshape(len(found), *shape, 3, 3)


def elastic_part(law: Law, F: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Elastic deformation gradients along a motion from the stress-free state.

    Args:
        law: whose flow; an elastic one returns F.
        F: total deformation gradients, shape [times, points, 3, 3].
        r: constants of the law's radius, shape [4].
    """
    if law.flow != "plastic":
        return F
    t, kernel, found = types(PRECISION), _loaded(_history(law)), np.empty(F.shape)

    def part(own: slice) -> None:
        total = wp.array(np.ascontiguousarray(F[:, own]), dtype=t.mat, device="cpu")
        out = wp.empty(total.shape, dtype=t.mat, device="cpu")
        wp.launch(kernel, dim=total.shape[1], inputs=[total, t.vec4(*r), out], device="cpu")
        found[:, own] = out.numpy()

    parted(part, F.shape[1], 1 + ALONE // len(F))
    return found


def strain_over_radius(law: Law, F: np.ndarray) -> np.ndarray:
    """|dev e| in units of the law's radius at r = 1, shape [...].

    Zero where that radius is none, and where there is hardly any strain beside the largest.
    """
    t, shape = types(PRECISION), F.shape[:-2]
    out = wp.empty(int(np.prod(shape)), dtype=t.vec3, device="cpu")
    kernel = yield_measures(law, DECOMPOSITION, PRECISION)
    inputs = [_matrices(F), t.vec4(1.0, 0.0, 0.0, 0.0), out]
    wp.launch(kernel, dim=len(out), inputs=inputs, device="cpu")
    size, radius = out.numpy()[:, 0], out.numpy()[:, 1]
    counts = (radius > 0.0) & (size > LEAST_STRAIN * size.max())
    found = np.where(counts, size / np.where(counts, radius, 1.0), 0.0)
    return np.asarray(found.reshape(shape))


def _loaded(kernel: Any) -> Any:
    """The same kernel, which no two threads will then load at once."""
    kernel.module.load(wp.get_device("cpu"), 1)
    return kernel


def _matrices(a: np.ndarray):
    flat = np.ascontiguousarray(a, dtype=float).reshape(-1, 3, 3)
    return wp.array(flat, dtype=types(PRECISION).mat, device="cpu")


@cache
def volumetric(law: Law) -> tuple[bool, ...]:
    """Which terms are pure pressures: tests without divergence cannot see them."""
    rng = np.random.default_rng(0)
    F = np.eye(3) + 0.1 * rng.standard_normal((8, 3, 3))
    values = {k: 1.0 for k in law.keys}
    T = unit_stresses(law, F, rng.standard_normal((8, 3, 3)), values, np.ones(8))
    shear = T - np.trace(T, axis1=2, axis2=3)[:, :, None, None] / 3.0 * np.eye(3)
    small = 1e-9 * np.abs(T).max(axis=(1, 2, 3))
    return tuple(bool(v) for v in np.abs(shear).max(axis=(1, 2, 3)) <= small)
