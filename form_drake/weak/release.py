"""Traction-free directions: lateral stretches that the law itself chooses, not the tracks.

Where a specimen is thin across some material directions, the normal stress along them vanishes to
the slenderness. The measured stretches there carry noise and nothing else, so they are replaced:
F' = F diag(s) with e . F'^T P(F') e = 0 for every such direction e (fibre: two, plane stress: one).
"""

import numpy as np

from form_drake.laws import Law, Values
from form_drake.motion.motion import determinant, inverse
from form_drake.weak.stress import unit_stresses

ROUNDS = 12
STEP = 1e-6
CLOSE = 1e-4  # change of the stretches in a step of Newton, which leaves of the order of its square
SANE = (0.1, 10.0)  # changes of volume that a start is made for
LOST = 1e-3  # share of points, far outside what the tracks cover, that may not converge


def released(
    law: Law,
    F: np.ndarray,
    values: Values,
    theta: np.ndarray,
    axes: tuple[int, ...],
    near: np.ndarray | None = None,
) -> np.ndarray:
    """F with the stretches along traction-free material directions set by the law.

    Args:
        law: whose stress vanishes there.
        F: deformation gradients, shape [..., 3, 3].
        values: constants of the law.
        theta: coefficients of its terms up to a common factor, shape [terms].
        axes: the traction-free directions in stress-free coordinates.
        near: answer for a motion nearby, where the search starts, shape of F; None: there is none.

    Raises:
        ValueError: no stretches are found.
    """
    if not axes:
        return F
    still, back = np.zeros_like(F), inverse(F)
    stretch = np.ones((*F.shape[:-2], 3))
    own = list(axes)
    if near is None:
        # from no change of volume, where soft and nearly incompressible laws are nearly released
        stretch[..., own] = np.clip(determinant(F), *SANE)[..., None] ** (-1.0 / len(axes))
    else:
        lengths = (np.linalg.norm(G[..., own], axis=-2) for G in (near, F))
        stretch[..., own] = np.divide(*lengths)

    def normal(s: np.ndarray) -> np.ndarray:
        G = F * s[..., None, :]
        T = np.tensordot(theta, unit_stresses(law, G, still, values), axes=1)
        # e . F^-1 tau F^-T e for Kirchhoff tau: the second Piola stress along e
        rows = [back[..., a, :] / s[..., a, None] for a in axes]
        pulls = [np.einsum("...ij,...j->...i", T, e) for e in rows]
        return np.stack([np.sum(e * p, axis=-1) for e, p in zip(rows, pulls, strict=True)], axis=-1)

    for _ in range(ROUNDS):
        now = normal(stretch)
        slope = np.empty((*now.shape, len(axes)))
        for n, a in enumerate(axes):
            moved = stretch.copy()
            moved[..., a] += STEP
            slope[..., n] = (normal(moved) - now) / STEP
        change = np.linalg.solve(slope, -now[..., None])[..., 0]
        change = np.nan_to_num(np.clip(change, -0.2, 0.2))
        for n, a in enumerate(axes):
            stretch[..., a] += change[..., n]
        if np.mean(np.abs(change) > CLOSE) <= LOST:
            break
    else:
        raise ValueError("traction-free directions: no lateral stretches balance the stress")
    found: np.ndarray = F * stretch[..., None, :]
    return found
