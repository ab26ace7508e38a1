"""The twin offset: what reading a motion does to its rows, taken from a rollout read the same way.

A twin is a rollout of the same scene at the identified parameters theta_0. It is sampled and fitted
exactly as the data are. Its rows b - A theta_0 are not zero: that residual r is interpolation,
discretisation and whatever else the reading costs, and no material. It is put into the columns,

    A'_k = A_k + r s_k / theta_0k,    s_k = |theta_0k| size_k / sum_j |theta_0j| size_j,

so that the twin's own rows hold at theta_0. In the columns, not in b, because it follows the stress:
it grows with the moduli as the columns do. The shares go by the sizes of the integrals, which are
positive, and not by the integrals themselves, which may cancel. At the fixed point the shares do not
matter, since there A' theta_0 = A theta_0 + r whatever they are.

The cure is as good as the twin: what the simulator of the scene itself has wrong stays.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from form_drake.identify.led import Led, LedOptions
from form_drake.identify.solve import require_given
from form_drake.laws import Law
from form_drake.records import Recording
from form_drake.weak.system import Row, WeakSystem

PASSES = 12  # of carrying and solving, at most
SETTLED = 1e-4  # largest relative change of a parameter between passes that counts as none
MEMORY = 3  # passes from which the next point is extrapolated
MOST_MIXED = 5.0  # times the last change, as which an extrapolation may move
TWINS = 2
SCAN = np.geomspace(1.0 / 30.0, 30.0, 13)  # of the yield constant about its start
DIFFERENCE = 3e-3  # of the logarithm of the yield constant
LARGEST_STEP = 0.4  # of the same

Values = dict[str, float]
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Offset:
    """What is added to the columns, row by row.

    Attributes:
        share: shape [rows, terms] [N m s per unit].
        rows: labels of the rows.
    """

    share: np.ndarray
    rows: tuple[Row, ...]

    @classmethod
    def of(cls, twin: WeakSystem, theta: np.ndarray) -> "Offset":
        """The offset of a twin's rows at the coefficients that it was rolled with.

        Coefficients that are zero receive nothing.
        """
        acting = np.abs(theta) * twin.sizes
        total = np.maximum(acting.sum(axis=1, keepdims=True), 1e-300)
        shares = np.where(theta == 0.0, 0.0, acting / total / np.where(theta == 0.0, 1.0, theta))
        return cls((twin.b - twin.A @ theta)[:, None] * shares, twin.rows)

    def applied(self, system: WeakSystem) -> WeakSystem:
        """The rows that the twin has too, with corrected columns."""
        where = {row: n for n, row in enumerate(self.rows)}
        own = np.array([n for n, row in enumerate(system.rows) if row in where], dtype=int)
        rows = tuple(system.rows[n] for n in own)
        share = self.share[[where[row] for row in rows]]
        return WeakSystem(
            system.A[own] + share,
            system.b[own],
            system.scale[own],
            system.sizes[own],
            rows,
        )


def with_twins(
    first: Answer,
    twin: Callable[[Answer], Offset],
    fit: Callable[[Offset, Answer], Answer],
    count: int = TWINS,
) -> list[Answer]:
    """The answer without a twin, then with one twin after the other.

    Args:
        first: without a twin.
        twin: the offset of a twin rolled with an answer.
        fit: the answer of the data's rows with an offset, started at an answer.
        count: of twins; each is rolled with the answer before it.
    """
    answers = [first]
    for _ in range(count):
        answers.append(fit(twin(answers[-1]), answers[-1]))
    return answers


@dataclass(frozen=True)
class TwinFit:
    """Answers of ``identify_led``.

    Attributes:
        answers: parameter values, without a twin first, then after each twin.
        residual: root mean square of b - A theta as a share of that of b, for every answer.
        rows: number of rows in the last fit.
        passes: carrying and solving, in all.
    """

    answers: tuple[Values, ...]
    residual: tuple[float, ...]
    rows: int
    passes: int


def identify_led(
    recording: Recording,
    law: Law,
    start: Mapping[str, float],
    options: LedOptions | None = None,
    twins: int = TWINS,
) -> TwinFit:
    """Identify a law from positions by the weak form, without and with the twin offset.

    Ordinary least squares. A yield constant is searched about the linear solve, as the bound on the
    elastic strain, from the residual of the balance.

    Args:
        recording: positions of a motion whose solver is stated; its states are not read.
        law: elastic, fluid or plastic; of constants it may have one of yield.
        start: values of all parameters.
        options: of the rows.
        twins: number of twins.

    Raises:
        ValueError: the recording or the law is not as needed.
    """
    if law.constants("shape", "given"):
        raise ValueError(f"{law.name} has constants beside a yield: a led fit does not search them")
    require_given(law.name, [k for k in law.keys if k not in start])
    data = Led(replace(recording, states=None), law, options or LedOptions())
    fit = _Fit(data, law)

    def twin(values: Values) -> Offset:
        return Offset.of(data.rolled(values).system(values), law.theta(values))

    answers = with_twins(fit(None, dict(start)), twin, fit, twins)
    return TwinFit(tuple(answers), tuple(fit.residuals), fit.rows, fit.passes)


class _Fit:
    """Carry and solve until the parameters settle."""

    def __init__(self, data: Led, law: Law):
        self.data, self.law = data, law
        self.bound = next(iter(law.constants("yield")), None)
        self.residuals: list[float] = []
        self.rows = self.passes = 0

    def __call__(self, offset: Offset | None, start: Values) -> Values:
        values = dict(start)
        if self.bound is not None and offset is None:
            values = self._scanned(values)
        keys, point = tuple(values), np.array(list(values.values()))
        points, images = [], []
        for _ in range(PASSES):
            found, left = self._pass(dict(zip(keys, point.tolist(), strict=True)), offset)
            self.passes += 1
            points.append(point)
            images.append(np.array([found[k] for k in keys]))
            if np.max(np.abs(images[-1] / point - 1.0)) < SETTLED:
                break
            point = _mixed(np.array(points[-MEMORY:]), np.array(images[-MEMORY:]))
        self.residuals.append(left)
        return dict(zip(keys, images[-1].tolist(), strict=True))

    def _system(self, values: Values, offset: Offset | None) -> WeakSystem:
        system = self.data.system(values)
        return system if offset is None else offset.applied(system)

    def _bounded(self, values: Values, change: float) -> Values:
        """Values whose bound on the elastic strain is exp(change) times as large."""
        assert self.bound is not None
        return {**values, self.bound: values[self.bound] * float(np.exp(change))}

    def _scanned(self, values: Values) -> Values:
        """The yield constant whose rows leave the least residual, on a wide scan."""
        trials = [self._bounded(values, float(np.log(s))) for s in SCAN]
        left = [_solved(s.A, s.b)[1] for s in (self._system(t, None) for t in trials)]
        return trials[int(np.argmin(left))]

    def _pass(self, values: Values, offset: Offset | None) -> tuple[Values, float]:
        """Terms, and a step of the yield constant, from rows carried with ``values``."""
        system = self._system(values, offset)
        self.rows = len(system.b)
        if self.rows <= len(self.law.keys):
            raise ValueError(
                f"{self.rows} rows for {', '.join(self.law.keys)}: a wall meets nearly every test in"
                " every window; take shorter windows or narrower tests"
            )
        theta, left = _solved(system.A, system.b)
        change = 0.0
        if self.bound is not None:
            moved = self._system(self._bounded(values, DIFFERENCE), offset)
            slope = (moved.A - system.A) @ theta / DIFFERENCE
            both, left = _solved(np.column_stack([system.A, slope]), system.b)
            theta, change = both[:-1], float(np.clip(both[-1], -LARGEST_STEP, LARGEST_STEP))
        found = {
            t.key: float(c) if t.signed or c > 0.0 else 0.5 * values[t.key]
            for t, c in zip(self.law.terms, theta, strict=True)
        }
        if self.bound is not None:
            radius = self.law.radius_vector(values)[0] * np.exp(change)
            unit = self.law.radius_vector({**found, self.bound: 1.0})[0]
            found[self.bound] = float(radius / unit)
        return found, left


def _mixed(points: np.ndarray, images: np.ndarray) -> np.ndarray:
    """The next point of a search for the point that a pass does not change (Anderson's mixing).

    Args:
        points: where the last passes started, shape [passes, parameters].
        images: where they ended.
    """
    last = images[-1]
    change = (images - points) / last
    gaps = (change[:-1] - change[-1]).T
    share = np.linalg.lstsq(gaps, -change[-1], rcond=1e-3)[0]
    mixed = last + share @ (images[:-1] - last)
    far = np.max(np.abs(mixed / last - 1.0)) > max(MOST_MIXED * np.max(np.abs(change[-1])), 1e-3)
    return last if far else mixed


def _solved(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, float]:
    """Ordinary least squares, and the norm of the residual as a share of that of b."""
    length = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    theta = np.linalg.lstsq(A / length, b, rcond=None)[0] / length
    return theta, float(np.linalg.norm(b - A @ theta) / np.linalg.norm(b))
