"""One linear-algebra thread in each of the parallel workers; set before numpy is imported."""

import json
import os
import re
import shutil
import subprocess

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from matplotlib.image import imread

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
    "test_commands",
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
