"""What effects change of a twin: by its motion, or as a difference of simulations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.reading import ProbeReading
from form_drake.effects import Effect, Shape
from form_drake.effects.acting import failure
from form_drake.identify.problem import Problem, Rows
from form_drake.identify.scene import twin_problem
from form_drake.laws import ADDITIONS
from form_drake.motion import Body
from form_drake.records import Recording
from form_drake.workers import forkable, mapped

SITES = (0.2, 0.5, 0.8)  # of a body along each axis, where effects are simulated that have a place
CHANGE = 0.1  # of the size of what acts as a whole, in differences

Key = tuple[str, tuple[object, ...]]  # of a column: the effect's id, and its shape or site
Parts = tuple[dict[Key, Shape], np.ndarray]


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
        self.learn([(effect, shapes)])
        known, (sites, shares) = self._store(effect), self._parts(effect, shapes)
        return np.stack([known[key] for key in sites], axis=1) @ shares

    def learn(self, wanted: Sequence[tuple[Effect, Sequence[Shape]]]) -> None:
        """Make what columns of effects need that is not known yet, on all cores."""
        todo = {
            key: (effect, at)
            for effect, shapes in wanted
            for key, at in self._parts(effect, shapes)[0].items()
            if key not in self._store(effect)
        }
        tasks = sorted(todo.items(), key=lambda one: not self._simulates(*one[1]))
        seen = [effect.id for _, (effect, at) in tasks if not self._simulates(effect, at)]
        if seen:
            self.readings[0].ready(seen)  # made once for all copies, as the readings are
        made = mapped(lambda one: self._made(*one[1]), tasks, fork=forkable())
        for (key, (effect, _)), column in zip(tasks, made, strict=True):
            self._store(effect)[key] = column

    def _parts(self, effect: Effect, shapes: Sequence[Shape]) -> Parts:
        return parts(effect, shapes, self.problem.probes[0].body, placed=self._placed(effect))

    def _store(self, effect: Effect) -> dict[Key, np.ndarray]:
        """Where its columns are kept: with other twins, or with this one alone."""
        others = effect.trial and not self._acting(effect)
        return self.simulated if self._placed(effect) or others else self._known

    def _placed(self, effect: Effect) -> bool:
        """Whether its columns are simulated at some places and taken evenly between them."""
        here = not (effect.whole and self._acting(effect))
        return bool(effect.trial) and "radius" in effect.shapes and here

    def _acting(self, effect: Effect) -> list[Cause]:
        return [c for c in self.model.causes if c.effect is effect]

    def _simulates(self, effect: Effect, shape: Shape) -> bool:
        """Whether a column is a difference of simulations, in which a law has an addition once."""
        own = [dict(c.shape) for c in self._acting(effect)]
        once = effect.id in ADDITIONS and any(one != dict(shape) for one in own)
        return bool(effect.trial) and not once

    @cached_property
    def _known(self) -> dict[Key, np.ndarray]:
        return {}

    def _made(self, effect: Effect, shape: Shape) -> np.ndarray:
        if self._simulates(effect, shape):
            return self._changed(effect, shape)
        found = np.concatenate([_read(effect, reading, shape) for reading in self.readings])
        return found / self.model.shown if effect.compounds else found

    def _changed(self, effect: Effect, shape: Shape) -> np.ndarray:
        """What a coefficient more of an effect changes of a simulation, in rows of A theta - b."""
        meant = [n for n, p in enumerate(self.problem.probes) if effect.concerns(p.body)]
        size, model = self._more(effect, shape)
        return changed(self.problem, self.twin, self.scenes.rough, model, meant) / size

    def rests(self, models: Sequence[Model]) -> np.ndarray:
        """What laws leave of twins of these models less what is left here, shape [rows, models]."""
        rough, found = self.scenes.rough, []
        for model, made in zip(models, rough.every(models), strict=True):
            found.append(_left(twin_of(self.problem, rough, model, made), model))
        here = _left(self.twin, self.model)[:, None]
        return np.stack(found, axis=1) - here if found else np.zeros((len(here), 0))

    def _more(self, effect: Effect, shape: Shape) -> tuple[float, Model]:
        """A coefficient, and the model with so much more of an effect.

        What need not add up, if it acts, takes another shape as a whole.
        """
        size = 0.0
        for cause in self._acting(effect) if effect.whole else ():
            if dict(cause.shape) != dict(shape) and cause.coefficient != 0.0:
                others = self.model.without(cause)
                return cause.coefficient, others.more(effect, cause.coefficient, shape)
            size = CHANGE * abs(cause.coefficient)
        size = max(size, self.model.trial(effect, self.problem.probes[0].body), key=abs)
        return size, self.model.more(effect, size, shape)


def _left(twin: Problem, model: Model) -> np.ndarray:
    eta, theta = twin.coordinates(model.values)
    return rest_of(twin.rows(eta, theta), theta)


def _read(effect: Effect, reading: ProbeReading, shape: Shape) -> np.ndarray:
    """An effect's column along one motion, shape [rows].

    Raises:
        ValueError: it fails, as one that a user declares may, or is no column.
    """
    assert effect.column is not None
    try:
        found = np.asarray(effect.column(reading, shape), dtype=float)
    except Exception as error:
        raise failure(effect, error) from error
    rows = (int(reading.probe.keep.sum()),)
    if found.shape != rows:
        raise ValueError(f"effect {effect.id}: a column of shape {found.shape}, wanted {rows}")
    if not np.isfinite(found).all():
        raise ValueError(f"effect {effect.id}: its column is not finite")
    return found


def parts(effect: Effect, shapes: Sequence[Shape], body: Body, *, placed: bool) -> Parts:
    """Shapes whose columns add up to those of others, by key, and their shares, shape [these, shapes].

    They are those that the effect states, or places, or themselves.

    Args:
        effect: with its shape parameters.
        shapes: values of these.
        body: of the first probe.
        placed: whether columns of an effect with a place are made at some, and go evenly between.
    """
    if placed and "radius" in effect.shapes:
        return _around(effect, shapes, body)
    try:
        own, shares = effect.parts(shapes) if effect.parts else (shapes, np.eye(len(shapes)))
    except Exception as error:
        raise failure(effect, error) from error
    keys: list[Key] = [(effect.id, tuple(one.items())) for one in own]
    sites = dict(zip(keys, own, strict=True))  # a shape may be asked for twice
    order = {key: n for n, key in enumerate(sites)}
    found = np.zeros((len(sites), len(shapes)))
    np.add.at(found, [order[key] for key in keys], shares)
    return sites, found


def _around(effect: Effect, shapes: Sequence[Shape], body: Body) -> Parts:
    """Places in a body, and the shares in which what is felt of another is that of them: by parabolas.

    They have the radius that was tried first: what is so small is felt as a point.
    """
    size, sites = body.high - body.low, dict[Key, Shape]()
    at = (np.array([[shape[k] for k in "xyz"] for shape in shapes]) - body.low) / size
    parabolas = np.linalg.solve(np.vander(SITES).T, np.vander(at.ravel(), len(SITES)).T)
    along, shares = parabolas.reshape(len(SITES), *at.shape), []
    for which in np.ndindex((len(SITES),) * 3):
        place = body.low + size * np.take(SITES, which)
        there = {**dict(zip("xyz", place.tolist(), strict=True)), "radius": shapes[0]["radius"]}
        sites[effect.id, which] = there
        shares.append(np.prod(along[which, :, range(3)], axis=0))
    return sites, np.array(shares)


def twin_of(
    problem: Problem, scenes: Scenes, model: Model, made: Sequence[Recording] | None = None
) -> Problem:
    """A simulation of scenes, unless it is ``made`` already, read as those of a problem.

    Raises:
        ValueError: a simulation fails, or cannot be read.
    """
    made = scenes.rolled(model) if made is None else made
    try:
        return twin_problem(problem, scenes.recordings, lambda _: made, dict(model.values))
    except ValueError as error:
        raise ValueError(f"as simulated, {error}") from None


def changed(
    problem: Problem,
    twin: Problem,
    scenes: Scenes,
    model: Model,
    meant: Sequence[int],
    made: Sequence[Recording] | None = None,
) -> np.ndarray:
    """What simulations of some probes leave of the law more than a twin, zero elsewhere, shape [rows].

    Args:
        problem: probes of the data.
        twin: the same of the simulation.
        scenes: of all of them, as they are simulated.
        model: with the twin's values of the law.
        meant: which probes.
        made: simulations of these; None: by the model.

    Raises:
        ValueError: a simulation fails, or cannot be read.
    """
    other = replace(problem, probes=tuple(problem.probes[n] for n in meant), offset=None)
    other = twin_of(other, scenes.only(meant), model, made)
    lengths = [int(p.keep.sum()) for p in problem.probes]
    found = np.zeros(sum(lengths))
    own = np.repeat(np.isin(np.arange(len(lengths)), meant), lengths)
    found[own] = _left(other, model) - _left(twin, model)[own]
    return found


def rest_of(rows: Rows, theta: np.ndarray) -> np.ndarray:
    """b - A theta."""
    A, b = rows
    return np.asarray(b - A @ theta)
