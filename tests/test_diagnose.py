"""A diagnosis: the hidden effect stands out, is named and added, and held-out motion gains by it.

Data and twin come from one solver here; other tests have data that no solver of ours made.
"""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.__main__ import main
from form_drake.bench.nulls import _again, _digest
from form_drake.diagnose import Cause, Model, Nulls, Scenes, prepare, verify
from form_drake.diagnose import diagnosed as diagnosis
from form_drake.diagnose.channel import Channel
from form_drake.diagnose.columns import twin_of
from form_drake.diagnose.lesser import lesser
from form_drake.diagnose.match import Match
from form_drake.diagnose.placebo import removals
from form_drake.diagnose.score import coherence, named_from, scores, shapes
from form_drake.diagnose.score import scored as one_scored
from form_drake.diagnose.search import matched
from form_drake.diagnose.thresholds import likeness
from form_drake.diagnose.verdict import WRONG, Found, Naming, shed
from form_drake.diagnose.verify import Check, Predicted, there
from form_drake.effects import CATALOGUE
from form_drake.identify.problem import Problem
from form_drake.laws import LAWS, law_named
from form_drake.material import Material, read_material
from form_drake.motion import body, fit_tracks
from form_drake.mpm.tracing import between
from form_drake.records import Recording, Stream, read, write_recording
from form_drake.systems.scenario import load_scenario
from form_drake.weak.fields import BoxFields
from form_drake.weak.ready import prepared
from form_drake.weak.unknowns import Unknowns
from form_drake.weak.windows import even

DX, NOISE = 0.004, 5e-6
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
START = {"mu": 19e3, "lam": 42e3}
DELAY = 4e-3
NAMES = ("stiffening", "anisotropy", "eigenstrain", "drag", "density", "force-bias", "force-delay")
EFFECTS = [CATALOGUE[name] for name in NAMES]


def probe(seconds, stroke, beat):
    """A block under a bonded plate that presses, and goes back."""
    low, size = np.array([-0.01, -0.01, 0.0]), np.full(3, 0.02)
    X = low + size * np.random.default_rng(0).uniform(0.04, 0.96, (120, 3))
    t = np.linspace(0.0, seconds, round(150 * seconds) + 1)
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    pose[:, 2, 3] = 0.02 - stroke * np.sin(np.pi * t / seconds) ** 2 - 2e-4 * np.sin(beat * t)
    return Recording.from_arrays(
        t,
        np.tile(X, (len(t), 1, 1)),
        p_reference=X,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.02"},
        contact={"z-": "bonded floor", "z+": "bonded plate", "other": "free"},
        poses={"plate": Stream(t, pose)},
        forces={"plate": Stream(t, np.zeros((len(t), 3)))},
        law=LAW.name,
    )


def noisy(made, seed):
    rng = np.random.default_rng(seed)
    force = made.forces["plate"]
    size = 0.005 * np.abs(force.value).max()
    value = force.value + size * rng.standard_normal(force.value.shape)
    return replace(
        made,
        p_WQ=made.p_WQ + NOISE * rng.standard_normal(made.p_WQ.shape),
        noise=NOISE,
        forces={"plate": Stream(force.time, value, noise=size)},
    )


PROBE = probe(0.4, 1.6e-3, 50.0)


def rolled(*causes):
    (made,) = Scenes.of((PROBE,), DX).rolled(Model(LAW, TRUTH, causes))
    return made


def problem_of(data):
    shape = body(data)
    fields = BoxFields.of(shape, frozenset(data.forces), spans=(1, 1, 3), clear=DX)
    fit = fit_tracks(data, shape, symmetric=False)
    seen = prepared(data, "probe", [fields], even(0.0, 0.4, 0.12, 0.05), shape, fit)
    return Problem.of([seen], Unknowns.of(LAW, {}, "law"), "borne")


def fitted(data):
    """A twin that has been brought near to the data from a wrong start."""
    return matched(Match.of(problem_of(data), Scenes.of((data,), DX), Model(LAW, START)))


