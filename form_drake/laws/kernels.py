"""Warp kernels of a law: its stress, its responses, and what a step leaves of the trial state."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from form_drake.laws.law import Law
from form_drake.laws.tensor import (
    deviator,
    exponential,
    hencky,
    hencky_svd3,
    log_stretches,
    norm,
    rotation,
)

READ = {"rotation": "R", "strain": "e", "rate": "L"}  # of a point, by ``Law.needs``
PRECISIONS = {"float32": wp.float32, "float64": wp.float64}


@dataclass(frozen=True)
class Types:
    """Warp types of one precision."""

    real: Any
    vec3: Any
    vec4: Any
    mat: Any


@cache
def types(precision: str) -> Types:
    """The Warp types of ``float32`` or ``float64``."""
    if precision not in PRECISIONS:
        raise ValueError(f"unknown precision {precision!r}: choose float32 or float64")
    real = PRECISIONS[precision]
    return Types(
        real,
        wp.types.vector(3, real),
        wp.types.vector(4, real),
        wp.types.matrix((3, 3), real),
    )


@cache
def point_type(members: frozenset[str], precision: str):
    """The struct that responses read: F, J and what else the law says that they need.

    Without the others a response that reads more than it says is an error, and no wrong stress.
    """
    t = types(precision)
    every = {"F": t.mat, "J": t.real, "p": t.real, "R": t.mat, "e": t.mat, "L": t.mat}
    held = {name: of for name, of in every.items() if name in {"F", "J"} | members}
    return wp.struct(type("Point", (), {"__annotations__": held}))


def members(law: Law) -> frozenset[str]:
    """What the responses of a law may read of a point beside F and J, see ``READ``."""
    return frozenset(READ[need] for need in law.needs) | ({"p"} if law.pressure else set())


@wp.func
def _nothing(F: Any):
    return F


@wp.func
def _no_pressure(J: Any):
    return type(J)(0.0)


@cache
def point(law: Law, decomposition: str, precision: str):
    """Warp function (F, e, L, kappa) -> Point with what the law's responses read.

    F deformation gradient, J its determinant; R rotation of F, e Hencky strain, L velocity gradient
    [1/s], p pressure [Pa] where they are read.
    """
    own = members(law)
    t, Point = types(precision), point_type(own, precision)
    turned, strained, moving, pressed = (name in own for name in "ReLp")
    rotate = rotation(decomposition, precision)
    pressure = law.pressure or _no_pressure

    @wp.func
    def make(F: t.mat, e: t.mat, L: t.mat, kappa: t.real):
        q = Point()
        q.F = F
        q.J = wp.determinant(F)
        if turned:
            q.R = rotate(F)
        if strained:
            q.e = e
        if moving:
            q.L = L
        if pressed:
            q.p = kappa * pressure(q.J)
        return q

    return make


def strain(law: Law, decomposition: str, precision: str):
    """Warp function F -> Hencky strain, or F itself for a law that reads no strain."""
    return hencky(decomposition, precision) if "strain" in law.needs else _nothing


def bulk_index(law: Law) -> int:
    """Place of ``kappa`` among the terms; 0 for a law that reads no pressure."""
    keys = [t.key for t in law.terms]
    return keys.index("kappa") if law.pressure is not None else 0


@cache
def responses(law: Law, decomposition: str, precision: str):
    """Kernel (F, L, kappa, p, s) -> T[k, particle], Kirchhoff stress per unit of each term.

    The pressure p [Pa] is the law's own where its array is empty.
    """
    t, make = types(precision), point(law, decomposition, precision)
    measure = strain(law, decomposition, precision)
    one = picked(tuple(term.response for term in law.terms))
    pressed = law.pressure is not None

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        F: wp.array(dtype=t.mat),
        L: wp.array(dtype=t.mat),
        kappa: t.real,
        p: wp.array(dtype=t.real),
        s: t.vec4,
        out: wp.array2d(dtype=t.mat),
    ):
        i = wp.tid()
        q = make(F[i], measure(F[i]), L[i], kappa)
        if pressed:
            if p.shape[0] > 0:
                q.p = p[i]
        for k in range(out.shape[0]):
            out[k, i] = one(q, s, k)

    return kernel


@cache
def stress(law: Law, decomposition: str, precision: str):
    """Warp function (F, e, L, theta, s) -> Kirchhoff stress [Pa]."""
    t, make = types(precision), point(law, decomposition, precision)
    total = summed(tuple(term.response for term in law.terms))
    bulk = bulk_index(law)

    @wp.func
    def function(F: t.mat, e: t.mat, L: t.mat, theta: wp.array(dtype=t.real), s: t.vec4):
        q = make(F, e, L, theta[bulk])
        return total(q, theta, s)

    return function


def summed(functions: tuple[wp.Function, ...]):
    """Warp function (q, theta, s) -> sum over k of theta[k] times the k-th function's response.

    One function calls the next instead of a loop over ``wp.static(functions[k])``: Warp's cache
    tells functions apart by what they call by name, and by what such a loop picks only once it has
    built them, which takes half a second.
    """
    *before, last = functions
    k = len(before)

    @wp.func
    def first(q: Any, theta: Any, s: Any):
        return theta[0] * last(q, s)

    if not before:
        return first
    rest = summed(tuple(before))

    @wp.func
    def function(q: Any, theta: Any, s: Any):
        return rest(q, theta, s) + theta[k] * last(q, s)

    return function


def picked(functions: tuple[wp.Function, ...]):
    """Warp function (q, s, k) -> the k-th function's response, for the reason of ``summed``."""
    *before, last = functions
    own = len(before)

    @wp.func
    def first(q: Any, s: Any, k: int):
        return last(q, s)

    if not before:
        return first
    rest = picked(tuple(before))

    @wp.func
    def function(q: Any, s: Any, k: int):
        if k == own:
            return last(q, s)
        return rest(q, s, k)

    return function


