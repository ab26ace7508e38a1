"""Prediction of a recorded motion from its first frame, and its loss."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from form_drake.laws.values import check_moduli
from form_drake.material import Material
from form_drake.mpm.simulation import Body, Simulation
from form_drake.records import Recording, rest_shape
from form_drake.records.stepped import require_plain

LOSS_EVERY = 5


@dataclass(frozen=True)
class Prediction:
    """A predicted motion beside the recorded one.

    Attributes:
        recording: the recording with its positions replaced by the predicted ones.
        loss: mean over frames, points and coordinates of the squared error [m^2].
        frames: number of frames in the loss.
    """

    recording: Recording
    loss: float
    frames: int


def loss_frames(recording: Recording) -> np.ndarray:
    """Indices of the frames in the loss: solver steps 0, 5, 10, ..., or all without steps."""
    if recording.step is None:
        return np.arange(recording.frames)
    return np.flatnonzero((recording.step - recording.step[0]) % LOSS_EVERY == 0)


def require_alone(material: Material) -> None:
    """Refuse a material with effects, which act where tools hold a body.

    Raises:
        ValueError: it has some.
    """
    if material.effects:
        ids = ", ".join(one.id for one in material.effects)
        raise ValueError(
            f"the material has effects ({ids}): they act in a station, and in recordings that state"
            " their block and the poses of what holds it"
        )


def predict(
    recording: Recording,
    material: Material,
    *,
    device: str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> Prediction:
    """Roll a material out from a recording's first frame.

    Args:
        recording: positions and velocities of the first frame, solver settings, volumes.
        material: law and values; its density counts where the recording states none.
        device: Warp device.
        progress: called with (frames done, frames) after each frame.

    Returns:
        A ``Prediction``.

    Raises:
        ValueError: the recording lacks what a rollout needs, or states what it would leave out, as the
            material may; a modulus is not positive; or no point is measured that the loss could compare.
        BlowUp: the simulation broke down.
    """
    require_alone(material)
    for name in ("solver", "volume", "v_0"):
        if getattr(recording, name) is None:
            raise ValueError(f"the recording states no {name}, which a prediction needs")
    require_plain(recording)
    used = loss_frames(recording)
    if recording.valid is not None and not recording.valid[used].any():
        raise ValueError("no point is valid in any frame of the loss: nothing can be compared")
    density = recording.density or material.density
    if density is None:
        raise ValueError("neither the recording nor the material states a density")
    check_moduli(material.law, material.values)
    x = rest_shape(recording)
    body = Body(x, recording.volume, density)
    simulation = Simulation(recording.solver, material.law, body, device=device)
    simulation.set_material(material.values)
    simulation.reset(x, recording.v_0)
    positions = np.empty_like(recording.p_WQ)
    for i in range(recording.frames):
        if i > 0 and recording.step is not None and recording.solver.dt is not None:
            simulation.step(int(recording.step[i] - recording.step[i - 1]))
        elif i > 0:
            simulation.advance(float(recording.time[i] - recording.time[i - 1]))
        positions[i] = simulation.x
        if progress is not None:
            progress(i + 1, recording.frames)
    error = (positions[used] - recording.p_WQ[used]).astype(float) ** 2
    if recording.valid is not None:
        error = error[recording.valid[used]]
    predicted = replace(
        recording, p_WQ=positions, states=None, valid=None, noise=None, source="prediction"
    )
    return Prediction(predicted, float(error.mean()), len(used))
