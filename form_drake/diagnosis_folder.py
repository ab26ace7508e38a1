"""What a diagnosis leaves in a folder: answer, material, page, a page that plays, what to record next."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from form_drake.diagnose import Diagnosis, Nulls
from form_drake.diagnose.page import diagnosis_page
from form_drake.diagnose.verdict import LEAST
from form_drake.files import write_json, write_text
from form_drake.motion import body
from form_drake.records import Recording, read, write_recording
from form_drake.report import Report

PLAYED = "before_after.html"
UPRIGHT = 0.999  # of gravity, that pulls down, where a station does what was recorded elsewhere


def write_diagnosis(
    found: Diagnosis,
    nulls: Nulls,
    folder: Path,
    *,
    command: str = "",
    effects: Path | None = None,
    finish: Callable[[Report], None] = lambda page: None,
) -> dict[str, Any]:
    """Write ``discrepancy.json``, ``material.yaml``, ``report.html``, what plays held-out motion, and ``next*.yaml``.

    Args:
        found: of a diagnosis.
        nulls: that its thresholds come from.
        folder: to write into.
        command: that diagnoses again with a further recording.
        effects: file with effects of one's own, which a process that predicts reads too.
        finish: adds to the page, once the answer is on disk.

    Returns:
        What ``discrepancy.json`` holds.
    """
    told = found.to_json()
    told["thresholds"] = {
        name: max(LEAST, nulls.thresholds.get(name, 0.0)) for name in told["passes"][0]["scores"]
    }
    told["basis"] = nulls.basis
    told["advice"] |= {"command": command, "scenarios": _advise(found, folder)}
    found.material.write(folder / "material.yaml")
    told["written"] = _again(found, folder / "material.yaml", effects)
    write_json(folder / "discrepancy.json", told)
    played, unplayed = _play(found, folder)
    page = diagnosis_page(
        found, nulls, command=command, scenarios=told["advice"]["scenarios"], played=played
    )
    if unplayed:
        page.paragraph(f"Held-out motion is not played: {unplayed}.")
    for one in told["written"]:
        page.paragraph(_sentence(one))
    finish(page)
    page.write(folder / "report.html")
    return told


def _again(found: Diagnosis, material: Path, effects: Path | None) -> list[dict[str, Any]]:
    """How far ``form-drake predict`` of a written material, in a process of its own, is off what was verified.

    Of every held-out recording: the largest change of a coordinate [m] and of a component of every tool's
    force [N]; ``failed``: why there is none, None: it did not fail.
    """
    if found.check is None or found.after is None:
        return []
    refused = found.verdict == "unnamed"  # its effects are not written
    verified, scenes = found.check.before if refused else found.after, found.check.scenes
    told, words = list[dict[str, Any]](), ["--device", scenes.device]
    words += [] if effects is None else ["--effects", str(effects.resolve())]
    with TemporaryDirectory() as name:
        seen, made = Path(name) / "seen.h5", Path(name) / "made.h5"
        for recording, own, dx in zip(
            scenes.recordings, verified.recordings, scenes.dx, strict=True
        ):
            write_recording(recording, seen)
            line = ["predict", str(material), str(seen), "--out", str(made), "--dx", str(dx)]
            command = [sys.executable, "-P", "-m", "form_drake", *line, *words]
            try:
                ran = subprocess.run(command, capture_output=True, text=True, check=False)
            except KeyboardInterrupt:  # what was found stays
                told.append({"failed": "interrupted", "tracks": None, "forces": {}})
                break
            if ran.returncode:
                last = (ran.stderr.strip() or "no word").splitlines()[-1]
                told.append({"failed": last, "tracks": None, "forces": {}})
                continue
            told.append({"failed": None, **_apart(read(made), own)})
    return told


def _apart(made: Recording, own: Recording) -> dict[str, Any]:
    forces = {k: float(np.abs(made.forces[k].value - s.value).max()) for k, s in own.forces.items()}
    return {"tracks": float(np.nanmax(np.abs(made.p_WQ - own.p_WQ))), "forces": forces}


def _sentence(one: dict[str, Any]) -> str:
    if one["failed"] is not None:
        return f"form-drake predict of the written material.yaml fails: {one['failed']}"
    forces = "".join(f", the force on {k} by {v:.2g} N" for k, v in one["forces"].items())
    return (
        "form-drake predict of the written material.yaml, in a process of its own, differs from what was verified:"
        f" a coordinate by {1e3 * one['tracks']:.2g} mm at most{forces}."
    )


def _play(found: Diagnosis, folder: Path) -> tuple[str, str]:
    """Name of a page that plays the first held-out motion, "": there is none; and why it failed."""
    if found.check is None or found.after is None:
        return "", ""
    from form_drake.systems.before_after import write_before_after

    seen, before = found.check.measured[0], found.check.before.recordings[0]
    title = "held-out motion, measured and predicted"
    try:
        write_before_after(seen, before, found.after.recordings[0], folder / PLAYED, title)
    except (ValueError, RuntimeError) as error:  # too large a page; no port for Meshcat
        return "", str(error)
    return PLAYED, ""


def _advise(found: Diagnosis, folder: Path) -> list[str]:
    """Names of scenarios in which the station does what should be recorded next, as far as it can."""
    from form_drake.systems.advised import advised
    from form_drake.systems.probe import planned
    from form_drake.systems.scenario import load_scenario

    seen = found.naming.passes[0].match.scenes.recordings[0]
    gravity, shape = np.asarray(seen.gravity), body(seen)
    if seen.gravity is None or not -gravity[2] > UPRIGHT * np.linalg.norm(gravity):
        return []
    foot = next(f.condition for f in shape.faces if f.axis == 2 and not f.side)
    plain = replace(found.model, causes=()).material(found.density)  # as recordings declare it
    made = advised(found.advice.motions, shape.low, shape.high, foot, plain)
    for name, text in made.items():
        write_text(folder / name, text)
        try:
            planned(load_scenario(folder / name))
        except ValueError:  # the arm cannot do it
            (folder / name).unlink()
    return [name for name in made if (folder / name).is_file()]
