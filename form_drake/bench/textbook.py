"""A peer of the speed bench: the material point method in Warp as textbooks and public codes write it.

Independent of the solver and of its laws. MLS-MPM with APIC and quadratic B-splines, float32,
singular values for the stress, one grid for mass and one for velocity, a plain loop over the 27
nodes, particles in random order, one launch per kernel.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp


@dataclass(frozen=True)
class Job:
    """One elastic body to be stepped.

    Attributes:
        x: positions [m], shape [particles, 3].
        v: velocities [m/s], shape [particles, 3].
        F: deformation gradients [-], shape [particles, 3, 3].
        volume: reference volume of every particle [m^3].
        density: reference density [kg/m^3].
        nodes: grid nodes per axis.
        dx: grid spacing [m].
        dt: time step [s].
        mu: Lame's second constant, the shear modulus [Pa].
        lam: Lame's first constant [Pa].
        tau_y: Frobenius radius of the Kirchhoff deviator at yield [Pa], read by the plastic law.
    """

    x: np.ndarray
    v: np.ndarray
    F: np.ndarray
    volume: float
    density: float
    nodes: int
    dx: float
    dt: float
    mu: float
    lam: float
    tau_y: float


@wp.func
def _corotated(F: wp.mat33, mu: float, lam: float, tau_y: float):
    U, s, V = wp.svd3(F)
    J = s[0] * s[1] * s[2]
    R = U * wp.transpose(V)
    tau = 2.0 * mu * (F - R) * wp.transpose(F) + lam * J * (J - 1.0) * wp.identity(3, dtype=float)
    return F, tau


@wp.func
def _von_mises(F: wp.mat33, mu: float, lam: float, tau_y: float):
    U, s, V = wp.svd3(F)
    e = wp.vec3(wp.log(s[0]), wp.log(s[1]), wp.log(s[2]))
    trace = e[0] + e[1] + e[2]
    d = e - wp.vec3(trace / 3.0)
    excess = 2.0 * mu * wp.length(d) / tau_y
    new = F
    if excess > 1.0:
        e = wp.vec3(trace / 3.0) + d / excess
        stretch = wp.vec3(wp.exp(e[0]), wp.exp(e[1]), wp.exp(e[2]))
        new = U * wp.diag(stretch) * wp.transpose(V)
    tau = U * wp.diag(2.0 * mu * e + wp.vec3(lam * trace)) * wp.transpose(U)
    return new, tau


@wp.func
def _spline(f: wp.vec3):
    a, b, c = wp.vec3(1.5) - f, f - wp.vec3(1.0), f - wp.vec3(0.5)
    return wp.matrix_from_rows(
        0.5 * wp.cw_mul(a, a), wp.vec3(0.75) - wp.cw_mul(b, b), 0.5 * wp.cw_mul(c, c)
    )


@cache
def _p2g(law: str):
    respond = {"fixed-corotated": _corotated, "von-mises": _von_mises}[law]

    @wp.kernel(module="unique", enable_backward=False)
    def p2g(
        x: wp.array(dtype=wp.vec3),
        v: wp.array(dtype=wp.vec3),
        C: wp.array(dtype=wp.mat33),
        F: wp.array(dtype=wp.mat33),
        moduli: wp.vec3,
        volume: float,
        mass: float,
        dx: float,
        dt: float,
        grid_v: wp.array3d(dtype=wp.vec3),
        grid_m: wp.array3d(dtype=float),
    ):
        p = wp.tid()
        new, tau = respond(F[p] + dt * C[p] * F[p], moduli[0], moduli[1], moduli[2])
        F[p] = new
        affine = mass * C[p] - (4.0 * dt * volume / (dx * dx)) * tau
        at = x[p] / dx
        b = wp.vec3i(int(at[0] - 0.5), int(at[1] - 0.5), int(at[2] - 0.5))
        f = at - wp.vec3(float(b[0]), float(b[1]), float(b[2]))
        w = _spline(f)
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    r = (wp.vec3(float(i), float(j), float(k)) - f) * dx
                    weight = w[i, 0] * w[j, 1] * w[k, 2]
                    push = weight * (mass * v[p] + affine * r)
                    wp.atomic_add(grid_v, b[0] + i, b[1] + j, b[2] + k, push)
                    wp.atomic_add(grid_m, b[0] + i, b[1] + j, b[2] + k, weight * mass)

    return p2g


@wp.kernel(enable_backward=False)
def _grid(nodes: int, grid_v: wp.array3d(dtype=wp.vec3), grid_m: wp.array3d(dtype=float)):
    i, j, k = wp.tid()
    if grid_m[i, j, k] > 0.0:
        u = grid_v[i, j, k] / grid_m[i, j, k]
        node = wp.vec3i(i, j, k)
        for a in range(3):
            if (node[a] < 3 and u[a] < 0.0) or (node[a] > nodes - 3 and u[a] > 0.0):
                u[a] = 0.0
        grid_v[i, j, k] = u


@wp.kernel(enable_backward=False)
def _g2p(
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    C: wp.array(dtype=wp.mat33),
    dx: float,
    dt: float,
    grid_v: wp.array3d(dtype=wp.vec3),
):
    p = wp.tid()
    at = x[p] / dx
    b = wp.vec3i(int(at[0] - 0.5), int(at[1] - 0.5), int(at[2] - 0.5))
    f = at - wp.vec3(float(b[0]), float(b[1]), float(b[2]))
    w = _spline(f)
    new_v = wp.vec3()
    new_C = wp.mat33()
    for i in range(3):
        for j in range(3):
            for k in range(3):
                r = (wp.vec3(float(i), float(j), float(k)) - f) * dx
                u = w[i, 0] * w[j, 1] * w[k, 2] * grid_v[b[0] + i, b[1] + j, b[2] + k]
                new_v += u
                new_C += (4.0 / (dx * dx)) * wp.outer(u, r)
    v[p] = new_v
    C[p] = new_C
    x[p] = x[p] + dt * new_v


class Textbook:
    """The textbook kernels in Warp; ``law`` is ``fixed-corotated`` or ``von-mises``."""

    def __init__(self, job: Job, law: str, *, device: str = "cpu"):
        self._job, self._law, self._device = job, law, device
        n, shape = len(job.x), (job.nodes,) * 3
        self._order = np.random.default_rng(0).permutation(n)
        self._x, self._v = (wp.zeros(n, dtype=wp.vec3, device=device) for _ in range(2))
        self._F, self._C = (wp.zeros(n, dtype=wp.mat33, device=device) for _ in range(2))
        self._grid_v = wp.zeros(shape, dtype=wp.vec3, device=device)
        self._grid_m = wp.zeros(shape, dtype=float, device=device)
        self.reset()

    def reset(self) -> None:
        """Back to the start of the job."""
        for name in ("x", "v", "F"):
            start = getattr(self._job, name)[self._order]
            getattr(self, "_" + name).assign(start.astype(np.float32))
        self._C.zero_()

    def step(self, steps: int) -> None:
        """Make steps of the job's dt."""
        job, n, grid = self._job, len(self._job.x), [self._grid_v, self._grid_m]
        moduli = wp.vec3(job.mu, job.lam, job.tau_y)
        sizes = [moduli, job.volume, job.volume * job.density, job.dx, job.dt]
        scatter = [self._x, self._v, self._C, self._F, *sizes, *grid]
        gather = [self._x, self._v, self._C, job.dx, job.dt, self._grid_v]
        for _ in range(steps):
            self._grid_v.zero_()
            self._grid_m.zero_()
            wp.launch(_p2g(self._law), dim=n, inputs=scatter, device=self._device)
            shape = self._grid_m.shape
            wp.launch(_grid, dim=shape, inputs=[job.nodes, *grid], device=self._device)
            wp.launch(_g2p, dim=n, inputs=gather, device=self._device)
        wp.synchronize_device(self._device)

    @property
    def x(self) -> np.ndarray:
        """Positions [m] in the job's order, shape [particles, 3]."""
        out = np.empty((len(self._order), 3))
        out[self._order] = self._x.numpy()
        return out
