"""``form-drake identify``: from a recording to a material."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from form_drake.commands.output import Assignments, assignments, emit, out_file, say
from form_drake.files import joined, spare, target_folder, whole_folder, write_json
from form_drake.identify import WeakOptions, chosen_method, identify
from form_drake.laws import load
from form_drake.motion.tracks import sighted
from form_drake.records import Recording, read, thinned
from form_drake.weak_report import weak_report


@dataclass(frozen=True)
class Identify:
    """Identify a material's law from a recording, with error bars."""

    recording: tyro.conf.Positional[tuple[Path, ...]]
    """One recording or more: an .h5 file, or an NCLaw .npz file with metadata.json beside it; several probes of
    one material are stacked by the weak form."""
    law: str | None = None
    """Constitutive law, or a sum such as yeoh+gent (see: form-drake list laws); default: the one
    that the recording declares."""
    laws: Path | None = None
    """Python file with laws of your own; it is executed."""
    method: Literal["step", "rollout", "weak"] | None = None
    """How: solver steps, rollouts, or the weak balance of tracks and forces; default: the first of
    them that the recording allows."""
    observe: Literal["full", "no-stress", "positions"] | None = None
    """What may be used of the recording; default: the most that it holds."""
    stride: int = 1
    """Use every N-th frame (positions only)."""
    position_noise: float | None = None
    """States the noise of recorded positions [m]; default: estimated."""
    add_noise: float | None = None
    """Degrades a copy of the positions on purpose [m], with --seed; the answer says so."""
    initial_velocity: Literal["known", "rigid"] | None = None
    """Take the recorded initial velocities, or find the rigid initial motion as well."""
    start: Assignments = ""
    """Values where rollouts start; default: a coarse scan that uses no truth."""
    known: Assignments = ""
    """Parameter values that are given; in the weak form nu may stand without E."""
    force: str = "sensor"
    """Source of the forces: sensor at the tool, or joint-torque, where the recording has both."""
    fields: str = ""
    """Test fields of the weak form, joined by commas: box, axial, bend, bend-curl, grid, potential; default:
    those that the stated faces of the body admit."""
    window: float | None = None
    """Width of the weak form's windows in time [s]; default: chosen from frames and law."""
    pressure: Literal["law", "free", "supplied"] | None = None
    """Who balances pressure in the weak form; default: decided from the motion."""
    traction_free: str = ""
    """Axes across which the body is too thin to bear stress, joined by commas: one for plane stress,
    two for a fibre (weak form); default: those across a bent strip."""
    estimator: Literal["gls", "ols"] = "gls"
    """Generalised, or ordinary least squares as in the paper (weak form)."""
    twin: bool = False
    """Simulate the scene that the recording states, or scenario.yaml beside it, with what was found;
    read it as the data are read, and take off what that costs; the answer without it is told as well
    (weak form)."""
    seed: int = 0
    """Seed of the added noise and of the noise draws."""
    report: Path | None = None
    """HTML report of the weak form to write."""
    out: Path | None = None
    """Material file to write; default: runs/identify/material.yaml."""
    json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Identify, write the material, print the answer."""
        if self.out is not None:
            out = out_file(self.out, ".yaml", ".yml")
        else:
            out = target_folder(Path("runs/identify"))
        spare(out, *self.recording, self.laws)
        report = None if self.report is None else out_file(self.report, ".html", option="--report")
        if not self.recording:
            raise ValueError("no recording is given: the PATH of one or more .h5 or .npz files")
        if self.seed < 0:
            raise ValueError(f"--seed: a whole number from 0 is wanted, got {self.seed}")
        if self.laws is not None:
            load(self.laws)
        recordings = [read(path) for path in self.recording]
        weak = chosen_method(recordings, self.method, self.observe) == "weak"
        if report is not None and not weak:
            raise ValueError("--report belongs to the weak form: add --method weak")
        answer = identify(
            recordings,
            self.law,
            method=self.method,
            observe=self.observe,
            stride=self.stride,
            position_noise=self.position_noise,
            add_noise=self.add_noise,
            initial_velocity=self.initial_velocity,
            start=assignments(self.start),
            known=assignments(self.known),
            seed=self.seed,
            force=self.force,
            weak=self._weak(),
            twin=self._twin(recordings) if self.twin else None,
        )
        if self.out is not None:
            answer.material.write(out)
        else:
            with whole_folder(out) as folder:
                answer.material.write(folder / "material.yaml")
                write_json(folder / "result.json", answer.to_json())
            if report is not None and out.resolve() in report.resolve().parents:
                joined(out, report.resolve().relative_to(out.resolve()).as_posix())
            out = out / "material.yaml"
        if report is not None:
            weak_report(answer, report)
            say(f"report: {report}")
        emit(str(answer), answer.to_json(), as_json=self.json)
        twist = answer.details.get("initial_twist")
        if twist is not None:
            found = ",".join(f"{v:.8g}" for v in twist["value"])
            say(f"initial motion, for form-drake predict: --initial-velocity {found}")
        say(f"written: {out}")

    def _twin(self, recordings: list[Recording]) -> Callable[..., Recording] | Literal["stated"]:
        scenario = self.recording[0].with_name("scenario.yaml")
        if recordings[0].solver is not None or not scenario.is_file():
            return "stated"
        if len(recordings) > 1:
            raise ValueError("--twin takes one probe of a station at a time")
        from form_drake.systems.replay import twin
        from form_drake.systems.scenario import load_scenario

        seen = thinned(sighted(recordings[0].measured_by(self.force)), self.stride)
        return twin(load_scenario(scenario), seen)

    def _weak(self) -> WeakOptions:
        axes = [part.strip() for part in self.traction_free.split(",") if part.strip()]
        if not set(axes) <= set("xyz"):
            raise ValueError(f"--traction-free {self.traction_free}: some of x, y, z are wanted")
        return WeakOptions(
            free=tuple("xyz".index(a) for a in axes) or None,
            fields=tuple(part.strip() for part in self.fields.split(",") if part.strip()),
            window=self.window,
            pressure=self.pressure,
            estimator=self.estimator,
            seed=self.seed,
        )
