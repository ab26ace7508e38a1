"""What a rollout needs of a recording: solver, masses and the shape at rest."""

from dataclasses import dataclass

import numpy as np

from form_drake.records.recording import Recording
from form_drake.records.solver import Solver

NEGLIGIBLE = 1e-5


@dataclass(frozen=True)
class Stepped:
    """What a motion stepped by a solver states of its particles.

    Attributes:
        solver: how it was stepped.
        volume: reference volumes [m^3], shape [points].
        density: mass per reference volume [kg/m^3].
    """

    solver: Solver
    volume: np.ndarray
    density: float

    @property
    def mass(self) -> np.ndarray:
        """Particle masses [kg], shape [points]."""
        return self.volume * self.density


def stepped(recording: Recording) -> Stepped:
    """The recording's solver, volumes and density.

    Raises:
        ValueError: naming what the recording lacks.
    """
    require_plain(recording)
    solver, volume, density = recording.solver, recording.volume, recording.density
    if solver is None:
        raise ValueError("the recording states no solver, which is needed here")
    if volume is None or density is None:
        missing = "volume" if volume is None else "density"
        raise ValueError(f"the recording states no {missing}, which is needed here")
    return Stepped(solver, volume, density)


def require_plain(recording: Recording) -> None:
    """Refuse what no solver's own steps hold.

    Raises:
        ValueError: forces beside gravity, or masses that are others.
    """
    if recording.body_force is not None or recording.mass_scale != 1.0:
        raise ValueError(
            "the recording states body_force or another mass_scale than 1, which steps of its solver would leave"
            " out: take gravity alone, and masses as they are"
        )


def rest_shape(recording: Recording) -> np.ndarray:
    """Stress-free positions [m] at which a rollout starts, shape [points, 3].

    Raises:
        ValueError: the first frame lies elsewhere, or is noisy and no rest shape is stated.
    """
    x = recording.reference
    extent = float(np.max(np.ptp(x, axis=0)))
    if recording.p_reference is None:
        if recording.noise is not None and recording.noise > NEGLIGIBLE * extent:
            raise ValueError(
                f"positions have a noise of {recording.noise:.3g} m, so the first frame is no rest"
                " shape: state the exact one as p_reference"
            )
        return x
    seen = np.isfinite(recording.p_WQ[0]).all(axis=1)
    if recording.valid is not None:
        seen &= recording.valid[0]
    if seen.any():
        offset = (recording.p_WQ[0] - x)[seen]
        shift, spread = offset.mean(axis=0), float(offset.std())
        if np.linalg.norm(shift) > 6.0 * spread / np.sqrt(len(offset)) + 1e-3 * extent:
            raise ValueError(
                f"the first frame lies {np.linalg.norm(shift):.3g} m from p_reference; a rollout"
                " starts at rest shape: give p_reference in the pose of the first frame"
            )
    return x
