"""The bench of the probes: its draws, noise, motions and tables."""

from dataclasses import replace
from shutil import copytree, ignore_patterns
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.bench.cases import PACKAGE
from form_drake.bench.oracles import laboratory_noise
from form_drake.bench.probes import (
    changes,
    finite_elements,
    planned,
    planned_cases,
    run_probes,
    specimen,
    table,
)
from form_drake.bench.probes_grid import SPACINGS, deepest, grid_changes
from form_drake.bench.probes_motions import Motions, code, errors
from form_drake.bench.probes_stress import by_rate, factors, gathered, yielding
from form_drake.systems.probe import prepare
from form_drake.systems.scenario import load_scenario

WAY = "[{time: 0.0, p_WT: [0.5, 0, 0.075]}, {time: 0.3, p_WT: [0.5, 0, 0.0725]}]"
COARSE = (
    "specimen.size=[0.024, 0.024, 0.024]",
    "specimen.p_WM=[0.5, 0.0, 0.062]",
    "solver.dx=0.004",
    "solver.mass_scale=40",
    "solver.settle=0.05",
    "measure.points=150",
    f"probe.waypoints={WAY}",
)


def test_specimens_are_the_same_ten_and_bear_their_weight():
    drawn = [specimen(seed) for seed in range(10)]
    assert drawn == [specimen(seed) for seed in range(10)]
    for values in drawn:
        assert 20e3 <= values["E"] <= 300e3 and 0.30 <= values["nu"] <= 0.45
        assert 0.01 <= values["tau_y"] / values["E"] <= 0.15
        assert np.sqrt(1.5) * values["tau_y"] >= 3.0 * 1000.0 * 9.81 * 0.025
    assert len({values["E"] for values in drawn}) == 10


def test_cases_put_the_specimens_into_the_scenarios():
    cases = planned_cases(3)
    assert len(cases) == 4 + 2 * 3
    name, made = cases["press-2"]
    material = load_scenario(name, made).specimen.material
    assert material == {**specimen(2), "density": 1000.0}
    name, made = cases["bend-1"]
    assert load_scenario(name, made).specimen.material["nu"] == specimen(1)["nu"]
    assert changes("bend", 1) == made


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder of motions, and the one that was put there: a small elastic press."""
    motions = Motions(tmp_path_factory.mktemp("motions"))
    return motions, motions.recording("press_b", COARSE)


@pytest.fixture(scope="module")
def pressed(kept):
    """That press, and the sums over its particles."""
    recording = kept[1]
    return recording, gathered(prepare(load_scenario("press_b", COARSE)), recording)


def test_a_motion_is_simulated_once(kept, monkeypatch):
    """The kept motion is read again; noise is as stated and that of its seed."""
    motions, first = kept
    monkeypatch.setattr("form_drake.systems.probe.record", None)  # would fail if called
    again = motions.recording("press_b", COARSE)
    assert np.array_equal(first.p_WQ, again.p_WQ)
    disturbed = laboratory_noise(first, np.random.default_rng(3))
    assert np.std(disturbed.p_WQ - first.p_WQ) == pytest.approx(20e-6, rel=0.02)
    force, exact = (r.forces["press_plate"].value for r in (disturbed, first))
    largest = np.linalg.norm(exact, axis=1).max()
    assert np.std(force - exact) == pytest.approx(0.01 * largest, rel=0.05)
    assert np.array_equal(laboratory_noise(first, np.random.default_rng(3)).p_WQ, disturbed.p_WQ)


def test_the_solver_s_own_stress_closes_the_balance(pressed):
    """In the rows of the identification, whatever reading the tracks costs."""
    recording, found = pressed
    material = load_scenario("press_b", COARSE).specimen.made()
    own = factors(recording, found, material)
    assert set(own) == {"E", "all"}  # nothing yields
    assert abs(own["E"]["error"]) < 0.6  # in six cells of height, ten times as fast as usual
    stiffer = factors(recording, replace(found, stress=1.1 * found.stress), material)
    assert stiffer["E"]["error"] == pytest.approx((own["E"]["error"] - 10.0) / 1.1, abs=1e-6)


def test_own_stress_is_summed_at_the_frames_of_the_recording(pressed):
    recording, found = pressed
    assert found.time == pytest.approx(recording.time - recording.time[0])
    assert found.stress.shape == (recording.frames, 6)
    assert np.all(found.end[..., 2] == 1.0)


def test_yielding_is_a_share_of_the_points():
    made = load_scenario("press_b").specimen.made()
    bound = np.sqrt(1.5) * made.values["tau_y"]  # of one uniaxial stress
    T = np.zeros((2, 4, 3, 3))
    T[0, :, 2, 2] = bound * np.array([-1.0, -0.99, 1.0, 0.0])
    T[1] = -1e6 * np.eye(3)  # pressure does not yield
    assert yielding(T, made).tolist() == [0.5, 0.0]
    assert yielding(T, load_scenario("bend_a").specimen.made()).tolist() == [0.0, 0.0]


def test_own_stress_of_thinned_frames(kept, pressed):
    """The frames of the recording are those of the solver's periods, every tenth."""
    motions, recording = kept
    material = load_scenario("press_b", COARSE).specimen.made()
    rates = by_rate(motions, "press_b", COARSE, rates=(100.0,))["rates"]
    assert {rate: len(errors) for rate, errors in rates.items()} == {"100.0": 5, "1000.0": 1}
    same = factors(recording, pressed[1], material)["E"]["error"]
    assert rates["100.0"][0]["E"] == pytest.approx(same, abs=1e-3)  # fields move between frames
    assert abs(rates["1000.0"][0]["E"]) < 0.6


