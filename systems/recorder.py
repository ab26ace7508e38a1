"""What a probe measures, gathered in the Context of the diagram while it runs."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from form_drake.perceive.rig import Rig
from form_drake.perceive.seen import Sight, completed, gathered
from form_drake.records import Recording, Stream
from form_drake.systems.behind import Result, steps_between
from form_drake.systems.force import draws

FORCES = {"sensor": "tool.force", "joint-torque": "tool.force_from_torque"}


@dataclass(frozen=True)
class Heard:
    """Samples so far, oldest first; never written again.

    Attributes:
        sights: of the points.
        signals: stamps [s], X_WT as matrix, joint angles [rad], and a force [N] from each source.
    """

    sights: tuple[Sight, ...] = ()
    signals: tuple[tuple[float, np.ndarray, np.ndarray, tuple[np.ndarray, ...]], ...] = ()

    def __deepcopy__(self, memo: object) -> "Heard":
        return self


@dataclass(frozen=True)
class Source:
    """Who tells a recorder where points are.

    Attributes:
        tracks: a system whose only output is the points' ``sight``.
        header: what is known of the points before, see ``Recorder``.
        rate: of their frames [Hz].
        rig: whose cameras follow them; None: they are particles.
    """

    tracks: LeafSystem
    header: Recording
    rate: float
    rig: Rig | None = None


class ParticleTracks(LeafSystem):
    """Chosen particles of a simulation as a tracker would report them.

    Noise is a function of seed and time, so that a cloned Context repeats it.

    Ports: in ``particles`` (``Snapshot``); out ``sight`` (``Result`` of a ``Sight``), as a tracker's.

    Args:
        chosen: indices of the particles.
        noise: standard deviation of a coordinate [m].
        seed: of it.
        period: step of the simulation [s].
    """

    def __init__(self, chosen: np.ndarray, noise: float, seed: int, period: float):
        super().__init__()
        self._chosen, self._noise, self._seed, self._period = chosen, noise, seed, period
        self.DeclareAbstractInputPort("particles", Value[object](None))
        self.DeclareAbstractOutputPort("sight", lambda: Value[object](None), self._calc)

    def _calc(self, context: Context, output: Value) -> None:
        p_WQ = self.get_input_port().Eval(context).p_WQ[self._chosen]
        if self._noise:
            rng = draws(self._seed, "tracks", round(context.get_time() / self._period))
            p_WQ = p_WQ + rng.normal(0.0, self._noise, p_WQ.shape)
        time = context.get_time()
        output.set_value(Result(time, Sight(time, p_WQ), age=0.0))


class Recorder(LeafSystem):
    """Gathers tracked points, poses, joints and forces.

    Ports: in ``sight`` (``Result`` of a ``Sight``, each kept once), ``tool.X_WT``,
    ``panda.position_measured``, ``tool.force`` and ``tool.force_from_torque``; out ``recording``: the
    ``Recording`` so far, or None before its second frame.

    Args:
        header: a recording of the specimen and tool, of which stamps, points, poses, forces and
            joints are replaced.
        tool: name of the tool in it.
        begin: when recording begins [s].
        rate: of frames [Hz].
        period: of the other signals [s]; forces are means over it.
        rig: whose cameras follow the points; None: they are particles.
        sensed: what sensors tell of what they would record without an effect.
        off: what is added to the tool's place [m], shape [3]; None: nothing.
    """

    def __init__(
        self,
        header: Recording,
        tool: str,
        *,
        begin: float,
        rate: float,
        period: float,
        rig: Rig | None = None,
        sensed: Callable[[Recording], Recording] = lambda recording: recording,
        off: np.ndarray | None = None,
    ):
        super().__init__()
        self._off = np.zeros((4, 4))
        if off is not None:
            self._off[:3, 3] = off
        self._header, self._tool, self._period, self._rig = header, tool, period, rig
        self._sensed = sensed
        self.DeclareAbstractInputPort("sight", Value[object](None))
        self.DeclareAbstractInputPort("tool.X_WT", Value[RigidTransform]())
        self.DeclareVectorInputPort("panda.position_measured", 7)
        for port in FORCES.values():
            self.DeclareVectorInputPort(port, 3)
        self._heard = self.DeclareAbstractState(Value[object](Heard()))
        self.DeclareAbstractOutputPort(
            "recording",
            lambda: Value[object](None),
            lambda context, out: out.set_value(self.recording(context)),
            {self.abstract_state_ticket(self._heard)},
        )
        self._first = round(begin / period)
        self._every = steps_between(rate, period)
        # one event at multiples of the period from 0 on, as the plant's: what was computed as
        # 0.05 + 0.001 would come a round-off apart from it, before or after the step
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._hear)

    def heard(self, context: Context) -> Heard:
        """The samples so far."""
        return context.get_abstract_state(int(self._heard)).get_value()

    def recording(self, context: Context) -> Recording | None:
        """What was recorded so far."""
        heard = self.heard(context)
        if len(heard.sights) < 2:
            return None
        time = np.array([s[0] for s in heard.signals])
        middle = time - 0.5 * self._period
        forces = {}
        for n, source in enumerate(FORCES):
            name = self._tool if source == "sensor" else f"{self._tool}:{source}"
            values = np.array([s[3][n] for s in heard.signals])
            forces[name] = Stream(middle, values, self._header.forces[name].noise)
        X_WT = np.array([s[1] for s in heard.signals]) + self._off
        probe = replace(
            self._header,
            poses={self._tool: Stream(time, X_WT, self._header.poses[self._tool].noise)},
            forces=forces,
            joints=Stream(time, np.array([s[2] for s in heard.signals])),
        )
        if self._rig is not None:
            return self._sensed(completed(gathered(self._rig, heard.sights), probe))
        tracks = {k: np.array([getattr(s, k) for s in heard.sights]) for k in ("time", "p_WQ")}
        return self._sensed(replace(probe, **tracks))

    def _hear(self, context: Context, state: State) -> EventStatus:
        time = context.get_time()
        step = round(time / self._period) - self._first
        if step < 0:
            return EventStatus.DidNothing()
        heard = self.heard(context)
        if step % self._every == 0:
            seen = self.GetInputPort("sight").Eval(context)
            last = heard.sights[-1].time if heard.sights else -np.inf
            if seen.time > last:
                heard = replace(heard, sights=(*heard.sights, seen.value))
        forces = tuple(np.array(self.GetInputPort(p).Eval(context)) for p in FORCES.values())
        X_WT = self.GetInputPort("tool.X_WT").Eval(context).GetAsMatrix4()
        q = np.array(self.GetInputPort("panda.position_measured").Eval(context))
        heard = replace(heard, signals=(*heard.signals, (time, X_WT, q, forces)))
        state.get_mutable_abstract_state(int(self._heard)).set_value(heard)
        return EventStatus.Succeeded()
