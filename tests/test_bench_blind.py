"""The blind bench: sealed sets, verdicts that are written once, and what they are worth."""

import fcntl
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from form_drake.__main__ import main
from form_drake.bench import blind, blind_score, blind_table, cases
from form_drake.bench.blind_cases import PROBES
from form_drake.bench.blind_score import RATES, _errors, digest, score, wilson
from form_drake.bench.blind_sizes import SIZES, compared, limits
from form_drake.bench.oracles import recorded
from form_drake.diagnose.motions import Block
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.records import write_recording

ORACLES = Path(__file__).parent / "oracles"
SEALS = sorted((Path(__file__).parents[1] / "docs" / "blind").rglob("key.sha256"))
sys.path.insert(0, str(ORACLES))
hidden = importlib.import_module("hidden_effects_cases")


def oracle(name, *words):
    subprocess.run([sys.executable, ORACLES / name, *map(str, words)], check=True, text=True)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set")
    counts = ["--single", 3, "--near", 1, "--null", 2, "--pair", 1, "--outside", 2, "--noise", 1]
    for name in ("a", "b"):
        words = ["--set", folder / f"{name}.json", "--key", folder / f"key-{name}.json"]
        oracle("hidden_effects_set.py", "--seed", 5, *words, *counts)
    return folder


def test_a_set_is_drawn_again_from_its_seed_and_tells_no_effect(drawn):
    assert (drawn / "a.json").read_bytes() == (drawn / "b.json").read_bytes()
    listed = json.loads((drawn / "a.json").read_text())
    kinds = sorted(one["kind"] for one in listed)
    assert kinds == sorted(
        ["single"] * 3 + ["near", "null", "null", "pair", "noise"] + ["outside"] * 2
    )
    assert kinds != [one["kind"] for one in listed] and set(listed[0]) == {"id", "seed", "kind"}
    key = json.loads((drawn / "key-a.json").read_text())
    assert blind.sealed(drawn / "key-a.sha256") == digest(key)
    first = next(iter(key.values()))
    first["effects"]["drag"] = {"c": 1.0}
    assert digest(key) != blind.sealed(drawn / "key-a.sha256")


@pytest.mark.parametrize("seal", SEALS, ids=lambda path: path.parent.name)
def test_a_seal_is_that_of_its_set(seal):
    """Else no key could open it. What is hidden follows from the seeds."""
    listed = json.loads((seal.parent / "set.json").read_text())
    key = {one["id"]: hidden.case_of(one["seed"], one["kind"]) for one in listed}
    assert all(key[name]["id"] == name for name in key)
    assert digest(key) == blind.sealed(seal)


def test_noise_is_in_the_files_and_stated(tmp_path):
    words = ["--seed", 3, "--kind", "null", "--small", "--level", "coarse", "--points", 40]
    for name, more in (("plain", []), ("noisy", ["--noisy"])):
        oracle("hidden_effects.py", *words, "--out", tmp_path / name / "c", *more)
    (folder,) = (tmp_path / "noisy" / "c").iterdir()
    made, still = (
        recorded(folder / "press"),
        recorded(tmp_path / "plain" / "c" / folder.name / "press"),
    )
    assert made.noise == 5e-5 and still.noise is None
    assert (made.p_WQ - still.p_WQ).std() == pytest.approx(5e-5, rel=0.05)
    forces = [r.forces["plate"] for r in (made, still)]
    assert forces[0].noise == pytest.approx(0.01 * abs(forces[1].value).max(), rel=1e-6)
    assert (forces[0].value - forces[1].value).std() == pytest.approx(forces[0].noise, rel=0.1)


def effect(name, *alike):
    one = {"name": name, "class": [name, *alike], "coefficient": 0.0, "std": 1e-9}
    where = {key: 0.01 for key in ("x", "y", "z", "radius", "strain", "azimuth", "elevation")}
    return {**one, "where": where}


GAP = {"before": 0.8, "after": 0.2, "noise": 0.6, "floor": 0.1, "closure": 0.9}