@pytest.mark.parametrize("name", ["press_b", "bend_a"])
def test_particles_fill_the_specimen_on_every_grid(name):
    own, *others = SPACINGS[name.split("_")[0]]
    assert load_scenario(name).solver.dx == own
    assert grid_changes(name, own) == ()
    for dx in others:
        after = load_scenario(name, grid_changes(name, dx))
        assert after.solver.dx == dx
        halves = np.array(after.specimen.size) / (0.5 * dx)
        assert halves == pytest.approx(np.round(halves))


def test_force_at_the_largest_stroke(pressed):
    recording, _ = pressed
    force, height = deepest(recording)
    way = recording.poses["press_plate"].value[:, 2, 3]
    assert height == pytest.approx(way.min(), abs=1e-5)
    assert force == pytest.approx(recording.forces["press_plate"].value[:, 2].max(), rel=0.02)


def test_motions_are_kept_until_what_they_depend_on_changes(tmp_path):
    """The solver, the law, the material's system or the plate; not what only reads a motion."""
    package = tmp_path / "form_drake"
    copytree(PACKAGE, package, ignore=ignore_patterns("__pycache__"))
    key = code(package)
    assert key == code()
    for name in ("identifier", "page", "replay", "snapshots", "tracker", "viewer"):
        _edited(package / f"systems/{name}.py")
    for name in (
        "motion/body.py",
        "weak/balance.py",
        "identify/weak.py",
        "bench/probes.py",
        "perceive/track.py",
        "skin.py",
    ):
        _edited(package / name)
    assert code(package) == key
    changing = (
        "mpm/transfer.py",
        "systems/material.py",
        "control.py",
        "models/tools/press_plate.sdf",
    )
    for name in changing:
        _edited(package / name)
        assert code(package) != key, name
        key = code(package)


def _edited(path):
    with path.open("a") as file:
        file.write("\n")


def test_cases_that_are_planned(tmp_path):
    cases, seconds = planned(Motions(tmp_path), 2, 5)
    assert cases.keys() == seconds.keys()
    named = {"own-stress/press_a", "rate/bend_b", "dx/press_b/1.667", "dx/bend_a/1"}
    assert named <= cases.keys()
    assert len([n for n in cases if n.startswith("dx/")]) == 4 * 3
    for drawn in ("own-stress/press-3", "rate/bend-2"):
        assert drawn not in cases
        assert drawn in planned(Motions(tmp_path), 2, 5, only=(drawn,))[0]
    made = {f"fe/{n}" for n in ("press-a", "press-b", "bend-touching-a", "bend-touching-b")}
    noisy_too = {f"{n.replace('fe/', 'fe-noise/')}/seeds2" for n in made}
    assert finite_elements(tmp_path, 2)[0].keys() == made | noisy_too


