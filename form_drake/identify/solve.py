"""Least squares, what it could not determine, and the answer of an identification."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from form_drake.laws import Law
from form_drake.material import Material

LARGEST_CONDITION = 1e10
LARGEST_MISFIT = 30.0
# relative error that rounding leaves in a parameter, in units of the last place: Warp's single
# precision svd3 is itself right to some 1e-5 only
ROUNDING = {"series": 4.0, "svd3": 32.0}


class Unidentifiable(ValueError):
    """The motion does not determine some parameters; ``keys`` names them."""

    def __init__(self, keys: Sequence[str], advice: str):
        self.keys = tuple(keys)
        super().__init__(f"the motion does not determine {', '.join(self.keys)}: {advice}")

    @classmethod
    def of(cls, law: Law, keys: Sequence[str], reason: str = "") -> "Unidentifiable":
        """The refusal that says which motion would determine the parameters of a law."""
        phrases = dict.fromkeys(law.parameter(k).excited for k in keys)
        form = ",".join(f"{k}=VALUE" for k in keys)
        words = f"{'; '.join(phrases)}; or state --known {form}"
        return cls(keys, f"({reason}) {words}" if reason else words)


def require_given(law: str, missing: Sequence[str], where: str = "") -> None:
    """Refuse to go on without the values that a law must be given.

    Args:
        law: its name.
        missing: keys.
        where: to state them; empty: as ``--known``.

    Raises:
        ValueError: ``missing`` is not empty.
    """
    if missing:
        where = where or "as --known " + ",".join(f"{k}=VALUE" for k in missing)
        raise ValueError(f"{law} needs given values for {', '.join(missing)}: state them {where}")


def with_rounding(
    covariance: np.ndarray,
    values: np.ndarray,
    condition: float,
    precision: str,
    decomposition: str,
) -> np.ndarray:
    """Covariance with the rounding of the recorded motion, which more rows do not average out."""
    share = condition * ROUNDING[decomposition] * float(np.finfo(precision).eps)
    return covariance + np.diag((share * values) ** 2)


@dataclass(frozen=True)
class LeastSquares:
    """Solution of A theta = b.

    Attributes:
        theta: coefficients, shape [columns].
        covariance: for independent rows of equal variance, shape [columns, columns].
        condition: condition number of A with columns scaled to unit length.
        residual: root mean square of b - A theta.
        rows: number of rows.
    """

    theta: np.ndarray
    covariance: np.ndarray
    condition: float
    residual: float
    rows: int


def least_squares(A: np.ndarray, b: np.ndarray, keys: Sequence[str]) -> LeastSquares:
    """Solve A theta = b in the least-squares sense.

    Args:
        A: shape [rows, columns].
        b: shape [rows].
        keys: name of each column.

    Raises:
        Unidentifiable: too few rows, or columns that vanish or depend on each other.
    """
    rows, columns = A.shape
    advice = "record a motion that strains the body more, and in more ways"
    scale = np.linalg.norm(A, axis=0)
    dead = [k for k, s in zip(keys, scale, strict=True) if not s > 0]
    if dead or rows <= columns:
        raise Unidentifiable(dead or keys, advice)
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    if s[-1] * LARGEST_CONDITION < s[0]:
        weak = [k for k, c in zip(keys, Vt[-1], strict=True) if abs(c) > 0.1]
        raise Unidentifiable(weak, advice)
    theta = (Vt.T @ ((U.T @ b) / s)) / scale
    residual = b - A @ theta
    inverse = (Vt.T / s**2) @ Vt / np.outer(scale, scale)
    variance = float(residual @ residual) / (rows - columns)
    rms = float(np.sqrt(np.mean(residual**2)))
    return LeastSquares(theta, variance * inverse, float(s[0] / s[-1]), rms, rows)


@dataclass(frozen=True)
class Identification:
    """An identified material and how well the data determine it.

    Attributes:
        material: with the covariance of the identified parameters.
        method: ``step``, ``rollout`` or ``weak``.
        observed: ``full``, ``no-stress`` or ``positions``; of the weak form, what was measured.
        condition: condition number of the scaled columns at the solution.
        residual: root mean square residual, in ``residual_unit``.
        rows: number of equations.
        seconds: time of the solution, kernel compilation apart [s].
        compile_seconds: time spent on loading or compiling kernels [s].
        misfit: residual in units of what noise or rounding explain; far above 1, the law or the
            recording's statements are wrong.
        details: further facts, e.g. initial velocity or the number of rollouts.
        weak: rows and residuals of the weak form, a ``WeakFit``; None for other methods.
    """

    material: Material
    method: str
    observed: str
    condition: float
    residual: float
    residual_unit: str
    rows: int
    seconds: float
    compile_seconds: float = 0.0
    misfit: float | None = None
    details: dict[str, Any] = field(default_factory=dict)
    weak: Any = field(default=None, repr=False)

    def to_json(self) -> dict[str, object]:
        """The command line's JSON object."""
        return {
            "law": self.material.law.name,
            "method": self.method,
            "observe": self.observed,
            "parameters": self.material.to_json(),
            "covariance": {
                "keys": list(self.material.keys),
                "values": self.material.covariance.tolist(),
            },
            "condition": self.condition,
            "residual": self.residual,
            "residual_unit": self.residual_unit,
            "rows": self.rows,
            "misfit": self.misfit,
            "seconds": self.seconds,
            "compile_seconds": self.compile_seconds,
            **self.details,
        }

    def __str__(self) -> str:
        return table(self)


def table(answer: Identification) -> str:
    """The answer as a plain table with 95 % intervals; angles also in degrees."""
    known, without = (answer.details.get(k, {}) for k in ("known", "without_twin"))
    head = f"{'without twin':>16}" if without else ""
    lines = [f"{'parameter':16}{'value':>16}{'± 95 %':>14}{head}  unit"]
    for key, p in answer.material.parameters().items():
        band = "given" if p.std is None or key in known else f"{1.96 * p.std:.2g}"
        unit = "" if p.unit == "-" else p.unit
        if p.unit == "rad":
            unit = f"rad = {np.degrees(p.value):.4g} deg"
        mark = " (derived)" if p.derived else ""
        first = f"{without[key]['value']:>16.8g}" if without else ""
        lines.append(f"{key:16}{p.value:>16.8g}{band:>14}{first}  {unit}{mark}")
    effective = answer.details.get("effective_rows")
    worth = "" if effective is None else f" (worth {effective:.3g} independent ones)"
    lines.append(
        f"{answer.material.law.name}: {answer.method}, {answer.observed}; {answer.rows} rows{worth},"
        f" condition {answer.condition:.3g}, residual {answer.residual:.3g}"
        f" {answer.residual_unit}, {answer.seconds:.2f} s"
        f" (+ {answer.compile_seconds:.1f} s kernels)"
    )
    if added := answer.details.get("added_noise"):
        lines.append(f"NOISE ADDED: {added:.3g} m on every coordinate, on purpose")
    if bound := answer.details.get("at_bound"):
        lines.append(
            f"AT ITS BOUND: {', '.join(bound)} would come out negative; intervals are those without the bound"
        )
    if answer.misfit is not None and answer.misfit > LARGEST_MISFIT:
        lines.append(
            f"DOES NOT FIT: the residual is {answer.misfit:.3g} times what noise or rounding explain;"
            " another law, or other walls, density or noise than stated"
        )
    return "\n".join(lines)
