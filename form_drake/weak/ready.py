"""A recording made ready for the weak form: where and when its integrals are taken."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from form_drake.motion import Body, Fit, Motion, Sampling, body, fit_tracks, supplied
from form_drake.motion.body import unmeasured
from form_drake.motion.space import Space
from form_drake.motion.tracks import noise_of, tracks
from form_drake.records import Recording
from form_drake.weak.contact import HeldFields
from form_drake.weak.curl import CurlFields
from form_drake.weak.fields import Exchanged, Fields, Mirrored
from form_drake.weak.force import followed, holding, measured
from form_drake.weak.probe import Probe
from form_drake.weak.reach import usable
from form_drake.weak.windows import windows

SAMPLES = 8  # fewest times in a window
# a face moves by more than this share of the body, in so many looks; forces below this share of the
# body's weight are none
MOVED, FRAMES, LIGHT = 0.01, 24, 1e-5
LOOKS, CLOSED = 4, 1e-6  # times at which divergence is looked at, and what is none of it
UNDERSTATED = 1.5  # times the stated noise, that tracks show
GAUSS, ROUGH = 3, 2  # points along each axis of a cell, of one or two cells


def prepared(
    recording: Recording,
    name: str,
    fields: Sequence[Fields],
    ends: np.ndarray,
    shape: Body,
    fit: Fit,
    free: tuple[int, ...] = (),
) -> Probe:
    """A probe from a recording, its body and fit, test fields and the ends of its windows [s].

    ``free`` are its traction-free directions.
    """
    last = float(recording.time[-1] - recording.time[0])
    frame, width = float(np.median(np.diff(recording.time))), float(np.diff(ends, axis=1).min())
    step = frame / np.ceil(SAMPLES * frame / width - 1e-6)
    time = np.linspace(0.0, last, int(np.ceil(last / step)) + 1)
    mirrors = _mirrors(recording, fit, fields)
    cells = quadrature_cells(fit.space, fields, shape, mirrors)
    exchange = fit.space.symmetry.exchange if mirrored(fit, fields) else ()
    middle = 0.5 * (shape.low + shape.high)[list(exchange)]
    if not (set(exchange) <= set(mirrors) and _alike(cells, exchange, middle)):
        exchange = ()
    curved = any(isinstance(f, CurlFields) for f in fields)

    def sampled(cells: list[np.ndarray], points: int) -> Sampling:
        X, volume = shape.gauss(cells, points)
        volume = 2.0 ** len(mirrors) * volume
        X, volume = beside(X, volume, fields)
        if exchange:
            X, volume = halved(X, volume, X[:, exchange] - middle)
        found = Sampling.of(fit, time, X, volume, shape.density * recording.mass_scale)
        return replace(
            unfolded(found, fit),
            hessian=fit.space.scalar.hessian(X) if curved else None,
            pressure=supplied(recording, recording.pressure, fit, time, X),
            body_force=supplied(recording, recording.body_force, fit, time, X),
        )

    rough = [np.linspace(c[0], c[-1], 1 + (len(c) + 1) // 2) for c in cells]
    falls = np.zeros(3) if recording.solver is None else recording.solver.gravity
    stated = falls if recording.gravity is None else recording.gravity
    gravity = np.asarray(stated, float) / recording.mass_scale
    frames = recording.time - recording.time[0]
    hold = holding(shape)
    forces = {
        tool: followed(force, frames, fit.time) if tool in hold else force
        for tool, force in measured(recording, 0.0, last).items()
    }
    probe = Probe(
        name,
        shape,
        fit,
        sampled(cells, GAUSS),
        sampled(rough, ROUGH),
        tuple(fields),
        windows(time, ends),
        forces,
        gravity,
        usable(shape, fit, fields, ends),
        free,
    )
    for family in fields:
        _check(family, probe.motion)
    if not probe.motion.J.min() > 0.0:
        raise ValueError(
            f"{name}: the motion through the tracks folds the body: {_spoilt(recording, shape)}"
        )
    return probe


def _spoilt(recording: Recording, shape: Body) -> str:
    """What may be wrong with tracks through which no motion passes."""
    _, u, valid, time, _ = tracks(recording, shape, throughout=False)
    stated, seen = recording.noise, 0.0
    with suppress(ValueError):  # too much is missing to tell
        seen = noise_of(time, u, valid)
    if stated is None or seen < UNDERSTATED * stated:
        return "they are too few or too noisy"
    return (
        f"they jitter by {1e6 * seen:.3g} um, which is more than the noise of {1e6 * stated:.3g} um that is"
        " stated: state what there is, or leave it out and it is estimated"
    )


def unfolded(sampling: Sampling, fit: Fit) -> Sampling:
    """Without gradients where a point without volume folds: tracks tell least of corners."""
    alone = np.flatnonzero(sampling.volume == 0.0)
    if not len(alone):
        return sampling
    X, none = sampling.X[alone], sampling.volume[alone]
    looks = Sampling.of(fit, sampling.time, X, none, sampling.density).motion(fit.c)
    gradient = sampling.gradient.copy()
    gradient[alone[looks.J.min(axis=0) <= 0.0]] = 0.0
    return replace(sampling, gradient=gradient)


def _check(fields: Fields, motion: Motion) -> None:
    """Refuse fields whose samples have other shapes than all take them to have."""
    found = fields.at(motion.at(slice(0, 2)))
    shape = (2, len(fields.names), len(motion.X), 3)
    for name, value, wanted in (
        ("value", found.value, shape),
        ("gradient", found.gradient, (*shape, 3)),
        ("rate", found.rate, shape),
    ):
        if value is not None and value.shape != wanted:
            raise ValueError(
                f"test fields {type(fields).__name__}: {name} of shape {value.shape}, wanted"
                f" [times, fields, points, ...]: {wanted}"
            )


def check_loads(recording: Recording, shape: Body, fit: Fit) -> None:
    """Refuse tools that the tracks show to move and no force is of, and forces of no weight at all.

    Raises:
        ValueError: saying so.
    """
    for face in shape.faces:
        known = face.tool in recording.forces or face.tool in recording.poses
        if not face.tool or known or face.condition == "bonded":
            continue
        time, X = (
            np.linspace(fit.time.breaks[0], fit.time.breaks[-1], FRAMES),
            shape.face_points(face),
        )
        x = Sampling.of(fit, time, X, np.ones(len(X)), 1.0).motion(fit.c).x[..., face.axis]
        if np.ptp(x.mean(axis=1)) > MOVED * (shape.high - shape.low)[face.axis]:
            raise unmeasured(face)
    size = shape.high - shape.low
    weight = 9.81 * shape.density * float(np.prod(size))
    largest = max((float(np.abs(s.value).max()) for s in recording.forces.values()), default=0.0)
    if 0.0 < largest < LIGHT * weight:
        raise ValueError(
            f"forces reach {largest:.3g} N, but the stated box of {' x '.join(f'{s:.3g}' for s in size)}"
            f" m weighs {weight:.3g} N: are lengths in millimetres, or the density in other units"
            " than kg/m^3?"
        )


def feel_pressure(probe: Probe) -> list[str]:
    """Families of test fields whose divergence does not vanish."""
    motion, found = probe.motion, []
    look = motion.at(slice(None, None, max(len(motion.time) // LOOKS, 1)))
    for family in probe.fields:
        gradient = family.at(look).gradient
        if family.material:
            gradient = gradient @ look.inverse[:, None]
        divergence = np.trace(gradient, axis1=-2, axis2=-1)
        if np.sqrt(np.mean(divergence**2)) > CLOSED * np.sqrt(np.mean(gradient**2)):
            found.append(type(family).__name__)
    return found


def _mirrors(recording: Recording, fit: Fit, fields: Sequence[Fields]) -> list[int]:
    """Axes along which motion, fields and loads are mirrored, so that half of the body is enough."""
    if recording.pressure is not None or recording.body_force is not None:
        return []
    gravity = np.zeros(3) if recording.gravity is None else np.asarray(recording.gravity)
    return [a for a in fit.space.symmetry.mirrors if gravity[a] == 0.0 and _even(fit, fields, a)]


def _even(fit: Fit, fields: Sequence[Fields], axis: int) -> bool:
    """Whether all fields stay as they are when mirrored along an axis about the middle of the body."""
    ends = fit.space.scalar.axes[axis].breaks
    middle, near = 0.5 * (ends[0] + ends[-1]), 1e-9 * (ends[-1] - ends[0])
    return all(isinstance(f, Mirrored) and f.even(axis, middle, near) for f in fields)


def mirrored(fit: Fit, fields: Sequence[Fields]) -> bool:
    """Whether all fields share the symmetries of a fit, so that none is the image of another."""
    symmetry = fit.space.symmetry
    if not all(_even(fit, fields, a) for a in symmetry.mirrors):
        return False
    both = symmetry.exchange
    return not both or all(isinstance(f, Exchanged) and f.exchanged(*both) for f in fields)


def _alike(cells: list[np.ndarray], axes: tuple[int, ...], middle: np.ndarray) -> bool:
    """Whether the cells along some axes are the same from the middle on [m]."""
    own = [cells[a] - m for a, m in zip(axes, middle, strict=True)]
    return all(len(c) == len(own[0]) and np.allclose(c, own[0], rtol=1e-9) for c in own)


def halved(X: np.ndarray, volume: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points on one side of the diagonal of two axes, for those of both.

    Args:
        X: points [m], shape [points, 3].
        volume: theirs [m^3], shape [points].
        across: their coordinates along the two axes from the middle of the body [m].
    """
    apart = np.abs(across[:, 0]) - np.abs(across[:, 1])
    near = 1e-6 * np.abs(across).max()
    kept = apart > -near
    return X[kept], (volume * np.where(apart > near, 2.0, 1.0))[kept]


