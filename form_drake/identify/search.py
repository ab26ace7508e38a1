"""Variable projection: a search over nonlinear constants around the linear weak solve."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from form_drake.motion import Motion
from form_drake.weak.probe import Probe
from form_drake.weak.solve import Solution, Weights, bounded
from form_drake.weak.stress import strain_over_radius
from form_drake.weak.system import Row, WeakSystem, stacked
from form_drake.weak.unknowns import Unknowns

Level = Literal["borne", "row", "probe"]
Rows = tuple[np.ndarray, np.ndarray]  # A, b
Drawn = tuple[np.ndarray, dict[str, np.ndarray]]  # noise of coefficients [m] and of forces [N]

GRID = 17  # values in the scan of one nonlinear constant
FEW = 4  # of each, where there are several
ROUNDS, HALVINGS = 12, 8  # of steps, and of one step
LONGEST = 0.7  # step of a logarithm
CLOSE = 1e-4  # the last one
NOTHING = 1e-12  # share of the residual's square, below which a step promises nothing
MOST = 60  # evaluations for several constants
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
    """

    probes: tuple[Probe, ...]
    unknowns: Unknowns
    ranges: tuple[tuple[float, float], ...]
    level: Level = "borne"
    offset: np.ndarray | None = None

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
                directions; None: all that are sought are one.
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

    def disturbed(self, eta: np.ndarray, drawn: Sequence[Drawn], share: float) -> Rows | None:
        """A and b with a share of ``drawn`` added to tracks and forces; None: it folds a body."""
        moved = []
        for probe, (change, push) in zip(self.probes, drawn, strict=True):
            motion = probe.sampling.motion(probe.fit.c + share * change)
            if motion.J.min() <= 0.0:
                return None
            moved.append((motion, {k: share * p for k, p in push.items()}))
        return self._assembled(eta, self._coefficients(None), moved)

    def _coefficients(self, theta: np.ndarray | None) -> np.ndarray:
        return self.unknowns.theta(np.ones(len(self.unknowns.keys))) if theta is None else theta

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
        values = self.values(eta)
        return [p.noise(self.unknowns.law, values, theta) for p in self.probes]

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

    def searched(self, by: Weights, start: np.ndarray | None = None) -> np.ndarray:
        """The logarithms of the nonlinear constants that leave the least residual.

        Gauss-Newton steps of the projected residual (Kaufman's variable projection), whose slopes
        are those of the coarser problem.

        Args:
            by: weights of the rows.
            start: where the search starts; None: at the best of a coarse scan.

        Raises:
            ValueError: no value gives a finite stress.
        """
        eta = self.coarser._scanned(by) if start is None else start
        if not len(eta):
            return eta
        if len(eta) == 1:
            return self._stepped(eta, by)
        low, high = np.log(np.array(self.ranges)).T
        inside = np.clip(eta, low + CLOSE, high - CLOSE)
        if not self._jacobian(inside, by).any():  # nothing to follow
            return np.asarray(inside)
        found = least_squares(
            lambda e: self._residual(e, by),
            inside,
            jac=lambda e: self._jacobian(e, by),
            bounds=(low, high),
            xtol=0.1 * CLOSE,
            ftol=None,
            gtol=None,
            max_nfev=MOST,
        )
        return np.asarray(found.x)

    def _stepped(self, eta: np.ndarray, by: Weights) -> np.ndarray:
        """One constant by steps that are halved until they lessen the residual."""
        (low,), (high,) = np.log(np.array(self.ranges)).T
        residual = self._residual(eta, by)
        for _ in range(ROUNDS):
            slope = self._jacobian(eta, by)[:, 0]
            steep, left = float(slope @ slope), float(residual @ residual)
            step = -float(slope @ residual) / steep if steep > 0.0 else 0.0
            new = np.clip(eta + np.clip(step, -LONGEST, LONGEST), low, high)
            if np.abs(new - eta).max() < CLOSE:
                return np.asarray(new)
            if steep * step**2 < NOTHING * left:
                return eta
            for _ in range(HALVINGS):
                residual = self._residual(new, by)
                if residual @ residual < left:
                    break
                new = 0.5 * (eta + new)
            else:
                return eta
            eta = new
        return eta

    def _scanned(self, by: Weights) -> np.ndarray:
        """The best of some values of the nonlinear constants."""
        count = GRID if len(self.ranges) == 1 else FEW
        sides = [np.linspace(np.log(a), np.log(z), count + 2)[1:-1] for a, z in self.ranges]
        tried = [np.array(p) for p in product(*sides)]
        left = [float(np.sum(self._residual(eta, by) ** 2)) for eta in tried]
        if not np.isfinite(left).any():
            spans = (f"{k} in [{a:.3g}, {z:.3g}]" for k, (a, z) in self._spans())
            raise ValueError(f"no value of {' and '.join(spans)} gives a finite stress")
        return tried[int(np.argmin(left))]

    def _spans(self) -> Iterable[tuple[str, tuple[float, float]]]:
        return zip(self.unknowns.searched, self.ranges, strict=True)

    def _solved(self, eta: np.ndarray, by: Weights) -> tuple[Solution, np.ndarray]:
        """Solution at exp(eta), and which coefficients are off the bound of their sign."""
        signed = {t.key for t in self.unknowns.law.terms if t.signed}
        least = np.where([k in signed for k in self.unknowns.keys], -np.inf, 0.0)
        found = bounded(*self.reduced(*self.rows(eta)), by, least)
        return found, found.theta > least

    def _residual(self, eta: np.ndarray, by: Weights) -> np.ndarray:
        """White residual of the linear solution; infinite where the stress is not finite."""
        A, b = self.rows(eta)
        if not (np.isfinite(A).all() and np.isfinite(b).all()):
            return np.full(len(b), np.inf)
        return by.white(self._solved(eta, by)[0].residual)

    def _jacobian(self, eta: np.ndarray, by: Weights) -> np.ndarray:
        """Derivative of ``_residual``, that of the projection left out."""
        found, free = self._solved(eta, by)
        theta = self.unknowns.theta(found.theta)
        A = by.white(self.reduced(*self.rows(eta))[0][:, free])
        S = by.white(self.coarser.slopes(eta, theta, released=False))
        U, s, _ = np.linalg.svd(A, full_matrices=False)
        U = U[:, s > 1e-12 * s.max(initial=0.0)]
        return np.asarray(U @ (U.T @ S) - S)

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
