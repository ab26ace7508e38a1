"""YAML files of scenarios: what they inherit, changes by path, and keys that there are."""

import dataclasses
import typing
from collections.abc import Mapping, Sequence
from importlib.abc import Traversable
from importlib.resources import files
from pathlib import Path
from types import UnionType
from typing import Any

import yaml

from form_drake.files import PlainLoader, read_mapping
from form_drake.laws.values import finite

DEEPEST = 8  # of inheritance


def shipped() -> Traversable:
    """The folder of the scenarios that come with the package."""
    return files("form_drake") / "models" / "scenarios"


def named() -> list[str]:
    """Scenarios of the package that can be run: those that others only inherit from are left out."""
    found = {Path(p.name).stem: p for p in shipped().iterdir() if p.name.endswith(".yaml")}
    contents = {name: yaml.safe_load(p.read_text()) for name, p in found.items() if "." not in name}
    parents = {c.get("inherits") for c in contents.values()}
    return sorted(set(contents) - parents)


def layered(name: str, changes: Sequence[str]) -> dict[str, Any]:
    """What a scenario holds with all that it inherits and the changes; see ``inherited`` and ``change``."""
    content = inherited(name, Path.cwd())
    for told in changes:
        change(content, told)
    return rooted(_merged({}, content), Path.cwd())


def inherited(name: str, folder: Path, depth: int = 0) -> dict[str, Any]:
    """What a file holds, on top of what it inherits.

    Args:
        name: of a scenario of the package, or a file.
        folder: that the file is named from.
        depth: of inheritance so far.

    Raises:
        ValueError: there is no such scenario or file, or inheritance has no end.
    """
    if depth > DEEPEST:
        raise ValueError("it inherits from itself")
    path = folder / name
    if not name.endswith((".yaml", ".yml")):
        path = Path(str(shipped() / f"{name}.yaml"))
        if not path.is_file():
            raise ValueError(
                f"no scenario {name!r}: choose from {', '.join(named())}, or name a .yaml file"
            )
    content = rooted(read_mapping(path), path.parent)
    parent = content.pop("inherits", None)
    base = {} if parent is None else inherited(str(parent), path.parent, depth + 1)
    return dict(_merged(base, content))


def rooted(content: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A scenario's entries with the files and folders in them named from the root; they were from ``folder``."""

    def at(told: Any) -> Any:
        local = isinstance(told, str) and told and "://" not in told
        return str((folder / told).resolve()) if local else told

    content |= {key: at(content[key]) for key in ("arm", "cell") if key in content}
    if isinstance(packages := content.get("packages"), dict):
        content["packages"] = {name: at(told) for name, told in packages.items()}
    return content


def _merged(base: Any, over: Any) -> Any:
    """``over`` on top of ``base``, mapping by mapping; lists are replaced, and null takes an entry out."""
    if not isinstance(over, Mapping):
        return over
    below = base if isinstance(base, Mapping) else {}
    merged = {**below, **{k: _merged(below.get(k), v) for k, v in over.items()}}
    return {k: v for k, v in merged.items() if v is not None}


def change(content: dict[str, Any], told: str) -> None:
    """Change an entry, as PATH=VALUE tells.

    Raises:
        ValueError: it is told otherwise, or the path goes through a value.
    """
    place, equals, text = told.partition("=")
    *path, last = place.strip().split(".")
    if not equals or not last:
        raise ValueError(f"--set {told}: NAME.NAME=VALUE is wanted")
    try:
        value: Any = float(text)
        value = int(text) if value.is_integer() and text.strip().lstrip("+-").isdigit() else value
    except ValueError:
        value = _parsed(told, text)
    here = content
    for key in path:
        here = here.setdefault(key, {})
        if not isinstance(here, dict):
            raise ValueError(f"--set {told}: {key} holds no entries")
    here[last] = value


def _parsed(told: str, text: str) -> Any:
    try:
        return yaml.load(text, PlainLoader)
    except yaml.YAMLError as error:
        said = " ".join(str(error).split())
        raise ValueError(f"--set {told}: what follows = is no YAML: {said}") from None


def check(schema: Any, content: Any, where: str) -> None:
    """Refuse keys that no dataclass has a field for, and what is no number, list or mapping where one is due.

    Args:
        schema: dataclass, type of Drake's with fields, or other type.
        content: what a file holds for it.
        where: path of it in the file.

    Raises:
        ValueError: says what is allowed.
    """
    if schema is float and (isinstance(content, bool) or not isinstance(content, int | float)):
        raise ValueError(f"{where}: a number is wanted, got {content!r}")
    if isinstance(content, int | float) and not isinstance(content, bool):
        finite(where, content)
    if isinstance(schema, UnionType) and content is not None:
        check(typing.get_args(schema)[0], content, where)
    if typing.get_origin(schema) is list:
        if not isinstance(content, list):
            raise ValueError(f"{where}: a list is wanted, got {content!r}")
        for n, item in enumerate(content):
            check(typing.get_args(schema)[0], item, f"{where}[{n}]")
    if typing.get_origin(schema) is dict:
        if not isinstance(content, Mapping):
            raise ValueError(f"{where}: entries are wanted, got {content!r}")
        for key, item in content.items():
            check(typing.get_args(schema)[1], item, f"{where}.{key}")
    fields = getattr(schema, "__fields__", None)  # of a type of Drake's
    if dataclasses.is_dataclass(schema):
        fields = dataclasses.fields(schema)
    if fields is None:
        return
    if not isinstance(content, Mapping):
        raise ValueError(f"{where or 'a file'} holds entries, got {content!r}")
    allowed = {f.name: f.type for f in fields}
    for key, value in content.items():
        place = f"{where}.{key}" if where else str(key)
        if key not in allowed:
            raise ValueError(f"no {place}; allowed there are {', '.join(allowed)}")
        check(allowed[key], value, place)
