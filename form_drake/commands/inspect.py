"""``form-drake list`` and ``form-drake check``: what there is, and what a file holds."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import tyro

from form_drake.commands.output import emit, say
from form_drake.effects import CATALOGUE, Effect, catalogue
from form_drake.effects.acting import known
from form_drake.files import about, existing, read_mapping
from form_drake.identify import most_observed
from form_drake.laws import ADDITIONS, LAWS
from form_drake.laws.law import Law, Term
from form_drake.material import Material, derived, read_material
from form_drake.motion import body
from form_drake.motion.body import faces
from form_drake.records import READERS, Recording, read


def material_files() -> dict[str, Path]:
    """Materials that come with the package, by name."""
    folder = Path(str(files("form_drake") / "models" / "materials"))
    return {p.stem: p for p in sorted(folder.glob("*.yaml"))}


@dataclass(frozen=True)
class List:
    """List the laws, materials, scenarios or effects that come with the package."""

    what: tyro.conf.Positional[Literal["laws", "materials", "scenarios", "effects"]]
    """What to list."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Print the list."""
        if self.what == "laws":
            found: dict[str, Any] = {n: _law(law) for n, law in (LAWS | ADDITIONS).items()}
            lines = [
                f"{n:20} {', '.join(e['parameters']):62} {e['stress']}" for n, e in found.items()
            ]
        elif self.what == "effects":
            found = {name: _effect(effect) for name, effect in CATALOGUE.items()}
            lines = [
                f"{n:16} {e['unit']:7} {' '.join(e['shapes']):18} {e['sentence']}"
                for n, e in found.items()
            ]
        elif self.what == "scenarios":
            found = _scenarios()
            lines = [
                f"{n:14} {e['law']:20} {e['tool']:24} {e['seconds']} s" for n, e in found.items()
            ]
        else:
            found = {n: _material(read_material(p), p) for n, p in material_files().items()}
            lines = [f"{n:14} {e['law']:20} {e['file']}" for n, e in found.items()]
        emit("\n".join(lines), {self.what: found}, as_json=self.json)
        if self.what == "laws" and not self.json:
            say("Elastic laws may be added to each other, and fluids to each other: yeoh+gent.")
            say(f"{', '.join(ADDITIONS)} only add to a solid: fixed-corotated+damping.")


def _effect(effect: Effect) -> dict[str, Any]:
    return {
        "sentence": effect.sentence,
        "unit": effect.unit,
        "signed": effect.signed,
        "prior": list(effect.prior),
        "shapes": list(effect.shapes),
        "shown": list(effect.shown),
        "of": "the world" if effect.world else "a sensor",
    }


def _scenario(name: str | Path, own: Path | None = None) -> dict[str, Any]:
    from form_drake.systems.scenario import load_scenario

    scenario = load_scenario(name, effects=catalogue(own))
    return {
        "name": scenario.name,
        "law": scenario.specimen.law,
        "material": scenario.specimen.material,
        "tool": scenario.probe.tool,
        "seconds": scenario.probe.waypoints[-1].time if scenario.probe.waypoints else 0.0,
    }


def _scenarios() -> dict[str, Any]:
    from form_drake.systems.layers import named

    return {name: _scenario(name) for name in named()}


def _law(law: Law) -> dict[str, Any]:
    parameters = {}
    for p in law.parameters:
        role = ("given" if p.given else "linear") if isinstance(p, Term) else p.role
        parameters[p.key] = {"unit": p.unit, "role": role}
    return {
        "parameters": parameters,
        "derived": {k: unit for k, (unit, _) in derived(law).items()},
        "stress": law.equation,
        "adds_to": sorted(law.adds_to),
    }


def _material(material: Material, path: Path) -> dict[str, Any]:
    return {
        "law": material.law.name,
        "parameters": material.to_json(),
        "density": material.density,
        "file": str(path),
    }


