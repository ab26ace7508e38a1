"""Identification from positions alone: Levenberg-Marquardt on rollouts of the solver.

Unknown are the logarithms of all parameters and, where asked for, the rigid initial motion; the
residual is predicted minus observed position, so the answer is the maximum of the likelihood for
independent noise of equal variance. The horizon grows: short ones are cheap and have few local
minima. Only the last steps need the rounding of the recording's own solver.
"""

import time
from typing import Any

import numpy as np
from tqdm import tqdm

from form_drake.identify.marquardt import STEP, LevenbergMarquardt
from form_drake.identify.solve import (
    LARGEST_CONDITION,
    Identification,
    Unidentifiable,
    with_rounding,
)
from form_drake.identify.trials import Guess, Rollouts, as_guess, as_vector
from form_drake.material import Material

HORIZONS = {0.2: 2e-2, 0.4: 3e-3, 1.0: 3e-4}
TWIST = ("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z")
LEAST_SIGNAL = 4.0


def identify_rollout(rollouts: Rollouts, start: Guess) -> Identification:
    """Identify every parameter jointly from positions.

    Args:
        rollouts: of the recording, with the law and the values that are given.
        start: where the iteration starts; its twist asks for the rigid initial motion too.

    Raises:
        ValueError: no simulation near the start is stable, or the search does not converge.
        Unidentifiable: the motion does not determine the parameters.
    """
    begun = time.perf_counter()
    vector = as_vector(start, rollouts.sought)
    with tqdm(desc="rollouts", unit="", disable=None, delay=2, leave=False) as bar:
        rough = LevenbergMarquardt(rollouts, rollouts.frames(min(HORIZONS)), bar, rough=True)
        vector = rough.nearby(vector)
        for horizon, tolerance in HORIZONS.items():
            rough.frames = rollouts.frames(horizon)
            vector = rough.fit(vector, tolerance)
        every = np.arange(rollouts.recording.frames)
        exact = LevenbergMarquardt(rollouts, every, bar, rough=False)
        vector, residual, J = exact.polish(vector)
    return _answer(rollouts, vector, residual, J, begun)


def require_minimum(J: np.ndarray, residual: np.ndarray, inverse: np.ndarray) -> None:
    """Refuse an answer from which the linearised residual could still fall.

    Raises:
        ValueError: the next Gauss-Newton step promises to lower the cost by more than a tenth.
    """
    slope = J.T @ residual
    promised = float(slope @ inverse @ slope) / float(residual @ residual)
    if promised > 0.1:
        raise ValueError(
            f"the search stopped {100 * promised:.0f} % above what its slope promises: it did not"
            " converge; leave out --start, or give one nearer to the material"
        )


def _answer(
    rollouts: Rollouts,
    vector: np.ndarray,
    residual: np.ndarray,
    J: np.ndarray,
    begun: float,
) -> Identification:
    recording, law, keys = rollouts.recording, rollouts.law, rollouts.sought
    scale = np.linalg.norm(J, axis=0)
    names = [*keys, *(TWIST if len(vector) > len(keys) else ())]
    rounding = np.finfo(rollouts.dtype).eps * float(np.max(np.abs(recording.reference)))
    unseen = scale * STEP < LEAST_SIGNAL * rounding * np.sqrt(len(residual))
    dead = [n for n, u in zip(names, unseen, strict=True) if u]
    if dead:
        raise Unidentifiable(dead, "no position depends on it; record a motion that loads the body")
    correlation = (J / scale).T @ (J / scale)
    eigenvalues, vectors = np.linalg.eigh(correlation)
    if eigenvalues[0] * LARGEST_CONDITION < eigenvalues[-1]:
        weak = [n for n, c in zip(names, vectors[:, 0], strict=True) if abs(c) > 0.1]
        raise Unidentifiable(weak, "record a longer or livelier motion")
    inverse = (vectors / eigenvalues) @ vectors.T / np.outer(scale, scale)
    dof = max(len(residual) - len(vector), 1)
    spread = float(np.sqrt(residual @ residual / dof))
    noise = recording.noise or spread
    require_minimum(J, residual, inverse)
    covariance = noise**2 * inverse
    condition = float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))
    vague = [k for k, c in zip(keys, np.diag(covariance), strict=False) if c > 1.0]
    if vague:
        raise Unidentifiable(vague, "the noise hides it; record a livelier motion or more frames")
    guess = as_guess(vector, keys)
    values = np.array([guess.values[k] for k in keys])
    n = len(keys)
    details: dict[str, Any] = {"rollouts": rollouts.count, "position_noise": spread}
    if guess.twist is not None:
        std = np.sqrt(np.diag(covariance)[n:])
        details["initial_twist"] = {"value": guess.twist.tolist(), "std": std.tolist()}
    return Identification(
        material=Material(
            law,
            {**rollouts.known, **guess.values},
            recording.density,
            tuple(keys),
            with_rounding(
                covariance[:n, :n] * np.outer(values, values),
                values,
                condition,
                np.dtype(rollouts.dtype).name,
                rollouts.decomposition,
            ),
        ),
        method="rollout",
        observed="positions",
        condition=condition,
        residual=float(np.sqrt(np.mean(residual**2))),
        residual_unit="m",
        rows=len(residual),
        seconds=time.perf_counter() - begun,
        misfit=spread / recording.noise if recording.noise else None,
        details=details,
    )
