"""Integrals of one family of test fields along a motion, see ``form_drake.weak.balance``."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from form_drake.motion import Motion
from form_drake.weak.contact import STIFFNESS
from form_drake.weak.curl import CurlFields
from form_drake.weak.fields import Fields

KEPT = 2**24  # entries of the gradients at all times, up to which they are remembered
TOGETHER = 2**17  # entries of the gradients that are found at once


@dataclass(frozen=True)
class Rest:
    """What is integrated beside the stress, at the times of a motion.

    Attributes:
        load: shape [times, fields] [N m].
        momentum: shape [times, fields] [N m s].
        carried: shape [times, fields] [N m].
    """

    load: np.ndarray
    momentum: np.ndarray
    carried: np.ndarray


class Balance(Protocol):
    """Integrals of one family of test fields along one motion."""

    @property
    def fields(self) -> Fields: ...

    @property
    def motion(self) -> Motion: ...

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        """Integrals of a stress over windows [N m s per unit], shape [windows, fields].

        Args:
            T: Kirchhoff stress, shape [times, points, 3, 3].
            chi: the windows [s], shape [windows, times].
        """
        ...

    @property
    def rest(self) -> Rest:
        """All the other integrals, at every time."""
        ...


def forces(motion: Motion, gravity: np.ndarray) -> np.ndarray:
    """Weight and body force of every point [N], shape [times, points, 3]."""
    body = gravity if motion.body_force is None else gravity + motion.body_force
    return np.broadcast_to(motion.mass[:, None] * body, motion.x.shape)


def runs(motion: Motion, fields: Fields) -> list[slice]:
    """Times of a motion in runs at which the gradients of fields stay in the cache."""
    count = max(1, TOGETHER // (9 * len(fields.names) * len(motion.X)))
    return [slice(n, n + count) for n in range(0, len(motion.time), count)]


def _pull(motion: Motion) -> np.ndarray:
    """V F^-T, shape [times, points, 3, 3]."""
    return np.asarray(motion.volume[:, None, None] * motion.inverse.swapaxes(-1, -2))


def _flat(a: np.ndarray) -> np.ndarray:
    return a.reshape(len(a), -1)


def _against(weights: np.ndarray, integrand: np.ndarray) -> np.ndarray:
    """Sums over points and components, shape [times, fields]."""
    found: np.ndarray = (weights @ _flat(integrand).T).T
    return found


def _each(weights: np.ndarray, integrand: np.ndarray) -> np.ndarray:
    """Sums over points and components with weights of every time, shape [times, fields]."""
    times, fields = weights.shape[:2]
    flat = weights.reshape(times, fields, -1) @ integrand.reshape(times, -1, 1)
    found: np.ndarray = flat[..., 0]
    return found


@dataclass(frozen=True)
class Fixed:
    """Material fields that no motion changes."""

    fields: Fields
    motion: Motion
    gravity: np.ndarray

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray]:
        sampled = self.fields.at(self.motion.at(slice(0, 1)))
        return _flat(sampled.value[0]), _flat(sampled.gradient[0])

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        return self.paired((chi @ _flat(T @ _pull(self.motion))).reshape(len(chi), -1, 3, 3))

    def paired(self, met: np.ndarray) -> np.ndarray:
        """Sums of V T F^-T, shape [..., points, 3, 3], against the gradients, shape [..., fields]."""
        found: np.ndarray = met.reshape(*met.shape[:-3], -1) @ self._tables[1].T
        return found

    @cached_property
    def rest(self) -> Rest:
        (value, gradient), motion = self._tables, self.motion
        load = _against(value, forces(motion, self.gravity))
        if motion.pressure is not None:
            supplied = (motion.J * motion.pressure)[:, :, None, None]
            load = load + _against(gradient, supplied * _pull(motion))
        momentum = _against(value, motion.mass[:, None] * motion.v)
        return Rest(load, momentum, np.zeros_like(momentum))

    def stress_by_point(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        """The parts of ``stress`` that its points give, shape [windows, fields, points]."""
        met = (chi @ _flat(T @ _pull(self.motion))).reshape(len(chi), -1, 9)
        return _by_point(met, self._tables[1])

    def mass_by_point(self, chi: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Weight and inertia of a unit mass at every point [m/s], shape [windows, fields, points]."""
        v = self.motion.v
        met = (rate @ _flat(v)).reshape(len(chi), -1, 3)
        return _by_point(met + chi.sum(axis=1)[:, None, None] * self.gravity, self._tables[0])


