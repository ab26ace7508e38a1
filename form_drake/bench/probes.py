"""Probes in the station: what they identify, against what was simulated.

Four named scenarios and ten specimens drawn by seeds 0 to 9, none left out. Each motion is simulated
once by the arm in its station and kept; noise is added to it afterwards. Beside the answer stand the
one with the twin (the same probe simulated again at the identified values and read the same way), what
the solver's own stress leaves of the balance, which no reading can be blamed for, the answers from
finer grids, and those to motions that finite elements have made.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench import oracles, weak_form
from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.oracles import ORACLES, laboratory_noise
from form_drake.bench.probes_grid import SPACINGS, on_grid
from form_drake.bench.probes_motions import Motions, code, errors
from form_drake.bench.probes_tables import FINITE_KINDS, GOALS, table
from form_drake.identify import Unidentifiable, identify

NAMED = ("press_a", "press_b", "bend_a", "bend_b")
SPECIMENS = 10
SEEDS = 20
STIFFNESS, STRENGTH, POISSON = (20e3, 300e3), (0.01, 0.15), (0.30, 0.45)
OWN_WEIGHT = 3.0  # least uniaxial yield stress over rho g H
NORMAL_90 = 1.645
SECONDS = {"press": 60.0, "bend": 150.0}  # of one simulation
READING = {"press": 8.0, "bend": 4.0}  # of one identification
FINER = 3.5  # power of the fineness of a grid by which a simulation takes longer

__all__ = ["planned_cases", "run_probes", "table"]


def specimen(seed: int) -> dict[str, float]:
    """E, nu and tau_y of a specimen that bears its own weight.

    E is log-uniform from 20 to 300 kPa, tau_y / E log-uniform from 0.01 to 0.15, nu uniform from
    0.30 to 0.45, drawn again until sqrt(3/2) tau_y is at least 3 rho g H of the pressed block.
    """
    rng = np.random.default_rng(seed)
    weight = 1000.0 * 9.81 * 0.025
    while True:
        E, share = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (STIFFNESS, STRENGTH))
        nu = float(rng.uniform(*POISSON))
        if np.sqrt(1.5) * share * E >= OWN_WEIGHT * weight:
            return {"E": E, "nu": nu, "tau_y": share * E}


def changes(probe: str, seed: int) -> tuple[str, ...]:
    """Changes of ``press_b`` or ``bend_a`` that put a specimen in."""
    values = specimen(seed)
    keys = ("E", "nu", "tau_y") if probe == "press" else ("E", "nu")
    return tuple(f"specimen.material.{k}={values[k]}" for k in keys)


def planned_cases(specimens: int) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Scenario and changes by name of the case."""
    cases: dict[str, tuple[str, tuple[str, ...]]] = {name: (name, ()) for name in NAMED}
    for seed in range(specimens):
        cases[f"press-{seed}"] = ("press_b", changes("press", seed))
    for seed in range(specimens):
        cases[f"bend-{seed}"] = ("bend_a", changes("bend", seed))
    return cases


def without_noise(
    motions: Motions, name: str, made: tuple[str, ...], with_twin: bool
) -> dict[str, Any]:
    """The answer to exact tracks, with or without the twin."""
    from form_drake.systems.replay import twin
    from form_drake.systems.scenario import load_scenario

    recording, scenario = motions.recording(name, made), load_scenario(name, made)
    true = scenario.specimen.made()

    again = twin(scenario, recording) if with_twin else None
    answer = identify(recording, method="weak", twin=again)
    return {
        "errors": errors(answer, true),
        "rows": answer.rows,
        "condition": answer.condition,
        "seconds": answer.seconds,
    }


def with_noise(motions: Motions, name: str, made: tuple[str, ...], seeds: int) -> dict[str, Any]:
    """Median size of the error and coverage of the 90 % intervals over noise seeds."""
    from form_drake.systems.scenario import load_scenario

    recording, true = motions.recording(name, made), load_scenario(name, made).specimen.made()
    found: list[dict[str, dict[str, float]]] = []
    refused = 0
    for seed in range(seeds):
        try:
            noisy = laboratory_noise(recording, np.random.default_rng(seed))
            found.append(errors(identify(noisy, method="weak"), true))
        except Unidentifiable:
            refused += 1
    sizes = {k: np.abs([f[k]["error"] for f in found]) for k in (found[0] if found else ())}
    return {
        "median": {k: float(np.median(e)) for k, e in sizes.items()},
        "p90": {k: float(np.quantile(e, 0.9)) for k, e in sizes.items()},
        "worst": {k: float(e.max()) for k, e in sizes.items()},
        "coverage_90": {
            k: float(np.mean([abs(f[k]["error"]) <= NORMAL_90 * f[k]["std"] for f in found]))
            for k in sizes
        },
        "errors": {k: [f[k]["error"] for f in found] for k in sizes},
        "refused": refused,
        "seeds": seeds,
    }


