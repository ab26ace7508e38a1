"""What is seen of a soft body: its skin, its outermost particles, and a field on them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from form_drake.motion.body import Face
from form_drake.mpm.exchange import Snapshot

NEIGHBOURS = 27  # particles that carry a point of the skin
REACH = 3.0  # spacings, from which particles carry a point of a patch
RIDGE = 1e-9  # keeps a sheet of one layer from having no slope at all
LATTICE = 0.02  # of a spacing, within which particles stand on a lattice


@dataclass(frozen=True)
class Field:
    """A scalar that colours a body.

    Attributes:
        unit: that it is shown in.
        value: of every particle, from their places free of stress [m] and a snapshot.
        signed: its range need not begin at zero.
    """

    unit: str
    value: Callable[[np.ndarray, Snapshot], np.ndarray]
    signed: bool = False


def von_mises(tau: np.ndarray) -> np.ndarray:
    """Equivalent stress sqrt(3/2 s:s), s the deviator of a stress, shape [particles]."""
    s = tau - np.trace(tau, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    found: np.ndarray = np.sqrt(1.5 * np.sum(s**2, axis=(1, 2)))
    return found


FIELDS = {
    "displacement": Field("mm", lambda X, now: 1e3 * np.linalg.norm(now.p_WQ - X, axis=1)),
    "speed": Field("mm/s", lambda X, now: 1e3 * np.linalg.norm(now.state.v, axis=1)),
    "stress": Field("kPa", lambda X, now: 1e-3 * von_mises(now.state.tau)),
    "pressure": Field(
        "kPa", lambda X, now: -1e-3 / 3.0 * np.trace(now.state.tau, axis1=1, axis2=2), True
    ),
}


def field_named(name: str) -> Field:
    """A field by name.

    Raises:
        ValueError: there is none; the message lists them.
    """
    if name not in FIELDS:
        raise ValueError(f"no field {name!r} to colour by; choose from {', '.join(FIELDS)}")
    return FIELDS[name]


def outermost_first(rest: np.ndarray, seed: int = 0) -> tuple[np.ndarray, int]:
    """Particles in random order, those at the surface before those inside.

    Args:
        rest: places free of stress, on a lattice of any orientation [m], shape [particles, 3].
        seed: of the order.

    Returns:
        Indices, shape [particles], and how many of them are at the surface.
    """
    tree = cKDTree(rest)
    reach = 1.3 * float(np.median(tree.query(rest, k=2)[0][:, 1]))
    neighbours = tree.query_ball_point(rest, reach, return_length=True) - 1
    outer = neighbours < 6
    order = np.random.default_rng(seed).permutation(len(rest))
    chosen: np.ndarray = np.concatenate([order[outer[order]], order[~outer[order]]])
    return chosen, int(outer.sum())


@dataclass(frozen=True)
class Skin:
    """A closed surface that moves with the particles of a body.

    Points at the body's edges stand once for each face that meets there, so that edges stay sharp.

    Attributes:
        faces: vertices of triangles, seen counter-clockwise from outside, shape [triangles, 3].
        carried: share of every particle in a point's place, shape [points, particles].
        mark: places on a face of the body free of stress, from its corner [m], shape [points, 2].
    """

    faces: np.ndarray
    carried: csr_array
    mark: np.ndarray

    @classmethod
    def of(cls, rest: np.ndarray) -> "Skin":
        """The skin of a body, half a spacing around its outermost particles.

        Args:
            rest: particles free of stress on a lattice along the axes [m], shape [particles, 3].

        Raises:
            ValueError: they stand on none.
        """
        low, spacing, cell = _lattice(rest)
        full = np.zeros(cell.max(axis=0) + 3, dtype=bool)
        full[tuple((cell + 1).T)] = True
        corners, quads, sides = _quads(full)
        X = low + (corners - 1.5) * spacing
        axes = [[k for k in range(3) if k != axis] for axis in range(3)]
        mark = np.array(
            [x[axes[side // 2]] for x, side in zip(X - X.min(axis=0), sides, strict=True)]
        )
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        return cls(triangles, _carried(X, rest, spacing), mark)

    def points(self, p_WQ: np.ndarray) -> np.ndarray:
        """Places [m] for places of the particles [m], shape [points, 3]."""
        found: np.ndarray = self.carried @ p_WQ
        return found

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Outward unit normals at the points, shape [points, 3]."""
        a, b, c = (points[self.faces[:, k]] for k in range(3))
        area = np.cross(b - a, c - a)
        total = np.zeros_like(points)
        for k in range(3):
            np.add.at(total, self.faces[:, k], area)
        unit: np.ndarray = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
        return unit


