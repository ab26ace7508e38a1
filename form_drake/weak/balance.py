"""Spatial integrals of the momentum balance along a motion, and how noise in the motion moves them.

For every test field psi and time t

    stress_k = sum_p V T_k : grad psi        load = sum_p m (g + body force) . psi + V J p div psi
    momentum = sum_p m v . psi               carried = sum_p m v . (d psi / dt along the motion)

so that with a window chi the balance reads (eq. 9 of the paper)

    sum_k theta_k int chi stress_k dt
        = int chi (load + carried) + chi' momentum dt + int chi (force on the body) . psi dt.

V is the reference volume and T_k a Kirchhoff stress; material fields pair with the first Piola
stress T_k F^-T, so that their integrals are one matrix product over all times.
"""

from dataclasses import dataclass

import numpy as np

from form_drake.motion import Motion
from form_drake.weak.curl import CurlFields
from form_drake.weak.fields import Fields


@dataclass(frozen=True)
class Series:
    """Integrals of one family of fields at the times of a motion.

    Attributes:
        stress: shape [terms, times, fields] [N m per unit].
        load: shape [times, fields] [N m].
        momentum: shape [times, fields] [N m s].
        carried: shape [times, fields] [N m].
    """

    stress: np.ndarray
    load: np.ndarray
    momentum: np.ndarray
    carried: np.ndarray


def series(fields: Fields, motion: Motion, T: np.ndarray, gravity: np.ndarray) -> Series:
    """Integrals of the balance.

    Args:
        fields: test fields.
        motion: of the body.
        T: Kirchhoff stress per unit of each term, shape [terms, times, points, 3, 3].
        gravity: [m/s^2], shape [3].
    """
    if isinstance(fields, CurlFields):
        return _transformed(fields, motion, T, gravity)
    return (_fixed if fields.fixed else _moving)(fields, motion, T, gravity)


def forces(motion: Motion, gravity: np.ndarray) -> np.ndarray:
    """Weight and body force of every point [N], shape [times, points, 3]."""
    body = gravity if motion.body_force is None else gravity + motion.body_force
    return np.broadcast_to(motion.mass[:, None] * body, motion.x.shape)


def pressures(motion: Motion) -> np.ndarray | None:
    """V J p of a supplied pressure [N m], shape [times, points]."""
    if motion.pressure is None:
        return None
    found: np.ndarray = motion.volume * motion.J * motion.pressure
    return found


def _flat(a: np.ndarray) -> np.ndarray:
    return a.reshape(len(a), -1)


def _fixed(fields: Fields, motion: Motion, T: np.ndarray, gravity: np.ndarray) -> Series:
    sampled = fields.at(motion.frame(0))
    value, gradient = _flat(sampled.value), _flat(sampled.gradient)
    volume, transposed = motion.volume[:, None, None], motion.inverse.swapaxes(-1, -2)

    def against(weights: np.ndarray, integrand: np.ndarray) -> np.ndarray:
        found: np.ndarray = (weights @ _flat(integrand).T).T
        return found

    stress = np.stack([against(gradient, volume * (Tk @ transposed)) for Tk in T])
    load = against(value, forces(motion, gravity))
    supplied = pressures(motion)
    if supplied is not None:
        load = load + against(gradient, supplied[:, :, None, None] * transposed)
    momentum = against(value, motion.mass[:, None] * motion.v)
    return Series(stress, load, momentum, np.zeros_like(momentum))


def _transformed(fields: CurlFields, motion: Motion, T: np.ndarray, gravity: np.ndarray) -> Series:
    """``_moving`` for psi = F w / J: the motion is moved over to stress and forces instead."""
    assert motion.second is not None
    w, dw = (_flat(a) for a in fields.curls(motion.X))
    back = motion.F.swapaxes(-1, -2) / motion.J[..., None, None]
    growth = np.einsum("tqki,tqikc->tqc", motion.inverse, motion.second, optimize=True)
    transposed = motion.inverse.swapaxes(-1, -2)

    def against(integrand: np.ndarray, table: np.ndarray) -> np.ndarray:
        found: np.ndarray = (table @ _flat(integrand).T).T
        return found

    def vector(f: np.ndarray) -> np.ndarray:
        return against((back @ f[..., None])[..., 0], w)

    stress = []
    for Tk in motion.volume[:, None, None] * T:
        S = Tk @ transposed
        C = back @ S
        bent = np.einsum("tqic,tqiac->tqa", S, motion.second, optimize=True)
        B = bent / motion.J[..., None] - (C @ growth[..., None])[..., 0]
        stress.append(against(B, w) + against(C, dw))
    impulse = motion.mass[:, None] * motion.v
    swell = np.trace(motion.L, axis1=2, axis2=3)[..., None]
    carried = (motion.L.swapaxes(-1, -2) @ impulse[..., None])[..., 0] - swell * impulse
    load = vector(forces(motion, gravity))  # a supplied pressure cancels
    return Series(np.array(stress), load, vector(impulse), vector(carried))


def _moving(fields: Fields, motion: Motion, T: np.ndarray, gravity: np.ndarray) -> Series:
    shape = (len(motion.time), len(fields.names))
    stress = np.empty((len(T), *shape))
    load, momentum, carried = np.empty(shape), np.empty(shape), np.empty(shape)
    weight, supplied = forces(motion, gravity), pressures(motion)
    impulse = motion.mass[:, None] * motion.v
    scaled = motion.volume[:, None, None] * T
    pull = np.broadcast_to(np.eye(3), motion.F.shape)
    if fields.material:
        pull = motion.inverse.swapaxes(-1, -2)
        scaled = scaled @ pull
    for n in range(len(motion.time)):
        sampled = fields.at(motion.frame(n))
        value, gradient = _flat(sampled.value), _flat(sampled.gradient)
        stress[:, n] = (gradient @ _flat(scaled[:, n]).T).T
        load[n] = value @ weight[n].ravel()
        if supplied is not None:
            load[n] += gradient @ (supplied[n][:, None, None] * pull[n]).ravel()
        momentum[n] = value @ impulse[n].ravel()
        carried[n] = 0.0 if sampled.rate is None else _flat(sampled.rate) @ impulse[n].ravel()
        if not fields.material:
            carried[n] += gradient @ (impulse[n][:, :, None] * motion.v[n][:, None, :]).ravel()
    return Series(stress, load, momentum, carried)
