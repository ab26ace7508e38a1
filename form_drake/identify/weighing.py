"""Search and weights of a weak balance: rows weighed by the covariance that its own answer gives them."""

import time
from dataclasses import replace

import numpy as np

from form_drake.identify.options import Weighed
from form_drake.identify.problem import Problem
from form_drake.identify.search import searched
from form_drake.weak.solve import Solution, Weights, balanced, weights

PASSES = 3  # of the weights after the first search, fewer where they no longer change
SETTLED = 0.03  # share by which the stress may still change: weights that far off cost some thousandths of the variance
LEANING, STILL = 12, 1e-4  # the same where stretches follow from the ratios of what is sought


def weighing(problem: Problem) -> Weighed:
    """Search, and weigh the rows of a problem."""
    begun = time.perf_counter()
    return Weighed(*_weighted(problem), time.perf_counter() - begun)


def _and(some: list[np.ndarray], others: list[np.ndarray]) -> list[np.ndarray]:
    return [a + b for a, b in zip(some, others, strict=True)]


def _weighted(
    problem: Problem,
) -> tuple[Problem, np.ndarray, Solution, Weights, list[np.ndarray]]:
    """Search and solution, first with rows weighted by size, then by their covariance."""
    coarse = problem.coarser
    middle = np.array([0.5 * np.log(a * z) for a, z in problem.ranges])
    rough = coarse.system(middle)
    sizes = rough.sizes[:, problem.unknowns.columns]
    size = np.mean(sizes / np.sqrt(np.mean(sizes**2, axis=0)), axis=1)
    none = [np.zeros((k, k)) for k in (int(p.keep.sum()) for p in problem.probes)]
    by = weights(none, size / size.max(), 1.0)
    eta = searched(coarse, by)
    solution = coarse.solved(coarse.system(eta), by)
    passes, settled = (LEANING, STILL) if problem.leans else (PASSES, SETTLED)
    for _ in range(passes):
        before, theta = eta, problem.unknowns.theta(solution.theta)
        if problem.leans:
            problem = replace(problem, towards=theta)
        noise = _and(problem.noise(eta, theta), problem.missed)
        system = problem.system(eta, theta)
        by = balanced(noise, system.scale, *problem.reduced(system.A, system.b))
        eta = searched(problem, by, eta)
        solution = problem.solved(problem.system(eta), by)
        change = np.abs(problem.unknowns.theta(solution.theta) - theta)
        moved = np.max(np.abs(eta - before), initial=0.0)
        moved = max(moved, (system.sizes @ change).sum() / (system.sizes @ np.abs(theta)).sum())
        if moved <= settled:
            break
    return problem, eta, solution, by, noise
