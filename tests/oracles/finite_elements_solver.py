"""Mesh, contact and time stepping of the reference finite elements. SI units.

Total Lagrangian 27-node bricks, 3 x 3 x 3 Gauss points, consistent mass M. With x = X + u and
F = I + sum_a u_a grad N_a the balance of the nodes is

    M a + int P grad N dV - int rho g N dV - contact - reaction = 0

Time: TR-BDF2. With G = 2 - sqrt(2), q = G h/2, alpha = 1/(G (2 - G)), beta = (1 - G)^2 alpha, one
step from 0 over h is a trapezoidal stage 1 at G h and a backward one 2 at h, both balanced:

    v1 = (u1 - u0)/q - v0                      a1 = (v1 - v0)/q - a0
    v2 = (u2 - alpha u1 + beta u0)/q           a2 = (v2 - alpha v1 + beta v0)/q

Second order, unconditionally stable, rid of a contact's ringing within a step or two; every
force belongs to the end of its step. In both stages a = u/q^2 + known, so that one factorised
tangent serves both, and following steps too as long as Newton's corrections shrink fivefold.

A plate holds the nodes that it has touched, exactly; the pusher is a stiff penalty.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

GAUSS, GAUSS_WEIGHT = np.polynomial.legendre.leggauss(3)
IJK = np.indices((3, 3, 3)).reshape(3, 27)
G = 2 - np.sqrt(2)
ALPHA = 1 / (G * (2 - G))
BETA = (1 - G) ** 2 * ALPHA
TOLERANCE = 1e-10  # largest Newton correction left undone [m]


def lagrange(s):
    """The three quadratic shape functions (N, 3) at s in [-1, 1] (N,), and their slopes."""
    values = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], -1)
    return values, np.stack([s - 0.5, -2 * s, s + 0.5], -1)


def brick(s):
    """The 27 shape functions (N, 27) at s (N, 3), and their gradients (N, 27, 3)."""
    (n, d), i = lagrange(s), IJK
    x, y, z = (n[:, axis, i[axis]] for axis in range(3))
    slopes = [d[:, 0, i[0]] * y * z, x * d[:, 1, i[1]] * z, x * y * d[:, 2, i[2]]]
    return x * y * z, np.stack(slopes, -1)


class Mesh:
    """A box of 27-node bricks between the planes ``edges`` (three increasing arrays) [m].

    Attributes:
        X: Node positions (N, 3) [m].
        cells: Nodes of the elements (E, 27).
        gradient: Shape gradients (E, 27, 81) [1/m], the last index running over Gauss point, axis.
        weight: Volumes of the Gauss points (E, 27) [m^3].
        mass: int N_a N_b dV (N, N) [m^3], sparse.
    """

    def __init__(self, edges):
        """Lay the nodes and integrate the shape functions."""
        self.edges = edges = [np.asarray(e, float) for e in edges]
        lines = [np.sort(np.concatenate([e, (e[1:] + e[:-1]) / 2])) for e in edges]
        self.shape = tuple(len(line) for line in lines)
        self.X = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3)
        element = np.indices([len(e) - 1 for e in edges]).reshape(3, -1)
        grid = 2 * element[:, :, None] + IJK[:, None, :]
        self.cells = np.ravel_multi_index(tuple(grid), self.shape)
        half = np.stack([np.diff(e)[k] / 2 for e, k in zip(edges, element, strict=True)], -1)
        points = np.stack(np.meshgrid(GAUSS, GAUSS, GAUSS, indexing="ij"), -1).reshape(-1, 3)
        N, slope = brick(points)
        gradient = slope.transpose(1, 0, 2) / half[:, None, None, :]
        self.gradient = gradient.reshape(len(half), 27, 81)
        weight = np.einsum("i,j,k->ijk", *[GAUSS_WEIGHT] * 3).ravel()
        self.weight = weight * half.prod(1)[:, None]
        self._pattern()
        self.mass = self._sum(np.einsum("eq,qa,qb->eab", self.weight, N, N))

    def _pattern(self):
        """Where the entries of the element matrices go in a sparse matrix over the nodes."""
        count = len(self.X)
        pairs = (self.cells[:, :, None] * count + self.cells[:, None, :]).ravel()
        unique, self._slot = np.unique(pairs, return_inverse=True)
        self._column = unique % count
        self._row = np.concatenate([[0], np.cumsum(np.bincount(unique // count))])

    def _sum(self, blocks):
        """Sparse sum of element matrices (E, 27, 27)."""
        data = np.bincount(self._slot, blocks.ravel())
        return sp.csr_matrix((data, self._column, self._row), (len(self.X),) * 2)

    def stiffness(self, blocks):
        """Sparse sum (3N, 3N) of element matrices (E, 27, 27, 3, 3), rows by node and axis."""
        blocks = blocks.reshape(-1, 9)
        data = np.stack([np.bincount(self._slot, blocks[:, k]) for k in range(9)], -1)
        full = (data.reshape(-1, 3, 3), self._column, self._row)
        return sp.bsr_matrix(full, shape=(3 * len(self.X),) * 2)

    def sampler(self, points):
        """Sparse shape functions (Q, N) at the reference positions points (Q, 3) [m]."""
        cell, s = np.empty(points.shape, int), np.empty(points.shape)
        for axis, e in enumerate(self.edges):
            k = np.clip(np.searchsorted(e, points[:, axis], "right") - 1, 0, len(e) - 2)
            cell[:, axis], s[:, axis] = k, 2 * (points[:, axis] - e[k]) / (e[k + 1] - e[k]) - 1
        grid = 2 * cell.T[:, :, None] + IJK[:, None, :]
        column = np.ravel_multi_index(tuple(grid), self.shape)
        entries = (brick(s)[0].ravel(), column.ravel(), 27 * np.arange(len(points) + 1))
        return sp.csr_matrix(entries, (len(points), len(self.X)))


class Plate:
    """A rigid plate z = height(t) [m] above (side 1) or below (side -1) a body, frictionless or not.

    It holds z of those of its nodes that it has touched; a frictionless one lets go of nodes it
    would have to pull, a sticking one holds x and y too where the touch found them.
    """

    def __init__(self, nodes, height, *, side=1, sticking=False):
        """Start away from the nodes."""
        self.nodes, self.height, self.side, self.sticking = nodes, height, side, sticking
        self.active, self.anchor = np.zeros(len(nodes), bool), np.zeros((len(nodes), 2))

    def hold(self, mask, target, X, time):
        """Write into the held dofs ``mask`` and displacements ``target`` (N, 3) [m]."""
        held = self.nodes[self.active]
        mask[held, 2], target[held, 2] = True, self.height(time) - X[held, 2]
        if self.sticking:
            mask[held, :2], target[held, :2] = True, self.anchor[self.active]

    def settled(self, X, u, reaction, time):
        """Whether the touched nodes are the right ones; if not, change them."""
        depth = self.side * ((X + u)[self.nodes, 2] - self.height(time))
        touched = ~self.active & (depth > TOLERANCE)
        pulled = self.active & (self.side * reaction[self.nodes, 2] > 1e-9)
        wrong = touched | (pulled & (not self.sticking))
        self.anchor[touched] = u[self.nodes[touched], :2]
        self.active = self.active ^ wrong
        return not wrong.any()


class Pusher:
    """A rigid frictionless cylinder along y against surface points.

    With d = (x - centre) in the x-z plane, r = |d|, n = d/r and the penetration g = max(R - r, 0)
    each point of reference area w bears the force w k g n.
    """

    def __init__(self, mesh, points, weight, centre, *, radius, stiffness):
        """Take points (Q, 3) [m], their areas (Q,) [m^2], centre(t) [m] and k [Pa/m]."""
        self.sampler = mesh.sampler(points)
        self.matrix = sp.kron(self.sampler, np.eye(3), "csr")
        self.points, self.weight, self.centre = points, weight, centre
        self.radius, self.stiffness = radius, stiffness

    def touch(self, u, time):
        """Positions (Q, 3) [m], r (Q, 1) [m], n (Q, 3) and g (Q, 1) [m]."""
        x = self.points + self.sampler @ u
        d = (x - self.centre(time)) * [1.0, 0.0, 1.0]
        r = np.hypot(d[:, :1], d[:, 2:])
        return x, r, d / r, np.maximum(self.radius - r, 0)

    def forces(self, u, time):
        """Positions (Q, 3) [m] and forces on the body (Q, 3) [N]."""
        x, _, n, g = self.touch(u, time)
        return x, self.weight[:, None] * self.stiffness * g * n

    def slope(self, u, time):
        """Slopes (Q, 3, 3) [N/m] of the forces by the positions."""
        _, r, n, g = self.touch(u, time)
        k = self.weight[:, None] * self.stiffness
        normal = n[:, :, None] * n[:, None, :]
        across = np.diag([1.0, 0.0, 1.0]) - normal
        return (k * (g / r))[..., None] * across - (k * (g > 0))[..., None] * normal

    def tangent(self, slope):
        """Sparse slope (3N, 3N) of the nodal forces, or 0."""
        used = np.flatnonzero(slope.any((1, 2)))
        if not len(used):
            return 0
        rows = (3 * used[:, None] + np.arange(3)).ravel()
        block = sp.bsr_matrix((slope[used], np.arange(len(used)), np.arange(len(used) + 1)))
        return self.matrix[rows].T @ block @ self.matrix[rows]


class Solver:
    """A body in motion: displacement u, velocity v, acceleration a (N, 3), state of the law.

    ``reaction`` (N, 3) [N] is the force of supports and plate on the nodes.
    """

    def __init__(self, mesh, law, p, *, density, gravity, fixed, plates=(), pusher=None):
        """Start stress-free and at rest, the dofs ``fixed`` (N, 3) held for good."""
        self.mesh, self.law, self.p, self.density = mesh, law, p, density
        self.fixed, self.plates, self.pusher = fixed, plates, pusher
        self.u, self.v, self.a = (np.zeros_like(mesh.X) for _ in range(3))
        self.reaction = np.zeros_like(mesh.X)
        self.state = np.tile(np.eye(3), (mesh.weight.size, 1, 1))
        self.weight = density * (mesh.mass @ np.ones(len(mesh.X)))[:, None] * gravity
        self.factors = self.key = None
        self.time, self.factorisations, self.iterations = 0.0, 0, 0

    def stress(self, u, *, tangent=False):
        """P, state and A at all Gauss points of displacements u."""
        cells = self.mesh.cells
        F = u[cells].mT @ self.mesh.gradient
        F = F.reshape(len(cells), 3, 27, 3).transpose(0, 2, 1, 3).reshape(-1, 3, 3) + np.eye(3)
        return self.law(F, self.state, self.p, tangent=tangent)

    def internal(self, P):
        """Nodal forces (N, 3) [N] of the stresses P: int P grad N dV."""
        scaled = (P * self.mesh.weight.reshape(-1, 1, 1)).mT
        local = self.mesh.gradient @ scaled.reshape(len(self.mesh.cells), 81, 3)
        nodes = self.mesh.cells.ravel()
        sums = [np.bincount(nodes, local[..., k].ravel(), len(self.mesh.X)) for k in range(3)]
        return np.stack(sums, -1)

    def residual(self, u, a, time):
        """Reaction (N, 3) [N] that the balance asks for, and the state of the law."""
        P, state, _ = self.stress(u)
        force = self.density * (self.mesh.mass @ a) + self.internal(P) - self.weight
        if self.pusher:
            force -= self.pusher.sampler.T @ self.pusher.forces(u, time)[1]
        return force, state

    def factorise(self, u, inertia, time, free):
        """Factorise the tangent of the free dofs at u; inertia = da/du [1/s^2]."""
        A = self.stress(u, tangent=True)[2]
        count = len(self.mesh.cells)
        A = (A * self.mesh.weight.reshape(-1, 1, 1, 1, 1)).transpose(0, 2, 1, 3, 4)
        shape = self.mesh.gradient.reshape(count, 27, 27, 3).transpose(0, 2, 3, 1)
        half = A.reshape(count, 27, 27, 3) @ shape  # element, Gauss point, (J i k), b
        blocks = self.mesh.gradient @ half.reshape(count, 81, 243)
        blocks = blocks.reshape(count, 27, 3, 3, 27).transpose(0, 1, 4, 2, 3)
        K = self.mesh.stiffness(blocks)
        K = K + sp.kron(self.density * inertia * self.mesh.mass, np.eye(3))
        if self.pusher:
            K = K - self.pusher.tangent(self.pusher.slope(u, time))
        K = K.tocsr()[free][:, free].tocsc()
        options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
        self.factors = splu(K, **options, options={"SymmetricMode": True})
        self.factorisations += 1

    def newton(self, u, mask, inertia, known, time):
        """Bring the free dofs into balance; returns u, reaction and the state of the law."""
        free = np.flatnonzero(~mask.ravel())
        key = (inertia, mask.tobytes())
        stale, last = key != self.key, np.inf
        self.key = key
        for _ in range(40):
            self.iterations += 1
            force, state = self.residual(u, inertia * u + known, time)
            if stale:
                self.factorise(u, inertia, time, free)
            change = np.zeros(u.size)
            change[free] = self.factors.solve(-force.ravel()[free])
            size = np.abs(change).max()
            if size < TOLERANCE:
                return u, force, state
            if not size < np.ptp(self.mesh.X):
                break
            stale, last = size > 0.2 * last, size
            u = u + change.reshape(u.shape)
        raise FloatingPointError(f"no equilibrium at {time} s: corrections of {size:.1e} m")

    def stage(self, guess, inertia, known, time):
        """Balance at ``time`` with a = inertia u + known; commits reaction and state."""
        settled = [False]
        while not all(settled):
            mask, target = self.fixed.copy(), np.zeros_like(guess)
            for plate in self.plates:
                plate.hold(mask, target, self.mesh.X, time)
            guess = np.where(mask, target, guess)
            u, reaction, state = self.newton(guess, mask, inertia, known, time)
            settled = [plate.settled(self.mesh.X, u, reaction, time) for plate in self.plates]
        self.reaction, self.state = reaction, state
        return u

    def rest(self, time=None):
        """Go to static equilibrium at ``time`` [s] (default: now)."""
        self.time = self.time if time is None else time
        self.v, self.a = np.zeros_like(self.u), np.zeros_like(self.u)
        self.u = self.stage(self.u, 0.0, self.a, self.time)

    def step(self, h):
        """Move on by h [s], in halves where Newton fails."""
        before = (self.u, self.v, self.a, self.reaction, self.state, self.time)
        touched = [plate.active for plate in self.plates]
        try:
            self.single(h)
        except FloatingPointError:
            if h < 1e-6:
                raise
            self.u, self.v, self.a, self.reaction, self.state, self.time = before
            self.key = None
            for plate, active in zip(self.plates, touched, strict=True):
                plate.active = active
            self.step(h / 2)
            self.step(h / 2)

    def single(self, h):
        """One step of TR-BDF2 over h [s]."""
        q, (u0, v0, a0) = G * h / 2, (self.u, self.v, self.a)
        guess = u0 + G * h * v0 + (G * h) ** 2 / 2 * a0
        u1 = self.stage(guess, 1 / q**2, -(u0 / q + 2 * v0) / q - a0, self.time + G * h)
        v1 = (u1 - u0) / q - v0
        known = ((BETA * u0 - ALPHA * u1) / q - ALPHA * v1 + BETA * v0) / q
        guess = u0 + h * v0 + h**2 / 2 * ((v1 - v0) / (G * h))
        self.u = self.stage(guess, 1 / q**2, known, self.time + h)
        self.v = (self.u - ALPHA * u1 + BETA * u0) / q
        self.a = self.u / q**2 + known
        self.time += h
