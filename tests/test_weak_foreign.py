"""A block of rubber under a plate as a person would hand it in, and what is refused of it."""

import importlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

from form_drake import Recording, Stream, Unidentifiable, identify, read_material
from form_drake.identify import WeakOptions
from form_drake.identify.worth import at_bound
from form_drake.laws import law_named
from form_drake.material import Material
from form_drake.motion import body
from form_drake.weak.families import bend

SIZE = np.array([0.02, 0.02, 0.015])  # [m]
FPS, LAST = 50, 1.0


def stress(a, c, C10, kappa):
    """Kirchhoff stress along x and z of neo-Hookean rubber stretched by a, a and c."""
    J, b = a * a * c, np.array([a * a, c * c])
    b = b * J ** (-2.0 / 3.0)
    return 2.0 * C10 * (b - (2.0 * b[0] + b[1]) / 3.0) + kappa * J * (J - 1.0)


def pulled(C10=1e5, kappa=None, noise=20e-6, seed=1, **changes):
    """The recording; without ``kappa`` the rubber keeps its volume."""
    rng = np.random.default_rng(seed)

    def stretches(time):
        c = 1.0 + 0.3 * np.sin(np.pi * time / LAST) ** 2
        if kappa is None:
            return c**-0.5, c
        free = [brentq(lambda a, k=k: stress(a, k, C10, kappa)[0], 0.8, 1.01) for k in c]
        return np.array(free), c

    time, fast = np.linspace(0.0, LAST, FPS + 1), np.linspace(0.0, LAST, 201)
    X = rng.uniform(0.0, 1.0, (120, 3)) * SIZE
    a, c = stretches(time)
    middle = np.array([0.01, 0.01, 0.0])
    p_WQ = middle + (X - middle) * np.stack([a, a, c], axis=-1)[:, None]
    a, c = stretches(fast)
    if kappa is None:
        pull = 2.0 * C10 * (c - c**-2.0)
    else:
        pull = np.array([stress(*k, C10, kappa)[1] for k in zip(a, c, strict=True)]) / c
    force = np.zeros((len(fast), 3))
    force[:, 2] = -pull * SIZE[0] * SIZE[1]  # of the material on the plate
    force += 0.01 * np.abs(force).max() * rng.standard_normal(force.shape) * (noise > 0.0)
    made = {
        "p_reference": X,
        "density": 1070.0,
        "geometry": {"shape": "box", "low": "0 0 0", "high": "0.02 0.02 0.015"},
        "contact": {"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        "forces": {"plate": Stream(fast, force)},
        **changes,
    }
    return Recording.from_arrays(time, p_WQ + noise * rng.standard_normal(p_WQ.shape), **made)


def test_rubber_that_keeps_its_volume_lacks_its_bulk_modulus_alone():
    """Noise changes the volume of every track's neighbourhood, and is none of the rubber's doing."""
    made = pulled()
    for estimator in ("gls", "ols"):
        with pytest.raises(Unidentifiable) as refused:
            identify(made, "neo-hookean", weak=WeakOptions(estimator=estimator))
        assert refused.value.keys == ("kappa",)
    answer = identify(made, "neo-hookean", known={"kappa": 1e8}).material.parameters()["C10"]
    assert answer.value == pytest.approx(1e5, abs=3.0 * answer.std) and answer.std < 500.0


def test_a_jolt_that_frames_miss_counts_against_its_windows_alone():
    made = pulled(kappa=2e6, noise=0.0)
    push = made.forces["plate"]
    fine = np.linspace(0.0, LAST, 2001)
    force = np.stack([np.interp(fine, push.time, v) for v in push.value.T], axis=1)
    jolt = np.where(np.abs(fine - 0.31) < 0.008, 0.2, 0.0)[:, None] * force
    answers = [
        identify(replace(made, forces={"plate": Stream(fine, f)}), "neo-hookean")
        for f in (force, force + jolt)
    ]
    C10, found = (a.material.parameters()["C10"] for a in answers)
    assert C10.value == pytest.approx(1e5, rel=1e-3)
    assert found.value == pytest.approx(1e5, rel=1e-3) and found.std < 5.0 * C10.std
    problem = answers[1].weak.problem
    against_twin = replace(problem, offset=np.zeros_like(answers[1].weak.system.A))
    assert problem.missed[0].any() and not against_twin.missed[0].any()  # which misses as much


def test_noise_hides_a_column_from_both_estimators():
    made, ends = pulled(), ((0.1, 0.5), (0.5, 0.9))
    for estimator in ("gls", "ols"):
        options = WeakOptions(
            estimator=estimator, pressure="law", fields=("box",), ends=ends, draws=2
        )
        with pytest.raises(Unidentifiable, match="kappa"):
            identify(made, "neo-hookean", weak=options)


def test_fields_that_feel_pressure_are_no_choice_where_it_is_left_out():
    with pytest.raises(ValueError, match="BoxFields feel the pressure that is left out"):
        identify(
            pulled(kappa=2e6),
            "neo-hookean",
            known={"kappa": 2e6},
            weak=WeakOptions(pressure="free", fields=("box",)),
        )


def test_a_fibre_tells_its_stiffness_without_its_lateral_stretch():
    made = pulled(kappa=2e6)
    thick = np.where(np.arange(3) < 2, 0.9, 1.0)  # what tracks tell across it is wrong
    made = replace(made, p_WQ=0.01 + (made.p_WQ - 0.01) * thick, p_reference=made.reference)
    answers = [
        identify(made, "neo-hookean", known={"kappa": 2e6}, weak=WeakOptions(free=free))
        for free in (None, (0, 1))
    ]
    plain, fibre = (abs(a.material.values["C10"] / 1e5 - 1.0) for a in answers)
    assert fibre < 0.01 < plain
    for free, words in (((0, 1, 2), "at most two"), ((0, 4), "at most two")):
        with pytest.raises(ValueError, match=words):
            identify(made, "neo-hookean", weak=WeakOptions(free=free))
    with pytest.raises(ValueError, match="von-mises is not elastic"):
        identify(made, "von-mises", weak=WeakOptions(free=(0,)))


def test_the_pressure_of_a_fibre_is_what_leaves_its_sides_free():
    made, known = pulled(), {"kappa": 1e8}
    fibre = identify(made, "neo-hookean", known=known, weak=WeakOptions(free=(0, 1)))
    assert fibre.details["pressure"] == "law"
    assert fibre.material.values["C10"] == pytest.approx(1e5, rel=0.01)
    with pytest.raises(ValueError, match="leave out the traction-free axes"):
        identify(made, "neo-hookean", known=known, weak=WeakOptions(free=(0, 1), pressure="free"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"forces": {}}, r"plate touches z\+ and moves, but the recording holds no force of it"),
        ({"density": 1070e9}, "weighs .* are lengths in millimetres, or the density"),
    ],
)
def test_a_force_that_is_missing_or_weighs_nothing_is_said(change, words):
    with pytest.raises(ValueError, match=words) as refused:
        identify(pulled(**change), "neo-hookean", known={"kappa": 1e8})
    assert "\n" not in str(refused.value)


