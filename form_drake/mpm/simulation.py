"""An explicit material point simulation: state, steps, snapshots and rollouts."""

import math
import threading
from collections.abc import Collection

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.laws.kernels import types, update
from form_drake.mpm.model import CFL, Body, State, stable_dt
from form_drake.mpm.transfer import g2p, p2g
from form_drake.mpm.walls import fold_kernels, fold_tables, grid_step, separating_bounds
from form_drake.records.solver import Solver

__all__ = ["BlowUp", "Body", "Simulation", "State", "stable_dt"]

GRAPH_STEPS = 20

_capture_lock = threading.Lock()


class BlowUp(ValueError):
    """The simulation left the domain or stopped being finite."""


class Simulation:
    """One body of one law on one grid.

    Several simulations may run in as many threads, since Warp releases the interpreter lock while
    a graph of steps runs; make them before the threads start, since making one records its graphs.
    """

    def __init__(self, solver: Solver, law: Law, body: Body, *, device: str = "cpu"):
        self.solver, self.law, self.body, self.device = solver, law, body, device
        self._t = types(solver.precision)
        self._dtype = np.float32 if solver.precision == "float32" else np.float64
        self._kernels = (
            p2g(solver.gradient, solver.precision),
            g2p(solver.gradient, solver.precision),
            update(law, solver.decomposition, solver.precision),
        )
        self._values: dict[str, float] | None = None
        self._dt = 0.0
        self._allocate()
        if solver.dt is not None:
            self._set_dt(solver.dt)
        self._graphs = {steps: self._recorded(steps) for steps in (1, GRAPH_STEPS)}

    def _array(self, value: np.ndarray, dtype):
        value = np.ascontiguousarray(value, dtype=self._dtype)
        return wp.array(value, dtype=dtype, device=self.device)

    def _allocate(self) -> None:
        t, solver, n = self._t, self.solver, len(self.body.x)
        volume = np.broadcast_to(self.body.volume, n)
        self._mass = self._array(volume * self.body.density, t.real)
        self._volume = self._array(volume, t.real)
        self._x = self._array(self.body.x, t.vec3)
        self._v = wp.zeros_like(self._x)
        self._C = wp.zeros(n, dtype=t.mat, device=self.device)
        self._L = self._C if solver.gradient == "mls" else wp.zeros_like(self._C)
        self._F = self._array(np.tile(np.eye(3), (n, 1, 1)), t.mat)
        self._tau = wp.zeros_like(self._C)
        self._theta = wp.zeros(len(self.law.terms), dtype=t.real, device=self.device)
        self._constants = wp.zeros(2, dtype=t.vec4, device=self.device)
        self._clock = wp.zeros(1, dtype=t.vec4, device=self.device)
        self._fault = wp.full(2, -1, dtype=int, device=self.device)
        self._steps = wp.zeros(1, dtype=int, device=self.device)
        self._project = wp.ones(1, dtype=int, device=self.device)
        nodes = solver.nodes
        self._nodes = wp.vec3i(*nodes)
        self._grid = wp.zeros(nodes[0] * nodes[1] * nodes[2], dtype=t.vec4, device=self.device)
        extent = np.array(nodes) * solver.dx
        edge = solver.dx * (0.5 if solver.margin is None else solver.margin)
        self._low, self._high = t.vec3(*([edge] * 3)), t.vec3(*(extent - edge))
        if solver.margin is None:
            self._high = t.vec3(*(extent - 1.5 * solver.dx))
        low, high = separating_bounds(solver)
        self._bounds = wp.vec3i(*(int(i) for i in low)), wp.vec3i(*(int(i) for i in high))
        self._folds = {
            axis: (
                wp.array(parents.astype(np.int32), dtype=wp.vec2i, device=self.device),
                self._array(table[:, :4], t.vec4),
                self._array(table[:, 4:], t.real),
            )
            for axis, (parents, table) in fold_tables(solver).items()
        }
        if self._folds:
            self._momentum = wp.zeros(len(self._grid), dtype=t.vec3, device=self.device)
            self._node_mass = wp.zeros_like(self._momentum)
            self._folded = wp.zeros(len(self._grid), dtype=int, device=self.device)

    def _set_dt(self, dt: float) -> None:
        self._dt = dt
        self._clock.assign(np.array([[dt, *self.solver.gravity]], dtype=self._dtype))

    def set_material(self, values: Values) -> None:
        """Give every parameter of the law a value (SI units)."""
        missing = [k for k in self.law.keys if k not in values]
        if missing:
            raise ValueError(f"{self.law.name} needs a value for {', '.join(missing)}")
        self._values = dict(values)
        self._theta.assign(self.law.theta(values).astype(self._dtype))
        vectors = np.stack([self.law.shape_vector(values), self.law.radius_vector(values)])
        self._constants.assign(vectors.astype(self._dtype))

    def reset(self, x: np.ndarray, v: np.ndarray, **state: np.ndarray) -> None:
        """Start from positions and velocities, at rest shape unless C, L, F are given."""
        n = len(self.body.x)
        eye, zero = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3))
        C = state.get("C", zero)
        self._write(x=x, v=v, C=C, L=state.get("L", C), F=state.get("F", eye))
        self._steps.zero_()
        self._fault.fill_(-1)
        self._project.zero_()
        self._launch_update()
        self._project.fill_(1)

    def _write(self, **arrays: np.ndarray) -> None:
        for name, value in arrays.items():
            target = getattr(self, "_" + name)
            target.assign(np.ascontiguousarray(value, dtype=self._dtype))

    def state(self) -> State:
        """Snapshot of everything that the next step reads."""
        arrays = {
            k: getattr(self, "_" + k).numpy().copy() for k in ("x", "v", "C", "L", "F", "tau")
        }
        return State(**arrays, step=int(self._steps.numpy()[0]))

    def restore(self, state: State) -> None:
        """Continue from a snapshot, bit for bit on the CPU."""
        self._write(**{k: getattr(state, k) for k in ("x", "v", "C", "L", "F", "tau")})
        self._steps.fill_(state.step)
        self._fault.fill_(-1)

    @property
    def dt(self) -> float:
        """Current time step [s]."""
        return self._dt

    @property
    def x(self) -> np.ndarray:
        """Positions [m], shape [particles, 3]."""
        return self._x.numpy().copy()

    @property
    def v(self) -> np.ndarray:
        """Velocities [m/s], shape [particles, 3]."""
        return self._v.numpy().copy()

    def _launch(self, kernel, dim, inputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device)

    def _launch_update(self) -> None:
        inputs = [self._project, self._F, self._L, self._theta, self._constants, self._tau]
        self._launch(self._kernels[2], len(self.body.x), inputs)

    def _launch_walls(self) -> None:
        precision, nodes = self.solver.precision, self._nodes
        eps = self._t.real(self.solver.mass_eps)
        if not self._folds:
            inputs = [self._grid, self._clock, eps, *self._bounds, nodes, self._steps]
            self._launch(grid_step(precision), len(self._grid), inputs)
            return
        split, weigh, fold, solve, unfold = fold_kernels(precision)
        grids = [self._momentum, self._node_mass, self._folded]
        self._launch(split, len(self._grid), [self._grid, self._clock, *grids])
        for axis, (parents, table, shares) in self._folds.items():
            self._launch(weigh, self.solver.nodes, [axis, parents, shares, nodes, *grids[1:]])
            self._launch(fold, self.solver.nodes, [axis, parents, table, nodes, *grids])
        inputs = [eps, self._momentum, self._node_mass, self._grid, *self._bounds, nodes]
        self._launch(solve, self.solver.nodes, [*inputs, self._steps])
        for axis, (parents, table, _) in reversed(self._folds.items()):
            inputs = [axis, parents, table, nodes, self._folded, self._grid]
            self._launch(unfold, self.solver.nodes, inputs)

    def _launch_step(self) -> None:
        n, dx = len(self.body.x), self._t.real(self.solver.dx)
        scatter, gather, _ = self._kernels
        self._grid.zero_()
        particles = [self._x, self._v, self._C, self._tau, self._mass, self._volume]
        self._launch(scatter, n, [*particles, self._clock, dx, self._nodes, self._grid])
        self._launch_walls()
        held = self.solver.margin is not None
        domain = [self._grid, self._clock, dx, self._nodes, self._low, self._high, held]
        moved = [self._x, self._v, self._C, self._L, self._F, self._fault, self._steps]
        self._launch(gather, n, [*domain, *moved])
        self._launch_update()

    def _recorded(self, steps: int):
        """Graph of some steps; every kernel is loaded before recording starts."""
        self._launch_step()
        self.reset(self.body.x, np.zeros_like(self.body.x))
        with _capture_lock, wp.ScopedCapture(device=self.device) as capture:
            for _ in range(steps):
                self._launch_step()
        return capture.graph

    def step(self, steps: int = 1) -> None:
        """Make steps of the current dt.

        Raises:
            ValueError: there is no material, or no dt yet.
            BlowUp: a particle is not finite or left the domain.
        """
        if self._values is None:
            raise ValueError("the simulation has no material yet: call set_material first")
        if steps and not self._dt:
            raise ValueError("the solver states no dt: use advance, which chooses one")
        for _ in range(steps // GRAPH_STEPS):
            wp.capture_launch(self._graphs[GRAPH_STEPS])
        for _ in range(steps % GRAPH_STEPS):
            wp.capture_launch(self._graphs[1])
        self._check()

    def _check(self) -> None:
        particle, step = (int(i) for i in self._fault.numpy())
        if particle < 0:
            return
        limit = stable_dt(self.law, self._values, self.body.density, self.solver.dx, cfl=1.0)
        cause = "a wall is missing or the body is thrown out of the grid"
        if self._dt > limit:
            cause = f"the time step {self._dt:.3g} s exceeds the stability limit {limit:.3g} s"
        raise BlowUp(
            f"the simulation broke down in step {step}: particle {particle} left the domain or is"
            f" not finite; likely {cause}"
        )

    def advance(self, duration: float) -> None:
        """Advance by a time [s], in steps of the solver's dt or else within the stability limit.

        The limit is found anew after every 20 steps, from the speeds then and what gravity can add
        to them in 20 steps; steps in between are equal, and the last one ends on the duration.
        """
        if not 0.0 <= duration < math.inf:
            raise ValueError(f"duration {duration} s: a finite one of at least 0 is wanted")
        if self.solver.dt is not None:
            steps = round(duration / self.solver.dt)
            if abs(steps * self.solver.dt - duration) > 1e-6 * max(duration, self.solver.dt):
                raise ValueError(
                    f"{duration} s is not a whole number of the fixed steps of {self.solver.dt} s"
                )
            self.step(steps)
            return
        while duration > 0.0:
            steps = int(np.ceil(duration / self._limit()))
            self._set_dt(duration / steps)
            self.step(min(steps, GRAPH_STEPS))
            duration = (steps - GRAPH_STEPS) * self._dt

    def _limit(self) -> float:
        """Time step [s] that stays stable while gravity acts for ``GRAPH_STEPS`` steps."""
        fastest = float(np.sqrt(np.max(np.sum(self._v.numpy() ** 2, axis=1), initial=0.0)))
        dx, g = self.solver.dx, float(np.linalg.norm(self.solver.gravity))
        limit = stable_dt(self.law, self._values, self.body.density, dx, fastest)
        # dt (CFL dx / limit + GRAPH_STEPS g dt) = CFL dx
        gain = GRAPH_STEPS * g * limit**2 / (CFL * dx)
        return 2.0 * limit / (1.0 + math.sqrt(1.0 + 4.0 * gain))

    def run(self, frames: Collection[int], progress=None) -> np.ndarray:
        """Positions [m] at the given solver steps, shape [frames, particles, 3].

        Frames count from the current state and must not decrease; the step is fixed.
        """
        out = np.empty((len(frames), len(self.body.x), 3), dtype=self._dtype)
        done = 0
        for i, frame in enumerate(frames):
            self.step(int(frame) - done)
            done = int(frame)
            out[i] = self._x.numpy()
            if progress is not None:
                progress(i + 1, len(frames))
        return out