def verdicts(key, seal, out, **more):
    """Verdicts by hand: of the singles one right, one by its class, one wrong."""
    kinds = {}
    for name, truth in key.items():
        kinds.setdefault(truth["kind"], []).append((name, list(truth["effects"])))
    lines = []

    def told(name, verdict, *effects, gap=(), placebos=()):
        passes = [{"scores": {"drag": 3.0 + len(lines)}}]
        lesser = {"ols": {"density": 20.0}, "gls": {}}
        one = {"id": name, "verdict": verdict, "named": verdict, "effects": list(effects)}
        one["lesser"] = lesser
        one["placebos"] = [{"gap": [{**GAP, "closure": c}]} for c in placebos]
        lines.append({**one, "gap": list(gap), "passes": passes, "seconds": 100.0, **more})

    (a, (right,)), (b, (twin,)), (c, _) = kinds["single"]
    told(a, "named", effect(right), gap=[GAP, {**GAP, "closure": None}], placebos=(0.4, 0.1))
    told(b, "ambiguous", effect("other", twin))
    told(c, "named", effect("nonsense"), gap=[GAP], placebos=(0.8, 0.8))
    told(kinds["null"][0][0], "none")
    told(kinds["null"][1][0], "unnamed", effect("inclusion"))
    told(kinds["near"][0][0], "named", effect("nonsense"))
    told(kinds["pair"][0][0], "named", *map(effect, kinds["pair"][0][1]))
    told(kinds["outside"][0][0], "unnamed")
    told(kinds["outside"][1][0], "named", effect("density"))
    told(kinds["noise"][0][0], "error")
    head = {"code": "c", "seal": seal}
    out.write_text("".join(json.dumps(x) + "\n" for x in (head, *lines)))


def test_what_verdicts_are_worth(drawn, tmp_path, capsys):
    key, seal = drawn / "key-a.json", drawn / "key-a.sha256"
    out = tmp_path / "blind.json"
    verdicts(json.loads(key.read_text()), blind.sealed(seal), out)
    found = score(out, key, seal)
    rates = {name: (r["hits"], r["of"]) for name, r in found["rates"].items()}
    assert rates == {
        "right class, strong singles": (2, 3),
        "right class and named": (1, 3),
        "right class and nothing else": (2, 3),
        "right by declared classes, and sign": (0, 3),  # of no size, and by a verdict's own class
        "false alarms on nulls": (1, 2),
        "nulls, not told that nothing is missing": (1, 2),
        "out of catalogue, refused": (1, 2),
        "out of catalogue, refused without held-out": (1, 2),
        "out of catalogue, confidently misnamed": (1, 2),
        "near threshold, confidently wrong": (1, 1),
        "near threshold, right class": (0, 1),
        "pairs, both named": (1, 1),
        "pairs, both named and nothing else": (1, 1),
        "wrong noise, confident names": (0, 0),  # an error is no name that was not given
        "wrong noise, confidently wrong": (0, 0),
    }
    wanted = {"beyond noise": 0.25, "with noise": np.sqrt(0.4), "noise alone": 0.6, "closure": 0.9}
    told = {k: pytest.approx(v) for k, v in wanted.items()}
    assert found["gap"] == {"channels": 1, "excluded": 1, **told}
    earlier = {"before": 2.0, "after": 0.5, "floor": 0.3}  # which hold the noise
    pure, loud, noise = _errors(earlier)
    assert pure == pytest.approx([np.sqrt(4.0 - 0.09), 0.4]) and noise == 0.3
    assert list(loud) == [2.0, 0.5]
    assert found["placebos"] == {"cases": 1, "named": 0.9, "runner-up": 0.4, "drawn": 0.1}
    assert found["nulls"] == {"drag": 7.0} and len(found["confusions"]) == 2
    truth = json.loads(key.read_text()).values()
    singles = [set(t["effects"]) for t in truth if t["kind"] == "single"]
    ways = {"full": {"drag"}, "gls": set(), "ols": {"density", "force-gain"}}  # one class
    for way, names in ways.items():
        assert found["ablation"][way]["right"] == [sum(bool(s & names) for s in singles), 3]
    assert {way: own["false"] for way, own in found["ablation"].items()} == {
        "ols": [2, 2],
        "gls": [0, 2],
        "full": [0, 2],
    }
    words = ["bench", "blind", "--seal", str(seal), "--score", str(out), "--key", str(key)]
    assert main(words) in (None, 0)
    assert "right class, strong singles" in capsys.readouterr().out


