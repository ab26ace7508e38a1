"""Warp kernels of the weak form: a law's stress along a motion, and stretches free of it."""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.laws.kernels import flow, picked, point, strain, summed
from form_drake.laws.memory import LARGEST

PRECISION, DECOMPOSITION = "float64", "series"
NEWTON_STEP, NEWTON_LONGEST = 1e-6, 0.2  # of a stretch: in differences, and in one step
# change of a stretch in a step of Newton, which leaves of the order of its square
NEWTON_CLOSE = 1e-4

real, vec3, vec4, mat = wp.float64, wp.vec3d, wp.vec4d, wp.mat33d


def loaded(kernel: Any) -> Any:
    """The same kernel, which no two threads will then load at once."""
    kernel.module.load(wp.get_device("cpu"), 1)
    return kernel


def matrices(a: np.ndarray):
    """3 x 3 matrices, shape [..., 3, 3], one after another."""
    flat = np.ascontiguousarray(a, dtype=float).reshape(-1, 3, 3)
    return wp.array(flat, dtype=mat, device="cpu")


def numbers(a: np.ndarray):
    """Numbers, shape [n]."""
    return wp.array(np.ascontiguousarray(a, dtype=float), dtype=real, device="cpu")


def constants(law: Law, values: Values, theta: np.ndarray) -> list[Any]:
    """The arguments theta, kappa, s and r of ``response``."""
    kappa = real(values.get("kappa", 0.0))
    s, r = vec4(*law.shape_vector(values)), vec4(*law.radius_vector(values))
    return [numbers(theta), kappa, s, r]


@cache
def response(law: Law):
    """Warp function: stress [Pa] that a law's flow leaves of a trial F, and the elastic part of F."""
    make, measure = (f(law, DECOMPOSITION, PRECISION) for f in (point, strain))
    total, pressed = summed(tuple(term.response for term in law.terms)), law.pressure is not None

    @wp.func
    def still(F: mat, r: vec4):
        return F, measure(F)

    keep = flow(law, DECOMPOSITION, PRECISION) if law.flow == "plastic" else still

    @wp.func
    def function(
        F: mat,
        L: mat,
        theta: wp.array(dtype=real),
        kappa: real,
        s: vec4,
        r: vec4,
        supplied: int,
        p: real,
    ):
        elastic, e = keep(F, r)
        q = make(elastic, e, L, kappa)
        if pressed:
            if supplied != 0:
                q.p = p
        return total(q, theta, s), elastic

    return function


@cache
def gathering(law: Law):
    """Kernel: V T_k F^-T over the windows, added to out[k, window, point].

    ``chi[time, n]`` is the share of a time in the window ``first[time] + n``; T_k is that of the elastic
    part of F. The pressure p [Pa] is the law's own where its array is empty.
    """
    make, measure = (f(law, DECOMPOSITION, PRECISION) for f in (point, strain))
    one, pressed = picked(tuple(term.response for term in law.terms)), law.pressure is not None

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        begin: int,
        first: wp.array(dtype=int),
        chi: wp.array2d(dtype=real),
        elastic: wp.array2d(dtype=mat),
        L: wp.array2d(dtype=mat),
        F: wp.array2d(dtype=mat),
        volume: wp.array(dtype=real),
        kappa: real,
        p: wp.array2d(dtype=real),
        s: vec4,
        out: wp.array3d(dtype=mat),
    ):
        i = begin + wp.tid()
        for n in range(F.shape[0]):
            q = make(elastic[n, i], measure(elastic[n, i]), L[n, i], kappa)
            if pressed:
                if p.shape[0] > 0:
                    q.p = p[n, i]
            along = volume[i] * wp.transpose(wp.inverse(F[n, i]))
            for k in range(out.shape[0]):
                met = one(q, s, k) * along
                for m in range(chi.shape[1]):
                    share = chi[n, m]
                    if share != real(0.0):
                        out[k, first[n] + m, i] += share * met

    return kernel


