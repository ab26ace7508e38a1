"""The command line: what it prints, what it writes, and how it refuses."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from form_drake import LAWS, Recording, __main__, identify, predict, read, read_material
from form_drake.bench import cases, table2
from form_drake.commands import VERBS
from form_drake.commands.bench_cases import Cases
from form_drake.diagnose.motions import Block
from form_drake.effects import CATALOGUE
from form_drake.laws import ADDITIONS
from form_drake.material import Acting
from form_drake.mpm.bodies import rigid_velocity
from form_drake.records import Stream, write_recording
from helpers.commands import TRUTH, refusal, run


@pytest.mark.parametrize("verb", [(), *((v,) for v in VERBS), ("bench", "table2")])
def test_help_is_on_standard_output(capsys, verb):
    code, out, err = run(capsys, *verb, "--help")
    assert code == 0 and err == ""
    assert out.startswith(" ".join(("usage: form-drake", *verb)))


def test_version_names_what_it_stands_on(capsys):
    code, out, _ = run(capsys, "--version")
    assert code == 0 and out.count("\n") == 1
    for name in ("form-drake", "drake", "warp-lang", "numpy"):
        assert re.search(rf"\b{name} \d+\.\d+", out)
    assert "device cpu" in out or "device cuda" in out


@pytest.mark.parametrize("arguments", [("--version", "--json"), ("--json", "--version")])
def test_version_as_json(capsys, arguments):
    code, out, err = run(capsys, *arguments)
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert set(found["versions"]) == {"form-drake", *__main__.COMPONENTS}
    assert set(found["device"]) == {"alias", "name"}


def test_help_tells_no_default_that_is_none(capsys):
    for verb in (("diagnose",), ("bench", "nulls")):
        text = run(capsys, *verb, "--help")[1]
        assert not [word for word in ("None", "False", "(default: )") if word in text]
        assert "  --dx FLOAT  " in text and "(default:" in text


def test_help_mentions_the_version(capsys):
    assert "--version [--json]" in " ".join(run(capsys, "--help")[1].split())


def test_list_effects(capsys):
    code, out, _ = run(capsys, "list", "effects")
    assert code == 0 and [line.split()[0] for line in out.splitlines()] == list(CATALOGUE)
    effects = json.loads(run(capsys, "list", "effects", "--json")[1])["effects"]
    assert effects["drag"]["unit"] == "1/s" and effects["drag"]["of"] == "the world"
    assert (
        effects["force-gain"]["of"] == "a sensor" and effects["inclusion"]["shapes"][-1] == "radius"
    )


def test_list_laws(capsys):
    code, out, _ = run(capsys, "list", "laws")
    assert code == 0 and [line.split()[0] for line in out.splitlines()] == [*LAWS, *ADDITIONS]
    laws = json.loads(run(capsys, "list", "laws", "--json")[1])["laws"]
    assert set(laws) == {*LAWS, *ADDITIONS}
    assert {name for name, law in laws.items() if law["adds_to"]} == set(ADDITIONS)
    gent = laws["gent"]
    assert gent["parameters"]["J_m"] == {"unit": "-", "role": "shape"}
    assert gent["parameters"]["mu"] == {"unit": "Pa", "role": "linear"}
    assert gent["derived"] == {"E": "Pa", "nu": "-"}
    assert laws["bingham"]["parameters"]["kappa"]["role"] == "given"
    assert "Y" in laws["von-mises"]["derived"]


def test_list_materials(capsys):
    code, out, _ = run(capsys, "list", "materials", "--json")
    assert code == 0
    for name, entry in json.loads(out)["materials"].items():
        assert entry["law"] in LAWS and Path(entry["file"]).stem == name
        assert set(LAWS[entry["law"]].keys) <= set(entry["parameters"])


def test_check_says_what_a_file_holds(capsys, files):
    found = json.loads(run(capsys, "check", files / "steps.h5", "--json")[1])
    assert (found["kind"], found["points"], found["pairs"]) == ("recording", 48, 2)
    assert (found["observe"], found["law"], found["noise_m"]) == (
        "full",
        "fixed-corotated",
        "unknown",
    )
    found = json.loads(run(capsys, "check", files / "true.yaml", "--json")[1])
    assert (found["kind"], found["law"]) == ("material", "fixed-corotated")
    assert found["parameters"]["mu"]["value"] == TRUTH["mu"]
    for name in ("steps.h5", "true.yaml"):
        code, out, err = run(capsys, "check", files / name)
        assert code == 0 and err == "" and "fixed-corotated" in out


CAMERA = """{size: [640, 480], K: [[4000, 0, 320], [0, 4000, 240], [0, 0, 1]],
    distortion: [0, 0, 0, 0, 0], X_WC: [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.3], [0, 0, 0, 1]]}
