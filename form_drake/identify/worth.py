"""What a weak solution is worth: values with their slopes, noise bias, and what is refused."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from form_drake.identify.problem import Change, Problem, Rows
from form_drake.identify.solve import Unidentifiable
from form_drake.laws.values import LAME
from form_drake.weak.solve import LEAST_ERROR, Solution, Weights, solved
from form_drake.weak.system import WeakSystem
from form_drake.weak.unknowns import Unknowns

LARGEST_NOISE = 0.3  # share of noise in the power of a combination of columns
# what one deviation of a parameter may be: a share of the observed stress, or a logarithm of a
# nonlinear constant; and the part of that above which others are named beside one that is lost
LARGEST_SHARE, LARGEST_LOG = 0.5, 1.0
BESIDE = 0.2
# condition beyond which columns differ by less than what interpolation and quadrature leave of each
ALIKE = 1.0 / LEAST_ERROR
# of the variance of an answer, above which what noise of the columns adds to it is told by more draws,
# and the square of its bias by draws of two sizes
SCATTER, MORE = 0.1, 4


def refuse(problem: Problem, system: WeakSystem, phi: np.ndarray, free: Solution) -> None:
    """Refuse parameters whose deviation contributes as much stress as there is, and alike columns.

    Raises:
        Unidentifiable: naming them.
    """
    unknowns = problem.unknowns
    deviation = np.sqrt(np.diag(free.covariance))
    size = system.scale
    if problem.level == "borne":  # what was borne before is no stress that there is now
        size = np.abs(system.sizes * unknowns.theta(phi)).sum(axis=1)
    level = float(np.sqrt(np.mean(size**2)))
    own = np.sqrt(np.mean((system.sizes @ np.abs(unknowns.M)) ** 2, axis=0))
    worth = np.append(
        deviation[: len(phi)] * own / (LARGEST_SHARE * level), deviation[len(phi) :] / LARGEST_LOG
    )
    alike = free.condition > ALIKE
    if alike or worth.max() > 1.0:
        worth = np.abs(free.weakest) if alike else worth
        keys = (*unknowns.keys, *unknowns.searched)
        lost = [k for k, w in zip(keys, worth, strict=True) if w > BESIDE]
        raise Unidentifiable.of(unknowns.law, _named(unknowns, lost))


def at_bound(problem: Problem, system: WeakSystem, phi: np.ndarray) -> list[str]:
    """Keys of coefficients that must be positive and would not be."""
    held = phi <= 2.0 * problem.floors(system)
    return [k for k, h in zip(problem.unknowns.keys, held, strict=True) if h]


def parameters(
    problem: Problem, phi: np.ndarray, eta: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Keys, values and the derivative of the values by (phi, eta)."""
    unknowns = problem.unknowns
    law = unknowns.law
    touched = np.abs(unknowns.M).sum(axis=1) > 0
    terms = tuple(t.key for t, on in zip(law.terms, touched, strict=True) if on)

    def values(x: np.ndarray) -> np.ndarray:
        theta = unknowns.theta(x[: len(phi)])
        found = list(theta[touched])
        for key, e in zip(unknowns.searched, x[len(phi) :], strict=True):
            r = float(np.exp(e))
            found.append(unknowns.yields(r, theta) if key in law.constants("yield") else r)
        return np.array(found)

    at = np.append(phi, eta)
    slopes = []
    for n in range(len(at)):
        step = np.zeros(len(at))
        step[n] = 1e-6 * max(abs(at[n]), 1e-3)
        slopes.append((values(at + step) - values(at - step)) / (2.0 * step[n]))
    return (*terms, *unknowns.searched), values(at), np.array(slopes).T


def noise_bias(
    problem: Problem, eta: np.ndarray, J: np.ndarray, by: Weights, draws: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """What noise of the size that the data hold adds to (phi, eta) on average, and to its covariance.

    Antithetic pairs: the linear part cancels, errors-in-variables and curvature remain. Added noise
    tells by how much an answer shifts with the variance, and a line or a parabola through the shifts
    of draws of whole and half size leads back to none (simulation and extrapolation: Cook and
    Stefanski, J. Am. Stat. Assoc. 89, 1994). Where the shifts grow ever slower, as where noise
    crosses a yield surface, the line removes too little, and the parabola too much if anything:
    their middle is taken, and their difference is a deviation, unless the line itself is small
    beside the deviation. Of a draw that would fold a body, a share that does not is taken.
    Noise of the columns meets what noise has left of the rows: of first order in either, this
    scatters as well, and counts where columns are hardly larger than their noise.

    Raises:
        Unidentifiable: columns that are noise for the most part.
    """
    rng = np.random.default_rng(seed)
    unknowns = problem.unknowns
    count = len(unknowns.keys)

    def solution(rows: Rows) -> tuple[np.ndarray, Solution]:
        A, b = problem.reduced(*rows)
        return A, solved(np.hstack([A, J[:, count:]]), b, by)

    columns, still = solution(problem.rows(eta))

    def pair(drawn: Sequence[Change], part: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Odd part of the columns and even part of the answer, by size and its square."""
        both = [problem.disturbed(eta, drawn, sign * part) for sign in (1.0, -1.0)]
        found = [solution(rows) for rows in both if rows is not None]
        if len(found) < 2:
            return pair(drawn, 0.5 * part)
        (A, up), (B, down) = found
        return 0.5 * (A - B) / part, (0.5 * (up.theta + down.theta) - still.theta) / part**2, part

    left = by.white(still.residual)
    pairs: list[tuple[Sequence[Change], np.ndarray, float]] = []
    met: list[np.ndarray] = []
    noise = np.zeros((count, count))
    least = SCATTER * np.diag(still.covariance)
    while len(met) < draws or (
        len(met) < MORE * draws and np.any(np.mean(np.square(met), axis=0) > least)
    ):
        drawn = problem.changes([p.drawn(rng) for p in problem.probes])
        change, shift, part = pair(drawn, 1.0)
        noise += change.T @ change
        pairs.append((drawn, shift, part))
        met.append(still.covariance[:, :count] @ (by.white(change).T @ left))
    _refuse_hidden(unknowns, columns, noise / len(met))
    spread = np.mean([np.outer(m, m) for m in met], axis=0)
    line = np.mean([shift for _, shift, _ in pairs], axis=0)
    if not np.any(line**2 > least):
        return line, spread
    bent = []
    for same, far, part in pairs:
        near, half = pair(same, 0.5 * part)[1:]
        bent.append(near + (near - far) * (1.0 + half**2) / (part**2 - half**2))
    apart = np.mean(bent, axis=0) - line
    return line + 0.5 * apart, spread + np.outer(apart, apart)


def _refuse_hidden(unknowns: Unknowns, columns: np.ndarray, noise: np.ndarray) -> None:
    """Refuse a combination of columns that is noise, of this mean square, for the most part."""
    if not len(noise):
        return
    share, directions = eigh(noise, columns.T @ columns)
    if share[-1] > LARGEST_NOISE:
        weight = np.abs(directions[:, -1]) * np.linalg.norm(columns, axis=0)
        lost = [k for k, w in zip(unknowns.keys, weight, strict=True) if w > 0.3 * weight.max()]
        raise Unidentifiable.of(unknowns.law, _named(unknowns, lost), "noise hides them")


def _named(unknowns: Unknowns, keys: Sequence[str]) -> list[str]:
    """Keys of the law's own parameters."""
    own = unknowns.law.keys
    return [n for k in keys for n in ((k,) if k in own else LAME)]
