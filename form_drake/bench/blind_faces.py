"""Sealed cases seen from outside: what points on two sides and the force tell of an effect."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from form_drake.diagnose.model import Scenes
from form_drake.diagnose.score import ALIKE, Score, coherence, scores
from form_drake.diagnose.sight import Sight, guessed
from form_drake.diagnose.verdict import LEAST
from form_drake.effects import CATALOGUE
from form_drake.laws import law_named
from form_drake.records import Recording


def ranking(recordings: Sequence[Recording]) -> dict[str, Any]:
    """The effect whose column explains most, and all scores, also without what the grid has wrong.

    Args:
        recordings: of a press and a shake.

    Raises:
        ValueError: they do not state their scene, or it cannot be simulated.
    """
    law = law_named(recordings[0].law or "neo-hookean")
    sight = Sight.fitted(Scenes.of(tuple(recordings)), guessed(recordings[0], law, {}))
    found, plain = (scores(one, CATALOGUE.values()) for one in (sight, sight.uncorrected))
    left = sight.left
    return {
        "verdict": "named" if found[0].score > LEAST else "none",
        "effects": [_named(found)] if found[0].score > LEAST else [],
        "values": dict(sight.model.values),
        "passes": [{"residual": float(left @ left / len(left)), "scores": _scores(found)}],
        "limits": {s.effect.id: s.limit for s in found},
        "lesser": {"uncorrected": _scores(plain)},
        "before": {"limits": {s.effect.id: s.limit for s in plain}},
        "gap": [],
    }


def _named(found: Sequence[Score]) -> dict[str, Any]:
    best, *others = found
    like = coherence(found)[0, 1:]
    alike = [s.effect.id for s, c in zip(others, like, strict=True) if c > ALIKE]
    return {
        "name": best.effect.id,
        "class": sorted({best.effect.id, *alike}),
        "coefficient": best.coefficient,
        "std": best.std if np.isfinite(best.std) else None,
        "where": dict(best.shape),
    }


def _scores(found: Sequence[Score]) -> dict[str, float]:
    return {s.effect.id: float(f"{s.score:.4g}") for s in found}
