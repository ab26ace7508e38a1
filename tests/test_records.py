"""Recordings and materials as files: what is written comes back, what is broken is refused."""

import io
import json
import pickle
import zipfile
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from form_drake import LAWS, Material, Recording, Solver, Wall, read, read_material
from form_drake.files import whole_folder
from form_drake.records import Camera, States, Stream, framed, nclaw, write_recording

FRAMES, POINTS = 6, 5


def full_recording():
    """A recording with every field."""
    rng = np.random.default_rng(0)
    samples = np.linspace(0.0, 1.0, 4)
    square = rng.normal(size=(2, POINTS, 3, 3))
    valid = np.ones((FRAMES, POINTS), bool)
    valid[1, 2] = False
    p_WQ = rng.normal(size=(FRAMES, POINTS, 3))
    p_WQ[1, 2] = np.nan
    return Recording(
        time=np.arange(FRAMES) * 0.1,
        p_WQ=p_WQ,
        valid=valid,
        visible=rng.random((FRAMES, POINTS)) < 0.5,
        face=np.array([0, 1, -1, 3, 5]),
        covariance=np.tile(np.diag([1e-12, 1e-12, 4e-12]), (POINTS, 1, 1)),
        p_reference=rng.normal(size=(POINTS, 3)),
        v_0=rng.normal(size=(POINTS, 3)),
        pressure=rng.normal(size=(FRAMES, POINTS)),
        body_force=rng.normal(size=(FRAMES, POINTS, 3)),
        volume=rng.uniform(1.0, 2.0, POINTS),
        gravity=np.array([0.0, 0.1, -9.0]),
        step=np.arange(FRAMES) * 1000,
        rest=np.array([[0.0, 0.1], [0.4, 0.5]]),
        noise=2e-5,
        density=1050.0,
        solver=Solver(
            dx=0.02,
            nodes=(20, 21, 22),
            dt=1e-4,
            gradient="mls",
            decomposition="svd3",
            precision="float64",
            walls=(Wall(2, -1, 0.05, "stick"), Wall(0, 1, 0.3)),
            mass_eps=1e-9,
            margin=0.5,
            gravity=(0.0, 0.1, -9.0),
        ),
        states=States(
            step=np.array([7, 8]),
            x=rng.normal(size=(2, POINTS, 3)),
            v=rng.normal(size=(2, POINTS, 3)).astype(np.float32),
            C=square,
            F=square + np.eye(3),
            L=-square,
            tau=np.where(np.arange(2)[:, None, None, None] == 0, square, np.nan),
        ),
        law="fixed-corotated",
        known={"nu": 0.3},
        poses={"finger": Stream(samples, np.tile(np.eye(4), (4, 1, 1)))},
        forces={"finger": Stream(samples, rng.normal(size=(4, 3)), noise=0.02)},
        joints=Stream(samples, rng.normal(size=(4, 7))),
        cameras={"left": Camera(np.eye(3), np.eye(4), np.zeros(5), (640, 480))},
        geometry={"shape": "box", "size": "0.06 0.06 0.06 m"},
        contact={"z-": "bonded floor"},
        source="made here",
    )


def small_recording():
    """A recording with nothing that may be missing."""
    p_WQ = np.random.default_rng(1).normal(size=(FRAMES, POINTS, 3))
    return Recording(time=np.arange(FRAMES) * 0.1, p_WQ=p_WQ)


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


@pytest.mark.parametrize("make", [full_recording, small_recording])
def test_hdf5_keeps_every_field(tmp_path, make):
    recording = make()
    write_recording(recording, tmp_path / "a.h5")
    assert_same(read(tmp_path / "a.h5"), recording)
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]


def test_the_full_recording_is_full():
    recording = full_recording()
    assert all(getattr(recording, f.name) is not None for f in fields(recording))


def test_unknown_noise_is_not_zero_noise(tmp_path):
    for noise in (None, 0.0):
        write_recording(replace(small_recording(), noise=noise), tmp_path / "a.h5")
        assert read(tmp_path / "a.h5").noise == noise


