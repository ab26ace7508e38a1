"""What is believed of a specimen, and the recordings that it would give."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from form_drake.effects import Effect, Shape, World
from form_drake.effects.acting import Known, changed, known, sensed
from form_drake.laws import ADDITIONS, Law, Values
from form_drake.material import Acting, Material
from form_drake.motion import Body, body
from form_drake.mpm.stage import Stage
from form_drake.records import Recording, framed
from form_drake.workers import forkable, mapped

STEP = 0.2  # of the width of a shape parameter, in differences
FIRM = 2.0 / 3.0  # bulk modulus by shear modulus at a Poisson's ratio of zero
CELLS = 8  # of the grid along the least edge of a body
# of the size of an effect, one standard deviation of what simulations have wrong; of the second sealed set,
# whose verdicts held twice as much, errors were .64 standard deviations
INEXACT = 0.02
# of what Richardson's extrapolation would add, one standard deviation: two are Roache's factor of safety
# for two grids, 3, meant to hold 19 cases in 20 (Verification and Validation, 1998)
SAFE = 1.5
SEARCH, FIT = 2.25, 1.5  # times the spacing, of grids that find what is missing and how much


@dataclass(frozen=True)
class Cause(Known):
    """An effect that acts, as far as it is known.

    Attributes:
        std: of the coefficient; infinite: what is measured does not tell its size.
        spread: standard deviations of the shape parameters that were refined and are seen.
        alone: the part of ``std`` that is noise; None: all of it.
    """

    std: float = 0.0
    spread: Shape = field(default_factory=dict)
    alone: float | None = None

    def known(self, std: float, spread: Shape) -> "Cause":
        """With standard deviations by noise, beside which stands what simulations have wrong of sizes."""
        sizes = {k: self.shape[k] if self.effect.positive(k) else 0.0 for k in spread}
        more = {k: _beside(own, sizes[k]) for k, own in spread.items()}
        return replace(self, std=_beside(std, self.coefficient), spread=more, alone=std)

    @property
    def told(self) -> float | None:
        """Standard deviation for a file; None: it is infinite."""
        return self.std if np.isfinite(self.std) else None

    @property
    def least(self) -> float:
        """Standard deviation by noise alone."""
        return self.std if self.alone is None else self.alone

    @property
    def unknowns(self) -> int:
        """Coefficient and shape parameters."""
        return 1 + len(self.effect.shapes)

    @property
    def widths(self) -> np.ndarray:
        """How far the shape parameters are known, shape [parameters]."""
        return np.array([self.effect.width(self.shape, k) for k in self.effect.shapes])

    @property
    def ends(self) -> np.ndarray:
        """Shape parameters between which differences are taken, within their bounds, shape [parameters, 2].

        From what acts as a whole: that is simulated already.
        """
        keys, now = self.effect.shapes, np.array([self.shape[k] for k in self.effect.shapes])
        sizes = np.where([self.effect.positive(k) for k in keys], np.abs(now), np.inf)
        step = np.minimum(STEP * self.widths, 0.5 * sizes)
        less = now if self.effect.whole else np.maximum(now - step, self._floors)
        return np.stack([less, now + step], axis=1)

    @property
    def _floors(self) -> np.ndarray:
        return np.array([self.effect.floors.get(k, -np.inf) for k in self.effect.shapes])

    @property
    def beside(self) -> list[Shape]:
        """Its shape, and those a step less and more of each of the shape parameters."""
        pairs = zip(self.effect.shapes, self.ends.tolist(), strict=True)
        return [self.shape, *({**self.shape, key: end} for key, ends in pairs for end in ends)]

    def within(self, change: np.ndarray) -> np.ndarray:
        """A change of the unknowns, cut so that none leaves its bounds or goes far at once."""
        effect, now = self.effect, np.array([self.shape[k] for k in self.effect.shapes])
        wanted = self.coefficient + float(change[0])
        size = effect.bounded(wanted, self.coefficient)
        least = np.where([effect.positive(k) for k in effect.shapes], -0.5 * np.abs(now), -np.inf)
        least = np.maximum(least, self._floors - now)
        turn = np.clip(change[1:], np.maximum(-self.widths, least), self.widths)
        # what is not cut is not rounded
        own = change[0] if size == wanted else size - self.coefficient
        return np.append(own, turn)

    def towards(self, other: "Cause") -> np.ndarray:
        """Change of the unknowns that gives another of the same effect."""
        turns = [other.shape[k] - self.shape[k] for k in self.effect.shapes]
        return np.array([other.coefficient - self.coefficient, *turns])

    def moved(self, change: np.ndarray) -> "Cause":
        """With other unknowns."""
        shape = {
            k: self.shape[k] + float(d) for k, d in zip(self.effect.shapes, change[1:], strict=True)
        }
        size = self.coefficient + float(change[0])
        return replace(self, coefficient=size, shape={**self.shape, **shape})


def _beside(std: float, size: float) -> float:
    return float(np.hypot(std, INEXACT * size))


@dataclass(frozen=True)
class Model:
    """A law with its values, and the effects that act beside it.

    Attributes:
        law: the law.
        values: of its parameters.
        causes: the effects.
        keys: parameters whose deviations are known.
        covariance: of these by noise, then of the causes' coefficients, shape [keys + causes, the same]; empty:
            it is not known.
    """

    law: Law
    values: Values
    causes: tuple[Cause, ...] = ()
    keys: tuple[str, ...] = ()
    covariance: np.ndarray = field(
        default_factory=lambda: np.zeros((0, 0)), repr=False, compare=False
    )

    @property
    def stds(self) -> dict[str, float]:
        """Of the parameters whose deviations are known."""
        own = np.sqrt(np.diag(self.covariance)[: len(self.keys)])
        return dict(zip(self.keys, own.tolist(), strict=True))

    @classmethod
    def of(cls, material: Material, effects: Mapping[str, Effect]) -> "Model":
        """Of a material's file, with a catalogue of effects by id.

        Raises:
            ValueError: an effect that they lack, that does not fit the law, or of a size or shape that there
                cannot be.
        """
        stds = [one.std or 0.0 for one in material.effects]
        acting = zip(known(material.effects, material.law, effects), stds, strict=True)
        causes = (Cause(one.effect, one.coefficient, one.shape, std) for one, std in acting)
        return cls(material.law, material.values, tuple(causes))

    def material(self, density: float) -> Material:
        """For a file: additions to the law become part of it, the other effects stand beside it."""
        law, values, beside = self.law, dict(self.values), []
        keys, rows, more = (
            list(self.keys),
            list(range(len(self.keys))),
            np.zeros(len(self.covariance)),
        )
        for n, cause in enumerate(self.causes, start=len(keys)):
            if cause.effect.id in ADDITIONS and cause.effect.world is not None:
                plain = World(law, values, density, np.zeros(3))
                world = cause.effect.world(plain, cause.coefficient, cause.shape)
                if len(more) and cause.told is not None:
                    keys += sorted(set(world.values) - set(values) - set(cause.shape))
                    rows.append(n)
                    more[n] = cause.std**2 - cause.least**2
                law, values = world.law, dict(world.values)
            else:
                beside.append(Acting(cause.effect.id, cause.coefficient, cause.shape, cause.told))
        covariance = (self.covariance + np.diag(more))[np.ix_(rows, rows)]
        return Material(law, values, density, tuple(keys), covariance, tuple(beside))

    def more(self, effect: Effect, size: float, shape: Shape) -> "Model":
        """With one more effect, or more of one that acts with this very shape."""
        same = [c.effect is effect and dict(c.shape) == dict(shape) for c in self.causes]
        if not any(same):
            return Model(self.law, self.values, (*self.causes, Cause(effect, size, shape)))
        pairs = zip(self.causes, same, strict=True)
        more = (replace(c, coefficient=c.coefficient + size) if s else c for c, s in pairs)
        return Model(self.law, self.values, tuple(more))

    def trial(self, effect: Effect, of: Body) -> float:
        """Coefficient with which an effect is simulated beside this to see what it changes.

        More than all of the stress is no share of it, and would soften the body: less is tried then.
        """
        K, G = self.law.moduli(self.values)
        size = effect.tried(G or K, of.density * float(np.prod(of.high - of.low)))
        shares = sum(c.coefficient for c in self.causes if c.effect.share)
        return -size if effect.share and shares + size > 1.0 else size

    @property
    def shown(self) -> float:
        """By how much larger tools show forces than they are."""
        return float(np.prod([1.0 + c.coefficient for c in self.causes if c.effect.compounds]))

    @property
    def whole(self) -> "Model":
        """With shares of the stress that add up to one at most."""
        total = sum(c.coefficient for c in self.causes if c.effect.share)
        if total <= 1.0:
            return self
        every = (
            replace(c, coefficient=c.coefficient / total) if c.effect.share else c
            for c in self.causes
        )
        return replace(self, causes=tuple(every))

    def without(self, cause: Cause) -> "Model":
        """With all other causes."""
        return Model(self.law, self.values, tuple(c for c in self.causes if c is not cause))


def firm(
    law: Law, values: Values, known: Collection[str] = (), share: float = FIRM
) -> dict[str, float]:
    """Values whose bulk modulus is ``share`` of the shear modulus at least, ``known`` ones kept, nu too.

    A law that lacks an effect may come nearest to data with a body that widens as it is pulled,
    about which no other effect is judged rightly.
    """
    found, (K, G) = dict(values), law.moduli(values)
    for term in law.terms:
        bulk, shear = law.moduli({k: float(k == term.key) for k in values})
        if bulk > 0.0 == shear and not {term.key, "nu"} & {*known} and K < share * G:
            found[term.key] += (share * G - K) / bulk
            break
    return found


@dataclass(frozen=True)
class Scenes:
    """The scenes of some recordings, simulated with a model.

    Attributes:
        recordings: of blocks, see ``form_drake.mpm.stage.Stage``; forces among the frames, which alone are
            simulated.
        dx: grid spacing in each [m].
        device: Warp device.
        coarser: times the spacing, for simulations that search.
    """

    recordings: tuple[Recording, ...]
    dx: tuple[float, ...]
    device: str = "cpu"
    coarser: float = SEARCH

    @classmethod
    def of(
        cls,
        recordings: tuple[Recording, ...],
        dx: float | None = None,
        device: str = "cpu",
        coarser: float = SEARCH,
    ) -> "Scenes":
        """With a spacing [m], or ``CELLS`` cells along the least edge of each body.

        Raises:
            ValueError: no box is stated, or no force is stamped among the frames.
        """
        shapes = [body(r) for r in recordings]
        own = tuple(dx or float((s.high - s.low).min()) / CELLS for s in shapes)
        return cls(tuple(framed(r) for r in recordings), own, device, coarser)

    def only(self, chosen: Sequence[int]) -> "Scenes":
        """Some of them."""
        recordings = tuple(self.recordings[n] for n in chosen)
        return replace(self, recordings=recordings, dx=tuple(self.dx[n] for n in chosen))

    def times(self, factor: float) -> "Scenes":
        """With other spacings."""
        return replace(self, dx=tuple(factor * dx for dx in self.dx))

    @property
    def rough(self) -> "Scenes":
        """On the coarser grid."""
        return self.times(self.coarser)

    @property
    def spacings(self) -> tuple[float, ...]:
        """Grid spacings that are simulated, near ``dx`` [m]."""
        pairs = zip(self.recordings, self.dx, strict=True)
        return tuple(Stage(recording, dx).spacing for recording, dx in pairs)

    def remaining(self, order: float) -> list[float]:
        """What the finer grid may have wrong, one standard deviation, as a share of what it changes.

        Args:
            order: of the spacing, to which grids are wrong.
        """
        pairs = zip(self.spacings, self.rough.spacings, strict=True)
        return [SAFE / ((coarse / own) ** order - 1.0) for own, coarse in pairs]

    def rolled(self, model: Model) -> list[Recording]:
        """What the sensors would record.

        Raises:
            ValueError: a recording does not state what is needed, or a simulation fails.
        """
        (found,) = self.every([model])
        return found

    def every(self, models: Sequence[Model]) -> list[list[Recording]]:
        """The same of several models.

        Raises:
            ValueError: see ``rolled``.
        """
        scenes = list(zip(self.recordings, self.dx, strict=True))
        tasks = [(*scene, model) for model in models for scene in scenes]
        made = mapped(lambda task: self._rolled(*task), tasks, fork=forkable())
        return [made[n : n + len(scenes)] for n in range(0, len(made), len(scenes))]

    def _rolled(self, recording: Recording, dx: float, model: Model) -> Recording:
        stage = Stage(recording, dx, device=self.device)
        plain = Material(model.law, dict(model.values), body(recording).density)
        world = changed(stage.world(plain), model.causes)
        return cast(Recording, sensed(stage.rolled(world), model.causes))