@cache
def flow(law: Law, decomposition: str, precision: str):
    """Warp function (trial F, r) -> F after the step, see ``Law.flow``, and its Hencky strain.

    A law that reads no strain gets F in its place.
    """
    t = types(precision)
    third = wp.constant(t.real(1.0 / 3.0))

    @wp.func
    def elastic(F: t.mat, r: t.vec4):
        return F, F

    @wp.func
    def fluid(F: t.mat, r: t.vec4):
        new = wp.pow(wp.determinant(F), third) * wp.identity(n=3, dtype=F.dtype)
        return new, new

    @wp.func
    def granular(F: t.mat, r: t.vec4):
        J = wp.min(wp.determinant(F), t.real(1.0))
        new = wp.pow(J, third) * wp.identity(n=3, dtype=F.dtype)
        return new, new

    if law.flow == "plastic":
        return _return_svd3(law, t) if decomposition == "svd3" else _return(law, precision)
    return {"elastic": elastic, "fluid": fluid, "granular": granular}[law.flow]


def _return(law: Law, precision: str):
    t, radius = types(precision), law.radius
    measure, rotate, exp = (
        hencky("series", precision),
        rotation("series", precision),
        exponential(precision),
    )

    @wp.func
    def function(F: t.mat, r: t.vec4):
        e = measure(F)
        allowed = radius(wp.trace(e), r)
        d = deviator(e)
        size = norm(d)
        if allowed < t.real(0.0):
            return rotate(F), t.real(0.0) * e
        if size > allowed:
            excess = (t.real(1.0) - allowed / size) * d
            return exp(-excess) * F, e - excess
        return F, e

    return function


