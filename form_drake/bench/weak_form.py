"""The weak form on motions that no solver of this package made: errors, noise, refusals, time.

The motions come from the scripts in ``tests/oracles``, run as processes of their own. Each writes
plain arrays, what a person would state of the set-up, and the true parameters in a file of their
own, which only this bench opens.
"""

import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.oracles import FINITE, Motions, laboratory_noise, relative_noise
from form_drake.bench.weak_form_tables import ESTIMATORS, GOALS, table
from form_drake.identify import (
    Estimator,
    Identification,
    Unidentifiable,
    WeakOptions,
    estimates,
    identify,
)
from form_drake.records import Recording

__all__ = ["planned", "run_weak_form", "table"]
MODES = ("uniaxial", "biaxial", "shear")
FIXED = ("nu",)  # stated in the recordings of those materials that have it
HOMOGENEOUS = ("mooney-rivlin", "yeoh", "gent")
MOTIONS = {
    "newtonian": ("newtonian",),
    "bingham": ("bingham",),
    "mu-i": ("mu-i-1", "mu-i-2", "mu-i-3"),
    **{law: tuple(f"{law}-{mode}" for mode in MODES) for law in HOMOGENEOUS},
    "neo-hookean": ("neo-hookean",),
    "fixed-corotated": ("fixed-corotated",),
    "von-mises": ("von-mises",),
    "drucker-prager": ("drucker-prager",),
    "weakly-compressible": ("weakly-compressible",),
}
ALONE = {**{law: MOTIONS[law] for law in HOMOGENEOUS}, "mu-i": ("mu-i-1",)}
SECONDS = {
    "newtonian": 2.5,
    "bingham": 3.5,
    "mu-i": 3.5,
    "mooney-rivlin": 4.5,
    "yeoh": 4.5,
    "gent": 6.5,
    "von-mises": 4.5,
    "drucker-prager": 4.5,
}
OTHER_SECONDS = 0.6  # of one identification by both estimators
SOLVING = {"press": 45.0, "bend": 30.0}  # seconds of the finite elements
LEVELS = (0.3, 1.0, 3.0)  # percent of the rms of what is measured
DRAWS = 2  # in the studies of noise
SEEDS = 20
ROWS = 2000  # where time is measured
Z90 = 1.6449
Disturb = Callable[[Recording, np.random.Generator], Recording]


def percent(answer: Identification, true: dict[str, float]) -> dict[str, float]:
    """Error of every identified parameter [percent]."""
    found = answer.material.parameters()
    sought = [k for k in true if k not in FIXED]
    return {k: 100.0 * (found[k].value / true[k] - 1.0) for k in sought}


# --- cases ---------------------------------------------------------------------------------------
def exact(motions: Motions, cases: Sequence[str]) -> dict[str, Any]:
    """Identify one law from its motions as they are."""
    (answer,) = estimates(motions.recordings(cases), ESTIMATORS[:1], WeakOptions()).values()
    return _facts(answer, motions.truth(cases[0]))


def refused(motions: Motions, cases: Sequence[str]) -> dict[str, Any]:
    """Which parameters a refusal names where only the motion inside the body is used."""
    inside = [replace(r, forces={}, contact={}) for r in motions.recordings(cases)]
    try:
        identify(inside, method="weak")
        named: tuple[str, ...] = ()
    except Unidentifiable as refusal:
        named = refusal.keys
    return {"named": sorted(named), "expected": sorted(motions.truth(cases[0]))}


def noisy(
    motions: Motions,
    cases: Sequence[str],
    disturb: Disturb,
    estimators: tuple[Estimator, ...],
    seeds: int,
) -> dict[str, Any]:
    """Identify from disturbed copies of some motions, by seed and estimator."""
    clean, true = motions.recordings(cases), motions.truth(cases[0])
    runs: dict[str, list[dict[str, Any]]] = {e: [] for e in estimators}
    for seed in tqdm(range(seeds), unit="seed", disable=None, leave=False):
        rng = np.random.default_rng(seed)
        made = [disturb(r, rng) for r in clean]
        for estimator, answer in estimates(made, estimators, WeakOptions(draws=DRAWS)).items():
            runs[estimator].append(_facts(answer, true))
    return {"seeds": seeds, **{e: {**_summary(r), "runs": r} for e, r in runs.items()}}


def _facts(answer: Identification | Unidentifiable, true: dict[str, float]) -> dict[str, Any]:
    if isinstance(answer, Unidentifiable):
        return {"refused": list(answer.keys)}
    found, errors = answer.material.parameters(), percent(answer, true)
    std = {k: 100.0 * (found[k].std or 0.0) / abs(true[k]) for k in errors}
    return {
        "errors": errors,
        "std": std,
        "rows": answer.rows,
        "condition": answer.condition,
        "seconds": answer.seconds,
    }


