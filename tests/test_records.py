"""Recordings as files: what is written comes back, what is broken is refused."""

import json
import pickle
from dataclasses import fields, replace

import h5py
import numpy as np
import pytest

from form_drake import Recording, Solver, Wall, read, read_material
from form_drake.files import whole_folder
from form_drake.records import Camera, States, Stream, degraded, framed, write_recording
from helpers.files import assert_same, refused, write_nclaw

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
    refused(tmp_path / name, "is a folder", reader)


@pytest.mark.parametrize(
    ("place", "name", "value", "told"),
    [
        ("forces/plate/value", "unit", "kN", "forces/plate/value: the unit is N, got 'kN'"),
        ("forces/plate/time", "unit", "ms", "forces/plate/time: the unit is s, got 'ms'"),
        ("forces/plate", "nosie", 0.1, "forces/plate: unknown attribute 'nosie': .* are noise"),
        ("points", "noise", 0.1, "points: unknown attribute 'noise': allowed are none"),
        ("points/p_WQ", "units", "m", "unknown attribute 'units': allowed are dims, unit"),
    ],
)
def test_attributes_and_units_that_nobody_would_read_are_refused(
    tmp_path, place, name, value, told
):
    path, force = tmp_path / "a.h5", Stream(np.arange(2.0), np.zeros((2, 3)))
    write_recording(replace(full_recording(), forces={"plate": force}), path)
    with h5py.File(path, "a") as file:
        file[place].attrs[name] = value
    refused(path, told)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"rest": np.array([[0.5, 0.1]])}, "rest: each interval is a start and a later end"),
        ({"face": 0.9 + np.zeros(POINTS)}, "face: whole numbers are wanted"),
    ],
)
def test_statements_that_make_no_sense_are_refused(change, told):
    plain = full_recording()
    with pytest.raises(ValueError, match=told):
        Recording.from_arrays(plain.time, np.nan_to_num(plain.p_WQ), **change)


def test_noise_is_added_to_points_that_have_a_rest_shape():
    still = full_recording()
    p_WQ, valid = np.nan_to_num(still.p_WQ), np.ones(still.p_WQ.shape[:2], dtype=bool)
    p_WQ[0, 2], valid[0, 2] = np.nan, False
    lost = Recording.from_arrays(still.time, p_WQ, valid=valid)
    with pytest.raises(ValueError, match="1 points are not seen in the first frame"):
        degraded(lost, 1e-5, 0)


def test_a_stream_without_samples_is_refused():
    none = Stream(np.zeros(0), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="plate: it holds no sample: leave it out"):
        replace(full_recording(), forces={"plate": none})


def test_an_archive_that_does_not_begin_as_one_is_refused(tmp_path):
    write_nclaw(tmp_path)
    (tmp_path / "b.npz").write_bytes(b"junk" + (tmp_path / "a.npz").read_bytes())
    refused(tmp_path / "b.npz", "it is no zip archive")


def test_unknown_endings_are_refused(tmp_path):
    refused(tmp_path / "a.csv", r"ends in .h5, .hdf5, .npz, not '.csv'")


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
