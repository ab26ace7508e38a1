"""Checks of ``oracles/hidden_effects.py`` against closed forms and balances, and of its files."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from form_drake.records import Recording, Stream

sys.path.insert(0, str(Path(__file__).parent / "oracles"))
hidden, check, cases = (
    importlib.import_module(f"hidden_effects{x}") for x in ("", "_check", "_cases")
)


def test_compression_vibration_and_balance():
    assert abs(check.compressed()) < 1e-6
    for axis in (0, 2):
        assert abs(check.vibrating(axis)) < 2e-3
    assert check.balanced(check.known(bonded=True)) < 1e-4


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
    again = cases.case_of(3, kind, effect, small=True)
    assert again == truth
