"""A pass of a diagnosis with scores of effects."""

from types import SimpleNamespace

import numpy as np

from form_drake.diagnose.motions import Block
from form_drake.diagnose.score import Score
from form_drake.diagnose.verdict import Found
from form_drake.effects import CATALOGUE

BLOCK = Block()
RECORDED = (BLOCK.press("bonded"), BLOCK.shake())


def found(best, ranked, alike=(), rivals=(), recordings=RECORDED, unseen=()):
    """A pass with scores of effects by their limits."""
    scores = {
        name: Score(CATALOGUE[name], {}, 1.0, 90.0, limit, np.zeros(1))
        for name, limit in ranked.items()
    }
    match = SimpleNamespace(scenes=SimpleNamespace(recordings=recordings))
    told = {"alike": alike, "rivals": rivals, "unseen": tuple(CATALOGUE[n] for n in unseen)}
    return Found(match, tuple(scores.values()), best=scores.get(best), **told)


LIMITS = {"force-gain": 0.01, "density": 0.02, "drag": 300.0, "damping": 10.0, "eigenstrain": 1e-5}