def _return_svd3(law: Law, t: Types):
    radius = law.radius

    @wp.func
    def back(F: t.mat, r: t.vec4):
        U, s, V = wp.svd3(F)
        e = log_stretches(s)
        trace = e[0] + e[1] + e[2]
        allowed = radius(trace, r)
        mean = trace / t.real(3.0)
        d = e - t.vec3(mean, mean, mean)
        size = wp.length(d)
        if allowed < t.real(0.0):
            return U * wp.transpose(V)
        if size > allowed:
            h = t.vec3(mean, mean, mean) + (allowed / size) * d
            new = t.vec3(wp.exp(h[0]), wp.exp(h[1]), wp.exp(h[2]))
            return U * wp.diag(new) * wp.transpose(V)
        return F

    @wp.func
    def function(F: t.mat, r: t.vec4):
        new = back(F, r)
        return new, hencky_svd3(new)

    return function


@cache
def update(law: Law, decomposition: str, precision: str):
    """Kernel that ends a step: F <- flow(trial F), tau <- stress(F, L).

    Where ``project`` is 0, F is taken as it is.
    """
    t = types(precision)
    keep, evaluate = flow(law, decomposition, precision), stress(law, decomposition, precision)
    measure = strain(law, decomposition, precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        project: wp.array(dtype=int),
        F: wp.array(dtype=t.mat),
        L: wp.array(dtype=t.mat),
        theta: wp.array(dtype=t.real),
        constants: wp.array(dtype=t.vec4),
        tau: wp.array(dtype=t.mat),
    ):
        i = wp.tid()
        if project[0] != 0:
            new, e = keep(F[i], constants[1])
            F[i] = new
            tau[i] = evaluate(new, e, L[i], theta, constants[0])
        else:
            tau[i] = evaluate(F[i], measure(F[i]), L[i], theta, constants[0])

    return kernel


@cache
def lag(law: Law, decomposition: str, precision: str):
    """Kernel that lets the rate that viscosity feels follow the velocity gradient.

    ``late[0]`` lags by eta / spring, as with a spring in series whose shear modulus is ``spring[0]``;
    eta is the viscosity there and then, ``spring[1]`` at most. ``late[1]`` lags behind that, and their
    line to no lag at all is what is felt: second order in the lag. No spring, no lag.
    """
    t = types(precision)
    real = t.real
    evaluate, measure = (of(law, decomposition, precision) for of in (stress, strain))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        project: wp.array(dtype=int),
        clock: wp.array(dtype=t.vec4),
        spring: wp.array(dtype=t.real),
        F: wp.array(dtype=t.mat),
        L: wp.array(dtype=t.mat),
        theta: wp.array(dtype=t.real),
        constants: wp.array(dtype=t.vec4),
        late: wp.array2d(dtype=t.mat),
        felt: wp.array(dtype=t.mat),
    ):
        i = wp.tid()
        share = real(1.0)
        if spring[0] > real(0.0):
            old, e = felt[i], measure(F[i])
            d = deviator(real(0.5) * (old + wp.transpose(old)))
            none = wp.matrix(shape=(3, 3), dtype=real)
            borne = evaluate(F[i], e, old, theta, constants[0])
            borne -= evaluate(F[i], e, none, theta, constants[0])
            eta = real(1.0) * spring[1]
            if real(2.0) * eta * norm(d) > norm(deviator(borne)):
                eta = real(0.5) * norm(deviator(borne)) / norm(d)
            share = clock[0][0] / (clock[0][0] + eta / spring[0])
        if project[0] == 0:
            share = real(1.0)
        one = late[0, i] + share * (L[i] - late[0, i])
        two = late[1, i] + share * (one - late[1, i])
        late[0, i] = one
        late[1, i] = two
        felt[i] = real(2.0) * one - two

    return kernel


@cache
def yield_measures(law: Law, decomposition: str, precision: str):
    """Kernel F -> (|dev e|, the law's radius at r = (1, 0, 0, 0), 0)."""
    t, measure, radius = types(precision), hencky(decomposition, precision), law.radius

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(F: wp.array(dtype=t.mat), unit: t.vec4, out: wp.array(dtype=t.vec3)):
        i = wp.tid()
        e = measure(F[i])
        out[i] = t.vec3(norm(deviator(e)), radius(wp.trace(e), unit), t.real(0.0))

    return kernel
