"""Cases of a blind bench: folders that others recorded, or what is made again from seeds."""

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from form_drake.bench.oracles import recorded, run
from form_drake.diagnose.admitted import require_all_stated, require_one_specimen
from form_drake.files import about, read_mapping, read_text
from form_drake.identify.stated import declared_law
from form_drake.laws import Law
from form_drake.records import Recording, read

PROBES = ("press", "shake", "heldout")
READ = PROBES[:2]  # of them, in a diagnosis

Case = Callable[[], "Specimens"]
Probes = Literal["all", "press", "faces"]


@dataclass(frozen=True)
class Specimens:
    """What was recorded of a case.

    Attributes:
        by_probe: recordings by the name of the probe.
        draw: how often its coefficients were drawn anew, since what was drawn before cannot be simulated.
    """

    by_probe: dict[str, Recording]
    draw: int = 0

    def chosen(self, probes: Probes = "all") -> tuple[list[Recording], list[Recording], Law]:
        """What is read, what is held back, and the declared law.

        Raises:
            ValueError: it is nothing that ``form-drake diagnose`` takes.
        """
        names = {"all": PROBES, "press": ("press", "heldout"), "faces": READ}[probes]
        felt = []
        for name in (n for n in names if n in self.by_probe):
            with about(name):
                felt.append((name, self.by_probe[name].measured_by("sensor")))
        read = sum(name in READ for name, _ in felt)
        law = declared_law(felt[0][1], None)
        require_one_specimen(felt)
        require_all_stated(felt, 0 if probes == "faces" else read)  # faces are compared, not read
        every = [recording for _, recording in felt]
        return every[:read], every[read:], law


def cases_of(path: Path, *, faces: bool = False) -> dict[str, Case]:
    """Cases by id: of a folder of folders, or of a list of seeds from which they are made again.

    Args:
        path: of either.
        faces: whether those that are made again have points on two sides alone.

    Raises:
        ValueError: there are none, the folder holds a key, or a case has no press.
    """
    if path.is_file():
        return {one["id"]: lambda one=one: _made(one, faces=faces) for one in _listed(path)}
    if not path.is_dir():
        raise ValueError(f"{path}: no such folder, nor a list of cases")
    secrets = [p.name for p in path.rglob("*") if p.is_file() and _secret(p)]
    if secrets:
        raise ValueError(f"{path}: holds {secrets[0]}; the truth must lie elsewhere")
    found = sorted({p.parent for name in PROBES for p in path.glob(f"*/{name}.h5")})
    if not found:
        raise ValueError(f"{path}: no case there; a case is a folder with press.h5")
    for folder in found:
        if not (folder / "press.h5").is_file():
            raise ValueError(f"{folder}: no press.h5 is in it, which every case has")
    return {folder.name: lambda folder=folder: _kept(folder) for folder in found}


def _secret(path: Path) -> bool:
    """Whether a file may hold the truth, by its name; a seal does not."""
    return path.suffix != ".sha256" and any(w in path.name.lower() for w in ("key", "truth"))


def _listed(path: Path) -> list[dict[str, Any]]:
    try:
        listed = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: no list of cases: {error}") from None
    wanted = {"id": str, "seed": int, "kind": str}
    for one in listed if isinstance(listed, list) else [None]:
        if not isinstance(one, dict) or {k: type(v) for k, v in one.items()} != wanted:
            raise ValueError(f"{path}: no list of cases; each has id, seed and kind, and no more")
        if not one["id"].isalnum():
            raise ValueError(f"{path}: case {one['id']!r}: letters and digits are wanted")
    twice = [n for n, count in Counter(one["id"] for one in listed).items() if count > 1]
    if twice:
        raise ValueError(f"{path}: case {twice[0]} is listed twice or more")
    return list(listed)


def _kept(folder: Path) -> Specimens:
    paths = {name: folder / f"{name}.h5" for name in PROBES}
    return Specimens({name: read(path) for name, path in paths.items() if path.is_file()})


def _made(one: Mapping[str, Any], *, faces: bool) -> Specimens:
    with TemporaryDirectory() as name:
        key, out = Path(name) / "key.json", Path(name) / "cases"
        words = ["--seed", str(one["seed"]), "--kind", one["kind"], "--noisy"]
        words += ["--faces"] if faces else []
        run("hidden_effects.py", *words, "--out", out, "--key", key)
        draw = int(read_mapping(key)[one["id"]]["draw"])  # the rest of the truth is nobody's here
        return Specimens({probe: recorded(out / one["id"] / probe) for probe in PROBES}, draw)
