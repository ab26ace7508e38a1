"""A measured motion as effects read it: what each source adds to the rows of its balance."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from form_drake.effects.effect import Change
from form_drake.identify.problem import Problem
from form_drake.laws import ADDITIONS, Law, Values, law_named
from form_drake.laws.memory import Memory, history, remembered
from form_drake.motion import Motion, Sampling
from form_drake.weak.balance import Along, balance
from form_drake.weak.contact import HeldFields
from form_drake.weak.integrals import Fixed
from form_drake.weak.kernels import gathering, loaded
from form_drake.weak.probe import Probe
from form_drake.weak.ready import beside, quadrature_cells, unfolded
from form_drake.weak.stress import elastic_part, unit_stresses

STEP = 1e-4  # of a displacement, in differences
CELLS = 5  # of the quadrature along the least edge of a body, at least: what is sought may be small


@dataclass(frozen=True)
class ProbeReading:
    """One probe at identified values; see ``form_drake.effects.Reading``.

    Attributes:
        probe: of a recording.
        law: that was identified.
        values: of its parameters.
    """

    probe: Probe
    law: Law
    values: Values

    @classmethod
    def of(cls, problem: Problem, values: Mapping[str, float]) -> "tuple[ProbeReading, ...]":
        """One for each probe of a problem."""
        law = problem.unknowns.law
        return tuple(cls(_finely(probe), law, dict(values)) for probe in problem.probes)

    @cached_property
    def motion(self) -> Motion:
        """With the stretches that the law chooses along traction-free directions."""
        theta = self.law.theta(self.values)
        return self.probe.released_motion(self.law, self.values, self.probe.motion, theta)

    @property
    def X(self) -> np.ndarray:
        return self.motion.X

    @property
    def v(self) -> np.ndarray:
        return self.motion.v

    @property
    def gravity(self) -> np.ndarray:
        return self.probe.gravity

    def stress(self, tau: np.ndarray) -> np.ndarray:
        return self._kept(self._along.stress(tau[None], self._chi)[0])

    def ready(self, effects: Iterable[str]) -> None:
        """Load the kernels that columns of effects need, for all copies of the process."""
        added = (gathering(self._with(name)) for name in set(effects) & ADDITIONS.keys())
        for kernel in (history(), *added):
            loaded(kernel)

    def _with(self, name: str) -> Law:
        return law_named(f"{self.law.name}+{name}")

    def added(self, name: str, values: Values) -> np.ndarray:
        law = self._with(name)
        (key,) = [t.key for t in law.terms if t.key not in self.law.keys]
        whole = {**self.values, **values, key: 1.0}
        return self._kept(self._along.work(law, self._elastic, whole, self._chi)[-1])

    def now(self) -> np.ndarray:
        return self.stretched(1.0)

    def shared(self, share: np.ndarray) -> np.ndarray:
        if self._stress_by_point is None:
            return self.stress(share[:, None, None] * self.now())
        return np.asarray(self._stress_by_point @ share)

    @cached_property
    def _stress_by_point(self) -> np.ndarray | None:
        chi, now = self.probe.windows.chi, self.now()
        return self._by_point(lambda family: family.stress_by_point(now, chi))

    @cached_property
    def _mass_by_point(self) -> np.ndarray | None:
        windows = self.probe.windows
        found = self._by_point(lambda family: family.mass_by_point(windows.chi, windows.rate))
        return None if found is None else found * self.scale

    def _by_point(self, parts: Callable[[Fixed], np.ndarray]) -> np.ndarray | None:
        """Rows as sums over points, where all fields are fixed, shape [rows, points]."""
        families = [f for f in self._along.families if isinstance(f, Fixed)]
        if len(families) < len(self._along.families):
            return None
        found = np.concatenate([parts(f) for f in families], axis=1)
        return np.asarray(found.reshape(-1, found.shape[-1])[self.probe.keep])

    def remembered(self, memory: Memory) -> np.ndarray:
        motion = self.motion
        part = remembered(motion.F, motion.time, memory)
        return self._work(part) - self.once("work", lambda: self._work(motion.F))

    def stretched(self, factor: float) -> np.ndarray:
        return self._law(factor * self._elastic)

    def _law(self, F: np.ndarray) -> np.ndarray:
        """Its Kirchhoff stress at elastic deformation gradients [Pa]."""
        motion = self.motion
        T = unit_stresses(self.law, F, motion.L, self.values, motion.pressure)
        found: np.ndarray = np.tensordot(self.law.theta(self.values), T, axes=1)
        return found

    def _work(self, F: np.ndarray) -> np.ndarray:
        """What that does in the rows."""
        work = self._along.work(self.law, F, self.values, self._chi)
        return self._kept(np.tensordot(self.law.theta(self.values), work, axes=1))

    def load(self, per_mass: np.ndarray) -> np.ndarray:
        still = replace(self.motion, body_force=per_mass, v=0.0 * self.v, pressure=None)
        return -self._masses(still, np.zeros(3))

    @property
    def m(self) -> np.ndarray:
        found: np.ndarray = self.probe.body.density * self.motion.volume
        return found

    def mass(self, m: np.ndarray) -> np.ndarray:
        if self._mass_by_point is not None:
            return -np.asarray(self._mass_by_point @ m)
        scaled = replace(self.motion, mass=m * self.scale, pressure=None)
        return -self._masses(scaled, self.gravity)

    @property
    def scale(self) -> float:
        """By how much a quasi-static scene has more mass."""
        return float(self.motion.mass.sum() / self.m.sum())

    def once(self, name: str, make: Callable[[], np.ndarray]) -> np.ndarray:
        if name not in self._made:
            self._made[name] = make()
        return self._made[name]

    @cached_property
    def _made(self) -> dict[str, np.ndarray]:
        return {}

    def force(self, change: Change) -> np.ndarray:
        forces = self.probe.forces.items()
        return self.probe.pushed(self._along, {k: change(f.time, f.value) for k, f in forces})

    def moved(self, displacement: Change) -> np.ndarray:
        probe = self.probe
        size = STEP * float(np.ptp(self.X, axis=0).max())

        def rows(sign: float) -> np.ndarray:
            motion = _displaced(probe.motion, displacement, sign * size)
            theta = self.law.theta(self.values)
            along = probe.along(probe.released_motion(self.law, self.values, motion, theta))
            every = np.ones(len(theta), dtype=bool)
            return probe.columns(along, self.law, self.values, every) @ theta - probe.rest(
                along, {}
            )

        return (rows(1.0) - rows(-1.0)) / (2.0 * size)

    @cached_property
    def _elastic(self) -> np.ndarray:
        return elastic_part(self.law, self.motion.F, self.law.radius_vector(self.values))

    @cached_property
    def _along(self) -> Along:
        return self.probe.along(self.motion)

    @property
    def _chi(self) -> np.ndarray:
        return self.probe.windows.chi

    def _kept(self, rows: np.ndarray) -> np.ndarray:
        found: np.ndarray = rows.reshape(-1)[self.probe.keep]
        return found

    def _masses(self, motion: Motion, gravity: np.ndarray) -> np.ndarray:
        """Weight and inertia, b of the balance without forces on tools [N m s]."""
        chi, rate, found = self.probe.windows.chi, self.probe.windows.rate, []
        for family in self.probe.fields:
            if isinstance(family, HeldFields):
                found.append(np.zeros((len(chi), len(family.names))))
                continue
            r = balance(family, motion, gravity).rest
            found.append(chi @ (r.load + r.carried) + rate @ r.momentum)
        return self._kept(np.concatenate(found, axis=1))


def _finely(probe: Probe) -> Probe:
    """The same rows by a quadrature that a part of the body cannot slip through."""
    motion = probe.motion
    supplied = motion.pressure is not None or motion.body_force is not None
    if supplied or not all(f.fixed for f in probe.fields):
        return probe
    body, cells = probe.body, quadrature_cells(probe.fit.space, probe.fields, probe.body)
    widest = float((body.high - body.low).min()) / CELLS
    for n, ends in enumerate(cells):
        parts = np.ceil(np.diff(ends) / widest - 1e-6).astype(int)
        inner = [
            np.linspace(a, b, k + 1)[:-1] for a, b, k in zip(ends, ends[1:], parts, strict=False)
        ]
        cells[n] = np.append(np.concatenate(inner), ends[-1])
    X, volume = beside(*body.gauss(cells, 2), probe.fields)
    density = float(motion.mass.sum() / motion.volume.sum())
    made = Sampling.of(probe.fit, probe.windows.time, X, volume, density)
    return replace(probe, sampling=unfolded(made, probe.fit))


def _displaced(motion: Motion, displacement: Change, size: float) -> Motion:
    """The motion of points that are seen elsewhere by ``size`` times ``displacement``.

    ``displacement`` is affine in x.
    """
    x, X = motion.x, motion.X
    origin = displacement(X, np.zeros_like(x[:1, :1]))
    turn = np.stack(
        [displacement(X, np.eye(3)[d] + np.zeros_like(x[:1, :1])) - origin for d in range(3)],
        axis=-1,
    )[0, 0]
    more = np.eye(3) + size * turn
    inverse = np.linalg.inv(more)
    return replace(
        motion,
        x=x + size * displacement(X, x),
        v=motion.v @ more.T,
        F=more @ motion.F,
        L=more @ motion.L @ inverse,
    )
