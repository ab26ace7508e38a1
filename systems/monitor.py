"""Prediction beside measurement while the diagram runs, and an alarm where they part."""

from collections.abc import Callable

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from form_drake.diagnose.watch import Alarm, Watch


class Monitor(LeafSystem):
    """Watches whether a probe goes as a model of the specimen predicts.

    Ports: in ``recording`` (``Recording`` or None, what was measured so far); out ``alarm`` (``Alarm``,
    None as long as all goes as predicted; the first one stays) and ``excess`` (the last whole window
    of each of ``watch.channels`` over its limit, above 1 where it is exceeded, NaN where nothing was
    compared).

    Args:
        watch: the prediction of the whole motion.
        every: time between looks [s].
        told: called once, with the alarm.
    """

    def __init__(
        self,
        watch: Watch,
        *,
        every: float = 0.1,
        told: Callable[[Alarm], None] = lambda alarm: None,
    ):
        super().__init__()
        self._watch, self._told = watch, told
        self.DeclareAbstractInputPort("recording", Value[object](None))
        self._alarm = self.DeclareAbstractState(Value[object](None))
        self._excess = self.DeclareDiscreteState(np.full(len(watch.channels), np.nan))
        self.DeclareAbstractOutputPort(
            "alarm",
            lambda: Value[object](None),
            lambda context, out: out.set_value(self.alarm(context)),
            {self.abstract_state_ticket(self._alarm)},
        )
        self.DeclareStateOutputPort("excess", self._excess)
        self.DeclarePeriodicUnrestrictedUpdateEvent(every, every, self._update)

    def alarm(self, context: Context) -> Alarm | None:
        """The alarm, if there is one."""
        found: Alarm | None = context.get_abstract_state(int(self._alarm)).get_value()
        return found

    def _update(self, context: Context, state: State) -> EventStatus:
        recording = self.get_input_port().Eval(context)
        if recording is None:
            return EventStatus.DidNothing()
        excess, found = self._watch.look(recording)
        last = [e[-1] if len(e) else np.nan for _, e in excess.values()]
        state.get_mutable_discrete_state(int(self._excess)).set_value(np.array(last))
        if found is not None and self.alarm(context) is None:
            state.get_mutable_abstract_state(int(self._alarm)).set_value(found)
            self._told(found)
        return EventStatus.Succeeded()
