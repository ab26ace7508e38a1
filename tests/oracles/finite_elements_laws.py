"""Laws of the reference finite elements: first Piola-Kirchhoff stress P(F) and A = dP/dF [Pa].

All arrays carry one item per Gauss point. tau = P F^T is the Kirchhoff stress, mu = E/(2(1 + nu)),
lam = E nu/((1 + nu)(1 - 2 nu)).

``von_mises`` is Hencky elasticity in the elastic part of F = F_e F_p with the exponential-map
return. The state between steps is H = F_p^-1 F_p^-T, all that an isotropic law knows of F_p:

    b_trial = F H F^T = sum_a beta_a n_a n_a^T          e_a = log(beta_a)/2
    |dev e| shrinks to tau_y/(2 mu) if it is larger     tau = 2 mu dev e + (lam + 2 mu/3) tr e I
    H <- F^-1 exp(2 e) F^-T

so that |dev tau| <= tau_y in the Frobenius norm. ``fixed_corotated``, with F = R S, is

    P = 2 mu (F - R) + lam (J - 1) J F^-T               J = det F
"""

import numpy as np

EYE = np.eye(3)
LEVI_CIVITA = np.cross(EYE[:, None], EYE[None, :]).transpose(2, 0, 1)


def lame(E, nu):
    """The moduli mu and lam [Pa] of Young's modulus E [Pa] and Poisson's ratio nu."""
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def cofactor(F):
    """J F^-T of matrices F (N, 3, 3)."""
    up, down = F[:, [1, 2, 0]], F[:, [2, 0, 1]]
    return up[..., [1, 2, 0]] * down[..., [2, 0, 1]] - up[..., [2, 0, 1]] * down[..., [1, 2, 0]]


def polar(F):
    """The rotations R of F = R S (N, 3, 3), det F > 0, by R <- (R + R^-T)/2."""
    R, change = F, 1.0
    while change > 1e-9:
        cof = cofactor(R)
        better = (R + 3 * cof / (R * cof).sum((1, 2), keepdims=True)) / 2
        R, change = better, np.abs(better - R).max()
    return R


def von_mises(F, H, p, *, tangent=False):
    """Stress of gradients F (N, 3, 3) with the state H (N, 3, 3).

    Args:
        F: Deformation gradients at the end of the step.
        H: F_p^-1 F_p^-T at its start.
        p: E, tau_y [Pa] and nu; without tau_y the law is elastic.
        tangent: Whether A is wanted.

    Returns:
        P (N, 3, 3) [Pa], H at the end of the step, and A (N, 3, 3, 3, 3) [Pa], A_iJkL =
        dP_iJ/dF_kL, or None.
    """
    mu, lam = lame(p["E"], p["nu"])
    beta, n = np.linalg.eigh(F @ H @ F.mT)
    e = np.log(beta) / 2
    mean = e.mean(-1, keepdims=True)
    size = np.linalg.norm(e - mean, axis=-1, keepdims=True)
    radius = p.get("tau_y", np.inf) / (2 * mu)
    yields = size > radius
    scale = np.divide(radius, size, out=np.ones_like(size), where=yields)
    shear = scale * (e - mean)
    principal = 2 * mu * shear + (3 * lam + 2 * mu) * mean
    tau, inverse = (n * principal[:, None, :]) @ n.mT, np.linalg.inv(F)
    P = tau @ inverse.mT
    elastic = inverse @ (n * np.exp(2 * (shear + mean))[:, None, :]) @ n.mT @ inverse.mT
    state = np.where(yields[:, :, None], elastic, H)
    if not tangent:
        return P, state, None
    m = np.divide(shear, radius, out=np.zeros_like(e), where=yields)
    slope = (lam + 2 * mu / 3) + 2 * mu * scale[..., None] * (
        EYE - 1 / 3 - m[:, :, None] * m[:, None, :]
    )
    slope = slope / (2 * beta[:, None, :])
    return P, state, _spectral(slope, 2 * mu * scale, beta, n, F, H, P, inverse)


def _spectral(slope, shear, beta, n, F, H, P, inverse):
    """A of an isotropic tau(b), b = F H F^T, from its principal values.

    Args:
        slope: dtau_a/dbeta_b (N, 3, 3) [Pa].
        shear: (tau_a - tau_b)/(e_a - e_b) (N, 1) [Pa].
        beta: Principal values of b (N, 3), ascending.
        n: Principal axes (N, 3, 3), in columns.
        F: Gradients (N, 3, 3).
        H: State (N, 3, 3).
        P: Stress (N, 3, 3) [Pa].
        inverse: F^-1 (N, 3, 3).
    """
    ratio = beta[:, :, None] / beta[:, None, :] - 1
    near = np.abs(ratio) < 1e-8
    quotient = np.where(near, 1 - ratio / 2, np.log1p(ratio) / np.where(near, 1, ratio))
    twist = shear[:, :, None] * quotient / (2 * beta[:, None, :]) * (1 - EYE)
    half = n[:, :, None, :, None] * (H @ F.mT @ n)[:, None, :, None, :]
    change = half + half.mT  # n^T (db/dF_kL) n, indexed k, L, a, b
    diagonal = np.einsum("nab,nklbb->nkla", slope, change)
    change = twist[:, None, None] * change + diagonal[..., None] * EYE
    moved = n[:, None, None] @ change @ (inverse @ n).mT[:, None, None]
    return moved.transpose(0, 3, 4, 1, 2) - np.einsum("niL,nJk->niJkL", P, inverse)


def fixed_corotated(F, H, p, *, tangent=False):
    """Stress of gradients F (N, 3, 3); arguments and results are those of ``von_mises``.

    dR = R [w], [w] the skew matrix of w = (tr S - S)^-1 axial(R^T dF - dF^T R).
    """
    mu, lam = lame(p["E"], p["nu"])
    R, cof = polar(F), cofactor(F)
    J = (F * cof).sum((1, 2), keepdims=True) / 3
    P = 2 * mu * (F - R) + lam * (J - 1) * cof
    if not tangent:
        return P, H, None
    S = R.mT @ F
    firm = np.linalg.inv(np.trace(S, axis1=1, axis2=2)[:, None, None] * EYE - S)
    turn = np.einsum("cLa,nka->nckL", LEVI_CIVITA, R).reshape(-1, 3, 9)
    turn = (turn.mT @ firm @ turn).reshape(-1, 3, 3, 3, 3)
    A = 2 * mu * (np.einsum("ik,JL->iJkL", EYE, EYE) - turn)
    A += lam * np.einsum("niJ,nkL->niJkL", cof, cof)
    across = np.einsum("ikm,JLM,nmM->niJkL", LEVI_CIVITA, LEVI_CIVITA, F, optimize=True)
    return P, H, A + lam * (J - 1)[..., None, None] * across


LAWS = {"von-mises": von_mises, "fixed-corotated": fixed_corotated}
