"""What the inside of a body does now, as far as tracks and its law tell."""

from dataclasses import dataclass

import numpy as np

from form_drake.interior.path import Path
from form_drake.interior.resistance import Resistance
from form_drake.interior.surface import Seen
from form_drake.material import Material
from form_drake.motion import Body, Sampling, body, fit_tracks
from form_drake.motion.tracks import sighted
from form_drake.records import Recording

ALONG = 6  # points along each side of a body


@dataclass(frozen=True)
class Inside:
    """Motion of material points at one time.

    Attributes:
        time: stamp [s].
        X: positions free of stress [m], shape [points, 3].
        p_WQ: positions [m], shape [points, 3].
        v_WQ: velocities [m/s], shape [points, 3].
        F: deformation gradients, shape [points, 3, 3].
        L: velocity gradients [1/s], shape [points, 3, 3].
        deviation: standard deviation of the positions [m], shape [points, 3].
    """

    time: float
    X: np.ndarray
    p_WQ: np.ndarray
    v_WQ: np.ndarray
    F: np.ndarray
    L: np.ndarray
    deviation: np.ndarray


def inside(
    recording: Recording,
    material: Material | None = None,
    X: np.ndarray | None = None,
    *,
    force: str = "sensor",
) -> Inside:
    """The inside of a body in the last frame of a recording.

    Args:
        recording: of points throughout the body, or of its surface.
        material: that completes the surface's motion; None: Hencky's elasticity stands in.
        X: positions free of stress of the points that are wanted [m], shape [points, 3]; None: of an even
            grid.
        force: source of the force that tells when a tool presses.

    Raises:
        ValueError: too few points or frames, or no motion that passes through what is seen.
    """
    recording = sighted(recording.measured_by(force))
    shape = body(recording)
    X = _grid(shape) if X is None else X
    if recording.on_surface:
        nu = recording.known.get("nu")
        law = Resistance.plain(nu) if material is None else Resistance.of(material)
        fit = Path.of(Seen.of(recording, shape), law).fit()
    else:
        fit = fit_tracks(recording, shape)
    last = float(recording.time[-1] - recording.time[0])
    sampling = Sampling.of(fit, np.array([last]), X, np.ones(len(X)), 1.0)
    now = sampling.motion(fit.c)
    time, deviation = float(recording.time[-1]), fit.deviation(last, X)
    return Inside(time, X, now.x[0], now.v[0], now.F[0], now.L[0], deviation)


def _grid(shape: Body) -> np.ndarray:
    """An even grid throughout a box, shape [points, 3]."""
    sides = [
        np.linspace(a, z, 2 * ALONG + 1)[1::2] for a, z in zip(shape.low, shape.high, strict=True)
    ]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
