"""Which effect is missing: scores against thresholds, one effect added after the other."""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.noise import most
from form_drake.diagnose.race import MARGIN, SAME, Runner, field, raced
from form_drake.diagnose.score import ALIKE, Score, coherence, possible, scores
from form_drake.diagnose.search import matched
from form_drake.effects import Effect
from form_drake.identify.problem import Problem

MOST = 2  # effects: three at once are less likely than one that no catalogue has
LEAST = 16.0  # of a threshold: four standard deviations, whatever the nulls are
WRONG = 0.08  # of what effects change, that their simulation may have wrong
ROLLED = "simulating the twin"  # what is told when all is read

Verdict = Literal["none", "named", "ambiguous", "unnamed"]


@dataclass(frozen=True)
class Found:
    """One pass: an effect that was found missing, with what is like it.

    Attributes:
        match: before it was added.
        ranked: all scores, best first.
        seen: those above their thresholds.
        best: that which is added, or which stands out in the last pass and is not; None: none does.
        alike: ids of effects of one class with it: by their columns, or since no recording tells them apart.
        rivals: ids of effects of other classes whose simulations come as near, or whose columns where
            they were not simulated.
        refused: ids of effects above their thresholds whose simulations explain too little.
        doubt: least score, for what the simulation of effects that were added may have wrong.
        unseen: effects that may act and that no row sees.
        gone: ids of effects that were added here first, and became needless.
    """

    match: Match
    ranked: tuple[Score, ...]
    seen: tuple[Score, ...] = ()
    best: Score | None = None
    alike: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    doubt: float = 0.0
    unseen: tuple[Effect, ...] = ()
    gone: tuple[str, ...] = ()

    def instead(self, later: "Found") -> "Found":
        """With what a later pass has added, and not what was added here."""
        assert self.best is not None
        gone = (*self.gone, self.best.effect.id, *later.gone)
        kept = {k: getattr(later, k) for k in ("best", "alike", "rivals", "refused")}
        return replace(self, gone=gone, **kept)

    def wanted(self, effect: Effect, thresholds: Mapping[str, float]) -> float:
        """The score that an effect must exceed."""
        return max(thresholds.get(effect.id, 0.0), LEAST, self.doubt)

    @property
    def left(self) -> float:
        """Square of what law and causes leave of the gap, beyond noise."""
        return self.match.excess_left

    @property
    def enough(self) -> bool:
        """Whether that may be noise, and what the simulation of effects may have wrong."""
        chance = self.match.chance
        return self.left < most(chance) - chance + self.doubt


@dataclass(frozen=True)
class Naming:
    """All passes.

    Attributes:
        passes: the last one found nothing, or no more were allowed.
        added: causes of the model that were not known before, one for each pass but the last.
        match: the model's twin.
        verdict: ``unnamed``: something is missing that no effect explains, or none that can be
            simulated, or only more of them than ``MOST``, or more than noise is left.
        failed: the effect that was found last and cannot be simulated, and why; "": there is none.
    """

    passes: tuple[Found, ...]
    match: Match
    added: tuple[Cause, ...]
    verdict: Verdict
    failed: str = ""

    @cached_property
    def model(self) -> Model:
        """With everything that was added, refitted."""
        return self.match.told


def named(
    problem: Problem,
    scenes: Scenes,
    start: Model,
    effects: Sequence[Effect],
    thresholds: Mapping[str, float],
    progress: Callable[[str], None] = lambda text: None,
) -> Naming:
    """Add effects until nothing above its threshold is left, or what is left cannot be simulated.

    Args:
        problem: probes and unknowns.
        scenes: of the probes.
        start: law, values and known causes to begin with.
        effects: a catalogue.
        thresholds: score by effect's id that nothing missing may reach.
        progress: hears what is done.

    Raises:
        ValueError: a scene cannot be simulated.
    """
    progress(ROLLED)
    match = matched(Match.of(problem, scenes, start), rough=True)
    passes, failed = list[Found](), ""
    while True:
        progress("scoring effects")
        gone = {name for found in passes for name in found.gone}
        sought = [e for e in effects if e.id not in gone]
        found = judged(match, sought, thresholds, WRONG**2 * simulated(passes, match))
        try:
            found, after = _added(found, thresholds, progress, last=len(passes) == MOST)
        except ValueError as error:
            found, after, failed = replace(found, best=found.seen[0]), None, str(error)
        passes.append(replace(found, match=found.match.lighter))
        if after is None:
            break
        match, passes = shed(after, passes, thresholds)
    added = match.told.causes[len(start.causes) :]
    passes = without_rivals(passes, {c.effect.id for c in added} | gone)
    verdict: Verdict = "named" if added else "none"
    if passes[-1].best is not None or not passes[-1].enough:
        verdict = "unnamed"
    elif any(found.rivals for found in passes):
        verdict = "ambiguous"
    return Naming(tuple(passes), match, added, verdict, failed)


def simulated(passes: Sequence[Found], match: Match) -> float:
    """What effects explain of the gap's square if any of them acts in the world.

    What sensors make of a motion is exact.

    Args:
        passes: that found them.
        match: the twin with all of them.
    """
    if all(found.best is None or found.best.effect.world is None for found in passes):
        return 0.0
    return passes[0].left - match.excess_left


def without_rivals(passes: Sequence[Found], ids: Set[str]) -> list[Found]:
    """Passes without rivals that were added afterwards, or went again: they are no open question."""
    return [replace(p, rivals=tuple(r for r in p.rivals if r not in ids)) for p in passes]


