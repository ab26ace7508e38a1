"""What noise leaves in plastic strain: the adjoint against differences of whole histories."""

import numpy as np
import pytest

from form_drake.laws import law_named
from form_drake.weak import history
from form_drake.weak.covariance import Part, Window, _by_moment, _by_pair
from form_drake.weak.history import lasting
from form_drake.weak.solve import throughout
from form_drake.weak.stress import elastic_part, unit_stresses
from form_drake.weak.system import Row, WeakSystem
from form_drake.weak.tangent import State, tangent

LAW = law_named("von-mises")
THETA = np.array([3.0e4, 4.5e4])
R = np.array([0.004, 0.0, 0.0, 0.0])
VALUES = {"mu": THETA[0], "lam": THETA[1], "tau_y": 2.0 * THETA[0] * R[0]}
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


def found_at(F, chi, most, every=1):
    def back(trial, first):
        at = State(trial, np.zeros_like(trial))
        return tangent(LAW, at, VALUES, THETA, elastic=True)

    elastic = elastic_part(LAW, F, R)
    return lasting(F, elastic, lambda at: PAIRING[at], chi, back, most, every)


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
            held = own.rows[own.shares[:, m] > 0.0]
            through = held[0] if len(held) else np.zeros_like(rows)
            np.testing.assert_allclose(through, rows, rtol=0.0, atol=share * size)


def test_nothing_lasts_where_nothing_flows(chi):
    assert all(not len(own.rows) for own in found_at(path(5e-5), chi, 1000))


def test_neighbouring_times_make_one_look(chi):
    single, pairs = (found_at(path(0.005), chi, 1000, every) for every in (1, 2))
    assert sum(len(two.rows) for two in pairs) < sum(len(one.rows) for one in single)
    for one, two in zip(single, pairs, strict=True):
        np.testing.assert_array_equal(two.shares.sum(axis=0), one.shares.sum(axis=0))
        for share, rows in zip(two.shares, two.rows, strict=True):
            own = one.rows[one.shares @ share > 0.0]
            np.testing.assert_allclose(rows, own.mean(axis=0), atol=1e-9 * np.abs(rows).max())


def test_windows_in_pairs_and_by_moment_are_one_covariance():
    """Windows of unlike lengths, one that hears nothing, and one far from all others."""
    rng = np.random.default_rng(4)
    looks, moments, functions, fields = 40, 60, 5, 2
    series = np.zeros((looks, moments))
    for n in range(looks):
        series[n, n : n + 4] = rng.standard_normal(4)
    windows = []
    for first, last, size in ((0, 5, 1.0), (3, 6, 2.0), (5, 9, 0.0), (30, 36, 1.0)):
        slopes = rng.standard_normal((last - first, functions, fields))
        windows.append(Window(size * series[first:last], slopes))
    gain = rng.standard_normal((3, fields * len(windows)))
    for alike in (1, moments):  # every moment is as large, or has a size of its own
        part = Part(tuple(windows), rng.uniform(0.5, 1.0, (alike, functions)))
        both = _by_pair(part), _by_moment(part)
        np.testing.assert_allclose(*both, atol=1e-12 * np.abs(both[1]).max())
        few, own = gain @ both[0] @ gain.T, np.diag(both[0])
        np.testing.assert_allclose(part.combined(gain), few, atol=1e-12 * np.abs(few).max())
        np.testing.assert_allclose(part.variances(), own, atol=1e-12 * own.max())
        assert not both[0][4:6].any() and not both[0][:2, 6:].any() and both[0][:2, 2:4].any()


def test_an_error_that_lasts_has_the_sign_of_the_stress():
    rows = tuple(Row((0.0, 1.0), field, probe) for probe in "ab" for field in ("x", "y", "x"))
    A = np.array([1.0, 1.0, -1.0, 2.0, 1.0, 1.0])[:, None]
    system = WeakSystem(A, np.zeros(6), np.abs(A[:, 0]), np.abs(A), rows)
    first, second = throughout(system, np.array([3.0]), 0.1, [3, 3])
    np.testing.assert_allclose(first, 0.01 * np.array([[1, 0, -1], [0, 1, 0], [-1, 0, 1]]))
    np.testing.assert_allclose(second, 0.01 * np.array([[4, 0, 2], [0, 1, 0], [2, 0, 1]]))
