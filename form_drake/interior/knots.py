"""Cells of a body's splines, chosen by what its surface shows."""

from itertools import count

import numpy as np

from form_drake.motion import Body
from form_drake.motion.knots import ROOM, SLACK, looked_at
from form_drake.motion.space import Space, Symmetry
from form_drake.motion.splines import Splines, Tensor

DEGREE = 3
COARSEST = 4  # cells along the longest side
FINER = 1.25  # from one try to the next
MOST = 350  # functions
FAINT = 1e-4  # of the largest singular value, below which a function does not show at the surface


def chosen_cells(
    X: np.ndarray,
    u: np.ndarray,
    valid: np.ndarray,
    whitening: np.ndarray,
    body: Body,
    noise: float,
    symmetry: Symmetry,
) -> tuple[Space, float]:
    """The finest cells, about as long as they are wide, that left-out points support.

    The balance holds what points do not, so that finer cells cost little but time.

    Args:
        X: points of the surface [m], shape [points, 3].
        u: their displacements [m], also where they are not seen, shape [frames, points, 3].
        valid: which are seen, shape [frames, points].
        whitening: makes their errors alike, see ``Seen``, shape [points, 3, 3].
        body: the box.
        noise: standard deviation of a coordinate [m].
        symmetry: of the motion.

    Returns:
        Splines, and the root mean square error at left-out points in all frames [m].
    """
    every = np.ones_like(valid)
    fields, looked = looked_at(u, every, noise)
    size = body.high - body.low
    tried: list[tuple[Space, float]] = []
    for n in count():
        cell = float(size.max()) / (COARSEST * FINER**n)
        space = _space(body, np.maximum(1, np.round(size / cell)).astype(int), symmetry)
        if tried and space.size > MOST:
            break
        if not tried or space.size > tried[-1][0].size:
            tried.append((space, cross_validated(space, X, fields, looked, whitening)))
    least = min(error for _, error in tried)
    limit = np.hypot(SLACK * least, ROOM * noise)
    space = next(space for space, error in reversed(tried) if error <= limit)
    return space, cross_validated(space, X, u, valid, whitening)


def _space(body: Body, spans: np.ndarray, symmetry: Symmetry) -> Space:
    held = [f.condition == "bonded" for f in body.faces]
    a, b, c = (
        Splines.graded(body.low[n], body.high[n], spans[n], DEGREE, (held[2 * n], held[2 * n + 1]))
        for n in range(3)
    )
    return Space(Tensor((a, b, c)), symmetry, joined=True)


def cross_validated(
    space: Space, X: np.ndarray, fields: np.ndarray, valid: np.ndarray, whitening: np.ndarray
) -> float:
    """Root mean square error [m] of fields at left-out points of a surface, as if all were alike.

    Generalised cross-validation (Golub, Heath and Wahba 1979): what is left of the fields, by the share
    of freedom that is left.

    Args:
        space: of the fields.
        X: points [m], shape [points, 3].
        fields: shape [fields, points, 3].
        valid: where they count, shape [fields, points].
        whitening: as in ``chosen_cells``.
    """
    (block,) = space.blocks
    D = whitening @ block.matrix(space.scalar.matrix(X))
    U, S, _ = np.linalg.svd(D.reshape(-1, block.size), full_matrices=False)
    U = U[:, S > FAINT * S[0]]
    flat = np.einsum("pij,fpj->pif", whitening, fields, optimize=True).reshape(len(U), -1)
    rows = np.repeat(valid, 3, axis=1)
    for seen in np.unique(rows[~rows.all(axis=1)], axis=0):
        own = (rows == seen).all(axis=1)
        told = U[seen].T @ flat[np.ix_(seen, own)]
        # what the functions make of the others, fitted to those that count alone
        left = np.eye(np.sum(~seen)) - U[~seen] @ U[~seen].T
        flat[np.ix_(~seen, own)] = np.linalg.lstsq(left, U[~seen] @ told, rcond=None)[0]
    rest = (flat - U @ (U.T @ flat)) * rows.T
    size, count = np.sqrt(np.sum(rest**2) / rows.sum()), rows.sum() / len(rows)
    return float(size / max(1.0 - U.shape[1] / count, FAINT))