def beside(
    X: np.ndarray, volume: np.ndarray, fields: Sequence[Fields]
) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature points [m] and volumes [m^3], and points without volume that fields look at."""
    more = [f.points for f in fields if isinstance(f, HeldFields)]
    none = np.zeros(sum(map(len, more)))
    return np.concatenate([X, *more]), np.concatenate([volume, none])


def quadrature_cells(
    space: Space, fields: Sequence[Fields], shape: Body, mirrors: Sequence[int] = ()
) -> list[np.ndarray]:
    """Ends of the quadrature cells along every axis [m]: no spline has a break inside a cell."""
    found = []
    for a, axis in enumerate(space.scalar.axes):
        ends = [axis.breaks, *(f.breaks[a] for f in fields if f.breaks)]
        if a in mirrors:
            middle = 0.5 * (shape.low[a] + shape.high[a])
            ends = [np.append(e[e < middle], middle) for e in ends]
        every = np.sort(np.concatenate(ends))
        apart = np.append(True, np.diff(every) > 1e-6 * (every[-1] - every[0]))
        found.append(every[apart])
    return found


def probe_body(recording: Recording, symmetric: bool = True) -> tuple[Body, Fit]:
    """The body that a recording states and the motion fitted to its tracks."""
    shape = body(recording)
    return shape, fit_tracks(recording, shape, symmetric=symmetric)
