"""A diagnosis: what is hidden is named and added, and held-out motion gains by it.

Data and twin come from one solver here; other tests have data that no solver of ours made.
"""

import json
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest

from form_drake.__main__ import main
from form_drake.bench.nulls import _again, _digest
from form_drake.diagnose import Cause, Model, Nulls, Scenes, prepare
from form_drake.diagnose import diagnosed as diagnosis
from form_drake.diagnose.columns import twin_of
from form_drake.diagnose.page import diagnosis_page
from form_drake.diagnose.thresholds import likeness
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.material import Material, read_material
from form_drake.mpm.tracing import between
from form_drake.records import Recording, Stream, read, write_recording
from form_drake.systems.scenario import load_scenario
from helpers.diagnose import DX, LAW, NOISE, PROBE, TRUTH, noisy, probe, problem_of, rolled

DELAY = 4e-3


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A press and a motion to hold back: what they are without an effect, and with late forces."""
    folder = tmp_path_factory.mktemp("probes")
    plain = (PROBE, probe(0.3, 1.2e-3, 70.0))
    cause = Cause(CATALOGUE["force-delay"], DELAY, {})
    for name, causes in (("plain", ()), ("late", (cause,))):
        made = Scenes.of(plain, DX).rolled(Model(LAW, TRUTH, causes))
        for n, one in enumerate(made):
            write_recording(noisy(one, n), folder / f"{name}{n}.h5")
    return folder


def diagnosed(files, capsys, name, *more):
    out = files / f"report-{name}"
    said = main(
        [
            "diagnose",
            str(files / f"{name}0.h5"),
            "--dx",
            str(DX),
            "--out",
            str(out),
            "--json",
            *more,
        ]
    )
    assert said == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {
        k: v
        for k, v in json.loads((out / "discrepancy.json").read_text()).items()
        if k != "form_drake"
    }
    return found, out


def test_nothing_is_named_where_nothing_is_missing(files, capsys):
    found, out = diagnosed(files, capsys, "plain", "--holdout", str(files / "plain1.h5"))
    assert found["verdict"] == "none" and found["effects"] == [] and found["doubts"] == []
    missed = [one["missed"] > 0.5 for one in found["advice"]["limits"]]
    assert any(missed)
    assert f" {sum(missed)} of {len(missed)} effects would go unseen" in found["sentence"]
    assert [g["channel"] for g in found["gap"]] == ["tracks 1", "force of plate 1", "balance"]
    assert all(g["before"] == g["after"] and g["closure"] is None for g in found["gap"])
    for key, true in TRUTH.items():
        assert found["values"][key] == pytest.approx(true, rel=0.03)
    written = read_material(out / "material.yaml")
    assert written.effects == () and written.keys == tuple(found["stds"]) == ("mu", "lam")
    for key, std in found["stds"].items():
        assert written.parameters()[key].std == pytest.approx(std)
        assert 0.0 < std < 0.03 * TRUTH[key]
    assert found["thresholds"]["drag"] == 16.0 and "eight neo-Hookean blocks" in found["basis"]
    (left,) = found["passes"][0]["ledgers"]
    assert left["onset"] is None and max(left["interior"], left["tool"]) < 1.5
    assert "before and after are one prediction" in (out / "report.html").read_text()


def test_what_only_held_out_motion_shows_is_a_doubt(files):
    trained, unseen = (read(files / f"{name}.h5") for name in ("plain0", "late1"))
    nulls = Nulls.common()
    known = {"effects": [CATALOGUE["force-delay"]], "thresholds": nulls.thresholds}
    found = diagnosis([trained], LAW, **known, holdout=[unseen], dx=DX)
    assert found.verdict == "none" and not found.naming.added
    (doubt,) = found.to_json()["doubts"]
    assert "off by more than noise, grid and moduli explain" in doubt
    diagnosis_page(found, nulls).write(files / "doubt.html")
    assert escape(doubt) in (files / "doubt.html").read_text()


def test_what_is_missing_is_named_added_and_closes_the_gap(files, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # what lies among recordings is no module of ours
    (tmp_path / "numpy.py").write_text("raise SystemExit('not numpy')")
    scenes = Scenes.of((read(files / "late0.h5"),), DX)
    own = {"of": likeness(scenes, LAW), "draws": 3, "scores": {"drag": 2.0}}
    (files / "own.json").write_text(json.dumps(own))
    unseen = ["--holdout", str(files / "late1.h5"), "--placebo", "3"]
    found, out = diagnosed(files, capsys, "late", *unseen, "--nulls", str(files / "own.json"))
    assert found["verdict"] == "named" and found["sentence"].startswith(
        "Missing: force and pictures"
    )
    (effect,) = found["effects"]
    assert effect["name"] == "force-delay" and effect["unit"] == "s"
    assert effect["coefficient"] == pytest.approx(DELAY, abs=3.0 * effect["std"])
    gap = {g["channel"]: g for g in found["gap"]}
    force = gap["force of plate 1"]
    assert force["closure"] > 0.95 and force["after"] < 0.05 * force["before"]
    assert gap["tracks 1"]["closure"] is None  # late forces move no track
    balance = gap["balance"]  # of rows, which gather all samples
    assert balance["after"] < 0.15 * balance["before"]
    assert balance["closure"] is None  # less than three times what so coarse a grid changes
    assert balance["before"] > 2.0 * balance["noise"]
    runner_up, drawn = found["placebos"]
    others = [k for k in found["passes"][0]["scores"] if k not in effect["class"]]
    assert runner_up["name"] == others[0] and drawn["name"] in others[1:]
    for placebo in (runner_up, drawn):
        closed = {g["channel"]: g["closure"] for g in placebo["gap"]}
        assert closed["force of plate 1"] < force["closure"] - 0.3 and closed["tracks 1"] is None
        left = {g["channel"]: g["after"] for g in placebo["gap"]}
        assert left["balance"] > 3.0 * balance["after"]
    before, after = (one["ledgers"][0] for one in found["passes"])
    assert effect["onset"] == {"probe 1": before["onset"]} and after["onset"] is None
    assert before["tool"] > 2.0 * before["interior"] and after["tool"] < 1.5
    assert 0 < (out / "before_after.html").stat().st_size < 5_000_000
    assert f"{files / 'late0.h5'} NEXT.h5" in found["advice"]["command"]
    assert "next.yaml" in found["advice"]["scenarios"]
    advised = load_scenario(out / "next.yaml")
    assert advised.specimen.size == pytest.approx([0.02, 0.02, 0.02])
    assert advised.specimen.faces["z-"] == "bonded specimen_stand"
    page = (out / "report.html").read_text()
    assert "form-drake simulate with: next" in page and "come from 3 draws of noise" in page
    assert "before_after.html plays" in page and "What to record next" in page
    assert f"<td>{runner_up['name']}" in page
    assert "force-delay stands out" in page and "Not verified" in page

    written = str(out / "material.yaml")
    predict = [written, str(files / "late1.h5"), "--dx", str(DX), "--out", str(files / "p.h5")]
    assert main(["predict", *predict]) == 0
    capsys.readouterr()
    made, seen = (read(files / name).forces["plate"].value for name in ("p.h5", "late1.h5"))
    left = float(np.sqrt(np.mean((made - seen) ** 2)))
    assert left == pytest.approx(np.hypot(force["after"], force["noise"]), rel=0.15)
    assert left < 0.5 * force["before"]
    (again,) = found["written"]  # by the command itself
    assert again["failed"] is None and again["tracks"] < 1e-6
    assert again["forces"]["plate"] < 0.1 * force["noise"]
    assert "differs from what was verified" in page

    # what is known already is not found again, nor counted as found
    known = files / "known.yaml"
    known.write_text(Path(written).read_text())
    again, _ = diagnosed(files, capsys, "late", "--material", str(known))
    assert again["verdict"] == "none" and again["effects"] == []


def test_nulls_of_recordings_stand_for_such_recordings(files, capsys):
    out, written = files / "nulls.json", files / "true.yaml"
    Model(LAW, TRUTH).material(1000.0).write(written)
    words = ["bench", "nulls", "--draws", "1", "--dx", str(DX), "--out", str(out), "--json"]
    assert main([*words, "--like", str(files / "plain0.h5")]) == 2
    assert "--material MATERIAL.yaml are wanted together" in capsys.readouterr().err
    like = ["--material", str(written), "--like", str(files / "plain0.h5")]
    assert main([*words, *like, "--out", str(written)]) == 2
    assert f"{written} would take the place of {written}, which is read" in capsys.readouterr().err
    assert main([*words, *like]) == 0
    told = json.loads(capsys.readouterr().out)
    assert len(told["scores"]) > 15 and max(told["scores"].values()) < 16.0
    (errors,) = next(iter(told["cases"].values()))["errors"]
    assert errors == pytest.approx([0.0, 0.0], abs=0.03)

    own, scenes = Nulls.read(out), Scenes.of((read(files / "plain0.h5"),), DX)
    assert own.thresholds["drag"] == 1.5 * told["scores"]["drag"]
    (seen,), drag = scenes.recordings, Cause(CATALOGUE["drag"], 2.0, {})
    own.require_like(likeness(replace(scenes, recordings=(replace(seen, noise=1.2 * NOISE),)), LAW))
    felt = {k: replace(s, noise=2.0 * s.noise) for k, s in seen.forces.items()}
    off = {k: replace(s, noise=1e-4) for k, s in seen.poses.items()}
    twice = replace(scenes, recordings=2 * scenes.recordings, dx=(DX, DX))
    for other, told in (
        (likeness(scenes, LAWS["yeoh"]), "law fixed-corotated, these recordings have yeoh"),
        (likeness(scenes, LAW, [drag]), "known effects none, these recordings have drag"),
        (likeness(scenes.times(2.0), LAW), "grid spacing .m. 0.004, these recordings have 0.008"),
        (_with(scenes, noise=2.0 * NOISE), "noise of tracks .m. 5e-06, .* have 1e-05"),
        (_with(scenes, forces=felt), "noise of forces"),
        (_with(scenes, poses=off), "places of tools that are off"),
        (likeness(twice, LAW), "noise of tracks .m. 5e-06, .* have 5e-06, 5e-06"),
    ):
        with pytest.raises(ValueError, match=told):
            own.require_like(other)
        Nulls.common().require_like(other)


@pytest.mark.parametrize("of", [{"law": 5}, {"effects": [{"a": 1}]}, {"noise": ["x"]}])
def test_nulls_that_are_none_are_refused(tmp_path, of):
    told = {
        "law": "yeoh",
        "effects": [],
        "noise": [1e-5],
        "force": [],
        "place": [],
        "dx": [1e-3],
        **of,
    }
    (tmp_path / "nulls.json").write_text(json.dumps({"scores": {}, "draws": 16, "of": told}))
    with pytest.raises(ValueError, match=r"nulls[.]json: no nulls of recordings"):
        Nulls.read(tmp_path / "nulls.json")


def _with(scenes, **change):
    (seen,) = scenes.recordings
    return likeness(replace(scenes, recordings=(replace(seen, **change),)), LAW)


def test_draws_have_the_noise_and_the_gaps_of_what_was_measured():
    seen = noisy(PROBE, 0)
    there = np.random.default_rng(1).uniform(size=seen.p_WQ.shape[:2]) > 0.1
    seen = replace(seen, p_WQ=np.where(there[..., None], seen.p_WQ, np.nan), valid=there)
    (one,) = _again([(PROBE, seen)], np.random.default_rng(2))
    assert np.array_equal(one.valid, there) and one.noise == NOISE
    assert np.std((one.p_WQ - PROBE.p_WQ)[there]) == pytest.approx(NOISE, rel=0.05)
    force = seen.forces["plate"].noise
    assert np.std(one.forces["plate"].value) == pytest.approx(force, rel=0.2)


def test_finished_draws_are_those_of_these_recordings_alone():
    data, model = noisy(PROBE, 0), Model(LAW, TRUTH)
    known = _digest([data], model, (DX,))
    assert known == _digest([noisy(PROBE, 0)], Model(LAW, dict(TRUTH)), (DX,))
    others = [
        replace(data, gravity=np.zeros(3)),
        replace(data, density=500.0),
        replace(data, contact={**data.contact, "z+": "frictionless plate"}),
        replace(data, forces={"plate": replace(data.forces["plate"], noise=1.0)}),
        replace(data, poses={"plate": replace(data.poses["plate"], time=data.time + 1e-3)}),
    ]
    digests = {_digest([other], model, (DX,)) for other in others}
    digests |= {_digest([data], Model(LAW, TRUTH, (Cause(CATALOGUE["drag"], 2.0, {}),)), (DX,))}
    assert len(digests) == len(others) + 1 and known not in digests


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ["plain0.h5", "--nulls", "heavy.yaml"],
            "heavy.yaml: no nulls of recordings; form-drake bench",
        ),
        (["plain0.h5", "--nulls", "below.json"], "below.json: no nulls of recordings"),
        (["plain0.h5", "--nulls", "huge.json"], "huge.json: no nulls of recordings"),
        (["plain0.h5", "--nulls", "words.json"], "words.json: no nulls of recordings"),
        (["plain0.h5", "--nulls", "louder.json"], "louder.json: nulls are of noise of tracks"),
        (["plain0.h5", "--holdout", "plain0.h5"], "the same motion as"),
        (["none.h5"], "no such file"),
        (["silent.h5"], "no recording holds a force"),
        (["plain0.h5", "--dx", "0"], "--dx 0"),
        (["plain0.h5", "--placebo", "1"], "--placebo 1: a seed of zero or more"),
        (["plain0.h5", "--holdout", "late1.h5", "--placebo", "-1"], "--placebo -1"),
        (["plain0.h5", "--effects", "empty.py"], "declares no effect"),
        (["plain0.h5", "--material", "m.yaml", "--law", "yeoh"], "m.yaml has a law; leave out"),
        (["plain0.h5", "--material", "heavy.yaml"], "heavy.yaml: of another specimen: it has 1300"),
    ],
)
def test_what_cannot_be_diagnosed_is_one_line(files, capsys, monkeypatch, arguments, told):
    monkeypatch.chdir(files)
    (files / "empty.py").write_text("a = 1\n")
    of = likeness(Scenes.of((read(files / "plain0.h5"),), DX), LAW)
    for name, score, other in (
        ("below", -1.0, {}),
        ("huge", 10**400, {}),
        ("words", 1.0, {"noise": "12"}),
        ("louder", 1.0, {"noise": [1e-3]}),
    ):
        own = {"of": of | other, "draws": 1, "scores": {"drag": score}}
        (files / f"{name}.json").write_text(json.dumps(own))
    Model(LAW, TRUTH).material(1300.0).write(files / "heavy.yaml")
    silent = replace(probe(0.4, 0.0, 0.0), forces={}, noise=2e-5)
    write_recording(silent, files / "silent.h5")
    assert main(["diagnose", *arguments]) == 2
    err = capsys.readouterr().err
    assert told in err and err.strip().count("\n") == 0
    assert not (files / "runs").exists()


def test_effects_of_a_material_are_read_as_they_are_written(tmp_path):
    shape = {"x": 1e-3, "y": 0.0, "z": 0.01, "radius": 4e-3}
    causes = (
        Cause(CATALOGUE["damping"], 3.0, {}, 0.1),
        Cause(CATALOGUE["inclusion"], 0.5, shape, 0.02),
    )
    Model(LAW, TRUTH, causes).material(1000.0).write(tmp_path / "m.yaml")
    material = read_material(tmp_path / "m.yaml")
    assert material.law.name == "fixed-corotated+damping" and material.values["eta"] == 3.0
    model = Model.of(material, CATALOGUE)
    (cause,) = model.causes
    assert cause.effect is CATALOGUE["inclusion"] and cause.coefficient == 0.5
    assert dict(cause.shape) == shape and cause.std == 0.02
    text = (tmp_path / "m.yaml").read_text()
    for wrong, told in (
        ("id: nonsense", "effect 'nonsense'"),
        ("id: drag", "shape"),
    ):
        (tmp_path / "w.yaml").write_text(text.replace("id: inclusion", wrong))
        with pytest.raises(ValueError, match=told):
            Model.of(read_material(tmp_path / "w.yaml"), CATALOGUE)
    (tmp_path / "w.yaml").write_text(text.replace("coefficient: 0.5", "coefficient: .nan"))
    with pytest.raises(ValueError, match="coefficient"):
        read_material(tmp_path / "w.yaml")


OWN = """
import numpy as np
from dataclasses import replace
from pathlib import Path
from form_drake.effects import Effect