def test_datasets_state_unit_and_dimensions(tmp_path):
    write_recording(full_recording(), tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["points/p_WQ"].attrs["unit"] == "m"
        assert file["states/tau"].attrs["dims"] == "states points 3 3"
        assert file.attrs["form_drake_recording"] == 1


def test_from_arrays_takes_plain_lists():
    recording = Recording.from_arrays(
        [0, 1], [[[0, 0, 0]], [[0, 0, 1]]], face=[-1], valid=[[True], [True]], density=1000.0
    )
    assert recording.p_WQ.dtype == float and recording.face.dtype.kind == "i"
    assert (recording.frames, recording.points) == (2, 1)


class Broken(dict):
    """Cameras that fail while they are written."""

    def items(self):
        raise RuntimeError("the disk is full")


@pytest.mark.parametrize("old", [None, b"older content"])
def test_a_failed_write_leaves_what_was_there(tmp_path, old):
    path = tmp_path / "a.h5"
    if old:
        path.write_bytes(old)
    recording = small_recording()
    object.__setattr__(recording, "cameras", Broken())
    with pytest.raises(RuntimeError, match="disk"):
        write_recording(recording, path)
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([old] if old else [])


def test_a_folder_is_replaced_as_a_whole_or_not_at_all(tmp_path):
    run = tmp_path / "runs" / "x"
    for name in ("first", "second"):
        with whole_folder(run) as folder:
            (folder / name).write_text(name)
    assert {p.name for p in run.iterdir() if p.name[0] != "."} == {"second"}
    with pytest.raises(RuntimeError), whole_folder(run) as folder:
        (folder / "third").write_text("")
        raise RuntimeError
    assert (run / "second").read_text() == "second"
    assert [p.name for p in run.parent.iterdir()] == ["x"]


def test_a_folder_that_no_run_has_made_is_not_replaced(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="no earlier run has made"), whole_folder(tmp_path):
        pass
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


NAN3 = np.full((FRAMES, POINTS, 3), np.nan)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"p_WQ": np.zeros((FRAMES, POINTS, 2))}, "points/p_WQ: shape .* is wanted, got"),
        ({"p_WQ": np.zeros((FRAMES + 1, POINTS, 3))}, "points/p_WQ: shape"),
        ({"p_WQ": np.zeros((FRAMES, 0, 3))}, "points/p_WQ: shape"),
        ({"p_WQ": NAN3}, "frame 0, point 0 is not finite; mark it in 'valid'"),
        ({"p_WQ": np.zeros((FRAMES, POINTS, 3), int)}, "an array of numbers is wanted, got int64"),
        ({"p_WQ": np.full((FRAMES, POINTS, 3), "a")}, "an array of numbers is wanted, got <U1"),
        ({"p_WQ": [[0.0]]}, "an array of numbers is wanted, got list"),
        ({"time": np.arange(FRAMES) % 2 * 1.0}, "time stamps must increase"),
        ({"time": np.full(FRAMES, np.inf)}, "points/time: not finite at index"),
        ({"time": None}, "points/time: missing"),
        ({"valid": np.ones((FRAMES, POINTS))}, "true or false is wanted, got float64"),
        ({"covariance": np.zeros((POINTS, 3, 3))}, "points/covariance: every matrix"),
        ({"face": np.zeros(POINTS)}, "whole numbers is wanted, got float64"),
        ({"face": np.zeros(POINTS + 1, int)}, "points/face: shape"),
        ({"face": np.full(POINTS, 6)}, "points/face: -1 to 5 are allowed, got 6"),
        ({"face": np.full(POINTS, -2)}, "points/face: -1 to 5 are allowed, got -2"),
        (
            {"contact": {"bottom": "free"}},
            "contact: no face 'bottom'; allowed are x-, .* and other",
        ),
        ({"contact": {"z-": 5}}, "contact z-: words such as .* are wanted, got 5"),
        ({"contact": {"other": ["free"]}}, r"contact other: words .* got \['free'\]"),
        ({"step": np.zeros(FRAMES, int)}, "points/step: steps must increase"),
        ({"volume": np.zeros(POINTS)}, "volume: must be positive"),
        ({"density": -1.0}, "density: must be positive"),
        ({"density": np.inf}, "density: must be positive and finite"),
        ({"noise": -1e-3}, "noise: must be finite and not negative"),
        ({"noise": np.nan}, "noise: must be finite and not negative"),
        ({"v_0": np.full((POINTS, 3), np.nan)}, "points/v_0: not finite"),
        ({"forces": {"f": Stream(np.arange(2.0), np.zeros((2, 4)))}}, "f: samples of shape"),
        ({"joints": Stream(np.zeros(2), np.zeros((2, 7)))}, "time stamps must increase"),
        ({"poses": {"a/b": Stream(np.arange(2.0), np.zeros((2, 4, 4)))}}, "no slash"),
        ({"known": {"kappa": np.inf}}, "known kappa: a finite number is wanted, got 'inf'"),
        ({"known": {"kappa": "abc"}}, "known kappa: a finite number is wanted, got 'abc'"),
        ({"geometry": {"low": np.zeros(3)}}, "geometry low: words or a number are wanted"),
        ({"density": "1000"}, "density: a number is wanted, got '1000'"),
        ({"density": np.ones(POINTS)}, "density: a number is wanted"),
        ({"noise": True}, "noise: a number is wanted, got 'True'"),
        ({"law": 5}, "law: words are wanted, got '5'"),
        ({"source": None}, "source: words are wanted, got 'None'"),
        ({"contact": ["z-"]}, "contact: a mapping of names is wanted"),
        ({"forces": {3: None}}, "forces: a mapping of names is wanted"),
        ({"forces": {"f": (np.arange(2.0), np.zeros((2, 3)))}}, "f: a Stream is wanted, got tuple"),
        ({"forces": {"f": Stream(np.arange(2.0), 1j * np.ones((2, 3)))}}, "got complex128"),
        ({"forces": {"f": Stream(np.arange(2.0), [["a"] * 3] * 2)}}, "numbers are wanted, got <U1"),
        ({"joints": Stream(np.arange(2.0), np.zeros(2))}, r"samples of shape \[2, 'joints'\]"),
        ({"cameras": {"a": 1}}, "cameras/a: a Camera is wanted, got int"),
    ],
)
def test_recordings_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(small_recording(), **changes)