def test_what_is_no_verdict_that_nothing_is_missing_is_counted_on_nulls():
    alarm, other = (rate for name, (kind, rate) in RATES.items() if kind == "null")
    for verdict in ("unnamed", "error"):
        assert not alarm({"verdict": verdict}, {}) and other({"verdict": verdict}, {})
    assert not other({"verdict": "none", "effects": []}, {})
    doubted = {"verdict": "none", "effects": [], "doubts": ["held-out motion is off"]}
    assert other(doubted, {}) and not alarm(doubted, {})
    truth = {"effects": {"drag": {}, "density": {}}}
    three = {"verdict": "named", "effects": [*map(effect, ("drag", "density", "inclusion"))]}
    assert blind_score._all(three, truth) and not blind_score._exactly(three, truth)
    assert blind_score._exactly({**three, "effects": three["effects"][:2]}, truth)
    assert not blind_score._all({**three, "verdict": "unnamed"}, truth)


def test_what_was_found_and_is_refused_is_no_name():
    truth = {"effects": {"drag": {}}}
    one = {"verdict": "named", "effects": [effect("drag")]}
    assert blind_score.first(one, truth)
    assert blind_score.first({**one, "verdict": "ambiguous"}, truth)
    assert not blind_score.first({**one, "verdict": "unnamed"}, truth)


def test_what_no_recording_tells_apart_is_of_one_class():
    for name, other in (("density", "force-gain"), ("hardening", "yield")):
        assert blind_score.right(name, effect(other)) and blind_score.right(other, effect(name))
    assert not blind_score.right("drag", effect("density"))
    truth = {"effects": {"stiffening": {"C2": 500.0}}, "body": {}}
    for named, strictly in (
        ({"coefficient": 400.0}, True),
        ({"coefficient": -400.0}, False),
        ({"name": "damping"}, False),  # which says itself that it is like that
    ):
        one = {"verdict": "named", "effects": [effect("stiffening") | {"where": {}} | named]}
        assert blind_score.first(one, truth) and blind_score._strictly(one, truth) is strictly


def test_each_of_a_pair_is_named_by_one_of_its_own():
    truth = {"effects": {"damping": {}, "force-delay": {}}}
    both = [effect("damping", "force-delay"), effect("drag")]
    for named, told in ((both[:1], False), (both, False), ([both[0], effect("damping")], True)):
        assert blind_score._all({"verdict": "named", "effects": named}, truth) is told


def test_a_case_without_a_verdict_counts_as_an_error(drawn, tmp_path):
    key, seal = drawn / "key-a.json", drawn / "key-a.sha256"
    out, truth = tmp_path / "blind.json", json.loads(key.read_text())
    verdicts(truth, blind.sealed(seal), out)
    out.write_text("".join(out.read_text().splitlines(keepends=True)[:2]))  # the right single
    found = score(out, key, seal)
    rate = found["rates"]["right class, strong singles"]
    assert (rate["hits"], rate["of"]) == (1, sum(t["kind"] == "single" for t in truth.values()))
    assert found["missing"] == len(truth) - 1
    assert "cases without a verdict" in blind_table.table(found)
    before = {"nulls": {"drag": 9.0}, "limits": {"drag": 1.5}}  # with what the grid has wrong
    told = blind_table.table(found | {"before": before}).partition("limits, observed")
    assert "drag                     9\n" in told[0] and "drag                     1.5\n" in told[2]


def test_goals_stand_beside_what_was_reached(tmp_path, drawn):
    key, seal = drawn / "key-a.json", drawn / "key-a.sha256"
    out = tmp_path / "blind.json"
    verdicts(json.loads(key.read_text()), blind.sealed(seal), out)
    told = {
        line[:44].strip(): line for line in blind_table.table(score(out, key, seal)).split("\n")
    }
    assert (
        "2 of   3" in (rate := told["right class, strong singles"])
        and "MISSED (goal >= 98 %)" in rate
    )
    assert (
        "0.632" in (left := told["held-out error, after by before"])
        and "MISSED (goal <= 0.15)" in left
    )
    assert (
        "90.0 %" in told["closure, median"] and "MISSED (goal >= 95 %)" in told["closure, median"]
    )
    assert (
        "50 points" in (less := told["the runner-up closes less by"])
        and "met (goal >= 30 %)" in less
    )
    without = "seconds of a core without simulations, most"
    assert told[without].split()[-5:] == "not told (goal <= 60)".split()  # by earlier verdicts
    assert told["verdicts over 1200 s of a core"].endswith("met (goal <= 0)")
    verdicts(json.loads(key.read_text()), blind.sealed(seal), out, reading=61.0)
    assert "simulations, most  61" in (text := blind_table.table(score(out, key, seal)))
    assert "MISSED (goal <= 60)" in text
    outside = score(out, key, seal) | {"probes": "faces"}
    assert "MISSED (goal >= 90 %)" in blind_table.table(outside)