"""
RIG = f"""
form_drake_rig: 1
rate: 60.0
low: [-0.01, -0.01, 0.0]
high: [0.01, 0.01, 0.02]
face: z+
cameras:
  left: {CAMERA}
  right: {CAMERA.replace("[[1, 0, 0, 0]", "[[1, 0, 0, 0.05]")}
"""


def written(folder, name, text):
    (folder / name).write_text(text)
    return folder / name


def staged(folder):
    """A recording of a box between a floor and a plate that does not move."""
    time, grid = np.arange(3.0), np.indices((2, 2, 2)).reshape(3, -1).T * 0.01
    plate = Stream(time, np.tile(np.eye(4), (3, 1, 1)))
    box = {"shape": "box", "low": "0 0 0", "high": "0.01 0.01 0.01"}
    recording = Recording.from_arrays(
        time,
        np.tile(grid, (3, 1, 1)),
        density=1000.0,
        gravity=[0.0, 0.0, -9.81],
        mass_scale=4.0,
        geometry=box,
        contact={"z-": "bonded floor", "z+": "frictionless plate", "other": "free"},
        poses={"plate": plate},
        forces={n: Stream(time, np.ones((3, 3))) for n in ("plate", "plate:joint-torque")},
    )
    write_recording(recording, folder / "staged.h5")
    return recording


def test_check_says_what_is_stated_of_a_box(capsys, here):
    recording = staged(here)
    found = json.loads(run(capsys, "check", "staged.h5", "--json")[1])
    assert found["geometry"] == recording.geometry and found["contact"] == recording.contact
    assert (found["gravity"], found["mass_scale"]) == ([0.0, 0.0, -9.81], 4.0)
    assert found["streams"] == ["poses/plate", "forces/plate", "forces/plate:joint-torque"]
    wrong = {
        "low must be three numbers": {"geometry": {**recording.geometry, "low": "0 0"}},
        "must lie below high": {"geometry": {**recording.geometry, "high": "0 0 0"}},
        "contact x-: 'glued'": {"contact": {"other": "glued"}},
        "no face names it": {"contact": {"z-": "bonded floor"}, "geometry": {}},
    }
    for message, changes in wrong.items():
        write_recording(replace(recording, **changes), here / "wrong.h5")
        line = refusal(capsys, "check", "wrong.h5")
        assert line.startswith("form-drake: wrong.h5: ") and message in line


def test_check_reads_rigs(capsys, here):
    written(here, "rig.yaml", RIG)
    found = json.loads(run(capsys, "check", "rig.yaml", "--json")[1])
    assert (found["kind"], found["face"], found["spacing"]) == ("rig", "z+", None)
    assert found["cameras"] == {"left": "640 x 480", "right": "640 x 480"} and found["points"] > 8
    huge = written(here, "huge.yaml", RIG.replace("rate: 60.0", "rate: 1" + "0" * 400))
    assert "huge.yaml: rate: a finite number is wanted" in refusal(capsys, "check", huge)
    behind = written(here, "behind.yaml", RIG.replace("-1, 0.3]", "-1, -0.3]"))
    assert "behind.yaml: the face lies behind" in refusal(capsys, "check", behind)


OWN_EFFECT = """
from form_drake.effects import Effect
SYRUP = Effect("syrup", "it is thick", "1/s", (1.0, 9.0), lambda r, shape: r.X[:, 0], lambda w, c, s: w)
"""
SOFT = "form_drake_material: 1\nlaw: fixed-corotated\nparameters: {mu: 3.0, lam: 3.0}\n"


def test_check_reads_the_effects_of_a_material(capsys, here):
    soft = written(here, "soft.yaml", SOFT + "effects: [{id: syrup, coefficient: 2}]\n")
    line = refusal(capsys, "check", soft)
    assert "soft.yaml: effect 'syrup': choose from damping" in line and "--effects FILE" in line
    staged(here)
    line = refusal(capsys, "predict", soft, "staged.h5")
    assert "soft.yaml: effect 'syrup': choose from damping" in line and "--effects FILE" in line
    own = written(here, "own.py", OWN_EFFECT)
    found = json.loads(run(capsys, "check", soft, "--effects", own, "--json")[1])
    assert found["effects"] == [{"id": "syrup", "coefficient": 2.0, "shape": {}, "std": None}]
    soft.write_text(SOFT + "effects: [{id: drag, coefficient: 2, shape: {x: 1}}]\n")
    assert "soft.yaml: effect drag: shape ['x'] is given" in refusal(capsys, "check", soft)
    line = refusal(
        capsys, "check", written(here, "rig.yaml", "form_drake_rig: 1"), "--effects", own
    )
    assert "--effects belongs to a material" in line


@pytest.mark.parametrize("options", [(), ("--json",)])
@pytest.mark.parametrize(
    "values, message",
    [
        ("mu: 1.0e-320, lam: 1.0e+308", "parameters.E.value is not finite"),
        ("mu: 3.0, lam: -3.0", "bulk modulus -1 Pa: must be positive, change mu, lam"),
    ],
)
def test_values_without_modulus_are_refused(capsys, here, options, values, message):
    path = written(here, "far.yaml", SOFT.replace("mu: 3.0, lam: 3.0", values))
    line = refusal(capsys, "check", path, *options)
    assert f"far.yaml: {message}" in line


ANSWER = {"law", "method", "parameters", "condition", "seconds"}


def test_identify_prints_one_object_and_writes_the_material(capsys, files, here):
    code, out, err = run(capsys, "identify", files / "steps.h5", "--json", "--out", "m/a.yaml")
    answer = json.loads(out)
    assert code == 0 and set(answer) >= ANSWER
    assert (answer["law"], answer["method"]) == ("fixed-corotated", "step")
    for key, value in TRUTH.items():
        entry = answer["parameters"][key]
        assert set(entry) == {"value", "std", "unit", "derived"}
        assert entry["value"] == pytest.approx(value, rel=1e-9)
        assert (entry["unit"], entry["derived"]) == ("Pa", False)
    assert all(answer["parameters"][k]["derived"] for k in ("E", "nu", "K"))
    assert "written: m/a.yaml" in err
    material = read_material(here / "m" / "a.yaml")
    assert material.values["mu"] == answer["parameters"]["mu"]["value"]
    assert material.parameters()["mu"].std == answer["parameters"]["mu"]["std"]


def test_identify_replaces_its_earlier_folder(capsys, files, here):
    code, out, _ = run(capsys, "identify", files / "steps.h5")
    assert code == 0 and "mu" in out and "95 %" in out
    folder = here / "runs" / "identify"
    (folder / "notes.txt").write_text("mine")
    line = refusal(capsys, "identify", files / "steps.h5")
    assert "holds files that no earlier run has made (notes.txt)" in line
    assert (folder / "notes.txt").read_text() == "mine"
    (folder / "notes.txt").unlink()
    (folder / "result.json").unlink()  # as of a run that wrote less
    assert run(capsys, "identify", files / "steps.h5", "--known", f"mu={TRUTH['mu']}")[0] == 0
    assert {p.name for p in folder.iterdir() if p.name[0] != "."} == {
        "material.yaml",
        "result.json",
    }
    assert read_material(folder / "material.yaml").keys == ("lam",)
    assert [p.name for p in folder.parent.iterdir()] == ["identify"]


def test_no_output_takes_the_place_of_what_is_read(capsys, files, here):
    kept = here / "runs" / "a"
    kept.mkdir(parents=True)
    for name in ("steps.h5", "true.yaml"):
        (kept / name).write_bytes((files / name).read_bytes())
    (kept / ".form-drake").touch()  # of a run that does not tell what it wrote
    track = ("track", "pictures", "--calibration", "rig.yaml")
    for arguments in (
        ("diagnose", kept / "steps.h5", "--out", kept),
        ("predict", kept / "true.yaml", kept / "steps.h5", "--out", kept / "steps.h5"),
        ("simulate", "press_a", "--material", kept / "true.yaml", "--out", kept),
        (*track, "--probe", kept / "steps.h5", "--out", kept / "steps.h5"),
    ):
        assert "which is read: choose another --out" in refusal(capsys, *arguments)
    assert (kept / "steps.h5").read_bytes() == (files / "steps.h5").read_bytes()


def test_values_are_one_word_before_the_file(capsys, files, here):
    known = f"mu={TRUTH['mu']}, lam={TRUTH['lam'] / 2}"
    paths = (files / "true.yaml", files / "steps.h5")
    outcome = run(capsys, "predict", "--set", known, *paths, "--json")
    assert outcome[0] == 0, outcome
    mu = known.split(",")[0]
    outcome = run(capsys, "identify", "--known", mu, files / "steps.h5", "--json")
    assert outcome[0] == 0, outcome
    assert read_material(here / "runs" / "identify" / "material.yaml").keys == ("lam",)


TWIST = [-0.1, 0.2, 0.3, 1.0, -2.0, 0.5]


@pytest.mark.parametrize("name", ["unknown-motion.h5", "steps.h5"])
def test_predict_takes_a_rigid_initial_motion(capsys, files, here, name):
    text = ",".join(str(v) for v in TWIST)
    paths = (files / "true.yaml", files / name)
    code, out, _ = run(capsys, "predict", *paths, "--initial-velocity", text, "--json")
    recording = read(files / "steps.h5")
    v_0 = rigid_velocity(recording.reference, TWIST[:3], TWIST[3:])
    expected = predict(replace(recording, v_0=v_0), read_material(files / "true.yaml"))
    assert code == 0 and json.loads(out)["loss"] == expected.loss
    assert expected.loss != predict(recording, read_material(files / "true.yaml")).loss
    np.testing.assert_array_equal(read(here / "runs" / "predict" / "prediction.h5").v_0, v_0)


@pytest.mark.parametrize(
    "stated, message",
    [
        (lambda r: {"body_force": 0.0 * r.p_WQ}, "states body_force or another mass_scale"),
        (lambda r: {"mass_scale": 100.0}, "states body_force or another mass_scale"),
        (lambda r: {"valid": r.p_WQ[..., 0] > 1e3}, "no point is valid in any frame of the loss"),
    ],
)
def test_a_prediction_leaves_out_nothing_that_is_stated(files, stated, message):
    recording, material = read(files / "steps.h5"), read_material(files / "true.yaml")
    with pytest.raises(ValueError, match=message):
        predict(replace(recording, **stated(recording)), material)
    with pytest.raises(ValueError, match=r"the material has effects \(drag\)"):
        predict(recording, replace(material, effects=(Acting("drag", 5.0, {}),)))


@pytest.mark.parametrize(
    "name, options, message",
    [
        ("unknown-motion.h5", (), "--initial-velocity vx,vy,vz,wx,wy,wz"),
        ("steps.h5", ("--initial-velocity", "1,2,3"), "vx,vy,vz,wx,wy,wz are wanted"),
        ("steps.h5", ("--initial-velocity", "1,2,3,4,5,a"), "wz: a finite number"),
        ("steps.h5", ("--initial-velocity", "nan,2,3,4,5,6"), "vx: a finite number"),
        ("steps.h5", ("--set", "mu=-1"), "mu: must be positive"),
        ("steps.h5", ("--set", "E=-1,nu=0.3"), "E must be positive"),
        ("steps.h5", ("--set", "E=1e308,nu=0.4999999"), "lam: a finite number"),
    ],
)
def test_bad_predictions_are_refused(capsys, files, here, name, options, message):
    assert message in refusal(capsys, "predict", files / "true.yaml", files / name, *options)
    assert not list(here.iterdir())


def test_a_block_that_rests_without_any_tool_is_predicted(capsys, files, here):
    block = Block(size=(0.02, 0.02, 0.02), points=20, rate=60.0, stamps=60.0)
    still = block.shake(0.05)
    write_recording(replace(still, poses={}, forces={}), here / "rest.h5")
    felt = {"floor": Stream(still.time, np.zeros((still.frames, 3)))}
    write_recording(
        replace(still, forces={"floor:joint-torque": felt["floor"]}), here / "torque.h5"
    )
    told = ("--dx", "0.005", "--json", "--out", "p.h5")
    for name in ("rest.h5", "torque.h5"):
        code, out, said = run(capsys, "predict", files / "true.yaml", name, *told)
        assert code == 0, said
        assert 0.0 < json.loads(out)["shape_rms"] < 5e-3  # how far it sinks
    told = refusal(capsys, "predict", files / "true.yaml", "rest.h5", "--dx", "2.5")
    assert "dx 2.5 m: up to 0.005 m is wanted" in told  # millimetres


UNUSED = {
    "thrown": (("--drive", "force", "--scenario", "press_a"), "--scenario, --drive force: "),
    "thrown alone": (("--effects", "own.py"), "leave out --effects: "),
    "thrown finely": (("--dx", "0.01"), "leave out --dx: "),
    "staged": (("--initial-velocity", "x"), "leave out --initial-velocity: "),
    "staged by force": (("--drive", "force"), "leave out --drive force: staged.h5 lies beside no"),
    "probed": (
        ("--initial-velocity", "x", "--scenario", "a.yaml"),
        "leave out --initial-velocity:",
    ),
}


@pytest.mark.parametrize("case", UNUSED)
def test_options_of_no_use_are_refused(capsys, files, here, case):
    options, message = UNUSED[case]
    staged(here)
    path = files / "steps.h5" if case.startswith("thrown") else "staged.h5"
    assert message in refusal(capsys, "predict", files / "true.yaml", path, *options)
    assert [p.name for p in here.iterdir()] == ["staged.h5"]


def test_identify_prints_the_initial_motion(capsys, files, here, monkeypatch):
    answer = identify(read(files / "steps.h5"))
    found = {"initial_twist": {"value": TWIST, "std": [0.0] * 6}}
    monkeypatch.setattr(
        "form_drake.commands.identify.identify", lambda *_, **__: replace(answer, details=found)
    )
    _, out, err = run(capsys, "identify", files / "unknown-motion.h5")
    assert "--initial-velocity -0.1,0.2,0.3,1,-2,0.5\n" in err and "initial" not in out


@pytest.mark.parametrize("out", [(), ("--out", "there/p.h5")])
def test_predict_prints_the_loss_and_writes_the_motion(capsys, files, here, out):
    code, text, _ = run(capsys, "predict", files / "true.yaml", files / "steps.h5", "--json", *out)
    answer = json.loads(text)
    assert code == 0
    assert answer["frames"] == 2  # solver steps 0 and 100 of 0, 1, 100, 101 after the first
    assert answer["loss"] > 0.0
    place = here / (out[1] if out else "runs/predict/prediction.h5")
    predicted, recorded = read(place), read(files / "steps.h5")
    assert predicted.p_WQ.shape == recorded.p_WQ.shape
    used = np.flatnonzero((recorded.step - recorded.step[0]) % 5 == 0)
    error = predicted.p_WQ[used] - recorded.p_WQ[used]
    assert answer["loss"] == pytest.approx(np.mean(error**2), rel=1e-9)


def test_predict_takes_other_values(capsys, files, here):
    def loss(*options):
        paths = (files / "true.yaml", files / "steps.h5")
        return json.loads(run(capsys, "predict", *paths, "--json", *options)[1])["loss"]

    E, nu = 4000.0, 0.25
    mu, lam = E / 2.5, E * nu / (1.25 * 0.5)
    assert loss("--set", f"E={E},nu={nu}") == loss("--set", f"mu={mu},lam={lam}") != loss()


BAD_FILES = [
    *((f"{kind}.{suffix}", suffix) for kind in ("empty", "garbage", "folder", "missing")
      for suffix in ("h5", "npz", "yaml")),
    ("truncated.h5", "h5"),
]  # fmt: skip


@pytest.mark.parametrize("name, suffix", BAD_FILES)
def test_bad_files_are_refused(capsys, files, here, name, suffix):
    assert name in refusal(capsys, "check", files / name)
    if suffix == "yaml":
        line = refusal(capsys, "predict", files / name, files / "steps.h5", "--out", "p.h5")
    else:
        refusal(capsys, "predict", files / "true.yaml", files / name, "--out", "p.h5")
        line = refusal(capsys, "identify", files / name, "--out", "a.yaml")
    assert name in line
    assert not list(here.iterdir())


BAD_OPTIONS = {
    "unknown law": (("--law", "rubber"), "unknown law 'rubber': choose one of neo-hookean"),
    "start without equals": (("--start", "mu"), "'mu': NAME=VALUE is wanted"),
    "start twice": (("--start", "mu=1,mu=2"), "mu is given twice"),
    "start text": (("--observe", "positions", "--start", "mu=a,lam=1"), "mu: a finite number"),
    "unknown parameter": (("--known", "eta=1"), "fixed-corotated has no parameter 'eta'"),
    "infinite": (("--known", "mu=inf"), "mu: a finite number"),
    "negative": (("--known", "mu=-1"), "mu: must be positive, got -1"),
    "stride": (("--stride", "2"), "--stride applies to positions only"),
    "stride zero": (("--observe", "positions", "--stride", "0"), "stride: a whole number from 1"),
    "stride too large": (("--observe", "positions", "--stride", "9"), "leaves fewer than two"),
    "stride text": (("--stride", "a"), "--stride"),
    "noise": (("--observe", "positions", "--add-noise", "-1e-3"), "not be negative"),
    "stated noise": (("--observe", "positions", "--position-noise", "-1"), "negative"),
    "noise of steps": (("--add-noise", "1e-3"), "--add-noise applies to positions only"),
    "observe": (("--observe", "everything"), "everything"),
    "seed": (("--seed", "-1"), "--seed: a whole number from 0 is wanted, got -1"),
    "initial velocity": (("--initial-velocity", "maybe"), "maybe"),
    "unknown option": (("--colour", "red"), "--colour"),
    "second file": (("b.h5",), "b.h5"),
}


@pytest.mark.parametrize("case", BAD_OPTIONS)
def test_bad_options_are_refused(capsys, files, here, case):
    options, message = BAD_OPTIONS[case]
    assert message in refusal(capsys, "identify", files / "steps.h5", *options)
    assert not list(here.iterdir())


@pytest.mark.parametrize("verb", ["identify", "predict"])
def test_a_file_of_ones_own_that_ends_the_program(capsys, files, here, verb):
    own = written(here, "own.py", "import sys\nsys.exit(3)\n")
    told = ("identify", files / "steps.h5", "--laws", own)
    if verb == "predict":
        staged(here)
        told = ("predict", files / "true.yaml", "staged.h5", "--effects", own)
    assert "own.py, line 2: SystemExit: 3" in refusal(capsys, *told)


def test_no_declared_law_lists_the_laws(capsys, files, here):
    line = refusal(capsys, "identify", files / "lawless.h5")
    assert all(name in line for name in LAWS)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((), "demo, simulate, track, identify, predict"),
        (("melt",), "melt"),
        (("identify",), "PATH"),
        (("predict", "a.yaml"), "PATH"),
        (("list", "colours"), "colours"),
        (("check", "notes.txt"), "notes.txt: no such file"),
        (("demo", "--seed", "-1"), "--seed: a whole number from 0"),
        (("bench", "table2", "--data", "nowhere"), "nowhere: no such folder"),
        (("bench", "speed", "--only", "nothing"), "unknown case 'nothing': choose from mls"),
        (
            ("demo", "--seed", "abc"),
            "--seed abc: a whole number is wanted; see: form-drake demo --",
        ),
        (("diagnose", "a.h5", "--dx", "1,5"), "--dx 1,5: a number is wanted; see: form-drake diag"),
        (("bench", "blind"), "see: form-drake bench blind --help"),
        (("bench", "blund"), "see: form-drake bench --help"),
    ],
)
def test_wrong_commands_are_refused(capsys, here, arguments, message):
    assert message in refusal(capsys, *arguments)
    assert not list(here.iterdir())


def outs(folder):
    """Places where no file can be put, and what is said about them."""
    (folder / "file").write_text("kept")
    (folder / "folder").mkdir()
    return {"file/a.yaml": "is not a folder", "folder": "is a folder; a file is wanted"}


@pytest.mark.parametrize("out", ["file/a.yaml", "folder"])
def test_impossible_outputs_are_refused_before_work(capsys, files, here, monkeypatch, out):
    message = outs(here)[out]
    for module in ("identify", "predict"):
        monkeypatch.setattr(f"form_drake.commands.{module}.{module}", None)
    assert message in refusal(capsys, "identify", files / "steps.h5", "--out", out)
    arguments = ("predict", files / "true.yaml", files / "steps.h5", "--out", out)
    assert message in refusal(capsys, *arguments)
    assert (here / "file").read_text() == "kept" and not list((here / "folder").iterdir())


@pytest.mark.parametrize("out", ["a", "a.txt", "a.h5", "a.yaml.npz"])
def test_other_endings_are_refused_before_work(capsys, files, here, monkeypatch, out):
    for module in ("identify", "predict"):
        monkeypatch.setattr(f"form_drake.commands.{module}.{module}", None)
    line = refusal(capsys, "identify", files / "steps.h5", "--out", out)
    assert f"--out {out}: a name that ends in .yaml or .yml" in line
    out = out.replace(".h5", ".yaml")
    line = refusal(capsys, "predict", files / "true.yaml", files / "steps.h5", "--out", out)
    assert f"--out {out}: a name that ends in .h5 or .hdf5" in line
    assert not list(here.iterdir())


def test_a_scenario_is_no_material(capsys, here):
    (here / "pour.yaml").write_text("scenario: pour\nmaterial: glycerol\n")
    line = refusal(capsys, "check", "pour.yaml")
    assert "pour.yaml: no scenario; allowed there are name, arm, cell" in line


def test_unwritable_outputs_are_refused(capsys, files, here, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    for out in (("--out", "a.yaml"), ()):
        assert "is not writable" in refusal(capsys, "identify", files / "steps.h5", *out)
    assert not list(here.iterdir())


def test_a_diagram_is_drawn(capsys, here):
    told = ("simulate", "press_b", "--set", "solver.dx=0.005", "--graphviz", "g.dot", "--json")
    code, out, err = run(capsys, *told)
    assert (code, json.loads(out), err) == (0, {"diagram": "g.dot"}, "written: g.dot\n")
    plain = (here / "g.dot").read_text()
    assert plain.startswith("digraph") and "identifier" not in plain.lower()
    run(capsys, *told, "--answers", "0.2")
    assert "identifier" in (here / "g.dot").read_text().lower()


@pytest.mark.parametrize(
    ("only", "fits", "rolls"),
    [
        (("identify/jelly",), 3, 0),
        (("Floor, series",), 0, 12),
        (("rollout/jelly/Full/time",), 1, 1),
        ((), 12, 60),
    ],
)
def test_only_what_a_part_of_a_bench_needs_is_run(tmp_path, monkeypatch, only, fits, rolls):
    ran = []

    def told(kind):
        return lambda *words: ran.append(kind) or {"values": {}, "loss": 0.0}

    monkeypatch.setattr(table2, "nclaw_files", lambda data: {})
    for name in ("identified", "_floor", "_loss"):
        monkeypatch.setattr(table2, name, told(name))
    table2.run_table2(tmp_path, store=tmp_path / "store", only=only)
    assert (ran.count("identified"), len(ran)) == (fits, fits + rolls)
    with pytest.raises(ValueError, match="no case has it"):
        table2.run_table2(tmp_path, store=tmp_path / "store", only=("nothing",))


def test_a_part_of_a_bench_takes_nothing_from_the_whole(here, capsys):
    def bench(store, only):
        every = {name: lambda: {"made": 1} for name in ("a", "b")}
        found = cases.run_cases(every, store=store, mark="m", estimates={}, only=only)
        return {"cases": found}

    for words in ({}, {"only": ("a",)}, {}):
        Cases(**words).finish("some", bench, str)
    assert "2 of 2 cases to run" in (said := capsys.readouterr().err)
    assert "0 of 1 cases to run" in said and "0 of 2 cases to run" in said


@pytest.mark.parametrize("part", ["PACKAGE", "ORACLES"])
def test_saved_cases_count_only_with_the_same_code(tmp_path, monkeypatch, part):
    monkeypatch.setattr(cases, part, tmp_path)
    marks = [cases.fingerprint()]
    for place in ("material.py", "bench/truth.py", "systems/new.py"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_text(place)
        marks.append(cases.fingerprint())
    for changed in ("warp-lang", "numpy"):
        monkeypatch.setattr(cases, "version", lambda name, new=changed: str(name == new))
        marks.append(cases.fingerprint())
    assert len(set(marks)) == len(marks)
    assert cases.fingerprint() == marks[-1]


@pytest.mark.parametrize(
    "words, seen",
    [
        ("list laws", ""),
        ("predict no.yaml no.h5 --device cpu", ""),
        ("predict no.yaml no.h5 --device cuda:0", "7"),
        ("bench speed --device=cuda:0 --only nothing", "7"),
        ("simulate no --set solver.device=cuda:0", "7"),
        ("--version", "7"),
    ],
)
def test_warp_begins_with_no_gpu_that_nobody_asked_for(capfd, here, monkeypatch, words, seen):
    found = []
    monkeypatch.setenv(__main__.VISIBLE, "7")
    monkeypatch.setattr("warp.init", lambda: found.append(os.environ[__main__.VISIBLE]))
    run(capfd, *words.split())
    assert found[0] == seen and os.environ[__main__.VISIBLE] == "7"


@pytest.mark.gpu
@pytest.mark.parametrize("device, forks", [("cpu", True), ("cuda:0", False)])
def test_a_command_that_needs_no_gpu_may_fork_where_there_is_one(tmp_path, device, forks):
    program = (
        "from form_drake import __main__, workers; __main__.main(['predict', 'no', 'no', '--device',"
        f" '{device}']); print(workers.forkable())"
    )
    command = [sys.executable, "-c", program]
    options = {"cwd": tmp_path, "capture_output": True, "text": True, "timeout": 300}
    assert subprocess.run(command, check=True, **options).stdout == f"{forks}\n"
