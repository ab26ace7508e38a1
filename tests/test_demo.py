"""The demo without camera packages: its answer, its report, and when it opens the truth."""

import json
import re

import pytest

from form_drake import read, read_material
from helpers.commands import CAMERAS, blocked, refusal, run


def test_the_demo_replaces_no_foreign_folder(capsys, here):
    (here / "mine").mkdir()
    (here / "mine" / "thesis.tex").write_text("years")
    assert "no earlier run has made" in refusal(capsys, "demo", "--out", "mine")
    assert [p.name for p in (here / "mine").iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("measure.noise=0", "--set measure.noise=0: the demo sets it by itself"),
        ("specimen.material.E=5e4", "the demo sets it by itself"),
        ("specimen.known=[]", "specimen.known: nu is wanted among it"),
        ("probe.unseen=[]", "has no probe.unseen"),
    ],
)
def test_changes_that_the_demo_cannot_take_are_refused_at_once(capsys, here, told, said):
    code, _, err = run(capsys, "demo", "--seed", "1", "--set", told)
    seed, line = err.splitlines()
    assert (code, seed) == (2, "seed 1") and line.startswith("form-drake: ") and said in line
    assert not (here / "runs" / "demo").exists()


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """One coarse run of the demo without camera packages."""
    folder = tmp_path_factory.mktemp("demo")
    coarse = (
        "--set",
        "solver.dx=0.004",
        "--set",
        "solver.mass_scale=40",
        "--set",
        "measure.points=150",
    )
    done = blocked(folder, "demo", "--seed", "11", "--json", *coarse, absent=CAMERAS)
    assert done.returncode == 0, done.stderr
    return folder / "runs" / "demo", done


def test_the_demo_identifies_its_hidden_material(demo):
    folder, done = demo
    answer = json.loads(done.stdout)
    assert answer["seed"] == 11 and "seed 11" in done.stderr
    found = answer["identification"]["parameters"]
    truth = json.loads((folder / "truth.json").read_text())
    assert set(truth["values"]) == {"mu", "lam", "tau_y"}
    for key in ("mu", "tau_y"):
        assert found[key]["value"] == pytest.approx(truth["values"][key], rel=0.05)
    before, after = answer["before"], answer["after"]
    assert abs(after["peak_error"]) < 0.1 and after["shape_rms"] < 0.5 * before["shape_rms"]
    assert after["force_rms"] < 0.2 * before["force_rms"]
    assert read_material(folder / "material.yaml").values["mu"] == found["mu"]["value"]


def test_the_demo_shows_a_report(demo):
    folder, _ = demo
    page = (folder / "report.html").read_text()
    assert page.count("<img") >= 4 and "first guess" in page and "identified" in page
    assert "a block of 30 x 30 x 25 mm" in page and "Measured are 150 points" in page
    assert not re.search(r"(src|href)=\"(?!data:)", page)  # the page stands alone
    assert (folder / "station.html").stat().st_size < 15e6
    assert {p.name for p in folder.parent.iterdir()} == {"demo"}


def test_the_demo_opens_the_truth_after_the_answer_is_on_disk(demo):
    folder, done = demo
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("events:")]
    assert line.removeprefix("events: ").split(", ") == [
        "os.rename truth.json",
        "os.rename material.yaml",
        "os.rename identification.json",
        "open material.yaml",
        "open truth.json",
    ]
    recording = read(folder / "recording.h5")
    assert recording.known == {"nu": 0.3} and recording.v_0 is None
    for name in ("scenario.yaml", "identification.json"):
        assert (
            str(json.loads((folder / "truth.json").read_text())["values"]["tau_y"])
            not in (folder / name).read_text()
        )