def test_what_thresholds_stand_on_is_in_the_fingerprint(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "PACKAGE", tmp_path)
    monkeypatch.setattr(cases, "ORACLES", tmp_path)
    marks = []
    for scores in ({}, {"drag": 1.0}):
        (tmp_path / "nulls.json").write_text(json.dumps({"scores": scores}))
        marks.append(cases.fingerprint())
    assert marks[0] != marks[1]


BODY = {"E": 30e3, "nu": 0.5}
BLOCK = Block(size=(0.02, 0.02, 0.02), points=60, rate=150.0, stamps=150.0, law="yeoh")
SIZED = [  # effect, its truth, what is named, relative error
    ("drag", {"c": 20.0}, {"coefficient": 21.0, "std": 1.0}, 0.05),
    ("force-bias", {"bias": 0.2}, {"coefficient": -0.2, "std": 0.1, "where": {"azimuth": 0.0, "elevation": 0.1}}, 0.0),
    ("floor-slip", {"shear": 2e7}, {"coefficient": 1e-7, "std": 1e-9}, 1.0),
    ("floor-slip", {"friction": 0.2}, {"coefficient": 1e-7, "std": 1e-9}, None),
    # |s| = mu |dev b| = 2 mu |dev e| = 2/3 E |dev e|
    ("yield", {"tau_y": 200.0}, {"coefficient": 0.9, "std": 0.1, "where": {"strain": 0.011}, "spread": {"strain": 1e-3}}, 0.1),
    # |D| = 3 1/s gives eta_n / 3^(1/2); gamma is sqrt(2) |D|
    ("rate-dependence", {"eta_n": 10.0, "n": 0.5}, {"coefficient": 10.0 * 2.0**0.25, "std": 0.1}, 0.0),
    ("inclusion", {"factor": 3.0, "radius": 5e-3, "centre": [0.0, 0.0, 0.01]}, {"coefficient": 0.25, "std": 0.0, "where": {"x": 3e-3, "y": 4e-3, "z": 0.01, "radius": 10e-3}}, 0.0),
    ("anisotropy", {"k_f": 400.0}, {"coefficient": 396.0, "std": 8.0}, -0.01),
]  # fmt: skip


def test_sizes_are_compared_in_the_units_of_the_catalogue():
    results, truth, wanted = [], {}, {}
    for n, (name, told, named, error) in enumerate(SIZED):
        truth[str(n)] = {"kind": "single", "effects": {name: told}, "body": BODY}
        results.append(
            {"id": str(n), "verdict": "named", "effects": [{"name": name, "where": {}, **named}]}
        )
        wanted.setdefault(name, []).extend([] if error is None else [error])
    results.append(
        {"id": "0", "verdict": "named", "effects": [{"name": "density"}]}
    )  # wrongly named: no size to compare
    made = compared(results, truth)
    assert made["errors"] == {k: pytest.approx(v, abs=1e-9) for k, v in wanted.items()}
    assert (made["within"], made["of"]) == (5, 6)
    assert made["pull"] == pytest.approx(np.sqrt((1.0 + 50.0**2 + 1.0 + 0.5**2) / 6.0))
    assert made["centres"] == [pytest.approx(5e-3)]
    assert made["fine"] == pytest.approx(0.01) and made["rough"] == pytest.approx(0.5)


def test_sizes_that_nothing_tells_are_no_hits_of_intervals():
    truth = {
        str(n): {"kind": "single", "effects": {"drag": {"c": 20.0}}, "body": BODY} for n in range(4)
    }
    stds = (1.0, 30.0, None, 1.0)
    results = [
        {
            "id": str(n),
            "verdict": "named",
            "effects": [{"name": "drag", "where": {}, "coefficient": 21.0, "std": s}],
        }
        for n, s in enumerate(stds)
    ]
    results[-1]["verdict"] = "unnamed"
    made = compared(results, truth)
    assert (made["within"], made["of"], made["untold"]) == (1, 1, ["drag", "drag"])
    assert made["errors"] == {"drag": pytest.approx([0.05] * 3)}


