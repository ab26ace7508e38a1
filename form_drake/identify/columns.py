"""Columns of the discretely consistent balance, made with the solver's own transfer.

For one solver step with T the particle-to-grid and G the grid-to-particle transfer,

    v_{n+1} - G[(T v_n) / (m + eps)] - dt g = dt sum_k theta_k G[f(T_k) / (m + eps)],

exactly and linearly in theta: a weak form whose tests are psi_p = sum_i w_ip / (m_i + eps) N_i e_d.
"""

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.laws.kernels import responses, types
from form_drake.mpm.transfer import gather, p2g
from form_drake.mpm.walls import fold_tables, separating_bounds
from form_drake.records.solver import Solver


class Columns:
    """Rows of the balance for a body of particles stepped by a solver.

    Args:
        solver: grid, step, gradient, walls; its decomposition is used for the responses.
        law: whose terms are the columns.
        mass: particle masses [kg], shape [particles].
        volume: reference volumes [m^3], shape [particles].
    """

    def __init__(
        self,
        solver: Solver,
        law: Law,
        mass: np.ndarray,
        volume: np.ndarray,
        *,
        precision: str = "float64",
        device: str = "cpu",
    ):
        self.solver, self.law, self.device = solver, law, device
        self._t = t = types(precision)
        self._dtype = np.float32 if precision == "float32" else np.float64
        n = len(mass)
        self._scatter = p2g(solver.gradient, precision)
        self._gather = gather(precision)
        self._responses = responses(law, solver.decomposition, precision)
        self._mass, self._volume = self._put(mass, t.real), self._put(volume, t.real)
        self._nodes = wp.vec3i(*solver.nodes)
        self._grid = wp.zeros(int(np.prod(solver.nodes)), dtype=t.vec4, device=device)
        self._out = wp.zeros(n, dtype=t.vec3, device=device)
        self._T = wp.zeros((len(law.terms), n), dtype=t.mat, device=device)
        self._zero3 = wp.zeros(n, dtype=t.vec3, device=device)
        self._zero33 = wp.zeros(n, dtype=t.mat, device=device)
        self._own = wp.zeros(0, dtype=t.real, device=device)  # no pressure is supplied
        self._whole = self._put(np.ones(1), t.real)
        self._unit = self._put(np.array([[1.0, 0.0, 0.0, 0.0]]), t.vec4)

    def _put(self, value: np.ndarray, dtype):
        value = np.ascontiguousarray(value, dtype=self._dtype)
        return wp.array(value, dtype=dtype, device=self.device)

    def _scattered(self, x, v, C, tau):
        dx = self._t.real(self.solver.dx)
        self._grid.zero_()
        particles = [x, v, C, tau, self._mass, self._volume, self._whole]
        inputs = [*particles, self._unit, dx, self._nodes, self._grid]
        wp.launch(self._scatter, dim=len(x), inputs=inputs, device=self.device)
        return self._grid

    def _gathered(self, x) -> np.ndarray:
        t, solver = self._t, self.solver
        inputs = [x, self._grid, t.real(solver.mass_eps), t.real(solver.dx), self._nodes, self._out]
        wp.launch(self._gather, dim=len(x), inputs=inputs, device=self.device)
        return self._out.numpy().astype(np.float64)

    def stresses(self, F: np.ndarray, L: np.ndarray, values: Values) -> np.ndarray:
        """Kirchhoff stress per unit of each term [Pa/unit], shape [terms, particles, 3, 3].

        ``values`` holds the constants of the law and, where it reads pressure, ``kappa``.
        """
        t = self._t
        s = t.vec4(*self.law.shape_vector(values))
        kappa = t.real(values.get("kappa", 0.0))
        inputs = [self._put(F, t.mat), self._put(L, t.mat), kappa, self._own, s, self._T]
        wp.launch(self._responses, dim=len(F), inputs=inputs, device=self.device)
        return self._T.numpy().astype(np.float64)

    def forces(self, x: np.ndarray, F: np.ndarray, L: np.ndarray, values: Values) -> np.ndarray:
        """Internal force of each term at the nodes [N/unit], shape [terms, nodes, 3]."""
        self.stresses(F, L, values)
        x_ = self._put(x, self._t.vec3)
        found = np.empty((len(self.law.terms), len(self._grid), 3))
        for k in range(len(found)):
            found[k] = self._scattered(x_, self._zero3, self._zero33, self._T[k]).numpy()[:, :3]
        return found

    def rows(
        self,
        x: np.ndarray,
        v: np.ndarray,
        C: np.ndarray,
        L: np.ndarray,
        F: np.ndarray,
        v_next: np.ndarray,
        values: Values,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One step's balance at every particle.

        Returns:
            A, shape [particles, 3, terms] [m/s per unit]; b, shape [particles, 3] [m/s]; and which
            rows hold, shape [particles, 3]: those whose stencil meets no wall.
        """
        solver, t = self.solver, self._t
        if solver.dt is None:
            raise ValueError("the recording states no fixed solver step, so its steps give no rows")
        self.stresses(F, L, values)
        x_ = self._put(x, t.vec3)
        self._scattered(x_, self._put(v, t.vec3), self._put(C, t.mat), self._zero33)
        b = v_next - self._gathered(x_) - solver.dt * np.array(solver.gravity)
        A = np.empty((len(x), 3, len(self.law.terms)))
        for k in range(A.shape[2]):
            self._scattered(x_, self._zero3, self._zero33, self._T[k])
            A[:, :, k] = solver.dt * self._gathered(x_)
        return A, b, free_rows(solver, x)


def free_rows(solver: Solver, x: np.ndarray) -> np.ndarray:
    """Which velocity components no wall touches, shape [particles, 3]."""
    base = np.floor(x / solver.dx - 0.5)
    low, high = separating_bounds(solver)
    free = (base > low) & (base + 2 < high)
    for axis, (parents, _) in fold_tables(solver).items():
        plain = parents[:, 0] == -1
        ahead = np.unique(parents[parents >= 0])
        plain[ahead] = False
        stencil = base[:, axis].astype(int)[:, None] + np.arange(3)
        free &= plain[np.clip(stencil, 0, len(plain) - 1)].all(axis=1)[:, None]
    return free
