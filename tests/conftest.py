"""One linear-algebra thread in each of the parallel workers; set before numpy is imported."""

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from matplotlib.image import imread

from form_drake import LAWS, Material, Recording, Solver, Wall
from form_drake.records import States, write_recording
from helpers.commands import TRUTH

STEPS = Path(__file__).parent / "data" / "steps" / "fixed-corotated.npz"
SETTINGS = ("x", "v", "C", "F", "L", "tau", "step")

WATCH = (
    "<script>window.errors = []; window.onerror = m => errors.push(m);"
    "console.error = (...a) => errors.push(a.join(' '));</script>"
)
FLAGS = (
    "--no-sandbox --headless=new --disable-dev-shm-usage --use-angle=swiftshader"
    " --enable-unsafe-swiftshader --hide-scrollbars --window-size=800,600"
    " --virtual-time-budget=4000 --enable-logging=stderr"
)

LONGEST = (  # begun first, so that no worker is left with one of them at the end
    "test_diagnose",
    "test_small_cases",
    "test_weak",
    "test_scores",
    "test_demo",
    "05_from_pictures",
    "test_interior",
    "04_find_the_missing_effect",
    "test_effects",
    "test_nclaw",
    "test_rubber",
    "test_sight",
    "03_station_and_your_own_plant",
    "test_columns",
    "test_twin",
    "test_station",
    "test_pictures",
    "test_docs",
    "test_hidden_demo",
    "01_identify_and_predict",
)


def pytest_collection_modifyitems(items):
    """The files that take longest come first."""
    place = {name: n for n, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(LONGEST)))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a recording of full states, one of positions, and a material."""
    folder = tmp_path_factory.mktemp("files")
    with np.load(STEPS) as file:
        data = dict(file)
    nodes, dx, cells = int(data["nodes"]), float(data["dx"]), int(data["wall_cells"])
    ends = ((-1, (cells - 1) * dx), (1, (nodes - cells + 1) * dx))
    walls = tuple(Wall(axis, side, at) for axis in range(3) for side, at in ends)
    dt, gravity = float(data["dt"]), tuple(data["gravity"])
    solver = Solver(
        dx=dx,
        nodes=(nodes,) * 3,
        dt=dt,
        gradient=str(data["gradient"]),
        precision="float64",
        walls=walls,
        mass_eps=float(data["mass_eps"]),
        gravity=gravity,
    )
    steps = Recording.from_arrays(
        data["step"] * dt,
        data["x"],
        step=data["step"],
        v_0=data["v0"],
        volume=data["volume"],
        density=float(data["density"]),
        solver=solver,
        law="fixed-corotated",
        states=States(**{k: data[k] for k in SETTINGS}),
    )
    write_recording(steps, folder / "steps.h5")
    write_recording(replace(steps, law=None), folder / "lawless.h5")
    write_recording(replace(steps, states=None), folder / "positions.h5")
    write_recording(replace(steps, v_0=None), folder / "unknown-motion.h5")
    Material(LAWS["fixed-corotated"], TRUTH, 1000.0).write(folder / "true.yaml")
    text = (folder / "steps.h5").read_bytes()
    (folder / "truncated.h5").write_bytes(text[: len(text) // 2])
    for suffix in ("h5", "npz", "yaml"):
        (folder / f"empty.{suffix}").write_bytes(b"")
        (folder / f"garbage.{suffix}").write_bytes(b"\x00\xff garbage" * 99)
        (folder / f"folder.{suffix}").mkdir()
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def played(tmp_path):
    """(page, seconds, count, tree) -> what a browser says of a page that was moved to a time, and its picture.

    ``count`` frames hang in the scene tree at ``tree``, a JavaScript expression. Of the answer,
    ``errors`` are those of the console, ``seen`` the frames that are visible, ``now`` the text of the
    clock; the picture has the shape [rows, columns, 3].
    """
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        missing = pytest.fail if os.environ.get("CI") else pytest.skip
        missing("no chromium: apt-get install chromium")

    def play(page, seconds, count, tree):
        look = (
            f"<script>setTimeout(() => {{ viewer.animator.pause(); viewer.animator.seek({seconds});"
            " viewer.render(); tellTime(); }, 1500); setTimeout(() => { tellTime(); const seen ="
            f" [...Array({count}).keys()].filter(k => viewer.scene_tree.find([...{tree}, '' + k])"
            ".object.visible); console.log('SEEN' + JSON.stringify({errors, seen,"
            " now: document.getElementById('now').textContent})); }, 2500);</script>"
        )
        text = page.read_text().replace("<head>", f"<head>{WATCH}", 1)
        watched = tmp_path / "watched.html"
        watched.write_text(text.replace("</body>", f"{look}</body>"))
        shot = tmp_path / "page.png"
        command = [browser, *FLAGS.split(), f"--user-data-dir={tmp_path / 'profile'}"]
        command += [f"--screenshot={shot}", watched.as_uri()]
        told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=100)
        found = json.loads(re.search(r'"SEEN(\{.*\})", source', told.stderr).group(1))
        return found, imread(shot)[..., :3]

    return play