POSE = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    "wrong", [POSE.T, 0.0 * POSE, POSE * [[-1], [1], [1], [1]], POSE * [2, 2, 2, 1], 2.0 * POSE]
)
def test_poses_are_rigid(wrong):
    time, right = np.arange(3.0), np.stack([POSE] * 3)
    assert replace(small_recording(), poses={"plate": Stream(time, right)}).poses
    with pytest.raises(
        ValueError, match="poses/plate: sample 1 is no pose: a rotation and a place"
    ):
        right[1] = wrong
        replace(small_recording(), poses={"plate": Stream(time, right)})
    camera = Camera(np.eye(3), wrong, np.zeros(5), (640, 480))
    with pytest.raises(ValueError, match="cameras/left/X_WC: sample 0 is no pose"):
        replace(small_recording(), cameras={"left": camera})


def test_numbers_of_numpy_are_written(tmp_path):
    known, dx = {"kappa": np.float32(2.0)}, np.float64(0.1)
    solver = Solver(dx=dx, nodes=tuple(np.array([10, 10, 10])))
    made = replace(small_recording(), known=known, solver=solver, density=np.float32(900.0))
    write_recording(made, tmp_path / "a.h5")
    back = read(tmp_path / "a.h5")
    assert (back.known, back.solver, back.density) == ({"kappa": 2.0}, solver, 900.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"dx": 0.0},
        {"dx": np.nan},
        {"dx": "0.1"},
        {"dt": -1e-4},
        {"dt": np.inf},
        {"nodes": (2, 2, 2)},
        {"nodes": (2000, 2000, 2000)},
        {"nodes": (10, 10)},
        {"nodes": (10.0, 10.0, 10.0)},
        {"nodes": (10.5, 10, 10)},
        {"gravity": (0.0, 0.0)},
        {"gravity": (0.0, 0.0, np.nan)},
        {"margin": -1.0},
        {"mass_eps": -1.0},
        {"gradient": "best"},
        {"precision": "float16"},
        {"decomposition": "qr"},
    ],
)
def test_solver_settings_are_checked(changes):
    with pytest.raises(ValueError, match="solver settings"):
        replace(Solver(dx=0.1, nodes=(10, 10, 10)), **changes)


@pytest.mark.parametrize(
    "wall",
    [(3, 1, 0.1), (1.0, 1, 0.1), (0, 0, 0.1), (0, 1, np.nan), (0, 1, "0"), (0, 1, 0.1, "sticky")],
)
def test_walls_are_checked(wall):
    with pytest.raises(ValueError, match="wall"):
        Wall(*wall)


def put(place, value):
    """Replaces what is at a place, a dataset on the way to it included."""

    def change(file, folder):
        parent = place.rpartition("/")[0]
        if isinstance(file.get(parent), h5py.Dataset):
            del file[parent]
        elif place in file:
            del file[place]
        file[place] = value

    return change


def attribute(name, value):
    """Replaces an attribute of the file."""

    def change(file, folder):
        file.attrs[name] = value

    return change


