"""How the stress that a row integrates changes with the motion, all at a point in one kernel."""

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.motion.motion import cofactor, determinant
from form_drake.weak.derivatives import paired, strides, tangents
from form_drake.weak.kernels import constants, loaded, matrices, numbers, real
from form_drake.weak.stress import ALONE
from form_drake.workers import parted

STEP = 1e-6  # of strain, in the differences
SLOWEST = 1e-3  # velocity gradient [1/s] of which a step is a share, where nothing moves faster


@dataclass(frozen=True)
class Tangent:
    """A stress and its derivatives, whose entries come first and those of the matrix last.

    Attributes:
        stress: [Pa], shape [..., 3, 3].
        by_F: shape [..., 9, 3, 3].
        by_L: [Pa s], shape [..., 9, 3, 3]; None: not asked for.
        elastic_by_F: of the elastic deformation gradient, shape [..., 9, 3, 3]; None: not asked for.
    """

    stress: np.ndarray
    by_F: np.ndarray
    by_L: np.ndarray | None = None
    elastic_by_F: np.ndarray | None = None


@dataclass(frozen=True)
class State:
    """Where derivatives are taken, every array of shape [..., 3, 3].

    Attributes:
        F: deformation gradients that the stress is paired with.
        L: velocity gradients [1/s].
        unload: what leads from F to the trial elastic deformation gradient, F times this; None: I.
        seen: F before its columns ``axes`` were stretched until they bear no stress; None: F itself.
        axes: traction-free material directions, see ``form_drake.weak.release``.
        pressure: supplied Cauchy pressure [Pa], shape [...]; None: the law's own.
    """

    F: np.ndarray
    L: np.ndarray
    unload: np.ndarray | None = None
    seen: np.ndarray | None = None
    axes: tuple[int, ...] = ()
    pressure: np.ndarray | None = None


def tangent(
    law: Law,
    at: State,
    values: Values,
    theta: np.ndarray,
    *,
    material: bool = False,
    rates: bool = False,
    elastic: bool = False,
) -> Tangent:
    """Stress of a law and its derivatives by ``at.F``, or by ``at.seen`` where the law stretches it.

    Stretches along traction-free directions follow F such that none gets stress (derivatives of the
    implicit function).

    Args:
        law: the law.
        at: where.
        values: its constants.
        theta: coefficients of its terms.
        material: whether the stress is the first Piola stress tau F^-T instead of Kirchhoff's.
        rates: whether derivatives by L are wanted.
        elastic: whether those of the elastic deformation gradient are.
    """
    shape, count = at.F.shape[:-2], int(np.prod(at.F.shape[:-2]))
    given = [_flat(a) for a in (at.F, at.seen, at.L, at.unload)]
    p = np.zeros(0) if at.pressure is None else at.pressure.ravel()
    out = [np.empty((count if on else 0, 9, 9)) for on in (True, rates, elastic)]
    stress = np.empty((count, 3, 3))
    speed = STEP * max(float(np.abs(at.L).max(initial=0.0)), SLOWEST)
    own, kernel, pair = constants(law, values, theta), loaded(tangents(law)), loaded(paired)
    axes = wp.vec2i(*(*at.axes, -1, -1)[:2])

    def part(some: slice) -> None:
        F, seen, *held = (matrices(a[some]) for a in given)
        tau = matrices(stress[some])
        found = [wp.empty(a[some].shape, dtype=real, device="cpu") for a in out]
        steps = [real(STEP), real(speed), 9]
        inputs = [F, *held, numbers(p[some]), *own, *steps, tau, *found]
        wp.launch(kernel, len(tau), inputs, device="cpu")
        if material or at.seen is not None:
            inputs = [F, seen, axes, int(material), 9, tau, *found[:2]]
            wp.launch(pair, len(tau), inputs, device="cpu")
        stress[some] = tau.numpy()
        for a, f in zip(out, found, strict=True):
            a[some] = f.numpy()

    parted(part, count, ALONE // 8)
    by_F, by_L, by_trial = (a.reshape(-1, *shape[1:], 9, 3, 3) if len(a) else None for a in out)
    assert by_F is not None
    return Tangent(stress.reshape(*shape, 3, 3), by_F, by_L, by_trial)


def under(met: Tangent, F: np.ndarray, pressure: np.ndarray, *, material: bool = False) -> Tangent:
    """A stress and its derivatives beside a Cauchy pressure that does not change with F.

    Args:
        met: the stress alone, at ``F``.
        F: deformation gradients, shape [..., 3, 3].
        pressure: [Pa], shape [...].
        material: as of ``tangent``.
    """
    C, J = cofactor(F), determinant(F)[..., None, None]
    p, one = pressure[..., None, None], np.eye(3)
    if material:  # -J p F^-T
        G = C / J
        stress = met.stress - p * C
        slope = np.einsum("...ij,...kl->...ijkl", G, C) - np.einsum("...il,...kj->...ijkl", G, C)
    else:
        stress = met.stress - p * J * one
        slope = np.einsum("ij,...kl->...ijkl", one, C)
    return replace(met, stress=stress, by_F=met.by_F - p[..., None] * slope.reshape(met.by_F.shape))


def stride(
    law: Law,
    F: np.ndarray,
    before: np.ndarray,
    elastic: np.ndarray,
    values: Values,
    theta: np.ndarray,
    *,
    slopes: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """First Piola stress after F has moved on from a state, and the elastic part of F then.

    Args:
        law: the law.
        F: deformation gradients after the stride, shape [points, 3, 3].
        before: those before it.
        elastic: their elastic parts.
        values: constants of the law.
        theta: coefficients of its terms.
        slopes: whether derivatives are wanted.

    Returns:
        Stress [Pa] and elastic part, shape [points, 3, 3], and dP_ij / dF_kl, shape [points, 9, 9].
    """
    own, kernel = constants(law, values, theta), loaded(strides(law))
    P, after = np.empty(F.shape), np.empty(F.shape)
    by_F = np.empty((len(F) if slopes else 0, 9, 9))

    def part(some: slice) -> None:
        held = [matrices(a[some]) for a in (F, before, elastic)]
        out = [matrices(a[some]) for a in (P, after)]
        by = wp.empty(by_F[some].shape, dtype=real, device="cpu")
        wp.launch(kernel, len(out[0]), [*held, *own, real(STEP), 7, *out, by], device="cpu")
        P[some], after[some], by_F[some] = (a.numpy() for a in (*out, by))

    parted(part, len(F), ALONE // 8 if slopes else ALONE // 2)
    return P, after, by_F if slopes else None


def _flat(a: np.ndarray | None) -> np.ndarray:
    return np.zeros((0, 3, 3)) if a is None else a.reshape(-1, 3, 3)
