"""Positions only: from wrong starts without noise, and sparse, noisy, with unknown initial motion."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.truth import LAW, MATERIALS, nclaw_files, relative_errors, true_values
from form_drake.identify import identify
from form_drake.records import read

THIRD = 1.0 / 3.0
STARTS = {
    "3,3,3": (3.0, 3.0, 3.0),
    "1/3,1/3,1/3": (THIRD, THIRD, THIRD),
    "3,1/3,3": (3.0, THIRD, 3.0),
    "1/3,3,1/3": (THIRD, 3.0, THIRD),
    "3,3,1/3": (3.0, 3.0, THIRD),
    "1/3,1/3,3": (THIRD, THIRD, 3.0),
}
SEEDS = 20
STRIDE = 20
NOISE = 1e-3
Z90 = 1.6449
SECONDS = {"jelly": 8.0, "sand": 20.0, "plasticine": 15.0, "water": 4.0}


def from_start(data: Path, material: str, start: str) -> dict[str, Any]:
    """All steps, no noise, known initial velocities, from a start wrong by given factors."""
    true = true_values(data, material)
    wrong = dict(zip(true, STARTS[start], strict=False))
    answer = identify(
        read(nclaw_files(data)[f"{material}/train"]),
        LAW[material],
        observe="positions",
        start={k: t * wrong[k] for k, t in true.items()},
    )
    return _result(answer, true)


def sparse(data: Path, material: str, seed: int) -> dict[str, Any]:
    """Every 20th frame, 1 mm noise, unknown rigid initial motion, default start."""
    answer = identify(
        read(nclaw_files(data)[f"{material}/train"]),
        LAW[material],
        observe="positions",
        stride=STRIDE,
        add_noise=NOISE,
        initial_velocity="rigid",
        seed=seed,
    )
    result = _result(answer, true_values(data, material))
    parameters = answer.material.parameters()
    result["covered"] = {
        k: bool(abs(e) <= Z90 * parameters[k].std / parameters[k].value)
        for k, e in result["errors"].items()
    }
    return result


def _result(answer, true: dict[str, float]) -> dict[str, Any]:
    errors = relative_errors(answer.material.values, true)
    return {
        "errors": errors,
        "worst_error": max(abs(e) for e in errors.values()),
        "seconds": answer.seconds,
        "rollouts": answer.details["rollouts"],
    }


def run_positions(
    data: Path, *, store: Path, only: tuple[str, ...] = (), seeds: int = SEEDS
) -> dict[str, Any]:
    """Rows 2-4 of the table of numbers: starts, sparse and noisy, coverage."""
    files = nclaw_files(data)
    cases = {f"start/{m}/{s}": partial(from_start, data, m, s) for m in MATERIALS for s in STARTS}
    for seed in range(seeds):
        cases |= {f"sparse/{m}/seed{seed}": partial(sparse, data, m, seed) for m in MATERIALS}
    estimates = {n: SECONDS[n.split("/")[1]] for n in cases}
    mark = fingerprint(*files.values())
    found = run_cases(cases, store=store, mark=mark, estimates=estimates, only=only)
    summary = {m: _summary(m, found) for m in MATERIALS}
    return {"bench": "positions", "materials": summary, "cases": found}


def _summary(material: str, found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    starts = [r for n, r in found.items() if n.startswith(f"start/{material}/")]
    noisy = [r for n, r in found.items() if n.startswith(f"sparse/{material}/")]
    out: dict[str, Any] = {"starts": len(starts), "seeds": len(noisy)}
    if starts:
        out["start_worst_error"] = max(r["worst_error"] for r in starts)
        out["start_most_seconds"] = max(r["seconds"] for r in starts)
        out["start_median_seconds"] = float(np.median([r["seconds"] for r in starts]))
    if noisy:
        out["sparse_median_error"] = float(np.median([r["worst_error"] for r in noisy]))
        out["sparse_median_seconds"] = float(np.median([r["seconds"] for r in noisy]))
        out["coverage_90"] = float(np.mean([c for r in noisy for c in r["covered"].values()]))
    return out


def table(result: dict[str, Any]) -> str:
    """The summary as a plain table."""
    lines = [f"{'':44}" + "".join(f"{m:>12}" for m in MATERIALS)]
    rows = {
        "worst error of the starts (3x, 1/3x, mixed)": ("start_worst_error", ".1e"),
        "longest solve from a start [s]": ("start_most_seconds", ".1f"),
        "every 20th frame, 1 mm: median error": ("sparse_median_error", ".1e"),
        "its 90 % intervals cover": ("coverage_90", ".0%"),
        "its median solve [s]": ("sparse_median_seconds", ".1f"),
        "seeds": ("seeds", "d"),
    }
    for text, (key, form) in rows.items():
        cells = [result["materials"][m].get(key) for m in MATERIALS]
        shown = ["-" if c is None else format(c, form) for c in cells]
        lines.append(f"{text:44}" + "".join(f"{s:>12}" for s in shown))
    return "\n".join(lines)
