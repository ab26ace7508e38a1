"""The solver's own stress in the balance of the identification: what the simulator itself is wrong by.

The probe is simulated once more and all particles are quadrature points: their positions, velocities
and Kirchhoff stresses stand in the test fields and windows that the identification chooses for its
recording (each contraction of a pressed block by itself, also where it takes their mean). The factor by
which that stress has to be scaled for the balance of momentum to close is the error that a perfect
reading of the motion would be left with. No fit of tracks is in it. From fewer frames a second, it is the
error that vibrations make which are too fast for those.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import interp1d

from form_drake.bench.probes_motions import Motions
from form_drake.material import Material
from form_drake.motion import Body, Motion, body
from form_drake.mpm.exchange import Snapshot
from form_drake.records import Recording
from form_drake.systems.behind import steps_between
from form_drake.systems.probe import Run, begin, finish, prepare
from form_drake.systems.scenario import load_scenario
from form_drake.weak.axial import AxialFields
from form_drake.weak.balance import balance
from form_drake.weak.choice import chosen_windows
from form_drake.weak.families import RAMPS, bend
from form_drake.weak.fields import Fields
from form_drake.weak.force import measured
from form_drake.weak.windows import Windows, windows

BLOCK = 25  # fewest frames that are integrated at once
RATES = (30.0, 58.8, 60.0, 100.0)  # of frames [Hz], or a little more: whole periods of the solver
PHASES = 4  # first frames, about
AT_YIELD = 1e-3  # share below the yield stress that still counts as yielding
# share of the volume that yields, at most in elastic and at least in yielded windows: layers at the
# ends, where contact acts inside of the surface, may never yield
NONE, MOST = 1e-3, 0.75


@dataclass(frozen=True)
class Integrals:
    """Sums over the particles at the frames, see ``form_drake.weak.balance``.

    Attributes:
        time: from the first frame on [s], shape [frames].
        stress: of the simulator's own stress, shape [frames, fields] [N m].
        load: weight and what the fields' own motion carries, shape [frames, fields] [N m].
        momentum: shape [frames, fields] [N m s].
        end: values of the fields where the tool acts, shape [frames, fields, 3].
        yielding: share of the volume that is at its yield stress, shape [frames].
    """

    time: np.ndarray
    stress: np.ndarray
    load: np.ndarray
    momentum: np.ndarray
    end: np.ndarray
    yielding: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Integrals"]) -> "Integrals":
        """Frames of several, in order of time."""
        names = cls.__dataclass_fields__
        return cls(**{k: np.concatenate([getattr(p, k) for p in parts]) for k in names})

    def at(self, frames: np.ndarray) -> "Integrals":
        """Some of the frames; time runs from the first of them on."""
        names = type(self).__dataclass_fields__
        part = Integrals(**{k: getattr(self, k)[frames] for k in names})
        return replace(part, time=part.time - part.time[0])


@dataclass(frozen=True)
class Particles:
    """What of a run is integrated, and in which fields.

    Attributes:
        run: of the probe.
        recording: of the same probe, for what is known of body, tool and weight.
    """

    run: Run
    recording: Recording

    @property
    def tool(self) -> str:
        """The one whose force is measured."""
        (name,) = self.recording.forces
        return name

    def integrals(self, stamps: np.ndarray, snapshots: Sequence[Snapshot]) -> Integrals:
        """Sums at snapshots with stamps [s], shape [frames]."""
        motion = self._motion(stamps - self.recording.time[0], snapshots)
        T = np.array([s.state.tau for s in snapshots], dtype=float)
        fields = like_fields(self.recording, motion)
        gravity = np.asarray(self.recording.gravity) / self.recording.mass_scale
        found = balance(fields, motion, gravity)
        return Integrals(
            motion.time,
            found.stress(T, np.eye(len(T))),
            found.rest.load + found.rest.carried,
            found.rest.momentum,
            fields.acting(motion)[self.tool],
            yielding(T, self.run.scenario.specimen.made()),
        )

    def _motion(self, time: np.ndarray, snapshots: Sequence[Snapshot]) -> Motion:
        """The particles; F is the elastic part, which material fields of elastic laws alone read."""
        scene = self.run.station.material.scene
        states = [s.state for s in snapshots]
        v, F, L = (np.array([getattr(s, k) for s in states], float) for k in "vFL")
        x = np.array([s.p_WQ for s in snapshots])
        body = scene.simulation.body
        return Motion(time, scene.rest, x, v, F, L, body.volume, body.mass)


def yielding(T: np.ndarray, material: Material) -> np.ndarray:
    """Share of equal points that are at their yield stress, shape [frames].

    Args:
        T: Kirchhoff stresses [Pa], shape [frames, points, 3, 3].
        material: zero where it has no yield stress.
    """
    bound = material.values.get("tau_y", np.inf)
    dev = T - np.trace(T, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)
    size = np.sqrt(np.sum(dev**2, axis=(-1, -2)))
    found: np.ndarray = np.mean(size >= (1.0 - AT_YIELD) * bound, axis=1)
    return found


def like_fields(recording: Recording, motion: Motion) -> Fields:
    """As the identification chooses them, between the faces of the particles themselves."""
    shape = body(recording)
    return (bend(recording, shape) or [_axial(recording, shape, motion)])[0]


def _axial(recording: Recording, shape: Body, motion: Motion) -> AxialFields:
    (face,) = (f for f in shape.faces if f.tool in recording.forces)
    axis = face.axis
    levels, level = np.unique(np.round(motion.X[:, axis], 9), return_inverse=True)
    last = len(levels) - 1
    a, b, c, d = (motion.x[:, level == n, axis].mean(axis=1) for n in (0, 1, last - 1, last))
    ends = [1.5 * a - 0.5 * b, 1.5 * d - 0.5 * c]  # half a spacing beyond the outermost particles
    return AxialFields(
        axis=axis,
        origin=0.5 * (shape.low + shape.high),
        time=motion.time,
        start=ends[1 - face.side],
        length=ends[1] - ends[0],
        lateral=np.delete(np.eye(3), axis, axis=0),
        ramps=RAMPS,
        sign=1 if face.side else -1,
        tool=face.tool,
        breaks=(),
    )


def gathered(run: Run, recording: Recording) -> Integrals:
    """Simulate the probe and integrate over its particles at every frame of its recording."""
    particles, simulator = Particles(run, recording), begin(run)
    period, material = run.scenario.solver.period, run.station.material
    context = material.GetMyContextFromRoot(simulator.get_context())
    steps = {round(float(t) / period): n for n, t in enumerate(recording.time)}
    blocks = max(recording.frames // BLOCK, 1)
    full = set(np.linspace(0, recording.frames, blocks + 1).astype(int).tolist())
    held: list[Snapshot] = []
    parts: list[Integrals] = []

    def hear(step: int, _: int) -> None:
        if step not in steps:
            return
        held.append(material.snapshot(context))
        end = steps[step] + 1
        if end in full:
            parts.append(particles.integrals(recording.time[end - len(held) : end], held))
            held.clear()

    finish(run, simulator, hear)
    return Integrals.joined(parts)


def rows(recording: Recording, of: Integrals, over: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of the own stress and what they have to be [N m s], shape [windows, fields] each."""
    (force,) = measured(recording, 0.0, float(of.time[-1])).values()
    at = np.clip(force.time, of.time[0], of.time[-1])
    power = np.sum(interp1d(of.time, of.end, axis=0)(at) * force.value[:, None], axis=-1)
    b = over.chi @ of.load + over.rate @ of.momentum - force.impulses(over.ends) @ power
    return over.chi @ of.stress, b


