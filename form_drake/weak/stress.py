"""Stress of every term of a law along a motion, and the elastic strain that plastic flow leaves."""

from functools import cache

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.laws.kernels import responses, yield_measures
from form_drake.motion import Motion
from form_drake.weak.kernels import (
    DECOMPOSITION,
    PRECISION,
    gathering,
    history,
    loaded,
    mat,
    matrices,
    numbers,
    real,
    vec3,
    vec4,
)
from form_drake.workers import parted

ALONE = 2**12  # matrices that are worth a thread
LEAST_STRAIN = 1e-3  # of the largest, below which rounding tells what is left of it


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
    shape = F.shape[:-2]
    F, L = (np.asarray(a, dtype=float).reshape(-1, 3, 3) for a in (F, L))
    p = np.zeros(0) if pressure is None else np.asarray(pressure, dtype=float).ravel()
    kappa, s = real(values.get("kappa", 0.0)), vec4(*law.shape_vector(values))
    kernel = loaded(responses(law, DECOMPOSITION, PRECISION))
    found = np.empty((len(law.terms), len(F), 3, 3))

    def part(own: slice) -> None:
        out = wp.empty((len(found), len(F[own])), dtype=mat, device="cpu")
        inputs = [matrices(F[own]), matrices(L[own]), kappa, numbers(p[own]), s, out]
        wp.launch(kernel, dim=out.shape[1], inputs=inputs, device="cpu")
        found[:, own] = out.numpy()

    parted(part, len(F), ALONE)
    return found.reshape(len(found), *shape, 3, 3)


def gathered(
    law: Law, F: np.ndarray, motion: Motion, values: Values, chi: np.ndarray
) -> np.ndarray:
    """V T_k F^-T over windows [N m s per unit], with the stresses of every term.

    Args:
        law: whose terms.
        F: elastic deformation gradients, shape [times, points, 3, 3].
        motion: that they belong to.
        values: the constants of the law.
        chi: the windows [s], shape [windows, times].

    Returns:
        shape [terms, windows, points, 3, 3].
    """
    first, share = _banded(chi)
    points = F.shape[1]
    p = np.zeros((0, 0)) if motion.pressure is None else motion.pressure
    out = wp.zeros((len(law.terms), len(chi), points), dtype=mat, device="cpu")
    inputs = [
        wp.array(first, dtype=int, device="cpu"),
        wp.array(share, dtype=real, device="cpu"),
        *(matrices(a).reshape(F.shape[:2]) for a in (F, motion.L, motion.F)),
        numbers(motion.volume),
        real(values.get("kappa", 0.0)),
        wp.array(np.ascontiguousarray(p, dtype=float), dtype=real, device="cpu"),
        vec4(*law.shape_vector(values)),
        out,
    ]
    kernel = loaded(gathering(law))

    def part(own: slice) -> None:
        size = own.stop - own.start
        wp.launch(kernel, dim=size, inputs=[own.start, *inputs], device="cpu")

    parted(part, points, 1 + ALONE // len(F))
    found: np.ndarray = out.numpy()
    return found


def _banded(chi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first window of every time, and the shares of it and of those after it, shape [times, most]."""
    acts = chi.T != 0.0
    first = np.where(acts.any(axis=1), acts.argmax(axis=1), 0)
    last = np.where(acts.any(axis=1), len(chi) - acts[:, ::-1].argmax(axis=1), 0)
    count = max(1, int((last - first).max(initial=0)))
    first = np.minimum(first, max(len(chi) - count, 0))
    each = first[:, None] + np.arange(count)
    return first.astype(np.int32), np.ascontiguousarray(np.take_along_axis(chi.T, each, axis=1))


def elastic_part(law: Law, F: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Elastic deformation gradients along a motion from the stress-free state.

    Args:
        law: whose flow; an elastic one returns F.
        F: total deformation gradients, shape [times, points, 3, 3].
        r: constants of the law's radius, shape [4].
    """
    if law.flow != "plastic":
        return F
    kernel, found = loaded(history(law)), np.empty(F.shape)

    def part(own: slice) -> None:
        total = wp.array(np.ascontiguousarray(F[:, own]), dtype=mat, device="cpu")
        out = wp.empty(total.shape, dtype=mat, device="cpu")
        wp.launch(kernel, dim=total.shape[1], inputs=[total, vec4(*r), out], device="cpu")
        found[:, own] = out.numpy()

    parted(part, F.shape[1], 1 + ALONE // len(F))
    return found


def strain_over_radius(law: Law, F: np.ndarray) -> np.ndarray:
    """|dev e| in units of the law's radius at r = 1, shape [...].

    Zero where that radius is none, and where there is hardly any strain beside the largest.
    """
    shape = F.shape[:-2]
    out = wp.empty(int(np.prod(shape)), dtype=vec3, device="cpu")
    kernel = yield_measures(law, DECOMPOSITION, PRECISION)
    inputs = [matrices(F), vec4(1.0, 0.0, 0.0, 0.0), out]
    wp.launch(kernel, dim=len(out), inputs=inputs, device="cpu")
    size, radius = out.numpy()[:, 0], out.numpy()[:, 1]
    counts = (radius > 0.0) & (size > LEAST_STRAIN * size.max())
    found = np.where(counts, size / np.where(counts, radius, 1.0), 0.0)
    return np.asarray(found.reshape(shape))


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
