"""Kernels of what rigid tools and the material give each other.

A tool pushes particles before they are scattered: a particle of which the ball of its size reaches
into the tool by a depth gets the velocity change beta depth / dt - u_n along the normal, if that pushes:
also a tool that sticks lets go of what leaves it. Along the surface it is held where it touched: s being how far it has
gone from there, it gets -(u_t + beta s / dt), up to Coulomb's bound, which a tool that sticks has not; beyond it s grows no more. A
bonded tool prescribes the velocity of the grid nodes inside it (on a grid over the rest shape, of those
that it held at rest). Every impulse given to the material is taken from the tool, so that momentum is
kept to round-off. Flat plates are others over the rest shape, see ``form_drake.mpm.plates``.

Over the rest shape, a body may end at a bonded tool's flat face, half-way between two nodes. With the node
inside at rest, the body would move at its face by half of what the node outside does, as if it were half a
cell longer. So these two move oppositely about the tool: the face moves with it.

There particles are boxes, pushed where they touch: at the end T H a of one, a = H T^T n / |H T^T n|, where
H has half its edges on the diagonal and T is its deformation; the impulse there gives it an affine motion
too. What bears a load needs no depth: depths add up (the integral term of a controller) until none is
left. That has to be fast, and fade where a particle has left: what pushes late drives vibrations.
"""

from functools import cache

import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.solids import distance, solid_type
from form_drake.mpm.transfer import place_type

# Share of its depth that a particle is pushed out by in one step. Since a step's depth carries the
# load, a small one is a soft surface; 1 lets what hits the tool bounce back.
BETA = 0.75
HALFWAY = 0.01  # of a cell, by which a face may be off the middle between two nodes
LEARN = 0.3  # share of its depth that a step adds to what pushes a particle at no depth
FADE = 0.03  # share of that which a step takes from a particle that has left


@cache
def impulse(precision: str):
    """Warp function that takes an impulse j at r from tool n."""
    t = types(precision)

    @wp.func
    def give(taken: wp.array2d(dtype=wp.vec3d), n: int, r: t.vec3, j: t.vec3):
        m = wp.cross(r, j)
        wp.atomic_add(taken, n, 0, wp.vec3d(wp.float64(j[0]), wp.float64(j[1]), wp.float64(j[2])))
        wp.atomic_add(taken, n, 1, wp.vec3d(wp.float64(m[0]), wp.float64(m[1]), wp.float64(m[2])))

    return give


@cache
def contact(precision: str, total: bool = False):
    """Kernel of the impulses between the particles and one tool."""
    t = types(precision)
    where = place_type(precision, total)
    real, vec3 = t.real, t.vec3
    far, Struct, give = distance(precision), solid_type(precision), impulse(precision)
    beta, learn = wp.constant(real(BETA)), wp.constant(real(LEARN))
    fade = wp.constant(real(1.0 - FADE))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        many: int,
        n: int,
        solid: Struct,
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        clock: wp.array(dtype=t.vec4),
        grips: wp.array(dtype=t.vec4),
        dx: real,
        x: wp.array(dtype=where),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=t.mat),
        T: wp.array(dtype=t.mat),
        mass: wp.array(dtype=real),
        half: wp.array(dtype=vec3),
        slip: wp.array2d(dtype=vec3),
        taken: wp.array2d(dtype=wp.vec3d),
    ):
        begin = many * wp.tid()
        for p in range(begin, wp.min(begin + many, len(x))):
            r = vec3(real(x[p][0]), real(x[p][1]), real(x[p][2])) - place[n]
            near = far(solid, wp.transpose(turn[n]) * r)
            grip = grips[n]
            normal = turn[n] * vec3(near[0], near[1], near[2])
            edge = half[p]
            ahead = real(0.0)
            if wp.static(total):
                ahead = wp.length(wp.cw_mul(edge, wp.transpose(T[p]) * normal))
            else:
                ahead = wp.cbrt(edge[0] * edge[1] * edge[2])
            depth = ahead - near[3]
            dt = clock[0][0]
            gone = slip[n, p]
            borne = real(0.0)
            if wp.static(total):
                borne = wp.max(wp.dot(normal, gone) + learn * depth, real(0.0))
                if depth < real(0.0):
                    borne = fade * borne
            if depth + borne <= real(0.0) or dt <= real(0.0):
                slip[n, p] = vec3()
                continue
            # the affine motion that an impulse off the middle of a particle amounts to
            arm = vec3()
            lever = vec3()
            if wp.static(total):
                back = wp.transpose(T[p]) * normal
                arm = -ahead * normal
                lever = -wp.cw_mul(edge, wp.normalize(wp.cw_mul(edge, back)))
            u = v[p] - speed[n] - wp.cross(spin[n], r)
            along = wp.dot(normal, u)
            push = beta * (depth + borne) / dt - along
            if push <= real(0.0):
                slip[n, p] = borne * normal
                continue
            sliding = u - along * normal
            gone = gone - wp.dot(normal, gone) * normal + dt * sliding
            wanted = sliding + (beta / dt) * gone
            size = wp.length(wanted)
            share = real(1.0)
            friction = grip[0]
            if friction >= real(0.0) and size > friction * push:
                share = friction * push / size
            slip[n, p] = share * gone + borne * normal
            change = push * normal - share * wanted
            v[p] = v[p] + change
            C[p] = C[p] + wp.outer(change, real(4.0) / (dx * dx) * lever)
            give(taken, n, r + arm, -mass[p] * change)

    return kernel


