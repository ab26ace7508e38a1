"""What simpler statistics would have said of the same rows, for comparison.

None has a twin's rows taken off, so that what reading tracks costs stands in all rows. The first two
take their scale from what the law leaves.
"""

from collections.abc import Iterable

import numpy as np

from form_drake.diagnose.match import Match
from form_drake.diagnose.score import Score, scores
from form_drake.effects import Effect
from form_drake.weak.solve import Weights


def lesser(match: Match, effects: Iterable[Effect]) -> dict[str, list[Score]]:
    """Scores, best first, of all rows alike (``ols``), by their variances, and by their covariance.

    Args:
        match: of data and twin, nothing added.
        effects: a catalogue.
    """
    known, rest = list(effects), match.rest
    ends = np.cumsum(list(map(len, match.by.factors)))[:-1]
    sizes = np.split(match.by.sizes, ends)
    every = {
        "ols": [np.ones_like(s) for s in sizes],
        "diagonal": sizes,
    }
    found = {}
    for way, parts in every.items():
        own = match.seen_by(Weights(tuple(np.diag(p) for p in parts), match.by.error), rest)
        spread = float(np.sqrt(own.left @ own.left / max(len(rest) - own.basis.shape[1], 1)))
        scaled = Weights(tuple(spread * np.diag(p) for p in parts), match.by.error)
        found[way] = scores(match.seen_by(scaled, rest), known)
    found["gls"] = scores(match.seen_by(match.by, rest), known)
    return found
