"""Values of a law's parameters: what they may be, and E and nu in place of mu and lam."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from form_drake.laws.law import Constant, Law, Values

LAME = ("mu", "lam")
ENGINEERING = ("E", "nu")


def has_lame(law: Law) -> bool:
    """Whether E and nu can stand for the law's mu and lam: not in a sum, whose moduli hold more.

    What only adds to a law adds nothing to its moduli.
    """
    return set(LAME) <= set(law.keys) and len([p for p in law.parts if not p.adds_to]) == 1


def lame(E: float, nu: float) -> tuple[float, float]:
    """Lame's constants (mu, lam) [Pa] from Young's modulus [Pa] and Poisson's ratio.

    Raises:
        ValueError: E is not positive or nu not in (-1, 0.5).
    """
    if not E > 0 or not -1 < nu < 0.5:
        raise ValueError(f"E = {E}, nu = {nu}: E must be positive and nu between -1 and 0.5")
    return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def with_lame(law: Law, values: Values) -> dict[str, float]:
    """``values`` with E and nu, where both are given, turned into the law's mu and lam.

    Raises:
        ValueError: the law has no mu and lam, one of the pair is missing, or both pairs are given.
    """
    named = [k for k in ENGINEERING if k in values and k not in law.keys]
    if not named:
        return dict(values)
    rest = {k: v for k, v in values.items() if k not in ENGINEERING}
    if not has_lame(law):
        raise ValueError(f"{law.name} has no E and nu: its parameters are {', '.join(law.keys)}")
    if len(named) == 1:
        raise ValueError(f"{named[0]} alone is given: give E and nu together, or mu and lam")
    if set(LAME) & set(rest):
        raise ValueError("give either E and nu or mu and lam, not both")
    return {**rest, **dict(zip(LAME, lame(values["E"], values["nu"]), strict=True))}


def checked_values(law: Law, values: Mapping[str, Any]) -> dict[str, float]:
    """Allowed numbers for parameters that the law has; E and nu stand for mu and lam.

    Raises:
        ValueError: an unknown key, or a value that is not finite or physically impossible.
    """
    allowed = set(law.keys) | (set(ENGINEERING) if has_lame(law) else set())
    numbers = {}
    for key, value in values.items():
        if key not in allowed:
            raise ValueError(
                f"{law.name} has no parameter {key!r}: choose from {', '.join(sorted(allowed))}"
            )
        numbers[key] = finite(key, value)
    return {k: allowed_value(law, k, v) for k, v in with_lame(law, numbers).items()}


def allowed_value(law: Law, key: str, value: float) -> float:
    """``value``, if the parameter may have it.

    Raises:
        ValueError: it is not finite, not positive though the parameter must be, or above its limit.
    """
    parameter = law.parameter(key)
    if not parameter.signed and not value > 0:
        raise ValueError(f"{key}: must be positive, got {value}")
    if isinstance(parameter, Constant) and parameter.limit and not value < parameter.limit[0]:
        raise ValueError(f"{key}: must be below {parameter.limit[1]}, got {value}")
    return finite(key, value)


def check_moduli(law: Law, values: Values) -> None:
    """Refuse a body that gives way without end; an estimate may say so, nothing can be simulated.

    Raises:
        ValueError: its bulk modulus, or of a solid the shear modulus, is not positive.
    """
    K, G = law.moduli(values)
    moduli = {"bulk": K} | ({"shear": G} if law.flow in ("elastic", "plastic") else {})
    for name, modulus in moduli.items():
        if not modulus > 0.0:
            keys = ", ".join(t.key for t in law.terms)
            raise ValueError(f"{name} modulus {modulus:.6g} Pa: must be positive, change {keys}")


def finite(key: str, value: Any) -> float:
    """``value`` as a finite number.

    Raises:
        ValueError: it is none.
    """
    try:
        number = float(value) if not isinstance(value, bool | np.bool_) else np.nan
    except (TypeError, ValueError, OverflowError):
        number = np.nan
    if not np.isfinite(number):
        raise ValueError(f"{key}: a finite number is wanted, got {str(value)[:60]!r}")
    return number
