"""Commands in this process and in fresh ones."""

import subprocess
import sys

from form_drake import __main__

TRUTH = {"mu": 3766.1438712154586, "lam": 24571.85343589163}


def run(capsys, *arguments):
    """Exit code, standard output and standard error of one command in this process."""
    capsys.readouterr()
    try:
        code = __main__.main([str(a) for a in arguments])
    except SystemExit as stop:
        code = stop.code
    text = capsys.readouterr()
    return code, text.out, text.err


def refusal(capsys, *arguments):
    """The one line on standard error of a command that is refused."""
    code, out, err = run(capsys, *arguments)
    assert code == 2 and out == "", (code, out, err)
    assert err.startswith("form-drake: ") and err.count("\n") == 1, err
    assert "Traceback" not in err and len(err) < 700
    return err


BLOCKED = """
import sys
from pathlib import Path

ABSENT = sys.argv.pop(1).split(",")

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ABSENT:
            raise ImportError(f"{name} is blocked")

events = []

def heard(event, values):
    if event in ("open", "os.rename"):
        path = Path(str(values[event == "os.rename"]))
        if path.name in ("truth.json", "material.yaml", "identification.json"):
            events.append(f"{event} {path.name}")

sys.addaudithook(heard)
sys.meta_path.insert(0, Blocker())
from form_drake.__main__ import main
code = main(sys.argv[1:])
print("events:", ", ".join(events), file=sys.stderr)
sys.exit(code)
"""


CAMERAS = "open3d,cv2,pyrealsense2"


def blocked(folder, *arguments, absent=CAMERAS + ",pydrake"):
    """A command in a fresh process that cannot import Drake and the camera packages.

    It also tells in which order files of the demo appear and are opened.
    """
    return process(folder, "-c", BLOCKED, absent, *map(str, arguments))


def process(folder, *arguments):
    """Python in a fresh process."""
    command = [sys.executable, *arguments]
    options = {"capture_output": True, "text": True, "timeout": 300}
    return subprocess.run(command, cwd=folder, check=False, **options)
