"""Particle-to-grid and grid-to-particle transfer (APIC, quadratic B-splines), as Warp kernels.

The grid holds (momentum, mass) in one ``vec4`` per node; after the grid step (velocity, mass).
Loops over the 27 nodes are factored: what depends on one axis is summed along that axis first.
``exact`` uses the spline gradient for force and velocity gradient (the paper's eqs. 6 and 7);
``mls`` uses 4/dx^2 w (x_i - x_p), the gradient of the moving-least-squares MPM (Hu et al. 2018).

Where the grid is laid over the rest shape (``total``; de Vaucorbeil et al. 2020), the places of the
particles there give weights and gradients, which never change, and the stress is pulled back to it.
"""

from functools import cache

import warp as wp

from form_drake.basis import base_node, gradients, weights
from form_drake.laws.kernels import types
from form_drake.mpm.lanes import lanes, plane, sums


@cache
def stencil(precision: str):
    """Warp functions (x, 1/dx, nodes) -> first node, clamped to the grid, and the local offset."""
    t = types(precision)

    @wp.func
    def first(x: t.vec3, inverse_dx: t.real, nodes: wp.vec3i):
        b = base_node(x * inverse_dx)
        return wp.vec3i(
            wp.clamp(b[0], 0, nodes[0] - 3),
            wp.clamp(b[1], 0, nodes[1] - 3),
            wp.clamp(b[2], 0, nodes[2] - 3),
        )

    @wp.func
    def offset(x: t.vec3, inverse_dx: t.real, b: wp.vec3i):
        return x * inverse_dx - t.vec3(t.real(b[0]), t.real(b[1]), t.real(b[2]))

    return first, offset


@wp.func
def node_index(i: int, j: int, k: int, nodes: wp.vec3i):
    """Place of node (i, j, k) in the flat grid."""
    return (i * nodes[1] + j) * nodes[2] + k


@cache
def p2g(gradient: str, precision: str):
    """Kernel that scatters mass, a share of momentum, and the impulse dt f of the Kirchhoff stress tau."""
    t = types(precision)
    real, vec3, vec4 = t.real, t.vec3, t.vec4
    first, offset = stencil(precision)
    scaled, axpy = lanes(precision)

    @wp.func
    def column(a: t.mat, k: int):
        return vec4(a[0, k], a[1, k], a[2, k], real(0.0))

    @wp.kernel(module="unique", enable_backward=False)
    def mls(
        x: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=t.mat),
        tau: wp.array(dtype=t.mat),
        mass: wp.array(dtype=real),
        volume: wp.array(dtype=real),
        share: wp.array(dtype=real),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
        grid: wp.array(dtype=vec4),
    ):
        p = wp.tid()
        inverse = real(1.0) / dx
        b = first(x[p], inverse, nodes)
        f = offset(x[p], inverse, b)
        w = weights(f)
        m = mass[p]
        dt = clock[0][0]
        affine = dx * (
            (share[0] * m) * C[p] - (real(4.0) * inverse * inverse * dt * volume[p]) * tau[p]
        )
        along0 = column(affine, 0)
        along1 = column(affine, 1)
        along2 = column(affine, 2)
        u = (share[0] * m) * v[p] - affine * f
        start = vec4(u[0], u[1], u[2], m)
        for i in range(3):
            at_i = axpy(real(int(i)), along0, start)
            for j in range(3):
                at_j = axpy(real(int(j)), along1, at_i)
                wij = w[i, 0] * w[j, 1]
                n = node_index(b[0] + i, b[1] + j, b[2], nodes)
                for k in range(3):
                    at_k = axpy(real(int(k)), along2, at_j)
                    wp.atomic_add(grid, n + k, scaled(wij * w[k, 2], at_k))

    @wp.kernel(module="unique", enable_backward=False)
    def exact(
        x: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=t.mat),
        tau: wp.array(dtype=t.mat),
        mass: wp.array(dtype=real),
        volume: wp.array(dtype=real),
        share: wp.array(dtype=real),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
        grid: wp.array(dtype=vec4),
    ):
        p = wp.tid()
        inverse = real(1.0) / dx
        b = first(x[p], inverse, nodes)
        f = offset(x[p], inverse, b)
        w = weights(f)
        g = gradients(f, inverse)
        m = mass[p]
        impulse = (-clock[0][0] * volume[p]) * tau[p]
        force0 = column(impulse, 0)
        force1 = column(impulse, 1)
        force2 = column(impulse, 2)
        affine = (dx * share[0] * m) * C[p]
        along0 = column(affine, 0)
        along1 = column(affine, 1)
        along2 = column(affine, 2)
        u = (share[0] * m) * v[p] - affine * f
        start = vec4(u[0], u[1], u[2], m)
        for i in range(3):
            at_i = axpy(real(int(i)), along0, start)
            for j in range(3):
                at_j = axpy(real(int(j)), along1, at_i)
                wij = w[i, 0] * w[j, 1]
                push = axpy(g[i, 0] * w[j, 1], force0, scaled(w[i, 0] * g[j, 1], force1))
                here = axpy(wij, at_j, push)
                slope = scaled(wij, along2)
                push2 = scaled(wij, force2)
                n = node_index(b[0] + i, b[1] + j, b[2], nodes)
                for k in range(3):
                    at_k = axpy(real(int(k)), slope, here)
                    wp.atomic_add(grid, n + k, axpy(w[k, 2], at_k, scaled(g[k, 2], push2)))

    return {"mls": mls, "exact": exact}[gradient]


def place_type(precision: str, total: bool):
    """Type of a particle's place: over the rest shape, where nothing reads it, in double precision.

    Else what is slow would be rounded away.
    """
    return wp.vec3d if total else types(precision).vec3


