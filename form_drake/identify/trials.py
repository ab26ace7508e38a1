"""Trial rollouts: a recording's positions predicted for guessed parameters, several at a time."""

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from queue import SimpleQueue

import numpy as np

from form_drake.identify.solve import require_given
from form_drake.laws import Law
from form_drake.mpm.simulation import BlowUp, Body, Simulation
from form_drake.records import Recording, rest_shape, stepped

MOST_FRAMES = 101


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
        require_given(law.name, [k for k in law.given if k not in known])
        self.sought = [k for k in law.keys if k not in known]
        self.steps = recording.step - recording.step[0]
        short = self.frames(0.0)
        if recording.valid is not None and not recording.valid[short[1:]].any():
            raise ValueError("no point is valid in the first frames, so no rollout can be compared")
        self.count = 0
        self.decomposition = solver.decomposition
        self.dtype = np.float32 if solver.precision == "float32" else np.float64
        self.rest = rest_shape(recording)
        body = Body(self.rest, stated.volume, stated.density)
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
        arm = self.rest - self.rest.mean(axis=0)
        return twist[:3] + np.cross(twist[3:], arm)

    def _one(self, guess: Guess, frames: np.ndarray, rough: bool) -> np.ndarray | None:
        simulation = self._simulations[rough].get()
        try:
            simulation.set_material({**self.known, **guess.values})
            simulation.reset(self.rest, self.velocities(guess.twist))
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
    solver = stepped(recording).solver
    seen = np.isfinite(recording.p_WQ[frame]).all(axis=1)
    if recording.valid is not None:
        seen &= recording.valid[frame]
    x, now = recording.reference[seen], recording.p_WQ[frame][seen]
    arm = x - x.mean(axis=0)
    if len(x) < 3 or np.linalg.matrix_rank(arm, tol=1e-6 * np.ptp(recording.reference)) < 2:
        raise ValueError("an unknown initial velocity needs three points that are not on a line")
    v = (now - x) / duration - 0.5 * duration * np.asarray(solver.gravity)
    inertia = np.einsum("pi,pi,jk->jk", arm, arm, np.eye(3)) - arm.T @ arm
    omega = np.linalg.solve(inertia, np.cross(arm, v - v.mean(axis=0)).sum(axis=0))
    return np.concatenate([v.mean(axis=0), omega])
