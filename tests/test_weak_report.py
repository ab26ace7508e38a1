"""The report of a weak identification, and the README's example of foreign tracks and a force."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from form_drake import read
from form_drake.figures import residual_map
from form_drake.report import Report
from form_drake.weak_report import probe_rows, weak_report

README = Path(__file__).resolve().parents[1] / "README.md"
TRUE = {"C1": 2e4, "C2": 1.5e3, "C3": 4e2, "kappa": 1e5}  # [Pa]
NOISE, FORCE_NOISE = 5e-6, 2e-3  # [m], [N]


def stress(a, c):
    """Principal Kirchhoff stresses [Pa] of Yeoh's law in a block a times as wide and c as high."""
    J = a * a * c
    b = np.stack([a * a, a * a, c * c], axis=-1) * (J ** (-2 / 3))[:, None]
    I1 = b.sum(axis=1)
    slope = TRUE["C1"] + 2 * TRUE["C2"] * (I1 - 3) + 3 * TRUE["C3"] * (I1 - 3) ** 2
    shear = 2 * slope[:, None] * (b - I1[:, None] / 3)
    return shear + (TRUE["kappa"] * J * (J - 1))[:, None]


def pressed(time):
    """Width and height over time [s], as shares; Newton's method frees the sides of stress."""
    c = 1.0 - 0.6 * time
    a = c**-0.45
    for _ in range(20):
        slope = (stress(a + 1e-7, c) - stress(a - 1e-7, c))[:, 0] / 2e-7
        a = a - stress(a, c)[:, 0] / slope
    return a, c


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    """What the README's example finds in tracks and a force made by hand."""
    rng = np.random.default_rng(1)
    time, force_time = np.linspace(0.0, 0.7, 21), np.linspace(0.0, 0.7, 141)
    X = rng.uniform(0.0, (0.02, 0.02, 0.015), (60, 3))
    a, c = pressed(time)
    points = X * np.stack([a, a, c], axis=-1)[:, None]
    points[1:] += rng.normal(0.0, NOISE, points[1:].shape)  # the first frame counts as rest
    a, c = pressed(force_time)
    force = rng.normal(0.0, FORCE_NOISE, (141, 3))
    force[:, 2] -= stress(a, c)[:, 2] / c * 0.02**2
    blocks = re.findall(r"^```py\n(.*?)^```$", README.read_text(), re.DOTALL | re.MULTILINE)
    (block,) = (b for b in blocks if "rubber.h5" in b)
    folder = tmp_path_factory.mktemp("readme")
    found = {"time": time, "points": points, "force_time": force_time, "force": force}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(block, found)
        assert read("rubber.h5").forces.keys() == {"plate"}
    return found["answer"]


def test_example_of_the_readme(answer):
    values = answer.material.values
    assert values["C1"] == pytest.approx(TRUE["C1"], rel=0.02)
    assert values["kappa"] == pytest.approx(TRUE["kappa"], rel=0.02)


def test_rows_of_a_probe(answer):
    (rows,) = probe_rows(answer.weak)
    assert len(rows.measured) == answer.rows == len(rows.window) == len(rows.field)
    assert rows.measured - rows.fitted == pytest.approx(answer.weak.residual, abs=1e-12)
    labels = answer.weak.system.rows
    assert [rows.names[n] for n in rows.field] == [row.field for row in labels]
    ends = rows.probe.windows.ends
    assert [tuple(ends[n]) for n in rows.window] == [row.window for row in labels]
    again = rows.white[rows.window, rows.field]
    assert again == pytest.approx((rows.measured - rows.fitted) / rows.deviation)
    assert np.isfinite(rows.white).sum() == answer.rows


def test_a_slow_force_is_followed_by_the_frames(answer, tmp_path):
    (probe,) = answer.details["probes"]
    assert 0.0 <= probe["force_too_fast"]["plate"] < 0.01
    weak_report(answer, tmp_path / "slow.html")
    assert "swings faster than half the frame rate" in (tmp_path / "slow.html").read_text()


def test_curves_are_mean_forces(answer):
    (rows,) = probe_rows(answer.weak)
    ((name, curve),) = rows.curves().items()
    assert name == "z with plate"
    time, measured, deviation, fitted = curve
    a, c = pressed(time)
    applied = stress(a, c)[:, 2] / c * 0.02**2
    assert measured == pytest.approx(applied, rel=0.05, abs=0.05)
    assert np.all(np.abs(measured - fitted) < 10 * deviation + 0.01 * np.abs(measured).max())


def test_report_of_two_probes_holds_everything(answer, tmp_path):
    fit = answer.weak
    (probe,) = fit.problem.probes
    probes = (probe, replace(probe, name="probe 2", forces={}))
    twice = replace(
        fit,
        problem=replace(fit.problem, probes=probes),
        system=fit.system + fit.system,
        residual=np.tile(fit.residual, 2),
        noise=np.tile(fit.noise, 2),
    )
    assert [len(rows.measured) for rows in probe_rows(twice)] == [len(fit.residual)] * 2
    weak_report(replace(answer, weak=twice), tmp_path / "two.html")
    page = (tmp_path / "two.html").read_text()
    assert page.count("data:image/png;base64,") == 7
    for words in ("C1", "± 95 %", "noise bias removed", "Probe 1", "Probe 2", "condition number"):
        assert words in page
    assert "rows used" in page and "error at held-out tracks" in page
    assert not re.search(r">(nan|None|inf)\b", page)


def test_names_with_dollars_are_no_mathematics(tmp_path):
    name = "p$^$"
    figure = residual_map(np.zeros((2, 1)), np.arange(2.0), [f"along x on {name}"])
    axes = figure.axes[0]
    axes.plot([0.0, 1.0], [0.0, 1.0], label=name)
    axes.set(title=name, ylabel=name)
    axes.legend()
    page = Report("names")
    page.figure(figure, name)
    page.write(tmp_path / "page.html")
    assert "<figcaption>p$^$" in (tmp_path / "page.html").read_text()


def test_unused_rows_are_drawn_as_such():
    white = np.full((3, 4), np.nan)
    white[0] = 1.0
    figure = residual_map(white, np.arange(3.0), list("abcd"))
    above = figure.axes[0]
    assert [bar.get_height() for bar in above.patches] == [1.0, 0.0, 0.0]


def test_other_methods_have_no_such_report(answer, tmp_path):
    with pytest.raises(ValueError, match="weak form needs its rows, not those of rollout"):
        weak_report(replace(answer, weak=None, method="rollout"), tmp_path / "none.html")
