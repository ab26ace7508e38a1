"""The inside of a body while it is probed."""

from dataclasses import dataclass

from pydrake.common.value import Value
from pydrake.systems.framework import Context

from form_drake.interior import Inside, inside
from form_drake.material import Material
from form_drake.records import Recording
from form_drake.systems.behind import Behind, steps_between
from form_drake.systems.identifier import Answer


@dataclass(frozen=True)
class Reconstruction:
    """What could be found of the inside.

    Attributes:
        inside: None, where what is seen does not do, as at first.
        reason: why.
    """

    inside: Inside | None
    reason: str = ""


class Reconstructor(Behind):
    """Finds how the inside of a body moves from what is seen of it so far.

    Ports: in ``recording`` (``Recording`` or None) and ``material`` (of an identifier; may stay unconnected:
    Hencky's elasticity stands in until one is found); out ``inside`` (``Result`` of a ``Reconstruction``).

    Args:
        every: time between reconstructions [s].
        period: step of the simulation [s].
        wait: whether simulated time waits for the work, see ``Behind``.
        force: source of the force.
    """

    def __init__(
        self,
        *,
        every: float = 0.25,
        period: float = 0.001,
        wait: bool = True,
        force: str = "sensor",
    ):
        steps = steps_between(1.0 / every, period)
        super().__init__("inside", period=period, every=steps, begin=steps, wait=wait)
        self._force = force
        self.DeclareAbstractInputPort("recording", Value[object](None))
        self.DeclareAbstractInputPort("material", Value[object](None))

    def newest(
        self, context: Context, after: float
    ) -> tuple[float, tuple[Recording, Material | None]] | None:
        """As of the base."""
        recording = self.GetInputPort("recording").Eval(context)
        if recording is None or recording.time[-1] <= after:
            return None
        port = self.GetInputPort("material")
        answer: Answer | None = port.Eval(context).value if port.HasValue(context) else None
        found = answer.identification if answer else None
        return float(recording.time[-1]), (recording, found.material if found else None)

    def worked(
        self, memory: None, time: float, given: tuple[Recording, Material | None]
    ) -> tuple[None, Reconstruction]:
        """As of the base."""
        try:
            return None, Reconstruction(inside(*given, force=self._force))
        except ValueError as refusal:
            return None, Reconstruction(None, str(refusal))
