"""Which effect it is, by simulation: what scores say to first order is not enough for strong ones.

The few effects that explain nearly as much as the best begin where their scores are best, one with a
place at others too. What has no column, as what holds or lets go of a face, need not be linear in its
size: it begins wherever it is seen. A few steps of each show which comes nearest to the data.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Generic

import numpy as np

from form_drake.diagnose.match import Match
from form_drake.diagnose.model import FIT, SEARCH
from form_drake.diagnose.projected import Projected
from form_drake.diagnose.score import PLACES, Score, coherence, ranked, shapes
from form_drake.diagnose.search import M, Search, matched

FIELD, STARTS = 4, 4  # effects; starts of one that has a place
SAME = 0.99  # coherence from which no simulation would tell two effects apart
NEARLY = 0.4  # of the best score, from which another start is simulated
CLOSER = (0.5, 0.25)  # of the spacing of places, at which more are tried around the best
BESIDE = 4.0  # widths of the shape parameters, within which starts are one
MARGIN = 10.0  # of scores, within which effects are equally good
PLAIN = 4.0  # of scores, up to which one of fewer shape parameters is taken for another like it
ROUNDS = (1, 1, 2)  # steps, after each of which the worse half retires, see ``_better``


@dataclass(frozen=True)
class Runner(Generic[M]):
    """A start, and how far its search has come.

    Attributes:
        score: of the start.
        search: where it is.
        apart: square of its gap, beyond noise.
        left: square of what a last step would leave of it, beyond noise.
    """

    score: Score
    search: Search[M]
    apart: float
    left: float

    @classmethod
    def at(cls, score: Score, search: Search[M]) -> "Runner[M]":
        """Its place known, and what that was made from forgotten."""
        match = search.match
        apart, left = match.excess, match.excess_left
        return cls(score, search.lighter, apart, left)

    def matched(self: "Runner[Match]") -> Match:
        """The twin nearest to the data, on the grid that tells how much is missing.

        Raises:
            ValueError: it cannot be simulated.
        """
        try:
            return matched(self.search.match.on(FIT).anchored())
        except ValueError as error:
            raise ValueError(f"{self.score.effect.id}: {error}") from None

    def stepped(self) -> "Runner[M]":
        """One step on; where it has settled, or the simulation does not stand it, it stays."""
        try:
            return self if self.search.settled else Runner.at(self.score, self.search.stepped())
        except ValueError:
            return self


def raced(
    match: M,
    seen: Sequence[Score],
    progress: Callable[[str], None] = lambda text: None,
    nearly: float = NEARLY,
) -> list[Runner[M]]:
    """Effects by how near their simulations come to the data, the nearest first; each once.

    Args:
        match: without them.
        seen: their scores, best first.
        progress: hears what is tried.
        nearly: share of the best score, from which another effect is tried.

    Raises:
        ValueError: none can be simulated.
    """
    match = match.on(SEARCH)
    runners, failure = [], ValueError("no effect is given")
    starts = list[Score]()
    for score in field(seen, nearly):
        try:
            starts += _starts(match, score, nearly * seen[0].score)
        except ValueError:  # a column of one's own fails closer by
            starts.append(score)
    for start in starts:
        progress(f"trying {start.effect.id}")
        try:
            size = start.effect.bounded(start.coefficient)
            more = match.model.more(start.effect, size, start.shape)
            runners.append(Runner.at(start, Search.of(match.near(more))))
        except ValueError as error:
            failure = ValueError(f"{start.effect.id}: {error}")
    if not runners:
        raise failure
    for steps in ROUNDS:
        for _ in range(steps):
            runners = [runner.stepped() for runner in runners]
        runners = _better(runners)
    first: dict[str, Runner[M]] = {}
    for runner in runners:
        first.setdefault(runner.score.effect.id, runner)
    return list(first.values())


def _better(runners: Sequence[Runner[M]]) -> list[Runner[M]]:
    """The nearer half, and what is as near as the nearest, the nearest first.

    And the half of which a last step promises most: a first one may go too far, with the moduli.
    """
    half = (len(runners) + 1) // 2
    nearest = sorted(runners, key=lambda runner: runner.apart)
    stay = [id(r) for r in sorted(runners, key=lambda runner: runner.left)[:half]]
    stay += [id(r) for r in nearest[:half]]
    most = nearest[0].apart + MARGIN
    return [r for r in nearest if r.apart < most or id(r) in stay]


def field(seen: Sequence[Score], nearly: float = NEARLY) -> list[Score]:
    """What is simulated: of effects that no simulation would tell apart the first, or a plainer one."""
    found = list[Score]()
    for score in seen:
        near = score.score > nearly * seen[0].score and len(found) < FIELD
        alike = coherence([score, *found])[0, 1:]
        n = int(np.argmax(alike)) if len(found) else 0
        if alike.max(initial=0.0) > SAME:
            plainer = len(score.effect.shapes) < len(found[n].effect.shapes)
            if plainer and score.score > found[n].score - PLAIN:
                found[n] = score
        elif near or score.effect.columnless:
            found.append(score)
    return found


def _starts(match: Projected, score: Score, least: float) -> list[Score]:
    """The best of an effect, and others that are apart from it and nearly as good.

    What is more somewhere is like what is less elsewhere: the best of either sign is sought closer.
    """
    effect = score.effect
    if "radius" not in effect.shapes:
        return [score]
    every = ranked(match, effect, shapes(effect, match.bodies[0]))
    opposed = [s for s in every if s.coefficient * score.coefficient < 0.0]
    near = [_closer(match, one) for one in (score, *opposed[:1])]
    found = list[Score]()
    for other in sorted([*near, *every], key=lambda s: -s.score):
        if len(found) == STARTS or (found and other.score < least):
            break
        if all(_apart(one, other) for one in found):
            found.append(other)
    return found


def _closer(match: Projected, score: Score) -> Score:
    """The best of its sign at places that lie closer than those that were tried, around it.

    They stay as far from faces, and their scores are comparable.
    """
    body, effect = match.bodies[0], score.effect
    spacing = (body.high - body.low) / PLACES
    sides = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    luck = 2.0 * np.log(PLACES**3 / len(sides))
    for share in CLOSER:
        places = np.array([score.shape[k] for k in "xyz"]) + share * spacing * sides
        places = np.clip(places, body.low + 0.5 * spacing, body.high - 0.5 * spacing)
        around = [{**score.shape, **dict(zip("xyz", p, strict=True))} for p in places.tolist()]
        found = (replace(s, score=s.score - luck) for s in ranked(match, effect, around))
        score = next((s for s in found if s.coefficient * score.coefficient > 0.0), score)
    return score


def _apart(one: Score, other: Score) -> bool:
    keys, effect = one.effect.shapes, one.effect
    steps = [(other.shape[k] - one.shape[k]) / effect.width(other.shape, k) for k in keys]
    opposed = one.coefficient * other.coefficient < 0.0
    return opposed or float(np.linalg.norm(steps)) > BESIDE
