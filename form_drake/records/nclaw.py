"""Reader of the NCLaw trajectories: ``<name>.npz`` with ``metadata.json`` beside it.

Geometry, grid, step, density and walls come from the metadata. Its ``law`` entry, which states the
true parameters, is never looked up. The generator's own rounding is part of its data, so its solver
is named as it was: float32, Warp's built-in SVD, the moving-least-squares gradient.
"""

import lzma
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.files import existing, read_mapping
from form_drake.laws.values import finite
from form_drake.records.recording import Recording, States
from form_drake.records.solver import Solver, Wall

LARGEST = 2_000_000_000
BROKEN = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    OSError,
    EOFError,
    KeyError,
    RuntimeError,
    MemoryError,
)
BOUNDARY = "separating free slip, wall nodes i<3 and i>grid_cells-3"
SHAPES = {
    "x": ("frames", "N", 3),
    "v0": ("N", 3),
    "frames": ("frames",),
    "pair_frames": ("pairs", 2),
    "pair_v": ("pairs", 2, "N", 3),
    "pair_C": ("pairs", 2, "N", 3, 3),
    "pair_F": ("pairs", 2, "N", 3, 3),
    "pair_tau": ("pairs", "N", 3, 3),
    "block_frames": ("block",),
    "block_v": ("block", "N", 3),
    "block_C": ("block", "N", 3, 3),
    "block_F": ("block", "N", 3, 3),
}


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The npz file's arrays, after names, types, sizes, shapes and values are checked.

    Raises:
        ValueError: one line that says what is wrong; nothing is unpickled.
    """
    with existing(path).open("rb") as start:
        if start.read(2) != b"PK":
            raise ValueError(f"{path}: not a readable npz file (it is no zip archive)")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_headers(path, archive)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except BROKEN as error:
        detail = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: not a readable npz file ({detail})") from None
    _check_shapes(path, arrays)
    return arrays


def _check_headers(path: Path, archive: zipfile.ZipFile) -> None:
    total = 0
    for info in archive.infolist():
        name = info.filename.removesuffix(".npy")
        if name not in SHAPES:
            raise ValueError(f"{path}: unknown array {name[:60]!r}; known: {', '.join(SHAPES)}")
        with archive.open(info) as member:
            try:
                version = np.lib.format.read_magic(member)
                reader = {
                    (1, 0): np.lib.format.read_array_header_1_0,
                    (2, 0): np.lib.format.read_array_header_2_0,
                }[version]
                shape, _, dtype = reader(member)
                header = member.tell()
            except (ValueError, TypeError, SyntaxError, tokenize.TokenError, *BROKEN) as error:
                raise ValueError(
                    f"{path}: {name}: not a plain array ({str(error)[:120]})"
                ) from None
        if dtype.hasobject or dtype.kind not in "fi":
            raise ValueError(f"{path}: {name}: numbers are wanted, got {dtype}; never unpickled")
        size = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if header + size != info.file_size:
            held = info.file_size - header
            raise ValueError(f"{path}: {name}: declares {size} bytes of data, holds {held}")
        total += size
        if total > LARGEST:
            raise ValueError(f"{path}: more than {LARGEST // 10**9} GB of data, not read")


def _check_shapes(path: Path, arrays: dict[str, np.ndarray]) -> None:
    wanted_names = {"x", "v0"}
    if "pair_frames" in arrays:
        wanted_names |= {"pair_v", "pair_C", "pair_F", "pair_tau"}
    if "block_frames" in arrays:
        wanted_names |= {"block_v", "block_C", "block_F"}
    for name in sorted(wanted_names):
        if name not in arrays:
            raise ValueError(f"{path}: array {name!r} is missing")
    sizes: dict[str, int] = {}
    for name, array in arrays.items():
        wanted = SHAPES[name]
        named = [sizes.setdefault(w, n) if isinstance(w, str) else w
                 for w, n in zip(wanted, array.shape, strict=False)]  # fmt: skip
        if array.ndim != len(wanted) or tuple(named) != array.shape or 0 in array.shape:
            raise ValueError(
                f"{path}: {name}: shape {list(wanted)} is wanted, got {list(array.shape)}"
                f" (with {sizes})"
            )
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            first = np.argwhere(~np.isfinite(array))[0].tolist()
            raise ValueError(f"{path}: {name}: not finite at index {first}")


def read_metadata(path: Path) -> dict[str, Any]:
    """The entry of ``path`` in the metadata beside it, without its ``law``.

    Raises:
        ValueError: no metadata or no such entry.
    """
    metadata = read_mapping(path.with_name("metadata.json"))
    entry = metadata.get(path.name)
    if not isinstance(entry, dict):
        raise ValueError(f"{path.with_name('metadata.json')}: no entry for {path.name}")
    return {key: value for key, value in entry.items() if key != "law"}


def _solver(entry: dict[str, Any]) -> Solver:
    if entry.get("boundary") != BOUNDARY:
        raise ValueError(
            f"boundary {str(entry.get('boundary'))[:80]!r} is not known: {BOUNDARY!r} is"
        )
    nodes, bound = (int(finite(k, entry[k])) for k in ("grid_cells", "wall_bound"))
    dx = finite("dx", entry["dx"])
    gx, gy, gz = entry["gravity"]
    walls = tuple(
        Wall(axis, side, position)
        for axis in range(3)
        for side, position in ((-1, (bound - 1) * dx), (1, (nodes - bound + 1) * dx))
    )
    return Solver(
        dx=dx,
        nodes=(nodes, nodes, nodes),
        dt=finite("dt", entry["dt"]),
        gradient="mls",
        decomposition="svd3",
        precision="float32",
        walls=walls,
        mass_eps=finite("mass_eps", entry["mass_eps"]),
        margin=finite("position_clip_in_dx", entry["position_clip_in_dx"]),
        gravity=(finite("gravity", gx), finite("gravity", gy), finite("gravity", gz)),
    )


def _states(arrays: dict[str, np.ndarray], step: np.ndarray) -> States | None:
    """The state pairs and the consecutive block, merged by step."""
    where = {int(s): i for i, s in enumerate(step)}
    found: dict[int, tuple[np.ndarray, ...]] = {}
    missing = np.full((arrays["x"].shape[1], 3, 3), np.nan, dtype=np.float32)
    if "block_frames" in arrays:
        for i, n in enumerate(arrays["block_frames"]):
            state = tuple(arrays[f"block_{k}"][i] for k in ("v", "C", "F"))
            found[int(n)] = (*state, missing)
    if "pair_frames" in arrays:
        for i, pair in enumerate(arrays["pair_frames"]):
            for j, n in enumerate(pair):
                state = tuple(arrays[f"pair_{k}"][i, j] for k in ("v", "C", "F"))
                old = found.get(int(n), (missing,) * 4)[3]
                found[int(n)] = (*state, arrays["pair_tau"][i] if j == 0 else old)
    if not found:
        return None
    absent = [n for n in found if n not in where]
    if absent:
        raise ValueError(f"states at step {absent[0]}, of which no positions are recorded")
    order = sorted(found)
    v, C, F, tau = (np.stack([found[n][k] for n in order]) for k in range(4))
    x = arrays["x"][[where[n] for n in order]]
    return States(step=np.array(order), x=x, v=v, C=C, F=F, tau=tau)


def read_nclaw(path: Path) -> Recording:
    """A shared NCLaw trajectory as a recording.

    Raises:
        ValueError: one line that says what is wrong with the file or its metadata.
    """
    arrays, entry = read_arrays(path), read_metadata(path)
    frames = arrays.get("frames", np.arange(len(arrays["x"])))
    points = arrays["x"].shape[1]
    try:
        if finite("n_particles", entry["n_particles"]) != points:
            raise ValueError(f"{entry['n_particles']} particles stated, the file holds {points}")
        solver = _solver(entry)
        return Recording(
            time=frames * solver.dt,
            p_WQ=arrays["x"],
            v_0=arrays["v0"],
            volume=np.full(points, finite("particle_volume", entry["particle_volume"])),
            density=finite("density", entry["density"]),
            gravity=np.array(solver.gravity),
            step=frames,
            solver=solver,
            states=_states(arrays, frames),
            source=f"NCLaw trajectory {path.name}",
        )
    except KeyError as error:
        raise ValueError(f"{path}: the metadata lack {error}") from None
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None
