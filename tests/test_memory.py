"""Solids that remember: closed forms of what relaxes, yields and hardens in a stretched point."""

import numpy as np
import pytest

from form_drake.laws import LAWS
from form_drake.laws.memory import Memory, remembered
from form_drake.mpm.bodies import block
from form_drake.mpm.simulation import Simulation
from form_drake.records.solver import Solver

SHEAR = np.sqrt(1.5)  # |dev e| of a logarithmic stretch of one at constant volume


def stretched(e, volume=0.0):
    """F of logarithmic stretches along z at constant volume, and a change of volume, [times, 1, 3, 3]."""
    e = np.asarray(e)
    logs = np.stack([-0.5 * e, -0.5 * e, e], axis=1) + volume / 3.0
    return np.exp(logs)[:, None, :, None] * np.eye(3)


def deviator(F):
    """Logarithmic stretch along z beyond the mean, shape [times]."""
    logs = np.log(np.diagonal(F[:, 0], axis1=1, axis2=2))
    return logs[:, 2] - logs.mean(axis=1)


def test_what_relaxes_fades_exponentially_and_keeps_its_volume():
    time = np.linspace(0.0, 1.0, 201)
    e = np.where(time > 0.0, 0.05, 0.0)
    part = remembered(stretched(e, 0.03), time, Memory(1.0, rate=4.0))
    fading = 0.05 * np.exp(-4.0 * (time[1:] - time[1]))
    assert deviator(part)[1:] / deviator(part)[1] == pytest.approx(fading / 0.05, rel=1e-6)
    assert deviator(part)[1] == pytest.approx(0.05, rel=0.02)  # some fades within the first step
    assert np.linalg.det(part[:, 0]) == pytest.approx(np.exp(0.03), rel=1e-9)


def test_what_relaxes_has_relaxed_at_the_start():
    part = remembered(stretched([0.05, 0.05]), np.array([0.0, 1e-3]), Memory(1.0, rate=1.0))
    assert deviator(part) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("growth", [0.0, 0.5])
def test_what_yields_bears_its_strain_and_keeps_a_set(growth):
    e = np.concatenate([np.linspace(0.0, 0.08, 81), np.linspace(0.08, 0.06, 21)[1:]])
    memory = Memory(1.0, strain=0.03 * SHEAR, growth=growth)
    part = deviator(remembered(stretched(e), np.linspace(0.0, 1.0, len(e)), memory))
    beyond = np.maximum(e[:81] - 0.03, 0.0) * growth / (1.0 + growth)
    assert part[:81] == pytest.approx(np.minimum(e[:81], 0.03) + beyond, abs=1e-6)
    assert part[-1] == pytest.approx(part[80] - 0.02, abs=1e-6)  # unloaded elastically


def test_only_elastic_laws_remember():
    solver = Solver(dx=0.01, nodes=(8, 8, 8), dt=1e-4)
    body = block((0.04, 0.04, 0.04), (0.02, 0.02, 0.02), 0.01, 1000.0)
    with pytest.raises(ValueError, match="von-mises remembers: only elastic laws can"):
        Simulation(solver, LAWS["von-mises"], body, memories=[Memory(0.5, rate=1.0)])


def test_frames_that_are_few_tell_what_relaxes_soon():
    time, rate = np.linspace(0.0, 1.0, 61), 20.0  # a third of what remains is forgotten between two
    part = deviator(remembered(stretched(0.06 * time), time, Memory(1.0, rate=rate)))
    assert part == pytest.approx(0.06 / rate * (1.0 - np.exp(-rate * time)), rel=6e-3)
