"""Effects of the sensors: the force and the cameras tell something else than what was."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from form_drake.effects.effect import Effect, Reading, Shape

DIRECTIONS = {
    "azimuth": tuple(np.radians(np.arange(0.0, 180.0, 45.0)).tolist()),
    "elevation": tuple(np.radians((-60.0, -30.0, 0.0, 30.0, 60.0, 90.0)).tolist()),
}
# time [s], force [N], direction -> change [N]
Signal = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
Shown = Callable[
    [np.ndarray, np.ndarray, float], np.ndarray
]  # time, force, coefficient -> force [N]


def direction(shape: Shape) -> np.ndarray:
    """The unit vector of an azimuth and an elevation [rad], shape [3]; zero where there are none."""
    if not shape:
        return np.zeros(3)
    a, e = shape["azimuth"], shape["elevation"]
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _directed(
    name: str, of: Callable[[Reading, np.ndarray], np.ndarray]
) -> Callable[[Reading, Shape], np.ndarray]:
    """A column that is linear in a direction, by those of the three axes."""

    def along(reading: Reading, axis: np.ndarray) -> np.ndarray:
        return reading.once(f"{name} {axis}", lambda: of(reading, axis))

    def column(reading: Reading, shape: Shape) -> np.ndarray:
        if not shape:
            return along(reading, np.zeros(3))
        parts = [d * along(reading, e) for d, e in zip(direction(shape), np.eye(3), strict=True)]
        return np.sum(parts, axis=0)

    return column


def _force(id: str, wrong: Signal, shown_as: Shown | None = None, **more: Any) -> Effect:
    """What is recorded is the force and, per unit of the coefficient, ``wrong``.

    Args:
        id: of the effect.
        wrong: to first order.
        shown_as: the whole; None: it is linear in the coefficient.
        more: of the effect.
    """

    def column(reading: Reading, along: np.ndarray) -> np.ndarray:
        return -reading.force(lambda time, value: wrong(time, value, along))

    def sensor(recording: Any, size: float, shape: Shape) -> Any:
        start, along = recording.time[0], direction(shape)

        def felt(time: np.ndarray, value: np.ndarray) -> np.ndarray:
            if shown_as is not None:
                return shown_as(time, value, size)
            return value + size * wrong(time, value, along)

        streams = {
            k: s if ":" in k else replace(s, value=felt(s.time - start, s.value))
            for k, s in recording.forces.items()
        }  # what follows a colon is another source, see ``Recording.measured_by``
        return replace(recording, forces=streams)

    return Effect(id=id, column=_directed(id, column), sensor=sensor, **more)


def _constant(time: np.ndarray, value: np.ndarray, along: np.ndarray) -> np.ndarray:
    return np.broadcast_to(along, value.shape)


def _growing(time: np.ndarray, value: np.ndarray, along: np.ndarray) -> np.ndarray:
    return time[:, None] * along


def _late(time: np.ndarray, value: np.ndarray, along: np.ndarray) -> np.ndarray:
    return -np.gradient(value, time, axis=0)


def _delayed(time: np.ndarray, value: np.ndarray, delay: float) -> np.ndarray:
    """The force of another moment: what is slow beside a delay is not all that probes do."""
    return np.asarray(CubicSpline(time, value)(np.clip(time - delay, time[0], time[-1])))


FORCE_GAIN = _force(
    "force-gain",
    lambda time, value, along: value,
    sentence="the force sensor shows a share too much or too little",
    unit="-",
    prior=(0.005, 1.0),
    shown=("a known weight",),
    same=("density",),  # moduli and density grow by the share, and nothing else does
    bends=True,
    compounds=True,
    least=-1.0,
)
FORCE_BIAS = _force(
    "force-bias",
    _constant,
    sentence="the force sensor does not show zero where nothing acts",
    unit="N",
    prior=(1e-4, 10.0),
    shown=("a moment without contact",),
    shapes=DIRECTIONS,
)
FORCE_DRIFT = _force(
    "force-drift",
    _growing,
    sentence="the zero of the force sensor moves with time",
    unit="N/s",
    prior=(1e-4, 10.0),
    shown=("moments without contact before and after",),
    shapes=DIRECTIONS,
)
FORCE_DELAY = _force(
    "force-delay",
    _late,
    _delayed,
    sentence="force and pictures are not of the same moment",
    unit="s",
    prior=(1e-4, 0.1),
    shown=("a fast reversal",),
)


def _camera(
    id: str,
    wrong: Callable[[np.ndarray, np.ndarray], np.ndarray],
    shown_at: Callable[[np.ndarray, float, np.ndarray], np.ndarray],
    **more: Any,
) -> Effect:
    """Where a point is seen that is at x: ``shown_at`` (x, coefficient, direction), and to first order x
    and a coefficient times ``wrong`` (x, direction)."""

    def column(reading: Reading, along: np.ndarray) -> np.ndarray:
        return reading.moved(lambda X, x: -wrong(x, along))

    def sensor(recording: Any, size: float, shape: Shape) -> Any:
        seen = shown_at(recording.p_WQ, size, direction(shape))
        return replace(recording, p_WQ=seen, p_reference=recording.reference)

    return Effect(id=id, column=_directed(id, column), sensor=sensor, **more)


def _turned(x: np.ndarray, angle: float, along: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(angle * along).apply(x.reshape(-1, 3)).reshape(x.shape)


CAMERA_SCALE = _camera(
    "camera-scale",
    lambda x, along: x,
    lambda x, size, along: (1.0 + size) * x,
    sentence="the cameras see everything larger or smaller than it is",
    unit="-",
    prior=(1e-5, 0.1),
    shown=("a ruler", "a look at the bonded edge"),
    bends=True,
)
CAMERA_POSE = _camera(
    "camera-pose",
    lambda x, along: np.cross(along, x),
    _turned,
    sentence="the cameras are turned against the robot",
    unit="rad",
    prior=(1e-4, 0.2),
    shown=("a target that the robot carries",),
    shapes=DIRECTIONS,
)
