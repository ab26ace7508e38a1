"""The second half of Gent and Thomas' energy: W = C2 ln(I2 / 3), for neo-hookean+gent-thomas."""

from typing import Any

import warp as wp

from form_drake.laws import KAPPA, Law, Term, deviator, isochoric_b


@wp.func
def logarithm_of_i2(q: Any, s: Any):
    """(2 / I2) dev a with a = I1 b - b b, whose trace is 2 I2."""
    b = isochoric_b(q.F, q.J)
    a = wp.trace(b) * b - b * b
    return q.F.dtype(4.0) / wp.trace(a) * deviator(a)


GENT_THOMAS = Law(
    name="gent-thomas",
    parameters=(Term("C2", "Pa", logarithm_of_i2, excited="stretch it in two directions"), KAPPA),
    moduli=lambda v: (v["kappa"], 2.0 / 3.0 * v["C2"]),
    equation="2 C2 / I2 dev(I1 b - b b) + kappa J (J - 1) I",
)
