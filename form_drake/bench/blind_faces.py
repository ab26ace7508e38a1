"""Sealed cases seen from outside: what points on two sides and the force tell of an effect.

Scores of columns say which effects are simulated; which of these it is, how near they come.
"""

from collections.abc import Sequence
from typing import Any

from form_drake.diagnose.model import Scenes
from form_drake.diagnose.prepare import given
from form_drake.diagnose.race import MARGIN, Runner, raced
from form_drake.diagnose.score import ALIKE, Score, coherence, scored, scores
from form_drake.diagnose.sight import Sight, guessed
from form_drake.diagnose.verdict import LEAST
from form_drake.effects import CATALOGUE
from form_drake.laws import Law
from form_drake.records import Recording

NEARLY = 0.1  # of the best score: columns of what acts inside say little of how it looks outside


def ranking(recordings: Sequence[Recording], law: Law) -> dict[str, Any]:
    """The effect whose simulation comes nearest, and all scores, also with what the grid has wrong.

    Args:
        recordings: of a press and a shake.
        law: of the specimen.

    Raises:
        ValueError: they do not state their scene, or it cannot be simulated.
    """
    known = given(recordings, law, None)
    if tied := known.keys() - {*law.keys}:
        raise ValueError(
            f"the recordings declare {', '.join(tied)} as known, which two sides cannot hold: declare"
            f" values of {', '.join(law.keys)}, or none"
        )
    guess = guessed(recordings[0], law, known)
    sight = Sight.fitted(Scenes.of(tuple(recordings)), guess, known)
    found, plain = (scores(one, CATALOGUE.values()) for one in (sight, sight.uncorrected))
    seen = [s for s in found if s.score > LEAST]
    runners = raced(sight, seen, nearly=NEARLY) if seen else []
    left = sight.left
    return {
        "verdict": "named" if seen else "none",
        "effects": [_named(sight, runners[0], found)] if seen else [],
        "values": dict(sight.model.values),
        "passes": [{"residual": float(left @ left / len(left)), "scores": _scores(found)}],
        "limits": {s.effect.id: s.limit for s in found},
        "lesser": {"uncorrected": _scores(plain)},
        "before": {"limits": {s.effect.id: s.limit for s in plain}},
        "runners": {r.score.effect.id: r.left for r in runners},
        "gap": [],
    }


def _named(sight: Sight, runner: Runner[Sight], found: Sequence[Score]) -> dict[str, Any]:
    """Beside those that no recording tells from it, or whose columns are like its own where the search ended."""
    cause = runner.search.match.told.causes[-1]
    own = scored(sight, cause.effect, [cause.shape])
    least = min(LEAST, own.score - MARGIN)
    others = [s for s in found if s.effect is not own.effect and s.score > least]
    like = coherence([own, *others])[0, 1:]
    alike = [s.effect.id for s, c in zip(others, like, strict=True) if c > ALIKE]
    return {
        "name": cause.effect.id,
        "class": sorted({cause.effect.id, *cause.effect.same, *alike}),
        "coefficient": cause.coefficient,
        "std": cause.told,
        "where": dict(cause.shape),
        "spread": dict(cause.spread),
    }


def _scores(found: Sequence[Score]) -> dict[str, float]:
    return {s.effect.id: float(f"{s.score:.4g}") for s in found}
