"""The bench of the probes: its draws, noise, motions and tables."""

from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.bench.probes import (
    Motions,
    changes,
    errors,
    noisy,
    planned_cases,
    run_probes,
    specimen,
    table,
)
from form_drake.systems.scenario import load_scenario

WAY = "[{time: 0.0, p_WT: [0.5, 0, 0.076]}, {time: 0.3, p_WT: [0.5, 0, 0.0735]}]"
COARSE = (
    "solver.dx=0.005",
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


def test_a_motion_is_simulated_once(tmp_path, monkeypatch):
    """The kept motion is read again; noise is as stated and that of its seed."""
    motions = Motions(tmp_path / "motions")
    first = motions.recording("press_b", COARSE)
    monkeypatch.setattr("form_drake.systems.probe.record", None)  # would fail if called
    again = motions.recording("press_b", COARSE)
    assert np.array_equal(first.p_WQ, again.p_WQ)
    disturbed = noisy(first, 3)
    assert np.std(disturbed.p_WQ - first.p_WQ) == pytest.approx(20e-6, rel=0.02)
    force, exact = (r.forces["press_plate"].value for r in (disturbed, first))
    largest = np.linalg.norm(exact, axis=1).max()
    assert np.std(force - exact) == pytest.approx(0.01 * largest, rel=0.05)
    assert np.array_equal(noisy(first, 3).p_WQ, disturbed.p_WQ)


def test_errors_are_percent_of_the_truth():
    true = load_scenario("press_b").specimen.made()
    answer = SimpleNamespace(material=true.changed({"E": 84e3, "nu": 0.3, "tau_y": 9.5e3}))
    found = {key: e["error"] for key, e in errors(answer, true).items()}
    assert found == pytest.approx({"E": 5.0, "tau_y": -5.0})


def test_tables():
    exact = {"rows": 9, "condition": 2.0, "seconds": 1.0}
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
        }
    }
    text = table(result)
    assert "press E, 2 specimens: median 2.00, worst 3.00" in text
    assert "0.70    0.90    1.10    50%   0 refused of 2" in text


def test_bad_options_are_refused(tmp_path):
    with pytest.raises(ValueError, match="--seeds 0"):
        run_probes(store=tmp_path / "x.cases", seeds=0)
    with pytest.raises(ValueError, match="no case has it"):
        run_probes(store=tmp_path / "x.cases", only=("nothing",))
