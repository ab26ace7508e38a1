"""Data beside a twin: what the rows of one leave over and those of the other do not.

A twin is a simulation of the measured scenes with a model, read as the data are. What reading costs is
in both, so that the gap between them is what the model has wrong. What a simulation has wrong changes
little while the model does: a finer one tells it once, for the coarser ones that search (Stetter 1978,
the defect correction principle).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from form_drake.diagnose.columns import Columns, Key, rest_of, twin_of
from form_drake.diagnose.kept import Kept
from form_drake.diagnose.model import Cause, Model, Scenes, firm
from form_drake.diagnose.noise import Draws, by_field, shaken, weighed
from form_drake.diagnose.plates import Elsewhere
from form_drake.diagnose.projected import Projected
from form_drake.effects import Effect, Shape
from form_drake.identify.problem import Problem
from form_drake.laws import Values
from form_drake.motion import Body
from form_drake.records import Recording
from form_drake.weak.solve import Weights

OTHER = 0.03  # of the rows, from which their noise is taken anew
AWAY = 2.0  # standard deviations that what the grid has wrong may have changed by
CLOSE = 0.02  # of the rows, from which what the grid has wrong is looked at again
GROSS = 0.25  # of the rows, which no grid has wrong
FAR = 0.2  # of the rows, from which what the grid has wrong says nothing
MOST = np.log(2.0)  # largest change of a modulus in a pass, of its logarithm
TURN = 0.02  # of a modulus, in differences
SMALL = 0.1  # of the largest modulus, which one that is smaller may change by
ORDER = 3.0  # of the grid spacing, to which quadratic splines have displacements wrong

Recordings = Sequence[Recording]


@dataclass(frozen=True)
class Match(Projected):
    """Data and twin.

    Attributes:
        problem: probes of the data and unknowns of the law.
        twin: the same of the simulation.
        noise: inverse covariance of the rows of the data.
        by: the same, with what the finer grid may have wrong itself as one more error of every test field.
        model: that the twin was simulated with.
        scenes: of the recordings.
        draws: what noise of the data changes of rows of the twin, or of one that is near.
        grid: what the twin has wrong, in rows of b - A theta, shape [rows], by a finer one; None: it is not
            known.
        bent: the same in coefficients of the fits [m], by probe; none where it is not known, or nothing.
        began: ``apart`` where the model was when ``grid`` and the noise were found.
        simulated: what simulated effects change, see ``Columns``; found once.
        kept: columns of a twin nearby.
    """

    problem: Problem
    twin: Problem
    noise: Weights
    by: Weights
    model: Model
    scenes: Scenes
    draws: Draws = field(repr=False)
    grid: np.ndarray | None = field(default=None, repr=False)
    bent: tuple[np.ndarray, ...] = field(default=(), repr=False)
    began: np.ndarray | None = field(default=None, repr=False)
    simulated: dict[Key, np.ndarray] = field(default_factory=dict, repr=False)
    kept: Kept = Kept()

    @classmethod
    def of(
        cls,
        problem: Problem,
        scenes: Scenes,
        model: Model,
        made: Recordings | None = None,
        elsewhere: Sequence[Elsewhere] | None = None,
    ) -> "Match":
        """Simulate on the coarser grid, unless that is ``made`` already, read, and weigh.

        So are scenes with plates ``elsewhere``.
        """
        probes = tuple(replace(p, fit=p.fit.responding) for p in problem.probes)
        problem = replace(problem, probes=probes)  # what smoothing takes off, it takes off both
        twin = twin_of(problem, scenes.rough, model, made)
        by = weighed(problem, twin, scenes, model, elsewhere)
        draws = shaken(problem, twin, *twin.coordinates(model.values))
        found = cls(problem, twin, by, by, model, scenes, draws)
        none = np.zeros(len(found.apart)) if scenes.coarser <= 1.0 else None
        return replace(found, grid=none, began=found.apart)

    @property
    def bodies(self) -> list[Body]:
        return [p.body for p in self.problem.probes]

    def near(self, model: Model) -> "Match":
        twin, kept = twin_of(self.problem, self.scenes.rough, model), self._made
        found = replace(self, twin=twin, model=model)
        own = kept.own if found.bending == self.bending else None
        share = model.shown / self.model.shown
        if own is not None and share != 1.0:  # moduli and forces grow alike
            own = share * own
        now, before = (m.twin.coordinates(m.model.values) for m in (found, self))
        draws = self.draws  # exact in what rows are linear in
        if not np.array_equal(now[0], before[0]):
            draws = shaken(self.problem, twin, *now)
        return replace(found, draws=draws, kept=replace(kept, own=own))

    def on(self, coarser: float) -> "Match":
        """With a twin on another grid and the same gap: what else that grid has wrong is told by the two.

        A search on the finest grid stays there.
        """
        if coarser == self.scenes.coarser or self.scenes.coarser <= 1.0:
            return self
        scenes = replace(self.scenes, coarser=coarser)
        twin = twin_of(self.problem, scenes.rough, self.model)
        found = replace(self, twin=twin, scenes=scenes, kept=self._made)
        if self.grid is None:
            return found
        eta, theta = twin.coordinates(self.model.values)
        one, other = (rest_of(t.rows(eta, theta), theta) for t in (self.twin, twin))
        changes = zip(self.bent, _bent(self.twin, twin), strict=True)
        bent = tuple(old + new for old, new in changes)
        return replace(found, grid=self.grid + one - other, bent=bent)

    def anchored(self, made: Recordings | None = None) -> "Match":
        """With what the grid has wrong here, by a finer simulation; noise is taken anew if it is another.

        The finest grid has nothing wrong that is known. The simulation may be ``made`` already.
        """
        if self.scenes.coarser <= 1.0:
            return self
        finer = twin_of(self.problem, self.scenes, self.model, made)
        eta, theta = self.twin.coordinates(self.model.values)
        one, other = (rest_of(p.rows(eta, theta), theta) for p in (finer, self.twin))
        grid, rows = one - other, [int(p.keep.sum()) for p in self.problem.probes]
        share = self.scenes.remaining(ORDER)
        noise, draws = self.noise, self.draws
        if self._moved > OTHER:
            noise = weighed(self.problem, self.twin, self.scenes, self.model)
            draws = shaken(self.problem, self.twin, eta, theta)
        rest = by_field(self.problem, np.repeat(share, rows) * grid)
        bent, by = _bent(finer, self.twin), noise.beside(rest)
        kept = replace(self._made, own=None)
        found = replace(self, grid=grid, bent=bent, noise=noise, draws=draws, by=by, kept=kept)
        return replace(found, began=found.apart)

    @cached_property
    def here(self) -> bool:
        """Whether what the grid has wrong is known for this model, or for one near it.

        It is taken to change by as much of itself as the rows do.
        """
        if self.grid is None:
            return False
        size = float(np.linalg.norm(self.by.white(self.grid)))
        return not size or (self._moved * size < AWAY and self._moved < CLOSE)

    @property
    def gross(self) -> bool:
        """Whether far more is missing than any grid has wrong, which must be known: noise that is small
        makes it as much as anything."""
        return self.grid is not None and float(np.linalg.norm(self.gap)) > GROSS * self.size

    @property
    def far(self) -> bool:
        """Whether what the grid has wrong is not known, or of a model that is another."""
        return self.grid is None or self._moved > FAR

    @property
    def _moved(self) -> float:
        """How much of the rows has changed since what the grid has wrong was found."""
        if self.began is None:
            return 0.0
        return float(np.linalg.norm(self.by.white(self.apart - self.began)) / self.size)

    @cached_property
    def size(self) -> float:
        """Of the stress integrals, in standard deviations."""
        eta, theta = self.twin.coordinates(self.model.values)
        return float(np.linalg.norm(self.by.white(self.twin.rows(eta, theta)[0] @ theta)))

    def white(self, a: np.ndarray) -> np.ndarray:
        return self.by.white(a)

    def changes(self, effect: Effect, shapes: Sequence[Shape]) -> np.ndarray:
        return self.raw.of(effect, shapes)

    def learn(self, wanted: Sequence[tuple[Effect, Sequence[Shape]]]) -> None:
        self.raw.learn(wanted)

    @cached_property
    def raw(self) -> Columns:
        """What effects change of the twin, not whitened."""
        return Columns(self.problem, self.twin, self.model, self.scenes, self.simulated)

    def explains(self, after: "Match") -> np.ndarray:
        """The same. Rows of the data have noise that grows with the moduli, so that what other moduli change
        of them has a share of it.
        """
        eta, theta = self.twin.coordinates(self.model.values)
        one, other = (rest_of(m.twin.rows(eta, theta), theta) for m in (self, after))
        known, there = (0.0 if m.grid is None else m.grid for m in (self, after))
        return np.asarray(other - one + there - known)

    @cached_property
    def own_slopes(self) -> np.ndarray:
        """By the twin's motion; beside effects that bend them with what simulations add to that."""
        if self.kept.own is not None:
            return self.kept.own
        plain = self.twin.jacobian(*self.twin.coordinates(self.model.values))
        return plain + self._simulated_slopes() if self.bending else plain

    @property
    def bending(self) -> list[str]:
        """Ids of effects that act beside which the law's columns are others."""
        return [c.effect.id for c in self.model.causes if c.effect.bends]

    @property
    def _made(self) -> Kept:
        """For twins nearby."""
        own = self.__dict__.get("own_slopes", self.kept.own) if self.bending else None
        if "slopes" not in self.__dict__:
            return replace(self.kept, own=own)
        columns = np.split(self.slopes, self.parts, axis=1)[1:]
        pairs = zip(self.model.causes, columns, strict=True)
        acting = [self.kept.of(c) or (c, made) for c, made in pairs if c.effect.whole]
        return Kept(own, tuple(acting))

    def _kept(self, cause: Cause) -> np.ndarray | None:
        found = self.kept.of(cause)
        return None if found is None else found[1]

    def _simulated_slopes(self) -> np.ndarray:
        """What the unknowns change of what the law leaves of its twin, shape [rows, unknowns]."""
        phi = self._phi
        small = SMALL * float(np.abs(phi).max(initial=0.0))
        count = len(self.twin.coordinates(self.model.values)[0])
        sizes = TURN * np.append(np.maximum(np.abs(phi), small), np.ones(count))
        models = [replace(self.model, values=self.valued(step)) for step in np.diag(sizes)]
        went = np.array([self.turned(model.values)[n] for n, model in enumerate(models)])
        rests = self.raw.rests(models)
        return np.asarray(rests / np.where(went != 0.0, went, np.inf))

    def within(self, change: np.ndarray) -> np.ndarray:
        phi, found = self._phi, change.copy()
        least, most = np.exp(-MOST) - 1.0, np.exp(MOST) - 1.0
        largest = SMALL * float(np.abs(phi).max(initial=0.0))
        highest = most * np.maximum(np.abs(phi), largest)
        signed = {t.key for t in self.problem.unknowns.law.terms if t.signed}
        lowest = least * np.abs(phi)  # one that may be negative may pass zero
        passing = [key in signed for key in self.problem.unknowns.keys]
        lowest[passing] = np.minimum(lowest, -most * largest)[passing]
        found[: len(phi)] = np.clip(change[: len(phi)], lowest, highest)
        found[len(phi) :] = np.clip(change[len(phi) :], -MOST, MOST)
        return found

    def valued(self, change: np.ndarray) -> dict[str, float]:
        unknowns, now = self.problem.unknowns, self.model.values
        phi = self._phi + change[: len(self._phi)]
        eta = self.twin.coordinates(now)[0] + change[len(phi) :]
        values = {**now, **self.problem.values(eta)}
        theta = unknowns.theta(phi)
        values |= {t.key: float(v) for t, v in zip(unknowns.law.terms, theta, strict=True)}
        return firm(unknowns.law, values, unknowns.known)

    def turned(self, values: Values) -> np.ndarray:
        eta, theta = self.twin.coordinates(values)
        now = self.twin.coordinates(self.model.values)[0]
        return np.concatenate([self.problem.unknowns.phi(theta) - self._phi, eta - now])

    @property
    def _phi(self) -> np.ndarray:
        """The unknowns that the law is linear in."""
        return self.problem.unknowns.phi(self.twin.coordinates(self.model.values)[1])

    @property
    def rest(self) -> np.ndarray:
        """What the data leave of the law alone, no twin's rows taken off, shape [rows]."""
        eta, theta = self.twin.coordinates(self.model.values)
        return rest_of(self.problem.rows(eta, theta), theta)

    def seen_by(self, by: Weights, apart: np.ndarray) -> "Match":
        """The same columns with other weights, and other rows left over."""
        other = replace(self, by=by)
        kept = {"raw": self.raw, "slopes": self.slopes}
        other.__dict__.update(kept, apart=apart)
        return other

    @property
    def lighter(self) -> "Match":
        """The same with all that it was asked for, without what that was made from.

        Motions, tables of fields and readings take a hundred times as much room; they are made again if
        more is asked.
        """
        twin = self.twin.lighter
        other = replace(self, twin=twin)
        known = {k: v for k, v in vars(self).items() if k not in vars(other)}
        if "raw" in known:
            known["raw"] = self.raw.lighter(twin)
        other.__dict__.update(known)
        return other

    def doubted(self, root: np.ndarray) -> "Match":
        """With what its unknowns may have wrong as an error of its rows.

        Args:
            root: of their covariance, see ``root``.
        """
        return self.seen_by(self.by.beside(self.slopes @ root), self.apart)

    @cached_property
    def apart(self) -> np.ndarray:
        """The same, not whitened: rows of the data less those of the twin.

        Noise shifts the rows of the data to second order too. By as much it shifts those of the
        twin: that is the mean over pairs of draws of opposite sign.
        """
        eta, theta = self.twin.coordinates(self.model.values)
        data, own = (rest_of(p.rows(eta, theta), theta) for p in (self.problem, self.twin))
        shift = sum((0.5 * (one + other) for one, other in self._shaken), start=np.zeros(len(own)))
        grid = 0.0 if self.grid is None else self.grid
        return np.asarray(data - own - grid - shift / max(len(self._shaken), 1))

    @cached_property
    def _shaken(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """What noise changes of the twin's rows, not whitened: draws and their opposites."""
        theta = self.twin.coordinates(self.model.values)[1]
        return [(rest_of(one, theta), rest_of(other, theta)) for one, other in self.draws]

    @cached_property
    def chance(self) -> float:
        """Square of ``left`` if nothing but noise were missing: the mean over draws."""
        return self._expected(self.off)

    @cached_property
    def chance_apart(self) -> float:
        """The same of ``gap``."""
        return self._expected(lambda a: a)

    def _expected(self, part: Callable[[np.ndarray], np.ndarray]) -> float:
        halves = [self.by.white(0.5 * (one - other)) for one, other in self._shaken]
        squares = [np.sum(part(half) ** 2) for half in halves]
        return float(np.mean(squares)) if squares else float(len(self.gap))


def _bent(finer: Problem, coarser: Problem) -> tuple[np.ndarray, ...]:
    """What a finer grid changes of coefficients of fits [m], by probe."""
    pairs = zip(finer.probes, coarser.probes, strict=True)
    return tuple(one.fit.c - other.fit.c for one, other in pairs)
