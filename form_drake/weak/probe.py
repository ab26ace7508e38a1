"""One probe made ready: its fitted motion, test fields, windows and forces; rows on demand."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import interp1d

from form_drake.laws import Law, Values
from form_drake.motion import Body, Fit, Motion, Sampling
from form_drake.motion.motion import Displacement, inverse
from form_drake.motion.smoothing import Spread
from form_drake.weak.balance import Along, balance
from form_drake.weak.covariance import Past, track_noise
from form_drake.weak.fields import Fields
from form_drake.weak.force import Force
from form_drake.weak.history import lasting as lasting_rows
from form_drake.weak.integrals import runs
from form_drake.weak.noise import Bases, Slopes, slopes
from form_drake.weak.release import released
from form_drake.weak.stress import elastic_part, unit_stresses
from form_drake.weak.system import Row
from form_drake.weak.tangent import State, Tangent, tangent, under
from form_drake.weak.windows import Windows

POINTS = 2**15  # at all times together, whose stresses are differentiated at once
LOOKS = 6  # most times in a window at which the noise is linearised
# share of a row's variance that its linearisation misses: without it, rows that few independent
# noises drive would be combined into ones that claim to hold no noise at all
INEXACT = 0.03


@dataclass(frozen=True)
class Probe:
    """What the rows of one recording are made of.

    Attributes:
        name: of the probe.
        body: the specimen.
        fit: of the tracks.
        sampling: where it is evaluated.
        rough: fewer points, enough for a first search and for draws of noise.
        fields: families of test fields.
        windows: in time.
        forces: measured, by tool.
        gravity: [m/s^2], shape [3].
        keep: which rows are used, windows outermost, shape [windows * fields].
        released: traction-free material directions, see ``form_drake.weak.release``.
    """

    name: str
    body: Body
    fit: Fit
    sampling: Sampling
    rough: Sampling
    fields: tuple[Fields, ...]
    windows: Windows
    forces: dict[str, Force]
    gravity: np.ndarray
    keep: np.ndarray
    released: tuple[int, ...] = ()

    @cached_property
    def motion(self) -> Motion:
        """The motion of the fit."""
        return self.sampling.moved(self._displacement)

    @cached_property
    def _displacement(self) -> Displacement:
        return self.sampling.displaced(self.fit.c)

    def disturbed(self, change: Displacement, share: float) -> Motion:
        """The motion with a share of an error of its displacement."""
        return self.sampling.moved(self._displacement.plus(share, change))

    @property
    def coarser(self) -> "Probe":
        """The same rows, evaluated at the fewer points."""
        return replace(self, sampling=self.rough)

    def released_motion(
        self, law: Law, values: Values, motion: Motion, theta: np.ndarray
    ) -> Motion:
        """The motion with the stretches that the law chooses, see ``form_drake.weak.release``."""
        if not self.released:
            return motion
        own = self._released(law, values, theta)
        if motion is not self.motion:
            own = released(law, motion.F, values, theta, self.released, own)
        return replace(motion, F=own)

    def _released(self, law: Law, values: Values, theta: np.ndarray) -> np.ndarray:
        """F of its own motion with the stretches that the law chooses; the last are remembered."""
        key = (law.name, tuple(values.items()), theta.tobytes())
        if key not in self._stretched:
            self._stretched.clear()
            F = released(law, self.motion.F, values, theta, self.released)
            self._stretched[key] = F
        return self._stretched[key]

    @cached_property
    def _stretched(self) -> dict[tuple[Any, ...], np.ndarray]:
        return {}

    def along(self, motion: Motion) -> Along:
        """The integrals of every family of fields along a motion."""
        return self._still if motion is self.motion else self._along(motion)

    @cached_property
    def _still(self) -> Along:
        return self._along(self.motion)

    def _along(self, motion: Motion) -> Along:
        return Along(tuple(balance(f, motion, self.gravity) for f in self.fields))

    def columns(self, along: Along, law: Law, values: Values, acting: np.ndarray) -> np.ndarray:
        """A at the constants ``values``, shape [rows, terms]; a plastic law's radius follows from them.

        Args:
            along: every family of fields along a motion.
            law: whose terms are the columns.
            values: its constants.
            acting: which columns are wanted; the others are zero.
        """
        elastic = self._elastic(law, values, along.motion)
        work = along.work(law, elastic, values, self.windows.chi)[acting]
        A = np.zeros((len(self.keep), len(acting)))
        A[:, acting] = np.moveaxis(work, 0, -1).reshape(len(A), -1)
        return A[self.keep]

    def rest(self, along: Along, push: dict[str, np.ndarray]) -> np.ndarray:
        """b, shape [rows], with noise ``push`` added to the forces [N], by tool."""
        chi, rate = self.windows.chi, self.windows.rate
        rests = [family.rest for family in along.families]
        found = [chi @ (r.load + r.carried) + rate @ r.momentum for r in rests]
        pushed = {k: force.value + push.get(k, 0.0) for k, force in self.forces.items()}
        return np.concatenate(found, axis=1).ravel()[self.keep] - self.pushed(along, pushed)

    def pushed(self, along: Along, forces: dict[str, np.ndarray]) -> np.ndarray:
        """What forces on tools [N] do, by tool at the stamps of the recorded ones, shape [rows]."""
        found = []
        for family in along.families:
            done = np.zeros((len(self.windows), len(family.fields.names)))
            for tool, end in family.fields.acting(family.motion).items():
                power = self._powers(self.forces[tool], end, forces[tool])
                done += self._impulses[tool] @ power.sum(axis=-1)
            found.append(done)
        return np.asarray(np.concatenate(found, axis=1).ravel()[self.keep])

    def sizes(self, motion: Motion, law: Law, values: Values, acting: np.ndarray) -> np.ndarray:
        """Integrals of V |T_k| |grad psi| over the windows, arguments and shape as ``columns``."""
        looks = np.unique(np.linspace(0, len(motion.time) - 1, 24).astype(int))
        elastic = self._elastic(law, values, motion)[looks]
        part = motion.at(looks)
        T = unit_stresses(law, elastic, part.L, values, part.pressure)[acting]
        parts = [self._sizes(f, motion, T, looks) for f in self.fields]
        found = np.zeros((len(self.keep), len(acting)))
        found[:, acting] = np.concatenate(parts, axis=1).reshape(-1, len(T))
        return found[self.keep]

    @cached_property
    def labels(self) -> tuple[Row, ...]:
        """Of the rows."""
        every = [
            Row((float(a), float(z)), n, self.name)
            for a, z in self.windows.ends
            for f in self.fields
            for n in f.names
        ]
        return tuple(every[n] for n in np.flatnonzero(self.keep))

    def _elastic(self, law: Law, values: Values, motion: Motion) -> np.ndarray:
        """Elastic deformation gradients along a motion; the last along its own are remembered."""
        r = law.radius_vector(values)
        if motion is not self.motion:
            return elastic_part(law, motion.F, r)
        key = (law.name, r.tobytes())
        if key not in self._histories:
            self._histories.clear()
            self._histories[key] = elastic_part(law, motion.F, r)
        return self._histories[key]

    @cached_property
    def _histories(self) -> dict[tuple[str, bytes], np.ndarray]:
        return {}

    @cached_property
    def _impulses(self) -> dict[str, np.ndarray]:
        return {k: f.impulses(self.windows.ends) for k, f in self.forces.items()}

    def _powers(self, force: Force, end: np.ndarray, value: np.ndarray) -> np.ndarray:
        """f_d psi_d at the stamps of a force, shape [samples, fields, 3]."""
        at = np.clip(force.time, self.windows.time[0], self.windows.time[-1])
        psi = interp1d(self.windows.time, end, axis=0, assume_sorted=True)(at)
        found: np.ndarray = psi * value[:, None, :]
        return found

    def _sizes(
        self, fields: Fields, motion: Motion, T: np.ndarray, looks: np.ndarray
    ) -> np.ndarray:
        S = T @ motion.inverse[looks].swapaxes(-1, -2) if fields.material else T
        size = motion.volume * np.sqrt(np.sum(S**2, axis=(-1, -2)))
        own = motion.at(looks)
        gradients = (fields.at(own.at(run)).gradient for run in runs(own, fields))
        strength = [np.sqrt(np.sum(g**2, axis=(-1, -2))) for g in gradients]
        work = np.concatenate(strength) @ size.transpose(1, 2, 0)
        chi = self.windows.chi
        nearest = np.abs(motion.time[:, None] - motion.time[looks]).argmin(axis=1)
        share = np.stack([chi[:, nearest == n].sum(axis=1) for n in range(len(looks))], axis=1)
        found: np.ndarray = np.tensordot(share, work, axes=1)
        return found

    def noise(
        self, law: Law, values: Values, theta: np.ndarray, *, lasting: bool = False
    ) -> np.ndarray:
        """Covariance of b - A theta [(N m s)^2] from tracks and forces, kept rows alone.

        Args:
            law: the law.
            values: its constants.
            theta: coefficients of its terms.
            lasting: whether what noise leaves in plastic strain counts, see ``weak.history``. Without
                it errors of F act at their own time alone: rows of slow flow are then held for
                noisier than they are. Never along traction-free directions.
        """
        tracks = self._track_noise(law, values, theta, self.fit.spread, lasting=lasting)
        total = (tracks + self._force_noise())[np.ix_(self.keep, self.keep)]
        found: np.ndarray = total + INEXACT * np.diag(np.diag(total))
        return found

    def doubt(self, law: Law, values: Values, theta: np.ndarray) -> np.ndarray:
        """The same from what no track tells, see ``Fit``, at its own time alone."""
        found: np.ndarray = self._track_noise(law, values, theta, self.fit.doubt)
        return found[np.ix_(self.keep, self.keep)]

    def _track_noise(
        self,
        law: Law,
        values: Values,
        theta: np.ndarray,
        parts: tuple[Spread, ...],
        *,
        lasting: bool = False,
    ) -> np.ndarray:
        motion = self.motion
        rates, unload, own = "rate" in law.needs, None, motion.F
        if law.flow == "plastic":
            elastic = self._elastic(law, values, motion)
            first = np.broadcast_to(np.eye(3), elastic[:1].shape)
            unload = np.concatenate([first, inverse(motion.F[:-1]) @ elastic[:-1]])
        if self.released:
            own = self._released(law, values, theta)

        def tangents(at: np.ndarray, material: bool) -> Tangent:
            state = State(
                own[at],
                motion.L[at],
                unload=None if unload is None else unload[at],
                seen=motion.F[at] if self.released else None,
                axes=self.released,
                pressure=None if motion.pressure is None else motion.pressure[at],
            )
            met = tangent(law, state, values, theta, material=material, rates=rates)
            if state.pressure is None:
                return met
            return under(met, motion.F[at], state.pressure, material=material)

        width = float(np.diff(self.windows.ends, axis=1).min())
        step = float(np.median(np.diff(motion.time)))
        every = max(1, int(np.ceil(width / step / LOOKS - 1e-6)))
        at = np.arange(0, len(motion.time), every)
        bases = Bases.of(self.fit, self.sampling, parts)
        count = max(1, POINTS // len(motion.X))
        blocks = [at[n : n + count] for n in range(0, len(at), count)]
        families = [
            Slopes.joined(
                [slopes(f, motion, b, tangents, self.gravity, rates, bases) for b in blocks]
            )
            for f in self.fields
        ]
        history = []
        if lasting and law.flow == "plastic" and not self.released:
            history = self._history(law, values, theta, bases, every)
        return track_noise(bases, families, every, self.windows, history)

    def _history(
        self, law: Law, values: Values, theta: np.ndarray, bases: Bases, every: int
    ) -> list[Past]:
        """What lasts of the motion in plastic strain, looks of ``every`` times together."""
        motion = self.motion

        def back(trial: np.ndarray, first: int) -> Tangent:
            own = slice(first, first + len(trial))
            p = None if motion.pressure is None else motion.pressure[own]
            state = State(trial, motion.L[own], pressure=p)
            return tangent(law, state, values, theta, elastic=True)

        def pairing(at: slice) -> np.ndarray:
            look, found = motion.at(at), []
            for fields in self.fields:
                gradient = fields.at(look).gradient
                paired = gradient @ look.inverse[:, None] if fields.material else gradient
                found.append(motion.volume[:, None, None] * paired)
            return np.concatenate(found, axis=1)

        elastic = self._elastic(law, values, motion)
        found = lasting_rows(motion.F, elastic, pairing, self.windows.chi, back, POINTS, every)
        return [Past.of(own, bases) for own in found]

    def _force_noise(self) -> np.ndarray:
        counts = [len(f.names) for f in self.fields]
        m, W = sum(counts), len(self.windows)
        total = np.zeros((W * m, W * m))
        acting = [f.acting(self.motion) for f in self.fields]
        for tool, force in self.forces.items():
            none = [np.zeros((len(self.motion.time), n, 3)) for n in counts]
            end = np.concatenate(
                [a.get(tool, z) for a, z in zip(acting, none, strict=True)], axis=1
            )
            psi = self._powers(force, end, np.ones_like(force.value))
            rows = np.einsum("ws,sfd->wfsd", self._impulses[tool], psi, optimize=True)
            rows = rows.reshape(W * m, -1)
            total += force.noise**2 * (rows @ rows.T)
        return total

    @cached_property
    def missed(self) -> np.ndarray:
        """The same from what the motion misses of forces (see ``Force``), beyond their own noise.

        A window whose rows would be off by some amounts, had the motion been made of the force, may be off
        by as much, all alike, and no window tells of another.
        """
        left = {k: 0.0 * f.value if f.missed is None else f.missed for k, f in self.forces.items()}
        off = self.pushed(self.along(self.motion), left)
        noise = np.diag(self._force_noise())[self.keep]
        window = np.flatnonzero(self.keep) // (len(self.keep) // len(self.windows))
        together = window[:, None] == window
        size = np.maximum(together @ off**2, np.finfo(float).tiny)
        beyond = np.maximum(1.0 - together @ noise / size, 0.0)
        return np.asarray(together * beyond * np.outer(off, off))

    def drawn(self, rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Noise of the coefficients of the fit [m] and of the forces [N]."""
        push = {k: f.noise * rng.standard_normal(f.value.shape) for k, f in self.forces.items()}
        return self.fit.draw(rng), push
