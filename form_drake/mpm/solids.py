"""Rigid solids by their signed distance: exact for simple shapes, baked on a grid for meshes."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import warp as wp

from form_drake.laws.kernels import types

KINDS = ("box", "cylinder", "sphere", "half-space", "mesh")
BAND = 4  # cells around a mesh in which its distance is known
MOST_CELLS = 8_000_000


@dataclass(frozen=True)
class Solid:
    """A rigid solid in the frame G of its geometry.

    Attributes:
        kind: one of ``KINDS``; a cylinder's axis is z, a half-space lies below z = 0.
        size: half extents of a box; radius, radius and half length of a cylinder; radius of a
            sphere [m], shape [3].
        table: of a mesh, distances at the nodes of a grid [m], shape [nx, ny, nz].
        corner: first node of that grid [m], shape [3].
        spacing: of that grid [m].
    """

    kind: str
    size: np.ndarray = field(default_factory=lambda: np.zeros(3))
    table: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    corner: np.ndarray = field(default_factory=lambda: np.zeros(3))
    spacing: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"solid {self.kind!r}: choose one of {', '.join(KINDS)}")
        needed = {"box": 3, "cylinder": 3, "sphere": 1}.get(self.kind, 0)
        if not (np.isfinite(self.size).all() and np.all(np.asarray(self.size)[:needed] > 0)):
            raise ValueError(f"{self.kind}: positive finite sizes are wanted, got {self.size}")

    @classmethod
    def box(cls, size: np.ndarray) -> "Solid":
        """A box of edge lengths ``size`` [m], centred."""
        return cls("box", 0.5 * np.asarray(size, dtype=float))

    @classmethod
    def cylinder(cls, radius: float, length: float) -> "Solid":
        """A cylinder about z [m], centred."""
        return cls("cylinder", np.array([radius, radius, 0.5 * length]))

    @classmethod
    def sphere(cls, radius: float) -> "Solid":
        """A centred sphere [m]."""
        return cls("sphere", np.full(3, radius))

    @classmethod
    def half_space(cls) -> "Solid":
        """Everything below z = 0."""
        return cls("half-space")

    @classmethod
    def mesh(cls, vertices: np.ndarray, faces: np.ndarray, spacing: float) -> "Solid":
        """A closed triangle mesh, its distance baked on a grid and interpolated between nodes.

        Args:
            vertices: [m], shape [vertices, 3].
            faces: indices, shape [faces, 3].
            spacing: of the grid [m].

        Raises:
            ValueError: the mesh is empty or not finite, or the grid would be too large.
        """
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int32)
        if not (len(faces) and np.isfinite(vertices).all()):
            raise ValueError(f"mesh: {len(faces)} faces and finite vertices are wanted")
        corner = vertices.min(axis=0) - BAND * spacing
        nodes = np.ceil((vertices.max(axis=0) - corner) / spacing).astype(int) + BAND + 1
        if nodes.prod() > MOST_CELLS:
            raise ValueError(
                f"mesh of {np.ptp(vertices, axis=0)} m: its grid of {spacing} m would have"
                f" {nodes.prod()} nodes, at most {MOST_CELLS}; choose a larger spacing"
            )
        grid = np.stack(np.meshgrid(*map(np.arange, nodes), indexing="ij"), axis=-1)
        p = wp.array(corner + spacing * grid.reshape(-1, 3), dtype=wp.vec3, device="cpu")
        surface = wp.Mesh(
            wp.array(vertices, dtype=wp.vec3, device="cpu"),
            wp.array(faces.ravel(), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )
        out = wp.zeros(len(p), dtype=float, device="cpu")
        wp.launch(_bake, dim=len(p), inputs=[surface.id, p, out], device="cpu")
        return cls(
            "mesh", np.ptp(vertices, axis=0) / 2, out.numpy().reshape(nodes), corner, spacing
        )

    @property
    def reach(self) -> np.ndarray:
        """Half extents of a box about the frame's origin that holds the solid [m], shape [3]."""
        if self.kind != "mesh":
            return np.asarray(self.size)
        inner = BAND * self.spacing
        last = self.corner + self.spacing * (np.array(self.table.shape) - 1)
        return np.maximum(np.abs(self.corner + inner), np.abs(last - inner))

    def struct(self, precision: str, device: str):
        """The solid as ``distance`` reads it."""
        t = types(precision)
        made = solid_type(precision)()
        made.kind = KINDS.index(self.kind)
        made.size, made.corner = t.vec3(*map(float, self.size)), t.vec3(*map(float, self.corner))
        made.spacing = float(self.spacing)
        made.nodes = wp.vec3i(*(int(n) for n in self.table.shape))
        made.table = wp.array(self.table.ravel(), dtype=t.real, device=device)
        return made

    def within(self, p_GQ: np.ndarray, radius: float) -> bool:
        """Whether a ball about a point [m] may meet the solid, a mesh by the box that holds it."""
        if self.kind != "mesh":
            return float(self.distance(p_GQ[None])[0]) < radius
        inner = BAND * self.spacing
        last = self.corner + self.spacing * (np.array(self.table.shape) - 1)
        nearest = np.clip(p_GQ, self.corner + inner, last - inner)
        return float(np.linalg.norm(p_GQ - nearest)) < radius

    def distance(self, p_GQ: np.ndarray, device: str = "cpu") -> np.ndarray:
        """Signed distances [m] of points [m] in G, shape [points]; negative inside."""
        t = types("float64")
        p = wp.array(np.asarray(p_GQ, dtype=float), dtype=t.vec3, device=device)
        out = wp.zeros(len(p), dtype=t.real, device=device)
        inputs = [self.struct("float64", device), p, out]
        wp.launch(_distances(), dim=len(p), inputs=inputs, device=device)
        return out.numpy().copy()


