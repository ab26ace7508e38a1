"""Which effect is missing: scores against thresholds, one effect added after the other."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import minimize

from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.score import Score, coherence, scored, scores
from form_drake.diagnose.search import matched
from form_drake.effects import Effect
from form_drake.identify.problem import Problem

MOST = 3  # effects
ALIKE = 0.9  # coherence from which two columns are one class
MARGIN = 10.0  # of scores, within which effects of other classes make an answer ambiguous
LEAST = 16.0  # of a threshold: four standard deviations, whatever the nulls are
REFINED = 60  # columns that are tried while a shape is refined

Verdict = Literal["none", "named", "ambiguous", "unnamed"]


@dataclass(frozen=True)
class Found:
    """One pass: an effect that was found missing, with what is like it.

    Attributes:
        match: before it was added.
        ranked: all scores, best first.
        best: that which is added; None: none is above its threshold.
        alike: ids of effects whose columns are of one class with it.
        rivals: ids of effects of other classes that explain nearly as much.
    """

    match: Match
    ranked: tuple[Score, ...]
    best: Score | None
    alike: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Naming:
    """All passes.

    Attributes:
        passes: the last one found nothing, or no more were allowed.
        model: with everything that was added, refitted.
        added: causes of the model that were not known before, one for each pass but the last.
        verdict: ``unnamed``: something is missing that no effect explains, or none that can be
            simulated.
        failed: the effect that was found last and cannot be simulated, and why; "": there is none.
    """

    passes: tuple[Found, ...]
    model: Model
    added: tuple[Cause, ...]
    verdict: Verdict
    failed: str = ""


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
    progress("simulating the twin")
    match, passes, failed = matched(Match.of(problem, scenes, start)), [], ""
    while True:
        progress("scoring effects")
        passes.append(judged(match, effects, thresholds))
        best = passes[-1].best
        if best is None or len(passes) > MOST:
            break
        progress(f"adding {best.effect.id}")
        cause = Cause(best.effect, best.effect.bounded(best.coefficient), best.shape)
        more = replace(match.model, causes=(*match.model.causes, cause))
        try:
            match = matched(match.near(more))
        except ValueError as error:
            failed = f"{best.effect.id}: {error}"
            break
    model = match.told
    added = model.causes[len(start.causes) :]
    verdict: Verdict = "named" if added else "none"
    if passes[-1].best is not None:
        verdict = "unnamed"
    elif any(found.rivals for found in passes):
        verdict = "ambiguous"
    return Naming(tuple(passes), model, added, verdict, failed)


def judged(match: Match, effects: Sequence[Effect], thresholds: Mapping[str, float]) -> Found:
    """The effect that explains most of what is left, among those above their thresholds."""
    known = {c.effect.id for c in match.model.causes}
    ranked = scores(match, [e for e in effects if e.id not in known])
    seen = [s for s in ranked if s.score > max(thresholds.get(s.effect.id, 0.0), LEAST)]
    if not seen:
        return Found(match, tuple(ranked), None)
    best = refined(match, seen[0])
    like = coherence([best, *seen[1:]])[0, 1:]
    alike = tuple(s.effect.id for s, c in zip(seen[1:], like, strict=True) if c > ALIKE)
    near = tuple(
        s.effect.id
        for s, c in zip(seen[1:], like, strict=True)
        if c <= ALIKE and s.score > best.score - MARGIN
    )
    return Found(match, tuple(ranked), best, alike, near)


def refined(match: Match, score: Score) -> Score:
    """The score at the best shape near the best of a grid."""
    free = list(score.effect.shapes)
    if not free:
        return score
    start = np.array([score.shape[k] for k in free])
    widths = np.array([score.effect.width(score.shape, k) for k in free])

    def tried(z: np.ndarray) -> Score:
        shape = {**score.shape, **dict(zip(free, (start + z * widths).tolist(), strict=True))}
        return scored(match, score.effect, [shape])

    found = minimize(
        lambda z: -tried(z).score,
        np.zeros(len(free)),
        method="Nelder-Mead",
        options={"maxfev": REFINED, "initial_simplex": _simplex(len(free)), "xatol": 0.02},
    )
    best = tried(found.x)
    return best if best.score > score.score else score


def _simplex(n: int) -> np.ndarray:
    return 0.5 * np.vstack([np.zeros(n), np.eye(n)])
