"""Elasto-plastic laws with Hencky elasticity and a radial return at constant volume.

The elastic strain e = 1/2 log(F F^T) belongs to the elastic deformation gradient F. After a trial
step the deviator of e is scaled back to the radius that the law allows at the trial's trace.
"""

from typing import Any

import numpy as np
import warp as wp

from form_drake.laws.elastic import SQUEEZED
from form_drake.laws.law import Constant, Law, Term, Values


@wp.func
def hencky_shear(q: Any, s: Any):
    """2 e."""
    return q.F.dtype(2.0) * q.e


@wp.func
def hencky_volume(q: Any, s: Any):
    """tr(e) I."""
    return wp.trace(q.e) * wp.identity(n=3, dtype=q.F.dtype)


@wp.func
def constant_radius(trace: Any, r: Any):
    """|dev e| <= r_0."""
    return r[0]


@wp.func
def cone_radius(trace: Any, r: Any):
    """|dev e| <= -r_0 tr e; no strain survives in tension."""
    return -r[0] * trace


def _lame(values: Values) -> tuple[float, float]:
    return values["lam"] + 2.0 / 3.0 * values["mu"], values["mu"]


MU = Term("mu", "Pa", hencky_shear, guess=(0.38,), excited="shear the body below yield")
LAM = Term("lam", "Pa", hencky_volume, guess=(0.58,), signed=True, excited=SQUEEZED)
YIELDING = "load it beyond yield"

VON_MISES = Law(
    name="von-mises",
    parameters=(
        MU,
        LAM,
        Constant(
            "tau_y",
            "Pa",
            "yield",
            guess=(0.003, 0.03, 0.3),
            excited=YIELDING,
            tells=("Y", "Pa", lambda tau_y: float(np.sqrt(1.5)) * tau_y),
        ),
    ),
    moduli=_lame,
    equation="2 mu e + lam tr(e) I, |dev tau| <= tau_y",
    needs=frozenset({"strain"}),
    flow="plastic",
    radius=constant_radius,
    radius_constants=lambda v: (v["tau_y"] / (2.0 * v["mu"]),),
)


STEEPEST = float(np.sqrt(2.0 / 3.0))  # alpha of a friction angle of 90 deg


def friction_angle(alpha: float) -> float:
    """Friction angle [rad] of the cone alpha = sqrt(2/3) 2 sin(phi) / (3 - sin(phi)).

    For every alpha: an estimate may lie outside of what can be.
    """
    alpha = float(np.clip(alpha, -0.5 * STEEPEST, STEEPEST))
    return float(np.arcsin(3.0 * alpha / (2.0 * np.sqrt(2.0 / 3.0) + alpha)))


def cone_slope(values: Values) -> tuple[float, ...]:
    """|dev e| / (-tr e) on the Drucker-Prager cone."""
    return (values["alpha"] * (3.0 * values["lam"] + 2.0 * values["mu"]) / (2.0 * values["mu"]),)


DRUCKER_PRAGER = Law(
    name="drucker-prager",
    parameters=(
        MU,
        LAM,
        Constant(
            "alpha",
            "-",
            "yield",
            guess=(0.1, 0.3),
            excited=f"{YIELDING} under pressure",
            tells=("friction_angle", "rad", friction_angle),
            limit=(STEEPEST, f"sqrt(2/3) = {STEEPEST:.4f}, a friction angle of 90 deg"),
        ),
    ),
    moduli=_lame,
    equation="2 mu e + lam tr(e) I, |dev tau| <= -alpha tr(tau) (cone, no tension)",
    needs=frozenset({"strain"}),
    flow="plastic",
    radius=cone_radius,
    radius_constants=cone_slope,
)
