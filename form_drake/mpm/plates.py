"""Flat plates at flat faces of a body over its rest shape: constraints of the grid's velocities.

Over the rest shape the nodes of a column across a face stay those of the particles there. With the splines
w_r of the face's first layer of particles, in the grid's coordinate f, and the lever l from their middles to
their ends, what the ends do is

    v_end = sum_ij w_ij sum_r n_r v_ijr,    n_r = w_r (1 + 4 (r - f) l),

and follows a plate exactly if every column's sum_r n_r v_ijr does. Columns of a plate share no node: each meets
its own condition by the impulse that changes the grid's energy least; where plates are so near that theirs do,
what one does to the other is made good by the next step. That is Moreau's time stepping (1988): nothing is
pushed by a depth, so that a plate gives a body no energy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from form_drake.basis import splines
from form_drake.laws.kernels import types
from form_drake.mpm.held import Held
from form_drake.mpm.touch import impulse

SAME = 0.01  # of a particle, within which particles are of one layer
WEIGHTLESS = 1e-9  # of the largest column, below which rounding decides whether a column has mass
REACH = 2e-4  # [m] off a plate at which adhesion ends
ALIGNED = 1e-6  # sine of the angle between a plate and the grid at rest


@dataclass(frozen=True)
class Face:
    """Columns of nodes across the face of a body that a plate is at.

    Attributes:
        node: flat indices, shape [columns, 3].
        share: of their velocities in that of the ends of the particles, shape [3].
        place: where they cross the face at rest [m], shape [columns, 3].
        area: of the face that moves with them, at rest [m^2], shape [columns].
        beside: columns before and after along the two axes of the face, itself where there is none,
            shape [columns, 4].
    """

    node: np.ndarray
    share: np.ndarray
    place: np.ndarray
    area: np.ndarray
    beside: np.ndarray

    @classmethod
    def of(
        cls, x: np.ndarray, half: np.ndarray, dx: float, nodes: tuple[int, ...], normal: np.ndarray
    ) -> "Face":
        """That of particles at rest which a plate with this normal is at, in the grid's coordinates.

        Raises:
            ValueError: the plate does not lie along the grid.
        """
        axis = int(np.argmax(np.abs(normal)))
        across = [a for a in range(3) if a != axis]
        if np.linalg.norm(np.asarray(normal)[across]) > ALIGNED:
            raise ValueError(
                f"a plate's normal is {np.round(normal, 4)} where the body is at rest: over the rest"
                " shape plates lie along the axes of the grid"
            )
        out = -np.sign(normal[axis])
        end = (out * x[:, axis]).max()
        layer = np.flatnonzero(end - out * x[:, axis] < SAME * half[:, axis])
        middle, lever = float(x[layer[0], axis]) / dx, out * float(half[layer[0], axis]) / dx
        first, w = _splines(middle)
        share = w * (1.0 + 4.0 * (np.arange(3) - (middle - first)) * lever)
        base, parts = _splines(x[layer][:, across] / dx)
        own = 4.0 * half[layer][:, across].prod(axis=1)
        area = np.zeros([nodes[a] for a in across])
        for a, b in np.ndindex(3, 3):
            at = base[:, 0] + a, base[:, 1] + b
            np.add.at(area, at, own * parts[:, 0, a] * parts[:, 1, b])
        column = np.argwhere(area > WEIGHTLESS * area.max())
        found = np.full(np.array(area.shape) + 2, -1)
        found[tuple(column.T + 1)] = np.arange(len(column))
        steps = np.array([[-1, 0], [1, 0], [0, -1], [0, 1]]) + 1
        beside = np.stack([found[tuple((column + step).T)] for step in steps], axis=1)
        beside = np.where(beside < 0, np.arange(len(column))[:, None], beside)
        index = np.zeros((3, len(column), 3), dtype=int)
        index[across] = column.T[:, :, None]
        index[axis] = int(first) + np.arange(3)
        place = np.zeros((len(column), 3))
        place[:, across], place[:, axis] = dx * column, dx * (middle + lever)
        flat = np.ravel_multi_index(tuple(index), nodes)
        return cls(flat, share, place, area[tuple(column.T)], beside)


def _splines(s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """First nodes at coordinates in cells, and the three splines there, as a last axis."""
    first = np.floor(np.asarray(s) - 0.5).astype(int)
    f = s - first
    return first, splines(f)


class Plates:
    """The plates of one simulation on its device, and the faces that they are at.

    Args:
        tools: number of tools; those that are no plates are at no face.
        nodes: of the grid along each axis.
        precision: ``float32`` or ``float64``.
        device: Warp device.
    """

    def __init__(self, tools: int, nodes: tuple[int, ...], precision: str, device: str):
        t = types(precision)
        self._precision, self._device = precision, device
        self._most = max(nodes[a] * nodes[a - 1] for a in range(3))  # columns across any face

        def held(shape: tuple[int, ...], dtype) -> Held:
            return Held(wp.zeros(shape, dtype=dtype, device=device))

        self._node, self._beside = (held((tools, self._most, k), int) for k in (3, 4))
        self._share = held((tools,), t.vec3)
        self._anchor = held((tools, self._most), t.vec3)
        self._face = held(
            (tools, self._most), wp.vec3d
        )  # else slow drifts are rounded away, and stay
        self._area = held((tools, self._most), t.real)
        self._still, self._at = self._face.read(), self._anchor.read()
        self._node.write(-1)

    def put(self, faces: Mapping[int, Face], p_WT: np.ndarray, R_WT: np.ndarray) -> None:
        """Say which tool is at which face, where the tools are while the body is at rest."""
        node = np.full((*self._still.shape[:2], 3), -1)
        beside, area = np.zeros((*node.shape[:2], 4), dtype=int), np.ones(node.shape[:2])
        share, at, face = np.zeros((len(node), 3)), np.zeros(node.shape), np.zeros(node.shape)
        for n, own in faces.items():
            c = slice(len(own.node))
            node[n, c], beside[n, c], area[n, c] = own.node, own.beside, own.area
            share[n], face[n, c] = own.share, own.place
            at[n, c] = (own.place - p_WT[n]) @ R_WT[n]
        pairs = zip(
            (self._node, self._beside, self._area, self._share),
            (node, beside, area, share),
            strict=True,
        )
        for target, value in pairs:
            target.write(value)
        self._still, self._at = face, at
        self.release()

    def release(self) -> None:
        """Let the faces be where they are at rest, and held there."""
        self._face.write(self._still)
        self._anchor.write(self._at)

    @property
    def face(self) -> np.ndarray:
        """Where the columns cross the faces [m], shape [tools, columns, 3]."""
        return self._face.read()

    @face.setter
    def face(self, value: np.ndarray) -> None:
        self._face.write(value)

    @property
    def anchor(self) -> np.ndarray:
        """Where in their frames plates hold what is tied [m], shape [tools, columns, 3]; it goes as that slides."""
        return self._anchor.read()

    @anchor.setter
    def anchor(self, value: np.ndarray) -> None:
        self._anchor.write(value)

    def launch(self, n: int, *, tied: bool, dx, where: list, grid, taken) -> None:
        """Launch what the n-th tool does to the nodes after forces."""
        own = (self._node, self._share, self._anchor, self._area, self._beside, self._face)
        inputs = [n, tied, dx, *where, *(held.array for held in own), grid, taken]
        wp.launch(constrain(self._precision), self._most, inputs, device=self._device)

    def move(self, clock, grid) -> None:
        """Launch the motion of all faces, once every plate has met its condition."""
        inputs = [clock, self._node.array, self._share.array, grid, self._face.array]
        dim = self._still.shape[:2]
        wp.launch(follow(self._precision), dim, inputs, device=self._device)


@cache
def follow(precision: str):
    """Kernel that moves the faces with the nodes."""
    t = types(precision)
    vec3 = t.vec3

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        clock: wp.array(dtype=t.vec4),
        node: wp.array3d(dtype=int),
        share: wp.array(dtype=vec3),
        grid: wp.array(dtype=t.vec4),
        face: wp.array2d(dtype=wp.vec3d),
    ):
        n, c = wp.tid()
        if node[n, c, 0] < 0:
            return
        v = vec3()
        for r in range(3):
            one = grid[node[n, c, r]]
            v += share[n][r] * vec3(one[0], one[1], one[2])
        way = clock[0][0] * v
        face[n, c] += wp.vec3d(wp.float64(way[0]), wp.float64(way[1]), wp.float64(way[2]))

    return kernel


@cache
def constrain(precision: str):
    """Kernel of what a plate does to a column of nodes."""
    t = types(precision)
    real, vec3, give = t.real, t.vec3, impulse(precision)
    reach = wp.constant(real(REACH))

    @wp.func
    def apart(a: wp.vec3d, b: wp.vec3d):
        return vec3(real(a[0] - b[0]), real(a[1] - b[1]), real(a[2] - b[2]))

    @wp.func
    def wide(
        n: int, c: int, axis: int, beside: wp.array3d(dtype=int), face: wp.array2d(dtype=wp.vec3d)
    ):
        before, after = beside[n, c, 2 * axis], beside[n, c, 2 * axis + 1]
        steps = real(wp.where(before == c, 0, 1) + wp.where(after == c, 0, 1))
        return apart(face[n, after], face[n, before]) / wp.max(steps, real(1.0))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        n: int,
        tied: wp.bool,
        dx: real,
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        clock: wp.array(dtype=t.vec4),
        grips: wp.array(dtype=t.vec4),
        node: wp.array3d(dtype=int),
        share: wp.array(dtype=vec3),
        anchor: wp.array2d(dtype=vec3),
        area: wp.array2d(dtype=real),
        beside: wp.array3d(dtype=int),
        face: wp.array2d(dtype=wp.vec3d),
        grid: wp.array(dtype=t.vec4),
        taken: wp.array2d(dtype=wp.vec3d),
    ):
        c = wp.tid()
        dt = clock[0][0]
        if node[n, c, 0] < 0 or dt <= real(0.0):
            return
        v = vec3()
        light = real(0.0)  # inverse of the mass that an impulse at the face moves
        for r in range(3):
            one = grid[node[n, c, r]]
            if one[3] > real(0.0):
                s = share[n][r]
                v += s * vec3(one[0], one[1], one[2])
                light += s * s / one[3]
        middle = place[n]
        arm = apart(
            face[n, c],
            wp.vec3d(wp.float64(middle[0]), wp.float64(middle[1]), wp.float64(middle[2])),
        )
        normal = vec3(turn[n][0, 2], turn[n][1, 2], turn[n][2, 2])
        u = v - speed[n] - wp.cross(spin[n], arm)
        u_n = wp.dot(normal, u)
        u_t = u - u_n * normal
        grip = grips[n]
        change = vec3()
        if tied:
            off = arm - turn[n] * anchor[n, c]
            off_n = wp.dot(normal, off)
            off_t = off - off_n * normal
            push = -(u_n + off_n / dt)
            soft = real(1.0) + grip[2] / (light * area[n, c] * dt * dt)
            along = (u_t + off_t / dt) / soft
            size, most = wp.length(along), grip[0] * wp.max(push, real(0.0))
            if grip[0] >= real(0.0) and size > most:
                along = (most / size) * along
                slid = off_t + dt * (u_t - soft * along)
                anchor[n, c] = anchor[n, c] + wp.transpose(turn[n]) * slid
            change = push * normal - along
        else:
            gap = wp.dot(normal, arm)
            push = -(gap / dt + u_n)
            if push > real(0.0):
                size = wp.length(u_t)
                held = real(1.0)
                if grip[0] >= real(0.0) and size > grip[0] * push:
                    held = grip[0] * push / size
                change = push * normal - held * u_t
            elif grip[1] > real(0.0) and gap < reach:
                first = wide(n, c, 0, beside, face)
                second = wide(n, c, 1, beside, face)
                most = grip[1] * area[n, c] * wp.length(wp.cross(first, second)) / (dx * dx)
                most = most * wp.min(real(1.0) - gap / reach, real(1.0))
                change = wp.max(push, -most * dt * light) * normal
        for r in range(3):
            k = node[n, c, r]
            one = grid[k]
            if one[3] > real(0.0):
                d = (share[n][r] / (light * one[3])) * change
                grid[k] = one + t.vec4(d[0], d[1], d[2], real(0.0))
        give(taken, n, arm, -(real(1.0) / light) * change)

    return kernel
