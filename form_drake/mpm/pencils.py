"""Transfer between particles and a grid over their rest shape on the CPU, a pencil of eight particles at a time.

Over the rest shape particles keep their nodes and weights, and many stand in lines along an axis. What a line
of them and its nodes give each other is summed along that line first, and spread across it once for all. Eight
particles are the lanes of Clang's vector types. The sums are those of ``transfer`` (``mls``, ``total``), in
single precision.
"""

from collections.abc import Iterator
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
        axis, runs = min(
            ((a, list(_runs(s, base, a, nodes[a]))) for a in (2, 1, 0)), key=lambda c: len(c[1])
        )
        runs.sort(key=lambda run: run[0])  # as they lie in memory
        across = [(axis + 1) % 3, (axis + 2) % 3]
        index, table = np.zeros((len(runs), 11), dtype=np.int32), np.zeros((len(runs), 28))
        patterns = dict[bytes, int]()
        kept = list[np.ndarray]()
        length = 0
        for n, run in enumerate(runs):
            own = np.pad(run, (0, LANES - len(run)), mode="edge")
            once = np.arange(LANES) < len(run)
            pairs = (base[run[-1], axis] + 3 - base[run[0], axis] + 1) // 2
            first = base[run[0]].copy()
            first[axis] = min(first[axis], nodes[axis] - 2 * pairs)
            pattern = _pattern(w[own, axis], d[own, axis], base[own, axis] - first[axis], pairs)
            key = pattern.tobytes()
            if key not in patterns:
                patterns[key] = length
                kept.append(pattern)
                length += pattern.size
            flat = np.ravel_multi_index(tuple(first), nodes)
            index[n] = [flat, pairs, patterns[key], *own]
            sides = [a for b in across for a in (w[run[0], b], d[run[0], b])]
            table[n] = np.concatenate([*sides, mass[own] * once, volume[own] * once])
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
            held(np.concatenate([a.ravel() for a in kept]), t.real),
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


def _runs(s: np.ndarray, base: np.ndarray, axis: int, nodes: int) -> Iterator[np.ndarray]:
    """Particles of each pencil along an axis: those of equal places [cells] across, near each other."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    place = np.rint(s / SAME)
    order = np.lexsort((s[:, axis], place[:, second], place[:, first]))
    span = min(SPAN, nodes // 2 * 2) - 3
    begin = 0
    for n in range(1, len(order) + 1):
        if n < len(order):
            one, last = order[begin], order[n]
            alike = np.array_equal(place[one, [first, second]], place[last, [first, second]])
            if alike and n - begin < LANES and base[last, axis] - base[one, axis] <= span:
                continue
        yield order[begin:n]
        begin = n


def _pattern(w: np.ndarray, d: np.ndarray, base: np.ndarray, pairs: int) -> np.ndarray:
    """Splines of eight particles at their nodes, ``base`` and two more: by pairs of nodes and by nodes."""
    full = np.zeros((2, LANES, 2 * pairs))
    lane = np.arange(LANES)[:, None]
    full[:, lane, base[:, None] + np.arange(3)] = w, d
    by_pair = full.reshape(2, LANES, pairs, 2)[:, SLOTS].transpose(2, 1, 0, 3)
    by_node = full.transpose(2, 0, 1)
    every = np.repeat(by_pair[..., None], 4, axis=-1)
    return np.concatenate([every.ravel(), by_node.ravel()]).astype(np.float32)
