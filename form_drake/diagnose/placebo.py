"""Held-out motion with wrong effects, and without one of several: what was found must be worth more."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from form_drake.diagnose.channel import Channel
from form_drake.diagnose.model import SEARCH, Cause
from form_drake.diagnose.score import Score
from form_drake.diagnose.search import matched
from form_drake.diagnose.verdict import Found, Naming
from form_drake.diagnose.verify import Check, Predicted
from form_drake.effects import Effect


@dataclass(frozen=True)
class Placebo:
    """An effect of another class than those that were found, fitted in the place of the first.

    Attributes:
        cause: what it came out as.
        channels: errors on held-out motions without it and with it.
    """

    cause: Cause
    channels: tuple[Channel, ...]

    @property
    def effect(self) -> Effect:
        return self.cause.effect

    def to_json(self) -> dict[str, Any]:
        """As in ``discrepancy.json``."""
        return {
            "name": self.effect.id,
            "coefficient": self.cause.coefficient,
            "gap": [c.to_json() for c in self.channels],
        }


@dataclass(frozen=True)
class Removed:
    """One of several effects that were found, taken out again.

    Attributes:
        effect: which.
        channels: errors on held-out motions without it and with it, all others and the moduli refitted.
    """

    effect: Effect
    channels: tuple[Channel, ...]

    def to_json(self) -> dict[str, Any]:
        """As in ``discrepancy.json``."""
        return {"name": self.effect.id, "gap": [c.to_json() for c in self.channels]}


def removals(
    naming: Naming,
    check: Check,
    after: Predicted,
    progress: Callable[[str], None] = lambda text: None,
) -> Iterator[Removed]:
    """Each of several effects taken out; what one alone is worth, the errors before and after tell.

    Effects without which nothing can be simulated are passed over; of those that naming has refused
    nothing is asked.

    Args:
        naming: with what was added.
        check: held-out motions.
        after: predicted with all of it.
        progress: hears what is tried.
    """
    count = len(naming.added)
    if count < 2 or naming.verdict == "unnamed":
        return
    match = naming.match.on(SEARCH)
    for cause in match.model.causes[-count:]:
        progress(f"without {cause.effect.id}")
        try:
            less = matched(match.near(match.model.without(cause)), rough=True)
            yield Removed(cause.effect, tuple(check.channels(after, check.predicted(less))))
        except ValueError:
            continue


def placebos(
    naming: Naming,
    check: Check,
    seed: int,
    progress: Callable[[str], None] = lambda text: None,
) -> Iterator[Placebo]:
    """The runner-up, which scores best of other classes, and an effect that is drawn from the rest.

    Effects that a simulation does not stand are passed over.

    Args:
        naming: with something that was added.
        check: held-out motions.
        seed: by which effects are drawn.
        progress: hears what is tried.
    """
    first = naming.passes[0]
    others = _others(naming)
    rest = iter(others)
    yield from _next(first, rest, check, progress)
    left = list(rest)
    drawn = (left[n] for n in np.random.default_rng(seed).permutation(len(left)))
    yield from _next(first, drawn, check, progress)


def _next(
    found: Found, queue: Iterator[Score], check: Check, progress: Callable[[str], None]
) -> Iterator[Placebo]:
    """The first of a queue that can be simulated."""
    for score in queue:
        progress(f"placebo {score.effect.id}")
        try:
            yield _fitted(found, score, check)
        except ValueError:
            continue
        return


def _others(naming: Naming) -> list[Score]:
    """Scores of the first pass of effects that are not of a class with what was added, best first."""
    same = {c.effect.id for c in naming.added} | {i for p in naming.passes for i in p.alike}
    return [s for s in naming.passes[0].ranked if s.effect.id not in same]


def _fitted(found: Found, score: Score, check: Check) -> Placebo:
    match = found.match.on(SEARCH)
    size = score.effect.bounded(score.coefficient) or score.effect.prior[0]
    wrong = matched(match.near(match.model.more(score.effect, size, score.shape)), rough=True)
    return Placebo(wrong.told.causes[-1], tuple(check.channels(check.predicted(wrong))))