def test_the_least_size_that_is_named_is_read_off_faint_cases():
    """Twice the predicted limit of a score of 16 scores 64 where the prediction is right."""
    sizes = {"drag": {"c": 8.0}, "force-gain": {"gain": -0.04}, "yield": {"tau_y": 900.0}}
    ball = {"factor": 1.4, "radius": 6e-3, "centre": [0.0, 0.0, 0.015]}
    told = [  # limit, score
        ("drag", 5.0, 64.0),
        ("drag", 5.0, 16.0),
        ("drag", 5.0, 4.0),
        ("drag", 1.0, 1.0),  # not faint
        ("force-gain", 0.05, 0.0),
        ("yield", 0.05, 64.0),
        ("inclusion", 2.0 / np.sqrt(16.0 + 2.0 * np.log(125.0)), 16.0),  # of 125 places
    ]
    results, truth = [], {}
    for n, (name, limit, scored) in enumerate(told):
        effects = {name: ball if name == "inclusion" else sizes[name]}
        truth[str(n)] = {"kind": "near", "effects": effects, "body": {**BODY, "size": [0.03] * 3}}
        passes = [{"scores": {name: scored}}]
        results.append({"id": str(n), "limits": {name: limit}, "passes": passes})
    found = limits(results, truth)
    ratios = {"drag": pytest.approx(2.0), "force-gain": None, "inclusion": pytest.approx(1.0)}
    assert found["ratios"] == ratios
    assert (found["close"], found["of"]) == (1, 3)


def test_a_limit_is_read_off_a_faint_case_whichever_its_sign():
    truth = {
        str(n): {"kind": "near", "effects": {"camera-scale": {"scale": s}}, "body": BODY}
        for n, s in enumerate((-0.02, 0.02, -0.9))  # the last is not faint
    }
    passes = [{"scores": {"camera-scale": 16.0}}]
    results = [{"id": n, "limits": {"camera-scale": 0.025}, "passes": passes} for n in truth]
    found = limits(results, truth)
    assert found["cases"] == {"camera-scale": 2}
    assert found["ratios"] == {"camera-scale": pytest.approx(1.0)}


def test_sizes_that_were_drawn_anew_are_not_held_against_the_key():
    told = {"kind": "single", "effects": {"drag": {"c": 12.0}}, "body": BODY, "draw": 0}
    named = [{"name": "drag", "where": {}, "coefficient": 5.0, "std": 1.0}]
    one = {"id": "0", "verdict": "named", "effects": named, "draw": 1}
    one |= {"limits": {"drag": 5.0}, "passes": [{"scores": {"drag": 64.0}}]}
    for draw, count in ((0, 1), (1, 0)):
        seen = [{**one, "draw": draw}]
        assert len(compared(seen, {"0": told})["errors"]) == count
        assert limits(seen, {"0": told})["of"] == count


def test_every_effect_has_a_size_to_compare():
    assert set(SIZES) == set(CATALOGUE)


def test_what_the_grid_has_wrong_is_told_where_it_was_taken_off():
    truth = {"0": {"kind": "null", "effects": {}, "body": BODY}}
    one = {"id": "0", "passes": [{"scores": {"drag": 2.0}}], "lesser": {}, "limits": {}}
    assert not blind_score.before([one], truth)
    one |= {"lesser": {"uncorrected": {"drag": 9.0}}, "before": {"limits": {"drag": 1.0}}}
    assert blind_score.before([one], truth) == {"before": {"nulls": {"drag": 9.0}, "limits": {}}}


def test_intervals_of_rates():
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(39, 40) == pytest.approx((0.871, 0.996), abs=2e-3)  # Wilson's, by hand
    assert wilson(0, 40)[0] == pytest.approx(0.0, abs=1e-12)


def given(drawn, monkeypatch):
    """Cases that are their names, without the work of making them."""
    every = {name: partial(str, name) for name in blind.cases_of(drawn / "a.json")}
    monkeypatch.setattr(blind, "cases_of", lambda path, faces: every)
    return every


