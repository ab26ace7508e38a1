"""``form-drake diagnose``: what a simulation of recordings is missing."""

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from form_drake.commands.output import device, emit, say
from form_drake.diagnose import Diagnosis, Model, diagnosed, thresholds
from form_drake.diagnose.page import diagnosis_page
from form_drake.effects import CATALOGUE, load
from form_drake.files import target_folder, whole_folder, write_json
from form_drake.laws import law_named
from form_drake.material import read_material
from form_drake.motion import body
from form_drake.records import Recording, read

PLAYED = "before_after.html"


@dataclass(frozen=True)
class Diagnose:
    """Find where simulation and measurement disagree, name the missing effect, add it and verify it."""

    recording: tyro.conf.Positional[tuple[Path, ...]]
    """Recordings of one specimen with tracks throughout it: a press, whose force is measured, and
    what else there is, such as a shake."""
    material: Path | None = None
    """Material to begin with (YAML); default: the law that the recordings declare is identified."""
    law: str | None = None
    """Law where no material is given; default: the declared one."""
    holdout: tuple[Path, ...] = ()
    """Recordings of the same specimen on which what is found is verified, and which nothing else
    reads."""
    effects: Path | None = None
    """Python file with effects of your own; it is executed."""
    dx: float | None = None
    """Grid spacing of the simulated twin [m]; default: an eighth of the least edge."""
    out: Path | None = None
    """Folder to write; default: runs/diagnose."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Diagnose, write report, discrepancy.json and material.yaml, print the verdict."""
        out = target_folder(self.out or Path("runs/diagnose"))
        device(self.device)
        if self.dx is not None and not 0.0 < self.dx < np.inf:
            raise ValueError(f"--dx {self.dx:g}: a positive number of metres is wanted")
        if not self.recording:
            raise ValueError("no recording is given: the PATH of one or more .h5 files")
        effects = CATALOGUE | (load(self.effects, CATALOGUE) if self.effects else {})
        recordings = [read(path) for path in self.recording]
        holdout = [read(path) for path in self.holdout]
        start = None
        if self.material is not None:
            start = Model.of(read_material(self.material), effects)
        paths = (*self.recording, *self.holdout)
        _check(list(zip(paths, (*recordings, *holdout), strict=True)))
        law = start.law if start else law_named(self._law(recordings[0]))
        limits = thresholds()
        found = diagnosed(
            recordings,
            law,
            effects=list(effects.values()),
            thresholds=limits,
            start=start,
            holdout=holdout,
            dx=self.dx,
            device=self.device,
            progress=lambda text: say(f"{text} ..."),
        )
        told, command = found.to_json(), self._again(out)
        told["advice"]["command"] = command
        with whole_folder(out) as folder:
            write_json(folder / "discrepancy.json", told)
            found.material.write(folder / "material.yaml")
            played = _play(found, folder)
            page = folder / "report.html"
            diagnosis_page(found, limits, page, command=command, played=played)
        emit(_table(found), told, as_json=self.json)
        say(f"written: {out / 'report.html'}")

    def _again(self, out: Path) -> str:
        """The command that diagnoses again with a further recording."""
        words = ["form-drake", "diagnose", *map(str, self.recording), "NEXT.h5"]
        for name in ("material", "law", "effects", "dx"):
            value = getattr(self, name)
            words += [f"--{name}", str(value)] if value is not None else []
        words += ["--device", self.device] if self.device != "cpu" else []
        words += ["--holdout", *map(str, self.holdout)] if self.holdout else []
        return shlex.join([*words, "--out", f"{out}-next"])

    def _law(self, recording: Recording) -> str:
        law = self.law or recording.law
        if law is None:
            raise ValueError(
                f"{self.recording[0]} declares no law: name one with --law, or give --material"
            )
        return law


def _check(recordings: list[tuple[Path, Recording]]) -> None:
    """Refuse recordings of different specimens, and one motion twice.

    Raises:
        ValueError: see there.
    """
    (path, first), *rest = recordings
    shape = body(first)
    for n, (name, other) in enumerate(rest, start=1):
        size = body(other)
        same = np.allclose([size.low, size.high], [shape.low, shape.high], rtol=0.0, atol=1e-6)
        if not same or not np.isclose(size.density, shape.density):
            raise ValueError(
                f"{name}: another specimen than {path}; boxes and densities must agree"
            )
        for earlier, seen in recordings[:n]:
            if seen.p_WQ.shape == other.p_WQ.shape and np.array_equal(
                seen.p_WQ, other.p_WQ, equal_nan=True
            ):
                raise ValueError(f"{name}: the same motion as {earlier}")


def _play(found: Diagnosis, folder: Path) -> str:
    """Name of a page that plays the first held-out motion; "": none was predicted."""
    if not found.measured:
        return ""
    from form_drake.systems.before_after import write_before_after

    before, after = found.simulated
    write_before_after(
        found.measured[0],
        before[0],
        after[0],
        folder / PLAYED,
        "held-out motion, measured and predicted",
    )
    return PLAYED


def _table(found: Diagnosis) -> str:
    lines = [found.sentence(), ""]
    for n, one in enumerate(found.naming.passes, start=1):
        told = ", ".join(f"{s.effect.id} {s.score:.0f}" for s in one.ranked[:5])
        lines.append(f"pass {n}: {told}")
    if found.channels:
        lines += ["", f"{'held out':24} {'before':>10} {'after':>10} {'floor':>10} {'closed':>8}"]
    for c in found.channels:
        closed = f"{100.0 * c.closure:6.0f} %" if c.counts else "       -"
        numbers = " ".join(f"{v:10.3g}" for v in (c.before, c.after, c.floor))
        lines.append(f"{c.name:24} {numbers} {closed} {c.unit}")
    return "\n".join(lines)
