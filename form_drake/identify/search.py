"""Variable projection: a search over nonlinear constants around the linear weak solve."""

from itertools import product

import numpy as np
from scipy.optimize import least_squares

from form_drake.identify.problem import Problem
from form_drake.weak.solve import Solution, Weights, bounded

GRID = 17  # values in the scan of one nonlinear constant
FEW = 4  # of each, where there are several
ROUNDS, HALVINGS = 12, 8  # of steps, and of one step
LONGEST = 0.7  # step of a logarithm
CLOSE = 1e-4  # the last one
NOTHING = 1e-12  # share of the residual's square, below which a step promises nothing
MOST = 60  # evaluations for several constants


def searched(problem: Problem, by: Weights, start: np.ndarray | None = None) -> np.ndarray:
    """The logarithms of the nonlinear constants that leave the least residual.

    Gauss-Newton steps of the projected residual (Kaufman, "A variable projection method for solving
    separable nonlinear least squares problems", 1975), whose slopes are those of the coarser problem.

    Args:
        problem: whose rows.
        by: weights of the rows.
        start: where the search starts; None: at the best of a coarse scan.

    Raises:
        ValueError: no value gives a finite stress.
    """
    if not problem.ranges:
        return np.zeros(0)
    eta = _scanned(problem.coarser, by) if start is None else start
    if len(eta) == 1:
        return _stepped(problem, by, eta)
    low, high = np.log(np.array(problem.ranges)).T
    inside = np.clip(eta, low + CLOSE, high - CLOSE)
    if not _jacobian(problem, by, inside).any():  # nothing to follow
        return np.asarray(inside)
    found = least_squares(
        lambda e: _residual(problem, by, e),
        inside,
        jac=lambda e: _jacobian(problem, by, e),
        bounds=(low, high),
        xtol=0.1 * CLOSE,
        ftol=None,
        gtol=None,
        max_nfev=MOST,
    )
    return np.asarray(found.x)


def _stepped(problem: Problem, by: Weights, eta: np.ndarray) -> np.ndarray:
    """One constant by steps that are halved until they lessen the residual."""
    (low,), (high,) = np.log(np.array(problem.ranges)).T
    residual = _residual(problem, by, eta)
    for _ in range(ROUNDS):
        slope = _jacobian(problem, by, eta)[:, 0]
        steep, left = float(slope @ slope), float(residual @ residual)
        step = -float(slope @ residual) / steep if steep > 0.0 else 0.0
        new = np.clip(eta + np.clip(step, -LONGEST, LONGEST), low, high)
        if np.abs(new - eta).max() < CLOSE:
            return np.asarray(new)
        if steep * step**2 < NOTHING * left:
            return eta
        for _ in range(HALVINGS):
            residual = _residual(problem, by, new)
            if residual @ residual < left:
                break
            new = 0.5 * (eta + new)
        else:
            return eta
        eta = new
    return eta


def _scanned(problem: Problem, by: Weights) -> np.ndarray:
    """The best of some values of the nonlinear constants."""
    count = GRID if len(problem.ranges) == 1 else FEW
    sides = [np.linspace(np.log(a), np.log(z), count + 2)[1:-1] for a, z in problem.ranges]
    tried = [np.array(p) for p in product(*sides)]
    left = [float(np.sum(_residual(problem, by, eta) ** 2)) for eta in tried]
    if not np.isfinite(left).any():
        spans = zip(problem.unknowns.searched, problem.ranges, strict=True)
        where = " and ".join(f"{k} in [{a:.3g}, {z:.3g}]" for k, (a, z) in spans)
        raise ValueError(f"no value of {where} gives a finite stress")
    return tried[int(np.argmin(left))]


def _solved(problem: Problem, by: Weights, eta: np.ndarray) -> tuple[Solution, np.ndarray]:
    """Solution at exp(eta), and which coefficients are off the bound of their sign."""
    signed = {t.key for t in problem.unknowns.law.terms if t.signed}
    least = np.where([k in signed for k in problem.unknowns.keys], -np.inf, 0.0)
    found = bounded(*problem.reduced(*problem.rows(eta)), by, least)
    return found, found.theta > least


def _residual(problem: Problem, by: Weights, eta: np.ndarray) -> np.ndarray:
    """White residual of the linear solution; infinite where the stress is not finite."""
    A, b = problem.rows(eta)
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        return np.full(len(b), np.inf)
    return by.white(_solved(problem, by, eta)[0].residual)


def _jacobian(problem: Problem, by: Weights, eta: np.ndarray) -> np.ndarray:
    """Derivative of ``_residual``, that of the projection left out."""
    found, free = _solved(problem, by, eta)
    theta = problem.unknowns.theta(found.theta)
    A = by.white(problem.reduced(*problem.rows(eta))[0][:, free])
    S = by.white(problem.coarser.slopes(eta, theta, released=False))
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    U = U[:, s > 1e-12 * s.max(initial=0.0)]
    return np.asarray(U @ (U.T @ S) - S)
