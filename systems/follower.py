"""Follows a planned motion in time, up to a force if one is given."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.trajectories import Trajectory


@dataclass(frozen=True)
class Progress:
    """Where a follower is on its path.

    Attributes:
        along: time along the path [s].
        rate: seconds of the path per second: 1 follows it as planned, -1 goes back.
        stopped: whether the force was reached, or the end of a path that is to be gone back.
        rest: how long it has stood since [s].
    """

    along: float = 0.0
    rate: float = 0.0
    stopped: bool = False
    rest: float = 0.0


@dataclass
class Follow:
    """How a path is followed.

    Attributes:
        begin: when it begins [s].
        until_force: size of the measured force [N] at which it stops; None: goes to the end.
        brake: time in which it comes to a stop there, and in which it sets out to go back [s].
        hold: how long it stands there before it goes back the way it came [s]; None: it stays.
    """

    begin: float = 0.0
    until_force: float | None = None
    brake: float = 0.02
    hold: float | None = None

    def __post_init__(self) -> None:
        if self.until_force is not None and not self.until_force > 0.0:
            raise ValueError(f"until_force is {self.until_force:g} N: give a positive force")
        if not self.brake > 0.0 or self.begin < 0.0 or (self.hold is not None and self.hold < 0.0):
            raise ValueError(
                f"begin {self.begin:g} s, brake {self.brake:g} s, hold {self.hold} s: begin and"
                " hold must not be negative, brake must be positive"
            )


def advanced(
    now: Progress, follow: Follow, *, time: float, step: float, end: float, force: float
) -> Progress:
    """The progress one step later.

    Args:
        now: progress at ``time``.
        follow: the rules.
        time: [s].
        step: length of the step [s].
        end: length of the path [s].
        force: size of the measured force at ``time`` [N].
    """
    if time < follow.begin - 0.5 * step:
        return now
    reached = follow.until_force is not None and force >= follow.until_force
    ended = follow.hold is not None and now.along >= end
    stopped = now.stopped or reached or ended
    back = stopped and follow.hold is not None and now.rest >= follow.hold
    if not stopped:
        return replace(now, along=min(now.along + step, end), rate=1.0)
    change = step / follow.brake
    rate = now.rate + float(np.clip((-1.0 if back else 0.0) - now.rate, -change, change))
    along = float(np.clip(now.along + 0.5 * step * (now.rate + rate), 0.0, end))
    rest = now.rest + (step if rate == 0.0 else 0.0)
    return Progress(along, rate, stopped, rest)


class PathFollower(LeafSystem):
    """Joint angles along a planned motion.

    Ports: out ``position`` [rad] and ``time_along`` [s]; in ``force`` [N], three components, needed
    only with ``until_force``. All memory is in the Context. While nothing stops it, the angles at
    time t are exactly those planned for t - begin.
    """

    def __init__(self, motion: Trajectory, follow: Follow, *, period: float = 0.001) -> None:
        """Args: the motion (joint angles [rad] from time 0), the rules, the time step [s]."""
        super().__init__()
        self._motion, self._follow, self._period = motion, follow, period
        self._force = self.DeclareVectorInputPort("force", 3)
        self._state = self.DeclareDiscreteState(4)
        state = {self.discrete_state_ticket(self._state)}
        self.DeclareVectorOutputPort("position", motion.rows(), self._calc_position, state)
        self.DeclareVectorOutputPort("time_along", 1, self._calc_time, state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._advance)

    def _progress(self, context: Context) -> Progress:
        along, rate, stopped, rest = context.get_discrete_state(self._state).value()
        return Progress(along, rate, bool(stopped), rest)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.value(self._progress(context).along)[:, 0])

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._progress(context).along)

    def _advance(self, context: Context, state) -> None:
        force = 0.0
        if self._follow.until_force is not None:
            if not self._force.HasValue(context):
                raise ValueError("until_force needs the port force of the path follower connected")
            force = float(np.linalg.norm(self._force.Eval(context)))
        found = advanced(
            self._progress(context),
            self._follow,
            time=context.get_time(),
            step=self._period,
            end=self._motion.end_time(),
            force=force,
        )
        state.get_mutable_vector(self._state).SetFromVector(
            [found.along, found.rate, float(found.stopped), found.rest]
        )