@dataclass(frozen=True)
class Patch:
    """A flat rectangle of a body's surface that moves with the particles, as smoothly as they do.

    Attributes:
        X: its points free of stress, an even grid [m], shape [points, 3].
        triangles: vertices, seen counter-clockwise from outside, shape [triangles, 3].
        carried: share of every particle in a point's displacement, shape [points, particles].
    """

    X: np.ndarray
    triangles: np.ndarray
    carried: csr_array

    @classmethod
    def of(
        cls, rest: np.ndarray, low: np.ndarray, high: np.ndarray, face: Face, cell: float
    ) -> "Patch":
        """A face of a box.

        Moving least squares with weights that end smoothly: a motion of the particles that is of second
        order moves the patch along exactly, and any other one leaves no steps in it.

        Args:
            rest: particles free of stress on a lattice along the axes [m], shape [particles, 3].
            low: lower corner of the box [m], shape [3].
            high: upper corner [m], shape [3].
            face: which one.
            cell: longest side of a quad [m].

        Raises:
            ValueError: the particles stand on no lattice.
        """
        sides = [
            np.linspace(low[a], high[a], 1 + int(np.ceil((high[a] - low[a]) / cell)))
            for a in range(3)
        ]
        sides[face.axis] = face.middle(low, high)[[face.axis]]
        b, c = (a for a in range(3) if a != face.axis)
        X = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
        index = np.arange(len(X)).reshape(len(sides[b]), len(sides[c]))
        quad = [index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]]
        if face.side == (face.axis == 1):  # y turns z to x, not x to z
            quad.reverse()
        p, q, r, s = (corner.ravel() for corner in quad)
        triangles = np.concatenate([np.stack([p, q, r], axis=1), np.stack([p, r, s], axis=1)])
        return cls(X, triangles, _smoothly_carried(X, rest, _lattice(rest)[1]))

    def points(self, p_WQ: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Places [m] for places of the particles, now and free of stress [m], shape [points, 3]."""
        found: np.ndarray = self.X + self.carried @ (p_WQ - rest)
        return found


def _lattice(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest particle [m], spacing along each axis [m], and every particle's cell."""
    low = rest.min(axis=0)
    steps = [np.diff(np.sort(x)) for x in rest.T]
    gap = 0.05 * float(np.median(cKDTree(rest).query(rest, k=2)[0][:, 1]))
    wide = [s[s > gap] for s in steps]
    typical = np.array([np.median(s) if len(s) else 0.0 for s in wide])
    spacing = np.where(typical > 0.0, typical, typical.max())
    place = (rest - low) / spacing
    if not np.all(np.abs(place - np.round(place)) < LATTICE):
        raise ValueError("a skin needs particles on a lattice along the axes")
    return low, spacing, np.round(place).astype(int)


def _quads(full: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where cells border on void: corners [points, 3], quads of them, side that each lies on."""
    quads = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        ring = np.zeros((4, 3), dtype=int)
        ring[[1, 2], b] = 1
        ring[[2, 3], c] = 1
        step = np.diff(full.astype(int), axis=axis)
        for sign in (-1, 1):
            cell = np.argwhere(step == sign)
            cell[:, axis] += 1
            quad = cell[:, None, :] + (ring if sign < 0 else ring[::-1])
            side = np.full((*quad.shape[:2], 1), 2 * axis + (sign < 0))
            quads.append(np.concatenate([quad, side], axis=2))
    every = np.concatenate(quads)
    points, index = np.unique(every.reshape(-1, 4), axis=0, return_inverse=True)
    return points[:, :3], index.reshape(-1, 4), points[:, 3]


def _carried(X: np.ndarray, rest: np.ndarray, spacing: np.ndarray) -> csr_array:
    """Shares of the nearest particles, by a bell curve."""
    near = min(NEIGHBOURS, len(rest))
    index = cKDTree(rest / spacing).query(X / spacing, k=near)[1].reshape(len(X), near)
    r = (rest[index] - X[:, None]) / spacing
    return _shares(index, r, np.exp(-0.5 * np.sum(r**2, axis=2)), len(rest))


def _smoothly_carried(X: np.ndarray, rest: np.ndarray, spacing: np.ndarray) -> csr_array:
    """Shares of all particles within ``REACH``, by a weight that ends there smoothly."""
    near = cKDTree(rest / spacing).query_ball_point(X / spacing, REACH)
    most = max(map(len, near))
    index = np.array([[*own, *[own[0]] * (most - len(own))] for own in near])
    real = np.arange(most) < np.array([[len(own)] for own in near])
    r = (rest[index] - X[:, None]) / spacing
    share = 1.0 - np.minimum(np.sum(r**2, axis=2) / REACH**2, 1.0)
    return _shares(index, r, real * share**4, len(rest), 2)


def _shares(
    index: np.ndarray, r: np.ndarray, w: np.ndarray, particles: int, order: int = 1
) -> csr_array:
    """Weights of moving least squares: a motion of the particles of that order moves a point along.

    Args:
        index: particles that carry each point, shape [points, near].
        r: from the point to them [spacings], shape [points, near, 3].
        w: weight of each, shape [points, near].
        particles: how many there are.
        order: of the polynomial, 1 or 2.
    """
    i, j = np.triu_indices(3)
    P = np.concatenate([np.ones((*r.shape[:2], 1)), r, r[..., i] * r[..., j]], axis=2)
    P = P[..., : 4 if order == 1 else None]
    moment = np.einsum("nk,nki,nkj->nij", w, P, P, optimize=True)
    size = w.sum(axis=1)[:, None, None]
    unit = np.eye(P.shape[2])
    moment += RIDGE * size * (unit - np.diag(unit[0]))
    row = np.linalg.solve(moment, np.tile(unit[:, :1], (len(r), 1, 1)))[..., 0]
    shares = w * np.einsum("ni,nki->nk", row, P)
    at = np.repeat(np.arange(len(r)), index.shape[1])
    return csr_array((shares.ravel(), (at, index.ravel())), shape=(len(r), particles))
