"""Every effect on a press and a shake: what is switched on is found again, and nothing where nothing is.

Data come from a grid that is finer than the twin's, with noise. Which effect acts is known here; its size is
begun from another one, and found beside the moduli. Whether it would be named is another question.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.diagnose import Cause, Scenes, thresholds
from form_drake.diagnose.hidden import SIZES, Hidden
from form_drake.diagnose.match import Match
from form_drake.diagnose.motions import Block
from form_drake.diagnose.prepare import read
from form_drake.diagnose.score import scores
from form_drake.diagnose.search import matched
from form_drake.diagnose.verdict import LEAST
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.records import Recording

BLOCK, FINER = Block(), 1.5
LEVELS = (0.0, 0.5, 1.0)  # of the range of sizes
AWAY, ASIDE = 0.6, 0.5  # of the true size, and widths of shape parameters, where a search begins
PLATES = ("bonded", "frictionless")
SECONDS = 240.0  # for a case


def _begun(made: list[Recording]) -> Match:
    scenes = Scenes.of(tuple(made))
    problem, start = read(scenes, LAWS[BLOCK.law], {})
    return Match.of(problem, scenes, start)


def _on(name: str, level: float) -> dict[str, Any]:
    """One size of one effect, found again."""
    rng = np.random.default_rng([list(SIZES).index(name), round(10 * level)])
    hidden = Hidden.drawn(BLOCK, name, rng, level)
    true, effect = hidden.cause, hidden.cause.effect
    begun = _begun(hidden.recorded((hidden.press(), BLOCK.shake()), FINER, rng))
    aside = np.append((AWAY - 1.0) * true.coefficient, ASIDE * true.widths)
    guess = replace(begun.model, causes=(true.moved(aside),))
    match = matched(begun.near(guess))
    found: Cause = match.told.causes[0]
    left, lack = (float(np.sum(m.left**2)) for m in (match, matched(begun)))
    return {
        "true": true.coefficient,
        "found": found.coefficient,
        "std": found.told,
        "unit": effect.unit,
        "shape": {k: [true.shape[k], found.shape[k]] for k in effect.shapes},
        "left": left,
        "without": lack,
        "rows": len(match.left),
        "errors": {k: match.model.values[k] / t - 1.0 for k, t in hidden.values.items()},
        "plate": hidden.plate,
    }


def _off(plate: str) -> dict[str, Any]:
    """Scores of all effects where none acts."""
    rng = np.random.default_rng(0)
    hidden = replace(Hidden.drawn(BLOCK, "drag", rng), plate=plate)
    none = replace(hidden, cause=replace(hidden.cause, coefficient=0.0))
    match = matched(_begun(none.recorded((none.press(), BLOCK.shake()), FINER, rng)))
    found = scores(match, CATALOGUE.values())
    return {"scores": {s.effect.id: s.score for s in found}}


def run_effects(*, store: Path, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """The bench."""
    cases = {f"off/{plate}": lambda plate=plate: _off(plate) for plate in PLATES}
    cases |= {
        f"{name}/{level:g}": lambda name=name, level=level: _on(name, level)
        for name in SIZES
        for level in LEVELS
    }
    estimates = dict.fromkeys(cases, SECONDS)
    results = run_cases(cases, store=store, mark=fingerprint(), estimates=estimates, only=only)
    return {"bench": "effects", "cases": results, "thresholds": thresholds()}


def table(result: Mapping[str, Any]) -> str:
    """As printed."""
    lines = [f"{'effect':22} {'on':>10} {'found':>10} {'std':>9} {'error':>8}  explained  moduli"]
    for name, case in result["cases"].items():
        if "true" not in case:
            continue
        error = 100.0 * (case["found"] / case["true"] - 1.0)
        moduli = 100.0 * max(abs(e) for e in case["errors"].values())
        std = f"{'-':>9}" if case["std"] is None else f"{case['std']:9.2g}"
        numbers = f"{case['true']:10.4g} {case['found']:10.4g} {std} {error:+7.1f} %"
        gain = case["without"] - case["left"]
        lines.append(f"{name:22} {numbers} {gain:10.0f} {moduli:6.1f} %")
    for name, case in result["cases"].items():
        if "scores" in case:
            limits = result["thresholds"]
            over = [k for k, s in case["scores"].items() if s > max(limits.get(k, 0.0), LEAST)]
            most = max(case["scores"].items(), key=lambda one: one[1])
            told = (
                f"above their thresholds: {', '.join(over)}" if over else "none above its threshold"
            )
            lines.append(f"{name}: largest score {most[1]:.1f} of {most[0]}; {told}")
    return "\n".join(lines)
