"""``form-drake demo``: the main job in one command, without any data."""

import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from form_drake.commands.output import Changes, emit, say
from form_drake.demo import run_demo
from form_drake.effects import CATALOGUE
from form_drake.files import whole_folder
from form_drake.hidden_demo import run_hidden_demo


@dataclass(frozen=True)
class Demo:
    """Press a soft block of hidden material with the arm, identify it, predict another press."""

    set: Changes = ()
    """Change of the scenario, such as solver.dx=0.005 for a quick look; repeatable."""
    seed: int | None = None
    """Seed of the hidden material and the noise; default: a fresh one, printed."""
    out: Path = Path("runs/demo")
    """Folder to write; an earlier one is replaced as a whole."""
    hidden: bool = False
    """Instead: a block that carries an effect drawn by the seed is diagnosed; the effect is found,
    named and added, and an unseen motion predicted without and with it."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the demo and say where the report is."""
        if self.hidden and self.set:
            raise ValueError("--set: --hidden simulates no scenario; leave one of them out")
        seed = secrets.randbelow(10**6) if self.seed is None else self.seed
        if seed < 0:
            raise ValueError(f"--seed: a whole number from 0 is wanted, got {seed}")
        with whole_folder(self.out) as folder:
            say(f"seed {seed}")
            text, result = (self._hidden if self.hidden else self._press)(folder, seed)
        report = self.out / "report.html"
        emit(text, {"seed": seed, **result, "report": str(report)}, as_json=self.json)
        say(f"open {report}")

    def _press(self, folder: Path, seed: int) -> tuple[str, dict[str, Any]]:
        """What is printed and told of a press."""
        outcome = run_demo(folder, seed, say, self.set)
        told = [
            f"{name}: shape {1e3 * e['shape_rms']:.3f} mm, force {100 * e['force_rms']:.2f} % rms,"
            f" {100 * e['peak_error']:+.2f} % at its peak"
            for name, e in (("first guess", outcome.before), ("identified", outcome.after))
        ]
        answer = outcome.answer
        result = {"before": outcome.before, "after": outcome.after}
        text = "\n".join([str(answer), "unseen press", *told])
        return text, {"identification": answer.to_json(), **result}

    def _hidden(self, folder: Path, seed: int) -> tuple[str, dict[str, Any]]:
        """The same of an effect that was hidden."""
        found, truth = run_hidden_demo(folder, seed, say)
        effect = truth["effect"]
        unit = CATALOGUE[effect["name"]].unit
        told = f"hidden was: {effect['name']} {effect['coefficient']:.4g} {unit}"
        return f"{found}\n\n{told}", {**found.to_json(), "truth": truth}
