"""Scores by effect that nothing missing may reach: one and a half times the largest of the nulls.

``form-drake bench nulls`` measures them, for all probes or for those of one's own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.diagnose.model import Scenes
from form_drake.diagnose.verify import tracking_noise
from form_drake.effects.acting import Known
from form_drake.files import read_mapping
from form_drake.laws import Law
from form_drake.weak.force import measured

FACTOR = 1.5
LIKE = 1.5  # times, by which noise and grid spacing may differ from those of nulls
MOST = 1e12  # of a number in a file
WORDS = {  # what nulls share with the recordings that they stand for
    "law": "law",
    "effects": "known effects",
    "noise": "noise of tracks [m]",
    "force": "noise of forces [N]",
    "place": "places of tools that are off by [m]",
    "dx": "grid spacing [m]",
}
MEASURED = ("noise", "force", "place", "dx")
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
        of: what recordings they stand for, see ``likeness``; None: for any.
    """

    scores: Mapping[str, float]
    basis: str = COMMON
    of: Mapping[str, Any] | None = None

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
        told = read_mapping(Path(path))
        try:
            scores = {str(k): _number(v) for k, v in told["scores"].items()}
            of = {k: [_number(v) for v in told["of"][k]] for k in MEASURED}
            law, *acting = [_word(w) for w in (told["of"]["law"], *told["of"]["effects"])]
            words = {"law": law, "effects": acting}
            draws = _number(told["draws"])
        except (AttributeError, KeyError, TypeError, ValueError):
            raise ValueError(
                f"{path}: no nulls of recordings; form-drake bench nulls --like writes them, and writes anew those"
                " of an older version"
            ) from None
        basis = (
            f"Thresholds come from {draws:g} draws of noise on a simulation of such recordings on a finer grid of"
            " the same solver: what that solver has wrong of the world is not in them."
        )
        return cls(scores, basis, of | words)

    @property
    def thresholds(self) -> dict[str, float]:
        """By effect's id."""
        return {name: FACTOR * float(score) for name, score in self.scores.items()}

    def require_like(self, of: Mapping[str, Any]) -> None:
        """Refuse recordings that nulls of one's own do not stand for.

        Raises:
            ValueError: law or known effects are others, or noise or grid differ.
        """
        if self.of is None:
            return
        for name, text in WORDS.items():
            known, own = self.of[name], of[name]
            if known == own:
                continue
            numbers = name in MEASURED and len(known) == len(own)
            if not numbers or any(
                max(a, b) > LIKE * min(a, b) for a, b in zip(known, own, strict=True)
            ):
                raise ValueError(
                    f"nulls are of {text} {_listed(known)}, these recordings have {_listed(own)}: run form-drake"
                    " bench nulls --like on these, with the material that the diagnosis begins with"
                )


def likeness(scenes: Scenes, law: Law, causes: Sequence[Known] = ()) -> dict[str, Any]:
    """What nulls must share with recordings, as in their file.

    Args:
        scenes: of the recordings.
        law: of the specimen.
        causes: effects that are known.
    """
    seen = scenes.recordings
    felt = (measured(one, 0.0, float(np.ptp(one.time))) for one in seen)
    return {
        "law": law.name,
        "effects": sorted(c.effect.id for c in causes),
        "noise": [tracking_noise(one) for one in seen],
        "force": [own[tool].noise for own in felt for tool in sorted(own)],
        "place": [one.poses[tool].noise or 0.0 for one in seen for tool in sorted(one.poses)],
        "dx": list(scenes.dx),
    }


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not 0.0 <= value < MOST:
        raise ValueError
    return float(value)


def _word(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _listed(value: Any) -> str:
    if not isinstance(value, list):
        return str(value)
    return ", ".join(v if isinstance(v, str) else f"{v:.3g}" for v in value) or "none"


def thresholds() -> dict[str, float]:
    """By effect's id, from the nulls that come with the package."""
    return Nulls.common().thresholds
