"""``form-drake demo``: the main job in one command, without any data."""

import secrets
from dataclasses import dataclass
from pathlib import Path

from form_drake.commands.output import Changes, emit, say
from form_drake.demo import run_demo
from form_drake.files import whole_folder


@dataclass(frozen=True)
class Demo:
    """Press a soft block of hidden material with the arm, identify it, predict another press."""

    set: Changes = ()
    """Change of the scenario, such as solver.dx=0.005 for a quick look; repeatable."""
    seed: int | None = None
    """Seed of the hidden material and the noise; default: a fresh one, printed."""
    out: Path = Path("runs/demo")
    """Folder to write; an earlier one is replaced as a whole."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the demo and say where the report is."""
        seed = secrets.randbelow(10**6) if self.seed is None else self.seed
        if seed < 0:
            raise ValueError(f"--seed: a whole number from 0 is wanted, got {seed}")
        with whole_folder(self.out) as folder:
            say(f"seed {seed}")
            outcome = run_demo(folder, seed, say, self.set)
        result = {
            "seed": seed,
            "identification": outcome.answer.to_json(),
            "before": outcome.before,
            "after": outcome.after,
            "report": str(self.out / "report.html"),
        }
        told = [
            f"{name}: shape {1e3 * e['shape_rms']:.3f} mm, force {100 * e['force_rms']:.2f} % rms,"
            f" {100 * e['peak_error']:+.2f} % at its peak"
            for name, e in (("first guess", outcome.before), ("identified", outcome.after))
        ]
        text = "\n".join([str(outcome.answer), "unseen press", *told])
        emit(text, result, as_json=self.json)
        say(f"5/5 open {self.out / 'report.html'}")
