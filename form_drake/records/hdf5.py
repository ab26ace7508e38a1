"""Recordings as HDF5 files: written whole, read with every check before a value is used."""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from form_drake.files import existing, once, plain, whole
from form_drake.laws.values import finite
from form_drake.records.recording import VERSION, Camera, Recording, States, Stream
from form_drake.records.solver import Solver, Wall

LARGEST = 8_000_000_000
LARGEST_RATIO = 1100  # gzip never packs more tightly
MOST_OBJECTS = 10_000
DEEPEST = 8
TEXTS = ("known", "geometry", "contact")
NUMBERS = ("density", "mass_scale")
ATTRIBUTES = (
    *TEXTS,
    *NUMBERS,
    "noise",
    "law",
    "solver",
    "source",
    "form_drake_recording",
)
PLACES = {  # units by place, * for any name
    tuple(f.metadata["place"].split("/")): f.metadata["unit"]
    for record in (Recording, States)
    for f in fields(record)
    if "place" in f.metadata
} | {
    (*group, name): unit
    for group, units in (
        (("poses", "*"), {"time": "s", "value": ""}),
        (("forces", "*"), {"time": "s", "value": "N"}),
        (("joints",), {"time": "s", "value": "rad"}),
        (("cameras", "*"), {f.name: "" for f in fields(Camera)} | {"K": "px", "size": "px"}),
    )
    for name, unit in units.items()
}
SUFFIXES = (".h5", ".hdf5")
STREAMS = (("poses", "*"), ("forces", "*"), ("joints",))


