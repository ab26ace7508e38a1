"""Rigid tools that touch or hold the material: where they are, and what they have been given."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.held import Held
from form_drake.mpm.plates import Face, Plates
from form_drake.mpm.solids import Solid
from form_drake.mpm.touch import bond, carry, contact

MANY = 64  # particles to a thread of the CPU: what a kernel is given is read once for them


@dataclass(frozen=True)
class Tool:
    """A rigid tool T in the grid's frame W.

    Attributes:
        name: of the tool.
        solid: its shape, in its frame T.
        contact: Coulomb's coefficient (0: frictionless), ``stick``, ``tied`` (a plate) or ``bonded``.
        plate: whether it is a half-space at one flat face of the body, over its rest shape, see
            ``form_drake.mpm.plates``.
    """

    name: str
    solid: Solid
    contact: float | Literal["stick", "tied", "bonded"] = 0.0
    plate: bool = False

    def __post_init__(self) -> None:
        if self.contact == "tied" and not self.plate:
            raise ValueError(f"tool {self.name}: only a plate ties")
        if self.plate and self.solid.kind != "half-space":
            raise ValueError(f"tool {self.name}: a plate is a half-space, not a {self.solid.kind}")
        if self.contact in ("stick", "tied", "bonded"):
            return
        if isinstance(self.contact, str) or not 0.0 <= self.contact < np.inf:
            raise ValueError(
                f"tool {self.name}: contact {self.contact!r}; allowed are a coefficient of at least"
                f" 0, stick{', tied' if self.plate else ''} and bonded"
            )


@dataclass(frozen=True)
class Grip:
    """How a tool holds material along its surface, and off it.

    Attributes:
        friction: Coulomb's coefficient of a tool that touches, or of a plate to what is tied to it, which
            it holds across; negative: nothing can slip.
        adhesion: tension that a plate over the rest shape bears [Pa]; it fades over ``REACH`` of distance.
        compliance: of a layer in shear between a plate and what is tied to it [m/Pa].
    """

    friction: float = -1.0
    adhesion: float = 0.0
    compliance: float = 0.0

    @property
    def vector(self) -> tuple[float, float, float, float]:
        """As kernels read it."""
        return self.friction, self.adhesion, self.compliance, 0.0


def _grip(tool: Tool) -> Grip:
    """How it holds at first."""
    return Grip(-1.0 if isinstance(tool.contact, str) else float(tool.contact))


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
        nodes: tuple[int, ...],
        total: bool = False,
    ):
        self.tools, self.device, self._precision, self._total = tools, device, precision, total
        t, n = types(precision), len(tools)
        flat = any(tool.plate for tool in tools)
        self.plates = Plates(n, nodes, precision, device) if flat else None
        self._many = MANY if wp.get_device(device).is_cpu else 1

        def held(shape: int | tuple[int, ...], dtype) -> Held:
            return Held(wp.zeros(shape, dtype=dtype, device=device))

        self._motion = [held(n, dtype) for dtype in (t.vec3, t.mat, t.vec3, t.vec3)]
        self._rest = [held(n, dtype) for dtype in (t.vec3, t.mat)]
        self._taken = held((n, 2), wp.vec3d)
        self._slip = held((n, particles), t.vec3)
        grips = [_grip(tool).vector for tool in tools]
        self._grip = wp.array(grips, dtype=t.vec4, device=device)
        self._solids = [tool.solid.struct(precision, device) for tool in tools]
        self.move(Motions.at_rest(np.full((n, 3), 1e3)))

    @property
    def touch(self) -> bool:
        """Whether any of them pushes particles."""
        return any(tool.contact != "bonded" and not tool.plate for tool in self.tools)

    def move(self, motions: Motions) -> None:
        """Set places and velocities; from there on every step carries the tools on."""
        for target, value in zip(self._motion, vars(motions).values(), strict=True):
            target.write(value)

    @property
    def motions(self) -> Motions:
        """Where tools are and how they move, for ``move``."""
        return Motions(*(held.read() for held in self._motion))

    def grip(self, n: int, grip: Grip) -> None:
        """Change how the n-th tool holds what it touches or what is tied to it."""
        grips = self._grip.numpy()
        grips[n] = grip.vector
        self._grip.assign(grips)

    def tie(self, motions: Motions, faces: Mapping[int, Face]) -> None:
        """Say where bonded tools hold the body at rest, and which plates are at which face of it.

        Args:
            motions: where the tools are while it is at rest.
            faces: by the number of the tool.
        """
        for target, value in zip(self._rest, (motions.p_WT, motions.R_WT), strict=True):
            target.write(value)
        if self.plates is not None:
            self.plates.put(faces, motions.p_WT, motions.R_WT)

    def release(self) -> None:
        """Forget what has slipped, and what the tools have been given."""
        self._slip.write(0.0)
        if self.plates is not None:
            self.plates.release()
        self.forget()

    def impulses(self) -> tuple[np.ndarray, np.ndarray]:
        """Impulse [N s] on every tool and its moment [N m s] about the tool's origin, so far.

        Returns:
            Arrays of shape [tools, 3] in W.
        """
        taken = self._taken.read()
        return taken[:, 0], taken[:, 1]

    def forget(self) -> None:
        """Count impulses from zero on."""
        self._taken.write(0.0)

    @property
    def slip(self) -> np.ndarray:
        """How far particles have gone along a tool from where they touched it [m]; across it, over
        the rest shape, the depth that would bear what is borne at none. Shape [tools, particles, 3]."""
        return self._slip.read()

    @slip.setter
    def slip(self, value: np.ndarray) -> None:
        self._slip.write(value)

    def push(self, clock, dx, x, v, C, T, mass, half) -> None:
        """Launch what the touching tools do to the particles before a step."""
        moved = [dx, x, v, C, T, mass, half, self._slip.array, self._taken.array]
        threads = -(-len(x) // self._many)
        kernel = contact(self._precision, self._total)
        for n, (tool, solid) in enumerate(zip(self.tools, self._solids, strict=True)):
            if tool.contact != "bonded" and not tool.plate:
                inputs = [self._many, n, solid, *self._where(), clock, self._grip, *moved]
                wp.launch(kernel, threads, inputs, device=self.device)

    def hold(self, clock, dx, nodes, grid) -> None:
        """Launch what tools do to the nodes after forces, then carry all tools on."""
        for n, (tool, solid) in enumerate(zip(self.tools, self._solids, strict=True)):
            if tool.plate:
                assert self.plates is not None
                where, tied = [*self._where(), clock, self._grip], tool.contact == "tied"
                self.plates.launch(
                    n, tied=tied, dx=dx, where=where, grid=grid, taken=self._taken.array
                )
            elif tool.contact == "bonded":
                held = [h.array for h in self._rest] if self._total else self._where()[:2]
                inputs = [n, solid, *self._where(), *held, dx, nodes, grid, self._taken.array]
                kernel = bond(self._precision, self._total)
                wp.launch(kernel, len(grid), inputs, device=self.device)
        if self.plates is not None:
            self.plates.move(clock, grid)
        inputs = [*self._where(), clock]
        wp.launch(carry(self._precision), len(self.tools), inputs, device=self.device)

    def _where(self) -> list:
        return [held.array for held in self._motion]
