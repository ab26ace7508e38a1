"""Where pictures come from: cameras that see a simulated specimen, or files."""

from pathlib import Path

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageRgba8U

from form_drake.perceive.pictures import Pictures
from form_drake.perceive.rig import Rig
from form_drake.systems.behind import remembered
from form_drake.systems.pictures import Photographer


class _Cameras(LeafSystem):
    """Ports of cameras: ``<camera>.color_image`` and ``<camera>.image_time`` [s], as RgbdSensor's.

    Derived systems say in ``stamp`` and ``pair`` what there is to see and call ``_ports`` when inputs are
    declared.
    """

    def stamp(self, context: Context) -> float:
        """Of the pictures [s]."""
        raise NotImplementedError

    def pair(self, context: Context) -> list[np.ndarray]:
        """Grey values of every camera, 0 to 255."""
        raise NotImplementedError

    def _ports(self, rig: Rig) -> None:
        self._pair = remembered(self, "pictures", self.pair)
        for n, (name, camera) in enumerate(rig.cameras.items()):
            width, height = camera.size

            def image(context: Context, output: Value, n: int = n) -> None:
                grey = np.round(np.minimum(self._pair.Eval(context)[n], 255))
                found = output.get_mutable_value()
                found.mutable_data[..., :3] = grey[..., None]
                found.mutable_data[..., 3] = 255

            def time(context: Context, output: BasicVector) -> None:
                output.SetAtIndex(0, self.stamp(context))

            def blank(width: int = width, height: int = height) -> Value:
                return Value(ImageRgba8U(width, height))

            self.DeclareAbstractOutputPort(f"{name}.color_image", blank, image)
            self.DeclareVectorOutputPort(f"{name}.image_time", 1, time)


class SpeckleCameras(_Cameras):
    """Two cameras that see a face of a simulated specimen, on which speckle is sprayed.

    Noise is a function of seed and frame, so that a cloned Context repeats it.

    Ports: in ``particles`` (``Snapshot``); out ``<camera>.color_image`` and ``<camera>.image_time``.

    Args:
        rig: the cameras.
        photographer: who renders.
        begin: time of frame 0 [s].
    """

    def __init__(self, rig: Rig, photographer: Photographer, begin: float):
        super().__init__()
        self._rate, self._photographer, self._begin = rig.rate, photographer, begin
        self.DeclareAbstractInputPort("particles", Value[object](None))
        self._ports(rig)

    def stamp(self, context: Context) -> float:
        """As of the base."""
        time: float = context.get_time()
        return time

    def pair(self, context: Context) -> list[np.ndarray]:
        """As of the base."""
        frame = max(round((self.stamp(context) - self._begin) * self._rate), 0)
        return self._photographer.pair(frame, self.get_input_port().Eval(context).p_WQ)


class PictureFiles(_Cameras):
    """Pictures of two cameras from files, each shown until the next; frames of which one cannot be used are not.

    Ports: out ``<camera>.color_image`` and ``<camera>.image_time``.

    Args:
        rig: the cameras.
        places: folders and files, named CAMERA_NUMBER.png.
        begin: time of frame 0 [s].

    Raises:
        ValueError: see ``Pictures.found``.
    """

    def __init__(self, rig: Rig, places: list[Path], begin: float = 0.0):
        super().__init__()
        self._pictures = Pictures.found(places, rig.cameras)
        self._time = begin + np.array(self._pictures.frames) / rig.rate
        self._ports(rig)

    @property
    def left_out(self) -> dict[int, str]:
        """Frames that are left out, and why."""
        return self._pictures.left_out

    @property
    def end(self) -> float:
        """Stamp of the last frame [s]."""
        return float(self._time[-1])

    def stamp(self, context: Context) -> float:
        """As of the base."""
        return float(self._time[self._frame(context)])

    def pair(self, context: Context) -> list[np.ndarray]:
        """As of the base."""
        return self._pictures.pair(self._frame(context))

    def _frame(self, context: Context) -> int:
        late = 1e-9 + context.get_time()
        return max(int(np.searchsorted(self._time, late, side="right")) - 1, 0)
