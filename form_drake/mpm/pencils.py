"""Transfer between particles and a grid over their rest shape on the CPU, a pencil of eight particles at a time.

Over the rest shape particles keep their nodes and weights, and many stand in lines along an axis. What a line
of them and its nodes give each other is summed along that line first, and spread across it once for all. Eight
particles are the lanes of Clang's vector types. The sums are those of ``transfer`` (``mls``, ``total``), in
single precision.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from form_drake.basis import splines
from form_drake.laws.kernels import types
from form_drake.mpm.pencil_kernels import kernels

LANES = 8
SPAN = 8  # most nodes of a pencil
SAME = 1e-6  # of a cell, within which places are one
SLOTS = [0, 4, 1, 5, 2, 6, 3, 7]  # the order in which lanes become quads


@dataclass(frozen=True)
class Pencils:
    """Particles by the lines that they stand in, as arrays on the CPU.

    Attributes:
        axis: along which they do.
        index: of each pencil the flat index of its first node, pairs of nodes, where its weights begin in
            ``pattern``, and its particles, the last one repeated to fill it; shape [pencils, 11].
        table: of each pencil the splines along the next axis and the one after, both beside these times
            how far the node is; masses [kg] and volumes [m^3] of the particles, zero where one is
            repeated; shape [pencils, 28].
        pattern: splines along the axis of what differs in them, for pairs of nodes and for nodes.
        mass: of the nodes [kg], as the fourth component, shape [nodes].
    """

    axis: int
    index: wp.array
    table: wp.array
    pattern: wp.array
    mass: wp.array

    @classmethod
    def of(
        cls, x: np.ndarray, mass: np.ndarray, volume: np.ndarray, dx: float, nodes: tuple[int, ...]
    ) -> "Pencils":
        """Of particles at rest at ``x`` [m] in the grid's frame, shape [particles, 3]."""
        s = x / dx
        base = np.clip(np.floor(s - 0.5).astype(int), 0, np.array(nodes) - 3)
        w = splines(s - base)
        d = w * (np.arange(3) - (s - base)[..., None])
        axis, order, ends = min(
            ((a, *_runs(s, base, a, nodes[a])) for a in (2, 1, 0)), key=lambda found: len(found[2])
        )
        begin = np.concatenate([[0], ends[:-1]])
        along = np.argsort(order[begin])  # as they lie in memory
        begin, ends = begin[along], ends[along]
        lane = begin[:, None] + np.arange(LANES)
        own = order[np.minimum(lane, ends[:, None] - 1)]
        one, once = own[:, 0], lane < ends[:, None]
        first = base[one]
        pairs = (base[own[:, -1], axis] + 3 - first[:, axis] + 1) // 2
        first[:, axis] = np.minimum(first[:, axis], nodes[axis] - 2 * pairs)
        beyond = base[own, axis] - first[:, axis, None]
        where, pattern = _patterns(w[own, axis], d[own, axis], beyond, pairs)
        flat = np.ravel_multi_index(tuple(first.T), nodes)
        index = np.column_stack([flat, pairs, where, own])
        sides = [a[one, (axis + n) % 3] for n in (1, 2) for a in (w, d)]
        table = np.hstack([*sides, mass[own] * once, volume[own] * once])
        weight = np.zeros((*nodes, 4))
        share = np.einsum("na,nb,nc->nabc", *w.swapaxes(0, 1)) * mass[:, None, None, None]
        for a, b, c in np.ndindex(3, 3, 3):
            at = base + np.array([a, b, c])
            np.add.at(weight, (*at.T, 3), share[:, a, b, c])
        t = types("float32")

        def held(a: np.ndarray, dtype) -> wp.array:
            flat = a.ravel() if dtype is not t.vec4 else a.reshape(-1, 4)
            kind = np.int32 if dtype is int else np.float32
            return wp.array(flat.astype(kind), dtype=dtype, device="cpu")

        return cls(
            axis,
            held(index, int),
            held(table, t.real),
            held(pattern, t.real),
            held(weight, t.vec4),
        )

    def scatter(self, grid: wp.array, v, C, tau, T, share, clock, dx, nodes) -> None:
        """Launch what gives nodes, beside their mass, a share of momentum and the impulses of tau."""
        self._launch(0, [grid, v, C, tau, T, share, clock, dx, nodes])

    def gather(self, grid: wp.array, *inputs) -> None:
        """Launch what moves the particles with the grid."""
        self._launch(1, [grid, *inputs])

    def _launch(self, n: int, inputs: list) -> None:
        own = [self.axis, self.index, self.table, self.pattern]
        dim = len(self.index) // (LANES + 3)
        wp.launch(kernels()[n], dim=dim, inputs=[*own, *inputs], device="cpu")


def _runs(s: np.ndarray, base: np.ndarray, axis: int, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Particles of equal places [cells] across an axis in an order, and where each pencil of it ends."""
    place = np.rint(s / SAME)[:, [(axis + 1) % 3, (axis + 2) % 3]]
    order = np.lexsort((s[:, axis], place[:, 1], place[:, 0]))
    apart = np.any(np.diff(place[order], axis=0), axis=1).tolist()
    node, span = base[order, axis].tolist(), min(SPAN, nodes // 2 * 2) - 3
    begin, ends = 0, []
    for n, other in enumerate(apart, 1):
        if other or n - begin == LANES or node[n] - node[begin] > span:
            ends.append(n)
            begin = n
    return order, np.array([*ends, len(order)])


def _patterns(
    w: np.ndarray, d: np.ndarray, beyond: np.ndarray, pairs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Splines at the nodes of pencils, by pairs of nodes and by nodes, each once: where, and all of them.

    Args:
        w: splines of every particle at three nodes, shape [pencils, 8, 3].
        d: the same times how far the node is.
        beyond: how far the first of the three is from that of the pencil, shape [pencils, 8].
        pairs: of nodes, shape [pencils].
    """
    where, kept, length = np.zeros(len(pairs), dtype=int), [], 0
    lane = np.arange(LANES)[:, None]
    for count in np.unique(pairs):
        some = np.flatnonzero(pairs == count)
        full = np.zeros((len(some), 2, LANES, 2 * count), dtype=np.float32)
        at = np.arange(len(some))[:, None, None], lane, beyond[some, :, None] + np.arange(3)
        full.swapaxes(0, 1)[:, *at] = w[some], d[some]
        seen = dict[bytes, int]()
        place = [seen.setdefault(one.tobytes(), len(seen)) for one in full]
        once = full[np.unique(place, return_index=True)[1]]
        by_pair = once.reshape(len(once), 2, LANES, count, 2)[:, :, SLOTS].transpose(0, 3, 2, 1, 4)
        every = np.repeat(by_pair.reshape(len(once), -1), 4, axis=1)
        rows = np.hstack([every, once.transpose(0, 3, 1, 2).reshape(len(once), -1)])
        where[some] = length + np.array(place) * rows.shape[1]
        kept.append(rows.ravel())
        length += rows.size
    return where, np.concatenate(kept)
