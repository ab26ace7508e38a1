"""Naming from what is seen of a surface: rows are tracks and forces, sample by sample.

Where no points lie inside, no balance can be read. Every column is then the difference of two
simulations, or of what sensors make of one; the algebra is that of the balance.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from form_drake.diagnose.columns import Key, Parts, parts
from form_drake.diagnose.model import Model, Scenes, firm
from form_drake.diagnose.plates import simulated
from form_drake.diagnose.prepare import CLEAR
from form_drake.diagnose.projected import Projected
from form_drake.diagnose.verify import there, tracking_noise
from form_drake.effects import Effect, Shape
from form_drake.effects.acting import Known, sensed
from form_drake.identify.start import guesses
from form_drake.laws import Law, Values
from form_drake.motion import Body, body
from form_drake.records import Recording, framed
from form_drake.weak.force import measured
from form_drake.weak.solve import TINY, lessened

STEP = 0.02  # of the logarithm of a modulus, in differences
PASSES, SETTLED = 12, 0.003  # of a fit; change of such a logarithm that is none
MOST = np.log(2.0)  # that it may change by in a pass
ORDER = 1.0  # of the grid spacing, to which motions near rims of held faces are wrong
GIVES = 0.05  # of the grid spacing, that contacts give by
LEAST = 1e-3  # strain below which a stiffness is not guessed


@dataclass(frozen=True)
class Sight(Projected):
    """Recordings beside a twin.

    Attributes:
        scenes: of the recordings.
        model: that the twin was simulated with; its causes stay as they are.
        made: the twin, on the coarser grid.
        grid: what that grid has wrong, in rows, by a finer one; None: it is not known.
        origin: the twin whose columns these are, which a search mends; None: itself.
        known: columns that have been made, by id and shape or place.
        given: values of the law that stay.
    """

    scenes: Scenes
    model: Model
    made: tuple[Recording, ...]
    grid: np.ndarray | None = field(default=None, repr=False)
    origin: "Sight | None" = field(default=None, repr=False)
    known: dict[Key, np.ndarray] = field(default_factory=dict, repr=False)
    given: Collection[str] = ()
    entire = False

    @classmethod
    def of(cls, scenes: Scenes, model: Model, given: Collection[str] = ()) -> "Sight":
        """Simulate.

        Raises:
            ValueError: a recording does not state its scene, or the simulation fails.
        """
        return cls(scenes, model, tuple(scenes.rough.rolled(model)), given=given)

    @classmethod
    def fitted(cls, scenes: Scenes, model: Model, given: Collection[str] = ()) -> "Sight":
        """Beside the model that comes nearest to the first recording, with what the grid has wrong.

        What rings after a shake would make the way there anything but straight. On a coarse grid moduli come
        nearest that are none of the body's, with which it would ring at another rate: they are sought
        again without what the grid has wrong of them.

        Raises:
            ValueError: as of ``of``.
        """
        press, grid = scenes.only([0]), None
        for _ in range(PASSES):
            here = replace(cls.of(press, model, given), grid=grid)
            if not here._keys:
                break
            step = here.within(np.linalg.lstsq(here.own_slopes, here.apart, rcond=None)[0])
            model = replace(model, values=here.valued(step))
            if np.abs(step).max() >= SETTLED:
                continue
            if grid is not None:
                break
            grid = here.corrected().grid
        return cls.of(scenes, model, given).corrected()

    def corrected(self) -> "Sight":
        """With what the grid has wrong, by one simulation on the finer grid."""
        return self._with(self._rows(self.scenes.rolled(self.model)) - self._still)

    @property
    def uncorrected(self) -> "Sight":
        """The same with whatever the grid has wrong."""
        return self._with(None)

    def _with(self, grid: np.ndarray | None) -> "Sight":
        found = replace(self, grid=grid)
        found.__dict__.update(_moduli=self._moduli, _noise=self._noise, _still=self._still)
        return found

    @property
    def bodies(self) -> list[Body]:
        return [body(r) for r in self.scenes.recordings]

    @cached_property
    def apart(self) -> np.ndarray:
        apart = self._rows(self.scenes.recordings) - self._still
        return apart if self.grid is None else apart - self.grid

    def white(self, a: np.ndarray) -> np.ndarray:
        """What the grid has wrong may be more or less, along every axis of the tracks and of the force of
        every recording: that is taken out. So much of it may be left at every point, along every axis, and
        so far may plates stand elsewhere, or contacts give: these are errors beside the noise.

        Raises:
            ValueError: a simulation with plates elsewhere fails.
        """
        return lessened(self._off(a), *self._plates)

    def _off(self, a: np.ndarray) -> np.ndarray:
        a = lessened(a, *self._left_there)
        return np.asarray(a - self._doubts @ (self._doubts.T @ a))

    @cached_property
    def _labels(self) -> np.ndarray:
        """Of every row the recording, the axis of its tracks or a force, and that at one point, shape [rows, 3]."""
        found, axes, places = [], 0, 0
        for n, (own, (valid, _, noise)) in enumerate(zip(self.made, self._noise, strict=True)):
            points = np.broadcast_to(np.arange(own.points), valid.shape)[valid]
            for which in (points, *(np.zeros(len(own.forces[k].time), int) for k in noise)):
                axis = np.tile(np.arange(3), len(which))
                place = places + 3 * np.repeat(which, 3) + axis
                found.append(np.stack([np.full(len(axis), n), axes + axis, place], axis=1))
                axes, places = axes + 3, 1 + int(place.max(initial=places - 1))
        return np.concatenate(found)

    @cached_property
    def _doubts(self) -> np.ndarray:
        """What the grid has wrong along every axis, beside what is left, orthonormal, shape [rows, axes]."""
        if self.grid is None:
            return np.zeros((len(self._still), 0))
        axes, grid = self._labels[:, 1], lessened(self.grid, *self._left_there)
        found = grid[:, None] * (axes[:, None] == np.unique(axes))
        size = np.linalg.norm(found, axis=0)
        return found[:, size > 0.0] / size[size > 0.0]

    @cached_property
    def _left_there(self) -> tuple[csr_array, np.ndarray]:
        """What the finer grid may have wrong itself: directions, shape [rows, places], and sizes.

        What a grid has wrong keeps its course in time and differs from place to place: of two grids one tells
        how large it is there, not how much of it is left.
        """
        rows = np.arange(len(self._still))
        if self.grid is None:
            return csr_array((len(rows), 0)), np.zeros(0)
        which, _, places = self._labels.T
        left = np.array(self.scenes.remaining(ORDER))[which] * self.grid
        sizes = np.sqrt(np.bincount(places, left**2))
        return csr_array((left / np.maximum(sizes, TINY)[places], (rows, places))), sizes

    @cached_property
    def _plates(self) -> tuple[np.ndarray, np.ndarray]:
        """Principal directions and sizes of what plates that are off change, off what the grid has wrong."""
        made = [] if self.grid is None else simulated(self.scenes, self.model, GIVES)
        found = []
        for one in made:
            every = [*self.made[: one.of], one.recording, *self.made[one.of + 1 :]]
            found.append(self._rows(every) - self._still)
        errors = self._off(np.reshape(found, (len(found), len(self._still))).T)
        lines, sizes, _ = np.linalg.svd(errors, full_matrices=False)
        return lines, sizes

    @property
    def chance_apart(self) -> float:
        return float(len(self.gap) - self._doubts.shape[1])

    @property
    def size(self) -> float:
        return float(np.linalg.norm(self._still))

    @property
    def _keys(self) -> list[str]:
        given = {*self.given, *self.model.law.constants("given")}
        return [k for k, v in self.model.values.items() if k not in given and v > 0.0]

    @property
    def own_slopes(self) -> np.ndarray:
        """Of the logarithms of what the law does not state, if above zero."""
        return (self.origin or self)._moduli

    @cached_property
    def _moduli(self) -> np.ndarray:
        more = [{**self.model.values, k: self.model.values[k] * np.exp(STEP)} for k in self._keys]
        made = self.scenes.rough.every([replace(self.model, values=v) for v in more])
        slopes = [(self._rows(one) - self._still) / STEP for one in made]
        return np.reshape(slopes, (-1, len(self._still))).T

    def within(self, change: np.ndarray) -> np.ndarray:
        return np.clip(change, -MOST, MOST)

    def valued(self, change: np.ndarray) -> dict[str, float]:
        grown = zip(self._keys, np.exp(change), strict=True)
        values = {**self.model.values, **{k: self.model.values[k] * float(f) for k, f in grown}}
        return firm(self.model.law, values, self.given)

    def turned(self, values: Values) -> np.ndarray:
        grown = [values[k] / self.model.values[k] for k in self._keys]
        return np.log(np.array(grown, dtype=float))

    def near(self, model: Model) -> "Sight":
        made = tuple(self.scenes.rough.rolled(model))
        found = replace(self, model=model, made=made, origin=self.origin or self)
        found.__dict__.update(_noise=self._noise, _doubts=self._doubts)
        found.__dict__.update(_left_there=self._left_there, _plates=self._plates)
        return found

    def learn(self, wanted: Sequence[tuple[Effect, Sequence[Shape]]]) -> None:
        if self.origin is not None:
            return self.origin.learn(wanted)
        todo = {
            key: (effect, at)
            for effect, shapes in wanted
            for key, at in self._parts(effect, shapes)[0].items()
            if key not in self.known
        }
        acting = {key: one for key, one in todo.items() if one[0].world is not None}
        models = [self.model.more(e, self._trial(e), shape) for e, shape in acting.values()]
        made = dict(zip(acting, self.scenes.rough.every(models), strict=True))
        for key, (effect, shape) in todo.items():
            own = made.pop(key, None) or self._sensed(effect, shape)
            self.known[key] = (self._rows(own) - self._still) / self._trial(effect)

    def _sensed(self, effect: Effect, shape: Shape) -> list[Recording]:
        own = Known(effect, self._trial(effect), shape)
        return [sensed(one, [own]) for one in self.made]

    def _trial(self, effect: Effect) -> float:
        tried = effect.trial or float(np.sqrt(effect.prior[0] * effect.prior[1]))
        return self.model.trial(replace(effect, trial=tried), self.bodies[0])

    def changes(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        if self.origin is not None:
            return self.origin.changes(effect, shapes)
        self.learn([(effect, shapes)])
        sites, shares = self._parts(effect, shapes)
        return np.stack([self.known[key] for key in sites], axis=1) @ shares

    def _parts(self, effect: Effect, shapes: Sequence[Shape]) -> Parts:
        return parts(effect, shapes, self.bodies[0], placed=True)

    @cached_property
    def _still(self) -> np.ndarray:
        return self._rows(self.made)

    def _rows(self, made: Sequence[Recording]) -> np.ndarray:
        """What is measured, in standard deviations, where the data have it, shape [rows]."""
        parts = []
        for own, seen, (valid, sd, noise) in zip(
            made, self.scenes.recordings, self._noise, strict=True
        ):
            parts.append((own.p_WQ - seen.reference)[valid].ravel() / sd)
            parts += [own.forces[tool].value.ravel() / sd_force for tool, sd_force in noise.items()]
        return np.concatenate(parts)

    @cached_property
    def _noise(self) -> list[tuple[np.ndarray, float, dict[str, float]]]:
        """Of every recording: which points count when, shape [frames, points], and the standard deviations
        of their coordinates [m] and of its forces [N].

        Test fields keep clear of faces that are held, where the solver errs most, and so do points.
        """
        found = []
        for seen, dx in zip(self.scenes.recordings, self.scenes.dx, strict=True):
            forces, shape = measured(seen, 0.0, float(np.ptp(seen.time))), body(seen)
            valid = there(seen)
            for face in shape.faces:
                if face.condition != "free":
                    plane = (shape.low, shape.high)[face.side][face.axis]
                    valid &= np.abs(seen.reference[:, face.axis] - plane) > CLEAR * dx
            found.append((valid, tracking_noise(seen), {k: f.noise for k, f in forces.items()}))
        return found


def guessed(recording: Recording, law: Law, known: Values) -> Model:
    """A model by the stiffness that the largest force and the strain of the points along it show.

    Raises:
        ValueError: no tool of which the force is measured touches the body.
    """
    recording, shape = framed(recording), body(recording)
    touched = [f for f in shape.faces if f.tool in recording.forces]
    if not touched:
        raise ValueError(
            "no measured force is on a tool that touches the body: its stiffness is open"
        )
    face = touched[0]
    edges, force = shape.high - shape.low, recording.forces[face.tool]
    most = int(np.argmax(np.abs(force.value[:, face.axis])))
    frame = int(np.argmin(np.abs(recording.time - force.time[most])))
    moved = (recording.p_WQ[frame] - recording.reference)[:, face.axis]
    seen = there(recording)[frame]
    strain = np.polyfit(recording.reference[seen, face.axis], moved[seen], 1)[0]
    stress = force.value[most, face.axis] * edges[face.axis] / np.prod(edges)
    modulus = abs(stress) / max(abs(strain), LEAST)
    return Model(law, {**known, **guesses(law, known, [float(modulus)])[0]})