@cache
def solid_type(precision: str):
    """Warp struct of a ``Solid``."""
    t = types(precision)

    class Struct:
        kind: int
        size: t.vec3
        corner: t.vec3
        spacing: t.real
        nodes: wp.vec3i
        table: wp.array(dtype=t.real)

    return wp.struct(Struct)


@cache
def distance(precision: str):
    """Warp function (solid, p_GQ) -> unit gradient of the signed distance, and the distance."""
    t = types(precision)
    real, vec3, vec4, Struct = t.real, t.vec3, t.vec4, solid_type(precision)
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    far = wp.constant(real(1.0e3))

    @wp.func
    def towards(p: vec3, q: vec3):
        """Distance of a box corner's quadrant, q being |p| - half extents."""
        signs = vec3(wp.sign(p[0]), wp.sign(p[1]), wp.sign(p[2]))
        outside = vec3(wp.max(q[0], zero), wp.max(q[1], zero), wp.max(q[2], zero))
        length = wp.length(outside)
        if length > zero:
            n = wp.cw_mul(signs, outside) / length
            return vec4(n[0], n[1], n[2], length)
        axis = int(0)
        if q[1] > q[axis]:
            axis = int(1)
        if q[2] > q[axis]:
            axis = int(2)
        n = vec3()
        n[axis] = signs[axis]
        return vec4(n[0], n[1], n[2], q[axis])

    @wp.func
    def around(p: vec3, radius: real, half: real):
        r = wp.sqrt(p[0] * p[0] + p[1] * p[1])
        flat = towards(vec3(one, p[2], zero), vec3(r - radius, wp.abs(p[2]) - half, -far))
        scale = flat[0] / wp.max(r, real(1.0e-12))
        return vec4(scale * p[0], scale * p[1], flat[1], flat[3])

    @wp.func
    def interpolated(s: Struct, p: vec3):
        q = (p - s.corner) / s.spacing
        i, j, k = int(wp.floor(q[0])), int(wp.floor(q[1])), int(wp.floor(q[2]))
        if i < 0 or j < 0 or k < 0:
            return vec4(zero, zero, one, far)
        if i > s.nodes[0] - 2 or j > s.nodes[1] - 2 or k > s.nodes[2] - 2:
            return vec4(zero, zero, one, far)
        f = vec3(q[0] - real(i), q[1] - real(j), q[2] - real(k))
        row, layer = s.nodes[2], s.nodes[1] * s.nodes[2]
        at = i * layer + j * row + k
        a0 = s.table[at] + f[2] * (s.table[at + 1] - s.table[at])
        at += row
        a1 = s.table[at] + f[2] * (s.table[at + 1] - s.table[at])
        g0 = (one - f[1]) * (s.table[at - row + 1] - s.table[at - row])
        g0 += f[1] * (s.table[at + 1] - s.table[at])
        at += layer - row
        b0 = s.table[at] + f[2] * (s.table[at + 1] - s.table[at])
        at += row
        b1 = s.table[at] + f[2] * (s.table[at + 1] - s.table[at])
        g1 = (one - f[1]) * (s.table[at - row + 1] - s.table[at - row])
        g1 += f[1] * (s.table[at + 1] - s.table[at])
        a = a0 + f[1] * (a1 - a0)
        b = b0 + f[1] * (b1 - b0)
        slope = vec3(b - a, (one - f[0]) * (a1 - a0) + f[0] * (b1 - b0), g0 + f[0] * (g1 - g0))
        n = wp.normalize(slope)
        return vec4(n[0], n[1], n[2], a + f[0] * (b - a))

    @wp.func
    def function(s: Struct, p: vec3):
        if s.kind == 0:
            return towards(p, vec3(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2])) - s.size)
        if s.kind == 1:
            return around(p, s.size[0], s.size[2])
        if s.kind == 2:
            n = wp.normalize(p)
            return vec4(n[0], n[1], n[2], wp.length(p) - s.size[0])
        if s.kind == 3:
            return vec4(zero, zero, one, p[2])
        return interpolated(s, p)

    return function


@cache
def _distances():
    t = types("float64")
    far = distance("float64")
    Struct = solid_type("float64")

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(s: Struct, p: wp.array(dtype=t.vec3), out: wp.array(dtype=t.real)):
        i = wp.tid()
        out[i] = far(s, p[i])[3]

    return kernel


@wp.kernel(module="unique", enable_backward=False)
def _bake(mesh: wp.uint64, p: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    found = wp.mesh_query_point_sign_winding_number(mesh, p[i], 1.0e6)
    nearest = wp.mesh_eval_position(mesh, found.face, found.u, found.v)
    out[i] = found.sign * wp.length(p[i] - nearest)
