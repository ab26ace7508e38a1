"""Scores by effect that nothing missing may reach: one and a half times the largest of the nulls.

``form-drake bench nulls`` measures them, for all probes or for those of one's own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from form_drake.diagnose.model import Scenes
from form_drake.diagnose.verify import tracking_noise
from form_drake.files import read_mapping
from form_drake.records import Recording

FACTOR = 1.5
LIKE = 1.5  # times, by which noise of tracks and grid spacing may differ from those of nulls
COMMON = (
    "Thresholds come from eight neo-Hookean blocks on a finer grid of the same solver, pressed by bonded"
    " and by frictionless plates, and shaken, with sixteen draws of noise of 50 um in tracks and of 1 % in"
    " forces; other bodies, laws, motions and noises may need others (form-drake bench nulls --like)."
)


@dataclass(frozen=True)
class Nulls:
    """Largest scores where nothing is missing.

    Attributes:
        scores: by effect's id.
        basis: what they stand on, in a sentence.
        law: that they are of; None: they serve for any.
        noise: of the tracks of each recording [m].
        dx: grid spacing in each [m].
    """

    scores: Mapping[str, float]
    basis: str = COMMON
    law: str | None = None
    noise: tuple[float, ...] = ()
    dx: tuple[float, ...] = ()

    @classmethod
    def common(cls) -> "Nulls":
        """Those that come with the package."""
        path = Path(str(files("form_drake.diagnose") / "nulls.json"))
        return cls(read_mapping(path)["scores"])

    @classmethod
    def read(cls, path: Path) -> "Nulls":
        """Those of one's own recordings, as ``form-drake bench nulls --like`` writes them.

        Raises:
            ValueError: it is no such file.
        """
        told = read_mapping(path)
        try:
            scores = {str(k): float(v) for k, v in told["scores"].items()}
            noise, dx = (tuple(map(float, told[name])) for name in ("noise", "dx"))
            law, draws = str(told["law"]), int(told["draws"])
        except (AttributeError, KeyError, TypeError, ValueError):
            raise ValueError(
                f"{path}: no nulls of recordings; form-drake bench nulls --like writes them"
            ) from None
        numbers = np.array([*scores.values(), *noise, *dx])
        if not (np.all(np.isfinite(numbers)) and np.all(numbers >= 0.0)):
            raise ValueError(f"{path}: numbers that are finite and not negative are wanted")
        basis = (
            f"Thresholds come from {draws} draws of noise on a simulation of such recordings on a finer grid of the"
            " same solver: what that solver has wrong of the world is not in them."
        )
        return cls(scores, basis, law, noise, dx)

    @property
    def thresholds(self) -> dict[str, float]:
        """By effect's id."""
        return {name: FACTOR * float(score) for name, score in self.scores.items()}

    def require_like(self, scenes: Scenes, law: str) -> None:
        """Refuse recordings that nulls of one's own do not stand for.

        Raises:
            ValueError: their law is another, there are more or less of them, or their noise or grid
                differs.
        """
        if self.law is None:
            return
        if law != self.law:
            raise ValueError(f"nulls are of law {self.law}, the recordings of {law}")
        kinds = {"noise": (self.noise, noises(scenes.recordings)), "grid": (self.dx, scenes.dx)}
        for name, (known, own) in kinds.items():
            pairs = [(max(a, 1e-300), max(b, 1e-300)) for a, b in zip(known, own, strict=False)]
            if len(known) != len(own) or any(max(a / b, b / a) > LIKE for a, b in pairs):
                raise ValueError(
                    f"nulls are of {_listed(known)} ({name} of each recording), these have {_listed(own)}:"
                    " run form-drake bench nulls --like on these"
                )


def noises(recordings: Sequence[Recording]) -> tuple[float, ...]:
    """Standard deviations of a coordinate in each [m]."""
    return tuple(map(tracking_noise, recordings))


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * v:.3g} mm" for v in values)


def thresholds() -> dict[str, float]:
    """By effect's id, from the nulls that come with the package."""
    return Nulls.common().thresholds
