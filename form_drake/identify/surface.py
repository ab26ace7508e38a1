"""Identification from points on the surface: the inside is what the law found so far balances.

First any elasticity stands in for the law. What is identified then takes its place, until values no
longer change: the inside, the law and what is seen agree.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from form_drake.identify.options import Reader
from form_drake.identify.solve import Identification
from form_drake.interior import Resistance, fit_surface
from form_drake.motion import Body, Fit, body
from form_drake.records import Recording
from form_drake.weak.ready import probe_body

PASSES = 4
SETTLED = 0.2  # of a standard deviation, by which values may still change
LEAST = 1e-3  # of a value, the same


def balanced_inside(
    recordings: Sequence[Recording],
    known: Mapping[str, float],
    identified: Callable[[Sequence[Recording], Reader], Identification],
) -> Identification:
    """The answer whose own law balances the inside of the bodies.

    Args:
        recordings: of which some hold points of the surface alone.
        known: given values.
        identified: the answer from recordings with a reader of them.
    """
    throughout = {id(r): probe_body(r) for r in recordings if not r.on_surface}
    resistance: Resistance | None = Resistance.plain(known.get("nu"))
    answers: list[Identification] = []
    while resistance is not None and len(answers) < PASSES:

        def read(
            r: Recording, symmetric: bool = True, inside: Resistance = resistance
        ) -> tuple[Body, Fit]:
            if not r.on_surface:
                return throughout[id(r)] if symmetric else probe_body(r, symmetric)
            shape = body(r)
            return shape, fit_surface(r, shape, inside, symmetric=symmetric)

        given = recordings if resistance.weighs else [_weightless(r) for r in recordings]
        answers.append(identified(given, read))
        if len(answers) > 1 and _alike(*answers[-2:]):
            break
        resistance = Resistance.of(answers[-1].material)
    last = answers[-1]
    first = {k: v.value for k, v in answers[0].material.parameters().items()}
    details = {**last.details, "passes_inside": len(answers), "before_law_inside": first}
    return replace(last, details=details, seconds=sum(a.seconds for a in answers))


def _weightless(recording: Recording) -> Recording:
    """Without weight, where the frame that it has bent is taken for free of stress."""
    bent = recording.on_surface and recording.p_reference is None
    return replace(recording, gravity=None) if bent else recording


def _alike(one: Identification, other: Identification) -> bool:
    """Whether two answers differ by less than matters."""
    before, now = one.material.parameters(), other.material.parameters()
    return all(
        abs(p.value - before[k].value) <= max(SETTLED * (p.std or 0.0), LEAST * abs(p.value))
        for k, p in now.items()
    )
