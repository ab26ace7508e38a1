"""Documentation against the code: made pages are up to date, examples run, links and lists hold."""

import json
import re
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest

import make
from form_drake import LAWS, read_material, write_recording
from form_drake.bench.truth import MATERIALS
from form_drake.effects import CATALOGUE, load
from form_drake.systems.probe import prepare, record
from form_drake.systems.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
MATERIAL_FILES = sorted((ROOT / "models" / "materials").glob("*.yaml"))


def name(path):
    return path.name


def python_blocks(page):
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)


def test_made_pages_are_up_to_date():
    stale = [path.name for path, text in make.pages().items() if path.read_text() != text]
    assert not stale, "run: python docs/make.py"


def test_benchmarks_are_rendered_from_results():
    page = (ROOT / "docs" / "benchmarks.md").read_text()
    result = {"bench": "positions", "materials": {m: {"seeds": 12345} for m in MATERIALS}}
    once = make.with_benchmarks(page, [result])
    assert once.count("12345") == len(MATERIALS)
    assert make.with_benchmarks(once, [result]) == once
    with pytest.raises(ValueError, match="known are"):
        make.with_benchmarks(page, [{"bench": "other"}])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder that looks like the repository after a (coarse) demo; E of its material."""
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("press_a", ("solver.dx=0.005", "solver.mass_scale=40"))
    write_recording(record(prepare(scenario)), Path("runs/demo/recording.h5"))
    return scenario.specimen.material["E"]


def test_examples_of_the_readme(folder):
    first, own = python_blocks(ROOT / "README.md")
    found = {}
    exec(first, found)
    E = found["answer"].material.parameters()["E"].value
    assert E == pytest.approx(folder, rel=0.05)
    Path("buoyancy.py").write_text(own)
    assert list(load(Path("buoyancy.py"), CATALOGUE)) == ["buoyancy"]
    assert len(own.splitlines()) <= 20


@pytest.mark.parametrize("page", ["recording.md", "solver.md", "effects.md"])
def test_examples_of_the_pages(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = {}
    for block in python_blocks(ROOT / "docs" / page):
        exec(block, found)
    if "buoyancy" in found:  # the README has it too
        exec(python_blocks(ROOT / "README.md")[1], own := {})
        columns = [each["buoyancy"].column(found["reading"], {}) for each in (found, own)]
        assert np.array_equal(*columns) and np.any(columns[0])


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
        assert target.startswith("https://") or (page.parent / target).exists(), target


def test_readme_lists_every_law_and_stays_short():
    text = (ROOT / "README.md").read_text()
    for law in LAWS.values():
        keys = " ".join(law.sought)
        assert f"| `{law.name}` | `{keys}` |" in text
    assert len(text.splitlines()) <= 110


def test_every_file_has_an_origin():
    listed = re.findall(r"^\| `([^`]+)` \|", (ROOT / "docs" / "data.md").read_text(), re.MULTILINE)
    for top in ("models", "tests"):
        for path in (ROOT / top).rglob("*"):
            place = path.relative_to(ROOT).as_posix()
            if path.is_file() and "__pycache__" not in place:
                assert any(fnmatch(place, pattern) for pattern in listed), place
    for pattern in listed:
        assert list(ROOT.glob(pattern)), pattern


@pytest.mark.parametrize("path", MATERIAL_FILES, ids=name)
def test_materials_are_complete_and_say_their_source(path):
    assert path.read_text().startswith("# ")
    assert read_material(path).density > 0


@pytest.mark.parametrize("path", NOTEBOOKS, ids=name)
def test_notebooks_are_short_stripped_and_assert(path):
    cells = json.loads(path.read_text())["cells"]
    assert len(cells) <= 15
    assert not any(c.get("outputs") or c.get("execution_count") for c in cells)
    assert "assert" in "".join(cells[-1]["source"])


def test_readme_starts_with_two_commands_of_their_own():
    text = (ROOT / "README.md").read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert blocks == [
        "sh install.sh && .venv/bin/form-drake demo\n",
        "sh install.sh test && .venv/bin/python -m pytest\n",
    ]


def test_a_bench_of_three_grids_leaves_the_table_of_exact_tracks(monkeypatch):
    monkeypatch.setitem(make.TABLES, "probes", lambda result: "all")
    monkeypatch.setitem(make.TABLES, "probes-dx", lambda result: "grids")
    marks = "".join(
        f"<!-- docs/make.py: {name} -->\nold {name}\n<!-- docs/make.py: end -->\n"
        for name in ("probes", "probes-dx")
    )
    page = make.with_benchmarks(marks, [{"bench": "probes", "cases": {"dx/press_a/2.5": {}}}])
    assert "old probes\n" in page and "grids" in page and "old probes-dx" not in page
