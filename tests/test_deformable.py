"""Drake's own deformable bodies, identified; and the oracle that has simulated them."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from form_drake import __main__
from form_drake.bench import deformable
from form_drake.records import write_recording

sys.path.insert(0, str(Path(__file__).parent / "oracles"))
reference = importlib.import_module("drake_deformable_reference")
QUICK = ("press-coarse", "press-medium")


@pytest.mark.parametrize(
    "case", [c if c in QUICK else pytest.param(c, marks=pytest.mark.slow) for c in deformable.NAMES]
)
def test_apparent_modulus(case):
    """What is identified on a mesh is the modulus that the mesh's own force shows."""
    assert abs(deformable.identified(case)["difference"]) < deformable.GOAL


@pytest.mark.slow
def test_limit_of_the_meshes():
    """Meshes extrapolated to no spacing give the modulus that Drake was given."""
    result = deformable.run_deformable()
    for found in result["kinds"].values():
        assert abs(found["errors"]["E"]) < deformable.GOAL
        assert abs(found["errors"]["apparent"]) < deformable.GOAL
    assert "MISSED" not in deformable.table(result)


def test_a_part_of_the_bench(monkeypatch):
    """What is left out is not identified."""
    asked = []

    def identified(case, folder):
        asked.append(case)
        return dict.fromkeys(("spacing", "E", "apparent"), float(len(asked))) | {"true": 1.0}

    monkeypatch.setattr(deformable, "identified", identified)
    assert deformable.run_deformable(only=("pre",))["kinds"].keys() == {"press"}
    assert asked == [f"press-{mesh}" for mesh in deformable.MESHES]
    with pytest.raises(ValueError, match="--only pour: choose from press, bend"):
        deformable.run_deformable(only=("pour",))


@pytest.mark.parametrize("kind", deformable.KINDS)
def test_apparent_moduli_approach_the_true_one(kind):
    """Linear tetrahedra are too stiff, the less so the finer they are."""
    facts = [deformable.truth(f"{kind}-{mesh}") for mesh in deformable.MESHES]
    apparent, spacing = ([f[key] for f in facts] for key in ("apparent", "spacing"))
    assert (np.diff([*apparent, facts[0]["E"]]) < 0).all()
    limit = deformable.extrapolated(np.array(spacing), np.array(apparent))
    assert limit == pytest.approx(facts[0]["E"], rel=0.02)


@pytest.mark.parametrize("kind", deformable.KINDS)
def test_reference_has_converged(kind):
    """The bricks' force under the stored stroke comes out again, and finer ones hardly change it."""
    facts = deformable.truth(f"{kind}-coarse")
    stored = facts["reference_forces"]
    assert reference.reference(kind, facts["travel"], 1) == pytest.approx(stored[:1], rel=1e-6)
    assert stored[1] == pytest.approx(stored[2], rel=1e-3)
    assert facts["apparent"] == pytest.approx(facts["E"] * facts["force"] / stored[-1])


def test_command(tmp_path, capsys):
    """The command reads such a recording as any other."""
    path = tmp_path / "press.h5"
    write_recording(deformable.recording("press-coarse"), path)
    words = ["identify", str(path), "--out", str(tmp_path / "material.yaml")]
    assert __main__.main(words) == 0
    assert "fixed-corotated" in capsys.readouterr().out


def test_extrapolation():
    """A line in the square of the spacing."""
    spacing = np.array([4e-3, 3e-3, 2e-3])
    assert deformable.extrapolated(spacing, 7.0 + 3e5 * spacing**2) == pytest.approx(7.0)


def test_missing_files(tmp_path):
    """One line says what makes them."""
    with pytest.raises(ValueError, match=r"drake_deformable\.py makes it"):
        deformable.recording("press-coarse", tmp_path)


@pytest.mark.slow
def test_drake_again(tmp_path, monkeypatch):
    """The oracle's command makes the stored files again."""
    oracle = importlib.import_module("drake_deformable")
    words = ["--reference", "1", "--out", str(tmp_path), "press-coarse"]
    monkeypatch.setattr(sys, "argv", ["drake_deformable.py", *words])
    oracle.main()
    made, stored = (
        deformable.recording("press-coarse", folder) for folder in (tmp_path, deformable.DATA)
    )
    np.testing.assert_allclose(made.p_WQ, stored.p_WQ, atol=2e-7)
    np.testing.assert_allclose(made.forces["plate"].value, stored.forces["plate"].value, atol=1e-3)
