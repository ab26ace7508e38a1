"""Derivatives of the stress that rows integrate, against differences of the whole."""

import numpy as np
import pytest

from form_drake.laws import law_named
from form_drake.weak.release import released
from form_drake.weak.stress import elastic_part, unit_stresses
from form_drake.weak.tangent import State, stride, tangent

H = 1e-5
THETA = np.array([3.0e4, 4.5e4, 2.0e3])
VALUES = {"mu": 3.0e4, "lam": 4.5e4, "tau_y": 1.0e3}


def by_entries(f, F):
    """Central differences, shape [..., 9, 3, 3], entries of F last."""
    units = np.eye(9).reshape(9, 3, 3)
    found = np.stack([(f(F + H * E) - f(F - H * E)) / (2.0 * H) for E in units], axis=-1)
    return found.reshape(*F.shape[:-2], 9, 3, 3)


@pytest.fixture
def motion():
    rng = np.random.default_rng(0)
    F = np.eye(3) + 0.1 * rng.standard_normal((4, 5, 3, 3))
    return F, rng.standard_normal(F.shape), np.eye(3) + 0.03 * rng.standard_normal(F.shape)


@pytest.mark.parametrize("material", [False, True])
@pytest.mark.parametrize(
    ("name", "axes"),
    [
        ("fixed-corotated", ()),
        ("fixed-corotated", (0, 2)),
        ("neo-hookean", (1,)),
        ("von-mises", ()),
        ("fixed-corotated+damping", ()),
    ],
)
def test_derivatives_are_those_of_the_whole(motion, name, axes, material):
    """With the return to the yield surface, with stretches that the law chooses, and with rates."""
    (F, L, unload), law = motion, law_named(name)
    theta, plastic = THETA[: len(law.terms)], law.flow == "plastic"

    def stress(F, L):
        paired = elastic = released(law, F, VALUES, theta, axes)
        if plastic:
            flat = (F @ unload).reshape(1, -1, 3, 3)
            elastic = elastic_part(law, flat, law.radius_vector(VALUES)).reshape(F.shape)
        tau = np.tensordot(theta, unit_stresses(law, elastic, L, VALUES), axes=1)
        return tau @ np.linalg.inv(paired).swapaxes(-1, -2) if material else tau

    at = State(
        released(law, F, VALUES, theta, axes),
        L,
        unload=unload if plastic else None,
        seen=F if axes else None,
        axes=axes,
    )
    found = tangent(law, at, VALUES, theta, material=material, rates="rate" in law.needs)
    wanted = by_entries(lambda F: stress(F, L), F)
    np.testing.assert_allclose(found.stress, stress(F, L), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.by_F, wanted, atol=1e-5 * np.abs(wanted).max())
    if "rate" in law.needs:
        wanted = by_entries(lambda L: stress(F, L), L)
        np.testing.assert_allclose(found.by_L, wanted, atol=1e-5 * np.abs(wanted).max())
    else:
        assert found.by_L is None


def test_a_supplied_pressure_takes_the_place_of_the_law_s(motion):
    F, L, _ = motion
    law, theta = law_named("mu-i"), np.array([0.4, 0.2, 1.0e4])
    values = {k: 1.0 for k in law.keys} | {"I_0": 0.3, "kappa": 1e4}
    theta, p = np.resize(theta, len(law.terms)), np.full(F.shape[:2], 50.0)
    wanted = np.tensordot(theta, unit_stresses(law, F, L, values, p), axes=1)
    own, given = (tangent(law, State(F, L, pressure=q), values, theta) for q in (None, p))
    np.testing.assert_allclose(given.stress, wanted, rtol=1e-9)
    assert np.abs(own.stress - given.stress).max() > 1e-3 * np.abs(wanted).max()


@pytest.mark.parametrize("name", ["von-mises", "neo-hookean"])
def test_a_stride_is_followed_from_where_it_begins(motion, name):
    """Its stress is that of a history through the same places, its slope the differences of it."""
    law = law_named(name)
    theta, before = THETA[: len(law.terms)], motion[0].reshape(-1, 3, 3)
    on = before + 5e-4 * motion[1].reshape(-1, 3, 3)
    r = law.radius_vector(VALUES)
    begun = elastic_part(law, before[None], r)[0]
    P, elastic, slope = stride(law, on, before, begun, VALUES, theta, slopes=True)
    trial = on @ np.linalg.inv(before) @ begun
    wanted = elastic_part(law, np.stack([begun, trial]), r)[1]
    np.testing.assert_allclose(elastic, wanted, atol=1e-12)
    tau = np.tensordot(theta, unit_stresses(law, wanted, np.zeros_like(wanted), VALUES), axes=1)
    np.testing.assert_allclose(P @ on.swapaxes(1, 2), tau, atol=1e-9 * np.abs(tau).max())
    by = by_entries(lambda F: stride(law, F, before, begun, VALUES, theta)[0], on)
    size = np.abs(by).max()
    np.testing.assert_allclose(slope.reshape(by.shape), by, atol=1e-5 * size)