def test_a_run_goes_on_where_it_stopped(drawn, tmp_path, monkeypatch):
    seal, out, asked = drawn / "key-a.sha256", tmp_path / "blind.json", []

    def verdict(case, probes, *, placebo):
        asked.append(case)
        if len(asked) == 3:
            raise KeyboardInterrupt
        return {"verdict": "none", "seconds": 1.0}

    given(drawn, monkeypatch)
    monkeypatch.setattr(blind, "_verdict", verdict)
    monkeypatch.setattr(blind, "forkable", lambda: False)
    with pytest.raises(KeyboardInterrupt):
        blind.run_blind(drawn / "a.json", seal, out)
    assert len(out.read_text().splitlines()) == 3
    result = blind.run_blind(drawn / "a.json", seal, out)
    assert len(result["results"]) == 10 and len(asked) == 11
    assert len({one["id"] for one in blind.verdicts(out)[1]}) == 10
    whole = out.read_text()
    out.write_text(whole[:-20])  # cut off in the last line
    result = blind.run_blind(drawn / "a.json", seal, out)
    assert len(result["results"]) == 10 and len(asked) == 12 and out.read_text() == whole
    foreign = tmp_path / "notes.txt"
    foreign.write_text("mine\nand this")  # no newline at its end
    with pytest.raises(ValueError, match="no verdicts of a blind bench"):
        blind.run_blind(drawn / "a.json", seal, foreign)
    assert foreign.read_text() == "mine\nand this"
    out.write_text(whole[:-1])  # the last line is whole
    blind.run_blind(drawn / "a.json", seal, out)
    assert len(asked) == 12 and out.read_text() == whole
    with pytest.raises(ValueError, match="verdicts of other probes"):
        blind.run_blind(drawn / "a.json", seal, out, probes="press")
    monkeypatch.setattr(blind, "fingerprint", lambda: "another")
    with pytest.raises(ValueError, match="one run counts, begin another file"):
        blind.run_blind(drawn / "a.json", seal, out)


def test_a_file_of_verdicts_is_of_one_run_at_a_time_and_of_one_set(drawn, tmp_path, monkeypatch):
    seal, out = drawn / "key-a.sha256", tmp_path / "blind.json"
    given(drawn, monkeypatch)
    monkeypatch.setattr(blind, "_verdict", lambda case, probes, *, placebo: {"verdict": "none"})
    monkeypatch.setattr(blind, "forkable", lambda: False)
    blind.run_blind(drawn / "a.json", seal, out)
    whole = out.read_text()
    with blind._held(out):  # a copy that goes on longer holds what its process has held
        pid = os.fork()
        if not pid:
            time.sleep(5.0)
            os._exit(0)
    blind.run_blind(drawn / "a.json", seal, out)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    with out.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(ValueError, match="another run writes it"):
            blind.run_blind(drawn / "a.json", seal, out)
    monkeypatch.setattr(blind, "cases_of", lambda path, faces: {"z": lambda: "z"})
    with pytest.raises(ValueError, match="has a verdict on case"):
        blind.run_blind(drawn / "a.json", seal, out)
    assert out.read_text() == whole


@pytest.mark.parametrize(
    ("there", "probes", "read", "held"),
    [
        (PROBES, "all", ["press", "shake"], ["heldout"]),
        (("press", "heldout"), "all", ["press"], ["heldout"]),
        (PROBES, "press", ["press"], ["heldout"]),
        (PROBES, "faces", ["press", "shake"], []),
        (("press", "shake"), "all", ["press", "shake"], []),
    ],
)
def test_motions_of_a_case_are_taken_by_their_names(tmp_path, there, probes, read, held):
    case(tmp_path / "a", there)
    *motions, law = blind.cases_of(tmp_path)["a"]().chosen(probes)
    assert law is LAWS["yeoh"]
    named = [[PROBES[round(1e5 * r.noise) - 1] for r in some] for some in motions]
    assert named == [read, held]


