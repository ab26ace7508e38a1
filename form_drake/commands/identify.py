"""``form-drake identify``: from a recording to a material."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from form_drake.commands.output import Assignments, assignments, emit, out_file, say
from form_drake.files import target_folder, whole_folder, write_json
from form_drake.identify import identify
from form_drake.records import read


@dataclass(frozen=True)
class Identify:
    """Identify a material's law from a recording, with error bars."""

    recording: tyro.conf.Positional[Path]
    """Recording: an .h5 file, or an NCLaw .npz file with metadata.json beside it."""
    law: str | None = None
    """Constitutive law (see: form-drake list laws); default: the one that the recording declares."""
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
    """Parameter values that are given."""
    seed: int = 0
    """Seed of the added noise."""
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
        recording = read(self.recording)
        answer = identify(
            recording,
            self.law,
            observe=self.observe,
            stride=self.stride,
            position_noise=self.position_noise,
            add_noise=self.add_noise,
            initial_velocity=self.initial_velocity,
            start=assignments(self.start),
            known=assignments(self.known),
            seed=self.seed,
        )
        if self.out is not None:
            answer.material.write(out)
        else:
            with whole_folder(out) as folder:
                answer.material.write(folder / "material.yaml")
                write_json(folder / "result.json", answer.to_json())
            out = out / "material.yaml"
        emit(str(answer), answer.to_json(), as_json=self.json)
        twist = answer.details.get("initial_twist")
        if twist is not None:
            found = ",".join(f"{v:.8g}" for v in twist["value"])
            say(f"initial motion, for form-drake predict: --initial-velocity {found}")
        say(f"written: {out}")
