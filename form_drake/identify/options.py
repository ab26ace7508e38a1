"""How the weak form is set up, and what it leaves for others to read."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from form_drake.identify.problem import Level, Problem
from form_drake.motion import Body, Fit
from form_drake.weak.fields import Fields
from form_drake.weak.solve import Solution, Weights
from form_drake.weak.system import WeakSystem
from form_drake.weak.unknowns import Pressure

Estimator = Literal["gls", "ols"]
Reader = Callable[..., tuple[Body, Fit]]  # (recording, symmetric) -> its body and motion


@dataclass(frozen=True)
class WeakOptions:
    """How the weak form is set up.

    Attributes:
        fields: names of families of test fields, or the families themselves, see
            ``form_drake.weak.choice``; empty: chosen from the faces of the body.
        window: width of the windows [s]; None: chosen from the frames and the law.
        ends: first and last moment of every window, counted from the first frame [s]; empty: they
            are spread evenly.
        pressure: who balances pressure, see ``Unknowns.of``; None: chosen from the motion.
        free: material axes (0, 1, 2) along which the body is too thin to bear stress, one for plane
            stress, two for a fibre, see ``form_drake.weak.release``; None: those across a bent strip.
        estimator: ``gls``, or ``ols`` for ordinary least squares as in the paper.
        draws: pairs of noise draws for the errors-in-variables correction; 0: none.
        seed: of the draws.
        level: what the model error of a row is a share of, see ``Problem``.
    """

    fields: tuple[str | Fields, ...] = ()
    window: float | None = None
    ends: tuple[tuple[float, float], ...] = ()
    pressure: Pressure | None = None
    free: tuple[int, ...] | None = None
    estimator: Estimator = "gls"
    draws: int = 4
    seed: int = 0
    level: Level = "borne"


@dataclass(frozen=True)
class WeakFit:
    """Everything a report needs beside the answer.

    Attributes:
        problem: probes and unknowns.
        system: rows at the solution.
        theta: coefficients of all terms.
        residual: b - A theta [N m s], shape [rows].
        noise: standard deviation of each row's noise [N m s], shape [rows].
        error: model error as a share of each row's size.
        bias: what the errors-in-variables correction took off each value.
    """

    problem: Problem
    system: WeakSystem
    theta: np.ndarray
    residual: np.ndarray
    noise: np.ndarray
    error: float
    bias: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Weighed:
    """A problem, and the weights of its rows: all that does not depend on the estimator.

    Attributes:
        problem: probes and unknowns.
        eta: logarithms of the nonlinear constants by generalised least squares.
        solution: of the linear coefficients.
        by: weights.
        noise: covariance of each probe's rows [(N m s)^2].
        seconds: that it took [s].
    """

    problem: Problem
    eta: np.ndarray
    solution: Solution
    by: Weights
    noise: list[np.ndarray]
    seconds: float
