"""Checks of what a recording states: shapes, types, finiteness, and facts stated twice."""

from collections.abc import Mapping
from dataclasses import fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import numpy as np

from form_drake.laws import law_named
from form_drake.laws.values import finite

if TYPE_CHECKING:
    from form_drake.records.recording import Camera, Recording, Stream

RIGID = 1e-3  # what a rotation matrix that is written with a few digits may be off by
MAPPINGS = ("known", "geometry", "contact", "poses", "forces", "cameras")


def check_arrays(record: Any, sizes: dict[str, int]) -> None:
    """Check shape, type and finiteness of every array field; kind ``n`` admits NaN.

    Raises:
        ValueError: naming the field, what was got and what is allowed.
    """
    for f in fields(record):
        if "dims" not in f.metadata:
            continue
        value, dims, kind = getattr(record, f.name), f.metadata["dims"], f.metadata["kind"]
        place = f.metadata["place"]
        if value is None:
            if "None" not in str(f.type):
                raise ValueError(f"{place}: missing")
            continue
        kinds = {"f": "f", "n": "f", "i": "iu", "b": "b"}[kind]
        if not isinstance(value, np.ndarray) or value.dtype.kind not in kinds:
            got = getattr(value, "dtype", type(value).__name__)
            raise ValueError(f"{place}: an array of {_words(kind)} is wanted, got {got}")
        wanted = tuple(int(d) if d.isdigit() else sizes.get(d, d) for d in dims)
        fits = value.ndim == len(dims) and all(
            isinstance(w, str) or w == n for w, n in zip(wanted, value.shape, strict=True)
        )
        if not fits or 0 in value.shape:
            words = ", ".join(str(w) for w in wanted)
            raise ValueError(f"{place}: shape [{words}] is wanted, got {list(value.shape)}")
        sizes.update({d: n for d, n in zip(dims, value.shape, strict=True) if not d.isdigit()})
        if kind == "f" and not np.isfinite(value).all():
            first = np.argwhere(~np.isfinite(value))[0].tolist()
            raise ValueError(f"{place}: not finite at index {first}")


def _words(kind: str) -> str:
    return {"f": "numbers", "n": "numbers", "i": "whole numbers", "b": "true or false"}[kind]


def check_statements(recording: "Recording") -> None:
    """Check the kinds of single numbers, words and names: what a file cannot hold, nobody states.

    Raises:
        ValueError: naming the statement, what was got and what is wanted.
    """
    for name in ("density", "noise", "mass_scale"):
        value = getattr(recording, name)
        if value is not None and not _number(value):
            raise ValueError(f"{name}: a number is wanted, got {_shown(value)}")
    for name in ("law", "source"):
        value = getattr(recording, name)
        if not isinstance(value, str if name == "source" else str | None) or "\0" in (value or ""):
            raise ValueError(f"{name}: words are wanted, got {_shown(value)}")
    for name in MAPPINGS:
        value = getattr(recording, name)
        if not isinstance(value, Mapping) or not all(isinstance(k, str) for k in value):
            raise ValueError(f"{name}: a mapping of names is wanted, got {_shown(value)}")
    for key, value in recording.known.items():
        finite(f"known {key}", value)
    for key, value in recording.geometry.items():
        if not isinstance(value, str) and not _number(value):
            raise ValueError(
                f"geometry {key}: words or a number are wanted, as '0 0 0.02', got {_shown(value)}"
            )
    for name in [*recording.poses, *recording.forces, *recording.cameras]:
        if not name or name == "." or "/" in name or "\0" in name:
            raise ValueError(f"{name!r} names no stream or camera: it must hold no slash")


def _number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    return repr(" ".join(str(value).split())[:60])


