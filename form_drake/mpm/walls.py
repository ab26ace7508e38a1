"""The grid step and its walls.

``separate`` walls lie on nodes and clamp the normal velocity there and behind. ``slip`` and
``stick`` walls are ghost folds: the velocity of a node closer than dx/2 to the plane, or behind it,
is the extrapolation sum_j a_j v_j from nodes in front that makes the velocity on the plane itself
zero (its normal part for slip), and its momentum, force and mass are carried by those nodes with the
same coefficients. The plane is where it is stated, between nodes too. A ghost with little mass in
front of it is not folded but stands still.
"""

from functools import cache

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.transfer import node_index
from form_drake.records.solver import Solver, Wall

NO_WALL = 1 << 30
DEAD = -2
NEAREST = 0.5 - 1e-6
DEEPEST = -2.2
LARGEST_SUM = 1.6
SMALLEST_MASS_SHARE = 0.2


def separating_bounds(solver: Solver) -> tuple[np.ndarray, np.ndarray]:
    """Last low and first high node index of the separating walls per axis, each of shape [3].

    Of two walls on one side of an axis the tighter one counts.
    """
    low, high = np.full(3, -1), np.full(3, NO_WALL)
    for wall in solver.walls:
        if wall.kind != "separate":
            continue
        node = round(wall.position / solver.dx)
        if wall.side < 0:
            low[wall.axis] = max(low[wall.axis], node)
        else:
            high[wall.axis] = min(high[wall.axis], node)
    return low, high


def wall_distance(wall: Wall, dx: float, nodes: int) -> np.ndarray:
    """Distance of the nodes along the wall's axis from its plane [cells], negative behind it."""
    return (np.arange(nodes) * dx - wall.position) * -wall.side / dx


