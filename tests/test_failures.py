"""How commands fail: interrupts, memory, pipes, disks and devices, and what cannot be imported."""

import builtins
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import form_drake
from form_drake.libraries import DEBIAN
from helpers.commands import TRUTH, blocked, process, refusal, run


def test_an_interrupted_command_says_so(capsys, monkeypatch):
    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("form_drake.commands.inspect.List.run", interrupted)
    code, out, err = run(capsys, "list", "laws")
    assert (code, out) == (130, "") and err.startswith("form-drake: interrupted")


@pytest.mark.parametrize(
    "error, message",
    [
        (MemoryError(), "not enough memory\n"),
        (MemoryError("Unable to allocate 9 TiB"), "not enough memory: Unable to allocate 9 TiB"),
        (RuntimeError("Failed to allocate 8 bytes on device 'cpu'"), "not enough memory: Failed"),
        (RuntimeError("Warp CUDA error 2: out of memory"), "not enough memory: Warp"),
    ],
)
def test_too_little_memory_is_one_line(capsys, monkeypatch, error, message):
    def greedy(self):
        raise error

    monkeypatch.setattr("form_drake.commands.inspect.List.run", greedy)
    assert message in refusal(capsys, "list", "laws")


def test_other_failures_are_not_hidden(capsys, monkeypatch):
    def broken(self):
        raise RuntimeError("a mistake in the program")

    monkeypatch.setattr("form_drake.commands.inspect.List.run", broken)
    with pytest.raises(RuntimeError, match="a mistake"):
        run(capsys, "list", "laws")


@pytest.mark.parametrize("arguments", [("list", "laws"), ("--help",), ("--version",)])
def test_a_closed_pipe_is_silent(tmp_path, arguments):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "form_drake", *arguments]
    with open(writing, "w") as pipe:
        options = {"stdout": pipe, "stderr": subprocess.PIPE, "text": True, "timeout": 300}
        done = subprocess.run(command, cwd=tmp_path, check=False, **options)
    assert (done.returncode, done.stderr) == (141, "")


def test_closed_streams_are_silent(tmp_path):
    line = f"exec {sys.executable} -m form_drake --version <&- >&- 2>&-"
    done = subprocess.run(["sh", "-c", line], cwd=tmp_path, check=False, timeout=300)
    assert done.returncode == 0


def test_a_full_disk_leaves_nothing(capsys, files, here, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    line = refusal(capsys, "identify", files / "steps.h5", "--out", "a.yaml")
    assert "No space left" in line and not list(here.iterdir())


@pytest.mark.parametrize("device", ["cuda:99", "cuda"])
def test_a_missing_device_is_one_line(capfd, files, here, monkeypatch, device):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: 0)
    for words in (("predict", files / "true.yaml", files / "steps.h5"), ("bench", "speed")):
        line = refusal(capfd, *words, "--device", device)
        assert f"{device}: no such device here, only cpu" in line
    assert not list(here.iterdir())


def test_a_device_that_is_set_in_a_scenario_is_asked_for(capfd, here):
    words = ("simulate", "press_a", "--set", "solver.device=cuda:99", "--out", here / "runs")
    assert "cuda:99: no such device here" in refusal(capfd, *words)


MISSING = "{}: cannot open shared object file: No such file or directory"


@pytest.mark.parametrize("library", DEBIAN)
@pytest.mark.parametrize("kind", [ImportError, OSError])
def test_a_missing_system_library_names_its_package(capsys, monkeypatch, kind, library):
    original = builtins.__import__

    def hindered(name, *rest):
        if name == "pyrealsense2":
            raise kind(MISSING.format(library))
        return original(name, *rest)

    def needs_a_camera(self):
        import pyrealsense2  # noqa: F401

    monkeypatch.setattr(builtins, "__import__", hindered)
    monkeypatch.setattr("form_drake.commands.inspect.List.run", needs_a_camera)
    line = refusal(capsys, "list", "laws")
    assert f"{library} is missing" in line and f"apt-get install {DEBIAN[library]}" in line


def test_a_missing_module_is_named(capsys, monkeypatch):
    def needs_a_module(self):
        import a_module_that_is_not_there.part  # noqa: F401

    monkeypatch.setattr("form_drake.commands.inspect.List.run", needs_a_module)
    line = refusal(capsys, "list", "laws")
    assert "Python package a_module_that_is_not_there is missing" in line


HINDERED = """
import builtins
import sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            raise getattr(builtins, sys.argv[2])(f"No module named {name!r}", **NAMED)

NAMED = {"name": sys.argv[1]} if sys.argv[2] == "ModuleNotFoundError" else {}
sys.meta_path.insert(0, Finder())
from form_drake.__main__ import main
sys.exit(main(["list", "laws"]))
"""


@pytest.mark.parametrize(
    "module, package",
    [("h5py", "h5py"), ("tqdm", "tqdm"), ("tyro", "tyro"), ("warp", "warp-lang"),
     ("yaml", "pyyaml"), ("numpy", "numpy")],
)  # fmt: skip
def test_a_missing_dependency_is_one_line(tmp_path, module, package):
    done = process(tmp_path, "-c", HINDERED, module, "ModuleNotFoundError")
    line = f"form-drake: the Python package {package} is missing; reinstall form-drake with its"
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"{line} dependencies\n"


ENDED = """
import os
import signal
import sys
from form_drake.__main__ import main
from form_drake.commands.inspect import List
List.run = lambda self: os.kill(os.getpid(), signal.SIGTERM)
sys.exit(main())
"""


def test_a_command_that_is_told_to_end_tidies_up(tmp_path):
    done = process(tmp_path, "-c", ENDED, "list", "laws")
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "form-drake: interrupted; nothing half-written was left\n"


def test_an_interrupt_while_importing_is_one_line(tmp_path):
    done = process(tmp_path, "-c", HINDERED, "warp", "KeyboardInterrupt")
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "form-drake: interrupted; nothing half-written was left\n"


PUBLIC = """
import sys
import form_drake
assert not {"numpy", "warp", "yaml"} & set(sys.modules), "imported too early"
import form_drake.identify.solve
from form_drake import *
for name in form_drake.__all__:
    assert globals()[name] is getattr(form_drake, name)
assert callable(identify) and callable(form_drake.identify)
"""


def test_public_names_are_imported_when_used(tmp_path):
    done = process(tmp_path, "-c", PUBLIC)
    assert done.returncode == 0, done.stderr
    assert set(form_drake.__all__) == set(form_drake.PLACES) <= set(dir(form_drake))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = form_drake.nonsense


def test_a_process_without_cameras_identifies_and_predicts(files, tmp_path):
    done = blocked(tmp_path, "identify", files / "steps.h5", "--json", "--out", "a.yaml")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    answer = json.loads(done.stdout)
    assert answer["parameters"]["mu"]["value"] == pytest.approx(TRUTH["mu"], rel=1e-9)
    done = blocked(tmp_path, "predict", "a.yaml", files / "steps.h5", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 2


def test_a_process_refuses_in_one_line(tmp_path):
    done = process(tmp_path, "-m", "form_drake", "identify", "missing.h5", "--json")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == ["form-drake: missing.h5: no such file"]
