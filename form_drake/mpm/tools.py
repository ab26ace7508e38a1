"""Rigid tools that touch or hold the material, and the impulses that pass between them.

A tool pushes particles before they are scattered: a particle of which the ball of its radius reaches
into the tool by a depth gets the velocity change beta depth / dt - u_n along the normal, pulling only
where the tool is said to stick. Along the surface it is held where it touched: s being how far it has gone from there, it
gets -(u_t + beta s / dt), up to Coulomb's bound, beyond which s grows no more. A bonded
tool prescribes the velocity of the grid nodes inside it; a tied one holds the particles that are
tied to it where they were tied, whichever nodes it meets on its way. Every impulse given to the
material is taken from the tool, so that momentum is kept to round-off.
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.solids import Solid, distance, solid_type

# Share of its depth that a particle is pushed out by in one step. Since a step's depth carries the
# load, a small one is a soft surface; 1 lets what hits the tool bounce back.
BETA = 0.75
REACH = 2e-4  # [m]


@dataclass(frozen=True)
class Tool:
    """A rigid tool T in the grid's frame W.

    Attributes:
        name: of the tool.
        solid: its shape, in its frame T.
        contact: Coulomb's coefficient (0: frictionless), ``stick``, ``tied`` or ``bonded``.
    """

    name: str
    solid: Solid
    contact: float | Literal["stick", "tied", "bonded"] = 0.0

    def __post_init__(self) -> None:
        if self.contact in ("stick", "tied", "bonded"):
            return
        if isinstance(self.contact, str) or not 0.0 <= self.contact < np.inf:
            raise ValueError(
                f"tool {self.name}: contact {self.contact!r}; allowed are a coefficient of at least"
                " 0, stick, tied and bonded"
            )


@dataclass(frozen=True)
class Grip:
    """How a tool holds material along its surface, and off it.

    Attributes:
        friction: Coulomb's coefficient; negative: it cannot slip.
        adhesion: tension that a touching tool bears [Pa]; it fades over ``REACH`` of distance.
        compliance: of a layer in shear between a tied tool and what it holds [m/Pa].
        lever: share of a particle's radius off its middle at which a touching tool pushes it. With
            one the layer that touches bears all of the pressure and widens as what is below does.
    """

    friction: float = -1.0
    adhesion: float = 0.0
    compliance: float = 0.0
    lever: float = 0.0

    @property
    def vector(self) -> tuple[float, float, float, float]:
        return self.friction, self.adhesion, self.compliance, self.lever


def _grip(tool: Tool) -> Grip:
    return Grip() if isinstance(tool.contact, str) else Grip(float(tool.contact))


@dataclass(frozen=True)
class Motions:
    """How tools move, each about the origin of its frame.

    Attributes:
        p_WT: places [m], shape [tools, 3].
        R_WT: orientations, shape [tools, 3, 3].
        v_WT: velocities [m/s], shape [tools, 3].
        w_WT: angular velocities [rad/s], shape [tools, 3].
    """

    p_WT: np.ndarray
    R_WT: np.ndarray
    v_WT: np.ndarray
    w_WT: np.ndarray

    @classmethod
    def at_rest(cls, p_WT: np.ndarray) -> "Motions":
        """Unturned tools at rest at places [m], shape [tools, 3]."""
        p = np.atleast_2d(np.asarray(p_WT, dtype=float))
        return cls(p, np.tile(np.eye(3), (len(p), 1, 1)), np.zeros_like(p), np.zeros_like(p))


class Tools:
    """The tools of one simulation on its device: where they are, and what they have been given."""

    def __init__(self, tools: tuple[Tool, ...], particles: int, precision: str, device: str):
        self.tools, self.device, self._precision = tools, device, precision
        t = types(precision)
        n = len(tools)
        self._dtype = np.float32 if precision == "float32" else np.float64
        self._place = wp.zeros(n, dtype=t.vec3, device=device)
        self._turn = wp.zeros(n, dtype=t.mat, device=device)
        self._speed, self._spin = wp.zeros_like(self._place), wp.zeros_like(self._place)
        self._taken = wp.zeros((n, 2), dtype=wp.vec3d, device=device)
        self._slip = wp.zeros((n, particles), dtype=t.vec3, device=device)
        self._tied = wp.zeros((n, particles), dtype=wp.bool, device=device)
        self._grip = wp.array([_grip(tool).vector for tool in tools], dtype=t.vec4, device=device)
        self._solids = [tool.solid.struct(precision, device) for tool in tools]
        self.move(Motions.at_rest(np.full((n, 3), 1e3)))

    def move(self, motions: Motions) -> None:
        """Set places and velocities; from there on every step carries the tools on."""
        for target, value in zip(self._where(), vars(motions).values(), strict=True):
            target.assign(np.ascontiguousarray(value, dtype=self._dtype))

    def grip(self, n: int, grip: "Grip") -> None:
        """Change how the n-th tool holds what it touches or what is tied to it."""
        grips = self._grip.numpy()
        grips[n] = grip.vector
        self._grip.assign(grips)

    def tie(self, tied: np.ndarray) -> None:
        """Say which particles are tied to which tool, shape [tools, particles]."""
        self._tied.assign(np.asarray(tied, dtype=bool))

    def impulses(self) -> tuple[np.ndarray, np.ndarray]:
        """Impulse [N s] on every tool and its moment [N m s] about the tool's origin, so far.

        Returns:
            Arrays of shape [tools, 3] in W.
        """
        taken = self._taken.numpy()
        return taken[:, 0].copy(), taken[:, 1].copy()

    def forget(self) -> None:
        """Count impulses from zero on."""
        self._taken.zero_()

    @property
    def slip(self) -> np.ndarray:
        """How far particles have gone from where they touched [m], shape [tools, particles, 3]."""
        return self._slip.numpy().copy()

    @slip.setter
    def slip(self, value: np.ndarray) -> None:
        self._slip.assign(np.ascontiguousarray(value, dtype=self._dtype))

    def push(self, clock, dx, x, v, C, mass, radius) -> None:
        """Launch what the touching tools do to the particles before a step."""
        for n, (tool, solid) in enumerate(zip(self.tools, self._solids, strict=True)):
            if tool.contact == "tied":
                inputs = [n, *self._where(), clock, self._grip, self._tied]
                inputs += [x, v, mass, radius, self._slip, self._taken]
                wp.launch(tie(self._precision), len(x), inputs, device=self.device)
            elif tool.contact != "bonded":
                inputs = [n, solid, *self._where(), clock, self._grip]
                inputs += [dx, x, v, C, mass, radius, self._slip, self._taken]
                wp.launch(contact(self._precision), len(x), inputs, device=self.device)

    def hold(self, clock, dx, nodes, grid) -> None:
        """Launch what the bonded tools do to the nodes after forces, then carry all tools on."""
        for n, (tool, solid) in enumerate(zip(self.tools, self._solids, strict=True)):
            if tool.contact == "bonded":
                inputs = [n, solid, *self._where(), dx, nodes, grid, self._taken]
                wp.launch(bond(self._precision), len(grid), inputs, device=self.device)
        inputs = [*self._where(), clock]
        wp.launch(carry(self._precision), len(self.tools), inputs, device=self.device)

    def _where(self) -> list:
        return [self._place, self._turn, self._speed, self._spin]


def _give(precision: str):
    """Warp function that takes an impulse j at r from tool n."""
    t = types(precision)

    @wp.func
    def give(taken: wp.array2d(dtype=wp.vec3d), n: int, r: t.vec3, j: t.vec3):
        m = wp.cross(r, j)
        wp.atomic_add(taken, n, 0, wp.vec3d(wp.float64(j[0]), wp.float64(j[1]), wp.float64(j[2])))
        wp.atomic_add(taken, n, 1, wp.vec3d(wp.float64(m[0]), wp.float64(m[1]), wp.float64(m[2])))

    return give


@cache
def contact(precision: str):
    """Kernel of the impulses between the particles and one tool."""
    t = types(precision)
    real, vec3 = t.real, t.vec3
    far, Struct, give = distance(precision), solid_type(precision), _give(precision)
    beta = wp.constant(real(BETA))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        n: int,
        solid: Struct,
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        clock: wp.array(dtype=t.vec4),
        grips: wp.array(dtype=t.vec4),
        dx: real,
        x: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=t.mat),
        mass: wp.array(dtype=real),
        radius: wp.array(dtype=real),
        slip: wp.array2d(dtype=vec3),
        taken: wp.array2d(dtype=wp.vec3d),
    ):
        p = wp.tid()
        r = x[p] - place[n]
        near = far(solid, wp.transpose(turn[n]) * r)
        depth = radius[p] - near[3]
        dt = clock[0][0]
        grip = grips[n]
        reach = real(0.0)
        if grip[1] > real(0.0):
            reach = real(REACH)
        if depth <= -reach or dt <= real(0.0):
            slip[n, p] = vec3()
            return
        normal = turn[n] * vec3(near[0], near[1], near[2])
        u = v[p] - speed[n] - wp.cross(spin[n], r)
        along = wp.dot(normal, u)
        push = beta * depth / dt - along
        pull = real(0.0)
        if reach > real(0.0):
            whole = real(4.0) * radius[p] * radius[p] * grip[1] * dt / mass[p]
            pull = whole * wp.min(real(1.0) + depth / reach, real(1.0))
        if push <= real(0.0):
            slip[n, p] = vec3()
            if pull > real(0.0):
                pulled = wp.max(push, -pull) * normal
                v[p] = v[p] + pulled
                give(taken, n, r, -mass[p] * pulled)
            return
        gone = slip[n, p]
        sliding = u - along * normal
        gone = gone - wp.dot(normal, gone) * normal + dt * sliding
        wanted = sliding + (beta / dt) * gone
        size = wp.length(wanted)
        share = real(1.0)
        friction = grip[0]
        if friction >= real(0.0) and size > friction * push:
            share = friction * push / size
        slip[n, p] = share * gone
        change = push * normal - share * wanted
        v[p] = v[p] + change
        # the affine motion to which an impulse off the middle of a particle amounts
        arm = -grip[3] * radius[p] * real(4.0) / (dx * dx)
        C[p] = C[p] + wp.outer(change, arm * normal)
        give(taken, n, r, -mass[p] * change)

    return kernel


@cache
def tie(precision: str):
    """Kernel that holds the particles that are tied to one tool.

    Along the surface they may be held by a layer that shears, and only up to Coulomb's bound.
    """
    t = types(precision)
    real, vec3, give = t.real, t.vec3, _give(precision)
    beta = wp.constant(real(BETA))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        n: int,
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        clock: wp.array(dtype=t.vec4),
        grips: wp.array(dtype=t.vec4),
        tied: wp.array2d(dtype=wp.bool),
        x: wp.array(dtype=vec3),
        v: wp.array(dtype=vec3),
        mass: wp.array(dtype=real),
        radius: wp.array(dtype=real),
        slip: wp.array2d(dtype=vec3),
        taken: wp.array2d(dtype=wp.vec3d),
    ):
        p = wp.tid()
        dt = clock[0][0]
        if not tied[n, p] or dt <= real(0.0):
            return
        r = x[p] - place[n]
        u = v[p] - speed[n] - wp.cross(spin[n], r)
        gone = slip[n, p] + dt * u
        wanted = u + (beta / dt) * gone
        grip = grips[n]
        if grip[0] >= real(0.0) or grip[2] > real(0.0):
            normal = turn[n] * vec3(real(0.0), real(0.0), real(1.0))
            push = -wp.dot(normal, wanted)
            sliding = wanted + push * normal
            area = real(4.0) * radius[p] * radius[p]
            # the implicit step of a spring, which ends as what holds without compliance
            stiff = real(1.0) / (real(1.0) + grip[2] * mass[p] / (area * dt * dt))
            along = gone - wp.dot(normal, gone) * normal
            sliding = stiff * (sliding + (real(1.0) - beta) * (real(1.0) - stiff) / dt * along)
            size = wp.length(sliding)
            most = grip[0] * wp.max(push, real(0.0))
            if grip[0] >= real(0.0) and size > most:
                share = most / size
                gone = gone - (real(1.0) - share) * along
                sliding = share * sliding
            wanted = sliding - push * normal
        slip[n, p] = gone
        v[p] = v[p] - wanted
        give(taken, n, r, mass[p] * wanted)

    return kernel


@cache
def bond(precision: str):
    """Kernel that moves the nodes inside one tool with it."""
    t = types(precision)
    real, vec3 = t.real, t.vec3
    far, Struct, give = distance(precision), solid_type(precision), _give(precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        n: int,
        solid: Struct,
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        dx: real,
        nodes: wp.vec3i,
        grid: wp.array(dtype=t.vec4),
        taken: wp.array2d(dtype=wp.vec3d),
    ):
        i = wp.tid()
        node = grid[i]
        if node[3] <= real(0.0):
            return
        c = i % nodes[2]
        b = (i / nodes[2]) % nodes[1]
        a = i / (nodes[1] * nodes[2])
        r = dx * vec3(real(a), real(b), real(c)) - place[n]
        if far(solid, wp.transpose(turn[n]) * r)[3] > real(0.0):
            return
        u = speed[n] + wp.cross(spin[n], r)
        give(taken, n, r, node[3] * (vec3(node[0], node[1], node[2]) - u))
        grid[i] = t.vec4(u[0], u[1], u[2], node[3])

    return kernel


@cache
def carry(precision: str):
    """Kernel that moves every tool by one step of its motion."""
    t = types(precision)
    real, vec3 = t.real, t.vec3

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        place: wp.array(dtype=vec3),
        turn: wp.array(dtype=t.mat),
        speed: wp.array(dtype=vec3),
        spin: wp.array(dtype=vec3),
        clock: wp.array(dtype=t.vec4),
    ):
        n = wp.tid()
        dt = clock[0][0]
        place[n] = place[n] + dt * speed[n]
        angle = dt * wp.length(spin[n])
        if angle > real(0.0):
            K = wp.skew(wp.normalize(spin[n]))
            R = turn[n]
            turn[n] = R + wp.sin(angle) * (K * R) + (real(1.0) - wp.cos(angle)) * (K * (K * R))

    return kernel


@cache
def decay(precision: str):
    """Kernel that lets velocities and their gradients decay at a rate [1/s]."""
    t = types(precision)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        clock: wp.array(dtype=t.vec4),
        rate: wp.array(dtype=t.real),
        v: wp.array(dtype=t.vec3),
        C: wp.array(dtype=t.mat),
    ):
        p = wp.tid()
        if rate[0] > t.real(0.0):
            left = wp.exp(-rate[0] * clock[0][0])
            v[p] = left * v[p]
            C[p] = left * C[p]

    return kernel
