"""The demo of a diagnosis: a soft block that carries an effect nobody knows; it is found and added.

Material and effect are drawn from a seed, simulated on a finer grid than the diagnosis takes, and
written to ``truth.json``, which is opened again only for the last table, after the answer is on disk.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.diagnose import Diagnosis, Nulls, diagnosed
from form_drake.diagnose.hidden import Hidden
from form_drake.diagnose.motions import Block
from form_drake.diagnosis_folder import write_diagnosis
from form_drake.effects import CATALOGUE
from form_drake.files import read_mapping, write_json
from form_drake.laws import LAWS
from form_drake.records import read, write_recording
from form_drake.report import Report

BLOCK = Block(points=200)
DX: float | None = None  # grid spacing of the twin [m]; None: chosen
FINER = 1.25  # times as many cells along every axis as the twin's
PRESSING, SHAKING = 1.9, 1.0  # [s]
UNSEEN = {"seconds": 1.5, "depth": 0.09, "beat": 6.0}
NAMES = (  # of which a press alone, here the unseen one, shows what they change
    "anisotropy",
    "camera-pose",
    "camera-scale",
    "eigenstrain",
    "force-delay",
    "inclusion",
    "relaxation",
    "stiffening",
)
LARGE = (0.5, 1.0)  # of the range of sizes
FILES = ("press", "shake", "unseen")


def run_hidden_demo(
    folder: Path, seed: int, say: Callable[[str], None]
) -> tuple[Diagnosis, dict[str, Any]]:
    """The whole demo into a folder: recordings, report, material with the effect.

    Args:
        folder: to write into.
        seed: of what is hidden and of the noise.
        say: told what happens.

    Returns:
        What was found, and what was hidden.
    """
    say(
        "1/3 a soft block with a hidden effect is pressed and shaken (compiling kernels the first time)"
    )
    _hide(folder, np.random.default_rng(seed))
    press, shake, unseen = (read(folder / f"{name}.h5") for name in FILES)
    say("2/3 what a simulation of the block is missing is sought")
    nulls = Nulls.common()
    found = diagnosed(
        (press, shake),
        LAWS[BLOCK.law],
        effects=list(CATALOGUE.values()),
        thresholds=nulls.thresholds,
        holdout=(unseen,),
        dx=DX,
        progress=lambda text: say(f"    {text}"),
    )
    say("3/3 the report is written")
    write_diagnosis(found, nulls, folder, finish=lambda page: _compared(page, found, folder))
    return found, read_mapping(folder / "truth.json")


def _hide(folder: Path, rng: np.random.Generator) -> None:
    """Write the recordings of a specimen, and the truth about it."""
    hidden = Hidden.drawn(BLOCK, str(rng.choice(NAMES)), rng, float(rng.uniform(*LARGE)))
    planned = (hidden.press(seconds=PRESSING), BLOCK.shake(SHAKING), hidden.press(**UNSEEN))
    for name, recording in zip(FILES, hidden.recorded(planned, FINER, rng, DX), strict=True):
        write_recording(recording, folder / f"{name}.h5")
    write_json(folder / "truth.json", hidden.to_json())


def _compared(page: Report, found: Diagnosis, folder: Path) -> None:
    """What was hidden, and what was found of it."""
    truth, model = read_mapping(folder / "truth.json"), found.naming.model
    page.heading("What was hidden")
    rows = [
        [key, f"{true:.5g}", f"{model.values[key]:.5g}", model.law.unit(key)]
        for key, true in truth["values"].items()
    ]
    one = truth["effect"]
    effect = CATALOGUE[one["name"]]
    same = [c for c in model.causes if c.effect is effect]
    told = [f"{c.coefficient:.4g}" for c in same] or ["not found"]
    rows.append([effect.id, f"{one['coefficient']:.4g}", told[0], effect.unit])
    for key, true in one["where"].items():
        told = [f"{c.shape[key]:.4g}" for c in same] or ["-"]
        rows.append([key, f"{true:.4g}", told[0], ""])
    page.table(["", "hidden", "found", "unit"], rows)
