"""One probe made ready: its fitted motion, test fields, windows and forces; rows on demand."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import interp1d

from form_drake.laws import Law, Values
from form_drake.motion import Body, Fit, Motion, Sampling
from form_drake.motion.motion import Displacement
from form_drake.weak.balance import Along, balance
from form_drake.weak.fields import Fields
from form_drake.weak.force import Force
from form_drake.weak.integrals import runs
from form_drake.weak.release import released
from form_drake.weak.stress import elastic_part, unit_stresses
from form_drake.weak.system import Row
from form_drake.weak.windows import Windows


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
        own = self.stretched(law, values, theta)
        if motion is not self.motion:
            own = released(law, motion.F, values, theta, self.released, own)
        return replace(motion, F=own)

    def stretched(self, law: Law, values: Values, theta: np.ndarray) -> np.ndarray:
        """F of its own motion with the stretches that the law chooses; the last are remembered."""
        key = (law.name, tuple(values.items()), theta.tobytes())
        if key not in self._stretches:
            self._stretches.clear()
            F = released(law, self.motion.F, values, theta, self.released)
            self._stretches[key] = F
        return self._stretches[key]

    @cached_property
    def _stretches(self) -> dict[tuple[Any, ...], np.ndarray]:
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
        elastic = self.elastic(law, values, along.motion)
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
                power = self.powers(self.forces[tool], end, forces[tool])
                done += self.impulses[tool] @ power.sum(axis=-1)
            found.append(done)
        return np.asarray(np.concatenate(found, axis=1).ravel()[self.keep])

    def sizes(self, motion: Motion, law: Law, values: Values, acting: np.ndarray) -> np.ndarray:
        """Integrals of V |T_k| |grad psi| over the windows, arguments and shape as ``columns``."""
        looks = np.unique(np.linspace(0, len(motion.time) - 1, 24).astype(int))
        elastic = self.elastic(law, values, motion)[looks]
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

    def elastic(self, law: Law, values: Values, motion: Motion) -> np.ndarray:
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
    def impulses(self) -> dict[str, np.ndarray]:
        return {k: f.impulses(self.windows.ends) for k, f in self.forces.items()}

    def powers(self, force: Force, end: np.ndarray, value: np.ndarray) -> np.ndarray:
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

    def drawn(self, rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Noise of the coefficients of the fit [m] and of the forces [N]."""
        push = {k: f.noise * rng.standard_normal(f.value.shape) for k, f in self.forces.items()}
        return self.fit.draw(rng), push
