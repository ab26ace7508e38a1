"""A block between faces that move as recorded: what a recording states, simulated without a robot."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from form_drake.effects.world import World
from form_drake.laws.memory import NEVER
from form_drake.laws.values import check_moduli
from form_drake.material import Material
from form_drake.motion import Body as Shape
from form_drake.motion import Face, Motion, body
from form_drake.mpm.bodies import block, by_material
from form_drake.mpm.exchange import Scene, Snapshot, region_around
from form_drake.mpm.settling import rested
from form_drake.mpm.solids import Solid
from form_drake.mpm.tools import Grip, Tool
from form_drake.mpm.tracing import between
from form_drake.mpm.ways import Path, followed, motions_of, require_apart
from form_drake.records import Recording, Stream

PERIOD = 2e-3  # longest time [s] for which tools go straight on
SETTLING = 0.15  # time [s] that the body is given to come to rest
COMING = 0.5  # of it, in which tools come to where they begin: what yields remembers a sudden one
CALM = 250.0  # rate [1/s] at which velocities decay meanwhile
QUARTER = 0.25  # of a cell, by which faces lie beyond a node


@dataclass(frozen=True)
class Stage:
    """What is simulated again.

    Attributes:
        recording: of a block whose box, faces, and poses of tools that touch it are stated; what acts on
            it besides is gravity.
        dx: grid spacing [m].
        precision: ``float32`` or ``float64``.
        device: Warp device.
    """

    recording: Recording
    dx: float
    precision: str = "float32"
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.recording.body_force is not None:
            raise ValueError("the recording states body_force, which no block is simulated with")

    def world(self, material: Material) -> World:
        """The plain scene of a material, as the recording states it.

        Raises:
            ValueError: the material has effects, which change a scene once it is made, or a modulus that is
                not positive.
        """
        check_moduli(material.law, material.values)
        if material.effects:
            ids = ", ".join(one.id for one in material.effects)
            raise ValueError(
                f"the material has effects ({ids}): simulate it as a Model of"
                " form_drake.diagnose, which applies them"
            )
        gravity = np.zeros(3) if self.recording.gravity is None else self.recording.gravity
        return World(material.law, material.values, self._shape.density, np.asarray(gravity, float))

    @property
    def _shape(self) -> Shape:
        return body(self.recording)

    @property
    def spacing(self) -> float:
        """Of the grid [m]: near ``dx``, so that held faces lie a quarter of a cell off nodes."""
        return self._grid(self._shape, self._held(self._shape))[0]

    def rolled(self, world: World) -> Recording:
        """The recording with points and forces of the simulation in place of the measured ones.

        Raises:
            ValueError: the recording does not state what is needed, or the simulation fails.
        """
        return self._set(world).recorded()

    def moving(self, world: World) -> tuple[Recording, Motion]:
        """The same, and the motion of all particles at the frames; F is the elastic part."""
        play = self._set(world)
        return play.recorded(), play.motion()

    def _set(self, world: World) -> "_Play":
        shape = self._shape
        held = self._held(shape)
        paths = [Path.of(self.recording, shape, face) for face in held]
        dx, places = self._grid(shape, held)
        size, middle = shape.high - shape.low, 0.5 * (shape.low + shape.high)
        bodies = by_material(world, block(middle, size, 0.5 * dx, world.density))
        scene = Scene(
            [m for m, _ in bodies],
            [b for _, b in bodies],
            [_tool(face) for face in held],
            region=region_around(
                np.stack([shape.low, shape.high]), np.zeros(3), dx, places, QUARTER
            ),
            dx=dx,
            gravity=world.gravity,
            mass_scale=self.recording.mass_scale,
            memories=world.memories,
            drag=world.drag,
            swelling=world.swelling,
            total=True,
            precision=self.precision,
            device=self.device,
        )
        return _Play(self.recording, world, scene, paths)

    def _held(self, shape: Shape) -> list[Face]:
        """Faces that a tool or support holds.

        Raises:
            ValueError: one of which nobody knows how it is held, or a measured tool without poses; or
                nothing holds the body.
        """
        poses, last = self.recording.poses, self.recording.time[[0, -1]]
        for face in shape.faces:
            name = f"{'xyz'[face.axis]}{'-+'[face.side]}"
            if face.condition not in ("free", "bonded", "frictionless"):
                raise ValueError(
                    f"face {name} is {face.condition}: only faces that are free, or bonded or"
                    " frictionless as a whole, can be simulated"
                )
            if face.tool in self.recording.forces and face.tool not in poses:
                raise ValueError(f"{face.tool} presses {name}: to simulate it, add its poses")
            if face.tool in poses and not _within(last, poses[face.tool].time):
                stamps = poses[face.tool].time[[0, -1]]
                raise ValueError(
                    f"poses of {face.tool} are stamped {stamps} s, the frames {last} s: they must"
                    " cover the frames"
                )
        self._require_named(shape)
        held = [f for f in shape.faces if f.condition != "free"]
        if not held:
            raise ValueError("all faces are free: a block that nothing holds is not simulated")
        return held

    def _require_named(self, shape: Shape) -> None:
        """Refuse tools of which no face says that it is theirs: they would stand still, or feel nothing."""
        named = {f.tool for f in shape.faces}
        lost = sorted(set(self.recording.forces) - named)
        if any(f.condition != "free" and not f.tool for f in shape.faces):
            lost += sorted(set(self.recording.poses) - named - set(lost))
        if lost:
            raise ValueError(
                f"no face names {', '.join(lost)} in contact; name the one that it holds, such as"
                f' {{"z+": "frictionless {lost[0]}"}}'
            )

    def _grid(self, shape: Shape, held: list[Face]) -> tuple[float, dict[int, float]]:
        """A spacing near ``dx`` [m], and places a quarter of a cell off nodes [m], by axis.

        There, with two particles to a cell, what a plate gives nodes is what an even stress gives them:
        it stays even. So half-cells fit the edge of the body between the first pair of held faces.
        """
        dx, places = self.dx, dict[int, float]()
        for face in held:
            if not places:
                edge = float((shape.high - shape.low)[face.axis])
                dx = 2.0 * edge / max(round(2.0 * edge / self.dx), 2)
            places.setdefault(face.axis, float((shape.low, shape.high)[face.side][face.axis]))
        return dx, places


@dataclass(frozen=True)
class _Play:
    """One run of a stage."""

    recording: Recording
    world: World
    scene: Scene
    paths: list[Path]

    @cached_property
    def _time(self) -> np.ndarray:
        time: np.ndarray = self.recording.time - self.recording.time[0]
        return time

    @cached_property
    def _run(self) -> tuple[list[Snapshot], np.ndarray, np.ndarray]:
        """Snapshots at the frames; stamps [s] of mean forces on the faces [N]."""
        counts = np.ceil(np.diff(self._time) / PERIOD - 1e-9).astype(int)
        parts = [
            np.linspace(a, z, n + 1)[1:]
            for (a, z), n in zip(pairwise(self._time), counts, strict=True)
        ]
        ends = np.concatenate([[0.0], *parts])
        require_apart(self.paths, ends)
        snapshot = self._settled()
        frames, forces, late = [snapshot], [snapshot.force], []
        steps = np.diff(ends)
        motions = motions_of([followed(p.at(ends), steps) for p in self.paths], steps)
        for first, last in pairwise(np.append(0, np.cumsum(counts)).tolist()):
            own = slice(first, last)
            snapshot, mean = self.scene.follow(snapshot, motions[own], steps[own])
            forces.extend(mean)
            frames.append(snapshot)
            late += [0.5 * self.scene.simulation.dt] * len(mean)
            if not np.linalg.det(snapshot.state.T).min() > 0.0:
                raise ValueError(
                    f"the simulated body turns inside out {ends[last]:.3g} s after the first frame: it is"
                    " pressed or pulled too far for its grid, or its material is unstable; check poses,"
                    " units and values"
                )
        # the impulses of a step balance stresses as they are where it begins
        stamps = np.concatenate([[0.0], 0.5 * (ends[1:] + ends[:-1]) - late, ends[-1:]])
        return frames, stamps, np.array([*forces, snapshot.force])

    def _settled(self) -> Snapshot:
        """At rest among the tools, whatever relaxes having relaxed; none of them slips or sticks."""
        scene, world = self.scene, self.world
        count = int(np.ceil(SETTLING / PERIOD))
        share = np.clip(np.linspace(0.0, 1.0 / COMING, count + 1), 0.0, 1.0)
        motions = motions_of([p.coming(share) for p in self.paths], np.full(count, PERIOD))
        scene.tie(motions[0])
        self._grip(replace(world, friction=0.0, adhesion=0.0, slipping=0.0, slippery=0.0))
        snapshot = scene.start()
        relaxed = [replace(m, rate=NEVER if m.rate else 0.0) for m in world.memories]
        scene.simulation.set_memories(relaxed)
        snapshot, _ = scene.follow(snapshot, motions, np.full(count, PERIOD), CALM)
        snapshot = rested(scene, snapshot, motions[-1])
        scene.simulation.set_memories(world.memories)
        self._grip(world)
        return snapshot

    def _grip(self, world: World) -> None:
        """Say how tools hold: those that touch, those that bond, and supports among these."""
        tools = self.scene.simulation.tools
        for n, (tool, path) in enumerate(zip(self.scene.tools, self.paths, strict=True)):
            if tool.contact != "tied":
                tools.grip(n, Grip(world.friction, world.adhesion))
            elif path.tool not in self.recording.forces:
                friction = 1.0 / world.slippery if world.slippery > 0.0 else -1.0
                tools.grip(n, Grip(friction, compliance=world.slipping))

    def recorded(self) -> Recording:
        """What would have been recorded."""
        (frames, stamps, forces), streams = self._run, {}
        for name, measured in self.recording.forces.items():
            own = sum(forces[:, n] for n, path in enumerate(self.paths) if path.tool == name)
            at = measured.time - self.recording.time[0]
            value = np.stack([np.interp(at, stamps, f) for f in np.asarray(own).T], axis=1)
            streams[name] = Stream(measured.time, value)
        rest, X = self.scene.rest, self.recording.reference
        follow = between(X, rest)
        return replace(
            self.recording,
            p_WQ=np.array([X + follow @ (f.p_WQ - rest) for f in frames]),
            p_reference=self.recording.reference,
            valid=None,
            forces=streams,
            noise=None,
        )

    def motion(self) -> Motion:
        """Of the particles."""
        frames, body = self._run[0], self.scene.simulation.body
        v, F, L = (np.array([getattr(f.state, k) for f in frames]) for k in "vFL")
        x = np.array([f.p_WQ for f in frames])
        return Motion(self._time, self.scene.rest, x, v, F, L, body.volume, body.mass)


def _within(ends: np.ndarray, stamps: np.ndarray) -> bool:
    """Whether stamps cover a time [s], but for what clocks round."""
    near = 1e-6 * (ends[1] - ends[0])
    return bool(stamps[0] <= ends[0] + near and stamps[-1] >= ends[1] - near)


def _tool(face: Face) -> Tool:
    return Tool(
        face.tool or "face",
        Solid.half_space(),
        "tied" if face.condition == "bonded" else 0.0,
        plate=True,
    )
