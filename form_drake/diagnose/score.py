"""How well every effect of a catalogue explains what the rows of a balance leave over.

Each effect is one more column. Rows are whitened by their covariance, columns and residual are
projected off what law and known causes explain, and an effect is scored by how much of the
residual's square its column takes: chi-square with one degree of freedom where nothing is missing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from form_drake.diagnose.projected import Projected
from form_drake.effects import Effect, Shape
from form_drake.motion import Body
from form_drake.weak.solve import TINY

PLACES = 5  # along each axis of a body at which a place is tried
RADIUS = 0.2  # of the least edge of a body, of what is sought at a place
UNSEEN = 1e50  # least size, from which nothing would be seen
ALIKE = 0.9  # coherence from which two columns are one class
DETECTED = 5.0  # standard deviations that count as seen


@dataclass(frozen=True)
class Score:
    """One effect at its best shape.

    Attributes:
        effect: of the catalogue.
        shape: values of its shape parameters.
        coefficient: in the effect's unit and bounds; to first order, and about moduli that have taken
            what they can of the effect.
        score: what it takes of the residual's square, less 2 ln of the number of shapes; not
            below zero.
        limit: least size that these rows would show at that shape; of no score, that at half of the
            shapes.
        column: whitened, projected, of unit length, shape [rows].
    """

    effect: Effect
    shape: Shape
    coefficient: float
    score: float
    limit: float
    column: np.ndarray


def shapes(effect: Effect, body: Body) -> list[dict[str, float]]:
    """Shapes at which an effect is sought in a body: its own grid, or places inside."""
    if "radius" not in effect.shapes:
        return effect.grid()
    size, share = body.high - body.low, (np.arange(PLACES) + 0.5) / PLACES
    axes = [low + share * edge for low, edge in zip(body.low, size, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = RADIUS * float(size.min())
    return [dict(zip("xyz", place.tolist(), strict=True)) | {"radius": radius} for place in grid]


def named_from(effect: Effect, wanted: float) -> float:
    """Size at which an effect scores as much on average, in standard deviations at its shape."""
    count = PLACES**3 if "radius" in effect.shapes else len(effect.grid())
    return float(np.sqrt(wanted + 2.0 * np.log(count)))


def possible(match: Projected, effects: Iterable[Effect]) -> list[Effect]:
    """Those that fit the law, and that a body has a face for."""
    law, bodies = match.model.law, match.bodies
    return [e for e in effects if e.fits(law) and any(e.concerns(b) for b in bodies)]


def scores(match: Projected, effects: Iterable[Effect]) -> list[Score]:
    """Every effect at the shape that explains most, best first.

    Args:
        match: of data and twin.
        effects: a catalogue; those that are not possible, or that no row sees, are left out.
    """
    tried = {e.id: (e, shapes(e, match.bodies[0])) for e in possible(match, effects)}
    match.learn(list(tried.values()))
    found = (scored(match, *one) for one in tried.values())
    return sorted((s for s in found if s.limit < UNSEEN), key=lambda s: -s.score)


def scored(match: Projected, effect: Effect, tried: Sequence[Shape]) -> Score:
    """One effect at the best of some shapes; where none is seen, its limit is their median."""
    best, *others = ranked(match, effect, tried)
    limits = [one.limit for one in (best, *others) if one.limit < UNSEEN]
    return best if best.score or not limits else replace(best, limit=float(np.median(limits)))


def ranked(match: Projected, effect: Effect, tried: Sequence[Shape]) -> list[Score]:
    """One effect at some shapes, best first, also of those whose scores are zero."""
    columns = match.off(match.columns(effect, tried))
    length = np.maximum(np.linalg.norm(columns, axis=0), TINY)
    unit = columns / length
    wanted = unit.T @ match.left
    taken = np.clip(wanted, effect.lower * length, effect.most * length)
    gain = taken * (2.0 * wanted - taken) - 2.0 * np.log(len(tried))
    every = [
        Score(effect, shape, float(c), max(float(g), 0.0), DETECTED * float(std), u)
        for shape, c, std, g, u in zip(
            tried, taken / length, 1.0 / length, gain, unit.T, strict=True
        )
    ]
    return [every[n] for n in np.argsort(-gain, kind="stable")]


def coherence(found: Sequence[Score]) -> np.ndarray:
    """How alike the columns of effects are, from 0 to 1, shape [effects, effects]."""
    columns = np.stack([s.column for s in found], axis=1)
    return np.abs(columns.T @ columns)
