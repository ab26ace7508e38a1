"""A peer of the speed bench: MLS-MPM in Taichi, written the way of its public 3-D examples.

The same method and job as ``textbook``, on one CPU thread. Taichi is an optional extra and is
imported when a peer is made.
"""

import contextlib
import importlib.util
import os
import sys

import numpy as np

from form_drake.bench.textbook import Job

NO_TAICHI = "Taichi is not installed (optional extra 'peers'): its row is skipped"


def taichi_available() -> bool:
    """Whether Taichi can be imported."""
    return importlib.util.find_spec("taichi") is not None


def _taichi_p2g(ti, job: Job, fields):
    x, v, C, F, grid_v, grid_m = fields
    mu, lam, dt, dx, volume = job.mu, job.lam, job.dt, job.dx, job.volume
    mass, inv_dx = job.volume * job.density, 1.0 / job.dx

    @ti.kernel
    def p2g():
        for p in x:
            base = (x[p] * inv_dx - 0.5).cast(int)
            fx = x[p] * inv_dx - base.cast(float)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            F[p] = (ti.Matrix.identity(float, 3) + dt * C[p]) @ F[p]
            U, sig, V = ti.svd(F[p])
            J = sig[0, 0] * sig[1, 1] * sig[2, 2]
            stress = 2 * mu * (F[p] - U @ V.transpose()) @ F[p].transpose()
            stress += ti.Matrix.identity(float, 3) * lam * J * (J - 1)
            affine = (-dt * volume * 4 * inv_dx * inv_dx) * stress + mass * C[p]
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                dpos = (offset.cast(float) - fx) * dx
                weight = w[i][0] * w[j][1] * w[k][2]
                grid_v[base + offset] += weight * (mass * v[p] + affine @ dpos)
                grid_m[base + offset] += weight * mass

    return p2g


def _taichi_grid(ti, job: Job, fields):
    grid_v, grid_m = fields[4:]
    nodes = job.nodes

    @ti.kernel
    def grid():
        for n in ti.grouped(grid_m):
            if grid_m[n] > 0:
                grid_v[n] /= grid_m[n]
                for a in ti.static(range(3)):
                    if n[a] < 3 and grid_v[n][a] < 0:
                        grid_v[n][a] = 0
                    if n[a] > nodes - 3 and grid_v[n][a] > 0:
                        grid_v[n][a] = 0

    return grid


def _taichi_g2p(ti, job: Job, fields):
    x, v, C, _F, grid_v, _grid_m = fields
    dt, inv_dx = job.dt, 1.0 / job.dx

    @ti.kernel
    def g2p():
        for p in x:
            base = (x[p] * inv_dx - 0.5).cast(int)
            fx = x[p] * inv_dx - base.cast(float)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.Vector.zero(float, 3)
            new_C = ti.Matrix.zero(float, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                dpos = offset.cast(float) - fx
                g_v = grid_v[base + offset]
                weight = w[i][0] * w[j][1] * w[k][2]
                new_v += weight * g_v
                new_C += 4 * inv_dx * weight * g_v.outer_product(dpos)
            v[p], C[p] = new_v, new_C
            x[p] += dt * v[p]

    return g2p


class Taichi:
    """The fixed-corotated job in Taichi, one CPU thread or one CUDA device."""

    def __init__(self, job: Job, *, device: str = "cpu"):
        os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")
        with contextlib.redirect_stdout(sys.stderr):  # Taichi greets on standard output
            import taichi as ti

            arch = ti.cpu if device == "cpu" else ti.cuda
            ti.init(arch=arch, default_fp=ti.f32, cpu_max_num_threads=1, log_level=ti.ERROR)
        self._ti, self._job, n = ti, job, len(job.x)
        self._order = np.random.default_rng(0).permutation(n)
        vectors = [ti.Vector.field(3, float, shape=n) for _ in range(2)]
        matrices = [ti.Matrix.field(3, 3, float, shape=n) for _ in range(2)]
        shape = (job.nodes,) * 3
        grid = [ti.Vector.field(3, float, shape=shape), ti.field(float, shape=shape)]
        self._fields = [*vectors, *matrices, *grid]
        makers = (_taichi_p2g, _taichi_grid, _taichi_g2p)
        self._kernels = [make(ti, job, self._fields) for make in makers]
        self.reset()

    def reset(self) -> None:
        """Back to the start of the job."""
        x, v, C, F = self._fields[:4]
        for field, start in ((x, self._job.x), (v, self._job.v), (F, self._job.F)):
            field.from_numpy(start[self._order].astype(np.float32))
        C.fill(0)

    def step(self, steps: int) -> None:
        """Make steps of the job's dt."""
        for _ in range(steps):
            for field in self._fields[4:]:
                field.fill(0)
            for kernel in self._kernels:
                kernel()
        self._ti.sync()

    @property
    def x(self) -> np.ndarray:
        """Positions [m] in the job's order, shape [particles, 3]."""
        out = np.empty((len(self._order), 3))
        out[self._order] = self._fields[0].to_numpy()
        return out
