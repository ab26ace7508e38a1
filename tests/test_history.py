"""What noise leaves in plastic strain: the adjoint against differences of whole histories."""

import numpy as np
import pytest

from form_drake.laws import law_named
from form_drake.weak import history
from form_drake.weak.history import lasting
from form_drake.weak.stress import elastic_part, unit_stresses

LAW = law_named("von-mises")
THETA = np.array([3.0e4, 4.5e4])
R = np.array([0.004, 0.0, 0.0, 0.0])
TIMES, POINTS, FIELDS = 14, 3, 2
H = 1e-5


def path(reach):
    """Deformation gradients that go out to some strain and half of the way back."""
    along = np.concatenate([np.linspace(0.0, 1.0, 10), np.linspace(0.95, 0.5, 4)])
    spread = np.random.default_rng(2).standard_normal((POINTS, 3, 3))
    return np.eye(3) + reach * along[:, None, None, None] * spread


def stress(elastic):
    return np.tensordot(THETA, unit_stresses(LAW, elastic, np.zeros_like(elastic), {}), axes=1)


@pytest.fixture
def chi():
    windows = np.zeros((3, TIMES))
    windows[0, 2:6], windows[1, 5:9], windows[2, 10:14] = 0.7, 0.3, 0.5
    return windows


PAIRING = np.random.default_rng(3).standard_normal((TIMES, FIELDS, POINTS, 3, 3))


def by_history(F, chi, m):
    """Derivatives of the rows by F at a time through what it leaves, [windows, fields, points, 3, 3]."""
    found = np.zeros((len(chi), FIELDS, POINTS, 3, 3))
    later = np.arange(TIMES) > m
    for i in range(3):
        for j in range(3):
            tau = []
            for sign in (1.0, -1.0):
                moved = F.copy()
                moved[m, :, i, j] += sign * H
                tau.append(stress(elastic_part(LAW, moved, R)))
            slope = (tau[0] - tau[1]) / (2.0 * H)
            rows = np.einsum("wt,tfpab,tpab->wfp", chi * later, PAIRING, slope)
            found[:, :, :, i, j] = rows
    return found


def found_at(F, chi, most):
    def back(trial, first):
        elastic = elastic_part(LAW, trial.reshape(1, -1, 3, 3), R).reshape(trial.shape)
        return elastic, stress(elastic)

    elastic = elastic_part(LAW, F, R)
    return lasting(F, elastic, lambda n: PAIRING[n], chi, back, most)


@pytest.mark.parametrize(("most", "forgotten", "share"), [(4, 0.0, 1e-4), (1000, 0.01, 0.04)])
def test_rows_remember_what_flow_has_left(chi, most, forgotten, share, monkeypatch):
    """Without forgetting to the last digits; what is forgotten is small."""
    monkeypatch.setattr(history, "FORGOTTEN", forgotten)
    F = path(0.005)
    found = found_at(F, chi, most)
    size = max(np.abs(own.rows).max() for own in found)
    for m in range(1, TIMES - 1):
        wanted = by_history(F, chi, m)
        for own, rows in zip(found, wanted, strict=True):
            held = own.rows[own.times == m]
            through = held[0] if len(held) else np.zeros_like(rows)
            np.testing.assert_allclose(through, rows, rtol=0.0, atol=share * size)


def test_nothing_lasts_where_nothing_flows(chi):
    assert all(not len(own.times) for own in found_at(path(5e-5), chi, 1000))
