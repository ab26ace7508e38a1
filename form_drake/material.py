"""Materials: a law with values, their covariance and what follows from them; YAML in and out."""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from form_drake.files import about, read_mapping, write_text
from form_drake.laws import Law, Values, law_named
from form_drake.laws.values import (
    ENGINEERING,
    check_moduli,
    checked_values,
    finite,
    has_lame,
)

VERSION = 1
ENTRIES = {"form_drake_material", "law", "density", "parameters", "covariance", "effects"}
UNITS = {"E": "Pa", "nu": "-"}


@dataclass(frozen=True)
class Parameter:
    """One printed value: ``std`` is None where it is not known, as for given constants."""

    value: float
    std: float | None
    unit: str
    derived: bool = False


@dataclass(frozen=True)
class Acting:
    """An effect that acts on the specimen or its sensors, see ``form_drake.effects``.

    Attributes:
        id: of the effect.
        coefficient: in the effect's unit.
        shape: values of its shape parameters.
        std: of the coefficient, where it is known.
    """

    id: str
    coefficient: float
    shape: Mapping[str, float] = field(default_factory=dict)
    std: float | None = None


@dataclass(frozen=True)
class Material:
    """A law with a value for every parameter.

    Attributes:
        law: the constitutive law.
        values: parameter values (SI units) by key.
        density: mass per reference volume [kg/m^3], where known.
        keys: identified parameters, in the order of ``covariance``.
        covariance: of the identified parameters, shape [keys, keys].
        effects: that act beside the law.
    """

    law: Law
    values: dict[str, float]
    density: float | None = None
    keys: tuple[str, ...] = ()
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    effects: tuple[Acting, ...] = ()

    def __post_init__(self) -> None:
        missing = [k for k in self.law.keys if k not in self.values]
        if missing:
            raise ValueError(f"{self.law.name} needs a value for {', '.join(missing)}")

    def changed(self, values: Mapping[str, Any]) -> "Material":
        """This material with some values stated anew; their uncertainty is dropped."""
        new = checked_values(self.law, values)
        kept = [i for i, k in enumerate(self.keys) if k not in new]
        return replace(
            self,
            values={**self.values, **new},
            keys=tuple(self.keys[i] for i in kept),
            covariance=self.covariance[np.ix_(kept, kept)],
        )

    def parameters(self) -> dict[str, Parameter]:
        """The law's parameters, then what is derived from them, each with its uncertainty."""
        out = {}
        for key in self.law.keys:
            std = None
            if key in self.keys:
                i = self.keys.index(key)
                std = float(np.sqrt(max(self.covariance[i, i], 0.0)))
            out[key] = Parameter(self.values[key], std, self.law.unit(key))
        for key, (unit, function) in derived(self.law).items():
            with suppress(ZeroDivisionError):  # estimated moduli may cancel: nothing follows then
                out[key] = Parameter(function(self.values), self._derived_std(function), unit, True)
        return out

    def _derived_std(self, function: Callable[[Values], float]) -> float | None:
        if not self.keys:
            return None
        slopes, deviation = [], np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        for key, std in zip(self.keys, deviation, strict=True):
            h = max(1e-6 * abs(self.values[key]), 1e-4 * std, 1e-18)
            ends = [function({**self.values, key: self.values[key] + s * h}) for s in (1, -1)]
            slopes.append((ends[0] - ends[1]) / (2.0 * h))
        g = np.array(slopes)
        return float(np.sqrt(max(g @ self.covariance @ g, 0.0)))

    def to_json(self) -> dict[str, dict[str, Any]]:
        """The ``parameters`` object of the command line's JSON."""
        return {
            key: {"value": p.value, "std": p.std, "unit": p.unit, "derived": p.derived}
            for key, p in self.parameters().items()
        }

    def write(self, path: Path) -> None:
        """Write the YAML file, whole."""
        entries = {}
        for key, p in self.parameters().items():
            entries[key] = {"value": float(p.value), "unit": p.unit}
            if p.std is not None:
                entries[key]["std"] = p.std
            if p.derived:
                entries[key]["derived"] = True
        content: dict[str, Any] = {"form_drake_material": VERSION, "law": self.law.name}
        if self.density is not None:
            content["density"] = {"value": float(self.density), "unit": "kg/m^3"}
        content["parameters"] = entries
        if self.keys:
            content["covariance"] = {
                "keys": list(self.keys),
                "values": [[float(c) for c in row] for row in self.covariance],
            }
        if self.effects:
            content["effects"] = [_told(one) for one in self.effects]
        write_text(Path(path), yaml.safe_dump(content, sort_keys=False))


def _told(one: Acting) -> dict[str, Any]:
    """An effect's entry in a file."""
    entry: dict[str, Any] = {"id": one.id, "coefficient": float(one.coefficient)}
    if one.std is not None:
        entry["std"] = float(one.std)
    if one.shape:
        entry["shape"] = {k: float(v) for k, v in one.shape.items()}
    return entry


def derived(law: Law) -> dict[str, tuple[str, Callable[[Values], float]]]:
    """What follows from a law's parameters: key -> (unit, values -> value)."""
    out: dict[str, tuple[str, Callable[[Values], float]]] = {}
    if law.flow in ("elastic", "plastic"):
        out["E"] = ("Pa", lambda v: _young(*law.moduli(v)))
        out["nu"] = ("-", lambda v: _poisson(*law.moduli(v)))
    if "kappa" not in law.keys or law.summands:  # of a sum, kappa may be a part of K only
        out["K"] = ("Pa", lambda v: law.moduli(v)[0])
    for p in law.parameters:
        if p.tells:
            name, unit, function = p.tells
            out[name] = (unit, _alone(p.key, function))
    return {k: entry for k, entry in out.items() if k not in law.keys}