def stages(of: Integrals, over: Windows, material: Material) -> dict[str, np.ndarray]:
    """Windows that tell E, since nothing has yielded yet, and tau_y, since most of the volume yields.

    Returns:
        shape [windows] each; ``all`` of them beside.
    """
    every = np.ones(len(over), dtype=bool)
    if "tau_y" not in material.values:
        return {"E": every}
    now = over.chi @ of.yielding / over.chi.sum(axis=1)
    so_far = np.array([of.yielding[of.time <= end].max() for end in over.ends[:, 1]])
    return {"E": so_far <= NONE, "tau_y": now >= MOST, "all": every}


def factors(recording: Recording, of: Integrals, material: Material) -> dict[str, Any]:
    """By how much the own stress has to be scaled, by stage.

    Args:
        recording: of the probe.
        of: what ``gathered`` has found.
        material: that was simulated.

    Returns:
        Of every stage that has windows the error [%], the number of rows, and the norm of what the
        unscaled stress leaves of them [%].
    """
    over = windows(of.time, chosen_windows(recording, material.law, None))
    A, b = rows(recording, of, over)
    found = {}
    for key, stage in stages(of, over, material).items():
        own, wanted = A[stage].ravel(), b[stage].ravel()
        if len(own):
            size = float(own @ own)
            found[key] = {
                "error": 100.0 * (float(own @ wanted) / size - 1.0),
                "rows": len(own),
                "left": 100.0 * float(np.linalg.norm(wanted - own)) / np.sqrt(size),
            }
    return found


def own_stress(motions: Motions, name: str, made: tuple[str, ...]) -> dict[str, Any]:
    """Errors that the simulator leaves to E in elastic and to tau_y in yielded windows."""
    scenario = load_scenario(name, made)
    recording = motions.recording(name, made)
    found = gathered(prepare(scenario), recording)
    return {"errors": factors(recording, found, scenario.specimen.made())}


def by_rate(
    motions: Motions, name: str, made: tuple[str, ...], rates: Sequence[float] = RATES
) -> dict[str, Any]:
    """Those errors for frames after so many solver periods, with several first frames."""
    scenario = load_scenario(name, made)
    recording, period = motions.recording(name, made), scenario.solver.period
    first, last = (round(float(t) / period) for t in recording.time[[0, -1]])
    stamps = period * np.arange(first, last + 1)
    found = gathered(prepare(scenario), _at_frames(recording, stamps))
    material, told = scenario.specimen.made(), {}
    for rate in (*rates, 1.0 / period):
        step = steps_between(rate, period)
        errors = []
        for start in range(0, step, max(step // PHASES, 1)):
            frames = np.arange(start, len(stamps), step)
            own = factors(_at_frames(recording, stamps[frames]), found.at(frames), material)
            errors.append({k: v["error"] for k, v in own.items() if k != "all"})
        told[f"{1.0 / (step * period):.1f}"] = errors
    return {"rates": told}


def _at_frames(recording: Recording, time: np.ndarray) -> Recording:
    """A recording of as many frames, for its stamps [s] alone."""
    still = np.broadcast_to(recording.p_WQ[:1], (len(time), *recording.p_WQ.shape[1:]))
    return replace(recording, time=time, p_WQ=still, valid=None)
