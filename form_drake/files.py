"""Files that appear whole or not at all, and checks of files that come from elsewhere."""

import json
import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

LARGEST_TEXT = 4_000_000
MARK = ".form-drake"


class PlainLoader(yaml.SafeLoader):
    """The safe loader, without aliases, a few of which can stand for gigabytes, and without repeated keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node that is no alias."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not read")
        return super().compose_node(parent, index)

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """What a node stands for, if it is of the kind that its tag says."""
        try:
            return super().construct_object(node, deep)
        except (AttributeError, LookupError, TypeError, ValueError):
            line, value = node.start_mark.line + 1, str(node.value)[:60]
            kind = node.tag.rpartition(":")[2]
            raise yaml.YAMLError(f"line {line}: {value!r} is no {kind}") from None

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """A mapping in which every key stands once."""
        found = super().construct_mapping(node, deep)
        if len(found) < len(node.value):
            keys = Counter(self.construct_object(key) for key, _ in node.value)
            key = str(keys.most_common(1)[0][0])[:60]
            line = node.start_mark.line + 1
            raise yaml.YAMLError(
                f"{key} is given twice in the entries from line {line} on: keep one"
            )
        return found


# 63e3 and 1e-4, which YAML 1.1 takes for words
PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object in which every key stands once, see ``json.loads``.

    Raises:
        ValueError: one stands twice.
    """
    found = dict(pairs)
    if len(found) < len(pairs):
        key = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"{key[:60]} is given twice: keep one")
    return found


def target(path: Path) -> Path:
    """``path``, if a file can be put there; to be asked before long work.

    Raises:
        ValueError: it is a folder, or lies in something that is not a folder or is closed to us.
    """
    if path.is_dir():
        raise ValueError(f"{path}: is a folder; a file is wanted")
    _open_parent(path)
    return path


def target_folder(path: Path) -> Path:
    """``path``, if a folder can be put there or replaced; to be asked before long work.

    Raises:
        ValueError: it is a file, lies where nothing can be written, or holds files that no earlier
            run has made.
    """
    if path.exists() and not path.is_dir():
        raise ValueError(f"{path} is a file; a folder is wanted: choose another --out")
    if path.is_dir() and (foreign := _foreign(path)):
        raise ValueError(
            f"{path} holds files that no earlier run has made ({foreign[0]}); it is replaced as a whole: remove"
            " them or choose another --out"
        )
    _open_parent(path.resolve())
    return path


def spare(out: Path, *inputs: Path | None) -> None:
    """Refuse an output that would take the place of what is read.

    Raises:
        ValueError: an input is the output, or lies in it.
    """
    place = out.resolve()
    for one in (path for path in inputs if path is not None):
        if place in (one.resolve(), *one.resolve().parents):
            raise ValueError(
                f"{out} would take the place of {one}, which is read: choose another --out"
            )


def _open_parent(path: Path) -> None:
    parent = next(p for p in path.absolute().parents if p.exists())
    if not parent.is_dir():
        raise ValueError(f"{path}: {parent} is not a folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise ValueError(f"{path}: {parent} is not writable")


def _foreign(folder: Path) -> list[str]:
    """Files of a folder that the run which made it has not; one that does not tell has made all."""
    mark = folder / MARK
    if not mark.is_file():
        return _held(folder)
    made = mark.read_text(encoding="utf-8", errors="replace").splitlines()[1:]
    return [name for name in _held(folder) if name not in made] if made else []


def _held(folder: Path) -> list[str]:
    files = (path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")))
    return [name for name in files if (folder / name).is_file() and name != MARK]


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block succeeds."""
    target(path).parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A temporary folder beside ``path`` that replaces it, as a whole, when the block succeeds."""
    path = target_folder(path).resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    temporary.chmod(0o755)
    old = temporary.with_name(temporary.name + ".old")
    try:
        yield temporary
        told = [version("form-drake"), *_held(temporary)]
        (temporary / MARK).write_text("".join(f"{line}\n" for line in told), encoding="utf-8")
        try:
            if path.exists():
                path.rename(old)
            temporary.rename(path)
        except BaseException:  # an interrupt between the two as well
            if old.exists() and not path.exists():
                old.rename(path)
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def joined(folder: Path, *names: str) -> None:
    """Count files that are written into a folder of ``whole_folder`` later to those of its run."""
    with (folder / MARK).open("a", encoding="utf-8") as mark:
        mark.writelines(f"{name}\n" for name in names)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def plain(value: Any) -> Any:
    """``value`` with numpy numbers, arrays and paths turned into plain JSON values."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    return value


def write_json(path: Path, value: dict[str, Any]) -> None:
    """Write a JSON object whole, with this package's version; it must hold finite numbers only."""
    content = {"form_drake": version("form-drake"), **value}
    write_text(path, json.dumps(plain(content), indent=2, allow_nan=False) + "\n")


@contextmanager
def about(name: object) -> Iterator[None]:
    """Say of what a mistake is."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def existing(path: Path) -> Path:
    """``path``, if it is a file that is not empty.

    Raises:
        ValueError: it is missing, a folder, or empty.
    """
    if not path.exists():
        raise ValueError(f"{path}: no such file")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder; a file in it is wanted")
    if not path.is_file():
        raise ValueError(f"{path}: not a file")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    return path


def read_text(path: Path) -> str:
    """Text of a small file.

    Raises:
        ValueError: missing, empty, larger than 4 MB or not UTF-8.
    """
    if existing(path).stat().st_size > LARGEST_TEXT:
        raise ValueError(f"{path}: larger than {LARGEST_TEXT // 1_000_000} MB, not read")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        hint = f"not a text file ({error.reason})"
        if path.suffix in (".h5", ".hdf5", ".npz"):
            hint += ": it seems a recording, where a text (YAML, JSON, Python) is wanted"
        raise ValueError(f"{path}: {hint}") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def read_mapping(path: Path) -> dict[str, Any]:
    """A JSON or YAML file that holds a mapping, read by the safe loaders.

    Raises:
        ValueError: it cannot be read, or does not hold a mapping.
    """
    text = read_text(path)
    try:
        value = (
            json.loads(text, object_pairs_hook=once)
            if path.suffix == ".json"
            else yaml.load(text, PlainLoader)
        )
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        first = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: not valid {path.suffix[1:] or 'YAML'} ({first})") from None
    if not isinstance(value, dict):
        raise ValueError(
            f"{path}: a mapping of names to values is wanted, got {type(value).__name__}"
        )
    return value
