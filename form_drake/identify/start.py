"""Where the rollouts start: a coarse scan that uses no truth, then the carried one-step solve."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from form_drake.identify.columns import Columns
from form_drake.identify.solve import Identification
from form_drake.identify.trials import Guess, Rollouts, mean_square
from form_drake.laws import Law
from form_drake.mpm.simulation import BlowUp, Body, Simulation, State
from form_drake.records import Recording, stepped

SCANNED_E = tuple(10.0**n for n in range(3, 8))
HORIZON = 0.2
PASSES = 2
MOST_STEPS = 200
FINEST_NOISE = 1e-6


def guesses(
    law: Law, known: Mapping[str, float], moduli: Sequence[float] = SCANNED_E
) -> list[dict[str, float]]:
    """The scanned values: Young's moduli [Pa] times each parameter's guesses."""
    sought = [law.parameter(k) for k in law.keys if k not in known]
    scaled = [p.unit in ("Pa", "Pa s") for p in sought]
    found = []
    for E, choice in product(
        moduli if any(scaled) else (1.0,), product(*(p.guess for p in sought))
    ):
        pairs = zip(sought, scaled, choice, strict=True)
        found.append({p.key: g * E if s else g for p, s, g in pairs})
    return found


def scanned(rollouts: Rollouts, twist: np.ndarray | None) -> Guess:
    """The scanned guess whose rollout over a short horizon fits best.

    Raises:
        ValueError: none of them is stable with the recording's time step.
    """
    trials = [Guess(v, twist) for v in guesses(rollouts.law, rollouts.known)]
    frames = rollouts.frames(HORIZON)
    costs = [mean_square(r) for r in rollouts.residuals(trials, frames, rough=True)]
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise ValueError("no scanned modulus gives a stable simulation: give a start with --start")
    return trials[best]


def refuse_local_minimum(
    rollouts: Rollouts, answer: Identification, twist: np.ndarray | None
) -> None:
    """Refuse an answer that fits worse than a scanned guess.

    Raises:
        ValueError: some scanned guess fits the first frames better.
    """
    if twist is not None:
        twist = np.array(answer.details["initial_twist"]["value"])
    values = {k: answer.material.values[k] for k in rollouts.sought}
    pair = [Guess(values, twist), scanned(rollouts, twist)]
    residuals = rollouts.residuals(pair, rollouts.frames(HORIZON), rough=True)
    found, guessed = (mean_square(r) for r in residuals)
    if guessed < found:
        raise ValueError(
            f"the search from --start ended {np.sqrt(found):.3g} m away, where a scanned guess is"
            f" {np.sqrt(guessed):.3g} m away: leave out --start, or give one nearer to the material"
        )


def leader(recording: Recording, law: Law) -> tuple[Simulation, Columns]:
    """A simulation to be led along a recording, and the columns of its balance."""
    stated = stepped(recording)
    solver = replace(stated.solver, decomposition="series")
    body = Body(recording.reference, stated.volume, stated.density)
    columns = Columns(solver, law, stated.mass, stated.volume, precision=solver.precision)
    return Simulation(solver, law, body), columns


def noise_level(p_WQ: np.ndarray) -> float:
    """Noise of frequent positions [m], from the median size of their fourth differences."""
    fourth = np.diff(p_WQ[: MOST_STEPS + 5].astype(float), n=4, axis=0)
    return float(np.median(np.abs(fourth)) / 0.6745 / np.sqrt(70.0)) if fourth.size else np.inf


def is_led(recording: Recording) -> bool:
    """Whether every step is recorded, quietly enough for velocities by differences."""
    if recording.step is None or recording.v_0 is None or recording.valid is not None:
        return False
    every = np.all(np.diff(recording.step[: MOST_STEPS + 1]) == 1)
    return bool(every) and noise_level(recording.p_WQ) <= FINEST_NOISE


def carried(recording: Recording, law: Law, guess: Guess, known: Mapping[str, float]) -> Guess:
    """One-step solve with C and F carried along the observed positions.

    The solver is led by x_n and v_n = (x_n - x_{n-1}) / dt at every step, so that C and F follow
    from the data and the guess; the velocities of the next step then give the terms linearly.
    """
    simulation, columns = leader(recording, law)
    values = {**known, **guess.values}
    free = [k for k, t in enumerate(law.terms) if t.key not in known]
    for _ in range(PASSES):
        simulation.set_material(values)
        theta = _led(recording, simulation, columns, values, free)
        if theta is None or np.any(theta <= 0):
            break
        values |= {law.terms[k].key: float(c) for k, c in zip(free, theta, strict=True)}
    return Guess({k: values[k] for k in guess.values}, guess.twist)


def _led(
    recording: Recording,
    simulation: Simulation,
    columns: Columns,
    values: dict[str, float],
    free: list[int],
) -> np.ndarray | None:
    assert recording.v_0 is not None
    terms, x, v_0 = len(columns.law.terms), recording.p_WQ, recording.v_0
    velocity = np.diff(x.astype(float), axis=0) / simulation.dt
    simulation.reset(recording.reference, v_0)
    normal, right = np.zeros((terms, terms)), np.zeros(terms)
    try:
        for n in range(min(MOST_STEPS, len(velocity))):
            state: State = simulation.state()
            v = v_0 if n == 0 else velocity[n - 1]
            here = (x[n], v, state.C, state.L, state.F)
            A, b, keep = columns.rows(*here, velocity[n], values)
            A, b = A[keep], b[keep]
            normal += A.T @ A
            right += A.T @ b
            simulation.restore(replace(state, x=x[n], v=v))
            simulation.step()
    except BlowUp:
        return None
    fixed = [k for k in range(terms) if k not in free]
    right = right - normal[:, fixed] @ [values[columns.law.terms[k].key] for k in fixed]
    try:
        return np.linalg.solve(normal[np.ix_(free, free)], right[free])
    except np.linalg.LinAlgError:
        return None


def default_start(rollouts: Rollouts, twist: np.ndarray | None) -> Guess:
    """The scan, improved by the carried solve where every step was recorded without noise."""
    recording = rollouts.recording
    start = scanned(rollouts, twist)
    if twist is not None or not is_led(recording):
        return start
    better = carried(recording, rollouts.law, start, rollouts.known)
    frames = rollouts.frames(HORIZON)
    costs = [mean_square(r) for r in rollouts.residuals([start, better], frames, rough=True)]
    return (start, better)[int(np.argmin(costs))]
