"""What is sought from some probes: rows at given nonlinear constants, solved for the linear ones."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from form_drake.motion import Motion
from form_drake.motion.motion import Displacement
from form_drake.weak import errors
from form_drake.weak.probe import Probe
from form_drake.weak.solve import Solution, Weights, bounded
from form_drake.weak.stress import strain_over_radius
from form_drake.weak.system import Row, WeakSystem, stacked
from form_drake.weak.unknowns import Unknowns

Level = Literal["borne", "row", "probe"]
Rows = tuple[np.ndarray, np.ndarray]  # A, b
Drawn = tuple[np.ndarray, dict[str, np.ndarray]]  # noise of coefficients [m] and of forces [N]
Change = tuple[Displacement, dict[str, np.ndarray]]  # what that does to a motion, and to forces

SHAPE_SPAN = 300.0  # either way from the first guess of a shape constant
YIELD_SPAN = 300.0  # below the largest elastic strain that the motion could hold
DIFFERENCE = 1e-3  # of the logarithm of a nonlinear constant


@dataclass(frozen=True)
class Problem:
    """Probes of one material and what is sought of its law.

    Attributes:
        probes: rows come from all of them.
        unknowns: of the law.
        ranges: first and last value of the search for each nonlinear constant; the yield
            constant is searched as the bound r on the elastic strain.
        level: the model error of a row is a share of the largest size that its test field has seen
            so far (``borne``: errors of what a body has undergone stay when it is unloaded), of its
            own size (``row``), or of the largest among the rows of its probe (``probe``).
        offset: added to A, shape [rows, terms], see ``form_drake.identify.twin``; None: nothing.
        towards: coefficients whose ratios set the stretches along traction-free directions where none
            are given, shape [terms]; None: all that are sought are as large as what is known, or one.
    """

    probes: tuple[Probe, ...]
    unknowns: Unknowns
    ranges: tuple[tuple[float, float], ...]
    level: Level = "borne"
    offset: np.ndarray | None = None
    towards: np.ndarray | None = None

    @classmethod
    def of(cls, probes: Sequence[Probe], unknowns: Unknowns, level: Level) -> "Problem":
        law = unknowns.law
        ranges = []
        for key in unknowns.searched:
            if key in law.constants("yield"):
                top = max(_largest_strain(p, unknowns) for p in probes)
                ranges.append((top / YIELD_SPAN, top))
            else:
                guess = law.parameter(key).guess
                ranges.append((min(guess) / SHAPE_SPAN, max(guess) * SHAPE_SPAN))
        return cls(tuple(probes), unknowns, tuple(ranges), level)

    @cached_property
    def coarser(self) -> "Problem":
        """The same problem with integrals over fewer points, or itself where there are none."""
        if all(p.sampling is p.rough for p in self.probes):
            return self
        return replace(self, probes=tuple(p.coarser for p in self.probes))

    @property
    def lighter(self) -> "Problem":
        """The same with the rows that it has made, without the motions they were made from."""
        other = replace(self, probes=tuple(replace(p) for p in self.probes))
        other.__dict__["_memory"] = self._memory
        return other

    def coordinates(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """The logarithms of the nonlinear constants, and theta, at given values of all parameters."""
        law, eta = self.unknowns.law, []
        for key in self.unknowns.searched:
            bound = key in law.constants("yield")
            eta.append(np.log(law.radius_vector(dict(values))[0] if bound else values[key]))
        return np.array(eta), np.array([values[t.key] for t in law.terms])

    def values(self, eta: np.ndarray) -> dict[str, float]:
        """Constants of the law at exp(eta); terms are placeholders."""
        law = self.unknowns.law
        values = {k: 1.0 for k in law.keys}
        values |= {k: v for k, v in self.unknowns.known.items() if k in law.keys}
        for key, e in zip(self.unknowns.searched, eta, strict=True):
            if key in law.constants("yield"):
                values |= self.unknowns.radius(float(np.exp(e)))
            else:
                values[key] = float(np.exp(e))
        return values

    def rows(self, eta: np.ndarray, theta: np.ndarray | None = None) -> Rows:
        """A and b at the nonlinear constants exp(eta); they are remembered.

        Args:
            eta: logarithms of the nonlinear constants.
            theta: coefficients that set, up to a factor, the stretches along traction-free
                directions; None: those of ``towards``.
        """
        return self._remembered("rows", eta, theta, self._rows)

    def system(self, eta: np.ndarray, theta: np.ndarray | None = None) -> WeakSystem:
        """All rows with their sizes, arguments as of ``rows``."""
        theta = self._coefficients(theta)
        A, b = self.rows(eta, theta)
        sizes = self._remembered("sizes", eta, theta, self._sizes)
        ends = np.cumsum([len(p.labels) for p in self.probes])[:-1]
        systems = []
        for probe, *own in zip(
            self.probes, *(np.split(a, ends) for a in (A, b, sizes)), strict=True
        ):
            scale = np.abs(own[2] * theta).sum(axis=1)
            if self.level == "probe":
                scale = np.full(len(scale), scale.max())
            elif self.level == "borne":
                scale = _borne(scale, probe.labels)
            systems.append(WeakSystem(own[0], own[1], scale, own[2], probe.labels))
        return stacked(systems)

    def changes(self, drawn: Sequence[Drawn]) -> list[Change]:
        """What noise that is drawn for every probe does where this problem looks."""
        pairs = zip(self.probes, drawn, strict=True)
        return [(probe.sampling.displaced(noise), push) for probe, (noise, push) in pairs]

    def disturbed(self, eta: np.ndarray, changes: Sequence[Change], share: float) -> Rows | None:
        """A and b with a share of changes of tracks and forces; None: it folds a body."""
        moved = []
        for probe, (change, push) in zip(self.probes, changes, strict=True):
            motion = probe.disturbed(change, share)
            if motion.J.min() <= 0.0:
                return None
            moved.append((motion, {k: share * p for k, p in push.items()}))
        return self._assembled(eta, self._coefficients(None), moved)

    def _coefficients(self, theta: np.ndarray | None) -> np.ndarray:
        if theta is not None:
            return theta
        if self.towards is not None:
            return self.towards
        known = float(np.max(np.abs(self.unknowns.offset), initial=0.0))
        size = known if known and self.leans else 1.0
        return self.unknowns.theta(np.full(len(self.unknowns.keys), size))

    @property
    def leans(self) -> bool:
        """Whether stretches along traction-free directions follow from ratios that are sought."""
        ratios = len(self.unknowns.keys) > 1 or bool(np.any(self.unknowns.offset))
        return ratios and any(p.released for p in self.probes)

    @cached_property
    def _memory(self) -> dict[tuple[str, bytes, bytes], Any]:
        return {}

    def _remembered(
        self,
        kind: str,
        eta: np.ndarray,
        theta: np.ndarray | None,
        make: Callable[[np.ndarray, np.ndarray], Any],
    ) -> Any:
        direction = np.zeros(0)
        if any(p.released for p in self.probes):
            theta = self._coefficients(theta)
            direction = np.round(theta / np.abs(theta).max(), 12)
        key = (kind, eta.tobytes(), direction.tobytes())
        if key not in self._memory:
            self._memory[key] = make(eta, direction)
        return self._memory[key]

    def _rows(self, eta: np.ndarray, theta: np.ndarray) -> Rows:
        return self._assembled(eta, theta, [(p.motion, {}) for p in self.probes])

    def _assembled(
        self,
        eta: np.ndarray,
        theta: np.ndarray,
        moved: Sequence[tuple[Motion, dict[str, np.ndarray]]],
    ) -> Rows:
        law, values, parts = self.unknowns.law, self.values(eta), []
        for probe, (motion, push) in zip(self.probes, moved, strict=True):
            along = probe.along(probe.released_motion(law, values, motion, theta))
            A = probe.columns(along, law, values, self.unknowns.columns)
            parts.append((A, probe.rest(along, push)))
        A, b = (np.concatenate(p) for p in zip(*parts, strict=True))
        return A if self.offset is None else A + self.offset, b

    def _sizes(self, eta: np.ndarray, theta: np.ndarray) -> np.ndarray:
        law, values, parts = self.unknowns.law, self.values(eta), []
        for probe in self.probes:
            motion = probe.released_motion(law, values, probe.motion, theta)
            parts.append(probe.sizes(motion, law, values, self.unknowns.columns))
        return np.concatenate(parts)

    def noise(self, eta: np.ndarray, theta: np.ndarray) -> list[np.ndarray]:
        """Covariance of each probe's rows, probes being independent [(N m s)^2]."""
        values, theta = self.values(eta), theta * self.unknowns.columns
        return [errors.noise(p, self.unknowns.law, values, theta) for p in self.probes]

    def passed(self, eta: np.ndarray, theta: np.ndarray, gain: Sequence[np.ndarray]) -> np.ndarray:
        """The same of combinations of all rows, with what noise leaves in plastic strain.

        Few points will do, and what history takes back must be read where it was added.

        Args:
            eta: logarithms of the nonlinear constants.
            theta: coefficients of all terms.
            gain: of each probe's rows, shape [combinations, rows].
        """
        return self._combined(errors.passed, self.coarser.probes, eta, theta, gain)

    @cached_property
    def missed(self) -> list[np.ndarray]:
        """The same from what motions miss between frames; a twin that is read alike misses as much."""
        none = 0.0 if self.offset is not None else 1.0
        return [none * errors.missed(p) for p in self.probes]

    def doubt(self, eta: np.ndarray, theta: np.ndarray, gain: Sequence[np.ndarray]) -> np.ndarray:
        """The same from what no track tells."""
        return self._combined(errors.doubt, self.probes, eta, theta, gain)

    def _combined(
        self,
        errors_of: Callable[..., np.ndarray],
        probes: Sequence[Probe],
        eta: np.ndarray,
        theta: np.ndarray,
        gain: Sequence[np.ndarray],
    ) -> np.ndarray:
        values, theta = self.values(eta), theta * self.unknowns.columns
        law, pairs = self.unknowns.law, zip(probes, gain, strict=True)
        return np.asarray(sum(errors_of(p, law, values, theta, own) for p, own in pairs))

    def solved(self, system: WeakSystem, by: Weights) -> Solution:
        """The linear solution of a system under the signs that physics demands."""
        return bounded(*self.reduced(system.A, system.b), by, self.floors(system))

    def reduced(self, A: np.ndarray, b: np.ndarray) -> Rows:
        """Columns of phi and what the known part leaves of b."""
        return A @ self.unknowns.M, b - A @ self.unknowns.offset

    def floors(self, system: WeakSystem) -> np.ndarray:
        """Least value of every phi: just above zero where it must be positive."""
        law, keys = self.unknowns.law, self.unknowns.keys
        signed = {t.key for t in law.terms if t.signed}
        size = np.linalg.norm(system.sizes @ np.abs(self.unknowns.M), axis=0)
        level = 1e-9 * np.linalg.norm(system.scale) / np.maximum(size, 1e-300)
        return np.where([k in signed for k in keys], -np.inf, level)

    def jacobian(self, eta: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """d (A theta) / d (phi, eta), by eta at fewer points, shape [rows, unknowns]."""
        A, b = self.rows(eta, theta)
        return np.hstack([self.reduced(A, b)[0], self.coarser.slopes(eta, theta)])

    def slopes(self, eta: np.ndarray, theta: np.ndarray, *, released: bool = True) -> np.ndarray:
        """d (A theta) / d eta, shape [rows, len(eta)].

        Args:
            eta: logarithms of the nonlinear constants.
            theta: coefficients of all terms.
            released: whether stretches along traction-free directions are those of theta.
        """
        along = theta if released else None
        columns = np.zeros((sum(int(p.keep.sum()) for p in self.probes), len(eta)))
        for n, step in enumerate(DIFFERENCE * np.eye(len(eta))):
            up, down = (self.rows(eta + s * step, along)[0] @ theta for s in (1.0, -1.0))
            columns[:, n] = (up - down) / (2.0 * DIFFERENCE)
        return columns


def _borne(scale: np.ndarray, labels: Sequence[Row]) -> np.ndarray:
    """The largest size that each row's test field has seen up to the end of its window."""
    found = scale.copy()
    for field in {row.field for row in labels}:
        own = np.array([n for n, row in enumerate(labels) if row.field == field])
        order = own[np.argsort([labels[n].window[1] for n in own], kind="stable")]
        found[order] = np.maximum.accumulate(scale[order])
    return found


def _largest_strain(probe: Probe, unknowns: Unknowns) -> float:
    """The bound on the elastic strain that nine tenths of the motion would pass, were it elastic."""
    motion = probe.motion
    looks = np.unique(np.linspace(0, len(motion.time) - 1, 40).astype(int))
    return float(np.quantile(strain_over_radius(unknowns.law, motion.F[looks]).max(axis=0), 0.9))