def solver_entry(**changes):
    """Changes solver settings as stored."""

    def change(file, folder):
        stored = json.loads(file.attrs["solver"])
        file.attrs["solver"] = json.dumps({**stored, **changes})

    return change


def without(place):
    """Removes a dataset or group."""

    def change(file, folder):
        del file[place]

    return change


def external_link(file, folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = np.array(file["points/p_WQ"])
    del file["points/p_WQ"]
    file["points/p_WQ"] = h5py.ExternalLink("other.h5", "x")


def soft_link(file, folder):
    file["elsewhere"] = np.array(file["points/p_WQ"])
    del file["points/p_WQ"]
    file["points/p_WQ"] = h5py.SoftLink("/elsewhere")


def virtual_dataset(file, folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = np.array(file["points/p_WQ"])
    layout = h5py.VirtualLayout((FRAMES, POINTS, 3), float)
    layout[:] = h5py.VirtualSource(folder / "other.h5", "x", (FRAMES, POINTS, 3))
    del file["points/p_WQ"]
    file.create_virtual_dataset("points/p_WQ", layout)


def external_dataset(file, folder):
    size = FRAMES * POINTS * 3 * 8
    (folder / "secret").write_bytes(bytes(size))
    del file["points/p_WQ"]
    external = [(str(folder / "secret"), 0, size)]
    file.create_dataset("points/p_WQ", (FRAMES, POINTS, 3), float, external=external)


def declared_only(shape):
    """A dataset that declares a shape and stores nothing."""

    def change(file, folder):
        del file["points/p_WQ"]
        file.create_dataset("points/p_WQ", shape, float, chunks=(1, POINTS, 3), fillvalue=0.0)

    return change


def bomb(file, folder):
    """8 GB declared, one chunk stored."""
    del file["points/p_WQ"]
    made = file.create_dataset("points/p_WQ", (60_000_000, POINTS, 3), float, chunks=(1, POINTS, 3))
    made[0] = 1.0


def cycle(file, folder):
    file["points/again"] = file["points"]


def doubling(file, folder):
    """Groups that hold each other twice: 2^40 paths."""
    group = file.create_group("g0")
    for n in range(1, 40):
        inner = file.create_group(f"g{n}")
        group["a"] = group["b"] = inner
        group = inner


HOSTILE = {
    "external link": (external_link, "links are not followed"),
    "soft link": (soft_link, "links are not followed"),
    "virtual dataset": (virtual_dataset, "only plain numbers"),
    "external dataset": (external_dataset, "only plain numbers"),
    "strings": (put("points/p_WQ", ["a", "b"]), "only plain numbers"),
    "opaque": (put("points/p_WQ", np.void(b"12345678")), "only plain numbers"),
    "references": (lambda f, _: put("r", f["points/time"].ref)(f, _), "only plain numbers"),
    "no data": (put("points/p_WQ", h5py.Empty("f")), "only plain numbers"),
    "named type": (put("type", np.dtype("f8")), "only plain numbers"),
    "complex": (put("points/p_WQ", np.zeros(3, complex)), "only plain numbers"),
    "declared only": (declared_only((FRAMES, POINTS, 3)), "only plain numbers"),
    "declared terabytes": (declared_only((10**12, POINTS, 3)), "only plain numbers"),
    "bomb": (bomb, "GB of data, not read"),
    "cycle": (cycle, "too many or too deep"),
    "doubling": (doubling, "too many or too deep"),
    "newer": (attribute("form_drake_recording", 2), "is '2'; this release reads version 1"),
    "versions": (attribute("form_drake_recording", [1, 1]), r"is '\[1 1\]'; this release reads"),
    "foreign": (lambda f, _: f.attrs.clear(), "is 'None'; this release reads version 1"),
    "NaN": (put("points/p_WQ", NAN3), "not finite"),
    "wrong shape": (put("points/p_WQ", np.zeros((FRAMES, POINTS))), "shape .* is wanted"),
    "float steps": (put("points/step", np.arange(FRAMES) * 0.5), "whole numbers is wanted"),
    "float mask": (put("points/valid", np.ones((FRAMES, POINTS))), "true or false is wanted"),
    "group for array": (put("points/p_WQ/x", 1.0), "an array is wanted, got a group"),
    "array for groups": (put("poses", np.zeros(3)), "a group is wanted, got an array"),
    "array for stream": (put("forces/finger", np.zeros(3)), "time, value is missing"),
    "array for joints": (put("joints", np.zeros(3)), "time, value is missing"),
    "no time": (without("points/time"), "points/time: missing"),
    "no samples": (without("forces/finger/value"), "value is missing"),
    "no states": (without("states/x"), "states/x: missing"),
    "camera": (put("cameras/left/K", np.zeros((2, 2))), "K .* wanted"),
    "camera size": (put("cameras/left/size", np.zeros(3)), "size .* wanted"),
    "noise": (attribute("noise", "loud"), "noise: a finite number"),
    "density": (attribute("density", np.nan), "density: a finite number"),
    "densities": (attribute("density", [1.0, 2.0]), "density: a finite number"),
    "known": (attribute("known", '{"nu": NaN}'), "nu: a finite number"),
    "geometry": (attribute("geometry", "[1"), "geometry: a mapping is wanted"),
    "contact": (attribute("contact", '{"z-": 5}'), "contact z-: words"),
    "contact twice": (attribute("contact", '{"z-": "free", "z-": "free"}'), "z- is given twice"),
    "misspelt": (
        put("points/vaild", np.zeros(3)),
        "unknown points/vaild: allowed are points/time,",
    ),
    "misplaced": (put("pionts/valid", np.zeros(3)), "unknown pionts/valid: allowed are cameras, "),
    "deep name": (put("poses/finger/x/value", np.zeros(3)), "unknown poses/finger/x/value"),
    "attribute": (attribute("densty", 2e3), "unknown attribute 'densty': allowed are known, "),
    "millimetres": (
        lambda f, _: f["points/p_WQ"].attrs.__setitem__("unit", "mm"),
        "points/p_WQ: the unit is m, got 'mm'",
    ),
    "camera of no size": (
        put("cameras/left/size", np.array([640.5, 480.0])),
        "whole numbers of pix",
    ),
    "faces": (put("points/face", np.full(POINTS, 99)), "points/face: -1 to 5"),
    "solver": (attribute("solver", "{}"), "solver: dx and nodes must be stated"),
    "solver nodes": (attribute("solver", '{"dx": 0.02}'), "solver: nodes must be stated"),
    "solver key": (solver_entry(warp=9), "solver: unknown entries warp"),
    "solver text": (solver_entry(dx="a"), "solver settings: finite numbers"),
    "solver infinite": (solver_entry(nodes=[np.inf] * 3), "solver settings: finite"),
    "solver flat": (solver_entry(dx=0.0), "solver settings: dx > 0"),
    "solver parts": (solver_entry(nodes=[20.9] * 3), "solver settings: whole node counts"),
    "solver words": (solver_entry(nodes="888"), "solver settings: finite numbers"),
    "solver truth": (solver_entry(dx=True), "solver settings: finite numbers"),
    "solver plane": (solver_entry(nodes=[20, 20]), "solver settings: three node counts"),
    "wall": (solver_entry(walls=[1]), "solver: "),
    "wall text": (solver_entry(walls=[{"axis": 0, "side": 1, "position": "a"}]), "wall position"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_hdf5_is_refused(tmp_path, case):
    change, message = HOSTILE[case]
    path = tmp_path / "a.h5"
    write_recording(full_recording(), path)
    with h5py.File(path, "a") as file:
        change(file, tmp_path)
    refused(path, message)


def truncated(data):
    return data[: len(data) // 2]


def flipped(data):
    """Some bytes in the middle are other ones."""
    middle = len(data) // 2
    return data[:middle] + bytes(255 - b for b in data[middle : middle + 64]) + data[middle + 64 :]


BYTES = {
    "empty": lambda data: b"",
    "truncated": truncated,
    "head only": lambda data: data[:20],
    "garbage": lambda data: b"not what it says\n" * 100,
    "pickle": lambda data: pickle.dumps({"x": 1}),
}


@pytest.mark.parametrize("case", BYTES)
@pytest.mark.parametrize("name", ["a.h5", "a.npz"])
def test_broken_files_are_refused(tmp_path, name, case):
    path = tmp_path / name
    if name == "a.h5":
        write_recording(full_recording(), path)
    else:
        write_nclaw(tmp_path)
    read(path)
    path.write_bytes(BYTES[case](path.read_bytes()))
    refused(path)


@pytest.mark.parametrize("name", ["a.h5", "a.npz", "a.yaml"])
def test_missing_files_and_folders_are_refused(tmp_path, name):
    reader = read_material if name == "a.yaml" else read
    refused(tmp_path / name, "no such file", reader)
    (tmp_path / name).mkdir()
    refused(tmp_path / name, "not a file", reader)


def test_unknown_endings_are_refused(tmp_path):
    refused(tmp_path / "a.csv", r"ends in .h5, .hdf5, .npz, not '.csv'")


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


def sample_material():
    covariance = np.array([[4.0, -1.0], [-1.0, 9.0]])
    return Material(
        LAWS["von-mises"],
        {"mu": 1234.5, "lam": 6789.0, "tau_y": 55.5},
        1000.0,
        ("mu", "lam"),
        covariance,
    )


def test_materials_come_back_as_written(tmp_path):
    material = sample_material()
    material.write(tmp_path / "a.yaml")
    again = read_material(tmp_path / "a.yaml")
    assert again.law is material.law
    assert (again.values, again.density, again.keys) == (
        material.values,
        material.density,
        material.keys,
    )
    np.testing.assert_array_equal(again.covariance, material.covariance)


HEAD = "form_drake_material: 1\nlaw: fixed-corotated\n"


def material_file(folder, text):
    (folder / "a.yaml").write_text(text)
    return folder / "a.yaml"


def test_engineering_constants_stand_for_lame_constants(tmp_path):
    text = HEAD + "parameters: {E: {value: 2.6e5, unit: Pa}, nu: 0.3}\n"
    values = read_material(material_file(tmp_path, text)).values
    assert values == pytest.approx({"mu": 1e5, "lam": 1.5e5}, rel=1e-12)


GOOD = HEAD + "parameters: {mu: 1.0, lam: 2.0}\n"
MATERIALS = {
    "both pairs": (HEAD + "parameters: {mu: 1.0, lam: 2.0, E: 3.0, nu: 0.3}", "not both"),
    "E alone": (HEAD + "parameters: {E: 3.0, lam: 2.0}", "E alone is given"),
    "nu of 0.5": (HEAD + "parameters: {E: 3.0, nu: 0.5}", "nu between -1 and 0.5"),
    "one missing": (HEAD + "parameters: {mu: 1.0}", "fixed-corotated needs a value for lam"),
    "unit": (HEAD + "parameters: {mu: {value: 1.0, unit: kPa}, lam: 2.0}", "mu: the unit is Pa"),
    "E's unit": (HEAD + "parameters: {E: {value: 1.0, unit: MPa}, nu: 0.3}", "E: the unit is Pa"),
    "unknown parameter": (HEAD + "parameters: {mu: 1.0, lam: 2.0, eta: 3.0}", "no parameter 'eta'"),
    "unknown entry": (GOOD + "colour: red", "unknown entries colour"),
    "NaN": (HEAD + "parameters: {mu: .nan, lam: 2.0}", "mu: a finite number"),
    "infinite": (HEAD + "parameters: {mu: -.inf, lam: 2.0}", "mu: a finite number"),
    "huge": (HEAD + "parameters: {mu: 1" + "0" * 400 + ", lam: 2.0}", "mu: a finite number"),
    "text": (HEAD + "parameters: {mu: soft, lam: 2.0}", "mu: a finite number"),
    "truth": (HEAD + "parameters: {mu: true, lam: 2.0}", "mu: a finite number"),
    "no value": (HEAD + "parameters: {mu: {unit: Pa}, lam: 2.0}", "mu: a finite number"),
    "parameters": (HEAD + "parameters: [1.0, 2.0]", "'parameters' must map names"),
    "law": (GOOD.replace("fixed-corotated", "rubber"), "unknown law 'rubber'"),
    "no law": (GOOD.replace("law: fixed-corotated", ""), "unknown law"),
    "newer": (GOOD.replace("material: 1", "material: 2"), "is '2'; this release reads version 1"),
    "no version": ("law: fixed-corotated", "is 'None'; this release reads version 1"),
    "list": ("- 1", "a mapping of names to values is wanted, got list"),
    "bare": ("mu", "a mapping of names to values is wanted, got str"),
    "not YAML": ("a: [", "not valid yaml"),
    "date": ("a: 2024-99-99", "not valid yaml"),
    "control": ("a: \x01", "not valid yaml"),
    "python tag": ("a: !!python/object/apply:os.getcwd []", "not valid yaml"),
    "tag": ("a: !thing 1", "not valid yaml"),
    "empty number": (HEAD + "parameters: {mu: !!int '', lam: 2.0}", "line 3: '' is no int"),
    "empty float": (HEAD + "parameters: {mu: !!float '', lam: 2.0}", "line 3: '' is no float"),
    "no truth": (GOOD + "density: !!bool x", "'x' is no bool"),
    "no time": (GOOD + "density: !!timestamp x", "'x' is no timestamp"),
    "key twice": (GOOD + "law: yeoh", "law is given twice in the entries from line 1 on: keep one"),
    "aliases": ("a: &a [1]\nb: *a", "aliases are not read"),
    "density": (GOOD + "density: -1.0", "density: must be positive"),
    "density unit": (GOOD + "density: {value: 1.0, unit: g/cm^3}", "density: the unit is kg/m"),
    "no density": (GOOD + "density: {unit: kg/m^3}", "density: a finite number"),
    "negative": (HEAD + "parameters: {mu: -1.0, lam: 2.0}", "mu: must be positive, got -1.0"),
    "zero": (HEAD + "parameters: {mu: 0.0, lam: 2.0}", "mu: must be positive, got 0.0"),
    "negative E": (HEAD + "parameters: {E: -1.0, nu: 0.3}", "E must be positive"),
    "negative bulk": (
        "form_drake_material: 1\nlaw: weakly-compressible\nparameters: {lam: -1.0}",
        "lam: must be positive",
    ),
    "negative viscosity": (
        "form_drake_material: 1\nlaw: newtonian\nparameters: {eta: -1.0, kappa: 1.0}",
        "eta: must be positive",
    ),
    "steeper than upright": (
        "form_drake_material: 1\nlaw: drucker-prager\nparameters: {mu: 1.0, lam: 2.0, alpha: 0.82}",
        r"alpha: must be below sqrt\(2/3\) = 0.8165, a friction angle of 90 deg, got 0.82",
    ),
    "no derived": (
        GOOD.replace("}", ", Y: {value: 1.0, derived: true}}"),
        "fixed-corotated has no derived 'Y': choose from E, nu, K",
    ),
    "parameter as derived": (
        HEAD + "parameters: {mu: 1.0, lam: {value: 2.0, derived: true}}",
        "needs a value for lam",
    ),
    "derived unit": (
        GOOD.replace("}", ", K: {value: 2.6, unit: kPa, derived: true}}"),
        "K: the unit is Pa",
    ),
    "derived text": (
        GOOD.replace("}", ", K: {value: stiff, derived: true}}"),
        "K: a finite number",
    ),
    "covariance": (GOOD + "covariance: 3", "covariance: "),
    "covariance keys": (GOOD + "covariance: {keys: 3, values: [[1]]}", "covariance: "),
    "covariance of others": (GOOD + "covariance: {keys: [eta], values: [[1]]}", "covariance: "),
    "covariance twice": (GOOD + "covariance: {keys: [mu, mu], values: [[1, 0], [0, 1]]}", "covar"),
    "covariance nested": (GOOD + "covariance: {keys: [[mu]], values: [[1]]}", "covariance: "),
    "covariance ragged": (GOOD + "covariance: {keys: [mu, lam], values: [[1], [1, 2]]}", "covar"),
    "covariance shape": (GOOD + "covariance: {keys: [mu, lam], values: [[1]]}", "covariance: "),
    "covariance NaN": (GOOD + "covariance: {keys: [mu], values: [[.nan]]}", "must be finite"),
    "covariance negative": (GOOD + "covariance: {keys: [mu], values: [[-1]]}", "not negative"),
    "covariance skew": (
        GOOD + "covariance: {keys: [mu, lam], values: [[1, 0.5], [-0.5, 1]]}",
        "must be symmetric",
    ),
}


@pytest.mark.parametrize("case", MATERIALS)
def test_wrong_materials_are_refused(tmp_path, case):
    text, message = MATERIALS[case]
    refused(material_file(tmp_path, text), message, read_material)


def test_the_material_behind_the_wrong_ones_is_right(tmp_path):
    material = read_material(material_file(tmp_path, GOOD))
    assert material.values == {"mu": 1.0, "lam": 2.0} and material.keys == ()


@pytest.mark.parametrize(
    "law, values",
    [
        ("fixed-corotated", {"mu": 3.0, "lam": -1.0}),
        ("mooney-rivlin", {"C10": 3.0, "C01": -1.0, "kappa": 9.0}),
        ("yeoh", {"C1": 3.0, "C2": -1.0, "C3": -0.5, "kappa": 9.0}),
        ("drucker-prager", {"mu": 3.0, "lam": 1.0, "alpha": 0.816}),
    ],
)
def test_signed_parameters_may_be_negative(tmp_path, law, values):
    Material(LAWS[law], values).write(tmp_path / "a.yaml")
    assert read_material(tmp_path / "a.yaml").values == values


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_all_other_parameters_are_positive(law):
    values = dict.fromkeys(law.keys, 0.5)
    material = Material(law, values)
    refused_keys = set()
    for key in law.keys:
        try:
            material.changed({key: -1.0})
        except ValueError as error:
            assert str(error) == f"{key}: must be positive, got -1.0"
            refused_keys.add(key)
    signed = {t.key for t in law.terms if t.signed}
    assert refused_keys == set(law.keys) - signed and signed <= {"C01", "C2", "C3", "lam"}


@pytest.mark.parametrize("alpha", [-9.0, -np.sqrt(8 / 3), -0.5, 0.0, np.sqrt(2 / 3), 0.9, 1e9])
def test_an_identified_cone_always_has_an_angle(alpha):
    values = {"mu": 1.0, "lam": 2.0, "alpha": float(alpha)}
    material = Material(LAWS["drucker-prager"], values, None, ("alpha",), np.eye(1))
    angle = material.parameters()["friction_angle"]
    assert np.isfinite([angle.value, angle.std]).all()
    assert abs(angle.value) <= np.pi / 2


@pytest.mark.parametrize(
    ("law", "values", "told"),
    [
        ("fixed-corotated", {"mu": 3.0, "lam": -3.0}, "bulk modulus -1 Pa: must be positive"),
        ("drucker-prager", {"mu": 3.0, "lam": -5.0, "alpha": 0.3}, "bulk modulus -3 Pa"),
        ("mooney-rivlin", {"C10": 1.0, "C01": -3.0, "kappa": 9.0}, "shear modulus -4 Pa"),
    ],
)
def test_a_body_that_gives_way_is_written_and_not_read(tmp_path, law, values, told):
    keys = tuple(values)
    material = Material(LAWS[law], values, 900.0, keys, np.eye(len(keys)))
    material.write(tmp_path / "a.yaml")
    assert "E" not in material.to_json() if values.get("lam") == -3.0 else "E" in material.to_json()
    refused(tmp_path / "a.yaml", told, read_material)


@pytest.mark.parametrize("key", ["E", "nu", "K", "Y"])
@pytest.mark.parametrize("factor", [1.0 + 5e-7, 1.0 + 2e-6, 2.0])
def test_an_edited_derived_value_is_refused(tmp_path, key, factor):
    sample_material().write(tmp_path / "a.yaml")
    value = sample_material().parameters()[key].value
    text = (tmp_path / "a.yaml").read_text()
    assert text.count(repr(float(value))) == 1
    path = material_file(tmp_path, text.replace(repr(float(value)), repr(float(value * factor))))
    if factor < 1.0 + 1e-6:
        assert read_material(path).values == sample_material().values
    elif key == "Y":
        refused(path, "Y: .* is marked as derived.*; change mu, lam, tau_y instead", read_material)
    else:
        refused(path, f"{key}: .*state E and nu instead of mu and lam", read_material)


def test_binary_and_large_texts_are_refused(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xff\xfe\x00" * 10)
    refused(path, "not a text file", read_material)
    path.write_bytes(b"#" * 5_000_000)
    refused(path, "larger than 4 MB", read_material)


def test_a_failed_material_write_leaves_the_old_one(tmp_path):
    sample_material().write(tmp_path / "a.yaml")
    old = (tmp_path / "a.yaml").read_bytes()
    broken = replace(sample_material(), density="heavy")
    with pytest.raises(ValueError):
        broken.write(tmp_path / "a.yaml")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.yaml", old)]


def test_forces_are_framed_by_the_first_and_the_last_frame():
    time, stamps = np.linspace(7.0, 8.0, 11), np.linspace(6.0, 9.0, 31)
    force = Stream(stamps, np.zeros((31, 3)), noise=0.1)
    whole = Recording.from_arrays(time, np.zeros((11, 8, 3)), forces={"plate": force})
    framed_force = framed(whole).forces["plate"]
    assert np.allclose(framed_force.time, time) and framed_force.noise == 0.1
    assert len(framed_force.value) == 11
    early = replace(whole, forces={"plate": replace(force, time=stamps - 3.0)})
    with pytest.raises(ValueError, match="stamped 3 to 6 s, the frames 7 to 8 s: two samples"):
        framed(early)