@cache
def history(law: Law):
    """Kernel (F[time, point], r) -> elastic F[time, point], from the stress-free state on.

    F moves straight from one time to the next, in strides no longer than ``LARGEST``: the return to
    the yield surface is of first order in them.
    """
    keep, follow = flow(law, DECOMPOSITION, PRECISION), followed(law)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(F: wp.array2d(dtype=mat), r: vec4, out: wp.array2d(dtype=mat)):
        i = wp.tid()
        start, _e = keep(F[0, i], r)
        out[0, i] = start
        for n in range(1, F.shape[0]):
            out[n, i] = follow(F[n - 1, i], F[n, i], out[n - 1, i], r)

    return kernel


@cache
def followed(law: Law):
    """Warp function: the elastic part after F has moved straight from one value to another."""
    keep, largest = flow(law, DECOMPOSITION, PRECISION), wp.constant(real(LARGEST))

    @wp.func
    def function(before: mat, after: mat, elastic: mat, r: vec4):
        stride = after - before
        count = 1 + int(wp.sqrt(wp.ddot(stride, stride)) / largest)
        last = before
        now = elastic
        for k in range(1, count + 1):
            here = before + real(k) / real(count) * stride
            now, _e = keep(here * wp.inverse(last) * now, r)
            last = here
        return now

    return function


@cache
def stretching(law: Law):
    """Kernel: Newton's method for the stretches along traction-free axes, see ``weak.release``.

    F becomes what it is with them; what is no number ends where it is.
    """
    pulls = _pulls(law)
    h, longest = wp.constant(real(NEWTON_STEP)), wp.constant(real(NEWTON_LONGEST))
    close = wp.constant(real(NEWTON_CLOSE))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        theta: wp.array(dtype=real),
        kappa: real,
        shape: vec4,
        r: vec4,
        axes: wp.vec2i,
        rounds: int,
        start: wp.array(dtype=vec3),
        F: wp.array(dtype=mat),
        ended: wp.array(dtype=int),
    ):
        i = wp.tid()
        a = axes[0]
        b = axes[1]
        ways = int(3)
        if b < 0:
            ways = 2
        s = start[i]
        for _ in range(rounds):
            now = vec3()
            by_a = vec3()
            by_b = vec3()
            for n in range(ways):  # one call alone, which halves the time to compile
                moved = s
                if n == 1:
                    moved[a] = s[a] + h
                elif n == 2:
                    moved[b] = s[b] + h
                pull = pulls(F[i], moved, theta, kappa, shape, r)
                if n == 0:
                    now = pull
                elif n == 1:
                    by_a = (pull - now) / h
                else:
                    by_b = (pull - now) / h
            change = vec3()
            if b < 0:
                change[a] = -now[a] / by_a[a]
            else:
                whole = by_a[a] * by_b[b] - by_a[b] * by_b[a]
                change[a] = (by_b[a] * now[b] - by_b[b] * now[a]) / whole
                change[b] = (by_a[b] * now[a] - by_a[a] * now[b]) / whole
            for k in range(3):
                if wp.isnan(change[k]):
                    change[k] = real(0.0)
                change[k] = wp.clamp(change[k], -longest, longest)
            s += change
            if wp.max(wp.abs(change)) <= close:
                ended[i] = 1
                break
        F[i] = F[i] * wp.diag(s)

    return kernel


def _pulls(law: Law):
    """Warp function: the second Piola stress along every axis, of F with its columns stretched."""
    evaluate = response(law)

    @wp.func
    def function(F: mat, s: vec3, theta: wp.array(dtype=real), kappa: real, shape: vec4, r: vec4):
        G = F * wp.diag(s)
        tau, _elastic = evaluate(G, mat(), theta, kappa, shape, r, 0, real(0.0))
        back = wp.inverse(G)
        return wp.get_diag(back * tau * wp.transpose(back))

    return function
