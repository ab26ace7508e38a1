"""Traction-free directions: lateral stretches that the law itself chooses, not the tracks.

Where a specimen is thin across some material directions, the normal stress along them vanishes to
the slenderness. The measured stretches there carry noise and nothing else, so they are replaced:
F' = F diag(s) with e . F'^T P(F') e = 0 for every such direction e (fibre: two, plane stress: one).
"""

import numpy as np
import warp as wp

from form_drake.laws import Law, Values
from form_drake.motion.motion import determinant
from form_drake.weak.kernels import constants, loaded, matrices, stretching, vec3
from form_drake.weak.stress import ALONE
from form_drake.workers import parted

ROUNDS = 12
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
        axes: the traction-free directions in stress-free coordinates, at most two.
        near: answer for a motion nearby, where the search starts, shape of F; None: there is none.

    Raises:
        ValueError: no stretches are found.
    """
    if not axes:
        return F
    flat, own = F.reshape(-1, 3, 3), list(axes)
    start = np.ones((len(flat), 3))
    if near is None:
        # from no change of volume, where soft and nearly incompressible laws are nearly released
        start[:, own] = np.clip(determinant(flat), *SANE)[:, None] ** (-1.0 / len(axes))
    else:
        lengths = (np.linalg.norm(G.reshape(-1, 3, 3)[..., own], axis=-2) for G in (near, F))
        start[:, own] = np.divide(*lengths)
    kernel, given = loaded(stretching(law)), constants(law, values, theta)
    both = wp.vec2i(*(*axes, -1)[:2])
    found, close = np.empty(flat.shape), np.empty(len(flat), dtype=bool)

    def part(some: slice) -> None:
        out = matrices(flat[some])
        s = wp.array(np.ascontiguousarray(start[some]), dtype=vec3, device="cpu")
        ended = wp.zeros(len(out), dtype=int, device="cpu")
        wp.launch(kernel, len(out), [*given, both, ROUNDS, s, out, ended], device="cpu")
        found[some], close[some] = out.numpy(), ended.numpy() != 0

    parted(part, len(flat), ALONE // 4)
    if np.mean(~close) > LOST:
        raise ValueError("traction-free directions: no lateral stretches balance the stress")
    return found.reshape(F.shape)