def _across(precision: str):
    """Warp function: steps from a node to the one that a face half-way between both mirrors it to.

    Zero where there is none, or where the body goes on inside.
    """
    t = types(precision)
    real = t.real
    along, off = wp.constant(real(1.0 - HALFWAY)), wp.constant(real(HALFWAY))

    @wp.func
    def across(grid: wp.array(dtype=t.vec4), i: int, nodes: wp.vec3i, normal: t.vec3, depth: real):
        stride = int(0)
        for axis in range(3):
            if wp.abs(normal[axis]) > along:
                step = wp.where(axis == 0, nodes[1] * nodes[2], wp.where(axis == 1, nodes[2], 1))
                stride = wp.where(normal[axis] > real(0.0), step, -step)
        halfway = wp.abs(depth - real(0.5)) < off
        if stride == 0 or not halfway or grid[i - stride][3] > real(0.0):
            return int(0)
        return stride

    return across


@cache
def bond(precision: str, total: bool = False):
    """Kernel that moves the nodes inside one tool with it, or those that were inside it at rest."""
    t = types(precision)
    real, vec3 = t.real, t.vec3
    far, Struct, give = distance(precision), solid_type(precision), impulse(precision)
    across = _across(precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        n: int,
        solid: Struct,
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        place_rest: wp.array(dtype=vec3),
        turn_rest: wp.array(dtype=t.mat),
        dx: real,
        nodes: wp.vec3i,
        grid: wp.array(dtype=t.vec4),
        taken: wp.array2d(dtype=wp.vec3d),
    ):
        i = wp.tid()
        node = grid[i]
        if node[3] <= real(0.0):
            return
        c = i % nodes[2]
        b = (i / nodes[2]) % nodes[1]
        a = i / (nodes[1] * nodes[2])
        r = dx * vec3(real(a), real(b), real(c)) - place_rest[n]
        local = wp.transpose(turn_rest[n]) * r
        near = far(solid, local)
        if near[3] > real(0.0):
            return
        v = vec3(node[0], node[1], node[2])
        if wp.static(total):
            out = vec3(near[0], near[1], near[2])
            face = turn[n] * (local - near[3] * out)
            j = i + across(grid, i, nodes, turn_rest[n] * out, -near[3] / dx)
            if j != i:
                other = grid[j]
                u_face = speed[n] + wp.cross(spin[n], face)
                off = v + vec3(other[0], other[1], other[2]) - real(2.0) * u_face
                impulse = -(node[3] * other[3] / (node[3] + other[3])) * off
                give(taken, n, face, real(-2.0) * impulse)
                both = t.vec4(impulse[0], impulse[1], impulse[2], real(0.0))
                grid[i] = node + both / node[3]
                grid[j] = other + both / other[3]
                return
            r = turn[n] * local
        u = speed[n] + wp.cross(spin[n], r)
        give(taken, n, r, node[3] * (v - u))
        grid[i] = t.vec4(u[0], u[1], u[2], node[3])

    return kernel


@cache
def carry(precision: str):
    """Kernel that moves every tool by one step of its motion."""
    t = types(precision)
    real, vec3 = t.real, t.vec3

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        clock: wp.array(dtype=t.vec4),
    ):
        n = wp.tid()
        dt = clock[0][0]
        place[n] = place[n] + dt * speed[n]
        angle = dt * wp.length(spin[n])
        if angle > real(0.0):
            K = wp.skew(wp.normalize(spin[n]))
            R = turn[n]
            turn[n] = R + wp.sin(angle) * (K * R) + (real(1.0) - wp.cos(angle)) * (K * (K * R))

    return kernel


@cache
def decay(precision: str):
    """Kernel that lets velocities and their gradients decay at a rate [1/s]."""
    t = types(precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        clock: wp.array(dtype=t.vec4),
        rate: wp.array(dtype=t.real),
        v: wp.array(dtype=t.vec3),
        C: wp.array(dtype=t.mat),
    ):
        p = wp.tid()
        if rate[0] > t.real(0.0):
            left = wp.exp(-rate[0] * clock[0][0])
            v[p] = left * v[p]
            C[p] = left * C[p]

    return kernel