def test_points_that_come_late_are_left_out():
    made = pulled(p_reference=None)
    seen = np.ones((made.frames, made.points), dtype=bool)
    seen[:4, 7] = False
    late = replace(made, valid=seen.copy(), p_WQ=np.where(seen[..., None], made.p_WQ, np.nan))
    answer = identify(late, "neo-hookean", known={"kappa": 1e8}).material.parameters()["C10"]
    assert answer.value == pytest.approx(1e5, rel=0.01)
    seen[0, 8:] = False
    with pytest.raises(ValueError, match=r"7 points are seen .* in the first"):
        identify(replace(late, valid=seen), "neo-hookean", known={"kappa": 1e8})


def test_a_coefficient_at_its_bound_is_said():
    problem = SimpleNamespace(
        floors=lambda _: np.array([1e-6, -np.inf, 1e-6]),
        unknowns=SimpleNamespace(keys=("C1", "C2", "mu")),
    )
    assert at_bound(problem, None, np.array([1e-6, -3.0, 2.0])) == ["C1"]
    answer = identify(pulled(), "neo-hookean", known={"kappa": 1e8})
    assert answer.details["at_bound"] == [] and "AT ITS BOUND" not in str(answer)
    held = replace(answer, details={**answer.details, "at_bound": ["C10"]})
    assert "AT ITS BOUND: C10 would come out negative" in str(held)


def test_the_covariance_and_the_worth_of_the_rows_are_shown():
    answer = identify(pulled(), "neo-hookean", known={"kappa": 1e8})
    covariance = answer.to_json()["covariance"]
    assert covariance["keys"] == ["C10"]
    std = answer.material.parameters()["C10"].std
    assert covariance["values"][0][0] == pytest.approx(std**2)
    worth = f"(worth {answer.details['effective_rows']:.3g} independent ones)"
    assert f"{answer.rows} rows {worth}" in str(answer)


def test_what_is_derived_of_a_value_near_zero_is_as_uncertain_as_it():
    law = law_named("neo-hookean")
    made = Material(law, {"C10": 1e-9, "kappa": 1e9}, keys=("C10",), covariance=np.array([[1e6]]))
    assert made.parameters()["E"].std == pytest.approx(6e3, rel=1e-3)


def test_bending_fields_are_even_where_a_tool_pushes_however_it_came_there():
    """From beyond the free end, say: where it does not press, it does no work."""
    time = np.linspace(0.0, 1.0, 41)
    X = np.indices((3, 3, 9)).reshape(3, -1).T * [0.006, 0.002, 0.0125]
    ways = {"along": np.interp(time, [0.0, 0.4], [-0.03, 0.03]), "there": np.full(41, 0.03)}
    ramps = []
    for way in ways.values():
        pose, force = np.tile(np.eye(4), (41, 1, 1)), np.zeros((41, 3))
        pose[:, 2, 3], force[time > 0.5, 0] = way, 1.0
        made = Recording.from_arrays(
            time,
            np.tile(X, (41, 1, 1)),
            density=1000.0,
            geometry={"shape": "box", "low": "0 0 0", "high": "0.012 0.004 0.1"},
            contact={"z+": "bonded clamp", "x+": "touched finger", "other": "free"},
            poses={"finger": Stream(time, pose)},
            forces={"finger": Stream(time, force, noise=0.01)},
        )
        (field,) = bend(made, body(made))
        ramps.append(field.ramps)
    assert np.allclose(*ramps) and ramps[0][0][0] > 0.3


def test_bias_takes_no_coefficient_below_its_floor(monkeypatch, tmp_path):
    """Else what is written could not be read again."""
    found = (np.full(1, 1e9), np.zeros((1, 1)))
    module = importlib.import_module("form_drake.identify.weak")
    monkeypatch.setattr(module, "noise_bias", lambda *arguments: found)
    answer = identify(pulled(), "neo-hookean", known={"kappa": 1e8})
    answer.material.write(tmp_path / "a.yaml")
    assert 0.0 < read_material(tmp_path / "a.yaml").values["C10"] < 1.0