def case(folder, there=PROBES, **changes):
    """The folder of a case; what is ``changes`` of a probe's recording."""
    folder.mkdir(parents=True)
    for n, name in enumerate(PROBES, start=1):
        made = replace(BLOCK.press("bonded", 0.1 * n), noise=n * 1e-5, law="yeoh")
        if name in there:
            write_recording(replace(made, **changes.get(name, {})), folder / f"{name}.h5")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"press": {"law": None}}, "the recording declares no law"),
        ({"shake": {"density": 900.0}}, "shake: another specimen than press"),
        ({"shake": {"noise": None}}, "shake: its tracks seem exact"),
        ({"heldout": {"poses": {}}}, "heldout: "),
    ],
)
def test_no_verdict_is_given_where_a_diagnosis_refuses(tmp_path, drawn, monkeypatch, changes, told):
    case(tmp_path / "cases" / "a", **changes)
    monkeypatch.setattr(blind, "diagnosed", None)
    monkeypatch.setattr(blind, "forkable", lambda: False)
    result = blind.run_blind(tmp_path / "cases", drawn / "key-a.sha256", tmp_path / "blind.json")
    (one,) = result["results"]
    assert one["verdict"] == "error" and told in one["why"]


def test_cases_that_cannot_be_read_have_no_verdict_and_the_rest_have(tmp_path, drawn, monkeypatch):
    folder, out = tmp_path / "cases", tmp_path / "blind.json"
    for name in ("a", "b"):
        case(folder / name)
    whole = (folder / "a" / "press.h5").read_bytes()
    (folder / "a" / "press.h5").write_bytes(b"")
    monkeypatch.setattr(blind, "_verdict", lambda seen, probes, placebo: {"verdict": "none"})
    monkeypatch.setattr(blind, "forkable", lambda: False)
    with pytest.raises(
        ValueError, match=r"no verdict on 1 cases.* a: .*press.h5: the file is empty"
    ):
        blind.run_blind(folder, drawn / "key-a.sha256", out)
    assert [one["id"] for one in blind.verdicts(out)[1]] == ["b"]
    (folder / "a" / "press.h5").write_bytes(whole)
    found = blind.run_blind(folder, drawn / "key-a.sha256", out)["results"]
    assert [one["id"] for one in found] == ["b", "a"]


def test_what_copies_have_told_is_kept_when_one_breaks_off(drawn, tmp_path, monkeypatch):
    seal, out, log = drawn / "key-a.sha256", tmp_path / "blind.json", tmp_path / "asked"
    broken = tmp_path / "broken"

    def verdict(case, probes, *, placebo):  # in copies of this process, so a file has to know
        with log.open("a") as file:
            file.write(f"{case}\n")
        fourth = log.read_text().splitlines().index(case) == 3
        if fourth and not broken.exists():
            broken.touch()
            raise RuntimeError("broken off")
        return {"verdict": "none", "seconds": 1.0}

    every = given(drawn, monkeypatch)
    monkeypatch.setattr(blind, "_verdict", verdict)
    with pytest.raises(RuntimeError, match="broken off"):
        blind.run_blind(drawn / "a.json", seal, out)
    begun = {one["id"] for one in blind.verdicts(out)[1]}
    first = len(log.read_text().splitlines())
    result = blind.run_blind(drawn / "a.json", seal, out)
    assert begun and not begun & set(log.read_text().splitlines()[first:])
    assert len(result["results"]) == 10
    assert {one["id"] for one in blind.verdicts(out)[1]} == set(every)


