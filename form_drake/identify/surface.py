"""Identification from points on the surface: the inside is what the law found so far balances.

First Hencky's elasticity stands in for the law. What is identified then takes its place, until the inside,
the law and what is seen agree. Each round brings values a share nearer to that; how large the share is
shows after a few, and the next steps are as much longer (Irons and Tuck, 1969).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from form_drake.identify.options import Reader
from form_drake.identify.solve import Identification
from form_drake.interior import Path, Resistance, Seen, stands
from form_drake.laws import Law
from form_drake.material import Material
from form_drake.motion import Body, Fit, body
from form_drake.records import Recording
from form_drake.weak.ready import probe_body

PASSES = 8
RUBBED = 2  # passes with a law in which friction is looked for
SETTLED = 0.2  # of a standard deviation, by which values may lie off those that agree
LEAST = 1e-3  # of a value, the same
LONGEST = 5.0  # times a change, by which values may step


def balanced_inside(
    recordings: Sequence[Recording],
    law: Law,
    known: Mapping[str, float],
    identified: Callable[[Sequence[Recording], Reader], Identification],
) -> Identification:
    """The answer whose own law balances the inside of the bodies.

    Args:
        recordings: of which some hold points of the surface alone.
        law: that is sought.
        known: given values.
        identified: the answer from recordings with a reader of them.

    Raises:
        ValueError: the law flows at rest.
    """
    stands(law)
    weightless = [_weightless(r) for r in recordings]
    place = {id(r): n for both in (recordings, weightless) for n, r in enumerate(both)}

    @cache
    def throughout(n: int, symmetric: bool) -> tuple[Body, Fit]:
        return probe_body(recordings[n], symmetric)

    @cache
    def surface(n: int, symmetric: bool) -> Seen:
        return Seen.of(recordings[n], body(recordings[n]), symmetric=symmetric)

    paths: dict[tuple[int, bool], Path] = {}

    def reader(resistance: Resistance) -> Reader:
        again = len(answers) <= RUBBED

        def read(recording: Recording, symmetric: bool = True) -> tuple[Body, Fit]:
            n = place[id(recording)]
            if not recording.on_surface:
                return throughout(n, symmetric)
            seen = surface(n, symmetric)
            before = paths.get((n, symmetric))
            friction = before.friction if before and not again else None
            path = Path.of(seen, resistance, friction, before)
            paths[n, symmetric] = path
            return seen.body, path.fit()

        return read

    answers: list[Identification] = []
    answers.append(identified(weightless, reader(Resistance.plain(known.get("nu")))))
    assumed, before, length, settled = answers[0].material, None, 1.0, False
    while not settled and len(answers) < PASSES:
        answers.append(identified(recordings, reader(Resistance.of(assumed))))
        found = answers[-1].material
        change = _change(assumed, found)
        length = 1.0 if before is None else _length(length, before, change)
        settled = length * float(np.abs(change).max()) <= 1.0
        assumed, before = _ahead(assumed, found, length), change
    first = {k: v.value for k, v in answers[0].material.parameters().items()}
    told = {
        "passes_inside": len(answers),
        "settled_inside": settled,
        "before_law_inside": first,
        "friction": [None if np.isinf(path.friction) else path.friction for path in paths.values()],
    }
    last = answers[-1]
    return replace(last, details={**last.details, **told}, seconds=sum(a.seconds for a in answers))


def _weightless(recording: Recording) -> Recording:
    """Without weight, where the frame that it has bent is taken for free of stress."""
    bent = recording.on_surface and recording.p_reference is None
    return replace(recording, gravity=None) if bent else recording


def _change(assumed: Material, found: Material) -> np.ndarray:
    """Of every identified value, as a multiple of what does not matter."""
    stated = found.parameters()
    ones = [(stated[k], assumed.values[k]) for k in found.keys]
    return np.array(
        [(p.value - a) / max(SETTLED * (p.std or 0.0), LEAST * abs(p.value)) for p, a in ones]
    )


def _length(length: float, before: np.ndarray, change: np.ndarray) -> float:
    """Of the next step in changes, from the last step's and what it made of the change."""
    bend = change - before
    found = -length * float(before @ bend) / max(float(bend @ bend), np.finfo(float).tiny)
    return found if 1.0 < found < LONGEST else 1.0


def _ahead(assumed: Material, found: Material, length: float) -> Material:
    """The values found, or beyond them where that makes a material."""
    old, new = assumed.values, found.values
    try:
        return found.changed({k: old[k] + length * (new[k] - old[k]) for k in found.keys})
    except ValueError:
        return found