@cache
def scored(name=None):
    """Scores where an effect of ``HIDDEN`` acts, or nothing does, and the twin that they are about."""
    causes = [Cause(CATALOGUE[name], *HIDDEN[name])] if name else []
    match = fitted(noisy(rolled(*causes), 0))
    return scores(match, EFFECTS), match


def test_nothing_stands_out_where_nothing_is_hidden():
    found, match = scored()
    assert max(s.score for s in found) < 12.0
    assert match.left @ match.left < 1.3 * len(match.left)
    for k, true in TRUTH.items():
        assert match.model.values[k] == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("needed", [True, False])
def test_what_has_become_needless_goes(needed):
    """A delay that was found first, and swelling beside it."""
    swelling = Cause(CATALOGUE["eigenstrain"], 5e-3, {})
    late = Cause(CATALOGUE["force-delay"], 4e-3, {})
    begun = fitted(noisy(rolled(swelling, *[late] * needed), 0))
    first, then = (replace(begun.model, causes=c) for c in ((late,), (late, swelling)))
    passes = [Found(begun, ()), Found(begun.near(first), ())]
    match, left, gone = shed(matched(begun.near(then)), passes, {})
    assert [c.effect.id for c in match.model.causes] == ["force-delay"] * needed + ["eigenstrain"]
    assert gone == [] if needed else gone == ["force-delay"] and left[0].match is begun
    assert len(left) == 1 + needed
    assert match.model.causes[-1].coefficient == pytest.approx(5e-3, rel=0.1)


def test_what_each_of_two_effects_is_worth_is_told_without_it():
    swelling, late = (
        Cause(CATALOGUE["eigenstrain"], 5e-3, {}),
        Cause(CATALOGUE["force-delay"], 4e-3, {}),
    )
    begun = fitted(noisy(made := rolled(swelling, late), 0))
    match = matched(begun.near(replace(begun.model, causes=(swelling, late))))
    check = Check.of(Scenes.of((noisy(made, 1),), DX), begun)
    naming = SimpleNamespace(match=match, added=match.told.causes)
    after = check.predicted(match)
    assert check.shows(after)
    soft, slow = removals(naming, check, after)
    assert [soft.effect.id, slow.effect.id] == ["eigenstrain", "force-delay"]
    tracks, force, *_ = (c for c in slow.channels)
    assert (
        force.name == "force of plate 1" and force.before > 3.0 * force.after and not tracks.counts
    )
    tracks, *_ = soft.channels
    assert tracks.before > 3.0 * tracks.after
    assert not any(c.worse for one in (soft, slow) for c in one.channels)
    alone = SimpleNamespace(match=match, added=match.told.causes[:1])
    assert list(removals(alone, check, after)) == []


