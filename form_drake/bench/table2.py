"""The paper's Table II on the shared NCLaw data: three observations, four materials, three motions.

Each row's material is identified on the training cube and rolled out on the later motion (``time``),
another initial motion (``velocity``) and another body on a finer grid (``geometry``). Two floors
stand beside them: the true parameters in this solver as the data's reader names it (float32, svd3),
and with the default decomposition without singular values.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import chosen, fingerprint, run_cases
from form_drake.bench.truth import (
    LAW,
    MATERIALS,
    PAPER,
    nclaw_files,
    relative_errors,
    true_values,
)
from form_drake.identify import identify
from form_drake.laws import law_named
from form_drake.material import Material
from form_drake.mpm.prediction import predict
from form_drake.records import read

ROWS = {"Full": "full", "No stress": "no-stress", "Pos. only": "positions"}
FLOORS = {"Floor": "svd3", "Floor, series": "series"}
CONDITIONS = ("time", "velocity", "geometry")
SECONDS = {"time": 4.0, "velocity": 1.0, "geometry": 45.0, "identify": 12.0}
NOTES = (
    "The training cubes have about one particle a cell, no noise, and positions at every step; full"
    " states at 25 step pairs and 41 consecutive frames.",
    "Losses are over the frames that the data hold: time every 20th step, velocity (seed 1 of three)"
    " every 10th, geometry every 200th; the mean is over the three conditions.",
)


def identified(data: Path, material: str, row: str) -> dict[str, Any]:
    """Identify one material on its training motion."""
    recording = read(nclaw_files(data)[f"{material}/train"])
    answer = identify(recording, LAW[material], observe=ROWS[row])
    values = {k: answer.material.values[k] for k in answer.material.law.sought}
    errors = relative_errors(values, true_values(data, material))
    return {
        "values": values,
        "errors": errors,
        "worst_error": max(abs(e) for e in errors.values()),
        "seconds": answer.seconds,
        "compile_seconds": answer.compile_seconds,
        "condition": answer.condition,
    }


def loss(data: Path, material: str, condition: str, values: dict[str, float], svd: str) -> float:
    """Rollout loss [m^2] of parameter values on one motion."""
    recording = read(nclaw_files(data)[f"{material}/{condition}"])
    recording = replace(recording, solver=replace(recording.solver, decomposition=svd))
    return predict(recording, Material(law_named(LAW[material]), values, 1000.0)).loss


def run_table2(
    data: Path, *, store: Path, only: tuple[str, ...] = (), conditions=CONDITIONS
) -> dict[str, Any]:
    """All cells of the table; see the module's text.

    Raises:
        ValueError: ``only`` leaves nothing.
    """
    files = nclaw_files(data)
    mark = fingerprint(*files.values())
    fits: dict[str, Callable] = {
        f"identify/{m}/{row}": partial(identified, data, m, row) for m in MATERIALS for row in ROWS
    }
    rolls = {
        f"rollout/{m}/{row}/{c}": f"identify/{m}/{row}"
        for m in MATERIALS
        for c in conditions
        for row in (*ROWS, *FLOORS)
    }
    names = chosen([*fits, *rolls], only)
    needed = {rolls.get(n, n) for n in names}
    fits = {n: f for n, f in fits.items() if n in needed}
    estimates = {n: SECONDS["identify"] if "Pos" in n else 2.0 for n in fits}
    found = run_cases(fits, store=store, mark=mark, estimates=estimates) if fits else {}
    rollouts: dict[str, Callable] = {}
    for name in (n for n in names if n in rolls):
        _, m, row, c = name.split("/")
        if row in FLOORS:
            rollouts[name] = partial(_floor, data, m, c, FLOORS[row])
        else:
            rollouts[name] = partial(_loss, data, m, c, found[rolls[name]]["values"])
    estimates = {n: SECONDS[n.rsplit("/", 1)[1]] for n in rollouts}
    losses = run_cases(rollouts, store=store, mark=mark, estimates=estimates) if rollouts else {}
    return {"bench": "table2", "notes": list(NOTES), "cells": _cells(found, losses, conditions)}


def _loss(data, material, condition, values) -> dict[str, Any]:
    return {"loss": loss(data, material, condition, values, "svd3")}


def _floor(data, material, condition, svd) -> dict[str, Any]:
    return {"loss": loss(data, material, condition, true_values(data, material), svd)}


def _cells(found, losses, conditions) -> list[dict[str, Any]]:
    cells = []
    for row in (*ROWS, *FLOORS):
        for m in MATERIALS:
            parts = {c: losses.get(f"rollout/{m}/{row}/{c}", {}).get("loss") for c in conditions}
            known = [v for v in parts.values() if v is not None]
            fit = found.get(f"identify/{m}/{row}", {})
            if not known and not fit:
                continue
            paper = PAPER.get(row, {}).get(m, (None, None))
            mean = float(np.mean(known)) if len(known) == len(conditions) else None
            cells.append(
                {
                    "row": row,
                    "material": m,
                    **{f"loss_{c}": v for c, v in parts.items()},
                    "mean_loss": mean,
                    "seconds": fit.get("seconds"),
                    "compile_seconds": fit.get("compile_seconds"),
                    "worst_error": fit.get("worst_error"),
                    "errors": fit.get("errors"),
                    "paper_mean_loss": paper[0],
                    "paper_seconds": paper[1],
                }
            )
    return cells


def table(result: dict[str, Any]) -> str:
    """The cells as a plain table, with the paper's rows."""

    def number(value, form=".1e"):
        return "-" if value is None else format(value, form)

    head = f"{'row':15}{'material':12}{'time':>9}{'velocity':>9}{'geometry':>9}{'mean':>9}"
    lines = [head + f"{'paper':>9}{'error':>9}{'s':>7}{'paper s':>8}"]
    for c in result["cells"]:
        parts = "".join(f"{number(c.get(f'loss_{k}')):>9}" for k in CONDITIONS)
        lines.append(
            f"{c['row']:15}{c['material']:12}{parts}{number(c['mean_loss']):>9}"
            f"{number(c['paper_mean_loss']):>9}{number(c['worst_error']):>9}"
            f"{number(c['seconds'], '.2f'):>7}{number(c['paper_seconds'], '.1f'):>8}"
        )
    for name in ("Diff. Sys-Id", "NCLaw"):
        for m in MATERIALS:
            value, seconds = PAPER[name][m]
            blank = " " * 36
            lines.append(f"{name:15}{m:12}{blank}{value:>9.1e}{'':>16}{seconds:>8.1f}")
    return "\n".join([*lines, *result["notes"]])
