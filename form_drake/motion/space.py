"""Displacement fields of a box: products of splines, tied together by the symmetries of the body.

A mirror along an axis, or the exchange of two axes, turns a field into another of the same basis
whose coefficients are permuted and change sign. Fields that all of them leave as they are have
fewer coefficients: one for each orbit of the permutations.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from form_drake.motion.body import Body
from form_drake.motion.splines import Tensor

RIDGE = 1e-8  # weight of the roughness against the mean square misfit


@dataclass(frozen=True)
class Symmetry:
    """Operations about the centre of a box that leave a motion as it is.

    Attributes:
        mirrors: axes along which it is mirrored.
        exchange: two axes that change places; empty: none.
        odd: mirrored axes along which a mirror turns a field into its negative.
    """

    mirrors: tuple[int, ...] = ()
    exchange: tuple[int, ...] = ()
    odd: tuple[int, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.mirrors or self.exchange)

    @classmethod
    def stated(cls, words: str) -> "Symmetry":
        """Symmetries in words: ``x``, ``y`` or ``z`` for a mirror along it, ``xy`` for an exchange.

        Raises:
            ValueError: other words, or an exchange of axes along which nothing is mirrored.
        """
        axes = [tuple("xyz".find(letter) for letter in word) for word in words.split()]
        mirrors = tuple(sorted({a for (a, *more) in axes if not more}))
        pairs = [tuple(sorted(pair)) for pair in axes if len(pair) == 2]
        known = all(min(a) >= 0 and len(set(a)) == len(a) < 3 for a in axes)
        if not known or len(set(pairs)) > 1 or not all(set(p) <= set(mirrors) for p in pairs):
            raise ValueError(
                f"symmetry {words!r}: allowed are x, y and z for mirrors along these axes, and one pair"
                " such as xy, of axes that are both mirrored, for their exchange"
            )
        return cls(mirrors, pairs[0] if pairs else ())

    @classmethod
    def wider(cls, body: Body, found: "Symmetry") -> "list[Symmetry]":
        """Symmetries with one operation more that box and faces of a body would allow."""
        faces = {(f.axis, f.side): (f.condition, f.tool) for f in body.faces}
        size = body.high - body.low
        mirrors = [
            cls(tuple(sorted((*found.mirrors, a))), found.exchange)
            for a in range(3)
            if a not in found.mirrors and faces[a, 0] == faces[a, 1]
        ]
        exchanges = [
            cls(found.mirrors, (a, b))
            for a, b in ((0, 1), (0, 2), (1, 2))
            if not found.exchange
            and {a, b} <= set(found.mirrors)
            and faces[a, 0] == faces[b, 0]
            and abs(size[a] / size[b] - 1.0) < 1e-6
        ]
        return mirrors + exchanges

    def describe(self) -> str:
        """Its operations in words; empty: none."""
        words = [f"mirrored along {'xyz'[a]}" for a in self.mirrors]
        if self.exchange:
            words.append(" and ".join("xyz"[a] for a in self.exchange) + " exchanged")
        return ", ".join(words)

    def evened(self, rungs: tuple[int, ...]) -> tuple[int, ...]:
        """Steps of a ladder along the axes, the same along those that change places."""
        found = list(rungs)
        for a in self.exchange:
            found[a] = max(rungs[b] for b in self.exchange)
        return tuple(found)

    def images(self, scalar: Tensor) -> tuple[np.ndarray, np.ndarray]:
        """Where every product of the operations takes coefficients [space, 3], flattened, and with which sign.

        Both have the shape [products, 3 space].
        """
        index = np.arange(3 * scalar.size).reshape(1, *(s.size for s in scalar.axes), 3)
        sign = np.ones(index.shape)
        for a in self.mirrors:
            whole = -1.0 if a in self.odd else 1.0
            turned = whole * np.where(np.arange(3) == a, -1.0, 1.0) * sign
            index = np.concatenate([index, np.flip(index, a + 1)])
            sign = np.concatenate([sign, np.flip(turned, a + 1)])
        if self.exchange:
            a, b = self.exchange
            order = np.arange(3)
            order[[a, b]] = b, a
            index, sign = (
                np.concatenate([k, np.swapaxes(k, a + 1, b + 1)[..., order]]) for k in (index, sign)
            )
        return index.reshape(len(index), -1), sign.reshape(len(sign), -1)


@dataclass(frozen=True)
class Block:
    """Components of the displacement that share coefficients.

    Attributes:
        axes: the components.
        ties: of every component, what the coefficients of the splines are, shape [space, functions].
    """

    axes: tuple[int, ...]
    ties: tuple[sparse.csr_matrix, ...]

    @property
    def size(self) -> int:
        """Number of functions."""
        return int(self.ties[0].shape[1])

    def matrix(self, values: np.ndarray) -> np.ndarray:
        """Functions where the splines have ``values`` [points, space]: [points, axes, functions]."""
        return np.stack([(tie.T @ values.T).T for tie in self.ties], axis=1)


@dataclass(frozen=True)
class Space:
    """Vector fields on a box.

    Attributes:
        scalar: splines of each component.
        symmetry: of all fields.
        joined: whether all components make one block, as where their errors depend on one another.
    """

    scalar: Tensor
    symmetry: Symmetry = Symmetry()
    joined: bool = False

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Components apart, or together where axes change places or all are ``joined``."""
        both = self.symmetry.exchange
        groups = [both] * bool(both) + [(a,) for a in range(3) if a not in both]
        images, signs = self.symmetry.images(self.scalar)
        still = images == np.arange(images.shape[1])
        kept = np.sum(np.where(still, signs, 0.0), axis=0) != 0.0
        least = images.argmin(axis=0)[None]
        first, sign = (np.take_along_axis(k, least, axis=0)[0] for k in (images, signs))
        weight = sign * np.sqrt(still.sum(axis=0) / len(images))
        found = []
        for axes in groups:
            own = [slice(a, None, 3) for a in axes]
            orbits = np.unique(np.concatenate([first[o][kept[o]] for o in own]))
            ties = tuple(_tie(orbits, first[o], weight[o], kept[o]) for o in own)
            found.append(Block(axes, ties))
        return (_joined(found),) if self.joined else tuple(found)

    @cached_property
    def alike(self) -> tuple[tuple[Block, ...], ...]:
        """Blocks whose components have the same functions, together."""
        groups: list[list[Block]] = []
        for block in self.blocks:
            for group in groups:
                if _same(block, group[0]):
                    group.append(block)
                    break
            else:
                groups.append([block])
        return tuple(tuple(group) for group in groups)

    @cached_property
    def size(self) -> int:
        """Number of functions of all components."""
        return sum(block.size for block in self.blocks)

    def normal(self, D: np.ndarray, block: Block) -> np.ndarray:
        """Normal matrix of rows D [points, axes, functions], and the roughness that settles the rest."""
        flat = D.reshape(-1, block.size)
        found: np.ndarray = flat.T @ flat + RIDGE * len(D) * self.roughness(block)
        return found

    def roughness(self, block: Block) -> np.ndarray:
        """As of ``Tensor.roughness``, shape [functions, functions]."""
        K = self.scalar.roughness
        return np.asarray(sum((tie.T @ (tie.T @ K).T) for tie in block.ties))

    def tied(self, y: np.ndarray) -> np.ndarray:
        """Coefficients of the splines [space, 3, n] from those of all functions, shape [size, n]."""
        c = np.empty((self.scalar.size, 3, y.shape[1]))
        ends = np.cumsum([block.size for block in self.blocks])[:-1]
        for block, own in zip(self.blocks, np.split(y, ends), strict=True):
            for axis, tie in zip(block.axes, block.ties, strict=True):
                c[:, axis] = tie @ own
        return c