buoyancy = Effect(
    id="buoyancy",
    sentence="what surrounds the body carries a share of its weight",
    unit="-",
    prior=(0.01, 1.0),
    column=lambda reading, shape: reading.load(np.broadcast_to(-reading.gravity, reading.v.shape)),
    world=lambda scene, size, shape: replace(scene, gravity=scene.gravity * (1.0 - size)),
)
"""


def test_forces_of_the_wrong_sign_are_refused_and_not_blamed_on_the_tracks(files):
    data = read(files / "plain0.h5")
    force = data.forces["plate"]
    turned = {"plate": Stream(force.time, -force.value, noise=force.noise)}
    scenes = Scenes.of((replace(data, forces=turned),), DX)
    with pytest.raises(ValueError, match="those of the material on the tool; is their sign turned"):
        prepare.read(scenes, LAW, {})
    assert prepare.read(Scenes.of((data,), DX), LAW, {})[1].values["mu"] > 1e4


def test_a_twin_that_cannot_be_read_is_not_taken_for_the_tracks():
    seen = noisy(rolled(), 0)
    turned = np.linspace(1.0, -1.0, seen.frames)[:, None, None]
    folded = replace(seen, p_WQ=turned * seen.reference)
    with pytest.raises(ValueError, match="as simulated, probe: the motion"):
        twin_of(problem_of(seen), Scenes.of((seen,), DX), Model(LAW, TRUTH), [folded])


def test_an_effect_of_ones_own_is_predicted(files, capsys):
    (files / "own.py").write_text(OWN)
    text = "effects:\n- {id: buoyancy, coefficient: 0.9}\n"
    Model(LAW, TRUTH).material(1000.0).write(files / "plain.yaml")
    (files / "light.yaml").write_text((files / "plain.yaml").read_text() + text)
    made = str(files / "q.h5")
    own = ["--effects", str(files / "own.py")]

    def force(name, *words):
        code = main(["predict", str(files / name), str(files / "plain1.h5"), "--out", made, *words])
        return read(Path(made)).forces["plate"].value[:, 2].mean() if code == 0 else code

    assert force("light.yaml") == 2
    assert "choose from" in capsys.readouterr().err
    heavy, light = force("plain.yaml"), force("light.yaml", *own)
    borne = 0.5 * 1000.0 * 0.02**3 * 9.81  # half of the weight hangs from the plate
    assert light - heavy == pytest.approx(0.9 * borne, rel=0.05)


def test_a_prediction_is_compared_where_and_while_it_is_measured(files, capsys):
    """Not at points that are lost, nor with forces that go on after the last frame."""
    Model(LAW, TRUTH).material(1000.0).write(files / "true.yaml")
    seen = read(files / "plain1.h5")
    valid = np.random.default_rng(0).random((30, seen.points)) > 0.2
    p_WQ = np.where(valid[..., None], seen.p_WQ[:30], 0.0)
    write_recording(replace(seen, time=seen.time[:30], p_WQ=p_WQ, valid=valid), files / "part.h5")
    made = ["--json", "--out", str(files / "q.h5")]
    assert main(["predict", str(files / "true.yaml"), str(files / "part.h5"), *made]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["shape_rms"] < 2e-5 and told["force_rms_plate"] < 0.02
    assert read(files / "q.h5").forces["plate"].time[-1] == pytest.approx(seen.time[29])


def test_what_cannot_be_simulated_is_not_named(files):
    def breaks(scene, size, shape):
        raise ValueError("the simulation broke down")

    effect = replace(CATALOGUE["force-delay"], sensor=None, world=breaks)
    found = diagnosis([read(files / "late0.h5")], LAW, effects=[effect], thresholds={}, dx=DX)
    assert found.verdict == "unnamed" and found.naming.added == ()
    assert found.to_json()["failed"] == "force-delay: the simulation broke down"
    assert found.sentence().endswith("fails, force-delay: the simulation broke down")


def test_points_between_particles_follow_quadratic_motion():
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*3 * [np.arange(8) / 8.0]), axis=-1).reshape(-1, 3)
    X, H = rng.uniform(0.0, 0.875, (50, 3)), rng.standard_normal((3, 3, 3))

    def u(x):
        return 0.3 + x @ H[0] + np.einsum("pi,pj,ijk->pk", x, x, H)

    assert np.allclose(between(X, grid) @ u(grid), u(X), atol=1e-12)


def test_a_tied_block_goes_where_its_plates_go():
    """A plate that moves through rows of nodes, down and aside, takes the material along."""
    still = probe(0.3, 0.0, 0.0)
    pose = still.poses["plate"].value.copy()
    share = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, len(pose))) ** 2
    pose[:, 2, 3] -= 3e-3 * share
    pose[:, 0, 3] += 2e-3 * share
    moved = replace(still, poses={"plate": Stream(still.time, pose)}, p_reference=still.reference)
    (made,) = Scenes.of((moved,), DX).rolled(Model(LAW, TRUTH))
    u, X = made.p_WQ[-1] - made.reference, made.reference
    top, low = X[:, 2] > 0.0185, X[:, 2] < 0.0015
    assert np.allclose(u[top][:, [0, 2]], [2e-3, -3e-3], atol=5e-4)
    assert np.allclose(u[low], 0.0, atol=5e-4)


def test_a_material_with_effects_is_not_predicted_without_them(tmp_path, capsys):
    thrown = Recording.from_arrays(np.linspace(0.0, 1.0, 5), np.zeros((5, 8, 3)))
    write_recording(thrown, tmp_path / "r.h5")
    Model(LAW, TRUTH, (Cause(CATALOGUE["drag"], 2.0, {}),)).material(1000.0).write(
        tmp_path / "m.yaml"
    )
    assert main(["predict", str(tmp_path / "m.yaml"), str(tmp_path / "r.h5")]) == 2
    assert "has effects (drag)" in capsys.readouterr().err
    assert isinstance(read_material(tmp_path / "m.yaml"), Material)
