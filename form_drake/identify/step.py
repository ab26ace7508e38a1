"""Identification from consecutive solver steps: exact, and linear in all but shape constants."""

import time
from collections.abc import Iterator, Mapping

import numpy as np
import warp as wp
from scipy.optimize import minimize_scalar

from form_drake.identify.columns import Columns
from form_drake.identify.solve import (
    ROUNDING,
    Identification,
    LeastSquares,
    Unidentifiable,
    least_squares,
    require_given,
    with_rounding,
)
from form_drake.laws import Law, Values
from form_drake.laws.kernels import types, yield_measures
from form_drake.material import Material
from form_drake.records import Recording, Solver, States, Stepped, stepped

SHAPE_RANGE = (1e-3, 1e3)
SHAPE_GRID = 31
SYMMETRIC = np.triu_indices(3)

Rows = tuple[np.ndarray, np.ndarray]
Solved = tuple[LeastSquares, dict[str, float], tuple[str, ...], np.ndarray]


def identify_step(
    recording: Recording, law: Law, *, observe: str, known: Mapping[str, float]
) -> Identification:
    """Identify a law from full solver states one step apart.

    Args:
        recording: with ``solver``, ``volume``, ``density`` and ``states``.
        law: the law.
        observe: ``full`` also reads the recorded stresses, ``no-stress`` only x, v, C, F.
        known: parameter values that are given; all that ``law.given`` names must be there,
            except a numerical bulk modulus that the motion itself determines.

    Raises:
        ValueError: the recording lacks what is needed.
        Unidentifiable: the motion does not determine the parameters.
    """
    body, states = stepped(recording), recording.states
    if states is None or not states.pairs():
        raise ValueError("the recording holds no two consecutive solver states")
    started = time.perf_counter()
    problem = _StepProblem(body, states, law, observe, known)
    problem.system({k: law.parameter(k).guess[0] for k in problem.shapes})
    if law.radius is not None:
        strain_and_radius(states.F[0], body.solver, law)
    compiled = time.perf_counter()
    solution, values, keys, covariance = problem.solve()
    hidden = np.sqrt(np.diag(covariance)) > np.abs([values[k] for k in keys])
    if hidden.all():
        raise Unidentifiable(keys, "the stress is below the residual; strain the body more")
    if law.radius is not None:
        keys, covariance = _add_yield(problem, values, keys, covariance)
    found = np.array([values[k] for k in keys])
    solver = body.solver
    kind = solver.precision, solver.decomposition
    covariance = with_rounding(covariance, found, solution.condition, *kind)
    material = Material(law, {k: values[k] for k in law.keys}, recording.density, keys, covariance)
    return Identification(
        material=material,
        method="step",
        observed=observe,
        condition=solution.condition,
        residual=solution.residual,
        residual_unit="Pa" if observe == "full" else "m/s",
        rows=solution.rows,
        seconds=time.perf_counter() - compiled,
        compile_seconds=compiled - started,
        misfit=solution.residual / problem.rounding(values),
    )