def _summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Median size of the errors [percent] and coverage of the 90 % intervals, by parameter."""
    kept = [r for r in runs if "errors" in r]
    out: dict[str, Any] = {"refused": len(runs) - len(kept), "median": {}, "mean": {}}
    out["coverage_90"] = {}
    for key in kept[0]["errors"] if kept else ():
        e, s = (np.array([r[name][key] for r in kept]) for name in ("errors", "std"))
        out["median"][key] = np.median(np.abs(e))
        out["mean"][key] = np.mean(e)
        out["coverage_90"][key] = np.mean(np.abs(e) <= Z90 * s)
    if kept:
        out["seconds"] = np.median([r["seconds"] for r in kept])
    return out


def timing(motions: Motions, case: str) -> dict[str, Any]:
    """Seconds of the processor, all threads together: one assembly of A and b, and everything.

    Windows as wide as by default, and as many as make about ``ROWS`` rows. Beside it, the most memory
    that an assembly takes, of all frames and of the first half of them.
    """
    made = motions.recording(case)
    answer = identify(made, method="weak")  # compiles kernels, and says how wide windows are
    (probe,) = answer.details["probes"]
    last, width = float(made.time[-1] - made.time[0]), probe["window"]
    begins = np.linspace(0.0, last - width, round(ROWS * probe["windows"] / answer.rows))
    options = WeakOptions(ends=tuple((float(t), float(t) + width) for t in begins))
    begun = time.process_time()
    answer = identify(made, method="weak", weak=options)
    whole = time.process_time() - begun
    begun = time.process_time()
    assembled(answer)
    seconds = time.process_time() - begun
    half = slice(made.frames // 2 + 1)
    first = replace(made, time=made.time[half], p_WQ=made.p_WQ[half])
    ends = tuple(own for own in options.ends if own[1] <= first.time[-1] - first.time[0])
    fewer = identify(first, method="weak", weak=replace(options, ends=ends, draws=0))
    return {
        "rows": answer.rows,
        "points": made.points,
        "frames": made.frames,
        "assembly_seconds": seconds,
        "identification_seconds": whole,
        "assembly_megabytes": [peak(answer), peak(fewer)],
    }


def assembled(answer: Identification) -> None:
    """Assemble A and b of an answer once more, with nothing remembered of the last time."""
    problem = answer.weak.problem
    problem = replace(problem, probes=tuple(replace(p) for p in problem.probes))
    problem.system(np.array([0.5 * np.log(a * z) for a, z in problem.ranges]))


def peak(answer: Identification) -> float:
    """The most memory that an assembly takes beside what was there [MB]."""
    tracemalloc.start()
    try:
        assembled(answer)
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


# --- the bench -----------------------------------------------------------------------------------
def run_weak_form(*, store: Path, only: tuple[str, ...] = (), seeds: int = SEEDS) -> dict[str, Any]:
    """All cases; see the module's text.

    Raises:
        ValueError: the package does not lie in a checkout of the project, or no seed is wanted.
    """
    if seeds < 1:
        raise ValueError(f"--seeds {seeds}: one or more are wanted")
    motions = Motions.within(store)
    cases, estimates = planned(motions, seeds)
    mark = fingerprint()
    found = run_cases(cases, store=store, mark=mark, estimates=estimates, only=only)
    return {"bench": "weak-form", "cases": found, "goals": GOALS}


def planned(
    motions: Motions, seeds: int
) -> tuple[dict[str, Callable[[], dict[str, Any]]], dict[str, float]]:
    """Cases by name, and how many seconds each is expected to take."""
    cases: dict[str, Callable[[], dict[str, Any]]] = {}
    expected: dict[str, float] = {}

    def add(name: str, seconds: float, run: Callable[[], dict[str, Any]]) -> None:
        cases[name], expected[name] = run, seconds

    one = {law: SECONDS.get(law, OTHER_SECONDS) for law in MOTIONS}
    for law, made in MOTIONS.items():
        add(f"exact/{law}", 2.0 * one[law], partial(exact, motions, made))
    for law, made in ALONE.items():
        add(f"refused/{law}", one[law], partial(refused, motions, made))
    for case in FINITE:
        solving = SOLVING[case.split("-")[0]]
        add(f"fe/{case}", solving + 10.0, partial(exact, motions, [case]))
    add("time/press-b", 25.0, partial(timing, motions, "press-b"))
    for case in FINITE:
        run = partial(noisy, motions, [case], laboratory_noise, ("gls",), seeds)
        add(f"fe-noise/{case}/seeds{seeds}", 5.5 * seeds, run)
    for law, made in MOTIONS.items():
        for level in LEVELS:
            disturb = partial(relative_noise, level=level)
            run = partial(noisy, motions, made, disturb, ESTIMATORS, seeds)
            add(f"noise/{law}/{level:g}/seeds{seeds}", one[law] * seeds, run)
    return cases, expected
