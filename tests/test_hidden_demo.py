"""The demo of a diagnosis, on a smaller block with a few effects."""

import json

import numpy as np
import pytest

from form_drake import hidden_demo
from form_drake.__main__ import main
from form_drake.diagnose.hidden import SIZES, Hidden
from form_drake.diagnose.motions import Block
from form_drake.effects import CATALOGUE
from form_drake.material import read_material
from form_drake.records import read


def test_what_is_hidden_is_drawn_from_the_seed():
    block = Block()
    for name in CATALOGUE:
        drawn, again = (Hidden.drawn(block, name, np.random.default_rng(1)) for _ in range(2))
        assert drawn.to_json() == again.to_json()
        assert drawn.to_json() != Hidden.drawn(block, name, np.random.default_rng(2)).to_json()
        shear, K = 2.0 * drawn.values["C10"], drawn.values["kappa"]
        E = 9.0 * K * shear / (3.0 * K + shear)
        low, high, unit = SIZES[name]
        by = {"": 1.0, "E": E, "1/E": 1.0 / E, "force": E * 0.036 * 0.034 * 0.075}[unit]
        assert low * (1.0 - 1e-9) <= drawn.cause.coefficient / by <= high * (1.0 + 1e-9)
        assert set(drawn.cause.shape) == set(drawn.cause.effect.shapes)
    plates = {Hidden.drawn(block, "drag", np.random.default_rng(n)).plate for n in range(9)}
    assert plates == {"bonded", "frictionless"}


def test_a_plate_that_sticks_is_lifted_off():
    hidden = Hidden.drawn(Block(), "adhesion", np.random.default_rng(0))
    assert hidden.plate == "frictionless"
    assert hidden.press().poses["plate"].value[-1, 2, 3] > 0.030
    assert Block().press("frictionless").poses["plate"].value[-1, 2, 3] < 0.030


@pytest.fixture
def small(monkeypatch):
    """A smaller block that is pressed faster, and fewer effects."""
    few = ("force-delay", "density", "drag")
    monkeypatch.setattr(hidden_demo, "BLOCK", Block(size=(0.02, 0.02, 0.02), points=100))
    monkeypatch.setattr(hidden_demo, "DX", 0.004)
    monkeypatch.setattr(hidden_demo, "PRESSING", 0.6)
    monkeypatch.setattr(hidden_demo, "SHAKING", 0.4)
    monkeypatch.setattr(hidden_demo, "UNSEEN", {"seconds": 0.5, "depth": 0.09, "beat": 6.0})
    monkeypatch.setattr(hidden_demo, "NAMES", ("force-delay",))
    monkeypatch.setattr(hidden_demo, "CATALOGUE", {name: CATALOGUE[name] for name in few})


def test_the_demo_finds_what_it_has_hidden(small, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--hidden", "--seed", "3", "--json"]) == 0
    said = capsys.readouterr()
    answer, folder = json.loads(said.out), tmp_path / "runs" / "demo"
    truth = json.loads((folder / "truth.json").read_text())
    hidden = truth["effect"]
    assert answer["verdict"] == "named" and hidden["name"] == "force-delay"
    assert hidden == answer["truth"]["effect"]
    (effect,) = answer["effects"]
    assert effect["name"] == hidden["name"]
    assert effect["coefficient"] == pytest.approx(hidden["coefficient"], rel=0.1)
    (force,) = [g for g in answer["gap"] if g["channel"].startswith("force")]
    assert force["after"] < 0.5 * force["before"]
    page = (folder / "report.html").read_text()
    assert "What was hidden" in page and f"{hidden['coefficient']:.4g}" in page
    assert (folder / "before_after.html").exists()
    assert read_material(folder / "material.yaml").effects[0].id == hidden["name"]
    assert read(folder / "unseen.h5").points == 100
    assert said.err.index("3/3") > said.err.index("2/3")


def test_a_scenario_cannot_be_changed_where_none_is_simulated(capsys):
    assert main(["demo", "--hidden", "--set", "solver.dx=0.01"]) == 2
    assert "--set: --hidden simulates no scenario" in capsys.readouterr().err
