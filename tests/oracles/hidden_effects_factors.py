"""Sparse factors of the tangent of the hidden-effects solids. SI units.

Nodes are eliminated by nested dissection along planes between elements. Factors are in single
precision, since Newton corrects what they leave. What contact changes at single nodes since a
factorisation enters by the Sherman-Morrison-Woodbury identity

    (K + I_D d I_D^T)^-1 b = y - K^-1 I_D (1 + d C)^-1 d y_D,  y = K^-1 b,  C = (K^-1)_DD
"""

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse.linalg import splu

RANK = 1e-10  # of the Gram matrix of normalised secants


def dissected(low, high):
    """Places (N, 3) in the box low <= k < high of a grid of 27-node bricks, as they are eliminated."""
    axis = int(np.argmax(high - low))
    if high[axis] - low[axis] < 4:
        return np.indices(high - low).reshape(3, -1).T + low
    middle, one = (low + high)[axis] // 4 * 2, np.arange(3) == axis
    sides = (low, np.where(one, middle, high)), (np.where(one, middle + 1, low), high)
    plane = np.where(one, middle, low), np.where(one, middle + 1, high)
    return np.concatenate([dissected(*part) for part in (*sides, plane)])


class Factors:
    """Solves for the free components of a nodal field."""

    def __init__(self, mesh, fixed):
        """Lay out the matrix of a mesh without the components ``fixed`` (3, n)."""
        places = dissected(np.zeros(3, int), np.array(mesh.shape))
        order = np.ravel_multi_index(tuple(places.T), mesh.shape)
        dofs = (3 * order[:, None] + np.arange(3)).ravel()
        self.dofs = dofs[~fixed.T.ravel()[dofs]]  # by node and axis
        self.rank = np.full(fixed.size, -1)
        self.rank[self.dofs] = np.arange(len(self.dofs))
        row, column = (self.rank[3 * k[:, None] + np.arange(3)] for k in (mesh.row, mesh.column))
        row, column = np.broadcast_arrays(row[:, :, None], column[:, None])
        row, column = row.ravel(), column.ravel()
        keep = np.flatnonzero((row >= 0) & (column >= 0))
        self.taken = keep[np.lexsort((row[keep], column[keep]))]
        start = np.searchsorted(column[self.taken], np.arange(len(self.dofs) + 1))
        self.layout, self.lu = (row[self.taken], start), None

    def factorise(self, stiffness, blocks):
        """Factorise; ``stiffness`` by pairs of nodes and axes, ``blocks`` (3, 3, n) those of walls."""
        K = sp.csc_matrix((stiffness.ravel()[self.taken].astype(np.float32), *self.layout))
        options = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0}
        self.lu = splu(K, **options, options={"SymmetricMode": True})
        self.blocks, self.firm = blocks, np.zeros(len(self.rank))
        self.firm[self.dofs] = np.abs(K.diagonal())
        self.known, self.columns = {}, np.zeros((0, len(self.dofs)), np.float32)
        self.change, self.at = np.zeros_like(blocks), []

    def update(self, blocks):
        """Follow walls whose stiffness is now ``blocks``; True where that changes the inverse."""
        change = blocks - self.blocks
        most = np.abs(change).max(1).T.ravel()  # by node and axis
        moved = most > 0.1 * self.firm
        change = change * (moved & (self.rank >= 0)).reshape(-1, 3).T[:, None]
        if not (np.abs(change - self.change) > 0.1 * np.abs(self.change)).any():
            return False
        self.change = change
        self.at = at = np.flatnonzero(moved & (self.rank >= 0))
        if not len(at):
            return True
        self.extend([k for k in at if k not in self.known])
        self.sides = self.columns[[self.known[k] for k in at]]
        C = self.sides[:, self.rank[at]].T.astype(float)
        node, axis = np.divmod(at, 3)
        self.d = np.where(node[:, None] == node, change[axis[:, None], axis, node[:, None]], 0.0)
        self.middle = lu_factor(np.eye(len(at)) + self.d @ C)
        return True

    def extend(self, dofs):
        """Solve for unit forces on ``dofs``."""
        if not dofs:
            return
        unit = np.zeros((len(self.dofs), len(dofs)), np.float32)
        unit[self.rank[dofs], np.arange(len(dofs))] = 1
        self.known |= {k: len(self.columns) + i for i, k in enumerate(dofs)}
        self.columns = np.vstack([self.columns, self.lu.solve(unit).T])

    def solve(self, force):
        """Displacement (3, n) [m] under forces (3, n) [N] on the free components."""
        y = self.lu.solve(force.T.ravel()[self.dofs].astype(np.float32)).astype(float)
        if len(self.at):
            z = lu_solve(self.middle, self.d @ y[self.rank[self.at]])
            y -= z @ self.sides
        found = np.zeros(force.size)
        found[self.dofs] = y
        return found.reshape(-1, 3).T


class Secants:
    """What steps taken have taught of the tangent since its factorisation: Anderson's mixing."""

    def __init__(self, depth):
        """Remember ``depth`` steps."""
        self.depth = depth
        self.clear()

    def clear(self):
        """Forget all."""
        self.moves, self.turns, self.gram = [], [], np.zeros((0, 0))

    def learn(self, move, turn):
        """A step ``move`` changed what the factors ask for by ``turn``."""
        size = np.sqrt((turn**2).sum())
        if size == 0:
            return
        old = len(self.turns) == self.depth
        self.moves = [*self.moves[old:], (move + turn).ravel() / size]
        self.turns = [*self.turns[old:], turn.ravel() / size]
        row = np.array([self.turns[-1] @ turn for turn in self.turns])
        gram = np.zeros((len(row),) * 2)
        gram[:-1, :-1], gram[-1], gram[:, -1] = self.gram[old:, old:], row, row
        self.gram = gram

    def corrected(self, change):
        """The change to make where the factors ask for ``change``."""
        if not self.turns:
            return change
        flat = change.ravel()
        share = np.linalg.lstsq(self.gram, np.array([t @ flat for t in self.turns]), rcond=RANK)[0]
        for part, move in zip(share, self.moves, strict=True):
            flat = flat - part * move
        return flat.reshape(change.shape)
