"""Trajectories of NCLaw as files: arrays and metadata are read, and refused where they are wrong."""

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from form_drake import read
from helpers.files import ENTRY, N, assert_same, nclaw_arrays, refused, write_nclaw


def flipped(data):
    """Some bytes in the middle are other ones."""
    middle = len(data) // 2
    return data[:middle] + bytes(255 - b for b in data[middle : middle + 64]) + data[middle + 64 :]


def test_nclaw_trajectories_are_read(tmp_path):
    arrays = nclaw_arrays()
    recording = read(write_nclaw(tmp_path, arrays))
    np.testing.assert_array_equal(recording.p_WQ, arrays["x"])
    np.testing.assert_array_equal(recording.v_0, arrays["v0"])
    np.testing.assert_allclose(recording.time, 5e-4 * np.arange(8), rtol=1e-15)
    assert recording.density == 900.0 and recording.law is None and not recording.known
    solver = recording.solver
    assert (solver.dx, solver.nodes, solver.dt) == (0.05, (20, 20, 20), 5e-4)
    assert (solver.gradient, solver.decomposition) == ("mls", "svd3")
    # nodes i < 3 and i > 17 belong to the walls
    walls = {(w.axis, w.side): w.position for w in solver.walls}
    assert walls == {(a, s): pytest.approx(p) for a in range(3) for s, p in ((-1, 0.1), (1, 0.9))}


def test_nclaw_states_are_merged_by_step(tmp_path):
    arrays = nclaw_arrays()
    states = read(write_nclaw(tmp_path, arrays)).states
    assert states.step.tolist() == [1, 2, 3, 4, 5, 6]
    assert states.pairs() == [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)]
    np.testing.assert_array_equal(states.x, arrays["x"][1:7])
    np.testing.assert_array_equal(states.F[4], arrays["pair_F"][1, 0])
    np.testing.assert_array_equal(states.C[2], arrays["block_C"][1])
    stressed = np.isfinite(states.tau).all(axis=(1, 2, 3))
    assert states.step[stressed].tolist() == [1, 5]
    np.testing.assert_array_equal(states.tau[0], arrays["pair_tau"][0])


def without_key(mapping, *names):
    return {k: v for k, v in mapping.items() if k not in names}


