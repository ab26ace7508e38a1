"""How files are refused and records compared, and a small trajectory of NCLaw."""

import json
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from form_drake import read
from form_drake.records import nclaw


def assert_same(a, b):
    """Equal values, types of arrays and fields of records, all the way down."""
    assert type(a) is type(b)
    if is_dataclass(a):
        for f in fields(a):
            assert_same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    else:
        assert a == b


def refused(path, match=None, reader=read):
    """The one line with which a reader refuses a file; it names the file."""
    with pytest.raises(ValueError, match=match) as caught:
        reader(path)
    text = str(caught.value)
    assert "\n" not in text and len(text) < 500
    assert path.name in text
    return text


N = 4


def nclaw_arrays():
    """Arrays as in the shared trajectories, of a few particles."""
    rng = np.random.default_rng(2)

    def some(*shape):
        return rng.normal(size=shape).astype(np.float32)

    frames = np.arange(8)
    arrays = {"x": some(8, N, 3), "v0": some(N, 3), "frames": frames}
    arrays |= {"pair_frames": np.array([[1, 2], [5, 6]]), "block_frames": np.arange(2, 5)}
    for name, shape in (("v", (N, 3)), ("C", (N, 3, 3)), ("F", (N, 3, 3))):
        arrays[f"pair_{name}"] = some(2, 2, *shape)
        arrays[f"block_{name}"] = some(3, *shape)
    return arrays | {"pair_tau": some(2, N, 3, 3)}


ENTRY = {
    "n_particles": N,
    "particle_volume": 1e-4,
    "density": 900.0,
    "dt": 5e-4,
    "grid_cells": 20,
    "dx": 0.05,
    "wall_bound": 3,
    "gravity": [0, -9.8, 0],
    "boundary": nclaw.BOUNDARY,
    "mass_eps": 1e-7,
    "position_clip_in_dx": 0.5,
    "law": {"E": 1.0},
}


def write_nclaw(folder, arrays=None, entry=None):
    """``a.npz`` with ``metadata.json`` beside it."""
    np.savez(folder / "a.npz", **(nclaw_arrays() if arrays is None else arrays))
    (folder / "metadata.json").write_text(json.dumps({"a.npz": entry or ENTRY}))
    return folder / "a.npz"
