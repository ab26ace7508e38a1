"""Identification while the probe still moves."""

from collections.abc import Callable
from dataclasses import dataclass

from pydrake.common.value import Value
from pydrake.systems.framework import Context

from form_drake.identify import Identification, Unidentifiable, identify
from form_drake.records import Recording
from form_drake.systems.behind import Behind, steps_between


@dataclass(frozen=True)
class Answer:
    """What a recording says so far.

    Attributes:
        time: of the recording that it is made from [s].
        identification: None as long as the motion determines nothing.
        reason: why there is none.
    """

    time: float
    identification: Identification | None
    reason: str = ""


class Identifier(Behind):
    """Identifies the material again and again from all that was recorded so far.

    Every answer is that of ``identify`` on the recording of its time: the one with which a probe is
    concluded is the batch answer.

    Ports: in ``recording`` (``Recording`` or None); out ``material`` (``Result`` of an ``Answer``).

    Args:
        every: time between answers [s].
        period: step of the simulation [s].
        wait: whether simulated time waits for the work, see ``Behind``.
        force: source of the force.
        told: called with every answer, from a thread where nothing waits.
    """

    def __init__(
        self,
        *,
        every: float = 0.5,
        period: float = 0.001,
        wait: bool = True,
        force: str = "sensor",
        told: Callable[[Answer], None] = lambda _: None,
    ):
        steps = steps_between(1.0 / every, period)
        super().__init__("material", period=period, every=steps, begin=steps, wait=wait)
        self._force, self._told = force, told
        self.DeclareAbstractInputPort("recording", Value[object](None))

    def newest(self, context: Context, after: float) -> tuple[float, Recording] | None:
        """As of the base."""
        recording = self.get_input_port().Eval(context)
        if recording is None or recording.time[-1] <= after:
            return None
        return float(recording.time[-1]), recording

    def worked(self, memory: None, time: float, given: Recording) -> tuple[None, Answer]:
        """As of the base."""
        try:
            answer = Answer(time, identify(given, method="weak", force=self._force))
        except (Unidentifiable, ValueError) as refusal:
            answer = Answer(time, None, str(refusal))
        self._told(answer)
        return None, answer
