"""Spatial integrals of the momentum balance along a motion, and how noise in the motion moves them.

For every test field psi and time t

    stress_k = sum_p V T_k : grad psi        load = sum_p m (g + body force) . psi + V J p div psi
    momentum = sum_p m v . psi               carried = sum_p m v . (d psi / dt along the motion)

so that with a window chi the balance reads (eq. 9 of the paper)

    sum_k theta_k int chi stress_k dt
        = int chi (load + carried) + chi' momentum dt + int chi (force on the body) . psi dt.

V is the reference volume and T_k a Kirchhoff stress; material fields pair with the first Piola
stress T_k F^-T, so that their integrals are one matrix product over all times. All but the stress
integrals are the same for every law, and are found once.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from form_drake.motion import Motion
from form_drake.weak.curl import CurlFields
from form_drake.weak.fields import Fields

KEPT = 2**24  # entries of the gradients at all times, up to which they are remembered


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


def balance(fields: Fields, motion: Motion, gravity: np.ndarray) -> Balance:
    """Integrals of ``fields`` along a motion under ``gravity`` [m/s^2], shape [3]."""
    if isinstance(fields, CurlFields):
        return _Curled(fields, motion, gravity)
    return (_Fixed if fields.fixed else _Moving)(fields, motion, gravity)


@dataclass(frozen=True)
class Along:
    """All families of test fields along one motion.

    Attributes:
        families: integrals of each.
    """

    families: tuple[Balance, ...]

    @property
    def motion(self) -> Motion:
        return self.families[0].motion

    @cached_property
    def _last(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        return {}

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        """As ``Balance.stress``; a search that leaves a term as it was costs nothing for it."""
        for k, Tk in enumerate(T):
            if k not in self._last or not np.array_equal(self._last[k][0], Tk):
                work = [f.stress(Tk, chi) for f in self.families]
                self._last[k] = Tk, np.concatenate(work, axis=1)
        return np.stack([self._last[k][1] for k in range(len(T))])


def forces(motion: Motion, gravity: np.ndarray) -> np.ndarray:
    """Weight and body force of every point [N], shape [times, points, 3]."""
    body = gravity if motion.body_force is None else gravity + motion.body_force
    return np.broadcast_to(motion.mass[:, None] * body, motion.x.shape)


def _flat(a: np.ndarray) -> np.ndarray:
    return a.reshape(len(a), -1)


def _against(weights: np.ndarray, integrand: np.ndarray) -> np.ndarray:
    """Sums over points and components, shape [times, fields]."""
    found: np.ndarray = (weights @ _flat(integrand).T).T
    return found


@dataclass(frozen=True)
class _Fixed:
    """Material fields that no motion changes."""

    fields: Fields
    motion: Motion
    gravity: np.ndarray

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray]:
        sampled = self.fields.at(self.motion.frame(0))
        return _flat(sampled.value), _flat(sampled.gradient)

    @cached_property
    def _pull(self) -> np.ndarray:
        """V F^-T, shape [times, points, 3, 3]."""
        return self.motion.volume[:, None, None] * self.motion.inverse.swapaxes(-1, -2)

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        found: np.ndarray = chi @ _flat(T @ self._pull) @ self._tables[1].T
        return found

    @cached_property
    def rest(self) -> Rest:
        (value, gradient), motion = self._tables, self.motion
        load = _against(value, forces(motion, self.gravity))
        if motion.pressure is not None:
            supplied = (motion.J * motion.pressure)[:, :, None, None]
            load = load + _against(gradient, supplied * self._pull)
        momentum = _against(value, motion.mass[:, None] * motion.v)
        return Rest(load, momentum, np.zeros_like(momentum))


@dataclass(frozen=True)
class _Moving:
    """Fields that are sampled anew at every time."""

    fields: Fields
    motion: Motion
    gravity: np.ndarray

    @cached_property
    def _kept(self) -> dict[int, np.ndarray]:
        return {}

    def _gradient(self, n: int, sampled: np.ndarray | None = None) -> np.ndarray:
        """V grad psi along x at a time, shape [fields, 9 points]."""
        if n in self._kept:
            return self._kept[n]
        motion = self.motion
        gradient = self.fields.at(motion.frame(n)).gradient if sampled is None else sampled
        if self.fields.material:
            gradient = gradient @ motion.inverse[n]
        found = _flat(gradient * motion.volume[:, None, None])
        if found.size * len(motion.time) <= KEPT:
            self._kept[n] = found
        return found

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        found = np.stack([self._gradient(n) @ Tn.ravel() for n, Tn in enumerate(T)])
        return np.asarray(chi @ found)

    @cached_property
    def rest(self) -> Rest:
        motion, fields = self.motion, self.fields
        shape = (len(motion.time), len(fields.names))
        load, momentum, carried = np.empty(shape), np.empty(shape), np.zeros(shape)
        weight, impulse = forces(motion, self.gravity), motion.mass[:, None] * motion.v
        flux = (motion.mass / motion.volume)[:, None, None] * (
            motion.v[..., :, None] * motion.v[..., None, :]
        )
        for n in range(len(motion.time)):
            sampled = fields.at(motion.frame(n))
            value, gradient = _flat(sampled.value), self._gradient(n, sampled.gradient)
            load[n] = value @ weight[n].ravel()
            if motion.pressure is not None:
                supplied = (motion.J[n] * motion.pressure[n])[:, None, None] * np.eye(3)
                load[n] += gradient @ supplied.ravel()
            momentum[n] = value @ impulse[n].ravel()
            if sampled.rate is not None:
                carried[n] = _flat(sampled.rate) @ impulse[n].ravel()
            if not fields.material:
                carried[n] += gradient @ flux[n].ravel()
        return Rest(load, momentum, carried)


@dataclass(frozen=True)
class _Curled:
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
        pull = motion.volume[:, None, None] * motion.inverse.swapaxes(-1, -2)
        S = T @ pull
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
