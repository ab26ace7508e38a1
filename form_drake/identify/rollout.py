"""Identification from positions alone: Levenberg-Marquardt on rollouts of the solver.

Unknown are the logarithms of all parameters and, where asked for, the rigid initial motion; the
residual is predicted minus observed position, so the answer is the maximum of the likelihood for
independent noise of equal variance. Derivatives are differences of rollouts run in threads.
"""

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from queue import SimpleQueue

import numpy as np
from tqdm import tqdm

from form_drake.identify.solve import LARGEST_CONDITION, Identification, Unidentifiable
from form_drake.laws import Law
from form_drake.material import Material
from form_drake.mpm.simulation import BlowUp, Body, Simulation
from form_drake.records import Recording, stepped

HORIZONS = {0.2: 2e-2, 0.4: 3e-3, 1.0: 3e-4}
MOST_FRAMES = 101
STEP = 1e-3
LONGEST_STEP = np.log(2.5)
DAMPING = (1e-8, 1e4)
MOST_ITERATIONS = 40
CHORDS = 3
TWIST = ("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z")


@dataclass(frozen=True)
class Guess:
    """Values of the unknowns.

    Attributes:
        values: parameter values by key.
        twist: rigid initial motion about the centroid (v [m/s], omega [rad/s]), shape [6], or None
            where the initial velocities are known.
    """

    values: dict[str, float]
    twist: np.ndarray | None = None


class Rollouts:
    """Predicts a recording's positions for trial parameters, several at a time."""

    def __init__(self, recording: Recording, law: Law, known: Mapping[str, float]):
        stated = stepped(recording)
        solver = stated.solver
        if recording.step is None or solver.dt is None:
            raise ValueError("the recording states no solver step for its frames")
        self.recording, self.law, self.known = recording, law, dict(known)
        must = [k for k in law.given if k not in known]
        if must:
            raise ValueError(
                f"{law.name} needs given values for {', '.join(must)}: state them as --known"
                f" {','.join(k + '=VALUE' for k in must)}"
            )
        self.sought = [k for k in law.keys if k not in known]
        self.steps = recording.step - recording.step[0]
        self.count = 0
        body = Body(recording.reference, stated.volume, stated.density)
        workers = max(1, min(os.cpu_count() or 1, 8))
        self._pool = ThreadPoolExecutor(workers)
        self._simulations: dict[bool, SimpleQueue[Simulation]] = {}
        for rough in (True, False):
            self._simulations[rough] = SimpleQueue()
            chosen = replace(solver, decomposition="series") if rough else solver
            for _ in range(workers):
                self._simulations[rough].put(Simulation(chosen, law, body))

    def velocities(self, twist: np.ndarray | None) -> np.ndarray:
        """Initial velocities [m/s], shape [points, 3]."""
        if twist is None:
            if self.recording.v_0 is None:
                raise ValueError("the recording holds no initial velocities")
            return self.recording.v_0
        arm = self.recording.reference - self.recording.reference.mean(axis=0)
        return twist[:3] + np.cross(twist[3:], arm)

    def _one(self, guess: Guess, frames: np.ndarray, rough: bool) -> np.ndarray | None:
        simulation = self._simulations[rough].get()
        try:
            simulation.set_material({**self.known, **guess.values})
            simulation.reset(self.recording.reference, self.velocities(guess.twist))
            positions = simulation.run(self.steps[frames])
            return self._residual(positions, frames)
        except BlowUp:
            return None
        finally:
            self._simulations[rough].put(simulation)

    def residuals(
        self, guesses: Sequence[Guess], frames: np.ndarray, *, rough: bool
    ) -> list[np.ndarray | None]:
        """Predicted minus observed coordinates [m] of the valid points, flat, for each guess.

        None where a rollout broke down. ``rough`` rollouts need no singular values: faster, and
        right but for the rounding of the recording's solver.
        """
        self.count += len(guesses)
        return list(self._pool.map(lambda g: self._one(g, frames, rough), guesses))

    def _residual(self, positions: np.ndarray, frames: np.ndarray) -> np.ndarray:
        difference = (positions - self.recording.p_WQ[frames]).astype(float)
        if self.recording.valid is None:
            return difference.ravel()
        return difference[self.recording.valid[frames]].ravel()

    def frames(self, horizon: float) -> np.ndarray:
        """Indices of at most ``MOST_FRAMES`` frames up to a share of the recording."""
        last = max(1, round(horizon * (self.recording.frames - 1)))
        return np.unique(np.linspace(0, last, min(last + 1, MOST_FRAMES)).round().astype(int))

    def close(self) -> None:
        """Release the threads."""
        self._pool.shutdown()


def mean_square(residual: np.ndarray | None) -> float:
    """Mean of the squares [m^2]; infinite for a rollout that blew up."""
    if residual is None:
        return np.inf
    value = float(residual @ residual) / len(residual)
    return value if np.isfinite(value) else np.inf


def as_vector(guess: Guess, keys: Sequence[str]) -> np.ndarray:
    """Logarithms of the parameters, then the twist."""
    logs = np.log([guess.values[k] for k in keys])
    return logs if guess.twist is None else np.concatenate([logs, guess.twist])


