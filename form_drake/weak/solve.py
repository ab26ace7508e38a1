"""Generalised least squares with a model error, and what the rows cannot tell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, lsq_linear
from scipy.sparse import csr_array

from form_drake.weak.system import WeakSystem

Blocks = Sequence[np.ndarray]
TINY = 1e-100  # length of a column that holds nothing
CLOSE = 4e-3  # of a model error, relatively
LEAST_ERROR = 1e-7  # of a row's size: what interpolation and quadrature always leave


def lessened(a: np.ndarray, lines: np.ndarray | csr_array, sizes: np.ndarray) -> np.ndarray:
    """Rows of unit covariance, made so again beside errors of such sizes along orthonormal lines.

    Args:
        a: shape [rows] or [rows, columns].
        lines: shape [rows, errors].
        sizes: standard deviations, shape [errors].
    """
    share = 1.0 / np.hypot(1.0, sizes) - 1.0  # (I + U s^2 U^T)^(-1/2) = I + U share U^T
    return np.asarray(a + (lines * share) @ (lines.T @ a))


@dataclass(frozen=True)
class Weights:
    """Inverse covariance of the rows, and the model error in it.

    Attributes:
        factors: Cholesky factors L of the covariance of each probe's rows, probes being independent.
        error: model error as a share of the size of each row.
        shared: errors e that all rows of a probe share beside it, of one standard deviation, shape
            [rows, errors]: the covariance is L L^T + sum e e^T. None: there are none.
    """

    factors: tuple[np.ndarray, ...]
    error: float
    shared: np.ndarray | None = None

    @cached_property
    def _ends(self) -> list[int]:
        return np.cumsum(list(map(len, self.factors)))[:-1].tolist()

    def of(self, probe: int) -> "Weights":
        """Those of one probe's rows."""
        return Weights((self.factors[probe],), self.error, self._errors[probe])

    def white(self, a: np.ndarray) -> np.ndarray:
        """a in units of the standard deviation of independent rows."""
        pairs = zip(self.factors, np.split(a, self._ends), self._lines, strict=True)
        found = []
        for factor, part, (lines, sizes) in pairs:
            found.append(lessened(solve_triangular(factor, part, lower=True), lines, sizes))
        return np.concatenate(found)

    def coloured(self, a: np.ndarray) -> np.ndarray:
        """The rows that are white as ``a``."""
        pairs = zip(self.factors, np.split(a, self._ends), self._lines, strict=True)
        found = []
        for factor, white, (lines, sizes) in pairs:
            share = np.hypot(1.0, sizes) - 1.0
            found.append(factor @ (white + (lines * share) @ (lines.T @ white)))
        return np.concatenate(found)

    @property
    def _errors(self) -> list[np.ndarray]:
        """Those of each probe that it has, shape [rows, errors]."""
        if self.shared is None:
            return [np.zeros((len(factor), 0)) for factor in self.factors]
        parts = np.split(self.shared, self._ends)
        return [part[:, part.any(axis=0)] for part in parts]

    @cached_property
    def _lines(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Principal directions and sizes of the whitened errors of each probe."""
        pairs = zip(self.factors, self._errors, strict=True)
        return [
            np.linalg.svd(solve_triangular(L, e, lower=True), full_matrices=False)[:2]
            for L, e in pairs
        ]

    def covariance(self, rows: np.ndarray) -> np.ndarray:
        """Of some rows of a single probe."""
        own, errors = self.factors[0][rows], self._errors[0][rows]
        return np.asarray(own @ own.T + errors @ errors.T)

    @property
    def sizes(self) -> np.ndarray:
        """Standard deviations of the rows."""
        pairs = zip(self.factors, self._errors, strict=True)
        squares = [np.sum(L**2, axis=1) + np.sum(e**2, axis=1) for L, e in pairs]
        return np.asarray(np.sqrt(np.concatenate(squares)))

    def beside(self, errors: np.ndarray) -> "Weights":
        """With more errors that all rows of a probe share, of one standard deviation, shape [rows, errors]."""
        before = np.zeros((len(errors), 0)) if self.shared is None else self.shared
        return replace(self, shared=np.hstack([before, errors]))


@dataclass(frozen=True)
class Solution:
    """Solution of A theta = b.

    Attributes:
        theta: shape [columns].
        covariance: shape [columns, columns].
        residual: b - A theta [N m s], shape [rows].
        condition: of the whitened columns scaled to unit length.
        effective: number of independent equations that the rows amount to.
        weakest: combination of those columns that is nearest to nothing, shape [columns].
    """

    theta: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    condition: float
    effective: float
    weakest: np.ndarray


def weights(noise: Blocks, scale: np.ndarray, error: float) -> Weights:
    """Weights for rows with noise and a model error.

    Args:
        noise: covariance of each probe's rows [(N m s)^2].
        scale: size of each row [N m s].
        error: model error as a share of the size.
    """
    share = max(error, LEAST_ERROR)
    factors = (np.linalg.cholesky(block) for block in totals(noise, scale, share))
    return Weights(tuple(factors), share)


def totals(noise: Blocks, scale: np.ndarray, error: float) -> list[np.ndarray]:
    """Covariance of noise and model error together, probe by probe."""
    own = np.split((error * scale) ** 2, np.cumsum([len(n) for n in noise])[:-1])
    return [n + np.diag(o) for n, o in zip(noise, own, strict=True)]


def balanced(noise: Blocks, scale: np.ndarray, A: np.ndarray, b: np.ndarray) -> Weights:
    """Weights whose model error makes the residual as large as its covariance says.

    Zero where the noise alone explains the residual.
    """

    @cache
    def excess(log_error: float) -> float:
        found = weights(noise, scale, float(np.exp(log_error)))
        r = found.white(b - A @ solved(A, b, found).theta)
        return float(np.log(max(r @ r, TINY) / max(len(b) - A.shape[1], 1)))

    least, most = float(np.log(LEAST_ERROR)), 0.0
    if excess(least) <= 0.0:
        return weights(noise, scale, 0.0)
    if excess(most) > 0.0:
        return weights(noise, scale, 1.0)
    error = np.exp(brentq(excess, least, most, xtol=CLOSE))
    return weights(noise, scale, float(error))


def solved(A: np.ndarray, b: np.ndarray, by: Weights) -> Solution:
    """Generalised least squares with the given weights; of fewer rows than columns, of no condition."""
    if not A.shape[1]:  # nonlinear constants alone are sought
        none = np.zeros(0)
        return Solution(none, np.zeros((0, 0)), b, 1.0, float(len(b)), none)
    white, target = by.white(A), by.white(b)
    length = np.linalg.norm(white, axis=0)
    safe = np.where(length > TINY, length, 1.0)
    rows, columns = white.shape
    U, s, Vt = np.linalg.svd(white / safe, full_matrices=rows < columns)
    lost = max(columns - rows, 0)
    U, s = np.pad(U, ((0, 0), (0, lost))), np.pad(s, (0, lost))
    s = np.maximum(s, 1e-12 * max(s[0], TINY))
    theta = (Vt.T @ ((U.T @ target) / s)) / safe
    covariance = (Vt.T / s**2) @ Vt / np.outer(safe, safe)
    return Solution(theta, covariance, b - A @ theta, float(s[0] / s[-1]), _effective(U), Vt[-1])


def _effective(U: np.ndarray) -> float:
    """Rows that carry the answer: inverse participation of the projection on the columns."""
    share = np.sum(U**2, axis=1) / U.shape[1]
    return float(1.0 / np.sum(share**2))


def ordinary(A: np.ndarray, b: np.ndarray, covariance: Blocks) -> Solution:
    """Ordinary least squares, with the covariance that the noise of the rows gives it."""
    found = solved(A, b, Weights(tuple(np.eye(len(n)) for n in covariance), 0.0))
    parts = np.split(np.linalg.pinv(A), np.cumsum([len(n) for n in covariance])[:-1], axis=1)
    own = sum(p @ n @ p.T for p, n in zip(parts, covariance, strict=True))
    return replace(found, covariance=np.asarray(own))


def gains(A: np.ndarray, by: Weights) -> list[np.ndarray]:
    """How a solution follows the rows of each probe, shape [columns, rows].

    Args:
        A: columns, shape [rows, columns].
        by: weights of the rows.
    """
    back = np.linalg.pinv(by.white(A))
    ends = np.cumsum([len(f) for f in by.factors])[:-1]
    return np.split(back @ by.white(np.eye(len(A))), ends, axis=1)


def passed_on(gain: Blocks, errors: Blocks) -> np.ndarray:
    """Covariance of a solution from errors by which its rows were not weighed.

    Args:
        gain: how it follows the rows of each probe, see ``gains``.
        errors: covariance of these rows [(N m s)^2].
    """
    return np.asarray(sum(g @ e @ g.T for g, e in zip(gain, errors, strict=True)))


def throughout(
    system: WeakSystem, theta: np.ndarray, error: float, counts: Sequence[int]
) -> list[np.ndarray]:
    """Covariance of each probe's rows from errors that last [(N m s)^2], one of every test field.

    Args:
        system: the rows.
        theta: coefficients, with whose stress an error changes sign.
        error: share of the sizes of the rows.
        counts: rows of each probe.
    """
    size = error * system.scale * np.sign(system.A @ theta)
    fields = np.array([row.field for row in system.rows])
    ends = np.cumsum(counts)[:-1]
    return [
        np.where(own[:, None] == own, np.outer(part, part), 0.0)
        for own, part in zip(np.split(fields, ends), np.split(size, ends), strict=True)
    ]


def bounded(A: np.ndarray, b: np.ndarray, by: Weights, floors: np.ndarray) -> Solution:
    """``solved`` with theta >= floors; a coefficient at its floor keeps the free covariance."""
    free = solved(A, b, by)
    if np.all(free.theta >= floors):
        return free
    white, target = by.white(A), by.white(b)
    length = np.maximum(np.linalg.norm(white, axis=0), 1e-300)
    limits = (floors * length, np.full(len(floors), np.inf))
    theta = lsq_linear(white / length, target, bounds=limits, method="bvls").x / length
    return replace(free, theta=theta, residual=b - A @ theta)
