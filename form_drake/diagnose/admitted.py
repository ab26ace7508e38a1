"""Which recordings a diagnosis takes; each is told of by its name."""

from collections.abc import Sequence

import numpy as np

from form_drake.diagnose.model import Scenes
from form_drake.diagnose.plates import require_placed
from form_drake.diagnose.prepare import require_throughout
from form_drake.diagnose.verify import tracking_noise
from form_drake.files import about
from form_drake.identify.stated import require_distinct
from form_drake.laws import Law
from form_drake.motion import Body, body
from form_drake.motion.tracks import require_frames
from form_drake.records import Recording
from form_drake.weak.force import FEW, measured

EXACT = 1e-4  # of the grid spacing, or the largest force, below which a noise that nobody states is none
LARGEST = 2.0  # edge of a specimen [m]
COARSEST = 0.25  # of a body's least edge, that the grid spacing is at most

SOLIDS = ("elastic", "plastic")
Named = Sequence[tuple[str, Recording]]


def require_solid(law: Law) -> None:
    """Refuse laws of fluids and grains, which have no shear modulus.

    Raises:
        ValueError: it is one.
    """
    if law.flow not in SOLIDS:
        raise ValueError(
            f"{law.name} flows: diagnoses are of solids, whose law is elastic or plastic"
        )


def require_one_specimen(recordings: Named) -> None:
    """Refuse recordings of different specimens, and one motion twice.

    Raises:
        ValueError: see there.
    """
    bodies = []
    for name, recording in recordings:
        with about(name):
            bodies.append(body(recording))
    (first, _), *rest = recordings
    shape, *sizes = bodies
    for (name, _), size in zip(rest, sizes, strict=True):
        same = np.allclose([size.low, size.high], [shape.low, shape.high], rtol=0.0, atol=1e-6)
        if not same or not np.isclose(size.density, shape.density):
            raise ValueError(
                f"{name}: another specimen than {first}; boxes and densities must agree"
            )
    require_distinct(recordings)


def require_all_stated(recordings: Named, read: int, dx: float | None = None) -> None:
    """Refuse recordings that could not be simulated, or compared with it, the first ``read`` being read.

    Raises:
        ValueError: see ``require_stated``.
    """
    for n, (name, recording) in enumerate(recordings):
        with about(name):
            require_stated(recording, dx, held_back=n >= read)


def require_stated(recording: Recording, dx: float | None, *, held_back: bool) -> None:
    """Refuse a recording that could not be simulated, or compared with its simulation.

    Args:
        recording: with the forces of one source.
        dx: grid spacing [m]; None: chosen, see ``Scenes``.
        held_back: whether it is compared sample by sample, which takes the noise of its tracks; the
            others are read, and held against simulations that are never exact.

    Raises:
        ValueError: a face, poses, gravity, stress-free positions, a common clock or the noise are not
            stated, the grid is too coarse, or points to be read lie on faces alone, or for too few frames.
    """
    if not held_back:
        require_frames(recording)
        require_throughout(recording)
    _require_scene(recording, dx)
    scenes = Scenes.of((recording,), dx)
    for tool, felt in measured(scenes.recordings[0], 0.0, float(np.ptp(recording.time))).items():
        if recording.forces[tool].noise:
            continue
        if len(felt.time) < FEW:
            raise ValueError(
                f"{len(felt.time)} samples of the force of {tool} lie among the frames, from {FEW} on their"
                " noise can be told: state noise [N] (Stream.noise)"
            )
        if not held_back and felt.noise < EXACT * float(np.abs(felt.value).max()):
            raise ValueError(
                f"the force of {tool} seems exact, to {felt.noise:.1g} N, and no simulation is: state the"
                " noise that it stands for (noise [N])"
            )
    noise = tracking_noise(recording)
    if held_back and not np.isfinite(noise):
        raise ValueError("how noisy its tracks are cannot be told: state noise [m]")
    if not held_back and not recording.noise and noise < EXACT * scenes.dx[0]:
        raise ValueError(
            f"its tracks seem exact, to {noise:.1g} m, and no simulation is: state the noise that they stand"
            " for (noise [m])"
        )


def require_fine(dx: float | None, shape: Body) -> None:
    """Refuse a grid that is too coarse for a body.

    Args:
        dx: grid spacing [m]; None: chosen.
        shape: of the body.

    Raises:
        ValueError: it is.
    """
    most = COARSEST * float(np.min(shape.high - shape.low))
    if dx is not None and dx > most:
        raise ValueError(
            f"dx {dx:g} m: up to {most:.3g} m is wanted, a quarter of the body's least edge"
        )


def _require_scene(recording: Recording, dx: float | None) -> None:
    shape = body(recording)
    size = shape.high - shape.low
    if np.max(size) > LARGEST:
        raise ValueError(
            f"its box has edges of {', '.join(f'{edge:g}' for edge in size)} m: lengths are in metres; are these"
            " millimetres?"
        )
    require_fine(dx, shape)
    _ = Scenes.of((recording,), dx).spacings  # refuses faces and poses that no stage can hold
    require_placed(recording)
    if recording.gravity is None:
        raise ValueError("gravity [m/s^2] is not stated: where there is none, state 0 0 0")
    if recording.p_reference is None:
        raise ValueError(
            "p_reference [m] is not stated: the first frame is as noisy as the others, and the body may sag"
            " in it; state where the points are in the body free of stress"
        )
