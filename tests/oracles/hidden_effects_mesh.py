"""Mesh of the hidden-effects solids: 27-node bricks with 3 x 3 x 3 Gauss points. SI units.

Arrays carry components first: u (3, n) over nodes. Masses are lumped by Simpson's rule.
"""

import numpy as np
import scipy.sparse as sp

GAUSS, GAUSS_WEIGHT = np.polynomial.legendre.leggauss(3)
IJK = np.indices((3, 3, 3)).reshape(3, 27)


def brick(s):
    """The 27 quadratic shape functions (N, 27) at s (N, 3), and their gradients (N, 27, 3)."""
    values = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2], -1)
    slopes = np.stack([s - 0.5, -2 * s, s + 0.5], -1)
    n, d = ([f[:, k, IJK[k]] for k in range(3)] for f in (values, slopes))
    gradient = [d[0] * n[1] * n[2], n[0] * d[1] * n[2], n[0] * n[1] * d[2]]
    return n[0] * n[1] * n[2], np.stack(gradient, -1)


class Mesh:
    """A box of 27-node bricks between the planes ``edges`` (three increasing arrays) [m].

    Attributes:
        X: Node positions (3, n) [m].
        cells: Nodes of the elements (27, E).
        points: Gauss points (3, 27 E) [m], elements running fastest.
        size: Sides of the elements (3, E) [m].
        volume: Shares of the volume at the nodes (n) [m^3].
    """

    def __init__(self, edges):
        """Lay nodes and Gauss points."""
        self.edges = edges = [np.asarray(e, float) for e in edges]
        lines = [np.sort(np.concatenate([e, (e[1:] + e[:-1]) / 2])) for e in edges]
        self.lines = lines
        shares = []
        for e in edges:
            share = np.zeros(2 * len(e) - 1)
            for k in range(3):
                np.add.at(share, 2 * np.arange(len(e) - 1) + k, np.diff(e) * [1, 4, 1][k] / 6)
            shares.append(share)
        self.shape, self.shares = tuple(len(line) for line in lines), shares
        self.X = np.stack(np.meshgrid(*lines, indexing="ij")).reshape(3, -1)
        self.volume = np.einsum("i,j,k->ijk", *shares).ravel()
        element = np.indices([len(e) - 1 for e in edges]).reshape(3, 1, -1)
        self.cells = np.ravel_multi_index(tuple(2 * element + IJK[:, :, None]), self.shape)
        self.size = np.stack([np.diff(e)[k[0]] for e, k in zip(edges, element, strict=True)])
        s = np.stack(np.meshgrid(GAUSS, GAUSS, GAUSS, indexing="ij"), -1).reshape(27, 3)
        value, slope = brick(s)
        self.slope = slope.transpose(2, 0, 1)  # axis, Gauss point, node
        self.points = (value @ self.X[:, self.cells]).reshape(3, -1)
        weight = np.einsum("i,j,k->ijk", *[GAUSS_WEIGHT] * 3).ravel() / 8
        self.weight = weight[:, None] * self.size.prod(0)
        pairs = (self.cells[:, None] * len(self.volume) + self.cells[None]).ravel()
        unique, self._slot = np.unique(pairs, return_inverse=True)
        self.row, self.column = np.divmod(unique, len(self.volume))

    def area(self, axis):
        """Shares (n) [m^2] of the cross-section normal to ``axis``."""
        one = [s if k != axis else np.ones_like(s) for k, s in enumerate(self.shares)]
        return np.einsum("i,j,k->ijk", *one).ravel()

    def gradient(self, u):
        """Gradients (3, 3, 27 E) of the nodal field u (3, n) at the Gauss points."""
        G = self.slope.reshape(81, 27) @ u[:, self.cells]
        return (G.reshape(3, 3, 27, -1) * (2 / self.size[:, None])).reshape(3, 3, -1)

    def internal(self, P):
        """Nodal forces (3, n) [N] of the stresses P (3, 3, 27 E): int P grad N dV."""
        P = P.reshape(3, 3, 27, -1) * (self.weight * (2 / self.size[:, None]))
        local = self.slope.reshape(81, 27).T @ P.reshape(3, 81, -1)
        nodes = self.cells.ravel()
        return np.stack([np.bincount(nodes, f.ravel(), len(self.volume)) for f in local])

    def stiffness(self, A, blocks):
        """Stiffness (pairs, 3, 3) of the pairs ``row``, ``column`` of nodes.

        Args:
            A: dP_iJ/dF_kL (3, 3, 3, 3, 27 E) [Pa].
            blocks: Added at the nodes (3, 3, n) [N/m].
        """
        side = 2 / self.size
        scale = side[:, None, None, None] * side[:, None] * self.weight
        A = A.reshape(3, 3, 3, 3, 27, -1) * scale
        A = A.transpose(0, 2, 1, 3, 4, 5).reshape(9, 243, -1).astype(np.float32)
        pairs = self.slope[:, None, :, :, None] * self.slope[None, :, :, None, :]
        full = pairs.reshape(243, 729).T.astype(np.float32) @ A
        data = [np.bincount(self._slot, block.ravel()) for block in full]
        data = np.stack(data, -1).reshape(-1, 3, 3)
        data[self.row == self.column] += blocks.transpose(2, 0, 1)
        return data

    def sampler(self, points):
        """Sparse shape functions (Q, n) at the reference positions points (Q, 3) [m]."""
        cell, s = np.empty(points.shape, int), np.empty(points.shape)
        for axis, e in enumerate(self.edges):
            k = np.clip(np.searchsorted(e, points[:, axis], "right") - 1, 0, len(e) - 2)
            cell[:, axis], s[:, axis] = k, 2 * (points[:, axis] - e[k]) / (e[k + 1] - e[k]) - 1
        grid = 2 * cell.T[:, :, None] + IJK[:, None, :]
        column = np.ravel_multi_index(tuple(grid), self.shape)
        entries = (brick(s)[0].ravel(), column.ravel(), 27 * np.arange(len(points) + 1))
        return sp.csr_matrix(entries, (len(points), len(self.volume)))

    def shared(self, points):
        """Shares (n) of the nodes in what lies at points (Q, 3) [m], none negative.

        Linear between planes of nodes: total and centre are kept.
        """
        place, part, found = [], [], np.zeros(len(self.volume))
        for axis, line in enumerate(self.lines):
            k = np.clip(np.searchsorted(line, points[:, axis], "right") - 1, 0, len(line) - 2)
            place.append(k)
            part.append((points[:, axis] - line[k]) / (line[k + 1] - line[k]))
        for corner in np.ndindex(2, 2, 2):
            node = np.ravel_multi_index(
                [k + c for k, c in zip(place, corner, strict=True)], self.shape
            )
            share = np.prod([t if c else 1 - t for t, c in zip(part, corner, strict=True)], 0)
            found += np.bincount(node, share, len(found)) / len(points)
        return found
