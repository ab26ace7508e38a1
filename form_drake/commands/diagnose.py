"""``form-drake diagnose``: what a simulation of recordings is missing."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from form_drake.commands.output import device, emit, say
from form_drake.diagnose import Model, Nulls, Scenes, diagnosed
from form_drake.diagnose.admitted import require_all_stated, require_one_specimen
from form_drake.diagnose.thresholds import likeness
from form_drake.diagnosis_folder import write_diagnosis
from form_drake.effects import Effect, catalogue
from form_drake.effects.acting import placed
from form_drake.files import about, spare, target_folder, whole_folder
from form_drake.identify.stated import of_one_material
from form_drake.laws import law_named
from form_drake.material import read_material
from form_drake.motion import body
from form_drake.motion.tracks import sighted
from form_drake.records import Recording, read


@dataclass(frozen=True)
class Diagnose:
    """Find where simulation and measurement disagree, name the missing effect, add it and verify it."""

    recording: tyro.conf.Positional[tuple[Path, ...]]
    """Recordings of one specimen, or of fresh ones that are equal, with tracks throughout it: a press,
    whose force is measured, and what else there is, such as a shake. Each begins free of stress."""
    material: Path | None = None
    """Material to begin with (YAML); default: the law that the recordings declare is identified."""
    law: str | None = None
    """Law where no material is given; default: the declared one."""
    holdout: tuple[Path, ...] = ()
    """Recordings of the same specimen, which are predicted with what is found, and which nothing else
    reads."""
    placebo: int | None = None
    """Seed: verify two wrong effects too, the runner-up and one drawn by lot, each fitted; with --holdout."""
    effects: Path | None = None
    """Python file with effects of your own; it is executed."""
    nulls: Path | None = None
    """Scores where nothing is missing in such recordings, as bench nulls --like writes them (JSON);
    default: those that come with the package."""
    dx: float | None = None
    """Grid spacing of the simulated twin [m]; default: an eighth of the least edge."""
    force: str = "sensor"
    """Source of the force: sensor, or joint-torque where the recording has both."""
    out: Path | None = None
    """Folder to write, in the place of an earlier run's; default: runs/diagnose."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Diagnose, write report, discrepancy.json and material.yaml, print the verdict."""
        out = target_folder(self.out or Path("runs/diagnose"))
        spare(out, *self.recording, *self.holdout, self.material, self.effects, self.nulls)
        device(self.device)
        if self.placebo is not None and (self.placebo < 0 or not self.holdout):
            raise ValueError(
                f"--placebo {self.placebo}: a seed of zero or more is wanted, and --holdout"
                " recordings on which to verify"
            )
        effects = catalogue(self.effects)
        recordings, holdout, start = self.opened(effects)
        law = start.law if start else law_named(self._law(recordings))
        nulls = Nulls.common()
        if self.nulls is not None:
            nulls = Nulls.read(self.nulls)
            scenes = Scenes.of(tuple(sighted(r) for r in recordings), self.dx)
            with about(self.nulls):
                nulls.require_like(likeness(scenes, law, start.causes if start else ()))
        found = diagnosed(
            recordings,
            law,
            effects=list(effects.values()),
            thresholds=nulls.thresholds,
            start=start,
            holdout=holdout,
            placebo=self.placebo,
            dx=self.dx,
            device=self.device,
            progress=lambda text: say(f"{text} ..."),
        )
        say(found.sentence())
        if found.after is not None:
            say("predicting it once more, with the material as it is written ...")
        command = self._again(out)
        with whole_folder(out) as folder:
            told = write_diagnosis(found, nulls, folder, command=command, effects=self.effects)
        emit(str(found), told, as_json=self.json)
        say(f"written: {out / 'report.html'}")

    def opened(
        self, effects: Mapping[str, Effect]
    ) -> tuple[list[Recording], list[Recording], Model | None]:
        """Recordings to read and to hold back, and what to begin with.

        Raises:
            ValueError: there are none, they are of several specimens, or state too little.
        """
        if self.dx is not None and not 0.0 < self.dx < np.inf:
            raise ValueError(f"--dx {self.dx:g}: a positive number of metres is wanted")
        if not self.recording:
            raise ValueError("no recording is given: the PATH of one or more .h5 files")
        if self.material is not None and self.law is not None:
            raise ValueError(
                f"--law {self.law}: {self.material} has a law; leave out --law or --material"
            )
        recordings, holdout = (
            [self._read(path) for path in paths] for paths in (self.recording, self.holdout)
        )
        paths = map(str, (*self.recording, *self.holdout))
        pairs = list(zip(paths, (*recordings, *holdout), strict=True))
        require_one_specimen(pairs)
        start = self._start(effects, recordings[0])
        of_one_material((*recordings, *holdout), start.law.name if start else self.law)
        require_all_stated(pairs, len(recordings), self.dx)
        return recordings, holdout, start

    def _start(self, effects: Mapping[str, Effect], recording: Recording) -> Model | None:
        """The material to begin with; None: there is none.

        Raises:
            ValueError: it, or a place in it, is of another specimen.
        """
        if self.material is None:
            return None
        material, shape = read_material(self.material), body(recording)
        stated = shape.density if material.density is None else material.density
        if not np.isclose(stated, shape.density):
            raise ValueError(
                f"{self.material}: of another specimen: it has {stated:g} kg/m^3, the recordings state"
                f" {shape.density:g}"
            )
        with about(self.material):
            start = Model.of(material, effects)
            placed(start.causes, shape.low, shape.high)
        return start

    def _again(self, out: Path) -> str:
        """The command that diagnoses again with a further recording."""
        words = ["form-drake", "diagnose", *map(str, self.recording), "NEXT.h5"]
        for name in ("material", "law", "effects", "dx"):  # nulls are of these recordings alone
            value = getattr(self, name)
            words += [f"--{name}", str(value)] if value is not None else []
        words += ["--force", self.force] if self.force != "sensor" else []
        words += ["--device", self.device] if self.device != "cpu" else []
        words += ["--placebo", str(self.placebo)] if self.placebo is not None else []
        words += ["--holdout", *map(str, self.holdout)] if self.holdout else []
        return shlex.join([*words, "--out", f"{out}-next"])

    def _read(self, path: Path) -> Recording:
        recording = read(path)
        with about(path):
            return recording.measured_by(self.force)

    def _law(self, recordings: Sequence[Recording]) -> str:
        declared = (self.law, *(recording.law for recording in recordings))
        law = next((name for name in declared if name is not None), None)
        if law is None:
            raise ValueError(
                f"{', '.join(map(str, self.recording))}: no law is declared: name one with --law, or give"
                " --material"
            )
        return law
