"""Fluids and granular flow: of the deformation gradient only the volume change J survives.

D is the symmetric part of the velocity gradient L [1/s] and gamma = sqrt(2 dev D : dev D + eps^2)
the regularised shear rate. ``kappa`` is a numerical bulk modulus.
"""

from typing import Any

import numpy as np
import warp as wp

from form_drake.laws.elastic import SQUEEZED, linear_volume
from form_drake.laws.law import Constant, Law, Term
from form_drake.laws.tensor import deviator


@wp.func
def shear_rate_tensor(L: Any):
    """dev D."""
    return deviator(L.dtype(0.5) * (L + wp.transpose(L)))


@wp.func
def regularised_rate(d: Any, epsilon: Any):
    """sqrt(2 d : d + epsilon^2)."""
    return wp.sqrt(type(epsilon)(2.0) * wp.ddot(d, d) + epsilon * epsilon)


@wp.func
def viscous(q: Any, s: Any):
    """2 J dev D."""
    return q.F.dtype(2.0) * q.J * shear_rate_tensor(q.L)


@wp.func
def bingham_yield(q: Any, s: Any):
    """2 J dev D / gamma; s = (epsilon)."""
    d = shear_rate_tensor(q.L)
    return q.F.dtype(2.0) * q.J / regularised_rate(d, s[0]) * d


@wp.func
def granular_pressure(J: Any):
    """-log(J) / J, never negative."""
    return wp.max(-wp.log(J) / J, type(J)(0.0))


@wp.func
def static_friction(q: Any, s: Any):
    """J p 2 dev D / gamma; s = (I_0, grain diameter, grain density, epsilon)."""
    d = shear_rate_tensor(q.L)
    return q.F.dtype(2.0) * q.J * q.p / regularised_rate(d, s[3]) * d


@wp.func
def inertial_friction(q: Any, s: Any):
    """I / (I + I_0) times the static response, I = gamma d sqrt(rho_s / p).

    Written without a division by p, so that it vanishes with the pressure.
    """
    rate = regularised_rate(shear_rate_tensor(q.L), s[3]) * s[1] * wp.sqrt(s[2])
    root = wp.sqrt(wp.max(q.p, type(q.p)(0.0)))  # a measured pressure may be noise
    return rate / (rate + s[0] * root) * static_friction(q, s)


@wp.func
def logarithmic_volume(q: Any, s: Any):
    """min(log J, 0) I."""
    return wp.min(wp.log(q.J), type(q.J)(0.0)) * wp.identity(n=3, dtype=q.F.dtype)


FLOWING = "let it flow at several rates"
FRICTION = "record several inclinations or inertial numbers"
TOLD = "state its value"  # of a constant that no motion determines


def repose_angle(mu_s: float) -> float:
    """Static friction angle [rad] of the mu(I) law."""
    return float(np.arctan(mu_s))


ETA = Term("eta", "Pa s", viscous, guess=(1e-4, 1e-2), excited=FLOWING)
GIVEN_KAPPA = Term("kappa", "Pa", linear_volume, guess=(1.0,), given=True, excited=SQUEEZED)

NEWTONIAN = Law(
    name="newtonian",
    parameters=(ETA, GIVEN_KAPPA),
    moduli=lambda v: (v["kappa"], 0.0),
    equation="2 eta J dev D + kappa J (J - 1) I",
    viscosity=lambda v: v["eta"],
    needs=frozenset({"rate"}),
    flow="fluid",
)

BINGHAM = Law(
    name="bingham",
    parameters=(
        ETA,
        Term("tau_y", "Pa", bingham_yield, guess=(0.001, 0.1), excited=FLOWING),
        GIVEN_KAPPA,
        Constant("epsilon", "1/s", "shape", guess=(1.0,), excited=FLOWING),
    ),
    moduli=lambda v: (v["kappa"], 0.0),
    equation="2 eta J dev D + 2 tau_y J dev D / gamma + kappa J (J - 1) I",
    viscosity=lambda v: v["eta"] + v["tau_y"] / v["epsilon"],
    needs=frozenset({"rate"}),
    flow="fluid",
)

MU_I = Law(
    name="mu-i",
    parameters=(
        Term(
            "mu_s",
            "-",
            static_friction,
            guess=(0.4,),
            excited=FRICTION,
            tells=("friction_angle", "rad", repose_angle),
        ),
        Term("delta_mu", "-", inertial_friction, guess=(0.3,), excited=FRICTION),
        Constant("I_0", "-", "shape", guess=(0.3,), excited=FRICTION),
        Term("kappa", "Pa", logarithmic_volume, given=True, excited=TOLD),
        Constant("grain_diameter", "m", "given", excited=TOLD),
        Constant("grain_density", "kg/m^3", "given", excited=TOLD),
        Constant("epsilon", "1/s", "given", excited=TOLD),
    ),
    moduli=lambda v: (v["kappa"], 0.0),
    equation="[mu_s + delta_mu I / (I + I_0)] J p 2 dev D / gamma + kappa log(J) I",
    needs=frozenset({"rate"}),
    flow="granular",
    pressure=granular_pressure,
)

WEAKLY_COMPRESSIBLE = Law(
    name="weakly-compressible",
    parameters=(Term("lam", "Pa", linear_volume, excited=SQUEEZED),),
    moduli=lambda v: (v["lam"], 0.0),
    equation="lam J (J - 1) I",
    flow="fluid",
)
