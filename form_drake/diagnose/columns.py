"""What effects change of a twin: by its motion, or as a difference of simulations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.reading import ProbeReading
from form_drake.effects import Effect, Shape
from form_drake.identify.problem import Problem, Rows
from form_drake.identify.scene import twin_problem
from form_drake.motion import Body
from form_drake.records import Recording
from form_drake.workers import forkable, mapped

SITES = (0.25, 0.75)  # of a body along each axis, where effects are simulated that have a place

Key = tuple[str, tuple[object, ...]]  # of a column: the effect's id, and its shape or site


@dataclass(frozen=True)
class Columns:
    """Columns of effects beside one twin; each is made once.

    Attributes:
        problem: probes of the data.
        twin: the same of the simulation.
        model: that it was simulated with.
        scenes: of the recordings.
        simulated: what effects that are simulated and do not act yet change, by id and shape or place;
            also of other twins of the same scenes, which are near enough to tell what is missing.
    """

    problem: Problem
    twin: Problem
    model: Model
    scenes: Scenes
    simulated: dict[Key, np.ndarray]

    @cached_property
    def readings(self) -> tuple[ProbeReading, ...]:
        """Of the twin: without noise, its columns cannot be explained away by small moduli."""
        return ProbeReading.of(self.twin, self.model.values)

    def lighter(self, twin: Problem) -> "Columns":
        """The same columns; more are made from ``twin``, a copy that has made nothing yet."""
        other = replace(self, twin=twin)
        other.__dict__["_known"] = self._known
        return other

    def of(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        """An effect's columns, in rows of A theta - b, shape [rows, shapes]."""
        self.learn([(effect, shape) for shape in shapes])
        return np.stack([self._column(effect, shape) for shape in shapes], axis=1)

    def learn(self, wanted: Sequence[tuple[Effect, Shape]]) -> None:
        """Make what columns of effects need that is not known yet, on all cores."""
        todo = dict[Key, tuple[Effect, Shape]]()
        for effect, shape in wanted:
            for key, at in self._needs(effect, shape).items():
                if key not in self._store(effect):
                    todo.setdefault(key, (effect, at))
        tasks = sorted(todo.items(), key=lambda one: not one[1][0].trial)
        if any(not effect.trial for _, (effect, _) in tasks):
            assert self.readings  # made once for all copies
        made = mapped(lambda one: self._made(*one[1]), tasks, fork=forkable())
        for (key, (effect, _)), column in zip(tasks, made, strict=True):
            self._store(effect)[key] = column

    def _needs(self, effect: Effect, shape: Shape) -> dict[Key, Shape]:
        """Shapes whose columns make up one: its own, or places from one to the next of which it goes evenly."""
        if not _placed(effect):
            return {(effect.id, tuple(shape.items())): shape}
        sites = around(self.problem.probes[0].body, shape)
        return {(effect.id, corner): there for corner, (there, _) in sites.items()}

    def _column(self, effect: Effect, shape: Shape) -> np.ndarray:
        known = self._store(effect)
        if not _placed(effect):
            return known[effect.id, tuple(shape.items())]
        sites = around(self.problem.probes[0].body, shape)
        parts = [share * known[effect.id, corner] for corner, (_, share) in sites.items()]
        return np.asarray(np.sum(parts, axis=0))

    def _store(self, effect: Effect) -> dict[Key, np.ndarray]:
        """Where its columns are kept: with other twins, or with this one alone."""
        acts = any(c.effect is effect for c in self.model.causes)
        return self.simulated if _placed(effect) or (effect.trial and not acts) else self._known

    @cached_property
    def _known(self) -> dict[Key, np.ndarray]:
        return {}

    def _made(self, effect: Effect, shape: Shape) -> np.ndarray:
        if effect.trial:
            return self._changed(effect, shape)
        assert effect.column is not None
        return np.concatenate([effect.column(reading, shape) for reading in self.readings])

    def _changed(self, effect: Effect, shape: Shape) -> np.ndarray:
        """What a coefficient more of an effect changes of a simulation, in rows of A theta - b."""
        probes = self.problem.probes
        meant = [n for n, p in enumerate(probes) if effect.concerns(p.body)]
        one, other = (
            replace(p, probes=tuple(p.probes[n] for n in meant), offset=None)
            for p in (self.twin, self.problem)
        )
        more = self.model.more(effect, effect.trial, shape)
        other = twin_of(other, self.scenes.rough.only(meant), more)
        eta, theta = self.twin.coordinates(self.model.values)
        change = rest_of(other.rows(eta, theta), theta) - rest_of(one.rows(eta, theta), theta)
        lengths = [int(p.keep.sum()) for p in probes]
        found = np.zeros(sum(lengths))
        found[np.repeat(np.isin(np.arange(len(probes)), meant), lengths)] = change / effect.trial
        return found


def around(body: Body, shape: Shape) -> dict[tuple[int, ...], tuple[Shape, float]]:
    """Eight places in a body, and the shares in which what is felt of a place is that of them.

    They have the radius that was tried first: what is so small is felt as a point.
    """
    size = body.high - body.low
    at = (np.array([shape[k] for k in "xyz"]) - body.low - SITES[0] * size) / size
    part, found = at / (SITES[1] - SITES[0]), dict[tuple[int, ...], tuple[Shape, float]]()
    for corner in np.ndindex(2, 2, 2):
        place = body.low + size * np.take(SITES, corner)
        there = {**dict(zip("xyz", place.tolist(), strict=True)), "radius": shape["radius"]}
        found[corner] = there, float(np.prod(np.where(corner, part, 1.0 - part)))
    return found


def _placed(effect: Effect) -> bool:
    """Whether its columns are simulated at some places and taken evenly between them."""
    return bool(effect.trial) and "radius" in effect.shapes


def twin_of(
    problem: Problem, scenes: Scenes, model: Model, made: Sequence[Recording] | None = None
) -> Problem:
    """A simulation of scenes, unless it is ``made`` already, read as those of a problem."""
    made = scenes.rolled(model) if made is None else made
    return twin_problem(problem, scenes.recordings, lambda _: made, dict(model.values))


def rest_of(rows: Rows, theta: np.ndarray) -> np.ndarray:
    """b - A theta."""
    A, b = rows
    return np.asarray(b - A @ theta)