def as_guess(vector: np.ndarray, keys: Sequence[str]) -> Guess:
    """Inverse of ``as_vector``."""
    values = dict(zip(keys, np.exp(vector[: len(keys)]).tolist(), strict=True))
    return Guess(values, vector[len(keys) :] if len(vector) > len(keys) else None)


def rigid_start(recording: Recording) -> np.ndarray:
    """Rigid motion [6] that best carries the reference to the first later frame, less gravity."""
    frame = min(1, recording.frames - 1)
    duration = float(recording.time[frame] - recording.time[0])
    if duration <= 0:
        raise ValueError("an unknown initial velocity needs at least two frames")
    x = recording.reference
    fall = 0.5 * duration * np.asarray(recording.gravity)
    v = (recording.p_WQ[frame] - x) / duration - fall
    arm = x - x.mean(axis=0)
    inertia = np.einsum("pi,pi,jk->jk", arm, arm, np.eye(3)) - arm.T @ arm
    omega = np.linalg.solve(inertia, np.cross(arm, v - v.mean(axis=0)).sum(axis=0))
    return np.concatenate([v.mean(axis=0), omega])


class LevenbergMarquardt:
    """The iteration on one set of frames."""

    def __init__(self, rollouts: Rollouts, frames: np.ndarray, bar: tqdm, *, rough: bool):
        self.rollouts, self.frames, self.bar, self.rough = rollouts, frames, bar, rough
        self.keys = rollouts.sought

    def residuals(self, vectors: Sequence[np.ndarray]) -> list[np.ndarray | None]:
        """Residuals [m] of trial vectors."""
        guesses = [as_guess(v, self.keys) for v in vectors]
        self.bar.update(len(vectors))
        return self.rollouts.residuals(guesses, self.frames, rough=self.rough)

    def jacobian(self, vector: np.ndarray, base: np.ndarray) -> np.ndarray | None:
        """Derivative of the residual by forward differences, backward where forward fails."""
        columns = []
        steps = STEP * np.eye(len(vector))
        for step, ahead in zip(steps, self.residuals([vector + s for s in steps]), strict=True):
            if ahead is not None:
                columns.append((ahead - base) / STEP)
                continue
            (behind,) = self.residuals([vector - step])
            if behind is None:
                return None
            columns.append((base - behind) / STEP)
        return np.column_stack(columns)

    def central_jacobian(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and its derivative by central differences."""
        steps = STEP * np.eye(len(vector))
        probes = [vector, *(vector + s for s in steps), *(vector - s for s in steps)]
        n = len(vector)
        found = [r for r in self.residuals(probes) if r is not None]
        if len(found) < len(probes):
            raise ValueError("the simulation breaks down at the start: give another with --start")
        pairs = zip(found[1 : n + 1], found[n + 1 :], strict=True)
        return found[0], np.column_stack([(a - b) / (2.0 * STEP) for a, b in pairs])

    def nearby(self, vector: np.ndarray) -> np.ndarray:
        """The best of the vectors that change every parameter by a factor of 2.5 or not."""
        n = len(self.keys)
        shifts = [np.zeros(n), *LONGEST_STEP * np.eye(n), *-LONGEST_STEP * np.eye(n)]
        if n <= 3:
            shifts = [LONGEST_STEP * np.array(s) for s in product((0, -1, 1), repeat=n)]
        pad = np.zeros(len(vector) - n)
        vectors = [vector + np.concatenate([s, pad]) for s in shifts]
        costs = [mean_square(r) for r in self.residuals(vectors)]
        return vectors[int(np.argmin(costs))]

    def fit(self, vector: np.ndarray, tolerance: float) -> np.ndarray:
        """Minimise from ``vector`` until the parameters move by less than ``tolerance``."""
        (residual,) = self.residuals([vector])
        cost, damping = mean_square(residual), 1e-2
        for _ in range(MOST_ITERATIONS):
            J = None if residual is None else self.jacobian(vector, residual)
            if J is None:
                break
            normal, slope = J.T @ J, J.T @ residual
            found = None
            while found is None and damping <= DAMPING[1]:
                trials = [damping, 0.01 * damping]
                vectors = [vector + self._step(normal, slope, d) for d in trials]
                residuals = self.residuals(vectors)
                costs = [mean_square(r) for r in residuals]
                pick = int(np.argmin(costs))
                if costs[pick] < cost:
                    found = vectors[pick], residuals[pick], costs[pick]
                    damping = max(trials[pick], DAMPING[0])
                else:
                    damping *= 100.0
            if found is None:
                break
            moved = float(np.max(np.abs((found[0] - vector)[: len(self.keys)])))
            vector, residual, cost = found
            self.bar.set_postfix_str(f"rms {np.sqrt(cost):.2e} m", refresh=False)
            if moved < tolerance:
                break
        return vector

    def polish(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gauss-Newton with one central-difference Jacobian; vector, residual, Jacobian."""
        residual, J = self.central_jacobian(vector)
        normal = J.T @ J
        cost = mean_square(residual)
        for _ in range(CHORDS):
            step = self._step(normal, J.T @ residual, 0.0)
            (new,) = self.residuals([vector + step])
            if new is None or mean_square(new) >= cost:
                break
            gain, cost = cost - mean_square(new), mean_square(new)
            vector, residual = vector + step, new
            if gain < 1e-3 * cost:
                break
        return vector, residual, J

    def _step(self, normal: np.ndarray, slope: np.ndarray, damping: float) -> np.ndarray:
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / np.outer(scale, scale) + damping * np.eye(len(scale))
        step = -np.linalg.lstsq(scaled, slope / scale, rcond=1e-12)[0] / scale
        longest = np.max(np.abs(step[: len(self.keys)]), initial=0.0)
        return step * min(1.0, LONGEST_STEP / max(longest, 1e-300))


def identify_rollout(
    recording: Recording,
    law: Law,
    *,
    known: Mapping[str, float],
    start: Guess,
    rollouts: Rollouts | None = None,
) -> Identification:
    """Identify every parameter jointly from positions.

    Args:
        recording: positions at solver steps, with ``solver``, ``volume`` and ``density``.
        law: the law.
        known: parameter values that are given.
        start: where the iteration starts; its twist asks for the rigid initial motion too.
        rollouts: to be reused; made anew by default.

    Raises:
        ValueError: the recording lacks what is needed, or no start is stable.
        Unidentifiable: the motion does not determine the parameters.
    """
    begun = time.perf_counter()
    rollouts = rollouts or Rollouts(recording, law, known)
    vector = as_vector(start, rollouts.sought)
    with tqdm(desc="rollouts", unit="", disable=None, delay=2, leave=False) as bar:
        rough = LevenbergMarquardt(rollouts, rollouts.frames(min(HORIZONS)), bar, rough=True)
        vector = rough.nearby(vector)
        for horizon, tolerance in HORIZONS.items():
            rough.frames = rollouts.frames(horizon)
            vector = rough.fit(vector, tolerance)
        every = np.arange(recording.frames)
        exact = LevenbergMarquardt(rollouts, every, bar, rough=False)
        vector, residual, J = exact.polish(vector)
    return _answer(recording, law, rollouts, vector, residual, J, begun)


def _answer(
    recording: Recording,
    law: Law,
    rollouts: Rollouts,
    vector: np.ndarray,
    residual: np.ndarray,
    J: np.ndarray,
    begun: float,
) -> Identification:
    keys = rollouts.sought
    scale = np.linalg.norm(J, axis=0)
    names = [*keys, *(TWIST if len(vector) > len(keys) else ())]
    dead = [n for n, s in zip(names, scale, strict=True) if not s > 0]
    if dead:
        raise Unidentifiable(dead, "no position depends on it; record a motion that loads it")
    correlation = (J / scale).T @ (J / scale)
    eigenvalues, vectors = np.linalg.eigh(correlation)
    if eigenvalues[0] * LARGEST_CONDITION < eigenvalues[-1]:
        weak = [n for n, c in zip(names, vectors[:, 0], strict=True) if abs(c) > 0.1]
        raise Unidentifiable(weak, "record a longer or livelier motion")
    inverse = (vectors / eigenvalues) @ vectors.T / np.outer(scale, scale)
    dof = max(len(residual) - len(vector), 1)
    spread = float(np.sqrt(residual @ residual / dof))
    noise = spread if recording.noise is None else max(recording.noise, 0.0)
    covariance = noise**2 * inverse
    guess = as_guess(vector, keys)
    values = np.array([guess.values[k] for k in keys])
    n = len(keys)
    details: dict[str, object] = {"rollouts": rollouts.count, "position_noise": spread}
    if guess.twist is not None:
        std = np.sqrt(np.diag(covariance)[n:])
        details["initial_twist"] = {"value": guess.twist.tolist(), "std": std.tolist()}
    return Identification(
        material=Material(
            law,
            {**rollouts.known, **guess.values},
            recording.density,
            tuple(keys),
            covariance[:n, :n] * np.outer(values, values),
        ),
        method="rollout",
        observed="positions",
        condition=float(np.sqrt(eigenvalues[-1] / eigenvalues[0])),
        residual=float(np.sqrt(np.mean(residual**2))),
        residual_unit="m",
        rows=len(residual),
        seconds=time.perf_counter() - begun,
        details=details,
    )


def thinned(recording: Recording, stride: int) -> Recording:
    """Every ``stride``-th frame; full solver states are dropped.

    Raises:
        ValueError: fewer than two frames would be left.
    """
    if stride < 1:
        raise ValueError(f"stride: a whole number from 1 is wanted, got {stride}")
    keep = slice(None, None, stride)
    if len(recording.time[keep]) < 2:
        raise ValueError(f"stride {stride} leaves fewer than two of {recording.frames} frames")
    rows = ("time", "p_WQ", "valid", "visible", "step")
    picked = {k: getattr(recording, k) for k in rows}
    picked = {k: None if v is None else v[keep] for k, v in picked.items()}
    return replace(recording, states=None, p_reference=recording.reference, **picked)