@dataclass(frozen=True)
class Check:
    """Say what a recording, material, scenario or rig file holds, or what is wrong with it."""

    file: tyro.conf.Positional[Path]
    """An .h5 or .npz recording, or a .yaml material, scenario or rig."""
    effects: Path | None = None
    """Python file with effects of your own that a material or a scenario names; it is executed."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Read the file with every check and print what it holds."""
        existing(self.file)
        content = read_mapping(self.file) if self.file.suffix in (".yaml", ".yml") else None
        kind = _kind(content)
        if self.effects is not None and kind not in ("material", "scenario"):
            raise ValueError(
                f"--effects belongs to a material or a scenario, and {self.file} is none"
            )
        if self.file.suffix in READERS:
            found = {"kind": "recording", **self._recording()}
        elif content is None:
            allowed = ", ".join([*READERS, ".yaml"])
            raise ValueError(f"{self.file}: unknown kind of file; known endings: {allowed}")
        elif kind == "material":
            found = {"kind": kind, **self._material()}
        elif kind == "rig":
            found = {"kind": kind, **_rig(self.file)}
        else:
            found = {"kind": kind, **_scenario(self.file, self.effects)}
        for place in _endless(found, ""):
            raise ValueError(
                f"{self.file}: {place} is not finite: numbers in the file are too small or too large"
            )
        lines = [f"{key:14} {_short(value)}" for key, value in found.items()]
        emit("\n".join(lines), found, as_json=self.json)

    def _recording(self) -> dict[str, Any]:
        recording = read(self.file)
        with about(self.file):
            _stated(recording)
        return _held(recording)

    def _material(self) -> dict[str, Any]:
        material = read_material(self.file)
        with about(self.file):
            known(material.effects, material.law, catalogue(self.effects))
            found = _material(material, self.file)
        return found | {"effects": [asdict(one) for one in material.effects]}


def _kind(content: dict[str, Any] | None) -> str:
    """Of a YAML file, by what it holds; "": the file is none."""
    if content is None:
        return ""
    marks = (k for k in ("material", "rig") if f"form_drake_{k}" in content)
    return next(marks, "scenario")


def _stated(recording: Recording) -> None:
    """Refuse what the weak form could not read of a recording's box and faces."""
    cornered = {"low", "high"} & set(recording.geometry)
    box = recording.geometry.get("shape") == "box" and cornered
    for source in sorted({name.partition(":")[2] or "sensor" for name in recording.forces} or {""}):
        one = recording.measured_by(source)
        if box:
            body(replace(one, density=one.density or 1.0))
        else:
            faces(one)


def _rig(path: Path) -> dict[str, Any]:
    from form_drake.perceive.rig import Rig

    rig = Rig.read(path)
    with about(path):
        points = len(rig.points())
    return {
        "cameras": {name: " x ".join(map(str, c.size)) for name, c in rig.cameras.items()},
        "rate": rig.rate,
        "low": rig.low.tolist(),
        "high": rig.high.tolist(),
        "face": rig.face.name,
        "half": rig.half,
        "spacing": rig.spacing,
        "points": points,
    }


def _endless(value: Any, place: str) -> Iterator[str]:
    """Places of numbers that are not finite."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _endless(entry, f"{place}.{key}" if place else str(key))
    elif isinstance(value, float) and not math.isfinite(value):
        yield place


def _short(value: Any) -> str:
    if isinstance(value, dict) and value and all(isinstance(v, dict) for v in value.values()):
        return ", ".join(f"{k} = {v['value']:.6g} {v['unit']}" for k, v in value.items())
    return str(value)


def _held(recording: Recording) -> dict[str, Any]:
    arrays = {}
    for record in (recording, recording.states):
        for f in fields(record) if record is not None else ():
            value = getattr(record, f.name)
            if "place" in f.metadata and value is not None:
                shape = " x ".join(str(n) for n in value.shape)
                arrays[f.metadata["place"]] = f"{shape} [{f.metadata['unit']}]"
    solver = recording.solver
    found: dict[str, Any] = {
        "source": recording.source,
        "frames": recording.frames,
        "points": recording.points,
        "duration_s": float(recording.time[-1] - recording.time[0]),
        "law": recording.law or "not declared",
        "known": dict(recording.known),
        "noise_m": "unknown" if recording.noise is None else recording.noise,
        "density": recording.density,
        "gravity": None if recording.gravity is None else recording.gravity.tolist(),
        "mass_scale": recording.mass_scale,
        "geometry": dict(recording.geometry),
        "contact": dict(recording.contact),
        "solver": "not stated",
        "pairs": len(recording.states.pairs()) if recording.states else 0,
        "observe": most_observed(recording),
        "streams": [
            *(f"poses/{name}" for name in recording.poses),
            *(f"forces/{name}" for name in recording.forces),
            *(["joints"] if recording.joints else []),
        ],
        "arrays": arrays,
    }
    if solver is not None:
        found["solver"] = (
            f"{solver.nodes} nodes, dx {solver.dx} m, dt {solver.dt} s, {solver.gradient} gradient,"
            f" {solver.decomposition}, {solver.precision}, {len(solver.walls)} walls"
        )
    return found
