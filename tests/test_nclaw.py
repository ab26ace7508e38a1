"""The shared NCLaw trajectories, which another program made, with every true value replaced.

The files are found through FORM_DRAKE_NCLAW. All tests read a copy of ``metadata.json`` whose
``law`` entries are nonsense; the truth they compare with is stated here.
"""

import json
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from form_drake import Material, identify, predict, read
from form_drake.__main__ import main
from form_drake.laws import LAWS

FOLDER = os.environ.get("FORM_DRAKE_NCLAW")
pytestmark = pytest.mark.skipif(
    not FOLDER, reason="FORM_DRAKE_NCLAW (folder of the shared NCLaw data) is not set"
)
SINE = np.sin(np.radians(25.0))


def lame(E, nu):
    return {"mu": E / (2 * (1 + nu)), "lam": E * nu / ((1 + nu) * (1 - 2 * nu))}


LAW = {
    "jelly": "fixed-corotated",
    "sand": "drucker-prager",
    "plasticine": "von-mises",
    "water": "weakly-compressible",
}
TRUTH = {
    "jelly": lame(1e5, 0.2),
    "sand": lame(1e6, 0.2) | {"alpha": np.sqrt(2 / 3) * 2 * SINE / (3 - SINE)},
    "plasticine": lame(3e5, 0.25) | {"tau_y": 5e3},
    "water": {"lam": lame(1e5, 0.3)["lam"]},
}


def worst(material, values):
    """Largest relative error of a parameter."""
    return max(abs(values[k] / t - 1.0) for k, t in TRUTH[material].items())


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The shared files beside metadata without a true value."""
    folder = tmp_path_factory.mktemp("nclaw")
    metadata = json.loads((Path(FOLDER) / "metadata.json").read_text())
    for entry in metadata.values():
        entry["law"] = {"elasticity": "nonsense", "E": -1.0, "nu": "green", "yield_stress": None}
    (folder / "metadata.json").write_text(json.dumps(metadata))
    for path in Path(FOLDER).glob("*.npz"):
        (folder / path.name).symlink_to(path)
    return folder


@cache
def trained(folder, material):
    """A training motion, every step recorded."""
    return read(folder / f"train_{material}.npz")


@cache
def identified(folder, material, observe):
    """The answer to a training motion."""
    return identify(trained(folder, material), LAW[material], observe=observe).material


@pytest.mark.parametrize("observe", ["no-stress", "full"])
@pytest.mark.parametrize(
    "material, bound", [("jelly", 1e-6), ("sand", 1e-5), ("plasticine", 1e-5), ("water", 1e-6)]
)
def test_steps_give_the_true_parameters(data, material, bound, observe):
    assert worst(material, identified(data, material, observe).values) < bound


@pytest.mark.parametrize("material, bound", [("jelly", 1e-5), ("water", 6e-6)])
def test_positions_give_the_true_parameters(data, material, bound):
    assert worst(material, identified(data, material, "positions").values) < bound


@pytest.mark.parametrize("condition", ["time", "velocity1"])
@pytest.mark.parametrize("material", LAW)
def test_unseen_motions_are_predicted(data, material, condition):
    unseen = read(data / f"eval_{condition}_{material}.npz")
    found = identified(data, material, "no-stress")
    assert predict(unseen, found).loss < (1e-10 if material == "water" else 1e-11)


def test_the_wrong_material_is_not_predicted(data):
    unseen = read(data / "eval_velocity1_jelly.npz")
    softer = Material(LAWS["fixed-corotated"], {k: 0.5 * v for k, v in TRUTH["jelly"].items()})
    assert predict(unseen, softer).loss > 1e-6


def spoken(capsys, *arguments):
    """The JSON text of a command, run times apart."""
    assert main([*map(str, arguments), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    return json.dumps({k: v for k, v in answer.items() if k not in ("seconds", "compile_seconds")})


@pytest.mark.parametrize(
    "material, observe",
    [*((m, "no-stress") for m in LAW), ("plasticine", "full"), ("water", "positions")],
)
def test_answers_do_not_depend_on_the_true_values(
    data, tmp_path, monkeypatch, capsys, material, observe
):
    heard, files = [], []
    for folder in (Path(FOLDER), data):
        out = tmp_path / f"{len(heard)}.yaml"
        monkeypatch.chdir(folder)
        options = ["--law", LAW[material], "--observe", observe, "--out", out]
        heard.append(spoken(capsys, "identify", f"train_{material}.npz", *options))
        files.append(out.read_bytes())
    assert heard[0] == heard[1]
    assert files[0] == files[1]


def test_predictions_do_not_depend_on_the_true_values(data, tmp_path, monkeypatch, capsys):
    material = tmp_path / "jelly.yaml"
    Material(LAWS["fixed-corotated"], TRUTH["jelly"]).write(material)
    heard = []
    for folder in (Path(FOLDER), data):
        monkeypatch.chdir(folder)
        options = ["--out", tmp_path / f"{len(heard)}.h5"]
        heard.append(spoken(capsys, "predict", material, "eval_velocity1_jelly.npz", *options))
    assert heard[0] == heard[1]