@cache
def _advance(precision: str, total: bool):
    """Warp function that moves a particle, or enters it as the first fault of the step."""
    vec3, place = types(precision).vec3, place_type(precision, total)
    real = wp.float64 if total else types(precision).real

    @wp.func
    def lost(x: place, low: vec3, high: vec3):
        inside = bool(True)
        for a in range(3):
            inside = inside and x[a] >= real(low[a]) and x[a] <= real(high[a])
        return not inside

    @wp.func
    def advance(
        p: int,
        step: vec3,
        low: vec3,
        high: vec3,
        held: wp.bool,
        x: wp.array(dtype=place),
        fault: wp.array(dtype=int),
        steps: wp.array(dtype=int),
    ):
        new = x[p] + place(real(step[0]), real(step[1]), real(step[2]))
        if wp.static(not total):
            if held and wp.isfinite(new):
                new = wp.min(wp.max(new, low), high)
        if lost(new, low, high):
            if wp.atomic_cas(fault, 0, -1, p) == -1:
                fault[1] = steps[0]
            new = x[p]
        x[p] = new

    return advance


@cache
def pulled(precision: str):
    """Kernel (Kirchhoff stress tau, T) -> tau T^-T, whose flux goes through areas at rest."""
    t = types(precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(tau: wp.array(dtype=t.mat), T: wp.array(dtype=t.mat), out: wp.array(dtype=t.mat)):
        p = wp.tid()
        out[p] = tau[p] * wp.transpose(wp.inverse(T[p]))

    return kernel


@cache
def g2p(gradient: str, precision: str, total: bool = False):
    """Kernel that gathers v, C and L, steps F to its trial value and moves the particles.

    Weights are those of ``place``. For ``mls`` L is C and its array is not written, unless ``total``:
    then C and the gathered gradient are those over the rest shape, whose whole deformation T is
    stepped too. ``fault`` receives the first particle that is not finite or leaves the domain, and
    the step.
    """
    t = types(precision)
    real, vec3, vec4 = t.real, t.vec3, t.vec4
    first, offset = stencil(precision)
    nine = plane(precision)
    blend, moment = sums(precision)
    where = place_type(precision, total)
    advance = _advance(precision, total)

    @wp.func
    def columns(a: vec4, b: vec4, c: vec4):
        return wp.matrix_from_cols(
            vec3(a[0], a[1], a[2]), vec3(b[0], b[1], b[2]), vec3(c[0], c[1], c[2])
        )

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        grid: wp.array(dtype=vec4),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
        low: vec3,
        high: vec3,
        held: wp.bool,
        place: wp.array(dtype=vec3),
        x: wp.array(dtype=where),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=t.mat),
        L: wp.array(dtype=t.mat),
        F: wp.array(dtype=t.mat),
        lost: wp.array(dtype=t.mat),
        T: wp.array(dtype=t.mat),
        fault: wp.array(dtype=int),
        steps: wp.array(dtype=int),
    ):
        p = wp.tid()
        inverse = real(1.0) / dx
        b = first(place[p], inverse, nodes)
        f = offset(place[p], inverse, b)
        w = weights(f)
        g = gradients(f, inverse)
        row, layer = nodes[2], nodes[1] * nodes[2]
        n = node_index(b[0], b[1], b[2], nodes)
        a0, m0, k0, s0, t0 = nine(grid, n, row, w, g)
        a1, m1, k1, s1, t1 = nine(grid, n + layer, row, w, g)
        a2, m2, k2, s2, t2 = nine(grid, n + 2 * layer, row, w, g)
        whole = blend(w, 0, a0, a1, a2)
        u = vec3(whole[0], whole[1], whole[2])
        moments = columns(moment(w, 0, a1, a2), blend(w, 0, m0, m1, m2), blend(w, 0, k0, k1, k2))
        affine = (real(4.0) * inverse) * (moments - wp.outer(u, f))
        rate = affine
        if wp.static(gradient == "exact"):
            rate = columns(
                blend(g, 0, a0, a1, a2), blend(w, 0, s0, s1, s2), blend(w, 0, t0, t1, t2)
            )
        dt = clock[0][0]
        if wp.static(total):
            rest = T[p]
            T[p] = rest + dt * rate
            rate = rate * wp.inverse(rest)
        if wp.static(total or gradient == "exact"):
            L[p] = rate
        v[p] = u
        C[p] = affine
        now = F[p]
        more = dt * (rate * now)
        if wp.static(total):
            more = more + lost[p]
            lost[p] = more - ((now + more) - now)
        F[p] = now + more
        advance(p, dt * u, low, high, held, x, fault, steps)

    return kernel


@cache
def gather(precision: str):
    """Kernel: value per mass of the nodes, sum_i w_i g_i / (m_i + eps), at the particles."""
    t = types(precision)
    real, vec3 = t.real, t.vec3
    first, offset = stencil(precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        x: wp.array(dtype=vec3),
        grid: wp.array(dtype=t.vec4),
        eps: real,
        dx: real,
        nodes: wp.vec3i,
        out: wp.array(dtype=vec3),
    ):
        p = wp.tid()
        inverse = real(1.0) / dx
        b = first(x[p], inverse, nodes)
        w = weights(offset(x[p], inverse, b))
        total = vec3()
        for i in range(3):
            for j in range(3):
                n = node_index(b[0] + i, b[1] + j, b[2], nodes)
                for k in range(3):
                    g = grid[n + k]
                    if g[3] > real(0.0):
                        scale = w[i, 0] * w[j, 1] * w[k, 2] / (g[3] + eps)
                        total += scale * vec3(g[0], g[1], g[2])
        out[p] = total

    return kernel