class _StepProblem:
    """Rows of all recorded steps, for any value of the shape constants."""

    def __init__(
        self,
        body: Stepped,
        states: States,
        law: Law,
        observe: str,
        known: Mapping[str, float],
    ):
        self.states, self.law, self.observe, self.known = states, law, observe, dict(known)
        self.solver = body.solver
        precision = self.solver.precision
        self.columns = Columns(self.solver, law, body.mass, body.volume, precision=precision)
        linear = [t.key for t in law.terms] if law.pressure is None else []
        require_given(law.name, [k for k in law.given if k not in known and k not in linear])
        if states.L is None and self.solver.gradient != "mls":
            raise ValueError(
                "the states hold no velocity gradients L, which equal C for the mls gradient only"
            )
        self.shapes = [k for k in law.constants("shape") if k not in known]
        self.free = [k for k, t in enumerate(law.terms) if t.key not in known]
        self.free_keys = [law.terms[k].key for k in self.free]
        if observe == "full" and (states.tau is None or not np.isfinite(states.tau).any()):
            raise ValueError("the recording holds no stresses: use --observe no-stress")

    def rounding(self, values: Values) -> float:
        """What rounding alone leaves as residual [m/s or Pa]."""
        s = self.states
        eps = float(np.finfo(self.solver.precision).eps)
        if self.observe == "full":
            assert s.tau is not None
            stiff = [abs(values[k]) for k in self.columns.law.keys if k in values]
            scale = max(*stiff, float(np.nanmax(np.abs(s.tau))))
            return ROUNDING[self.solver.decomposition] * eps * scale
        return 8.0 * eps * float(np.max(np.abs(s.v)))

    def system(self, shapes: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """A and b of the unknown terms at given shape constants."""
        constants = {**self.known, **shapes}
        parts = self._stress(constants) if self.observe == "full" else self._motion(constants)
        A, b = (np.concatenate(p) for p in zip(*parts, strict=True))
        for k, term in enumerate(self.law.terms):
            if term.key in self.known:
                b = b - self.known[term.key] * A[:, k]
        return A[:, self.free], b

    def _motion(self, constants: Values) -> Iterator[Rows]:
        s = self.states
        L = s.C if s.L is None else s.L
        for i, j in s.pairs():
            A, b, free = self.columns.rows(s.x[i], s.v[i], s.C[i], L[i], s.F[i], s.v[j], constants)
            yield A[free], b[free]

    def _stress(self, constants: Values) -> Iterator[Rows]:
        s = self.states
        assert s.tau is not None
        L = s.C if s.L is None else s.L
        for i in range(len(s.step)):
            if np.isfinite(s.tau[i]).all():
                T = self.columns.stresses(s.F[i], L[i], constants)[:, :, *SYMMETRIC]
                yield T.reshape(len(T), -1).T, s.tau[i].astype(float)[:, *SYMMETRIC].ravel()

    def solve(self) -> Solved:
        """Solution, all values, identified keys and their covariance (shapes last)."""
        if not self.shapes:
            solution = least_squares(*self.system({}), self.free_keys)
            values = {**self.known, **dict(zip(self.free_keys, solution.theta, strict=True))}
            return solution, values, tuple(self.free_keys), solution.covariance
        if len(self.shapes) > 1:
            raise ValueError(f"more than one unknown shape constant: {', '.join(self.shapes)}")
        return self._solve_shape(self.shapes[0])

    def _solve_shape(self, key: str) -> Solved:
        """Variable projection over one shape constant, polished by Gauss-Newton on all."""

        def misfit(log_c: float) -> float:
            A, b = self.system({key: float(np.exp(log_c))})
            theta = np.linalg.lstsq(A, b, rcond=None)[0]
            return float(np.sum((b - A @ theta) ** 2))

        grid = np.log(np.geomspace(*SHAPE_RANGE, SHAPE_GRID))
        values = np.array([misfit(c) for c in grid])
        best = int(np.argmin(values))
        ends = grid[max(best - 1, 0)], grid[min(best + 1, SHAPE_GRID - 1)]
        log_c = float(minimize_scalar(misfit, bounds=ends, method="bounded").x)
        theta = least_squares(*self.system({key: float(np.exp(log_c))}), self.free_keys).theta
        for _ in range(6):
            h = 1e-3 if self.solver.precision == "float32" else 1e-5
            A, b = self.system({key: float(np.exp(log_c))})
            nearby = [self.system({key: float(np.exp(log_c + s * h))}) for s in (1, -1)]
            predicted = [(A_ @ theta) - (b_ - b) for A_, b_ in nearby]
            J = np.column_stack([A, (predicted[0] - predicted[1]) / (2.0 * h)])
            step = least_squares(J, b - A @ theta, [*self.free_keys, key])
            theta = theta + step.theta[:-1]
            log_c += float(np.clip(step.theta[-1], -0.3, 0.3))
            if abs(step.theta[-1]) < 1e-12:
                break
        c = float(np.exp(log_c))
        covariance = step.covariance.copy()
        covariance[-1] *= c
        covariance[:, -1] *= c
        if np.sqrt(covariance[-1, -1]) > c:
            raise Unidentifiable([key], "its effect is below the residual; strain the body more")
        found = {**self.known, **dict(zip(self.free_keys, theta, strict=True)), key: c}
        return step, found, (*self.free_keys, key), covariance


def yielding(states: States, solver: Solver, law: Law) -> np.ndarray:
    """|dev e| and the law's radius at unit constant of every particle that yielded in a step.

    A particle yields where F_{n+1} differs from the trial value (I + dt L_{n+1}) F_n by more than
    round-off. Shape [samples, 2].

    Raises:
        ValueError: the recording states no fixed step.
    """
    if solver.dt is None:
        raise ValueError(
            "the recording states no fixed solver step: what yields in one is not told"
        )
    dtype = np.float32 if solver.precision == "float32" else np.float64
    L = states.C if states.L is None else states.L
    slack = 200.0 * np.finfo(dtype).eps
    found = []
    for i, j in states.pairs():
        trial = states.F[i] + solver.dt * (L[j] @ states.F[i])
        change = np.abs(states.F[j] - trial).max(axis=(1, 2))
        found.append(states.F[j][change > slack])
    samples = strain_and_radius(np.concatenate(found), solver, law)
    return samples[(samples[:, 1] > 0) & (samples[:, 0] > slack)]


def strain_and_radius(F: np.ndarray, solver: Solver, law: Law) -> np.ndarray:
    """|dev e| of elastic deformation gradients and the law's radius at unit constant, [n, 2]."""
    t = types(solver.precision)
    out = wp.zeros(len(F), dtype=t.vec3, device="cpu")
    if len(F):
        kernel = yield_measures(law, solver.decomposition, solver.precision)
        inputs = [wp.array(F, dtype=t.mat, device="cpu"), t.vec4(1.0, 0.0, 0.0, 0.0), out]
        wp.launch(kernel, dim=len(F), inputs=inputs, device="cpu")
    return out.numpy()[:, :2].astype(float)


def _add_yield(
    problem: _StepProblem, values: dict[str, float], keys: tuple[str, ...], covariance: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Adds the yield parameter, radius_constant / its value at a unit parameter, to ``values``."""
    law = problem.law
    (key,) = law.constants("yield")
    if key in problem.known:
        return keys, covariance
    samples = yielding(problem.states, problem.solver, law)
    if len(samples) < 3:
        raise Unidentifiable([key], "no particle yields between recorded steps; load it further")
    solution: LeastSquares = least_squares(samples[:, 1:], samples[:, 0], [key])
    radius, variance = float(solution.theta[0]), float(solution.covariance[0, 0])

    def unit(at: Values) -> float:
        assert law.radius_constants is not None
        return law.radius_constants({**at, key: 1.0})[0]

    values[key] = radius / unit(values)
    slopes = np.zeros(len(keys))
    for n, k in enumerate(keys):
        h = 1e-6 * abs(values[k])
        slopes[n] = np.diff([radius / unit({**values, k: values[k] + s * h}) for s in (-1, 1)])[0]
        slopes[n] /= 2.0 * h
    cross = covariance @ slopes
    own = variance / unit(values) ** 2 + slopes @ cross
    covariance = np.block([[covariance, cross[:, None]], [cross[None, :], np.array([[own]])]])
    return (*keys, key), covariance
