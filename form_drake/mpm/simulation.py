"""An explicit material point simulation: state, steps, snapshots and rollouts."""

import math
import threading
from collections.abc import Collection, Sequence

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.laws.kernels import lag, types, update
from form_drake.laws.memory import Memory, remember, vectors
from form_drake.mpm.grid import Grid
from form_drake.mpm.held import Held
from form_drake.mpm.model import CFL, Body, State, joined, spring, stable_dt
from form_drake.mpm.pace import STEPS, Pace
from form_drake.mpm.tools import Tool, Tools
from form_drake.mpm.touch import decay
from form_drake.mpm.transfer import place_type
from form_drake.records.solver import Solver

__all__ = ["BlowUp", "Body", "Simulation", "State", "stable_dt"]

# Steps that one launch makes: longer graphs take longer to record than they save.
GRAPHS = (4, 2, 1)

_capture_lock = threading.Lock()

# Share of the grid's velocities over the rest shape that particles give anew in an elastic body's step, see
# ``grid``; with tools that push particles all, as these would swing.
TAKEN = 0.03
# Courant number there without such tools; what is pressed far may be stiffer than at rest.
REST = 0.6


class BlowUp(ValueError):
    """The simulation left the domain or stopped being finite."""


class Simulation:
    """Bodies, each of its own law, and rigid tools on one grid.

    Args:
        solver: grid, step and walls.
        law: of the body, or one for each body.
        body: one or several; their particles are held one body after the other.
        tools: that touch or hold the particles.
        memories: of the bodies, whose laws are then elastic ones.
        total: whether the grid is laid over the rest shape, as suits solids that stay one piece; then
            without walls.
        device: Warp device.

    Several simulations may run in as many threads, since Warp releases the interpreter lock while
    a graph of steps runs; make them before the threads start, since making one records its graphs.
    """

    def __init__(
        self,
        solver: Solver,
        law: Law | Sequence[Law],
        body: Body | Sequence[Body],
        *,
        tools: Sequence[Tool] = (),
        memories: Sequence[Memory] = (),
        total: bool = False,
        device: str = "cpu",
    ):
        self.solver, self.device, self.memories = solver, device, tuple(memories)
        self.total = total
        self.laws = (law,) if isinstance(law, Law) else tuple(law)
        self.bodies = (body,) if isinstance(body, Body) else tuple(body)
        if len(self.laws) != len(self.bodies) or not self.bodies:
            raise ValueError(f"{len(self.laws)} laws for {len(self.bodies)} bodies: one for each")
        if memories and any(law.flow != "elastic" for law in self.laws):
            raise ValueError(f"{self.laws[0].name} remembers: only elastic laws can")
        if not total and any(tool.plate for tool in tools):
            raise ValueError("plates are at a body over its rest shape alone")
        if total and solver.walls:
            raise ValueError("a grid over the rest shape meets no walls: take tools")
        self.body = joined(self.bodies)
        self._lags = total and any(t.unit == "Pa s" for law in self.laws for t in law.terms)
        own = len(self.body.x), solver.precision, device, solver.nodes
        self.tools = Tools(tuple(tools), *own, total)
        self._t = types(solver.precision)
        self._dtype = np.float32 if solver.precision == "float32" else np.float64
        cfl = REST if total and not self.tools.touch else CFL
        self.pace = Pace(solver, self.laws, self.bodies, lagging=self._lags, cfl=cfl)
        self._dt = 0.0
        self._held: State | None = None
        self._allocate()
        if solver.dt is not None:
            self._set_dt(solver.dt)
        self._launch_step()  # loads every kernel before recording starts
        self.reset(self.body.x, np.zeros_like(self.body.x))
        self._graphs = {steps: self._recorded(steps) for steps in GRAPHS}

    def _array(self, value: np.ndarray, dtype):
        value = np.ascontiguousarray(value, dtype=self._dtype)
        return wp.array(value, dtype=dtype, device=self.device)

    def _allocate(self) -> None:
        t, solver, n = self._t, self.solver, len(self.body.x)
        self._mass = self._array(self.body.mass, t.real)
        self.grid = Grid(solver, self.body, self._mass, self.total, self.device)
        self._half = self._array(self.body.half, t.vec3)
        self._x = wp.zeros(n, dtype=place_type(solver.precision, self.total), device=self.device)
        self._v = wp.zeros(n, dtype=t.vec3, device=self.device)
        self._C = wp.zeros(n, dtype=t.mat, device=self.device)
        own = self.total or solver.gradient == "exact"
        self._L = wp.zeros_like(self._C) if own else self._C
        self._F = self._array(np.tile(np.eye(3), (n, 1, 1)), t.mat)
        self._lost = wp.zeros(n if self.total else 0, dtype=t.mat, device=self.device)
        self._tau = wp.zeros_like(self._C)
        self._felt = wp.zeros_like(self._L) if self._lags else self._L
        self._late = wp.zeros((2, n if self._lags else 0), dtype=t.mat, device=self.device)
        self._T = wp.clone(self._F) if self.total else self._F
        count = len(self.memories)
        self._parts = wp.zeros((count, n), dtype=t.mat, device=self.device)
        self._plastic = wp.zeros((count, n), dtype=t.real, device=self.device)
        self._memories = self._array(vectors(self.memories), t.vec4)
        self._theta = [wp.zeros(len(w.terms), dtype=t.real, device=self.device) for w in self.laws]
        self._constants = [wp.zeros(2, dtype=t.vec4, device=self.device) for _ in self.laws]
        self._springs = [wp.zeros(2, dtype=t.real, device=self.device) for _ in self.laws]
        self._damping = wp.zeros(1, dtype=t.real, device=self.device)
        self._time = Held(wp.zeros(1, dtype=t.vec4, device=self.device))
        self._clock = self._time.array
        self._faults = Held(wp.full(2, -1, dtype=int, device=self.device))
        self._fault = self._faults.array
        self._steps = wp.zeros(1, dtype=int, device=self.device)
        self._project = wp.ones(1, dtype=int, device=self.device)

    def _set_dt(self, dt: float) -> None:
        self._dt = dt
        self._time.write([dt, *self.solver.gravity])
        self._blend()

    def _blend(self) -> None:
        """Let particles give anew as much in a time, however many steps what is viscous makes of it."""
        if self.total and not self.tools.touch and self.pace.known:
            self.grid.share.write(1.0 - (1.0 - TAKEN) ** (self._dt / self.pace.elastic))

    def set_material(self, values: Values, body: int = 0) -> None:
        """Give every parameter of a body's law a value (SI units).

        Raises:
            ValueError: one is missing, or larger than the solver's precision can hold.
        """
        law = self.laws[body]
        missing = [k for k in law.keys if k not in values]
        if missing:
            raise ValueError(f"{law.name} needs a value for {', '.join(missing)}")
        theta, precision = law.theta(values), self.solver.precision
        if not np.all(np.abs(theta) <= np.finfo(self._dtype).max):
            raise ValueError(
                f"{law.name}: a parameter of {np.abs(theta).max():.3g} is more than {precision} holds"
            )
        self.pace.set_material(values, body)
        self._blend()
        self._theta[body].assign(theta.astype(self._dtype))
        vectors = np.stack([law.shape_vector(values), law.radius_vector(values)])
        self._constants[body].assign(vectors.astype(self._dtype))
        least = float(np.min(self.bodies[body].density))
        series = [spring(law, values, least, self.solver.dx), law.viscosity(values)]
        self._springs[body].assign(np.array(series, dtype=self._dtype))

    def set_damping(self, rate: float) -> None:
        """Let velocities decay at a rate [1/s], as for settling; 0 from the start."""
        self._damping.fill_(rate)

    def set_memories(self, memories: Sequence[Memory]) -> None:
        """Change what the parts forget; there are as many as from the start."""
        self._memories.assign(vectors(memories).astype(self._dtype))

    def reset(self, x: np.ndarray, v: np.ndarray, **state: np.ndarray) -> None:
        """Start from positions and velocities, at rest shape unless C, L, F are given.

        Where C and L are one matrix, with ``mls``, C counts.
        """
        n = len(self.body.x)
        eye, zero = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3))
        C = state.get("C", state.get("L", zero) if self._L is self._C else zero)
        F = state.get("F", eye)
        self._write(x=x, v=v, L=state.get("L", C), C=C, F=F)
        if self.total:
            self._write(T=state.get("T", eye), lost=zero)
        if self.memories:
            self._write(parts=np.tile(F, (len(self.memories), 1, 1, 1)))
            self._plastic.zero_()
        self.tools.release()
        self._steps.zero_()
        self._fault.fill_(-1)
        self._project.zero_()
        self._launch_update()
        self._project.fill_(1)
        if self.total:
            self.grid.begin(self._x, self._v, self._C, self._T)

    def _write(self, **arrays: np.ndarray) -> None:
        self._held = None
        for name, value in arrays.items():
            target = getattr(self, "_" + name)
            double = name == "x" and self.total
            target.assign(np.ascontiguousarray(value, dtype=float if double else self._dtype))

    @property
    def _kept(self) -> tuple[str, ...]:
        """Arrays of the particles that a snapshot holds."""
        kept = ("x", "v", "L", "C", "F", "tau")  # C counts where it is L too
        kept += ("T", "lost") if self.total else ()
        kept += ("late", "felt") if self._lags else ()
        return (*kept, "parts", "plastic") if self.memories else kept

    def state(self) -> State:
        """Snapshot of the material, all that the next step reads but where ``tools`` are.

        Its arrays are not written again.
        """
        if self._held is None:
            arrays = {k: getattr(self, "_" + k).numpy().copy() for k in self._kept}
            if self.total:
                arrays["grid"] = self.grid.velocity
            if self.tools.plates is not None:
                arrays |= {"face": self.tools.plates.face, "anchor": self.tools.plates.anchor}
            self._held = State(**arrays, slip=self.tools.slip, step=int(self._steps.numpy()[0]))
        return self._held

    def restore(self, state: State) -> None:
        """Continue from a snapshot, bit for bit on the CPU; tools are moved by whoever steps."""
        if state is self._held:
            return
        self._write(**{k: getattr(state, k) for k in self._kept})
        if self.total:
            self.grid.begin(self._x, self._v, self._C, self._T)
        if state.grid.size:
            self.grid.velocity = state.grid
        if state.slip.size:
            self.tools.slip = state.slip
        if self.tools.plates is not None:
            self.tools.plates.face, self.tools.plates.anchor = state.face, state.anchor
        self._steps.fill_(state.step)
        self._fault.fill_(-1)
        self._held = state

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
        solver, start = self.solver, 0
        for law, body, theta, constants, series in zip(
            self.laws, self.bodies, self._theta, self._constants, self._springs, strict=True
        ):
            own = slice(start, start + len(body.x))
            start = own.stop
            if self._lags:
                kernel = lag(law, solver.decomposition, solver.precision)
                inputs = [self._project, self._clock, series, self._F[own], self._L[own]]
                inputs += [theta, constants, self._late[:, own], self._felt[own]]
                self._launch(kernel, len(body.x), inputs)
            kernel = update(law, solver.decomposition, solver.precision)
            inputs = [self._F[own], self._felt[own], theta, constants]
            more = []
            if self.memories:
                kernel = remember(law, solver.decomposition, solver.precision)
                inputs = [self._clock, self._memories, *inputs]
                more = [self._parts[:, own], self._plastic[:, own]]
            self._launch(kernel, len(body.x), [self._project, *inputs, *more, self._tau[own]])

    def _launch_step(self) -> None:
        n, dx = len(self.body.x), self._t.real(self.solver.dx)
        grid, clock, tools = self.grid, self._clock, self.tools
        self._launch(decay(self.solver.precision), n, [clock, self._damping, self._v, self._C])
        if tools.tools:
            moved = [self._x, self._v, self._C, self._T]
            tools.push(clock, dx, *moved, self._mass, self._half)
        grid.scatter(self._x, self._v, self._C, self._tau, self._T, clock, self._damping)
        grid.step(clock, self._steps)
        if tools.tools:
            tools.hold(clock, dx, grid.nodes, grid.values)
        moved = [self._x, self._v, self._C, self._L, self._F, self._lost, self._T]
        grid.gather(*moved, self._fault, self._steps, clock)
        self._launch_update()

    def _recorded(self, steps: int):
        """Graph of some steps."""
        with _capture_lock, wp.ScopedCapture(device=self.device) as capture:
            for _ in range(steps):
                self._launch_step()
        return capture.graph

    def step(self, steps: int = 1) -> None:
        """Make steps of the current dt.

        Raises:
            ValueError: there is no material, or no dt yet, or steps are negative.
            BlowUp: a particle is not finite or left the domain.
        """
        if steps < 0:
            raise ValueError(f"{steps} steps: at least 0 are wanted; a simulation goes on only")
        if not self.pace.known:
            raise ValueError("a body has no material yet: call set_material first")
        if steps and not self._dt:
            raise ValueError("the solver states no dt: use advance, which chooses one")
        self._held = None
        for size in GRAPHS:
            for _ in range(steps // size):
                wp.capture_launch(self._graphs[size])
            steps %= size
        self._check()

    def _check(self) -> None:
        particle, step = (int(i) for i in self._faults.read())
        if particle < 0:
            return
        limit = self.pace.stable(cfl=1.0)
        cause = "a wall is missing, the body is thrown out of the grid or its material is unstable"
        if self._dt > limit:
            cause = f"the time step {self._dt:.3g} s exceeds the stability limit {limit:.3g} s"
        raise BlowUp(
            f"the simulation broke down in step {step}: particle {particle} left the domain or is"
            f" not finite; likely {cause}"
        )

    def advance(self, duration: float) -> None:
        """Advance by a time [s], in steps of the solver's dt or else within the stability limit.

        The limit is found anew after every 20 steps, from the speeds then and what gravity can add
        to them in 20 steps; steps in between are equal, and the last one ends on the duration. On a
        grid over the rest shape, which no particle crosses, speeds do not count.
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
            limit = self.pace.stable() if self.total else self._limit()
            steps = int(np.ceil(duration / limit))
            most = steps if self.total else STEPS
            self._set_dt(duration / steps)
            self.step(min(steps, most))
            duration = (steps - most) * self._dt

    def _limit(self) -> float:
        """Time step [s] that stays stable for ``STEPS`` steps from the speeds now."""
        return self.pace.falling(
            math.sqrt(np.max(np.sum(self._v.numpy() ** 2, axis=1), initial=0.0))
        )

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
