"""``form-drake predict``: roll an identified material out and compare."""

from dataclasses import dataclass
from pathlib import Path

import tyro
from tqdm import tqdm

from form_drake.commands.output import assignments, device, emit, say
from form_drake.files import target, target_folder, whole_folder, write_json
from form_drake.material import read_material
from form_drake.mpm.prediction import predict
from form_drake.records import read, write_recording


@dataclass(frozen=True)
class Predict:
    """Predict a recording's motion from its first frame with an identified material."""

    material: tyro.conf.Positional[Path]
    """Material file (YAML)."""
    recording: tyro.conf.Positional[Path]
    """Recording whose first frame, grid, step and walls are used."""
    set: tuple[str, ...] = ()
    """NAME=VALUE,... changes of the material; E and nu may stand for mu and lam."""
    out: Path | None = None
    """Recording to write the predicted motion to; default: runs/predict/prediction.h5."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Predict, write the motion, print the loss."""
        material, recording = read_material(self.material), read(self.recording)
        device(self.device)
        out = target(self.out) if self.out else target_folder(Path("runs/predict"))
        if self.set:
            material = material.changed(assignments(self.set))
        with tqdm(total=recording.frames, unit="frame", disable=None, delay=2, leave=False) as bar:
            prediction = predict(
                recording, material, device=self.device, progress=lambda *_: bar.update()
            )
        result = {
            "recording": str(self.recording),
            "law": material.law.name,
            "loss": prediction.loss,
            "frames": prediction.frames,
        }
        if self.out is not None:
            write_recording(prediction.recording, out)
        else:
            with whole_folder(out) as folder:
                write_recording(prediction.recording, folder / "prediction.h5")
                write_json(folder / "result.json", result)
            out = out / "prediction.h5"
        text = (
            f"{self.recording.name}: loss {prediction.loss:.3g} m^2 over {prediction.frames} frames"
        )
        emit(text, result, as_json=self.json)
        say(f"written: {out}")