def unseen(motions: Motions, name: str, made: tuple[str, ...]) -> dict[str, Any]:
    """Errors of a motion that was not used, predicted with the answer to exact tracks."""
    from form_drake.systems.replay import replay
    from form_drake.systems.scenario import load_scenario

    material = identify(motions.recording(name, made), method="weak").material
    measured = motions.recording(name, made, unseen=True)
    found = replay(load_scenario(name, made), material, measured)
    return {
        "shape_rms_mm": 1e3 * found.shape_rms,
        "force_rms": 100.0 * found.force_rms,
        "peak_error": 100.0 * found.peak_error,
    }


Cases = dict[str, Callable[[], dict[str, Any]]]


def planned(
    motions: Motions, seeds: int, specimens: int, only: tuple[str, ...] = ()
) -> tuple[Cases, dict[str, float]]:
    """Cases by name, and how many seconds each is expected to take.

    The solver's own stress of a drawn specimen is looked at, at every step or in fewer frames, where
    ``only`` names the specimen.
    """
    from form_drake.bench.probes_stress import by_rate, own_stress

    cases: Cases = {}
    expected: dict[str, float] = {}

    def add(name: str, seconds: float, run: Callable[..., dict[str, Any]], *given: Any) -> None:
        cases[name], expected[name] = partial(run, motions, *given), seconds

    for name, (scenario, made) in planned_cases(specimens).items():
        probe = scenario.split("_")[0]
        once, reading = SECONDS[probe], READING[probe]
        add(f"exact/{name}", once + reading, without_noise, scenario, made, False)
        add(f"twin/{name}", 3.0 * (once + reading), without_noise, scenario, made, True)
        add(f"noise/{name}/seeds{seeds}", reading * seeds, with_noise, scenario, made, seeds)
        if name in NAMED or any(name in part for part in only):
            add(f"own-stress/{name}", 2.0 * once, own_stress, scenario, made)
            add(f"rate/{name}", 4.0 * once, by_rate, scenario, made)
    for name in NAMED:
        probe = name.split("_")[0]
        add(f"unseen/{name}", 2.0 * SECONDS[probe], unseen, name, ())
        for dx in SPACINGS[probe]:
            finer = SPACINGS[probe][0] / dx
            seconds = SECONDS[probe] * finer**FINER + READING[probe]
            add(f"dx/{name}/{1e3 * dx:.4g}", seconds, on_grid, name, dx)
    return cases, expected


def finite_elements(folder: Path, seeds: int) -> tuple[Cases, dict[str, float]]:
    """Probes that finite elements have made, exact and noisy, as ``bench weak-form`` has them.

    None where the package does not lie in a checkout of the project.
    """
    if not (ORACLES / "finite_elements.py").is_file():
        return {}, {}
    cases, expected = weak_form.planned(oracles.Motions.within(folder), seeds)
    chosen = {n: run for n, run in cases.items() if n.split("/")[0] in FINITE_KINDS}
    return chosen, expected


def run_probes(
    *, store: Path, only: tuple[str, ...] = (), seeds: int = SEEDS, specimens: int = SPECIMENS
) -> dict[str, Any]:
    """All cases; see the module's text.

    Raises:
        ValueError: no seed is wanted, or ``only`` leaves nothing.
    """
    if seeds < 1:
        raise ValueError(f"--seeds {seeds}: one or more are wanted")
    cases, expected = planned(Motions(store.parent / "motions"), seeds, specimens, only)
    more, later = finite_elements(store.parent, seeds)
    mark = fingerprint() + code()[:8]
    found = run_cases(cases | more, store=store, mark=mark, estimates=later | expected, only=only)
    return {"bench": "probes", "cases": found, "goals": GOALS}