def test_errors_are_percent_of_the_truth():
    true = load_scenario("press_b").specimen.made()
    answer = SimpleNamespace(material=true.changed({"E": 84e3, "nu": 0.3, "tau_y": 9.5e3}))
    found = {key: e["error"] for key, e in errors(answer, true).items()}
    assert found == pytest.approx({"E": 5.0, "tau_y": -5.0})


def test_tables():
    exact = {"rows": 9, "condition": 2.0, "seconds": 1.0}

    def noisy(errors, cover):
        made = {k: {"E": 0.0} for k in ("median", "p90", "worst")} | {"errors": {"E": errors}}
        return made | {"coverage_90": {"E": cover}, "refused": 0, "seeds": 2}

    result = {
        "cases": {
            "exact/press-0": exact | {"errors": {"E": {"error": 1.0, "std": 0.1}}},
            "exact/press-1": exact | {"errors": {"E": {"error": -3.0, "std": 0.1}}},
            "noise/bend_a/seeds2": {
                "median": {"E": 0.7},
                "p90": {"E": 0.9},
                "worst": {"E": 1.1},
                "coverage_90": {"E": 0.5},
                "refused": 0,
                "seeds": 2,
            },
            "noise/press-0/seeds2": noisy([0.5, -3.0], 1.0),
            "noise/press-1/seeds2": noisy([0.5, 0.7], 0.5),
        }
    }
    text = table(result)
    assert "press E, 2 specimens: median 2.00, worst 3.00" in text
    assert "0.70    0.90    1.10    50%   0 refused of 2" in text
    together = (
        "press E, 2 specimens: median 0.60 met (goal 1), p90 2.31 MISSED (goal 2), worst 3.00"
    )
    assert f"{together}, 90 % intervals hold 75% MISSED (goal 80 to 98 %)" in text


def test_tables_of_simulator_grids_and_finite_elements():
    def at(dx, error):
        made = {"errors": {"E": {"error": error, "std": 0.1}}, "dx": dx}
        return made | {"force": 15.0, "closed_form": 15.3}

    exact = {"rows": 9, "condition": 2.0, "seconds": 1.0, "errors": {"E": -0.6}}
    own = {"E": {"error": 0.08, "rows": 9}, "all": {"error": 5.0, "rows": 12}}
    cases = {
        "own-stress/press_a": {"errors": own},
        "own-stress/bend_b": {"errors": {"E": {"error": -0.81, "rows": 75}}},
        "dx/press_b/2.5": at(2.5e-3, -0.9),
        "dx/press_b/2": at(2e-3, -0.7),
        "dx/press_b/1.667": at(5e-3 / 3.0, -0.5),
        "dx/bend_a/2": {"errors": {}, "dx": 2e-3, "force": 0.011, "refused": "it folds"},
        "fe/press-b": exact,
        "rate/bend_a": {"rates": {"58.8": [{"E": -0.7}, {"E": 0.25}], "1000.0": [{"E": 0.02}]}},
    }
    text = table({"cases": cases})
    assert "press_a   E +0.080 (9 rows)  all +5.000 (12 rows)  met (goal 0.3)" in text
    assert "bend_b    E -0.810 (75 rows)  MISSED (goal 0.8)" in text
    assert " 1.667 mm  E -0.500  force 15 N, closed form 15.3 N (-1.96 %)" in text
    assert "press_b   E: largest change 0.400  MISSED (goal 0.3)" in text
    assert "bend_a     2.000 mm  refused: it folds  force 0.011 N" in text
    assert "E -0.600  MISSED" in text
    assert "bend_a      58.8  E -0.700 to +0.250" in text


def test_bad_options_are_refused(tmp_path):
    with pytest.raises(ValueError, match="--seeds 0"):
        run_probes(store=tmp_path / "x.cases", seeds=0)
    with pytest.raises(ValueError, match="no case has it"):
        run_probes(store=tmp_path / "x.cases", only=("nothing",))
