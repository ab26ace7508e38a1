"""Effects that a person declares in a file of their own."""

import re
from math import isfinite, isnan
from numbers import Real
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
            if fault := _fault(thing):
                raise ValueError(f"{path}: effect {thing.id!r}: {fault}")
            if thing.id in catalogue or found.get(thing.id, thing) is not thing:
                raise ValueError(f"{path}: effect {thing.id!r}: the id is taken")
            found[thing.id] = _fitting(thing, path)
    for effect in found.values():
        if strange := set(effect.same) - {*catalogue, *found}:
            raise ValueError(
                f"{path}: effect {effect.id!r}: same may hold ids, got {min(strange)!r}"
            )
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
    for name in ("column", "world", "sensor", "parts", "fits"):
        told = getattr(effect, name)
        if not (callable(told) or (told is None and name != "fits")):
            return f"{name} must be a function, got {told!r}"
    for name in ("signed", "share", "bends", "compounds", "whole"):
        if not isinstance(told := getattr(effect, name), bool):
            return f"{name} must be True or False, got {told!r}"
    for name in ("prior", "trial", "least", "most"):
        told = getattr(effect, name)
        if not all(map(_number, told if name == "prior" else (told,))):
            return f"{name} must be of numbers, got {told!r}"
    if not isfinite(effect.trial):
        return f"trial must be finite, got {effect.trial!r}"
    for key, values in effect.shapes.items():
        if not isinstance(values, tuple) or not all(_number(v) and isfinite(v) for v in values):
            return f"shape {key} must be a tuple of finite numbers, got {values!r}"
    for key, least in effect.floors.items():
        if not (_number(least) and isfinite(least)):
            return f"floor of {key} must be a finite number, got {least!r}"
    if not effect.lower < effect.most:
        return f"no coefficient is above {effect.lower:g} and at most {effect.most:g}"
    if beside := set(effect.floors) - set(effect.shapes):
        return f"floors are of shapes, got {', '.join(sorted(beside))}"
    return None


def _number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and not isnan(value)


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
