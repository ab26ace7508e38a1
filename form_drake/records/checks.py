"""Checks of what a recording states: shapes, types, finiteness, and facts stated twice."""

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from form_drake.laws import law_named

if TYPE_CHECKING:
    from form_drake.records.recording import Recording, Stream


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


def check_stream(name: str, stream: "Stream", shape: tuple[int, ...]) -> None:
    """Check one stream's stamps and sample shape."""
    time, value = np.asarray(stream.time), np.asarray(stream.value)
    if time.ndim != 1 or value.shape != (len(time), *shape):
        raise ValueError(
            f"{name}: samples of shape {[len(time), *shape]} are wanted, got {list(value.shape)}"
        )
    if stream.noise is not None and not 0 <= stream.noise < np.inf:
        raise ValueError(f"{name}: noise must be finite and not negative, got {stream.noise}")
    if not np.isfinite(time).all() or not np.isfinite(value).all() or np.any(np.diff(time) <= 0):
        raise ValueError(f"{name}: values must be finite and time stamps must increase")


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
