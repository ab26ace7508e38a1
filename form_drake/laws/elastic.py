"""Elastic and hyperelastic laws: the first half of the paper's Table I, as Kirchhoff stresses.

Every volumetric response is J (J - 1) I, that is p = -kappa (J - 1) for the Cauchy pressure.
"""

from typing import Any

import warp as wp

from form_drake.laws.law import Constant, Law, Term
from form_drake.laws.tensor import deviator, isochoric_b


@wp.func
def linear_volume(q: Any, s: Any):
    """J (J - 1) I."""
    return q.J * (q.J - type(q.J)(1.0)) * wp.identity(n=3, dtype=q.F.dtype)


@wp.func
def first_invariant(q: Any, s: Any):
    """2 dev b."""
    return q.F.dtype(2.0) * deviator(isochoric_b(q.F, q.J))


@wp.func
def second_invariant(q: Any, s: Any):
    """2 dev(I1 b - b b)."""
    b = isochoric_b(q.F, q.J)
    return q.F.dtype(2.0) * deviator(wp.trace(b) * b - b * b)


@wp.func
def yeoh_second(q: Any, s: Any):
    """2 . 2 (I1 - 3) dev b."""
    b = isochoric_b(q.F, q.J)
    return q.F.dtype(4.0) * (wp.trace(b) - q.F.dtype(3.0)) * deviator(b)


@wp.func
def yeoh_third(q: Any, s: Any):
    """2 . 3 (I1 - 3)^2 dev b."""
    b = isochoric_b(q.F, q.J)
    x = wp.trace(b) - q.F.dtype(3.0)
    return q.F.dtype(6.0) * x * x * deviator(b)


@wp.func
def gent_shear(q: Any, s: Any):
    """dev b / (1 - (I1 - 3) / J_m); held at 1/1000 of the limit beyond it."""
    b = isochoric_b(q.F, q.J)
    room = q.F.dtype(1.0) - (wp.trace(b) - q.F.dtype(3.0)) / s[0]
    return deviator(b) / wp.max(room, q.F.dtype(1.0e-3))


@wp.func
def corotated_shear(q: Any, s: Any):
    """2 (F - R) F^T."""
    return q.F.dtype(2.0) * (q.F - q.R) * wp.transpose(q.F)


SHEARED = "shear the body"
SQUEEZED = "compress or expand its volume"

KAPPA = Term("kappa", "Pa", linear_volume, guess=(0.83,), excited=SQUEEZED)

NEO_HOOKEAN = Law(
    name="neo-hookean",
    parameters=(Term("C10", "Pa", first_invariant, guess=(0.19,), excited=SHEARED), KAPPA),
    moduli=lambda v: (v["kappa"], 2.0 * v["C10"]),
    equation="2 C10 dev b + kappa J (J - 1) I",
)

MOONEY_RIVLIN = Law(
    name="mooney-rivlin",
    parameters=(
        Term("C10", "Pa", first_invariant, guess=(0.15,), excited="stretch it in two directions"),
        Term(
            "C01",
            "Pa",
            second_invariant,
            guess=(0.04,),
            signed=True,
            excited="stretch it in two directions",
        ),
        KAPPA,
    ),
    moduli=lambda v: (v["kappa"], 2.0 * (v["C10"] + v["C01"])),
    equation="2 dev[C10 b + C01 (I1 b - b b)] + kappa J (J - 1) I",
)

YEOH = Law(
    name="yeoh",
    parameters=(
        Term("C1", "Pa", first_invariant, guess=(0.19,), excited=SHEARED),
        Term(
            "C2",
            "Pa",
            yeoh_second,
            guess=(0.01,),
            signed=True,
            excited="stretch it beyond I1 - 3 of some tenths",
        ),
        Term(
            "C3",
            "Pa",
            yeoh_third,
            guess=(0.001,),
            signed=True,
            excited="stretch it beyond I1 - 3 of about one",
        ),
        KAPPA,
    ),
    moduli=lambda v: (v["kappa"], 2.0 * v["C1"]),
    equation="2 [C1 + 2 C2 (I1 - 3) + 3 C3 (I1 - 3)^2] dev b + kappa J (J - 1) I",
)

GENT = Law(
    name="gent",
    parameters=(
        Term("mu", "Pa", gent_shear, guess=(0.38,), excited=SHEARED),
        Constant(
            "J_m",
            "-",
            "shape",
            guess=(3.0, 30.0),
            excited="stretch it beyond I1 - 3 of a tenth of J_m",
        ),
        KAPPA,
    ),
    moduli=lambda v: (v["kappa"], v["mu"]),
    equation="mu / (1 - (I1 - 3) / J_m) dev b + kappa J (J - 1) I",
)

FIXED_COROTATED = Law(
    name="fixed-corotated",
    parameters=(
        Term("mu", "Pa", corotated_shear, guess=(0.38,), excited=SHEARED),
        Term("lam", "Pa", linear_volume, guess=(0.58,), signed=True, excited=SQUEEZED),
    ),
    moduli=lambda v: (v["lam"] + 2.0 / 3.0 * v["mu"], v["mu"]),
    equation="2 mu (F - R) F^T + lam J (J - 1) I",
    needs=frozenset({"rotation"}),
)