def _alone(key: str, function: Callable[[float], float]) -> Callable[[Values], float]:
    return lambda values: function(values[key])


def _young(K: float, G: float) -> float:
    return float(9.0 * K * G) / float(3.0 * K + G)


def _poisson(K: float, G: float) -> float:
    return float(3.0 * K - 2.0 * G) / float(2.0 * (3.0 * K + G))


def read_material(path: Path) -> Material:
    """Read a material file; values may be plain numbers, and E and nu may stand for mu and lam.

    Raises:
        ValueError: one line that says what is wrong with the file.
    """
    content = read_mapping(Path(path))
    with about(path):
        return _parse(content)


def _parse(content: dict[str, Any]) -> Material:
    version = content.get("form_drake_material")
    if version is None:
        raise ValueError(f"no material: form_drake_material: {VERSION} is wanted in it")
    if version != VERSION:
        raise ValueError(
            f"form_drake_material is {str(version)[:60]!r}; this release reads version {VERSION}"
        )
    unknown = set(content) - ENTRIES
    if unknown:
        raise ValueError(f"unknown entries {', '.join(sorted(map(str, unknown)))}")
    law = law_named(str(content.get("law")))
    entries = content.get("parameters")
    if not isinstance(entries, dict):
        raise ValueError("'parameters' must map names to values")
    values: dict[str, float] = {}
    follows: dict[str, float] = {}
    for key, entry in entries.items():
        told = follows if isinstance(entry, dict) and entry.get("derived") else values
        told[str(key)] = _entry(law, str(key), entry)
    density = content.get("density")
    if density is not None:
        density = _number("density", "kg/m^3", density)
        if density <= 0:
            raise ValueError(f"density: must be positive, got {density}")
    keys, covariance = _covariance(law, content.get("covariance"))
    effects = _effects(content.get("effects", []))
    material = Material(law, checked_values(law, values), density, keys, covariance, effects)
    check_moduli(law, material.values)
    for key, value in follows.items():
        _check_derived(material, key, value)
    return material


def _check_derived(material: Material, key: str, value: float) -> None:
    """Refuse a derived value that does not follow: an edit of it would have no effect."""
    law = material.law
    if key not in derived(law):
        raise ValueError(
            f"{law.name} has no derived {key!r}: choose from {', '.join(derived(law))}"
        )
    right = derived(law)[key][1](material.values)
    if not math.isclose(value, right, rel_tol=1e-6, abs_tol=1e-9):
        remedy = f"change {', '.join(law.keys)} instead"
        if key in (*ENGINEERING, "K") and has_lame(law):
            remedy = "to change it, state E and nu instead of mu and lam"
        raise ValueError(
            f"{key}: {value:g} is marked as derived, but the parameters give {right:g}; {remedy}"
        )


def _entry(law: Law, key: str, entry: Any) -> float:
    if key in law.keys:
        return _number(key, law.unit(key), entry)
    units = UNITS | {k: unit for k, (unit, _) in derived(law).items()}
    return _number(key, units.get(key), entry)


def _number(key: str, unit: str | None, entry: Any) -> float:
    """A finite number, plain or as a mapping with ``value`` and the right ``unit``."""
    if not isinstance(entry, dict):
        return finite(key, entry)
    if unit is not None and entry.get("unit", unit) != unit:
        raise ValueError(f"{key}: the unit is {unit}, got {str(entry['unit'])[:60]!r}")
    return finite(key, entry.get("value"))


def _effects(entries: Any) -> tuple[Acting, ...]:
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise ValueError("effects: a list of entries with id and coefficient is wanted")
    found = []
    for entry in entries:
        name = str(entry.get("id"))[:60]
        unknown = set(entry) - {"id", "coefficient", "std", "shape"}
        shape = entry.get("shape", {})
        if unknown or not isinstance(shape, dict):
            raise ValueError(f"effect {name}: id, coefficient, std and a mapping shape are allowed")
        std = entry.get("std")
        if std is not None and not finite(f"effect {name}: std", std) >= 0.0:
            raise ValueError(f"effect {name}: std must not be negative, got {std}")
        found.append(
            Acting(
                name,
                finite(f"effect {name}: coefficient", entry.get("coefficient")),
                {str(k): finite(f"effect {name}: {k}", v) for k, v in shape.items()},
                None if std is None else float(std),
            )
        )
    return tuple(found)


def _covariance(law: Law, entry: Any) -> tuple[tuple[str, ...], np.ndarray]:
    if entry is None:
        return (), np.zeros((0, 0))
    named = entry.get("keys") if isinstance(entry, dict) else None
    keys = tuple(str(k) for k in named) if isinstance(named, list) else ()
    try:
        matrix = np.array(entry["values"], dtype=float)
    except (TypeError, KeyError, ValueError, OverflowError):
        matrix = np.zeros(0)
    distinct = len(set(keys)) == len(keys) > 0 and set(keys) <= set(law.keys)
    if not distinct or matrix.shape != (len(keys), len(keys)):
        raise ValueError("covariance: 'keys' and a square matrix 'values' of that size are wanted")
    if not np.isfinite(matrix).all():
        raise ValueError("covariance: values must be finite")
    size = np.sqrt(np.abs(np.diag(matrix)))
    if np.any(np.diag(matrix) < 0) or np.any(
        np.abs(matrix - matrix.T) > 1e-9 * np.outer(size, size)
    ):
        raise ValueError("covariance: it must be symmetric with a diagonal that is not negative")
    scaled = matrix / np.maximum(np.outer(size, size), 1e-300)
    if np.linalg.eigvalsh(scaled).min() < -1e-6:
        raise ValueError(
            "covariance: no set of deviations is correlated like that: it has negative eigenvalues"
        )
    return keys, matrix
