"""``form-drake simulate``: a probe in the station, recorded."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import tyro
from tqdm import tqdm

from form_drake.commands.output import Changes, device, emit, out_file, run_in, say
from form_drake.effects import catalogue
from form_drake.files import joined, spare, target_folder, whole_folder, write_json, write_text
from form_drake.material import read_material
from form_drake.records import Recording, read_recording, write_recording

if TYPE_CHECKING:
    from form_drake.systems.identifier import Answer
    from form_drake.systems.scenario import Scenario


ROUNDED = 1e-9  # share of a value, below which its deviation is rounding: it was given


@dataclass(frozen=True)
class Simulate:
    """Simulate a probe: arm, tool and soft material in one Drake diagram."""

    scenario: tyro.conf.Positional[str]
    """Name of a scenario (see: form-drake list scenarios) or a .yaml file."""
    set: Changes = ()
    """Change of the scenario, such as specimen.material.E=63e3; may be given several times."""
    material: Path | None = None
    """Material file (YAML) of the specimen, effects and all; default: the scenario's own material."""
    effects: Path | None = None
    """Python file with effects of your own that material or scenario name; it is executed."""
    out: Path | None = None
    """Folder to write; an earlier one is replaced as a whole; default: runs/SCENARIO."""
    field: Literal["displacement", "speed", "stress", "pressure"] = "stress"
    """What colours the particles of the Meshcat page."""
    page: bool = True
    """Leave out the Meshcat page, which is written otherwise."""
    live: bool = False
    """Show the simulation while it runs, in a browser."""
    perception: Literal["stereo"] | None = None
    """Two cameras see a face: pictures are rendered, and a process of its own that sees nothing else
    tracks them; the recording holds none of the simulator's particles. With --live or --answers they
    are tracked in the diagram while the probe moves."""
    answers: float | None = None
    """Identify while the probe moves, every so many seconds of it, and say what is known by then."""
    graphviz: Path | None = None
    """Draw the diagram into a .dot file and simulate nothing."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Simulate, then write recording, truth, effective scenario and page."""
        from form_drake.systems.pictures import seen_by_cameras
        from form_drake.systems.probe import largest_force, prepare, record, shown, truth
        from form_drake.systems.scenario import declaring, holding, load_scenario, scenario_text
        from form_drake.systems.viewer import View

        if self.answers is not None and not 0.0 < self.answers < np.inf:
            raise ValueError(f"--answers {self.answers:g}: a positive number of seconds is wanted")
        effects = catalogue(self.effects)
        own: tuple[str, ...] = ()
        if self.material is not None:
            material = read_material(self.material)
            before = load_scenario(self.scenario, effects=effects)
            own = (*holding(material), declaring(before.specimen.known, material.law))
        changes = (*own, f"solver.device={self.device}", *self.set)
        scenario = load_scenario(self.scenario, changes, effects)
        device(scenario.solver.device)
        seen = self.perception is not None
        within = seen and (self.live or self.answers is not None)
        if seen:
            scenario = seen_by_cameras(scenario)
        if self.graphviz is not None:
            dot = out_file(self.graphviz, ".dot", ".gv", option="--graphviz")
            drawn = prepare(scenario, seen=within, answers=self.answers, effects=effects)
            write_text(dot, drawn.diagram.GetGraphvizString())
            if self.json:
                emit("", {"diagram": str(dot)}, as_json=True)
            say(f"written: {dot}")
            return
        out = target_folder(self.out or Path("runs") / scenario.name)
        spare(out, Path(self.scenario), self.material, self.effects)
        hidden = truth(scenario)
        told = (lambda url: say(f"live view: {url}")) if self.live else None
        meshcat = shown(told) if self.page or self.live else None
        view = View(field=self.field)
        run = prepare(
            scenario,
            meshcat,
            view,
            seen=within,
            answers=self.answers,
            told=_tell,
            effects=effects,
        )
        steps = round(run.duration / scenario.solver.period)
        with tqdm(total=steps, unit="step", disable=None, delay=2, leave=False) as bar:
            recording = record(run, lambda *_: bar.update())
        with whole_folder(out) as folder:
            if seen and not within:
                self._look(scenario, recording, folder / "seen")
            else:
                write_recording(recording, folder / "recording.h5")
            write_json(folder / "truth.json", hidden)
            write_text(folder / "scenario.yaml", scenario_text(self.scenario, changes, hidden=True))
            if meshcat is not None and self.page:
                run.write_page(folder / "station.html")
        if seen and not within:
            recording = self._tracked(out, scenario.solver.device)
        result = {
            "scenario": scenario.name,
            "recording": str(out / "recording.h5"),
            "frames": recording.frames,
            "points": recording.points,
            "largest_force": largest_force(recording),
        }
        text = (
            f"{scenario.name}: {recording.frames} frames of {recording.points} points, largest force"
            f" {result['largest_force']:.4g} N"
        )
        emit(text, result, as_json=self.json)
        say(f"written: {out}")

    def _look(self, scenario: "Scenario", particles: Recording, seen: Path) -> None:
        """Write what cameras see of the particles, their rig and what is measured beside them."""
        from form_drake.systems.pictures import (
            beside_pictures,
            frames_a_second,
            rig_of,
            write_pictures,
        )

        rig = rig_of(scenario, frames_a_second(particles))
        (seen / "pictures").mkdir(parents=True)
        rig.write(seen / "rig.yaml")
        write_recording(beside_pictures(particles, scenario.stereo.symmetry), seen / "probe.h5")
        with tqdm(total=particles.frames, unit="pair", disable=None, delay=2, leave=False) as bar:
            place = seen / "pictures"
            write_pictures(place, scenario, rig, particles, scenario.solver.device, bar.update)

    def _tracked(self, out: Path, device: str) -> Recording:
        """The recording that a process makes of what cameras saw alone.

        Raises:
            ValueError: it fails; what was simulated is kept.
            KeyboardInterrupt: the same.
        """
        kept = f"pictures, rig and probe are kept in {out / 'seen'}: form-drake track reads them"
        names = ("recording.h5", "seen.html")
        joined(out, *names)
        recording, page = (str(out.resolve() / name) for name in names)
        given = ("pictures", "--calibration", "rig.yaml", "--probe", "probe.h5")
        made = ("--out", recording, "--report", page, "--device", device)
        try:
            run_in(out / "seen", "track", *given, *made)
        except ValueError as error:
            raise ValueError(f"{error}; {kept}") from None
        except KeyboardInterrupt:
            say(kept)
            raise
        return read_recording(Path(recording))


def _tell(answer: "Answer") -> None:
    found = answer.identification
    if found is None:
        say(f"{answer.time:.2f} s: {answer.reason}")
        return
    values = ", ".join(
        f"{key} {p.value:.4g} ± {1.96 * p.std:.2g} {p.unit}"
        for key, p in found.material.parameters().items()
        if p.std is not None and p.std > ROUNDED * abs(p.value)
    )
    say(f"{answer.time:.2f} s: {values} (found in {found.seconds:.2g} s)")