def shed(
    match: Match, passes: Sequence[Found], thresholds: Mapping[str, float]
) -> tuple[Match, list[Found]]:
    """Without causes that have become needless, beside one that was found last.

    What comes nearest at first may only be like what is missing, as a picture's scale is like swelling.

    Args:
        match: the twin with all of them.
        passes: that found them.
        thresholds: score by effect's id that a cause must be worth.

    Returns:
        The twin, and the passes that are left.
    """
    passes = list(passes)
    for n in reversed(range(len(passes) - 1)):
        cause = match.model.causes[n - len(passes)]
        wanted = passes[n].wanted(cause.effect, thresholds)
        if match.worth(n - len(passes)) > wanted:
            continue
        try:
            less = matched(match.near(match.model.without(cause)))
        except ValueError:  # it cannot be simulated alone
            continue
        if less.excess_left - match.excess_left < wanted:
            later = [a.instead(b) for a, b in pairwise(passes[n:])]
            match, passes = less, [*passes[:n], *later]
    return match, passes


def judged(
    match: Match, effects: Sequence[Effect], thresholds: Mapping[str, float], doubt: float = 0.0
) -> Found:
    """Scores of what is not known yet, and which of them are above their thresholds."""
    known = {c.effect.id for c in match.model.causes}
    sought = [e for e in effects if e.id not in known]
    ranked = scores(match, sought)
    ids = {s.effect.id for s in ranked}
    unseen = tuple(e for e in possible(match, sought) if e.id not in ids)
    found = Found(match, tuple(ranked), doubt=doubt, unseen=unseen)
    seen = [s for s in ranked if s.score > found.wanted(s.effect, thresholds)]
    return replace(found, seen=tuple(seen))


def _added(
    found: Found,
    thresholds: Mapping[str, float],
    progress: Callable[[str], None],
    *,
    last: bool,
) -> tuple[Found, Match | None]:
    """What is added, and the twin with it; None: nothing, or there have been enough.

    A column that takes more than simulations do by its threshold is no chance, nor is a simulation that
    takes so much more than it is worth: something is missing that is like it, and no effect is it.

    Raises:
        ValueError: the effect that comes nearest cannot be simulated.
    """
    if not found.seen:
        return found, None
    if last:
        return replace(found, best=found.seen[0]), None
    runners, refused, first = raced(found.match, found.seen, progress), list[str](), found.seen[0]
    odd = first.score - max(0.0, *(found.left - runner.left for runner in runners))
    for equal in _ties(runners):
        borne, beyond, failure = _refitted(found, equal, thresholds, progress)
        refused += beyond
        if borne:
            (gain, best, after), *others = borne
            rivals = [runner for less, runner, _ in others if less > gain - MARGIN]
            return _judged(replace(found, refused=tuple(refused)), best, rivals), after
        if failure is not None:
            raise failure
        odd = max(odd, *beyond.values())
    found = replace(found, refused=tuple(refused))
    chance = odd <= found.wanted(first.effect, thresholds)
    return (found if chance else replace(found, best=first)), None


def _refitted(
    found: Found,
    runners: Sequence[Runner[Match]],
    thresholds: Mapping[str, float],
    progress: Callable[[str], None],
) -> tuple[list[tuple[float, Runner[Match], Match]], dict[str, float], ValueError | None]:
    """Gains and twins, on a finer grid, of those that explain what they must, the largest gain first.

    Of the others by id, how much more they have seemed to explain; and why one could not be simulated.
    """
    borne, beyond, failure = list[tuple[float, Runner[Match], Match]](), dict[str, float](), None
    for runner in runners:
        effect, explained = runner.score.effect, found.left - runner.left
        wanted = found.wanted(effect, thresholds)
        if explained <= wanted:
            beyond[effect.id] = 0.0
            continue
        progress(f"adding {effect.id}")
        try:
            after = runner.matched()
        except ValueError as error:
            failure = error
            continue
        gain = found.left - after.excess_left
        if min(gain, after.worth()) > wanted:  # by the weights before, and by its own
            borne.append((gain, runner, after))
        else:
            beyond[effect.id] = max(gain - after.worth(), explained - gain)
    return sorted(borne, key=lambda one: -one[0]), beyond, failure


def _ties(runners: Sequence[Runner[Match]]) -> list[list[Runner[Match]]]:
    """Those that have come as near as the nearest, whom a finer grid tells apart; then one by one."""
    near = [r for r in runners if r.apart < runners[0].apart + MARGIN]
    return [near, *([r] for r in runners[len(near) :])]


def _judged(found: Found, best: Runner[Match], equal: Sequence[Runner[Match]]) -> Found:
    """With what is alike and what does as well.

    Next to a threshold chance decides which of two effects is above it: what was not simulated and
    scores nearly as much does as well, too, unless what it is just like was simulated and lost.
    """
    own, ran = best.score, field(found.seen)
    least = max(own.score, found.left - best.left) - MARGIN
    tried = {s.effect.id for s in ran}
    near = [s for s in found.ranked if s.score > least and s.effect.id not in tried]
    ids = {s.effect.id for s in found.ranked}
    others = {s.effect.id: s for s in (*found.seen, *near) if s.effect is not own.effect}
    like = coherence([own, *others.values()])[0, 1:]
    alike = [name for name, c in zip(others, like, strict=True) if c > ALIKE]
    alike += [name for name in own.effect.same if name not in alike and name in ids]
    level = [r.score for r in equal]
    open_ = {s.effect.id for s in (own, *level)}
    lost = [s for s in ran if s.effect.id not in open_]
    near = [s for s in near if coherence([s, *lost])[0, 1:].max(initial=0.0) <= SAME]
    rivals = [s.effect.id for s in (*level, *near) if s.effect.id not in alike]
    return replace(found, best=own, alike=tuple(alike), rivals=tuple(rivals))
