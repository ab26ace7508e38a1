"""What a diagnosis leaves in a folder: answer, material, page, and a page that plays."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from form_drake.diagnose import Diagnosis
from form_drake.diagnose.page import diagnosis_page
from form_drake.files import write_json
from form_drake.report import Report

PLAYED = "before_after.html"


def write_diagnosis(
    found: Diagnosis,
    thresholds: Mapping[str, float],
    folder: Path,
    *,
    command: str = "",
    finish: Callable[[Report], None] = lambda page: None,
) -> dict[str, Any]:
    """Write ``discrepancy.json``, ``material.yaml``, ``report.html``, and what plays held-out motion.

    Args:
        found: of a diagnosis.
        thresholds: score by effect's id that nothing missing may reach.
        folder: to write into.
        command: that diagnoses again with a further recording.
        finish: adds to the page, once the answer is on disk.

    Returns:
        What ``discrepancy.json`` holds.
    """
    told = found.to_json()
    told["advice"]["command"] = command
    write_json(folder / "discrepancy.json", told)
    found.material.write(folder / "material.yaml")
    played = _play(found, folder)
    page = diagnosis_page(found, thresholds, command=command, played=played)
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