ARRAYS = {
    "no positions": (lambda a: without_key(a, "x"), "array 'x' is missing"),
    "no velocities": (lambda a: without_key(a, "v0"), "array 'v0' is missing"),
    "no pair_v": (lambda a: without_key(a, "pair_v"), "array 'pair_v' is missing"),
    "no block_F": (lambda a: without_key(a, "block_F"), "array 'block_F' is missing"),
    "unknown": (lambda a: {**a, "colour": np.zeros(3)}, "unknown array 'colour'; known: x, v0"),
    "wrong shape": (lambda a: {**a, "v0": a["v0"][:2]}, "v0: shape .* is wanted, got"),
    "wrong dimensions": (lambda a: {**a, "x": a["x"][0]}, "x: shape .* is wanted, got"),
    "no particles": (lambda a: {**a, "v0": a["v0"][:0]}, "v0: shape"),
    "NaN": (lambda a: {**a, "v0": a["v0"] * np.nan}, "v0: not finite at index"),
    "strings": (lambda a: {**a, "v0": a["v0"].astype(str)}, "v0: numbers are wanted"),
    "complex": (lambda a: {**a, "v0": a["v0"] + 1j}, "v0: numbers are wanted"),
    "whole numbers": (lambda a: {**a, "x": np.zeros((8, N, 3), int)}, "an array of numbers"),
    "frames back": (lambda a: {**a, "frames": a["frames"][::-1].copy()}, "must increase"),
    "lost pair": (lambda a: {**a, "pair_frames": np.array([[1, 2], [50, 51]])}, "at step 50"),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_wrong_npz_arrays_are_refused(tmp_path, case):
    change, message = ARRAYS[case]
    refused(write_nclaw(tmp_path, change(nclaw_arrays())), message)


class Payload:
    """Unpickling it would make a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_pickled_arrays_are_never_loaded(tmp_path):
    mark = tmp_path / "mark"
    hostile = np.empty(1, dtype=object)
    hostile[0] = Payload(mark)
    refused(write_nclaw(tmp_path, {**nclaw_arrays(), "v0": hostile}), "never unpickled")
    (tmp_path / "a.npz").write_bytes(pickle.dumps(Payload(mark)))
    refused(tmp_path / "a.npz", "not a readable npz")
    assert not mark.exists()
    pickle.loads(pickle.dumps(Payload(mark)))
    assert mark.exists()  # the payload is live


def npy(shape, data=b"", dtype="<f8"):
    """Bytes of an npy file that declares what it likes."""
    stream = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + data


ENTRIES = {
    "terabytes": npy((10**6, 10**6, 3)),
    "short": npy((2, 3), bytes(40)),
    "long": npy((2, 3), bytes(50)),
    "negative": npy((-1, 3)),
    "no header": b"",
    "bad header": b"\x93NUMPY\x01\x00\x10\x00{'descr': import }",
    "version 9": b"\x93NUMPY\x09\x00" + npy((2, 3), bytes(48))[8:],
    "nested header": b"\x93NUMPY\x01\x00\xd0\x07" + b"(" * 2000,
}


@pytest.mark.parametrize("case", ENTRIES)
@pytest.mark.parametrize("packed", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_npz_entries_that_lie_are_refused(tmp_path, case, packed):
    path = write_nclaw(tmp_path, without_key(nclaw_arrays(), "v0"))
    with zipfile.ZipFile(path, "a", packed) as archive:
        archive.writestr("v0.npy", ENTRIES[case])
    refused(path, "v0: (declares|not a plain array)")


def test_damaged_npz_data_are_refused(tmp_path):
    path = write_nclaw(tmp_path)
    np.savez_compressed(path, **nclaw_arrays())
    path.write_bytes(flipped(path.read_bytes()))
    refused(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        for name, value in nclaw_arrays().items():
            with archive.open(f"{name}.npy", "w") as entry:
                np.save(entry, value)
    path.write_bytes(flipped(path.read_bytes()))
    refused(path)


METADATA = {
    "not JSON": ("{", "not valid json"),
    "list": ("[]", "a mapping of names to values is wanted"),
    "deep": ("[" * 100_000, "not valid json"),
    "no entry": ("{}", "no entry for a.npz"),
    "entry is a list": ('{"a.npz": []}', "no entry for a.npz"),
    "empty": ("", "the file is empty"),
    "huge number": ('{"a.npz": {"n_particles": 1' + "0" * 5000 + "}}", "metadata.json"),
}


@pytest.mark.parametrize("case", METADATA)
def test_broken_metadata_are_refused(tmp_path, case):
    text, message = METADATA[case]
    path = write_nclaw(tmp_path)
    (tmp_path / "metadata.json").write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read(path)
    assert "\n" not in str(caught.value) and "metadata.json" in str(caught.value)


def test_missing_metadata_are_named(tmp_path):
    path = write_nclaw(tmp_path)
    (tmp_path / "metadata.json").unlink()
    with pytest.raises(ValueError, match=r"metadata\.json: no such file"):
        read(path)


WRONG = (None, "many", [1], {}, float("nan"), float("inf"), True)
NUMBERS = [k for k, v in ENTRY.items() if isinstance(v, int | float)]


@pytest.mark.parametrize(
    "key, value",
    [(k, v) for k in ENTRY if k != "law" for v in WRONG] + [(k, -1) for k in NUMBERS],
)
def test_wrong_metadata_values_are_refused(tmp_path, key, value):
    refused(write_nclaw(tmp_path, entry={**ENTRY, key: value}))


@pytest.mark.parametrize("key", [k for k in ENTRY if k != "law"])
def test_missing_metadata_values_are_refused(tmp_path, key):
    refused(write_nclaw(tmp_path, entry=without_key(ENTRY, key)), key)


def test_the_law_entry_is_never_looked_up(tmp_path):
    given = read(write_nclaw(tmp_path))
    assert_same(read(write_nclaw(tmp_path, entry={**ENTRY, "law": "nonsense"})), given)
    assert_same(read(write_nclaw(tmp_path, entry=without_key(ENTRY, "law"))), given)