def _tie(
    orbits: np.ndarray, first: np.ndarray, weight: np.ndarray, kept: np.ndarray
) -> sparse.csr_matrix:
    """Every coefficient from that of its orbit, named by the ``first`` of it."""
    columns, ends = np.searchsorted(orbits, first[kept]), np.append(0, np.cumsum(kept))
    return sparse.csr_matrix((weight[kept], columns, ends), shape=(len(first), len(orbits)))


def _joined(blocks: list[Block]) -> Block:
    """All functions of some blocks as those of one."""
    ties: list[sparse.csr_matrix] = []
    for n, block in enumerate(blocks):
        for tie in block.ties:
            parts = [
                tie if m == n else sparse.csr_matrix((tie.shape[0], b.size))
                for m, b in enumerate(blocks)
            ]
            ties.append(sparse.csr_matrix(sparse.hstack(parts)))
    return Block(tuple(a for block in blocks for a in block.axes), tuple(ties))


def _same(one: Block, other: Block) -> bool:
    if len(one.ties) != len(other.ties) or one.size != other.size:
        return False
    return all(
        np.array_equal(getattr(a, k), getattr(b, k))
        for a, b in zip(one.ties, other.ties, strict=True)
        for k in ("indptr", "indices", "data")
    )


def paired(D: np.ndarray, u: np.ndarray) -> np.ndarray:
    """D^T u over points and axes, for u [frames, points, axes]: shape [functions, frames]."""
    found: np.ndarray = D.reshape(-1, D.shape[2]).T @ u.reshape(len(u), -1).T
    return found
