"""Follows a planned motion in time, up to a force if one is given."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State
from pydrake.trajectories import Trajectory

from form_drake.control import Follow, Progress, advanced


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
        # before what else changes at that time: a force that has been felt stops the tool
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._advance)

    def _progress(self, context: Context) -> Progress:
        along, rate, stopped, rest = context.get_discrete_state(self._state).value()
        return Progress(along, rate, bool(stopped), rest)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.value(self._progress(context).along)[:, 0])

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._progress(context).along)

    def _advance(self, context: Context, state: State) -> EventStatus:
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
        memory = state.get_mutable_discrete_state().get_mutable_vector(self._state)
        memory.SetFromVector([found.along, found.rate, float(found.stopped), found.rest])
        return EventStatus.Succeeded()
