"""What a diagnosis leaves in a folder: answer, material, page, a page that plays, what to record next."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.diagnose import Diagnosis, Nulls
from form_drake.diagnose.page import diagnosis_page
from form_drake.files import write_json, write_text
from form_drake.motion import body
from form_drake.report import Report

PLAYED = "before_after.html"
NEXT = "next.yaml"
UPRIGHT = 0.999  # of gravity, that pulls down, where a station does what was recorded elsewhere


def write_diagnosis(
    found: Diagnosis,
    nulls: Nulls,
    folder: Path,
    *,
    command: str = "",
    finish: Callable[[Report], None] = lambda page: None,
) -> dict[str, Any]:
    """Write ``discrepancy.json``, ``material.yaml``, ``report.html``, what plays held-out motion, and ``next.yaml``.

    Args:
        found: of a diagnosis.
        nulls: that its thresholds come from.
        folder: to write into.
        command: that diagnoses again with a further recording.
        finish: adds to the page, once the answer is on disk.

    Returns:
        What ``discrepancy.json`` holds.
    """
    told = found.to_json()
    told["advice"] |= {"command": command, "scenario": _advise(found, folder) or None}
    write_json(folder / "discrepancy.json", told)
    found.material.write(folder / "material.yaml")
    played = _play(found, folder)
    scenario = told["advice"]["scenario"] or ""
    page = diagnosis_page(found, nulls, command=command, scenario=scenario, played=played)
    finish(page)
    page.write(folder / "report.html")
    return told


def _play(found: Diagnosis, folder: Path) -> str:
    """Name of a page that plays the first held-out motion; "": none was predicted."""
    if found.check is None or found.after is None:
        return ""
    from form_drake.systems.before_after import write_before_after

    write_before_after(
        found.check.measured[0],
        found.check.before.recordings[0],
        found.after.recordings[0],
        folder / PLAYED,
        "held-out motion, measured and predicted",
    )
    return PLAYED


def _advise(found: Diagnosis, folder: Path) -> str:
    """Name of a scenario in which the station does what should be recorded next; "": it cannot."""
    from form_drake.systems.advised import advised
    from form_drake.systems.probe import planned
    from form_drake.systems.scenario import load_scenario

    seen = found.naming.passes[0].match.scenes.recordings[0]
    gravity, shape = np.asarray(seen.gravity), body(seen)
    if seen.gravity is None or not -gravity[2] > UPRIGHT * np.linalg.norm(gravity):
        return ""
    foot = next(f.condition for f in shape.faces if f.axis == 2 and not f.side)
    text = advised(found.advice.motions, shape.low, shape.high, foot, found.material)
    if not text:
        return ""
    write_text(folder / NEXT, text)
    try:
        planned(load_scenario(folder / NEXT))
    except ValueError:  # the arm cannot do it
        (folder / NEXT).unlink()
        return ""
    return NEXT
