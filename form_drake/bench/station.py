"""Effects hidden in the station, sought in probes that went through arm, tool and sensors of its diagram.

The station simulates them with tools that touch; a diagnosis reads what its recorder tells, and nothing
of the truth. Motions that nothing else reads verify what it names.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.diagnose import diagnosed, thresholds
from form_drake.effects import CATALOGUE
from form_drake.laws import law_named
from form_drake.records import Recording

HIDDEN = {  # size of the coefficient
    "nothing": 0.0,
    "damping": 5.0,  # more makes steps on so fine a grid short
    "drag": 12.0,
    "force-delay": 2e-3,
    "tool-friction": 0.03,
}
FINER = 1.6  # than a scenario's, the grid of the station: else what it has wrong would be found too
PROBES = {"press_elastic": HIDDEN.keys(), "shake_elastic": HIDDEN.keys() - {"tool-friction"}}
SECONDS = 900.0  # for a case


def _recorded(name: str, acting: str, seed: int, *, unseen: bool) -> Recording:
    """A probe of the station in which an effect acts, if it can: a plate that is glued on rubs nowhere."""
    from form_drake.systems.probe import prepare, record
    from form_drake.systems.scenario import held_out, load_scenario

    acts = acting in CATALOGUE and acting in PROBES[name]
    effects = f"{{id: {acting}, coefficient: {HIDDEN[acting]}}}" if acts else ""
    dx = load_scenario(name).solver.dx / FINER
    seeds = (f"measure.{of}seed={seed}" for of in ("", "sensor.", "torque."))
    changes = (f"solver.dx={dx:g}", *seeds)
    scenario = load_scenario(name, (f"specimen.effects=[{effects}]", *changes))
    made = record(prepare(held_out(scenario) if unseen else scenario))
    return made.measured_by("sensor")


def _found(read: Sequence[Recording], holdout: Sequence[Recording]) -> dict[str, Any]:
    """What a diagnosis tells of them."""
    law = read[0].law
    assert law is not None  # scenarios declare it
    every = list(CATALOGUE.values())
    told = diagnosed(
        read, law_named(law), effects=every, thresholds=thresholds(), holdout=holdout
    ).to_json()
    return {k: told[k] for k in ("verdict", "sentence", "effects", "gap", "doubts", "unverified")}


def _case(acting: str) -> dict[str, Any]:
    draws = iter(np.random.SeedSequence(list(HIDDEN).index(acting)).generate_state(4))
    read, holdout = (
        [_recorded(name, acting, int(next(draws)), unseen=unseen) for name in PROBES]
        for unseen in (False, True)
    )
    return {"true": HIDDEN[acting], **_found(read, holdout)}


def run_station(*, store: Path, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """The bench."""
    cases = {acting: lambda acting=acting: _case(acting) for acting in HIDDEN}
    estimates = dict.fromkeys(cases, SECONDS)
    results = run_cases(cases, store=store, mark=fingerprint(), estimates=estimates, only=only)
    return {"bench": "station", "cases": results}


def table(result: Mapping[str, Any]) -> str:
    """As printed."""
    lines = [f"{'hidden':13} {'size':>8}  {'verdict':10} {'closed':>6}  found"]
    for name, case in result["cases"].items():
        closed = [c["closure"] for c in case["gap"] if c["closure"] is not None]
        gap = f"{100.0 * float(np.median(closed)):.0f} %" if closed else "-"
        found = ", ".join(map(_size, case["effects"])) or "nothing"
        lines.append(f"{name:13} {case['true'] or '-':>8}  {case['verdict']:10} {gap:>6}  {found}")
    return "\n".join(lines)


def _size(effect: Mapping[str, Any]) -> str:
    about = "" if effect["std"] is None else f" ± {effect['std']:.1g}"
    return f"{effect['name']} {effect['coefficient']:.3g}{about} {effect['unit']}"