def test_bad_input_is_one_line(drawn, tmp_path, capsys):
    seal = str(drawn / "key-a.sha256")
    (tmp_path / "cases" / "a").mkdir(parents=True)
    (tmp_path / "cases" / "key.json").write_text("{}")
    (tmp_path / "told" / "a").mkdir(parents=True)
    (tmp_path / "told" / "a" / "Truth.yaml").touch()
    (tmp_path / "told" / "key.sha256").touch()  # a seal tells nothing
    (tmp_path / "hid" / "a").mkdir(parents=True)
    (tmp_path / "hid" / "all.key").touch()
    (tmp_path / "deep").write_text("[" * 100_000)
    one = '{"id": "a", "seed": 1, "kind": "null"}'
    (tmp_path / "again").write_text(f"[{one}, {one}]")
    (tmp_path / "shakes" / "a").mkdir(parents=True)
    (tmp_path / "shakes" / "a" / "shake.h5").touch()
    (tmp_path / "text").write_text("no hash")
    (tmp_path / "verdicts").write_text("{}\n{}\n")
    (tmp_path / "list").write_text('[{"id": "../a", "seed": 1, "kind": "null"}]')
    (tmp_path / "good").write_text('{"code": "c", "seal": "s"}\n')
    (tmp_path / "keys.json").write_text('{"a": 1}')
    good = str(tmp_path / "good")
    key = str(drawn / "key-a.json")
    truth = json.loads((drawn / "key-a.json").read_text())
    name, one = next((n, t) for n, t in truth.items() if t["kind"] == "single")
    lines = {"code": "c", "seal": blind.sealed(Path(seal))}, {"id": name, "verdict": "named"}
    lines[1]["effects"] = [{"name": next(iter(one["effects"])), "class": []}]
    (tmp_path / "sizeless").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (tmp_path / "listed.json").write_text(
        json.dumps({n: {**t, "effects": list(t["effects"])} for n, t in truth.items()})
    )
    (tmp_path / "twice").write_text("".join(json.dumps(lines[n]) + "\n" for n in (0, 1, 1)))
    twice, odd = str(tmp_path / "twice"), str(tmp_path / "odd")
    strange = ({**lines[0]}, {"id": [1], "verdict": "named"})
    Path(odd).write_text("".join(json.dumps(line) + "\n" for line in strange))
    less = str(tmp_path / "less.json")
    Path(less).write_text(json.dumps({n: t for n, t in truth.items() if n != name}))
    sizeless, listed = str(tmp_path / "sizeless"), str(tmp_path / "listed.json")
    for words, message in (
        (["--seal", seal], "no --cases"),
        (["--seal", seal, "--cases", key, "--faces", "--press-alone"], "choose one"),
        (["--seal", seal, "--score", sizeless, "--key", key], "what is scored is not there"),
        (["--seal", seal, "--score", good, "--key", listed], "no key; each"),
        (["--seal", seal, "--cases", str(tmp_path / "none")], "no such folder"),
        (["--seal", seal, "--cases", str(tmp_path / "cases")], "the truth must lie elsewhere"),
        (["--seal", seal, "--cases", str(tmp_path / "told")], "told: holds Truth.yaml; the truth"),
        (["--seal", seal, "--cases", str(tmp_path / "hid")], "hid: holds all.key; the truth"),
        (["--seal", seal, "--cases", str(tmp_path / "deep")], "no list of cases"),
        (["--seal", seal, "--cases", str(tmp_path / "again")], "case a is listed twice"),
        (["--seal", seal, "--score", str(tmp_path / "deep"), "--key", key], "no verdicts"),
        (["--seal", seal, "--cases", str(tmp_path / "cases" / "a")], "no case there"),
        (["--seal", seal, "--cases", str(tmp_path / "shakes")], "no press.h5 is in it"),
        (["--seal", str(tmp_path / "text"), "--cases", str(drawn / "a.json")], "of 64 digits"),
        (["--seal", seal, "--cases", seal], "no list of cases"),
        (["--seal", seal, "--cases", key], "no list of cases; each has id, seed and kind"),
        (["--seal", seal, "--cases", str(tmp_path / "list")], "letters and digits are wanted"),
        (
            ["--seal", seal, "--cases", str(drawn / "a.json"), "--only", "z"],
            "--only z: no id has it",
        ),
        (["--seal", seal, "--score", seal], "are wanted together"),
        (["--seal", seal, "--score", good, "--key", str(tmp_path / "keys.json")], "no key; each"),
        (["--seal", seal, "--score", good, "--key", key], "another seal than that of the verdict"),
        (["--seal", seal, "--score", sizeless, "--key", less], "not the key"),
        (["--seal", seal, "--score", good, "--key", key, "--faces"], "leave them out with --score"),
        (["--seal", seal, "--score", str(tmp_path / "verdicts"), "--key", key], "no verdicts"),
        (["--seal", seal, "--score", twice, "--key", key], f"case {name} has two verdicts"),
        (["--seal", seal, "--score", odd, "--key", key], "no verdicts of a blind bench"),
    ):
        with pytest.raises(SystemExit) as stop:
            sys.exit(main(["bench", "blind", *words]))
        assert stop.value.code == 2
        said = capsys.readouterr().err.strip()
        assert message in said and len(said.splitlines()) == 1
