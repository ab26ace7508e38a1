"""What a plain law leaves out: stresses that are added to it, as in ``fixed-corotated+damping``.

An addition bears nothing at rest, or nothing alike in all directions, so it is no law by itself.
"""

from typing import Any

import warp as wp

from form_drake.laws.elastic import YEOH
from form_drake.laws.flow import FLOWING, TOLD, regularised_rate, shear_rate_tensor, viscous
from form_drake.laws.law import Constant, Law, Term

SLOWEST, FASTEST = 1e-2, 1e2  # rates [1/s] between which rate dependence is that of a power
SOLID = frozenset({"elastic", "plastic"})


@wp.func
def power_of_rate(q: Any, s: Any):
    """2 J (gamma / 1 Hz)^(n - 1) dev D; s = (n)."""
    d = shear_rate_tensor(q.L)
    gamma = wp.min(regularised_rate(d, q.F.dtype(SLOWEST)), q.F.dtype(FASTEST))
    return q.F.dtype(2.0) * q.J * wp.pow(gamma, s[0] - q.F.dtype(1.0)) * d


@wp.func
def fibre(q: Any, s: Any):
    """(I4 - 1)/2 f f, f = F a, I4 = f . f; s = (azimuth, elevation) of a.

    The whole stretch counts, not its isochoric part, which would let a fibre be squeezed by pressure
    without an answer (Helfenstein et al. 2010, Int. J. Solids Struct. 47).
    """
    flat = wp.cos(s[1])
    a = wp.vector(flat * wp.cos(s[0]), flat * wp.sin(s[0]), wp.sin(s[1]))
    f = q.F * a
    return q.F.dtype(0.5) * (wp.dot(f, f) - q.F.dtype(1.0)) * wp.outer(f, f)


def _nothing_at_rest(_: object) -> tuple[float, float]:
    return 0.0, 0.0


DAMPING = Law(
    name="damping",
    parameters=(Term("eta", "Pa s", viscous, guess=(1e-4, 1e-2), excited=FLOWING),),
    moduli=_nothing_at_rest,
    equation="2 eta J dev D",
    needs=frozenset({"rate"}),
    adds_to=SOLID,
    viscosity=lambda v: v["eta"],
)

RATE_DEPENDENCE = Law(
    name="rate-dependence",
    parameters=(
        Term("eta_n", "Pa s", power_of_rate, guess=(1e-4, 1e-2), excited=FLOWING),
        Constant("n", "-", "given", guess=(0.5,), excited=TOLD),
    ),
    moduli=_nothing_at_rest,
    equation="2 eta_n J (gamma / 1 Hz)^(n - 1) dev D",
    needs=frozenset({"rate"}),
    adds_to=SOLID,
    viscosity=lambda v: v["eta_n"] * max(SLOWEST ** (v["n"] - 1.0), FASTEST ** (v["n"] - 1.0)),
)

STIFFENING = Law(
    name="stiffening",
    parameters=(YEOH.parameter("C2"),),
    moduli=_nothing_at_rest,
    equation="4 C2 (I1 - 3) dev b",
    adds_to=SOLID,
)

ANISOTROPY = Law(
    name="anisotropy",
    parameters=(
        Term("k_f", "Pa", fibre, guess=(0.1,), excited="load it along several directions"),
        Constant("azimuth", "rad", "given", excited=TOLD, signed=True),
        Constant("elevation", "rad", "given", excited=TOLD, signed=True),
    ),
    moduli=_nothing_at_rest,
    equation="k_f/2 (I4 - 1) f f, f = F a",
    adds_to=frozenset({"elastic"}),
    stretched=lambda v: v["k_f"],
)

ADDITIONS = {law.name: law for law in (DAMPING, RATE_DEPENDENCE, STIFFENING, ANISOTROPY)}