def check_stream(name: str, stream: "Stream", shape: tuple[int | str, ...]) -> None:
    """Check one stream's stamps and sample shape, of which words stand for any size."""
    if not all(hasattr(stream, part) for part in ("time", "value", "noise")):
        raise ValueError(f"{name}: a Stream is wanted, got {type(stream).__name__}")
    time, value = stream.time, stream.value
    if time.ndim == 1 and not len(time):
        raise ValueError(f"{name}: it holds no sample: leave it out")
    wanted = (len(time) if time.ndim == 1 else "samples", *shape)
    fits = value.ndim == len(wanted) and all(
        isinstance(w, str) or w == n for w, n in zip(wanted, value.shape, strict=True)
    )
    if time.ndim != 1 or not fits:
        raise ValueError(
            f"{name}: samples of shape {list(wanted)} are wanted, got {list(value.shape)}"
        )
    for part in (time, value):
        if part.dtype.kind not in "fiu":
            raise ValueError(f"{name}: numbers are wanted, got {part.dtype}")
    if stream.noise is not None and not _number(stream.noise):
        raise ValueError(f"{name}: noise must be a number, got {_shown(stream.noise)}")
    if stream.noise is not None and not 0 <= stream.noise < np.inf:
        raise ValueError(f"{name}: noise must be finite and not negative, got {stream.noise}")
    if not np.isfinite(time).all() or not np.isfinite(value).all() or np.any(np.diff(time) <= 0):
        raise ValueError(f"{name}: values must be finite and time stamps must increase")


def check_camera(name: str, camera: "Camera") -> None:
    """Check the shapes and numbers of a calibration."""
    parts = {"K": (3, 3), "X_WC": (4, 4), "distortion": (5,), "size": (2,)}
    if not all(hasattr(camera, part) for part in parts):
        raise ValueError(f"cameras/{name}: a Camera is wanted, got {type(camera).__name__}")
    found = {part: np.asarray(getattr(camera, part)) for part in parts}
    if {part: value.shape for part, value in found.items()} != parts:
        raise ValueError(
            f"cameras/{name}: K [3, 3], X_WC [4, 4], distortion [5] and size [2] are wanted"
        )
    if not all(v.dtype.kind in "fiu" and np.isfinite(v).all() for v in found.values()):
        raise ValueError(f"cameras/{name}: values must be finite")
    if not all(isinstance(n, Integral) and n > 0 for n in camera.size):
        raise ValueError(f"cameras/{name}: size: whole numbers of pixels are wanted")
    check_rigid(f"cameras/{name}/X_WC", found["X_WC"][None])


def check_rigid(name: str, poses: np.ndarray) -> None:
    """Refuse homogeneous matrices, shape [samples, 4, 4], that do not move a body rigidly."""
    R = poses[:, :3, :3]
    off = np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    off = np.maximum(off, np.abs(poses[:, 3] - np.eye(4)[3]).max(axis=1))
    wrong = ~((off <= RIGID) & (np.linalg.det(R) > 0.0))
    if wrong.any():
        raise ValueError(
            f"{name}: sample {int(wrong.argmax())} is no pose: a rotation and a place in the first three"
            " rows and 0 0 0 1 in the last are wanted"
        )


def check_consistency(recording: "Recording") -> None:
    """Refuse facts that are stated twice and differently, and a law that does not exist.

    Raises:
        ValueError: naming both statements.
    """
    if recording.law is not None:
        law_named(recording.law)
    solver = recording.solver
    if solver is None:
        return
    if recording.gravity is not None and not np.allclose(recording.gravity, solver.gravity):
        raise ValueError(f"gravity {recording.gravity} and the solver's {solver.gravity} differ")
    if solver.dt is not None and recording.step is not None:
        stated = recording.time - recording.time[0]
        stepped_time = (recording.step - recording.step[0]) * solver.dt
        if not np.allclose(stated, stepped_time, rtol=1e-4, atol=1e-2 * solver.dt):
            i = int(np.argmax(np.abs(stated - stepped_time)))
            raise ValueError(
                f"frame {i} is stamped {stated[i]:.6g} s after the first, its solver step"
                f" says {stepped_time[i]:.6g} s"
            )
