"""How every command speaks: tables or one JSON object on standard output, the rest on standard error."""

import json
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import tyro

from form_drake.files import plain, target

Assignments = Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")]
Changes = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="PATH=VALUE")]

TIDIES = 10.0  # [s] that a process has to end in when it is interrupted


def emit(text: str, value: dict[str, Any], *, as_json: bool) -> None:
    """Print the table, or the JSON object instead."""
    print(json.dumps(plain(value), allow_nan=False) if as_json else text, flush=True)


def say(text: str) -> None:
    """A message to the person, not part of the answer."""
    print(text, file=sys.stderr, flush=True)


def run_in(folder: Path, *words: str) -> None:
    """Run a command of this program in a folder, in a process of its own.

    Raises:
        ValueError: what it says, where it fails.
        KeyboardInterrupt: which it is told once, with time to tidy up.
    """
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "form_drake", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # else a terminal would tell it as well
    ) as child:
        try:
            told = child.communicate()[1]
        except KeyboardInterrupt:
            child.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                child.wait(TIDIES)
            child.kill()
            raise
    if child.returncode:
        raise ValueError(f"{words[0]}: {(told.strip() or 'failed').splitlines()[-1]}")
    for line in told.splitlines():
        if not line.startswith(("Warp", "written")):
            say(line)


def device(name: str) -> None:
    """Check that Warp has a device of this name.

    Raises:
        ValueError: it has none; the message says which there are.
    """
    import warp as wp

    try:
        if name == "cuda" and not wp.get_cuda_device_count():  # Warp would print why
            raise ValueError
        wp.get_device(name)
    except (RuntimeError, ValueError):
        names = ", ".join(d.alias for d in wp.get_devices())
        raise ValueError(
            f"--device {name}: no such device here, only {names}; CUDA needs an NVIDIA GPU and its"
            " driver"
        ) from None


def out_file(path: Path, *endings: str, option: str = "--out") -> Path:
    """``path``, if a file with one of the endings can be put there; to be asked before long work.

    Raises:
        ValueError: it cannot, or the path ends otherwise.
    """
    if target(path).suffix not in endings:
        raise ValueError(f"{option} {path}: a name that ends in {' or '.join(endings)} is wanted")
    return path


def assignments(text: str) -> dict[str, str]:
    """A ``NAME=VALUE,NAME=VALUE`` text as a mapping.

    Raises:
        ValueError: a part without a name, a value or an equals sign, or a name twice.
    """
    found: dict[str, str] = {}
    for part in text.split(","):
        if not part.strip():
            continue
        name, equals, value = (p.strip() for p in part.partition("="))
        if not name or not equals or not value:
            raise ValueError(f"{part.strip()!r}: NAME=VALUE is wanted")
        if name in found:
            raise ValueError(f"{name} is given twice")
        found[name] = value
    return found