def write_recording(recording: Recording, path: Path) -> None:
    """Write the file, whole.

    Raises:
        ValueError: its name does not end in .h5 or .hdf5.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: a recording is written to a file that ends in {SUFFIXES[0]}")
    with whole(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["form_drake_recording"] = VERSION
        file.attrs["source"] = recording.source
        file.attrs["noise"] = "unknown" if recording.noise is None else recording.noise
        if recording.mass_scale != 1.0:
            file.attrs["mass_scale"] = recording.mass_scale
        for name in ("density", "law"):
            if getattr(recording, name) is not None:
                file.attrs[name] = getattr(recording, name)
        for name in TEXTS:
            file.attrs[name] = json.dumps(plain(dict(getattr(recording, name))))
        if recording.solver is not None:
            file.attrs["solver"] = json.dumps(plain(asdict(recording.solver)))
        _write_arrays(file, recording)
        if recording.states is not None:
            _write_arrays(file, recording.states)
        _write_streams(file, recording)
        for name, camera in recording.cameras.items():
            for key, value in asdict(camera).items():
                file[f"cameras/{name}/{key}"] = np.asarray(value)


def _write_arrays(file: h5py.File, record: Any) -> None:
    for f in fields(record):
        value = getattr(record, f.name)
        if "place" not in f.metadata or value is None:
            continue
        dataset = file.create_dataset(f.metadata["place"], data=value, compression="gzip")
        dataset.attrs["unit"] = f.metadata["unit"]
        dataset.attrs["dims"] = " ".join(f.metadata["dims"])


def _write_streams(file: h5py.File, recording: Recording) -> None:
    streams: dict[str, Stream] = {f"poses/{k}": s for k, s in recording.poses.items()}
    streams |= {f"forces/{k}": s for k, s in recording.forces.items()}
    if recording.joints is not None:
        streams["joints"] = recording.joints
    for place, stream in streams.items():
        file[f"{place}/time"], file[f"{place}/value"] = stream.time, stream.value
        if stream.noise is not None:
            file[place].attrs["noise"] = stream.noise


def read_recording(path: Path) -> Recording:
    """Read a recording.

    Raises:
        ValueError: one line that says what is wrong with the file.
    """
    existing(path)
    try:
        with h5py.File(path, "r") as file:
            return _read(file)
    except (OSError, RuntimeError, KeyError, TypeError, MemoryError) as error:
        detail = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not a readable HDF5 file ({detail})") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _read(file: h5py.File) -> Recording:
    version = file.attrs.get("form_drake_recording")
    if np.ndim(version) or version != VERSION:
        raise ValueError(
            f"form_drake_recording is {str(version)[:60]!r}; this release reads version {VERSION}"
        )
    _refuse_hostile(file)
    values = _read_arrays(file, Recording)
    noise = file.attrs.get("noise", "unknown")
    values["noise"] = None if _text(noise) == "unknown" else finite("noise", noise)
    for name in NUMBERS:
        if name in file.attrs:
            values[name] = finite(name, file.attrs[name])
    values["law"] = _text(file.attrs["law"]) if "law" in file.attrs else None
    values["source"] = _text(file.attrs.get("source", ""))
    for name in TEXTS:
        values[name] = _mapping(name, file.attrs.get(name, "{}"))
    values["known"] = {k: finite(k, v) for k, v in values["known"].items()}
    if "solver" in file.attrs:
        values["solver"] = read_solver(_mapping("solver", file.attrs["solver"]))
    if "states" in file:
        values["states"] = States(**_read_arrays(file, States))
    values["poses"] = {k: _stream(g) for k, g in _groups(file, "poses")}
    values["forces"] = {k: _stream(g) for k, g in _groups(file, "forces")}
    values["joints"] = _stream(file["joints"]) if "joints" in file else None
    values["cameras"] = {k: _camera(g) for k, g in _groups(file, "cameras")}
    _refuse_unknown(file)
    return Recording(**values)


def _refuse_hostile(file: h5py.File) -> None:
    """Refuse links, object data, data that are declared only and sizes that no recording has."""
    total, objects = 0, 0
    largest = min(LARGEST, 10**8 + LARGEST_RATIO * file.id.get_filesize())

    def visit(group: h5py.Group, depth: int) -> None:
        nonlocal total, objects
        for name in group:
            objects += 1
            if objects > MOST_OBJECTS or depth > DEEPEST:
                raise ValueError(f"{group.name[:60]}: too many or too deep groups, not read")
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise ValueError(f"{group.name}/{name}: links are not followed")
            item = group[name]
            if isinstance(item, h5py.Group):
                visit(item, depth + 1)
                continue
            if (
                not isinstance(item, h5py.Dataset)
                or item.shape is None
                or (item.is_virtual or item.external or item.dtype.kind not in "fiub")
                or (item.size > 0 and item.id.get_storage_size() == 0)
            ):
                raise ValueError(f"{item.name}: only plain numbers stored in the file are read")
            total += item.size * item.dtype.itemsize
            if total > largest:
                raise ValueError(f"{item.name}: more than {largest / 1e9:.1f} GB of data, not read")

    visit(file, 0)


def _refuse_unknown(file: h5py.File) -> None:
    """Refuse names and units that nobody would read: a wrong one would silently count for nothing."""
    for name in file.attrs:
        if name not in ATTRIBUTES:
            raise ValueError(f"unknown attribute {name!r}: allowed are {', '.join(ATTRIBUTES)}")

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        path = tuple(name.split("/"))
        noisy = any(len(path) == len(own) and _begins(own, path) for own in STREAMS)
        known = {"noise"} if noisy else set()
        known = known if isinstance(item, h5py.Group) else {"unit", "dims"}
        if strange := sorted(set(item.attrs) - known):
            words = ", ".join(sorted(known)) or "none"
            raise ValueError(
                f"{name[:60]}: unknown attribute {strange[0][:60]!r}: allowed are {words}"
            )
        if isinstance(item, h5py.Group):
            return
        if not any(_begins(place, path) for place in PLACES):
            beside = ["/".join(p).replace("*", "NAME") for p in PLACES if p[0] == path[0]]
            allowed = beside or sorted({p[0] for p in PLACES})
            raise ValueError(f"unknown {name[:60]}: allowed are {', '.join(allowed)}")
        same = (
            u for place, u in PLACES.items() if len(place) == len(path) and _begins(place, path)
        )
        unit = next(same, "")
        told = _text(item.attrs.get("unit", unit))
        if unit and told != unit:
            raise ValueError(f"{name}: the unit is {unit}, got {told[:60]!r}")

    file.visititems(visit)


def _begins(place: tuple[str, ...], path: tuple[str, ...]) -> bool:
    return len(path) <= len(place) and all(a in ("*", b) for a, b in zip(place, path, strict=False))


def _read_arrays(file: h5py.File, record: type) -> dict[str, Any]:
    kinds = {"f": np.float64, "n": np.float64, "i": np.int64, "b": np.bool_}
    allowed = {"f": "fiu", "n": "fiu", "i": "iu", "b": "b"}
    values = {}
    for f in fields(record):
        place = f.metadata.get("place")
        if place is None:
            continue
        if place not in file:
            if "None" not in str(f.type):
                raise ValueError(f"{place}: missing")
            continue
        data, kind = _data(file, place), f.metadata["kind"]
        if data.dtype.kind in allowed[kind]:
            single = data.dtype == np.float32 and kind in "fn"
            data = data if single else data.astype(kinds[kind])
        values[f.name] = data
    return values


def _data(group: h5py.Group, name: str) -> np.ndarray:
    item = group[name]
    if not isinstance(item, h5py.Dataset):
        raise ValueError(f"{item.name}: an array is wanted, got a group")
    return np.asarray(item[()])


def _groups(file: h5py.File, name: str) -> list[tuple[str, h5py.Group]]:
    group = file.get(name, {})
    if isinstance(group, h5py.Dataset):
        raise ValueError(f"{name}: a group is wanted, got an array")
    return list(group.items())


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _mapping(name: str, value: Any) -> dict[str, Any]:
    try:
        mapping = json.loads(_text(value), object_pairs_hook=once)
    except json.JSONDecodeError:
        mapping = None
    if not isinstance(mapping, dict):
        raise ValueError(f"{name}: a mapping is wanted, got {_text(value)[:60]!r}")
    return mapping


def read_solver(values: Mapping[str, Any]) -> Solver:
    """Solver settings from a mapping, as stored in a recording.

    Raises:
        ValueError: an unknown entry or a value of the wrong type.
    """
    known = {f.name for f in fields(Solver)}
    unknown = set(values) - known
    if unknown:
        raise ValueError(f"solver: unknown entries {', '.join(sorted(unknown))}")
    missing = [name for name in ("dx", "nodes") if name not in values]
    if missing:
        raise ValueError(f"solver: {' and '.join(missing)} must be stated")
    try:
        settings = dict(values)
        settings["nodes"] = tuple(settings["nodes"])
        settings["walls"] = tuple(Wall(**w) for w in settings.get("walls", ()))
        settings["gravity"] = tuple(settings.get("gravity", (0.0, 0.0, -9.81)))
        return Solver(**settings)
    except (TypeError, KeyError, OverflowError) as error:
        raise ValueError(f"solver: {error}") from None


def _members(group: Any, *names: str) -> list[np.ndarray]:
    """Arrays of a group as float64.

    Raises:
        ValueError: it is no group, or lacks one.
    """
    lacking = [n for n in names if not isinstance(group, h5py.Group) or n not in group]
    if lacking:
        raise ValueError(f"{group.name}: {', '.join(lacking)} is missing")
    return [_data(group, n).astype(float) for n in names]


def _stream(group: h5py.Group) -> Stream:
    time, value = _members(group, "time", "value")
    noise = group.attrs.get("noise")
    return Stream(time, value, None if noise is None else finite("noise", noise))


def _camera(group: h5py.Group) -> Camera:
    K, X_WC, distortion, size = _members(group, "K", "X_WC", "distortion", "size")
    whole_size: Any = tuple(int(n) if n.is_integer() else n for n in size.ravel().tolist())
    return Camera(K, X_WC, distortion, whole_size)
