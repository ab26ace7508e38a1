"""Checks of ``oracles/hidden_effects.py`` against closed forms and balances, and of its files."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from form_drake.records import Recording, Stream

sys.path.insert(0, str(Path(__file__).parent / "oracles"))
hidden, check, cases, probes = (
    importlib.import_module(f"hidden_effects{x}") for x in ("", "_check", "_cases", "_probes")
)


def test_compression_vibration_and_balance():
    assert abs(check.compressed()) < 1e-6
    for axis in (0, 2):
        assert abs(check.vibrating(axis)) < 2e-3
    assert check.balanced(check.known(bonded=True)) < 1e-4


def test_contact_changed_since_a_factorisation_and_no_negative_mass():
    truth = cases.case_of(0, "single", "added-mass", small=True)
    solver, _ = probes.solver_of(truth, "press", "coarse")
    assert solver.mass.min() > 0
    assert abs(solver.mass.sum() - truth["effects"]["added-mass"]["mass"]
               - 1000 * np.prod(truth["body"]["size"])) < 1e-12  # fmt: skip
    factors, wall = solver.factors, solver.walls[0]
    force, blocks = np.random.default_rng(0).normal(size=solver.u.shape), factors.blocks.copy()
    blocks[:, :, wall.nodes[:20]] += np.diag([50.0, 30.0, -4e4])[:, :, None]
    assert factors.update(blocks) and not factors.update(blocks)
    moved = factors.solve(force)
    change = np.einsum("ikn,kn->in", blocks - factors.blocks, moved)
    factors.update(factors.blocks.copy())
    again = factors.solve(force - change)  # K y = f - d y
    assert np.abs(again - moved).max() < 0.02 * np.abs(moved).max()


def recording(path):
    """What a person would read of a case."""
    held, told = np.load(f"{path}.npz"), json.loads(Path(f"{path}.json").read_text())
    streams = {
        kind: {
            k[len(kind) + 1 : -6]: Stream(held[f"{k[:-6]}_time"], held[k])
            for k in held
            if k.startswith(f"{kind}_") and k.endswith("_value")
        }
        for kind in ("pose", "force")
    }
    return Recording.from_arrays(
        held["time"],
        held["p_WQ"],
        p_reference=held["p_reference"],
        gravity=held["gravity"],
        density=float(held["density"]),
        poses=streams["pose"],
        forces=streams["force"],
        geometry=told["geometry"],
        contact=told["contact"],
        law=told["law"],
    )


@pytest.mark.parametrize(("kind", "effect"), [("null", None), ("single", "drag")])
def test_files_hold_the_motion_and_the_key_the_truth(kind, effect, tmp_path):
    truth = cases.case_of(3, kind, effect, small=True)
    folder = tmp_path / truth["id"]
    folder.mkdir()
    hidden.made(truth, folder, "coarse", 150)
    text = " ".join(p.read_text() for p in folder.glob("*.json"))
    assert "drag" not in text and "kappa" not in text
    press, shake = (recording(folder / name) for name in ("press", "shake"))
    assert press.points == shake.points == 150
    weight = 1000.0 * 9.81 * np.prod(truth["body"]["size"])
    assert 0.0 < np.abs(press.forces["plate"].value[:, 2]).max() < 1e3 * weight
    assert not shake.forces and np.ptp(shake.poses["floor"].value[:, :3, 3], axis=0).max() > 1e-4
    assert (effect in truth["effects"]) is (effect is not None)
    assert cases.case_of(3, kind, effect, small=True) == truth
    other = cases.case_of(3, kind, effect, small=True, draw=1)
    assert other["body"] == truth["body"] and other["effects"].keys() == truth["effects"].keys()
    assert (other["effects"] == truth["effects"]) is (effect is None)