HIDDEN = {
    "anisotropy": (4e3, {"azimuth": np.radians(45.0), "elevation": 0.0}),
    "force-delay": (4e-3, {}),
    "eigenstrain": (5e-3, {}),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_the_hidden_effect_stands_out(name):
    effect, (size, _) = CATALOGUE[name], HIDDEN[name]
    found, _ = scored(name)
    assert found[0].effect is effect and found[0].score > 2.0 * found[1].score
    assert 0.5 < found[0].coefficient / size < 2.0  # to first order, about moduli that took a part
    assert found[0].limit < size
    assert np.allclose(np.diag(coherence(found)), 1.0)


def test_simpler_statistics_leave_out_what_they_do_not_know():
    """All rows alike, by a least-squares fit of the law and one effect's column to what the data leave."""
    _, match = scored("force-delay")
    found = {way: {s.effect.id: s for s in every} for way, every in lesser(match, EFFECTS).items()}
    assert set(found) == {"ols", "diagonal", "gls"}
    column = match.raw.of(CATALOGUE["force-delay"], [{}])
    squares = []
    for columns in (match.slopes, np.column_stack([match.slopes, column])):
        _, (square,), *_ = np.linalg.lstsq(columns, match.rest, rcond=None)
        squares.append(square)
    spread = squares[0] / (len(match.rest) - match.slopes.shape[1])
    gain = (squares[0] - squares[1]) / spread
    assert found["ols"]["force-delay"].score == pytest.approx(gain, rel=1e-6)
    size = match.by.sizes
    own = match.seen_by(match.by, match.rest)
    left = [
        match.rest
        - match.slopes
        @ np.linalg.lstsq(match.slopes / size[:, None], match.rest / size, rcond=None)[0]
    ]
    assert found["diagonal"]["force-delay"].score < np.sum((left[0] / size) ** 2)
    assert found["gls"]["force-delay"].score < own.left @ own.left
    assert match.left @ match.left < own.left @ own.left  # a twin has what reading costs


def test_a_score_counts_what_a_possible_size_explains():
    """Nothing can be softer than without stiffness, however much the column alone would take."""
    tried, columns = [{"n": 0.0}, {"n": 1.0}], np.eye(4)[:, :2]
    for left, (n, size, score) in {
        (-3.0, 2.0, 0.0, 1.0): (0, -1.0, 5.0),
        (-3.0, 2.5, 0.0, 1.0): (1, 2.5, 6.25),
    }.items():
        match = SimpleNamespace(
            columns=lambda effect, shapes: columns, off=lambda a: a, left=np.array(left)
        )
        best = one_scored(match, CATALOGUE["inclusion"], tried)
        assert (best.shape, best.coefficient) == (tried[n], pytest.approx(size))
        assert best.score == pytest.approx(score - 2.0 * np.log(2.0))


@pytest.mark.parametrize(("there", "limit"), [(0.0, 5.0 / 25.0), (2.0, 5.0 / 25.0), (4.0, 0.1)])
def test_a_limit_is_that_of_the_best_shape_or_their_median_where_nothing_is_seen(there, limit):
    """In standard deviations at the last shape, which rows see best."""
    effect = CATALOGUE["anisotropy"]
    tried = effect.grid()[:49]
    columns = np.eye(60)[:, : len(tried)] * np.linspace(1.0, 50.0, len(tried))
    left = there * np.eye(60)[len(tried) - 1]
    match = SimpleNamespace(columns=lambda effect, shapes: columns, off=lambda a: a, left=left)
    best = one_scored(match, effect, tried)
    assert best.score == pytest.approx(max(there**2 - 2.0 * np.log(len(tried)), 0.0))
    assert best.limit == pytest.approx(limit, rel=0.05)
    assert not there or best.shape == tried[-1]


@pytest.mark.parametrize("name", ["anisotropy", "drag"])
def test_an_effect_is_named_from_the_size_that_scores_its_threshold(name):
    """A score is less by what it gains from the number of shapes that are tried."""
    effect = CATALOGUE[name]
    tried = effect.grid()
    columns = np.eye(60)[:, : len(tried)]
    left = named_from(effect, 20.0) * columns[:, -1]
    match = SimpleNamespace(columns=lambda effect, shapes: columns, off=lambda a: a, left=left)
    assert one_scored(match, effect, tried).score == pytest.approx(20.0)


def test_places_lie_inside_the_body():
    shape = body(PROBE)
    tried = shapes(CATALOGUE["inclusion"], shape)
    places = np.array([[one[k] for k in "xyz"] for one in tried])
    assert len(tried) == 125 and np.all((places > shape.low) & (places < shape.high))
    assert tried[0]["radius"] == pytest.approx(0.004)
    assert shapes(CATALOGUE["drag"], shape) == [{}]


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
    assert [g["channel"] for g in found["gap"]] == ["tracks 1", "force of plate 1", "balance"]
    assert all(g["before"] == g["after"] and g["closure"] is None for g in found["gap"])
    for key, true in TRUTH.items():
        assert found["values"][key] == pytest.approx(true, rel=0.03)
    assert read_material(out / "material.yaml").effects == ()
    (left,) = found["passes"][0]["ledgers"]
    assert left["onset"] is None and max(left["interior"], left["tool"]) < 1.5
    assert "before and after are one prediction" in (out / "report.html").read_text()


def test_what_only_held_out_motion_shows_is_a_doubt(files, capsys):
    found, out = diagnosed(files, capsys, "plain", "--holdout", str(files / "late1.h5"))
    assert found["verdict"] == "none" and found["effects"] == []
    (doubt,) = found["doubts"]
    assert "off by more than noise, grid and moduli explain" in doubt
    assert doubt in (out / "report.html").read_text()


def test_what_is_missing_is_named_added_and_closes_the_gap(files, capsys):
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
    subprocess.run([sys.executable, "-m", "form_drake", "predict", *predict], check=True)
    made, seen = (read(files / name).forces["plate"].value for name in ("p.h5", "late1.h5"))
    left = float(np.sqrt(np.mean((made - seen) ** 2)))
    assert left == pytest.approx(np.hypot(force["after"], force["noise"]), rel=0.15)
    assert left < 0.5 * force["before"]
    (again,) = found["written"]  # by the command itself
    assert again["failed"] is None and again["tracks"] < 1e-6
    assert again["forces"]["plate"] < 0.1 * force["noise"]
    assert "differs from what was verified" in page

    # what is known already is not found again, nor counted as found
    again, _ = diagnosed(files, capsys, "late", "--material", written)
    assert again["verdict"] == "none" and again["effects"] == []


def test_nulls_of_recordings_stand_for_such_recordings(files, capsys):
    out, written = files / "nulls.json", files / "true.yaml"
    Model(LAW, TRUTH).material(1000.0).write(written)
    words = ["bench", "nulls", "--draws", "1", "--dx", str(DX), "--out", str(out), "--json"]
    assert main([*words, "--like", str(files / "plain0.h5")]) == 2
    assert "--material MATERIAL.yaml are wanted together" in capsys.readouterr().err
    assert main([*words, "--material", str(written), "--like", str(files / "plain0.h5")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert len(told["scores"]) > 15 and max(told["scores"].values()) < 16.0
    (errors,) = next(iter(told["cases"].values()))["errors"]
    assert errors == pytest.approx([0.0, 0.0], abs=0.03)

    own, scenes = Nulls.read(out), Scenes.of((read(files / "plain0.h5"),), DX)
    assert own.thresholds["drag"] == 1.5 * told["scores"]["drag"]
    (seen,), drag = scenes.recordings, Cause(CATALOGUE["drag"], 2.0, {})
    own.require_like(likeness(replace(scenes, recordings=(replace(seen, noise=1.2 * NOISE),)), LAW))
    felt = {k: replace(s, noise=2.0 * s.noise) for k, s in seen.forces.items()}
    twice = replace(scenes, recordings=2 * scenes.recordings, dx=(DX, DX))
    for other, told in (
        (likeness(scenes, LAWS["yeoh"]), "law fixed-corotated, these recordings have yeoh"),
        (likeness(scenes, LAW, [drag]), "known effects none, these recordings have drag"),
        (likeness(scenes.times(2.0), LAW), "grid spacing .m. 0.004, these recordings have 0.008"),
        (_with(scenes, noise=2.0 * NOISE), "noise of tracks .m. 5e-06, .* have 1e-05"),
        (_with(scenes, forces=felt), "noise of forces"),
        (likeness(twice, LAW), "noise of tracks .m. 5e-06, .* have 5e-06, 5e-06"),
    ):
        with pytest.raises(ValueError, match=told):
            own.require_like(other)
        Nulls.common().require_like(other)


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


def test_held_out_forces_count_among_the_frames_alone():
    time, force = PROBE.time[:30], PROBE.forces["plate"]
    short = replace(PROBE, time=time, p_WQ=PROBE.p_WQ[:30], noise=1e-6)
    scenes = Scenes.of((short,), DX)
    still = scenes.recordings[0]
    assert still.forces["plate"].time[-1] == time[-1] < force.time[-1]
    predicted = Predicted((still,), (still,), None)
    loud = np.where(force.time > time[-1] + 1e-9, 5.0, 0.0)[:, None] + force.value
    seen = replace(short, forces={"plate": Stream(force.time, loud, noise=1e-3)})
    _, channel = Check(Scenes.of((seen,), DX), None, predicted).channels(predicted)
    assert channel.before == 0.0 and not channel.counts


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


def test_what_grids_may_have_wrong_makes_no_prediction_worse():
    channel = Channel("force", "N", before=0.8, after=1.1, noise=0.5, samples=1250, grid=0.0)
    assert channel.floor == pytest.approx(
        0.5 * 0.0032**0.25
    )  # of chance, and of a noise told to 2 %
    assert channel.worse and channel.closure == pytest.approx(-0.3 / (0.8 - channel.floor))
    assert not replace(channel, grid=0.4).worse  # two of these beside a twentieth of the error
    assert not replace(channel, after=0.85).worse
    assert not replace(channel, noise=3.0).worse  # noise would do as much


def test_errors_far_below_the_noise_of_a_sample_are_told_where_there_are_many():
    """Two thirds of it, and a thirtieth after: what noise adds to a mean square is taken off."""
    rng, shape, noise = np.random.default_rng(1), PROBE.p_WQ.shape, 1e-4
    before, after = (share * noise * rng.standard_normal(shape) for share in (2 / 3, 1 / 30))
    force = PROBE.forces["plate"]
    seen = replace(PROBE, p_WQ=PROBE.p_WQ + noise * rng.standard_normal(shape), noise=noise)
    pushed = 0.5 * rng.standard_normal(force.value.shape)  # half of what is stated, and no error
    seen = replace(seen, forces={"plate": replace(force, value=force.value + pushed, noise=1.0)})
    off = [replace(PROBE, p_WQ=PROBE.p_WQ + error) for error in (before, after)]
    check = Check(Scenes((seen,), (DX,)), None, Predicted((off[0],), (off[0],), None))
    tracks, still = check.channels(Predicted((off[1],), (off[1],), None))
    assert tracks.samples == np.prod(shape) and tracks.floor < 0.25 * noise
    assert tracks.before == pytest.approx(noise / 1.5, rel=0.1) and tracks.counts
    assert tracks.after < 2.0 * tracks.floor and tracks.closure > 0.5
    assert not replace(tracks, samples=20).counts  # chance would do as much
    assert still.before == 0.0 and not still.counts


@pytest.mark.parametrize("lost_as", [np.nan, 0.0])
def test_what_is_lost_counts_in_no_error_wherever_it_is_put(lost_as):
    """And what the grid changes is projected out of what is left: here it is all that is."""
    rng, shape = np.random.default_rng(0), PROBE.p_WQ.shape
    grid, more = (1e-4 * rng.standard_normal(shape) for _ in range(2))
    valid = rng.random(shape[:2]) > 0.4
    valid[0, 3] = False  # of a point whose reference is stated
    p_WQ = np.where(valid[..., None], PROBE.p_WQ + grid, lost_as)
    seen = replace(PROBE, p_WQ=p_WQ, valid=valid, noise=1e-6)
    coarse, after = (replace(PROBE, p_WQ=PROBE.p_WQ + one) for one in (grid, grid + more))
    check = Check(Scenes((seen,), (DX,)), None, Predicted((PROBE,), (coarse,), None))
    tracks, _ = check.channels(Predicted((after,), (coarse,), None))
    assert tracks.before == pytest.approx(0.0, abs=1e-12)
    assert tracks.grid == pytest.approx(np.sqrt(np.mean(grid[valid] ** 2)))
    assert tracks.after == pytest.approx(np.sqrt(np.mean(more[valid] ** 2)), rel=0.01)
    unstated = replace(seen, p_reference=None)
    assert not there(unstated)[:, 3].any() and np.array_equal(there(seen), valid)


def rows_of(before, after, chance=50.0):
    """Of held-out rows of unit variance, before and after: one that effects change, and another."""
    own = [np.array(rows) for rows in (before, after)]
    by = SimpleNamespace(white=lambda a: a)
    match = SimpleNamespace(gap=own[1], apart=own[1], by=by, chance_apart=chance)
    was = SimpleNamespace(match=SimpleNamespace(apart=own[0]))
    return Check(SimpleNamespace(), None, was), Predicted((), (), match)


def borne_out(*told, **more):
    check, after = rows_of(*told, **more)
    return check.bears_out(after)


def test_held_out_rows_that_keep_more_than_noise_refuse_what_was_found():
    most = np.sqrt(50.0 + 4.0 * np.sqrt(125.0))
    assert borne_out((0.0, 0.99 * most), (0.0, 0.99 * most))
    assert not borne_out((0.0, 1.01 * most), (0.0, 1.01 * most))
    for share, fits in ((0.9, True), (1.1, False)):  # of what simulations of effects have wrong
        left = np.sqrt(most**2 + share * WRONG**2 * 900.0)
        assert borne_out((30.0, left), (0.0, left)) is fits


@pytest.mark.parametrize(
    ("predicted", "there", "fits"),
    [(3.9, 0.0, True), (4.1, 0.0, False), (4.1, 0.6, True), (20.0, 0.7, False), (20.0, 0.75, True)],
)
def test_held_out_rows_change_by_as_much_as_was_predicted(monkeypatch, predicted, there, fits):
    """In standard deviations; from four on they tell. The share that is there is known to 1/predicted."""
    gap = there * predicted
    assert borne_out((gap, 0.0), (gap - predicted, 0.0)) is fits
    check, after = rows_of((gap, 0.0), (gap - predicted, 0.0))
    check = replace(
        check, before=SimpleNamespace(match=check.before.match, recordings=(), coarse=())
    )
    check.scenes.recordings, own = (), SimpleNamespace(counts=False)
    monkeypatch.setattr(Check, "channels", lambda *a: [own])
    assert check.shows(after) is (predicted > 4.0)
    own.counts = True
    assert check.shows(after)
    if there:
        assert borne_out(((2.0 - there) * predicted, 0.0), (-gap + predicted, 0.0)) is fits


def test_a_diagnosis_reads_one_source_of_the_force(tmp_path, monkeypatch, capsys):
    """As a probe of the station is recorded, whose arm feels the force as well."""
    (stamps, still), felt = (PROBE.forces["plate"].time, PROBE.forces["plate"].value), {}
    both = {"plate": Stream(stamps, still), "plate:joint-torque": Stream(stamps, still + 2.0)}
    path = str(tmp_path / "probe.h5")
    write_recording(replace(PROBE, forces=both, noise=2e-5), tmp_path / "probe.h5")

    def diagnosed(recordings, law, **how):
        felt.update({name: float(f.value.max()) for name, f in recordings[0].forces.items()})
        raise ValueError("far enough")

    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", diagnosed)
    out = str(tmp_path / "out")
    for source, largest in (("sensor", 0.0), ("joint-torque", 2.0)):
        assert main(["diagnose", path, "--out", out, "--force", source]) == 2
        assert felt == {"plate": largest} and "far enough" in capsys.readouterr().err
    assert main(["diagnose", path, "--out", out, "--force", "scales"]) == 2
    assert "no force comes from scales; the recording has" in capsys.readouterr().err


def test_held_out_motion_verifies_nothing_if_it_fails_without_effects_and_refuses_if_with_them(
    monkeypatch,
):
    """What was named stays where its recording is what fails."""
    own = SimpleNamespace(values={})
    passes = (SimpleNamespace(match=SimpleNamespace(model=own), alike=()),)
    found = Naming(passes, SimpleNamespace(told=own), (Cause(CATALOGUE["drag"], 2.0, {}),), "named")
    read_as = SimpleNamespace(probes=[SimpleNamespace(body=SimpleNamespace(density=1000.0))])
    for name, made in (("read", (read_as, own)), ("named", found)):
        monkeypatch.setattr(f"form_drake.diagnose.diagnosis.{name}", lambda *a, made=made: made)

    def fails(*arguments):
        raise ValueError("it broke down")

    seen = replace(PROBE, noise=NOISE)
    unseen = replace(seen, p_WQ=PROBE.p_WQ + 1e-9)

    def told():
        return diagnosis([seen], LAW, effects=[], thresholds={}, holdout=[unseen], dx=DX)

    with pytest.raises(ValueError, match="hold the same motion"):
        diagnosis([seen], LAW, effects=[], thresholds={}, holdout=[seen], dx=DX)

    monkeypatch.setattr(Check, "of", fails)
    assert told().verdict == "named" and told().unverified == "it broke down"
    monkeypatch.setattr(Check, "of", lambda *a: SimpleNamespace(predicted=fails))
    assert told().verdict == "unnamed"
    assert told().sentence().endswith("fails, held-out motion as predicted: it broke down")


@pytest.mark.parametrize(
    ("known", "values"),
    [
        ({"lam": 40e3}, {"mu": 24e3, "lam": 40e3}),
        ({"nu": 1.0 / 3.0}, {"mu": 24e3, "lam": 48e3}),
        ({"mu": 20e3, "lam": 40e3}, {"mu": 20e3, "lam": 40e3}),
    ],
)
def test_what_is_declared_as_known_stays_while_a_twin_is_fitted(known, values):
    unknowns = Unknowns.of(LAW, known, "law")
    model, twin = Model(LAW, TRUTH), SimpleNamespace(coordinates=lambda v: (np.zeros(0), theta))
    theta = np.array([TRUTH["mu"], TRUTH["lam"]])
    problem = SimpleNamespace(unknowns=unknowns, values=lambda eta: {})
    match = Match(problem, twin, None, None, model, None)
    assert match.valued(np.zeros(len(unknowns.keys))) == pytest.approx(TRUTH)
    phi = match._phi
    assert match.valued(0.2 * phi) == pytest.approx(values)
    assert np.allclose(match.within(9.0 * phi), phi)  # twice as large, at most


def test_a_diagnosis_begins_with_what_recordings_declare(monkeypatch):
    told = {}

    def reading(scenes, law, known):
        told.update(known)
        raise ValueError("far enough")

    monkeypatch.setattr("form_drake.diagnose.diagnosis.read", reading)
    seen, more = replace(PROBE, known={"lam": 40e3}, noise=2e-5), {"effects": [], "thresholds": {}}
    for start in (None, Model(LAW, TRUTH)):
        told.clear()
        with pytest.raises(ValueError, match="far enough"):
            diagnosis([seen], LAW, start=start, dx=DX, **more)
        assert told == {"lam": 40e3}
    with pytest.raises(
        ValueError, match="the material has lam 42000, the recordings declare 40000"
    ):
        diagnosis([seen], LAW, start=Model(LAW, START), dx=DX, **more)


def test_constants_that_nothing_finds_are_asked_for_where_they_can_be_stated():
    with pytest.raises(ValueError, match="needs given values for n: state them in a --material"):
        prepare.read(None, law_named(f"{LAW.name}+rate-dependence"), {})


BAD = {  # what recordings lack, and what is said
    "no poses": (lambda r: {"poses": {}}, "add its poses"),
    "no faces": (lambda r: {"contact": {"z-": "bonded floor", "z+": "bonded plate"}}, "is unknown"),
    "short poses": (
        lambda r: {"poses": {"plate": Stream(r.time[:20], r.poses["plate"].value[:20])}},
        "must cover the frames",
    ),
    "late force": (
        lambda r: {"forces": {"plate": Stream(r.time + 0.3, r.forces["plate"].value)}},
        "the clocks must overlap",
    ),
    "few frames": (lambda r: {"time": r.time[:4], "p_WQ": r.p_WQ[:4]}, "state noise"),
    "no box": (lambda r: {"geometry": {}}, "geometry: shape None"),
    "no density": (lambda r: {"density": None}, "needs the recording's density"),
    "no sensor": (lambda r: {"forces": {"plate:scales": r.forces["plate"]}}, "comes from sensor"),
    "gravity alone": (
        lambda r: {"body_force": np.zeros(r.p_WQ.shape)},
        "states body_force",
    ),
    "lost points": (
        lambda r: {
            "p_reference": None,
            "p_WQ": np.concatenate([r.p_WQ[:1] * [[[np.nan]]], r.p_WQ[1:]]),
            "valid": np.arange(r.frames)[:, None] + 0 * r.p_WQ[0, :, 0] > 0,
        },
        "120 points have no stress-free position",
    ),
}


@pytest.mark.parametrize("lacks", BAD)
def test_every_recording_is_looked_at_before_anything_is_simulated(
    tmp_path, monkeypatch, capsys, lacks
):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", None)
    paths = [tmp_path / "press.h5", tmp_path / "other.h5"]
    write_recording(replace(PROBE, noise=2e-5), paths[0])
    change, told = BAD[lacks]
    other = replace(PROBE, p_WQ=PROBE.p_WQ + 1e-6)
    write_recording(replace(other, **change(other)), paths[1])
    words = ["diagnose", str(paths[0]), "--holdout", str(paths[1]), "--out", str(tmp_path / "o")]
    assert main(words) == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0 and f"{paths[1]}: " in said and told in said


def test_points_of_faces_alone_are_not_read(tmp_path, monkeypatch, capsys):
    """What is inside would be made up by the fit, and a stiffer part found in it."""
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", None)
    seen = replace(PROBE, face=np.arange(PROBE.points) % 6, noise=2e-5)
    write_recording(seen, tmp_path / "seen.h5")
    assert main(["diagnose", str(tmp_path / "seen.h5"), "--out", str(tmp_path / "o")]) == 2
    assert "seen.h5: all points are stated to lie on faces" in capsys.readouterr().err
    with pytest.raises(ValueError, match="needs points throughout the body"):
        prepare.probe(seen, "probe", DX)
    verify.require_stated(seen, DX, held_back=True)  # compared, not read


def test_exact_tracks_need_a_noise_that_they_stand_for(tmp_path, monkeypatch, capsys):
    """Else what the grid has wrong would be taken for something missing."""
    reached = ValueError("it is read")

    def diagnosed(*arguments, **more):
        raise reached

    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", diagnosed)
    made, path = rolled(), tmp_path / "exact.h5"
    for noise, told in ((None, "seem exact"), (0.0, "seem exact"), (2e-5, "it is read")):
        write_recording(replace(made, noise=noise), path)
        assert main(["diagnose", str(path), "--out", str(tmp_path / "o")]) == 2
        assert told in capsys.readouterr().err


def test_recordings_of_other_laws_are_no_probes_of_one_specimen(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", None)
    paths = [tmp_path / "press.h5", tmp_path / "other.h5"]
    laws = zip(paths, ("fixed-corotated", "yeoh"), (0.0, 1e-6), strict=True)
    for path, law, shift in laws:
        write_recording(replace(PROBE, law=law, p_WQ=PROBE.p_WQ + shift), path)
    assert main(["diagnose", *map(str, paths), "--out", str(tmp_path / "o")]) == 2
    assert "the recordings declare fixed-corotated and yeoh" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("part", "whose"),
    [("problem_of", "as measured"), ("_read", "as predicted without the effects")],
)
def test_held_out_motion_that_cannot_be_read_says_why(monkeypatch, part, whose):
    """As measured, or as predicted without the effects; tracks and forces are compared even so."""

    def fails(*arguments):
        raise ValueError("too few points")

    monkeypatch.setattr("form_drake.diagnose.verify._rolled", lambda *a: ((), ()))
    monkeypatch.setattr("form_drake.diagnose.verify.problem_of", lambda *a: None)
    monkeypatch.setattr(f"form_drake.diagnose.verify.{part}", fails)
    fitted = SimpleNamespace(problem=SimpleNamespace(unknowns=None))
    check = Check.of(Scenes.of((PROBE,), DX), fitted)
    assert check.unread == f"{whose}, too few points" and check.bears_out(check.before)
    after = SimpleNamespace(gap=np.full(50, 3.0), chance_apart=50.0)
    assert not check.bears_out(Predicted((), (), after))  # noise does not explain it
