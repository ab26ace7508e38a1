"""The grid's own step: momentum to velocity, gravity, and the walls that bound it."""

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.walls import fold_kernels, fold_tables, grid_step, separating_bounds
from form_drake.records.solver import Solver


class Boundary:
    """Walls of one solver, and what their folds need.

    Args:
        solver: grid and walls.
        device: Warp device.
    """

    def __init__(self, solver: Solver, device: str):
        self.solver, self.device = solver, device
        t = types(solver.precision)
        dtype = np.float32 if solver.precision == "float32" else np.float64
        self._eps = t.real(solver.mass_eps)
        self._nodes = wp.vec3i(*solver.nodes)
        low, high = separating_bounds(solver)
        self._bounds = wp.vec3i(*(int(i) for i in low)), wp.vec3i(*(int(i) for i in high))
        self._folds = {}
        for axis, (parents, table) in fold_tables(solver).items():
            held = [np.ascontiguousarray(a, dtype=dtype) for a in (table[:, :4], table[:, 4:])]
            self._folds[axis] = (
                wp.array(parents.astype(np.int32), dtype=wp.vec2i, device=device),
                wp.array(held[0], dtype=t.vec4, device=device),
                wp.array(held[1], dtype=t.real, device=device),
            )
        count = int(np.prod(solver.nodes)) if self._folds else 0
        self._momentum = wp.zeros(count, dtype=t.vec3, device=device)
        self._mass = wp.zeros_like(self._momentum)
        self._folded = wp.zeros(count, dtype=int, device=device)

    def step(self, grid, clock, steps) -> None:
        """Launch the step of the grid; ``steps`` counts it."""
        precision, nodes = self.solver.precision, self._nodes
        if not self._folds:
            inputs = [grid, clock, self._eps, *self._bounds, nodes, steps]
            self._launch(grid_step(precision), len(grid), inputs)
            return
        split, weigh, fold, solve, unfold = fold_kernels(precision)
        sums = [self._momentum, self._mass, self._folded]
        self._launch(split, len(grid), [grid, clock, self._eps, *sums])
        for axis, (parents, table, shares) in self._folds.items():
            self._launch(weigh, self.solver.nodes, [axis, parents, shares, nodes, *sums[1:]])
            self._launch(fold, self.solver.nodes, [axis, parents, table, nodes, *sums])
        inputs = [self._eps, self._momentum, self._mass, grid, *self._bounds, nodes, steps]
        self._launch(solve, self.solver.nodes, inputs)
        for axis, (parents, table, _) in reversed(self._folds.items()):
            inputs = [axis, parents, table, nodes, self._folded, grid]
            self._launch(unfold, self.solver.nodes, inputs)

    def _launch(self, kernel, dim, inputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device)
