"""Points of a face, followed by two cameras while the diagram runs."""

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus, LeafSystem
from pydrake.systems.sensors import ImageRgba8U

from form_drake.figures import UNLIKE
from form_drake.perceive.rig import Rig
from form_drake.perceive.seen import Sight, followed
from form_drake.perceive.stereo import Followed
from form_drake.systems.behind import Behind, steps_between
from form_drake.systems.viewer import cloud

COLOURS = "plasma"  # those of the report
SIGHT, POINT, LIFT = (
    "/sight",
    1.5e-3,
    1.5e-3,
)  # path in Meshcat; size of a point, how far before [m]
APART = 0.25  # of the time between frames, by which two pictures of one frame may be apart


class Tracker(Behind):
    """Follows points of a rig's face from the first pictures on.

    Pictures of both cameras that are not of one moment are skipped, as where a camera has stopped.

    Ports: in ``<camera>.color_image`` and ``<camera>.image_time`` [s] of both cameras, from an
    RgbdSensor, a file or a device; out ``sight`` (``Result`` of a ``form_drake.perceive.seen.Sight``).

    Args:
        rig: calibrated cameras and the face that they see.
        period: step of the simulation [s].
        begin: time of the first picture [s].
        wait: whether simulated time waits for the work, see ``Behind``.
        device: Warp device.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        period: float,
        begin: float = 0.0,
        wait: bool = True,
        device: str = "cpu",
    ):
        every, first = steps_between(rig.rate, period), round(begin / period)
        super().__init__("sight", period=period, every=every, begin=first, wait=wait)
        self._rig, self._device = rig, device
        for name, camera in rig.cameras.items():
            self.DeclareAbstractInputPort(f"{name}.color_image", Value(ImageRgba8U(*camera.size)))
            self.DeclareVectorInputPort(f"{name}.image_time", 1)

    def newest(
        self, context: Context, after: float
    ) -> tuple[float, list[np.ndarray] | None] | None:
        """The pictures of both cameras, if they are of one moment."""
        names = list(self._rig.cameras)
        time = [float(self.GetInputPort(f"{n}.image_time").Eval(context)[0]) for n in names]
        if max(time) <= after:
            return None
        if max(time) - min(time) > APART / self._rig.rate:
            return max(time), None
        pair = [grey(self.GetInputPort(f"{n}.color_image").Eval(context)) for n in names]
        return max(time), pair

    def worked(
        self, memory: Followed | None, time: float, given: list[np.ndarray]
    ) -> tuple[Followed, Sight]:
        """As of the base."""
        now = followed(self._rig, memory, given, self._device)
        return now, Sight.of(time, now)


class SightViewer(LeafSystem):
    """Draws the points that are followed, coloured by how alike their surroundings still are.

    They stand a little before their face, so that nothing hides them. Each frame is an object of its
    own, which Meshcat's recording shows until the next.

    Ports: in ``sight``, as the tracker's output.

    Args:
        meshcat: to draw into.
        normal: outward of the face that is seen, in world, shape [3].
        rate: of the drawing [Hz].
    """

    def __init__(self, meshcat: Meshcat, normal: np.ndarray, rate: float = 30.0):
        super().__init__()
        self._meshcat, self._before, self._seen = meshcat, LIFT * normal, -np.inf
        self.frames: list[str] = []
        self.DeclareAbstractInputPort("sight", Value[object](None))
        self.DeclarePeriodicPublishEvent(1.0 / rate, 0.0, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _publish(self, context: Context) -> EventStatus:
        sight = self.get_input_port().Eval(context).value
        if sight is None or sight.time == self._seen or not sight.held.any():
            return EventStatus.DidNothing()
        if sight.time < self._seen:  # another run
            self._meshcat.Delete(SIGHT)
            self.frames.clear()
        self._seen, now = sight.time, context.get_time()
        p_WQ = sight.p_WQ[sight.held] + self._before
        unlike = np.log10(np.maximum(1.0 - sight.likeness[sight.held], UNLIKE[0]))
        path = f"{SIGHT}/{len(self.frames)}"
        limits = (float(np.log10(UNLIKE[0])), float(np.log10(UNLIKE[1])))
        self._meshcat.SetObject(path, cloud(p_WQ, unlike, limits, COLOURS), point_size=POINT)
        self._meshcat.SetProperty(path, "visible", False, 0.0)
        for last in self.frames[-1:]:
            self._meshcat.SetProperty(last, "visible", False, now)
        self._meshcat.SetProperty(path, "visible", True, now)
        self.frames.append(path)
        return EventStatus.Succeeded()


def grey(image: ImageRgba8U) -> np.ndarray:
    """Grey values of a picture, uint8, shape [rows, columns]."""
    import cv2

    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image.data), cv2.COLOR_RGBA2GRAY))