@dataclass(frozen=True)
class Held(Fixed):
    """How far faces have gone, in place of a balance."""

    def paired(self, met: np.ndarray) -> np.ndarray:
        return np.zeros((*met.shape[:-3], len(self.fields.names)))

    @cached_property
    def rest(self) -> Rest:
        gone = STIFFNESS * _against(self._tables[0], self.motion.x - self.motion.X)
        return Rest(gone, np.zeros_like(gone), np.zeros_like(gone))

    def stress_by_point(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        return np.zeros((len(chi), len(self.fields.names), len(self.motion.X)))

    def mass_by_point(self, chi: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return self.stress_by_point(self.motion.F, chi)


def _by_point(met: np.ndarray, weights: np.ndarray) -> np.ndarray:
    table = weights.reshape(len(weights), *met.shape[1:])
    found: np.ndarray = np.einsum("wpk,fpk->wfp", met, table, optimize=True)
    return found


@dataclass(frozen=True)
class Moving:
    """Fields that are sampled anew at every time, some times together."""

    fields: Fields
    motion: Motion
    gravity: np.ndarray

    @cached_property
    def _runs(self) -> list[slice]:
        return runs(self.motion, self.fields)

    @cached_property
    def _kept(self) -> dict[int, np.ndarray]:
        return {}

    def _gradient(self, own: slice, sampled: np.ndarray | None = None) -> np.ndarray:
        """Gradients in a run of times, shape [times, fields, points, 3, 3]."""
        if own.start in self._kept:
            return self._kept[own.start]
        if sampled is None:
            sampled = self.fields.at(self.motion.at(own)).gradient
        if sampled.size * len(self._runs) <= KEPT:
            self._kept[own.start] = sampled
        return sampled

    def _met(self, tau: np.ndarray) -> np.ndarray:
        """What a gradient meets of a Kirchhoff stress: V tau, or V tau F^-T along X."""
        if self.fields.material:
            return np.asarray(tau @ _pull(self.motion))
        return np.asarray(tau * self.motion.volume[:, None, None])

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        met = self._met(T)
        found = [_each(self._gradient(own), met[own]) for own in self._runs]
        return np.asarray(chi @ np.concatenate(found))

    @cached_property
    def rest(self) -> Rest:
        motion, parts = self.motion, []
        weight, impulse = forces(motion, self.gravity), motion.mass[:, None] * motion.v
        flux = motion.v[..., :, None] * impulse[..., None, :]
        supplied = None
        if motion.pressure is not None:
            supplied = self._met((motion.J * motion.pressure)[..., None, None] * np.eye(3))
        for own in self._runs:
            sampled = self.fields.at(motion.at(own))
            gradient = self._gradient(own, sampled.gradient)
            load = _each(sampled.value, weight[own])
            if supplied is not None:
                load += _each(gradient, supplied[own])
            momentum = _each(sampled.value, impulse[own])
            carried = np.zeros_like(momentum)
            if sampled.rate is not None:
                carried += _each(sampled.rate, impulse[own])
            if not self.fields.material:
                carried += _each(gradient, flux[own])
            parts.append((load, momentum, carried))
        return Rest(*(np.concatenate(p) for p in zip(*parts, strict=True)))


@dataclass(frozen=True)
class Curled:
    """psi = F w / J: the motion is moved over to stress and forces instead."""

    fields: CurlFields
    motion: Motion
    gravity: np.ndarray

    @cached_property
    def _curls(self) -> tuple[np.ndarray, np.ndarray]:
        w, dw = self.fields.curls(self.motion.X)
        return _flat(w), _flat(dw)

    @cached_property
    def _back(self) -> np.ndarray:
        """F^T / J."""
        return self.motion.F.swapaxes(-1, -2) / self.motion.J[..., None, None]

    @cached_property
    def _growth(self) -> np.ndarray:
        """d log J / dX = F^-1_ki d F_ik / dX, shape [times, points, 3, 1]."""
        found = np.einsum("tqki,tqikc->tqc", self.motion.inverse, self._second, optimize=True)
        return np.asarray(found)[..., None]

    @property
    def _second(self) -> np.ndarray:
        assert self.motion.second is not None
        return self.motion.second

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        (w, dw), motion = self._curls, self.motion
        S = T @ _pull(motion)
        C = self._back @ S
        bent = np.einsum("tqic,tqiac->tqa", S, self._second, optimize=True)
        B = bent / motion.J[..., None] - (C @ self._growth)[..., 0]
        found: np.ndarray = chi @ _flat(B) @ w.T + chi @ _flat(C) @ dw.T
        return found

    @cached_property
    def rest(self) -> Rest:
        motion, (w, _) = self.motion, self._curls

        def vector(f: np.ndarray) -> np.ndarray:
            return _against(w, (self._back @ f[..., None])[..., 0])

        impulse = motion.mass[:, None] * motion.v
        swell = np.trace(motion.L, axis1=2, axis2=3)[..., None]
        carried = (motion.L.swapaxes(-1, -2) @ impulse[..., None])[..., 0] - swell * impulse
        load = vector(forces(motion, self.gravity))  # a supplied pressure cancels
        return Rest(load, vector(impulse), vector(carried))
