"""The bench of the weak form: motions that scripts make, its cases, and its tables."""

import json
from dataclasses import replace

import numpy as np
import pytest

from form_drake import Unidentifiable, __main__
from form_drake.bench import oracles, weak_form
from form_drake.bench.oracles import FINITE, Motions
from form_drake.laws import LAWS


def command(*words):
    return __main__.main(["bench", "weak-form", *(str(w) for w in words)])


@pytest.fixture(scope="module")
def motions(tmp_path_factory):
    return Motions.within(tmp_path_factory.mktemp("store"))


def test_every_law_has_a_motion():
    assert set(weak_form.MOTIONS) == set(LAWS)


def test_the_bench_runs_an_oracle_and_writes_the_error(tmp_path, capsys):
    out = tmp_path / "weak.json"
    assert command("--out", out, "--only", "exact/weakly", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result.items() <= json.loads(out.read_text()).items()
    (found,) = result["cases"].values()
    assert abs(found["errors"]["lam"]) < result["goals"]["exact"] and found["rows"] > 100
    assert "weakly-compressible" in weak_form.table(result)
    assert weak_form.table(result).endswith("met")


def test_elsewhere_than_in_a_checkout_one_line_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(oracles, "ORACLES", tmp_path / "oracles")
    assert command("--out", tmp_path / "weak.json") == 2
    said = capsys.readouterr().err.strip()
    assert "checkout" in said and "\n" not in said


def test_no_seed_is_one_line(tmp_path, capsys):
    assert command("--out", tmp_path / "weak.json", "--seeds", 0) == 2
    assert "--seeds 0" in capsys.readouterr().err


def test_noise_is_a_share_of_what_is_measured(motions):
    made = motions.recording("yeoh-uniaxial")
    changed = oracles.relative_noise(made, np.random.default_rng(0), level=1.0)
    np.testing.assert_array_equal(changed.reference, made.reference)
    moved = np.sqrt(np.mean((made.p_WQ - made.reference) ** 2))
    assert np.std(changed.p_WQ - made.p_WQ) == pytest.approx(0.01 * moved, rel=0.02)
    force, pushed = made.forces["pull_x"].value, changed.forces["pull_x"].value
    size = np.sqrt(np.mean(np.sum(force**2, axis=1)))
    assert np.std(pushed - force) == pytest.approx(0.01 * size, rel=0.15)


def test_laboratory_noise_is_stated_in_metres_and_forces(motions):
    made = motions.recording("yeoh-uniaxial")
    changed = oracles.laboratory_noise(made, np.random.default_rng(0))
    assert np.std(changed.p_WQ - made.p_WQ) == pytest.approx(20e-6, rel=0.02)
    force, pushed = made.forces["pull_x"].value, changed.forces["pull_x"].value
    assert np.std(pushed - force) == pytest.approx(0.01 * np.abs(force).max(), rel=0.15)


def test_a_strip_ends_at_its_clamp(tmp_path):
    plain = {"time": np.arange(9.0), "p_WQ": np.zeros((9, 8, 3)), "p_reference": np.zeros((8, 3))}
    stream = {
        "pose_pusher_time": np.arange(9.0),
        "pose_pusher_value": np.zeros((9, 4, 4)) + np.eye(4),
    }
    force = {"force_pusher_time": np.arange(9.0), "force_pusher_value": np.zeros((9, 3))}
    path = tmp_path / "bend-touching-a"
    np.savez(f"{path}.npz", **plain, **stream, **force, density=1000.0, gravity=np.zeros(3))
    facts = {"geometry": {}, "contact": {}, "law": "fixed-corotated", "known": {}}
    path.with_name("bend-touching-a.json").write_text(json.dumps(facts))
    path.with_name("bend-touching-a.truth.json").write_text('{"E": 1.0}')
    made = Motions(tmp_path).recording("bend-touching-a")
    assert made.geometry["high"].endswith("0.085") and made.contact["x+"] == "touched pusher"
    assert set(made.poses) == set(made.forces) == {"pusher"}
    assert made.known == {"nu": FINITE["bend-touching-a"]}


def test_refusals_are_counted_beside_errors(motions, monkeypatch):
    calls = []

    def refusing(recordings, estimators, options):
        calls.extend(estimators)
        return dict.fromkeys(estimators, Unidentifiable(("C1",), "noise hides it"))

    monkeypatch.setattr(weak_form, "estimates", refusing)
    monkeypatch.setattr(Motions, "recordings", lambda self, cases: [])
    monkeypatch.setattr(Motions, "truth", lambda self, case: {"C1": 1.0})
    found = weak_form.noisy(motions, ["any"], replace, ("gls", "ols"), 3)
    assert found["gls"]["refused"] == found["ols"]["refused"] == 3
    assert calls == ["gls", "ols"] * 3
    refused = weak_form.exact(motions, ["any"])
    assert calls[6:] == ["gls"]
    result = {"noise/yeoh/1/seeds3": found, "exact/yeoh": refused}
    text = weak_form.table({"cases": result, "goals": weak_form.GOALS})
    assert "refused: C1  MISSED" in text and " 3" in text


def test_summary_and_tables_show_every_kind():
    runs = [
        {"errors": {"E": e}, "std": {"E": 1.0}, "rows": 9, "condition": 1.0, "seconds": 2.0}
        for e in (-1.0, 0.5, 4.0)
    ]
    found = weak_form._summary(runs)
    assert found["median"] == {"E": 1.0} and found["coverage_90"]["E"] == pytest.approx(2 / 3)
    both = {"seeds": 3, "gls": found, "ols": found}
    size = {"rows": 2000, "points": 400, "frames": 201}
    cases = {
        "exact/yeoh": runs[2],
        "refused/yeoh": {"named": ["C1"], "expected": ["C1"]},
        "fe/press-a": runs[1],
        "fe-noise/bend-touching-a/seeds3": both,
        "noise/yeoh/0.3/seeds3": both,
        "time/press-b": {
            **size,
            "assembly_seconds": 0.5,
            "identification_seconds": 10.0,
            "assembly_megabytes": [80.0, 42.0],
        },
    }
    text = weak_form.table({"cases": cases, "goals": weak_form.GOALS})
    assert text.count("MISSED") == 2 and text.count(" met") == 4
    assert "covered in less than 80%: yeoh 0.3 E 67%" in text and "in 1 rows: none" in text
    assert "of all 3 values hold the truth in 67% (goal 80% to 98%)  MISSED" in text
    assert "20 times as much" in text and "67%" in text
    assert "0.50 (goal 2 met)" in text and "80 MB, of the first half of the frames 42 MB" in text
    off = {**found, "median": {"E": 2.1}}
    noisier = {
        f"noise/{law}/1/seeds3": {"seeds": 3, "gls": off, "ols": off} for law in ("gent", "yeoh")
    }
    text = weak_form.table({"cases": noisier, "goals": weak_form.GOALS})
    assert "gls, 1 %: median at most 2  MISSED: gent E, yeoh E" in text
