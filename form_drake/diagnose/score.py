"""How well every effect of a catalogue explains what the rows of a balance leave over.

Each effect is one more column. Rows are whitened by their covariance, columns and residual are
projected off what the law itself can explain, and an effect is scored by how much of the residual's
square its column takes: chi-square with one degree of freedom where nothing is missing.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from form_drake.diagnose.reading import ProbeReading
from form_drake.effects import Effect, Shape
from form_drake.identify.problem import Problem, Rows
from form_drake.motion import Body
from form_drake.weak.solve import TINY, Weights

PLACES = 5  # along each axis of a body at which a place is tried
RADIUS = 0.2  # of the least edge of a body, of what is sought at a place
PAIRS = 4  # of noise draws
DETECTED = 5.0  # standard deviations that count as seen


@dataclass(frozen=True)
class Score:
    """One effect at its best shape.

    Attributes:
        effect: of the catalogue.
        shape: values of its shape parameters.
        coefficient: in the effect's unit; to first order, and about moduli that have taken what they
            can of the effect.
        std: of it.
        score: what it takes of the residual's square, less 2 ln of the number of shapes; not
            below zero.
        limit: least size that these rows would show.
        column: whitened, projected, of unit length, shape [rows].
    """

    effect: Effect
    shape: Mapping[str, float]
    coefficient: float
    std: float
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


def scores(
    problem: Problem,
    twin: Problem,
    by: Weights,
    values: Mapping[str, float],
    effects: Iterable[Effect],
) -> list[Score]:
    """Every effect at the shape that explains most, best first.

    All columns are those of a twin: without noise, they cannot be explained away by moduli that
    go to zero, as in data whose force alone says how stiff the body is.

    Args:
        problem: probes and unknowns.
        twin: the same, simulated with ``values`` and read in the same way.
        by: inverse covariance of the rows.
        values: of all parameters, near those that the data have.
        effects: a catalogue; those that do not fit the law are left out.
    """
    base, left = leftover(problem, twin, by, values)
    readings = ProbeReading.of(twin, values)
    found = []
    for effect in (e for e in effects if e.fits(problem.unknowns.law)):
        tried = shapes(effect, problem.probes[0].body)
        columns = np.stack([_column(effect, shape, readings) for shape in tried], axis=1)
        found.append(_best(effect, tried, _off(base, by.white(columns)), left))
    return sorted(found, key=lambda s: -s.score)


def leftover(
    problem: Problem, twin: Problem, by: Weights, values: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """An orthonormal basis of what the law can explain, and what it leaves, both whitened.

    Returns:
        shapes [rows, unknowns] and [rows].
    """
    base = np.linalg.qr(by.white(twin.jacobian(*twin.coordinates(values))))[0]
    return base, _off(base, by.white(_apart(problem, twin, values)))


def corrected(
    problem: Problem, twin: Problem, by: Weights, values: Mapping[str, float]
) -> np.ndarray:
    """Change of the unknowns, linear ones first, that brings the twin nearest to the data."""
    slopes, apart = twin.jacobian(*twin.coordinates(values)), _apart(problem, twin, values)
    return np.asarray(np.linalg.lstsq(by.white(slopes), by.white(apart), rcond=None)[0])


def _apart(problem: Problem, twin: Problem, values: Mapping[str, float]) -> np.ndarray:
    """What the rows of the data leave and those of the twin do not [N m s].

    Noise shifts the rows of the data too, to second order. By as much it shifts those of the twin:
    that is the mean over pairs of draws of opposite sign.
    """
    eta, theta = twin.coordinates(values)
    data, own = (_rest(p.rows(eta, theta), theta) for p in (problem, twin))
    shift, count, rng = np.zeros(len(own)), 0, np.random.default_rng(0)
    for _ in range(PAIRS):
        drawn = [probe.drawn(rng) for probe in problem.probes]
        made = [twin.coarser.disturbed(eta, drawn, share) for share in (0.0, 1.0, -1.0)]
        still, *both = (_rest(one, theta) for one in made if one is not None)
        if len(both) == 2:
            shift += np.mean(both, axis=0) - still
            count += 1
    return np.asarray(data - own - shift / max(count, 1))


def _rest(rows: Rows, theta: np.ndarray) -> np.ndarray:
    A, b = rows
    return np.asarray(b - A @ theta)


def coherence(found: Sequence[Score]) -> np.ndarray:
    """How alike the columns of effects are, from 0 to 1, shape [effects, effects]."""
    columns = np.stack([s.column for s in found], axis=1)
    return np.abs(columns.T @ columns)


def _off(base: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.asarray(a - base @ (base.T @ a))


def _column(effect: Effect, shape: Shape, readings: Sequence[ProbeReading]) -> np.ndarray:
    return np.concatenate([effect.column(reading, shape) for reading in readings])


def _best(effect: Effect, tried: Sequence[Shape], columns: np.ndarray, left: np.ndarray) -> Score:
    length = np.linalg.norm(columns, axis=0)
    unit = columns / np.maximum(length, TINY)
    taken = unit.T @ left
    if not effect.signed:
        taken = np.maximum(taken, 0.0)
    n = int(np.argmax(np.abs(taken)))
    size = max(float(length[n]), TINY)
    score = max(float(taken[n] ** 2) - 2.0 * np.log(len(tried)), 0.0)
    return Score(
        effect, tried[n], float(taken[n]) / size, 1.0 / size, score, DETECTED / size, unit[:, n]
    )
