"""Long benches as named cases: each is saved when finished, so that a bench can be resumed."""

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tqdm import tqdm

from form_drake.bench.oracles import ORACLES
from form_drake.files import plain, write_json

PACKAGE = Path(__file__).resolve().parents[1]
LINKED = ("systems", "models")  # of it, in a checkout
READ = ("*.py", "*.json", "*.yaml", "*.sdf", "*.urdf", "*.xml")


def fingerprint(*inputs: Path) -> str:
    """Digest of the package, the oracles, what both compute with, and input files.

    A saved case counts only with it.
    """
    digest = hashlib.sha256()
    for name in ("drake", "warp-lang", "numpy", "scipy", "h5py", "opencv-python-headless"):
        digest.update(f"{name} {version(name)}\n".encode())
    for folder in (PACKAGE, *((PACKAGE / name).resolve() for name in LINKED), ORACLES):
        for source in sorted(path for kind in READ for path in folder.rglob(kind)):
            digest.update(f"{source.relative_to(folder)}\n".encode() + source.read_bytes())
    for path in sorted(inputs):
        digest.update(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}".encode())
    return digest.hexdigest()[:16]


def run_cases(
    cases: Mapping[str, Callable[[], dict[str, Any]]],
    *,
    store: Path,
    mark: str,
    estimates: Mapping[str, float],
    only: tuple[str, ...] = (),
) -> dict[str, dict[str, Any]]:
    """Run named cases, reading those that an earlier, interrupted bench finished.

    Args:
        cases: name -> function that returns a JSON-like result.
        store: folder of one JSON file per finished case.
        mark: fingerprint of code and inputs.
        estimates: name -> expected seconds.
        only: parts of names; cases that contain none of them are left out. Empty: all.

    Raises:
        ValueError: ``only`` leaves nothing.
    """
    names = chosen(cases, only)
    results: dict[str, dict[str, Any]] = {}
    for name in names:
        saved = _saved(store / f"{name.replace('/', '_')}.json", mark)
        if saved is not None:
            results[name] = saved
    left = [n for n in names if n not in results]
    minutes = sum(estimates.get(n, 10.0) for n in left) / 60.0
    tqdm.write(
        f"{len(left)} of {len(names)} cases to run, about {minutes:.1f} min; kept in {store} (without it all are"
        " run again)",
        file=sys.stderr,
    )
    for name in tqdm(left, unit="case", disable=None, leave=False):
        started = time.perf_counter()
        result = plain(cases[name]())
        result["case_seconds"] = time.perf_counter() - started
        write_json(store / f"{name.replace('/', '_')}.json", {"mark": mark, "result": result})
        results[name] = result
    return {n: results[n] for n in names}


def chosen(names: Iterable[str], only: Sequence[str]) -> list[str]:
    """Names that contain one of ``only``; of none, all.

    Raises:
        ValueError: no name does.
    """
    every = list(names)
    found = [n for n in every if not only or any(o in n for o in only)]
    if not found:
        parts = sorted({part for name in every for part in name.split("/")})
        raise ValueError(f"--only {','.join(only)}: no case has it; they are made of {parts}")
    return found


def _saved(path: Path, mark: str) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError):
        return None
    return content["result"] if content.get("mark") == mark else None
