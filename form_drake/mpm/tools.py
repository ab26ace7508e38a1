"""Rigid tools that touch or hold the material: where they are, and what they have been given."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.solids import Solid
from form_drake.mpm.touch import bond, carry, contact, tie


@dataclass(frozen=True)
class Tool:
    """A rigid tool T in the grid's frame W.

    Attributes:
        name: of the tool.
        solid: its shape, in its frame T.
        contact: Coulomb's coefficient (0: frictionless), ``stick``, ``tied`` (a half-space) or
            ``bonded``.
    """

    name: str
    solid: Solid
    contact: float | Literal["stick", "tied", "bonded"] = 0.0

    def __post_init__(self) -> None:
        if self.contact == "tied" and self.solid.kind != "half-space":
            raise ValueError(f"tool {self.name}: only a half-space ties, not a {self.solid.kind}")
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
        friction: Coulomb's coefficient of a touching tool; negative: it cannot slip.
        adhesion: tension that a touching tool bears [Pa]; it fades over ``REACH`` of distance.
        compliance: of a layer in shear between a tied tool and what it holds [m/Pa].
        lever: whether a touching tool pushes particles where they touch it, not in their middle; the
            layer that touches then bears all of the pressure and widens as what is below does.
    """

    friction: float = -1.0
    adhesion: float = 0.0
    compliance: float = 0.0
    lever: bool = False

    @property
    def vector(self) -> tuple[float, float, float, float]:
        return self.friction, self.adhesion, self.compliance, float(self.lever)


def _grip(tool: Tool, lever: bool) -> Grip:
    """How it holds at first: over the rest shape particles stay boxes, and tools push these's faces."""
    return Grip(-1.0 if isinstance(tool.contact, str) else float(tool.contact), lever=lever)


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

    def __init__(
        self,
        tools: tuple[Tool, ...],
        particles: int,
        precision: str,
        device: str,
        total: bool = False,
    ):
        self.tools, self.device, self._precision, self._total = tools, device, precision, total
        t = types(precision)
        n = len(tools)
        self._dtype = np.float32 if precision == "float32" else np.float64
        self._shared = wp.get_device(device).is_cpu  # its arrays are written in place: faster
        self._place = wp.zeros(n, dtype=t.vec3, device=device)
        self._turn = wp.zeros(n, dtype=t.mat, device=device)
        self._speed, self._spin = wp.zeros_like(self._place), wp.zeros_like(self._place)
        self._rest = [wp.zeros_like(self._place), wp.zeros_like(self._turn)]
        self._taken = wp.zeros((n, 2), dtype=wp.vec3d, device=device)
        self._slip = wp.zeros((n, particles), dtype=t.vec3, device=device)
        self._tied = wp.zeros((n, particles), dtype=wp.bool, device=device)
        self._knot = wp.zeros_like(self._slip)
        grips = [_grip(tool, total).vector for tool in tools]
        self._grip = wp.array(grips, dtype=t.vec4, device=device)
        self._solids = [tool.solid.struct(precision, device) for tool in tools]
        self.move(Motions.at_rest(np.full((n, 3), 1e3)))

    def move(self, motions: Motions) -> None:
        """Set places and velocities; from there on every step carries the tools on."""
        for target, value in zip(self._where(), vars(motions).values(), strict=True):
            self._put(target, value)

    def grip(self, n: int, grip: Grip) -> None:
        """Change how the n-th tool holds what it touches or what is tied to it."""
        grips = self._grip.numpy()
        grips[n] = grip.vector
        self._grip.assign(grips)

    def tie(self, motions: Motions, tied: np.ndarray, knots: np.ndarray) -> None:
        """Say which particles are tied to which tool, and where bonded ones hold the body at rest.

        Args:
            motions: where the tools are while it is at rest.
            tied: shape [tools, particles].
            knots: points that the faces of the particles are held at, in the frames of the tools [m],
                shape [tools, particles, 3].
        """
        for target, value in zip(self._rest, (motions.p_WT, motions.R_WT), strict=True):
            self._put(target, value)
        self._tied.assign(np.asarray(tied, dtype=bool))
        self._knot.assign(np.ascontiguousarray(knots, dtype=self._dtype))

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
        """How far particles have gone along a tool from where they touched it [m]; across it, the depth
        that would bear what a lever's impulses bear at none. Shape [tools, particles, 3]."""
        return self._slip.numpy().copy()

    @slip.setter
    def slip(self, value: np.ndarray) -> None:
        self._put(self._slip, value)

    def push(self, clock, dx, x, v, C, T, mass, half) -> None:
        """Launch what the touching tools do to the particles before a step."""
        for n, (tool, solid) in enumerate(zip(self.tools, self._solids, strict=True)):
            if tool.contact == "tied":
                inputs = [n, *self._where(), clock, self._grip, self._tied, self._knot]
                inputs += [dx, x, v, C, T, mass, half, self._slip, self._taken]
                wp.launch(tie(self._precision, self._total), len(x), inputs, device=self.device)
            elif tool.contact != "bonded":
                inputs = [n, solid, *self._where(), clock, self._grip]
                inputs += [dx, x, v, C, T, mass, half, self._slip, self._taken]
                wp.launch(contact(self._precision, self._total), len(x), inputs, device=self.device)

    def hold(self, clock, dx, nodes, grid) -> None:
        """Launch what the bonded tools do to the nodes after forces, then carry all tools on."""
        for n, (tool, solid) in enumerate(zip(self.tools, self._solids, strict=True)):
            if tool.contact == "bonded":
                held = self._rest if self._total else self._where()[:2]
                inputs = [n, solid, *self._where(), *held, dx, nodes, grid, self._taken]
                kernel = bond(self._precision, self._total)
                wp.launch(kernel, len(grid), inputs, device=self.device)
        inputs = [*self._where(), clock]
        wp.launch(carry(self._precision), len(self.tools), inputs, device=self.device)

    def _put(self, target, value: np.ndarray) -> None:
        if self._shared:
            target.numpy()[...] = value
        else:
            target.assign(np.ascontiguousarray(value, dtype=self._dtype))

    def _where(self) -> list:
        return [self._place, self._turn, self._speed, self._spin]
