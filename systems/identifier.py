"""Identification while the probe still moves."""

from collections.abc import Callable
from dataclasses import dataclass

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from form_drake.identify import Identification, Unidentifiable, identify


@dataclass(frozen=True)
class Answer:
    """The newest answer; never written again.

    Attributes:
        time: of the recording that it is made from [s].
        identification: None as long as the motion determines nothing.
        reason: why there is none.
    """

    time: float = 0.0
    identification: Identification | None = None
    reason: str = "nothing was recorded yet"

    def __deepcopy__(self, memo: object) -> "Answer":
        return self


class Identifier(LeafSystem):
    """Identifies the material again and again from all that was recorded so far.

    Every answer is that of ``identify`` on the recording of its time: the last one is the batch
    answer.

    Ports: in ``recording`` (``Recording`` or None); out ``material`` (``Answer``).

    Args:
        every: time between answers [s].
        force: source of the force.
        told: called with every answer.
    """

    def __init__(
        self,
        *,
        every: float = 0.25,
        force: str = "sensor",
        told: Callable[[Answer], None] = lambda _: None,
    ):
        super().__init__()
        self._force, self._told = force, told
        self.DeclareAbstractInputPort("recording", Value[object](None))
        self._answer = self.DeclareAbstractState(Value[object](Answer()))
        self.DeclareAbstractOutputPort(
            "material",
            lambda: Value[object](None),
            lambda context, out: out.set_value(self.answer(context)),
            {self.abstract_state_ticket(self._answer)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(every, every, self._update)

    def answer(self, context: Context) -> Answer:
        """The newest answer."""
        return context.get_abstract_state(int(self._answer)).get_value()

    def _update(self, context: Context, state: State) -> EventStatus:
        recording = self.get_input_port().Eval(context)
        if recording is None:
            return EventStatus.DidNothing()
        time = float(recording.time[-1])
        try:
            new = Answer(time, identify(recording, method="weak", force=self._force), "")
        except (Unidentifiable, ValueError) as refusal:
            new = Answer(time, None, str(refusal))
        state.get_mutable_abstract_state(int(self._answer)).set_value(new)
        self._told(new)
        return EventStatus.Succeeded()
