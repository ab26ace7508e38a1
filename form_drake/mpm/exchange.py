"""Bodies among moving tools, advanced from snapshot to snapshot in world coordinates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from form_drake.laws.memory import Memory
from form_drake.material import Material
from form_drake.mpm.model import Body, State
from form_drake.mpm.plates import Face
from form_drake.mpm.simulation import Simulation
from form_drake.mpm.tools import Motions, Tool
from form_drake.records.solver import Gradient, Solver

TOUCH = 0.02  # of a particle's radius, within which bodies merely touch a tool
ASTRAY = 0.02  # of a cell, and in radians, from which on a tool is not where it holds a body
EDGE = 3  # cells of the grid beyond the region that particles may visit
REST = 1  # of a grid over the rest shape, which none ever leaves


@dataclass(frozen=True)
class Snapshot:
    """Bodies at one time, and what the tools got on the way there; never written again.

    Attributes:
        state: of the particles, in the grid's coordinates.
        force: mean force on every tool since the snapshot before [N], shape [tools, 3].
        moment: mean moment about its origin [N m], shape [tools, 3].
        p_WQ: positions of the particles in the world [m], shape [particles, 3].
        left: where tools are for what they hold, as their velocities had it; None: where they really are.
    """

    state: State
    force: np.ndarray
    moment: np.ndarray
    p_WQ: np.ndarray
    left: Motions | None = None

    def __deepcopy__(self, memo: object) -> "Snapshot":
        return self


class Scene:
    """Bodies of materials among rigid tools.

    Args:
        materials: of the bodies, with density.
        bodies: particles in world coordinates [m]; their densities are those of the materials, unless
            every particle has one of its own.
        tools: that touch or hold them.
        region: lower and upper corner of where particles may go [m], shape [2, 3].
        dx: grid spacing [m].
        gravity: [m/s^2], shape [3].
        mass_scale: factor on every density, its inverse on gravity: quasi-static motion in larger
            time steps.
        memories: of the bodies, see ``form_drake.laws.memory``.
        drag: rate at which what surrounds the bodies lets velocities decay [1/s].
        swelling: stretch that the bodies have where they are free of stress, less one.
        total: see ``Simulation``; of the region only what the bodies fill at rest is then laid out.
        gradient: of the solver, see ``form_drake.records.Solver``; None: ``mls`` over the rest shape,
            ``exact`` in space.
        precision: ``float32`` or ``float64``.
        device: Warp device.

    Raises:
        ValueError: a material without density, or bodies that lie beyond the region or in a tool.
    """

    def __init__(
        self,
        materials: Sequence[Material],
        bodies: Sequence[Body],
        tools: Sequence[Tool],
        *,
        region: np.ndarray,
        dx: float,
        gravity: np.ndarray,
        mass_scale: float = 1.0,
        memories: Sequence[Memory] = (),
        drag: float = 0.0,
        swelling: float = 0.0,
        total: bool = False,
        gradient: Gradient | None = None,
        precision: str = "float32",
        device: str = "cpu",
    ):
        low, high = np.asarray(region, dtype=float)
        for body in bodies:
            if not np.all((body.x >= low) & (body.x <= high)):
                raise ValueError(
                    f"material from {body.x.min(0).round(4)} to {body.x.max(0).round(4)} m reaches"
                    f" out of the region from {low} to {high} m: enlarge the region"
                )
        self.rest = np.concatenate([b.x for b in bodies])
        self.drag, self._swelling = drag / mass_scale, swelling
        edge = REST if total else EDGE
        if total:
            low = low + dx * np.floor((self.rest.min(axis=0) - low) / dx)
            high = self.rest.max(axis=0)
        self.corner = low - edge * dx
        nodes = np.maximum(np.ceil((high - low) / dx).astype(int), 1) + 2 * edge + 1
        # what a plate gives a particle off its middle is what the force of ``mls`` balances: by the
        # spline's own gradient, layers of few cells give way under plates
        solver = Solver(
            dx=dx,
            nodes=tuple(int(n) for n in nodes),
            gradient=gradient or ("mls" if total else "exact"),
            precision=precision,
            gravity=tuple(float(g) / mass_scale for g in gravity),
        )
        moved = []
        for material, body in zip(materials, bodies, strict=True):
            if material.density is None:
                raise ValueError(f"a material of law {material.law.name} states no density")
            density = body.density if np.ndim(body.density) else material.density
            moved.append(replace(body, x=body.x - self.corner, density=density * mass_scale))
        self.simulation = Simulation(
            solver,
            [m.law for m in materials],
            moved,
            tools=tools,
            memories=memories,
            total=total,
            device=device,
        )
        self.bear(np.zeros(len(tools)))
        self._tied: Motions | None = None
        self._untied = [t.name for t in tools if t.plate or (total and t.contact == "bonded")]
        self._materials = tuple(materials)
        self.resist_rates(True)

    def bear(self, shares: np.ndarray) -> None:
        """Say how large the inertia of what tools hold is by their own, shape [tools].

        What is held pushes back a step later: of a way that it is off, more than 2 (1 - share)/(1 + share) in a
        step would throw both. Half of that is made up for.
        """
        held = np.array([t.contact == "bonded" for t in self.tools])
        self._catch = held * (1.0 - shares) / (1.0 + shares)

    def resist_rates(self, on: bool) -> None:
        """Give the bodies their materials, with what is viscous in them or without."""
        for n, material in enumerate(self._materials):
            viscous = [] if on else [t.key for t in material.law.terms if t.unit == "Pa s"]
            values = {**material.values, **dict.fromkeys(viscous, 0.0)}
            self.simulation.set_material(values, n)

    @property
    def tools(self) -> tuple[Tool, ...]:
        return self.simulation.tools.tools

    def tie(self, motions: Motions) -> None:
        """Say where tools are while the body is at rest: what they hold, and at which faces plates are.

        Raises:
            ValueError: a plate that does not lie along the grid.
        """
        body, solver, faces = self.simulation.body, self.simulation.solver, dict[int, Face]()
        for n, tool in enumerate(self.tools):
            if tool.plate:
                normal = motions.R_WT[n][:, 2]
                faces[n] = Face.of(body.x, body.half, solver.dx, solver.nodes, normal)
        self._untied, self._tied = [], motions
        still = replace(motions, p_WT=motions.p_WT - self.corner)
        self.simulation.tools.tie(still, faces)

    def astray(self, motions: Motions) -> list[str]:
        """Tools that hold the body over its rest shape, and are not where they were tied to it."""
        if not self.simulation.total or self._untied or self._tied is None:
            return []
        apart = np.abs(motions.p_WT - self._tied.p_WT).max(axis=1) / self.simulation.solver.dx
        turned = np.abs(motions.R_WT - self._tied.R_WT).max(axis=(1, 2))
        off = np.maximum(apart, turned) > ASTRAY
        return [
            t.name
            for t, away in zip(self.tools, off, strict=True)
            if away and t.contact == "bonded"
        ]

    def start(self) -> Snapshot:
        """The bodies in their rest shapes, at rest."""
        body = self.simulation.body
        F = np.tile(np.eye(3) / (1.0 + self._swelling), (len(body.x), 1, 1))
        self.simulation.reset(body.x, np.zeros_like(body.x), F=F)
        none = np.zeros((len(self.tools), 3))
        return Snapshot(self.simulation.state(), none, none, self.rest, self._tied)

    def overlaps(self, motions: Motions) -> dict[str, float]:
        """How deep particles at rest lie inside the tools that touch them [m], by tool."""
        found = {}
        radius = np.cbrt(np.prod(self.simulation.body.half, axis=1))
        for n, tool in enumerate(self.tools):
            local = (self.rest - motions.p_WT[n]) @ motions.R_WT[n]
            depth = radius - tool.solid.distance(local)
            if tool.contact not in ("tied", "bonded") and np.any(depth > TOUCH * radius):
                found[tool.name] = float(depth.max())
        return found

    def advance(
        self, start: Snapshot, motions: Motions, duration: float, damping: float = 0.0
    ) -> Snapshot:
        """The bodies a time [s] later, the tools going on as they move at its begin.

        What a tool holds knows velocities alone. Where the tool has come to be elsewhere than its velocities
        had it, that is made up for: else all would lag a step behind the places that a plant finds by its
        velocities after a step. See ``bear``.

        Args:
            start: where the bodies are; any earlier snapshot of this scene.
            motions: of the tools in the world at its time.
            duration: [s].
            damping: rate at which velocities decay [1/s], beside the drag.
        """
        way = (
            motions
            if start.left is None
            else _caught_up(motions, start.left, duration, self._catch)
        )
        end, _ = self.follow(start, [way], np.array([duration]), damping)
        return replace(end, left=_gone(way, start.left or motions, duration))

    def follow(
        self,
        start: Snapshot,
        motions: Sequence[Motions],
        durations: np.ndarray,
        damping: float = 0.0,
    ) -> tuple[Snapshot, np.ndarray]:
        """The same after several motions, one after the other.

        Returns:
            The bodies at their end, and the mean forces on the tools during each [N], shape [motions,
            tools, 3].

        Raises:
            ValueError: nobody has said what tied tools hold, or bonded ones over the rest shape.
        """
        if self._untied:
            raise ValueError(f"what is held by {', '.join(self._untied)} at rest: call tie first")
        simulation, forces = self.simulation, np.zeros((len(motions), len(self.tools), 3))
        moment = np.zeros_like(start.moment)
        simulation.restore(start.state)
        simulation.set_damping(damping + self.drag)
        for n, (way, duration) in enumerate(zip(motions, durations.tolist(), strict=True)):
            simulation.tools.move(replace(way, p_WT=way.p_WT - self.corner))
            simulation.tools.forget()
            simulation.advance(duration)
            forces[n], moment = (j / duration for j in simulation.tools.impulses())
        state = simulation.state()
        return Snapshot(state, forces[-1], moment, state.x + self.corner), forces


def _caught_up(now: Motions, left: Motions, duration: float, share: np.ndarray) -> Motions:
    """With velocities that lead to where tools go from where they were left, or a share of that way."""
    turned = Rotation.from_matrix(now.R_WT @ left.R_WT.swapaxes(-1, -2)).as_rotvec()
    v, w = (share[:, None] * off / duration for off in (now.p_WT - left.p_WT, turned))
    return replace(now, v_WT=now.v_WT + v, w_WT=now.w_WT + w)


def _gone(way: Motions, left: Motions, duration: float) -> Motions:
    """Where velocities lead from where tools were left."""
    turn = Rotation.from_rotvec(duration * way.w_WT).as_matrix()
    return replace(way, p_WT=left.p_WT + duration * way.v_WT, R_WT=turn @ left.R_WT)


def region_around(
    body: np.ndarray, room: np.ndarray, dx: float, places: Mapping[int, float], phase: float = 0.5
) -> np.ndarray:
    """Corners [m] of a region with room around a box, shape [2, 3].

    The grid lies evenly about the middle of the box, its nodes as near to the faces as that allows:
    a box among symmetric tools then deforms symmetrically.

    Args:
        body: lower and upper corner of the box [m], shape [2, 3].
        room: left on either side along each axis [m], shape [3].
        dx: grid spacing [m].
        places: by axis, a coordinate [m] that is to lie a ``phase`` beyond a node: half-way to the next,
            as the face of a clamp should, or a quarter, as those of plates should.
        phase: in cells.
    """
    low, high = body[0] - room, body[1] + room
    odd = np.rint((body[1] - body[0]) / dx) % 2.0
    low -= ((0.5 * odd - (0.5 * (body[0] + body[1]) - low) / dx) % 1.0) * dx
    for axis, place in places.items():
        low[axis] -= ((phase - (place - low[axis]) / dx) % 1.0) * dx
    return np.stack([low, high])
