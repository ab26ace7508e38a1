"""Levenberg-Marquardt on rollouts, with derivatives by differences."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from tqdm import tqdm

from form_drake.identify.trials import Rollouts, as_guess, mean_square

STEP = 1e-3
LONGEST_STEP = np.log(2.5)
DAMPING = (1e-8, 1e4)
MOST_ITERATIONS = 40
CHORDS = 3


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
