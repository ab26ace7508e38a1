"""Drift of a body whose motion is symmetric about its centre, wherever that goes."""

import numpy as np

from form_drake.motion.body import Body
from form_drake.motion.space import Space, Symmetry
from form_drake.motion.splines import Splines, Tensor

DEGREE = 3  # of the symmetric fields that may move beside the drift
APART = 1e-3  # share of a translation that no symmetric field must follow at the tracks


def centred(symmetry: Symmetry, body: Body, X: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Displacements less the translation along mirrored axes.

    A block that slides between smooth plates keeps its symmetry, about a centre that moves. The
    translation is fitted beside symmetric fields, so that it does not matter where the tracks are.
    Symmetric test fields do not see it: its weight, momentum and power are odd.

    Args:
        symmetry: of the motion about the centre.
        body: the specimen.
        X: stress-free positions of the tracks [m], shape [points, 3].
        u: displacements [m], shape [frames, points, 3].
    """
    if not symmetry.mirrors:
        return u
    a, b, c = (Splines.graded(body.low[n], body.high[n], 1, DEGREE, (False,) * 2) for n in range(3))
    space = Space(Tensor((a, b, c)), symmetry)
    values, found = space.scalar.matrix(X), u.copy()
    for block in space.blocks:
        axes = [a for a in block.axes if a in symmetry.mirrors]
        if axes:
            D = block.matrix(values)
            flat = D.reshape(-1, block.size)
            shift = np.tile(np.eye(3)[np.ix_(block.axes, axes)], (len(X), 1))
            own = shift - flat @ np.linalg.solve(space.normal(D, block), flat.T @ shift)
            told = own.T @ shift
            if np.linalg.eigvalsh(told)[0] > APART * len(X):
                series = u[:, :, block.axes].reshape(len(u), -1) @ own
                found[:, :, axes] -= np.linalg.solve(told, series.T).T[:, None]
    return found