def fold_table(
    wall: Wall, dx: float, nodes: int, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parents and coefficients of every node along the wall's axis.

    Args:
        wall: a slip or stick wall.
        dx: grid spacing [m].
        nodes: number of nodes along the axis.
        free: which of them no wall of the axis replaces, shape [nodes].

    Returns:
        parents, shape [nodes, 2]: node indices, -1 for none; first entry ``DEAD`` deep inside.
        coefficients, shape [nodes, 6]: two for components held at zero on the plane, two for
        components that slide, and the parents' shares in an interpolation.
    """
    parents, coefficients = np.full((nodes, 2), -1), np.zeros((nodes, 6))
    phi = wall_distance(wall, dx, nodes)
    for g in np.flatnonzero(phi < NEAREST):
        distance = 0.5 if abs(phi[g] + 0.5) < 1e-6 else 1.0
        share = np.clip(1.0 - np.abs(phi - distance), 0.0, None)
        ahead = np.flatnonzero((share > 1e-9) & free)[:2]
        if phi[g] < DEEPEST or len(ahead) == 0:
            parents[g, 0] = DEAD
            continue
        w, d = share[ahead], phi[ahead]
        held = phi[g] * w * d / np.sum(w * d * d)
        held *= min(1.0, LARGEST_SUM / max(np.sum(np.abs(held)), 1e-12))
        parents[g, : len(ahead)] = ahead
        coefficients[g, : len(ahead)] = held
        coefficients[g, 2 : 2 + len(ahead)] = held if wall.kind == "stick" else w / np.sum(w)
        coefficients[g, 4 : 4 + len(ahead)] = w / np.sum(w)
    return parents, coefficients


def fold_tables(solver: Solver) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """``fold_table`` per axis that has a slip or stick wall; two walls of an axis are merged."""
    tables: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    folded = [wall for wall in solver.walls if wall.kind != "separate"]
    for wall in folded:
        nodes = solver.nodes[wall.axis]
        free = np.all(
            [wall_distance(w, solver.dx, nodes) >= NEAREST for w in folded if w.axis == wall.axis],
            axis=0,
        )
        new = fold_table(wall, solver.dx, nodes, free)
        if wall.axis in tables:
            old = tables[wall.axis]
            mine = new[0][:, 0] != -1
            new = (
                np.where(mine[:, None], new[0], old[0]),
                np.where(mine[:, None], new[1], old[1]),
            )
        tables[wall.axis] = new
    return tables


@cache
def grid_step(precision: str):
    """Kernel: momentum to velocity, gravity, separating walls."""
    t = types(precision)
    real, vec4 = t.real, t.vec4

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        grid: wp.array(dtype=vec4),
        clock: wp.array(dtype=vec4),
        eps: real,
        low: wp.vec3i,
        high: wp.vec3i,
        nodes: wp.vec3i,
        steps: wp.array(dtype=int),
    ):
        n = wp.tid()
        if n == 0:
            steps[0] = steps[0] + 1
        g = grid[n]
        if g[3] > real(0.0):
            c = clock[0]
            v = vec4()
            k = n % nodes[2]
            j = (n / nodes[2]) % nodes[1]
            i = n / (nodes[1] * nodes[2])
            at = wp.vec3i(i, j, k)
            for a in range(3):
                u = g[a] / (g[3] + eps) + c[0] * c[a + 1]
                if at[a] <= low[a]:
                    u = wp.max(u, real(0.0))
                if at[a] >= high[a]:
                    u = wp.min(u, real(0.0))
                v[a] = u
            v[3] = g[3]
            grid[n] = v

    return kernel


@cache
def fold_kernels(precision: str):
    """Kernels ``split``, ``weigh``, ``fold``, ``solve`` and ``unfold`` of the ghost-fold walls."""
    t = types(precision)
    real, vec3, vec4 = t.real, t.vec3, t.vec4
    share = SMALLEST_MASS_SHARE

    @wp.func
    def parent(i: int, j: int, k: int, axis: int, at: int, nodes: wp.vec3i):
        if axis == 0:
            return node_index(at, j, k, nodes)
        if axis == 1:
            return node_index(i, at, k, nodes)
        return node_index(i, j, at, nodes)

    @wp.func
    def coefficient(c: vec4, which: int, component: int, axis: int):
        return wp.where(component == axis, c[which], c[2 + which])

    @wp.kernel(module="unique", enable_backward=False)
    def split(
        grid: wp.array(dtype=vec4),
        clock: wp.array(dtype=vec4),
        eps: real,
        momentum: wp.array(dtype=vec3),
        mass: wp.array(dtype=vec3),
        folded: wp.array(dtype=int),
    ):
        n = wp.tid()
        g = grid[n]
        c = clock[0]
        impulse = (g[3] + eps) * c[0]
        momentum[n] = vec3(g[0] + impulse * c[1], g[1] + impulse * c[2], g[2] + impulse * c[3])
        mass[n] = vec3(g[3], g[3], g[3])
        folded[n] = 0

    @wp.kernel(module="unique", enable_backward=False)
    def weigh(
        axis: int,
        parents: wp.array(dtype=wp.vec2i),
        shares: wp.array2d(dtype=real),
        nodes: wp.vec3i,
        mass: wp.array(dtype=vec3),
        folded: wp.array(dtype=int),
    ):
        i, j, k = wp.tid()
        at = wp.vec3i(i, j, k)[axis]
        pair = parents[at]
        if pair[0] < 0:
            return
        n = node_index(i, j, k, nodes)
        m = mass[n][axis]
        if m <= real(0.0):
            return
        ahead = real(0.0)
        for q in range(2):
            if pair[q] >= 0:
                ahead += shares[at, q] * mass[parent(i, j, k, axis, pair[q], nodes)][axis]
        if ahead >= real(share) * m:
            folded[n] = folded[n] + (1 << axis)

    @wp.kernel(module="unique", enable_backward=False)
    def fold(
        axis: int,
        parents: wp.array(dtype=wp.vec2i),
        table: wp.array(dtype=vec4),
        nodes: wp.vec3i,
        momentum: wp.array(dtype=vec3),
        mass: wp.array(dtype=vec3),
        folded: wp.array(dtype=int),
    ):
        i, j, k = wp.tid()
        at = wp.vec3i(i, j, k)[axis]
        pair = parents[at]
        if pair[0] < 0:
            return
        n = node_index(i, j, k, nodes)
        if (folded[n] >> axis) & 1 == 0:
            return
        c, m, p = table[at], mass[n], momentum[n]
        for q in range(2):
            if pair[q] >= 0:
                dp = vec3()
                dm = vec3()
                for d in range(3):
                    a = coefficient(c, q, d, axis)
                    size = wp.abs(coefficient(c, 0, d, axis)) + wp.abs(coefficient(c, 1, d, axis))
                    dp[d] = a * p[d]
                    dm[d] = wp.abs(a) * size * m[d]
                target = parent(i, j, k, axis, pair[q], nodes)
                wp.atomic_add(momentum, target, dp)
                wp.atomic_add(mass, target, dm)

    @wp.kernel(module="unique", enable_backward=False)
    def solve(
        eps: real,
        momentum: wp.array(dtype=vec3),
        mass: wp.array(dtype=vec3),
        grid: wp.array(dtype=vec4),
        low: wp.vec3i,
        high: wp.vec3i,
        nodes: wp.vec3i,
        steps: wp.array(dtype=int),
    ):
        i, j, k = wp.tid()
        n = node_index(i, j, k, nodes)
        if n == 0:
            steps[0] = steps[0] + 1
        m = mass[n]
        at = wp.vec3i(i, j, k)
        v = vec4()
        for d in range(3):
            if m[d] > real(0.0):
                u = momentum[n][d] / (m[d] + eps)
                if at[d] <= low[d]:
                    u = wp.max(u, real(0.0))
                if at[d] >= high[d]:
                    u = wp.min(u, real(0.0))
                v[d] = u
        v[3] = grid[n][3]
        grid[n] = v

    @wp.kernel(module="unique", enable_backward=False)
    def unfold(
        axis: int,
        parents: wp.array(dtype=wp.vec2i),
        table: wp.array(dtype=vec4),
        nodes: wp.vec3i,
        folded: wp.array(dtype=int),
        grid: wp.array(dtype=vec4),
    ):
        i, j, k = wp.tid()
        at = wp.vec3i(i, j, k)[axis]
        pair = parents[at]
        if pair[0] == -1:
            return
        n = node_index(i, j, k, nodes)
        v = vec4()
        if (folded[n] >> axis) & 1 == 1:
            c = table[at]
            for q in range(2):
                if pair[q] >= 0:
                    u = grid[parent(i, j, k, axis, pair[q], nodes)]
                    for d in range(3):
                        v[d] = v[d] + coefficient(c, q, d, axis) * u[d]
        v[3] = grid[n][3]
        grid[n] = v

    return split, weigh, fold, solve, unfold
