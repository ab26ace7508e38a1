"""Effects of the sensors: the force and the cameras tell something else than what was."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from form_drake.effects.effect import Effect, Reading, Shape

AXES = {"axis": (0.0, 1.0, 2.0)}
Signal = Callable[[np.ndarray, np.ndarray, Shape], np.ndarray]  # time [s], force [N] -> change [N]


def _force(id: str, wrong: Signal, **more: Any) -> Effect:
    """What is recorded is the force and a coefficient times ``wrong``."""

    def column(reading: Reading, shape: Shape) -> np.ndarray:
        return -reading.force(lambda time, value: wrong(time, value, shape))

    def sensor(recording: Any, size: float, shape: Shape) -> Any:
        start = recording.time[0]
        streams = {
            k: replace(s, value=s.value + size * wrong(s.time - start, s.value, shape))
            for k, s in recording.forces.items()
        }
        return replace(recording, forces=streams)

    return Effect(id=id, column=column, sensor=sensor, **more)


def _constant(time: np.ndarray, value: np.ndarray, shape: Shape) -> np.ndarray:
    return np.broadcast_to(np.eye(3)[int(shape["axis"])], value.shape)


def _growing(time: np.ndarray, value: np.ndarray, shape: Shape) -> np.ndarray:
    return time[:, None] * np.eye(3)[int(shape["axis"])]


def _late(time: np.ndarray, value: np.ndarray, shape: Shape) -> np.ndarray:
    return -np.gradient(value, time, axis=0)


FORCE_GAIN = _force(
    "force-gain",
    lambda time, value, shape: value,
    sentence="the force sensor shows a share too much or too little",
    unit="-",
    prior=(0.005, 1.0),
    shown=("a known weight",),
)
FORCE_BIAS = _force(
    "force-bias",
    _constant,
    sentence="the force sensor does not show zero where nothing acts",
    unit="N",
    prior=(1e-4, 10.0),
    shown=("a moment without contact",),
    shapes=AXES,
)
FORCE_DRIFT = _force(
    "force-drift",
    _growing,
    sentence="the zero of the force sensor moves with time",
    unit="N/s",
    prior=(1e-4, 10.0),
    shown=("moments without contact before and after",),
    shapes=AXES,
)
FORCE_DELAY = _force(
    "force-delay",
    _late,
    sentence="force and pictures are not of the same moment",
    unit="s",
    prior=(1e-4, 0.1),
    shown=("a fast reversal",),
)


def _camera(id: str, wrong: Callable[[np.ndarray, Shape], np.ndarray], **more: Any) -> Effect:
    """Where a point is seen is where it is and a coefficient times ``wrong`` of that place."""

    def column(reading: Reading, shape: Shape) -> np.ndarray:
        return reading.moved(lambda X, x: -wrong(x, shape))

    def sensor(recording: Any, size: float, shape: Shape) -> Any:
        seen = recording.p_WQ + size * wrong(recording.p_WQ, shape)
        return replace(recording, p_WQ=seen, p_reference=recording.reference)

    return Effect(id=id, column=column, sensor=sensor, **more)


def _turned(x: np.ndarray, shape: Shape) -> np.ndarray:
    return np.cross(np.eye(3)[int(shape["axis"])], x)


CAMERA_SCALE = _camera(
    "camera-scale",
    lambda x, shape: x,
    sentence="the cameras see everything larger or smaller than it is",
    unit="-",
    prior=(1e-5, 0.1),
    shown=("a ruler", "a look at the bonded edge"),
)
CAMERA_POSE = _camera(
    "camera-pose",
    _turned,
    sentence="the cameras are turned against the robot",
    unit="rad",
    prior=(1e-4, 0.2),
    shown=("a target that the robot carries",),
    shapes=AXES,
)
