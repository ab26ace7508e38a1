"""``form-drake predict``: roll an identified material out and compare."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from tqdm import tqdm

from form_drake.commands.output import Assignments, assignments, device, emit, out_file, say
from form_drake.diagnose import Model, Scenes
from form_drake.diagnose.admitted import require_fine
from form_drake.diagnose.verify import there
from form_drake.effects import Effect, catalogue
from form_drake.effects.acting import placed
from form_drake.files import about, spare, target_folder, whole_folder, write_json
from form_drake.laws.values import finite
from form_drake.material import Material, read_material
from form_drake.motion import body
from form_drake.mpm.bodies import rigid_velocity
from form_drake.mpm.prediction import predict, require_alone
from form_drake.records import Recording, read, write_recording

Predicted = Callable[[Material, Recording], tuple[Recording, dict[str, Any], str]]
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


def moving(recording: Recording, twist: str | None) -> Recording:
    """The recording with the initial velocities of a rigid motion, where one is stated.

    Raises:
        ValueError: six finite numbers are wanted, or there are no initial velocities at all.
    """
    if twist is None:
        if recording.v_0 is None:
            raise ValueError(
                "the recording holds no initial velocities: state the rigid initial motion with"
                f" --initial-velocity {','.join(TWIST)} (identify prints it and writes it into"
                " result.json)"
            )
        return recording
    parts = twist.split(",")
    if len(parts) != len(TWIST):
        raise ValueError(f"--initial-velocity {twist}: {','.join(TWIST)} are wanted")
    numbers = [
        finite(f"--initial-velocity: {k}", v.strip()) for k, v in zip(TWIST, parts, strict=True)
    ]
    v, omega = np.array(numbers[:3]), np.array(numbers[3:])
    return replace(recording, v_0=rigid_velocity(recording.reference, v, omega))


def _held(recording: Recording) -> bool:
    """Whether it states a body that something holds, which may rest without any tool."""
    words = [text.partition(" ")[0] for text in recording.contact.values()]
    return "shape" in recording.geometry and bool({"bonded", "frictionless"} & set(words))


@dataclass(frozen=True)
class Predict:
    """Predict a recorded motion with an identified material: thrown, from its first frame; probed in
    a station, or between the faces that the recording states, with the tool moving as recorded."""

    material: tyro.conf.Positional[Path]
    """Material file (YAML)."""
    recording: tyro.conf.Positional[Path]
    """Recording whose first frame, grid, step and walls are used, or of a probe in a station."""
    set: Assignments = ""
    """Changes of the material; E and nu may stand for mu and lam."""
    initial_velocity: Annotated[str | None, tyro.conf.arg(metavar=",".join(TWIST))] = None
    """Rigid initial motion about the centroid [m/s, rad/s]; default: the recorded velocities."""
    effects: Path | None = None
    """Python file with effects of your own that the material names; it is executed."""
    scenario: str | None = None
    """Scenario of a probe; default: scenario.yaml beside the recording."""
    drive: Literal["pose", "force"] = "pose"
    """What drives the tool of a probe: its recorded pose, or the recorded force."""
    dx: float | None = None
    """Grid spacing [m] for a probe between stated faces; default: an eighth of its least edge."""
    out: Path | None = None
    """Recording to write the predicted motion to; default: runs/predict/prediction.h5."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Predict, write the motion, print the loss."""
        if self.out is not None:
            out = out_file(self.out, ".h5", ".hdf5")
        else:
            out = target_folder(Path("runs/predict"))
        spare(out, self.material, self.recording, self.effects)
        material, recording = read_material(self.material), read(self.recording)
        device(self.device)
        if self.dx is not None and not 0.0 < self.dx < np.inf:
            raise ValueError(f"--dx {self.dx:g}: a positive number of metres is wanted")
        material = material.changed(assignments(self.set))
        how = self._how(recording)
        self._refuse_unused(how)
        predicted, result, text = how(material, recording)
        if self.out is not None:
            write_recording(predicted, out)
        else:
            with whole_folder(out) as folder:
                write_recording(predicted, folder / "prediction.h5")
                write_json(folder / "result.json", result)
            out = out / "prediction.h5"
        emit(text, result, as_json=self.json)
        say(f"written: {out}")

    def _how(self, recording: Recording) -> Predicted:
        """Thrown, in a station, or between the faces that the recording states."""
        stage = bool(recording.poses) or (recording.v_0 is None and _held(recording))
        if recording.solver is not None or not stage:
            return self._thrown
        stationed = self.scenario or self.recording.with_name("scenario.yaml").is_file()
        return self._probed if stationed or "shape" not in recording.geometry else self._staged

    def _refuse_unused(self, how: Predicted) -> None:
        """Refuse options that would change nothing."""
        given = {
            "--initial-velocity": self.initial_velocity is not None,
            "--effects": self.effects is not None,
            "--scenario": self.scenario is not None,
            f"--drive {self.drive}": self.drive != "pose",
            "--dx": self.dx is not None,
        }
        every = set(given)
        if how == self._thrown:
            idle, why = every - {"--initial-velocity"}, "is of a body that is thrown"
        elif how == self._staged:
            idle, why = (
                every - {"--effects", "--dx"},
                "lies beside no scenario: poses drive its tools",
            )
        else:
            idle, why = {"--initial-velocity", "--dx"}, "is of a probe, which begins at rest"
        unused = [option for option, on in given.items() if on and option in idle]
        if unused:
            raise ValueError(f"leave out {', '.join(unused)}: {self.recording} {why}")

    def _staged(
        self, material: Material, recording: Recording
    ) -> tuple[Recording, dict[str, Any], str]:
        with about(self.material):
            model = Model.of(material, self._catalogue)
        sensors = {k: s for k, s in recording.forces.items() if ":" not in k}
        recording = replace(recording, forces=sensors)
        shape = body(recording)
        require_fine(self.dx, shape)
        with about(self.material):
            placed(model.causes, shape.low, shape.high)
        scenes = Scenes.of((recording,), self.dx, self.device)
        (recording,), (predicted,) = scenes.recordings, scenes.rolled(model)
        apart = (predicted.p_WQ - recording.p_WQ)[there(recording)]
        errors = {"shape_rms": float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))}
        text = f"{self.recording.name}: shape {1e3 * errors['shape_rms']:.3g} mm rms"
        for tool, seen in recording.forces.items():
            size = float(np.sqrt(np.mean(np.sum(np.square(seen.value), axis=1))))
            change = predicted.forces[tool].value - seen.value
            share = float(np.sqrt(np.mean(np.sum(change**2, axis=1)))) / max(size, 1e-300)
            errors[f"force_rms_{tool}"] = share
            text += f", force on {tool} {100 * share:.3g} % rms"
        return predicted, self._named(material) | errors, text

    @property
    def _catalogue(self) -> dict[str, Effect]:
        return catalogue(self.effects)

    def _thrown(
        self, material: Material, recording: Recording
    ) -> tuple[Recording, dict[str, Any], str]:
        require_alone(material)
        recording = moving(recording, self.initial_velocity)
        with tqdm(total=recording.frames, unit="frame", disable=None, delay=2, leave=False) as bar:
            prediction = predict(
                recording, material, device=self.device, progress=lambda *_: bar.update()
            )
        result = self._named(material) | {"loss": prediction.loss, "frames": prediction.frames}
        text = (
            f"{self.recording.name}: loss {prediction.loss:.3g} m^2 over {prediction.frames} frames"
        )
        return prediction.recording, result, text

    def _probed(
        self, material: Material, recording: Recording
    ) -> tuple[Recording, dict[str, Any], str]:
        from form_drake.systems.replay import replay
        from form_drake.systems.scenario import load_scenario

        beside = self.recording.with_name("scenario.yaml")
        if self.scenario is None and not beside.is_file():
            raise ValueError(
                f"{self.recording}: a probe, but no scenario.yaml lies beside it: name --scenario"
            )
        name, own = self.scenario or beside, (f"solver.device={self.device}",)
        scenario = load_scenario(name, own, self._catalogue)
        with tqdm(unit="step", disable=None, delay=2, leave=False) as bar:
            found = replay(
                scenario,
                material,
                recording,
                drive=self.drive,
                effects=self._catalogue,
                progress=lambda *_: bar.update(),
            )
        errors: dict[str, float | None] = {
            "shape_rms": found.shape_rms,
            "force_rms": found.force_rms,
            "peak_error": found.peak_error,
        }
        force = f"force {100 * found.force_rms:.3g} % rms and {100 * found.peak_error:+.3g} % at its peak"
        if np.isnan(found.force_rms):
            errors |= {"force_rms": None, "peak_error": None}
            force = "no force was measured"
        text = (
            f"{self.recording.name}: shape {1e3 * found.shape_rms:.3g} mm rms, {force}, driven by"
            f" {self.drive}"
        )
        return found.recording, self._named(material) | errors | {"drive": self.drive}, text

    def _named(self, material: Material) -> dict[str, Any]:
        return {"recording": str(self.recording), "law": material.law.name}
