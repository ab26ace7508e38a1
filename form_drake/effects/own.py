"""Effects that a person declares in a file of their own."""

import re
from math import isfinite
from pathlib import Path
from typing import Any

from form_drake.effects.effect import CONDITIONS, Effect
from form_drake.laws import LAWS
from form_drake.laws.own import executed


def load(path: Path, catalogue: dict[str, Effect]) -> dict[str, Effect]:
    """Run a Python file, and find the effects that it declares.

    An effect is a module-level ``Effect`` object.

    Args:
        path: the file; it is run with all rights of this program.
        catalogue: effects that there are, by id.

    Raises:
        ValueError: one line: there is no such file, it fails, declares no effect, the id of one is
            taken, or one cannot say which laws it fits.
    """
    path = Path(path).absolute()
    imported = {id(effect) for effect in catalogue.values()}
    found: dict[str, Effect] = {}
    for thing in vars(executed(path)).values():
        if isinstance(thing, Effect) and id(thing) not in imported:
            if thing.id in catalogue or found.get(thing.id, thing) is not thing:
                raise ValueError(f"{path}: effect {thing.id!r}: the id is taken")
            if fault := _fault(thing):
                raise ValueError(f"{path}: effect {thing.id!r}: {fault}")
            found[thing.id] = _fitting(thing, path)
    if not found:
        raise ValueError(f"{path}: declares no effect; a module-level Effect object is wanted")
    return found


def _fault(effect: Effect) -> str | None:
    """What is wrong with a declaration, as far as it shows without a motion."""
    if not isinstance(effect.id, str) or not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", effect.id):
        return "an id is made of lower-case words joined by hyphens"
    for name in ("sentence", "unit"):
        if not isinstance(text := getattr(effect, name), str) or not text.strip():
            return f"{name} must be a text, got {text!r}"
    for name in ("shown", "faces", "same"):
        told = getattr(effect, name)
        if not isinstance(told, tuple) or not all(isinstance(one, str) for one in told):
            return f"{name} must be a tuple of texts, got {told!r}"
    if strange := [one for one in effect.faces if one not in CONDITIONS]:
        return f"faces may hold {', '.join(CONDITIONS)}, got {strange[0]!r}"
    for name in ("prior", "trial"):
        if not all(_numbers(getattr(effect, name))):
            return f"{name} must be of finite numbers, got {getattr(effect, name)!r}"
    for key, values in (*effect.shapes.items(), *effect.floors.items()):
        if not all(_numbers(values)):
            return f"shape {key} must be of finite numbers, got {values!r}"
    if not effect.lower < effect.most:
        return f"no coefficient is above {effect.lower:g} and at most {effect.most:g}"
    if beside := set(effect.floors) - set(effect.shapes):
        return f"floors are of shapes, got {', '.join(sorted(beside))}"
    return None


def _numbers(values: Any) -> list[bool]:
    every = values if isinstance(values, tuple) else (values,)
    return [type(v) in (int, float) and isfinite(v) for v in every]


def _fitting(effect: Effect, path: Path) -> Effect:
    """The effect, which has been asked about every law of this package."""
    for law in LAWS.values():
        try:
            effect.fits(law)
        except Exception as error:
            kind = type(error).__name__
            raise ValueError(
                f"{path}: effect {effect.id!r}: fits fails at law {law.name}: {kind}: {error}"
            ) from None
    return effect
