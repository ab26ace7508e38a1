"""Data beside a twin: what the rows of one leave over and those of the other do not.

A twin is a simulation of the measured scenes with a model, read as the data are. What reading and
discretisation cost is in both, so that the gap between them is what the model has wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.reading import ProbeReading
from form_drake.effects import Effect, Shape
from form_drake.identify.problem import Problem, Rows
from form_drake.identify.scene import twin_problem
from form_drake.weak.solve import Weights, weights

PAIRS = 4  # of noise draws
PASSES = 6  # of simulations until a twin is nearest to the data, at most
SETTLED = 0.3  # standard deviations that are no change
MOST = np.log(2.0)  # largest change of a modulus in a pass, of its logarithm


@dataclass(frozen=True)
class Match:
    """Data and twin.

    Attributes:
        problem: probes of the data and unknowns of the law.
        twin: the same of the simulation.
        by: inverse covariance of the rows of the data.
        model: that the twin was simulated with.
    """

    problem: Problem
    twin: Problem
    by: Weights
    model: Model

    @classmethod
    def of(cls, problem: Problem, scenes: Scenes, model: Model) -> "Match":
        """Simulate, read, weigh."""
        twin = twin_problem(
            problem, scenes.recordings, lambda _: scenes.rolled(model), dict(model.values)
        )
        probes = tuple(replace(p, fit=p.fit.responding) for p in problem.probes)
        problem = replace(problem, probes=probes)  # what smoothing takes off, it takes off both
        noise = problem.noise(*problem.coordinates(model.values))
        by = weights(noise, np.ones(sum(map(len, noise))), 0.0)
        return cls(problem, twin, by, model)

    @cached_property
    def readings(self) -> tuple[ProbeReading, ...]:
        """Of the twin: without noise, its columns cannot be explained away by small moduli."""
        return ProbeReading.of(self.twin, self.model.values)

    def columns(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        """An effect's columns, whitened, shape [rows, shapes]."""
        found = [
            np.concatenate([effect.column(reading, shape) for reading in self.readings])
            for shape in shapes
        ]
        return self.by.white(np.stack(found, axis=1))

    @cached_property
    def explained(self) -> np.ndarray:
        """Columns of the law's unknowns, and of the causes, whitened, shape [rows, unknowns]."""
        own = self.by.white(self.twin.jacobian(*self.twin.coordinates(self.model.values)))
        return np.hstack([own, *(self.columns(c.effect, [c.shape]) for c in self.model.causes)])

    @cached_property
    def gap(self) -> np.ndarray:
        """Whitened, shape [rows].

        Noise shifts the rows of the data to second order too. By as much it shifts those of the
        twin: that is the mean over pairs of draws of opposite sign.
        """
        eta, theta = self.twin.coordinates(self.model.values)
        data, own = (_rest(p.rows(eta, theta), theta) for p in (self.problem, self.twin))
        shift, count, rng = np.zeros(len(own)), 0, np.random.default_rng(0)
        for _ in range(PAIRS):
            drawn = [probe.drawn(rng) for probe in self.problem.probes]
            made = [self.twin.coarser.disturbed(eta, drawn, share) for share in (0.0, 1.0, -1.0)]
            still, *both = (_rest(one, theta) for one in made if one is not None)
            if len(both) == 2:
                shift += np.mean(both, axis=0) - still
                count += 1
        return self.by.white(data - own - shift / max(count, 1))

    @cached_property
    def basis(self) -> np.ndarray:
        """Orthonormal, of what law and causes explain, shape [rows, unknowns]."""
        return np.asarray(np.linalg.qr(self.explained)[0])

    @cached_property
    def left(self) -> np.ndarray:
        """What they leave of the gap, whitened, shape [rows]."""
        return self.off(self.gap)

    def off(self, a: np.ndarray) -> np.ndarray:
        """What they leave of whitened columns."""
        return np.asarray(a - self.basis @ (self.basis.T @ a))

    @cached_property
    def _solved(self) -> tuple[np.ndarray, np.ndarray]:
        """Change of the unknowns that closes the gap, and its standard deviation."""
        length = np.linalg.norm(self.explained, axis=0)
        inverse = np.linalg.pinv(self.explained / length)
        return inverse @ self.gap / length, np.linalg.norm(inverse, axis=1) / length

    @property
    def change(self) -> np.ndarray:
        """Of the unknowns that closes the gap: the law's, nonlinear ones last, then the causes'."""
        return self._solved[0]

    @property
    def std(self) -> np.ndarray:
        """Of the unknowns."""
        return self._solved[1]

    @property
    def settled(self) -> bool:
        """Whether no unknown would change by more than a share of its standard deviation."""
        return bool(np.all(np.abs(self.change) < SETTLED * self.std))

    @property
    def told(self) -> Model:
        """The model, its causes with their standard deviations."""
        causes = self.model.causes
        more = self.std[len(self.std) - len(causes) :]
        sure = tuple(replace(c, std=float(s)) for c, s in zip(causes, more, strict=True))
        return replace(self.model, causes=sure)

    def next(self) -> Model:
        """The model that closes the gap to first order; moduli change by a factor of two at most."""
        unknowns, model = self.problem.unknowns, self.model
        eta, theta = self.twin.coordinates(model.values)
        phi = np.array([model.values[k] for k in unknowns.keys])
        own, more = np.split(self.change, [len(phi) + len(eta)])
        step = np.clip(own[: len(phi)] / np.abs(phi), np.exp(-MOST) - 1.0, np.exp(MOST) - 1.0)
        eta = eta + np.clip(own[len(phi) :], -MOST, MOST)
        theta = unknowns.theta(phi + step * np.abs(phi))
        values = {**model.values, **self.problem.values(eta)}
        values |= {t.key: float(v) for t, v in zip(unknowns.law.terms, theta, strict=True)}
        sizes = [c.coefficient + float(d) for c, d in zip(model.causes, more, strict=True)]
        sizes = [
            size if c.effect.signed or size > 0.0 else 0.5 * c.coefficient
            for c, size in zip(model.causes, sizes, strict=True)
        ]
        return model.moved(values, sizes)


def matched(problem: Problem, scenes: Scenes, start: Model) -> Match:
    """The twin nearest to the data (Gauss-Newton)."""
    found = Match.of(problem, scenes, start)
    for _ in range(PASSES - 1):
        if found.settled:
            break
        found = Match.of(problem, scenes, found.next())
    return found


def _rest(rows: Rows, theta: np.ndarray) -> np.ndarray:
    A, b = rows
    return np.asarray(b - A @ theta)
