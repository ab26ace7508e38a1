"""The layout of a recording, read off a file in which nothing is missing."""

import inspect
import re
import tempfile
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from form_drake.records import Camera, Recording, Solver, States, Stream, Wall, write_recording
from make_markdown import markdown_table, single

SIZES = {"frames": 11, "points": 13, "states": 17, "intervals": 19, "samples": 23, "joints": 29}
NOISE, POSES = (
    "standard deviation of one component; absent: unknown.",
    "standard deviation of how far the place is off, which stays so; absent: not at all.",
)
STREAM_UNITS = {"poses": "", "forces": "N", "joints": "rad"}


def stated(cls: type) -> dict[str, str]:
    """What the class's docstring says of each attribute."""
    section = inspect.getdoc(cls).partition("Attributes:\n")[2]
    found: dict[str, str] = {}
    for line in section.splitlines():
        entry = re.match(r" {4}(\w+): (.*)", line)
        if entry:
            key, found[entry[1]] = entry[1], entry[2]
        elif line.startswith(" " * 8):
            found[key] += " " + line.strip()
    return {k: single(t) for k, t in found.items()}


def attributes(cls: type) -> dict[str, str]:
    """``stated`` without shapes and units, and with a file in mind."""
    said = {k: t.replace("None:", "absent:") for k, t in stated(cls).items()}
    return {k: re.sub(r",? shape \[[^\]]*\]| \[[^\]]*\]", "", t) for k, t in said.items()}


def unit_of(text: str) -> str:
    """The first bracket that holds a unit."""
    found = re.search(r"\[([a-zA-Z/^0-9 ]*[a-zA-Z][a-zA-Z/^0-9 ]*)\]", text)
    return found[1] if found else ""


def _arrays(cls: type) -> dict[str, np.ndarray]:
    made = {}
    for f in fields(cls):
        if "dims" in f.metadata:
            shape = [int(d) if d.isdigit() else SIZES[d] for d in f.metadata["dims"]]
            value = 1 + np.arange(np.prod(shape)).reshape(shape)
            made[f.name] = value.astype({"i": int, "b": bool}.get(f.metadata["kind"], float))
    return made


def full_recording() -> Recording:
    """A recording in which no field is missing."""

    def stream(*shape: int) -> Stream:
        return Stream(np.arange(SIZES["samples"]) * 1.0, np.ones((SIZES["samples"], *shape)))

    alike = np.tile(np.eye(3), (SIZES["points"], 1, 1))
    recording = Recording(
        **{**_arrays(Recording), "covariance": alike, "face": np.zeros(SIZES["points"], int)},
        noise=1.0,
        density=1.0,
        mass_scale=2.0,
        solver=Solver(
            dx=1.0, nodes=(9, 9, 9), dt=1.0, walls=(Wall(2, -1, 3.0),), gravity=(1.0, 2.0, 3.0)
        ),
        states=States(**_arrays(States)),
        law="neo-hookean",
        known={"kappa": 1.0},
        poses={
            "NAME": replace(
                stream(4, 4), value=np.tile(np.eye(4), (SIZES["samples"], 1, 1)), noise=1.0
            )
        },
        forces={"NAME": replace(stream(3), noise=1.0)},
        joints=replace(stream(SIZES["joints"]), noise=1.0),
        cameras={"NAME": Camera(np.eye(3), np.eye(4), np.zeros(5), (640, 480))},
        geometry={"shape": "box"},
        contact={"z-": "frictionless floor"},
        source="somewhere",
    )
    held = vars(recording)
    missing = [k for k, v in held.items() if v is None or (isinstance(v, dict | str) and not v)]
    if missing:
        raise ValueError(f"full_recording leaves out {', '.join(missing)}")
    return recording


def layout_table() -> str:
    """Every attribute and dataset of a recording's file."""
    says = attributes(Recording) | {
        "form_drake_recording": "Version of this layout.",
    }
    recording, raw = full_recording(), stated(Recording)
    words = {n: d for d, n in SIZES.items()}
    places = {f.metadata["place"]: f.name for f in fields(Recording) if f.metadata}
    states = {f.metadata["place"]: attributes(States)[f.name] for f in fields(States)}
    camera = stated(Camera)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "full.h5"
        write_recording(recording, path)
        with h5py.File(path) as file:
            for name, value in sorted(file.attrs.items()):
                field = getattr(recording, name, 1)
                kind = "text" if isinstance(field, str) else "number"
                is_json = isinstance(value, str) and value.startswith("{")
                unit = unit_of(raw.get(name, "")) if kind == "number" else ""
                rows.append((f"attribute `{name}`", "JSON" if is_json else kind, unit, says[name]))

            def visit(place: str, item: Any) -> None:
                if not isinstance(item, h5py.Dataset):
                    if "noise" in item.attrs:
                        of_poses = place.startswith("poses")
                        unit, says_of = ("m", POSES) if of_poses else ("as its values", NOISE)
                        rows.append((f"attribute `noise` of `{place}`", "number", unit, says_of))
                    return
                shape = ", ".join(words.get(n, str(n)) for n in item.shape)
                if "dims" in item.attrs:
                    shape = str(item.attrs["dims"]).replace(" ", ", ")
                top, last = place.split("/")[0], place.rsplit("/", 1)[-1]
                unit = str(item.attrs.get("unit", ""))
                if place in places or place in states:
                    meaning = states.get(place) or says[places[place]]
                elif top == "cameras":
                    meaning, unit = attributes(Camera)[last], unit_of(camera[last])
                elif last == "time":
                    meaning, unit = attributes(Stream)["time"], unit_of(stated(Stream)["time"])
                else:
                    meaning, unit = says[top], STREAM_UNITS[top]
                rows.append((f"`{place}`", f"[{shape}]", unit.replace("-", ""), meaning))

            file.visititems(visit)
    return markdown_table(("place", "shape or kind", "unit", "meaning"), rows)


def settings_table(cls: type) -> str:
    """Every setting of a dataclass: default and meaning."""
    rows = []
    for f in fields(cls):
        default = f.default if f.default is not MISSING else f.default_factory
        shown = "required" if default is MISSING else f"`{default}`"
        meaning = stated(cls)[f.name]
        rows.append((f"`{f.name}`", shown, meaning))
    return markdown_table(("setting", "default", "meaning"), rows)
