"""Covariance of a probe's rows: from its tracks and forces, and from what these do not tell."""

from collections.abc import Iterator

import numpy as np

from form_drake.laws import Law, Values
from form_drake.motion.motion import inverse
from form_drake.motion.smoothing import Spread
from form_drake.weak.covariance import Part, Past, parts_of, track_noise
from form_drake.weak.history import lasting as lasting_rows
from form_drake.weak.noise import Bases, Slopes, slopes
from form_drake.weak.probe import Probe
from form_drake.weak.tangent import State, Tangent, tangent, under

POINTS = 2**15  # at all times together, whose stresses are differentiated at once
LOOKS = 6  # most times in a window at which the noise is linearised
# share of a row's variance that its linearisation misses: without it, rows that few independent
# noises drive would be combined into ones that claim to hold no noise at all
INEXACT = 0.03


def noise(probe: Probe, law: Law, values: Values, theta: np.ndarray) -> np.ndarray:
    """Covariance of b - A theta [(N m s)^2] from tracks and forces, kept rows alone.

    Errors of F act at their own time alone: rows of slow flow are held for noisier than they are.

    Args:
        probe: whose rows.
        law: the law.
        values: its constants.
        theta: coefficients of its terms.
    """
    tracks = track_noise(_parts(probe, law, values, theta, probe.fit.spread))
    total = (tracks + from_forces(probe))[np.ix_(probe.keep, probe.keep)]
    found: np.ndarray = total + INEXACT * np.diag(np.diag(total))
    return found


def passed(
    probe: Probe, law: Law, values: Values, theta: np.ndarray, gain: np.ndarray
) -> np.ndarray:
    """The same of few combinations of the rows, with what noise leaves in plastic strain.

    What lasts is counted, see ``weak.history``, but along traction-free directions. ``gain`` are the
    combinations of kept rows, shape [combinations, rows].
    """
    every, forces = _of_all(probe, gain), from_forces(probe)
    total, variance = every @ forces @ every.T, np.diag(forces).copy()
    for part in _parts(probe, law, values, theta, probe.fit.spread, lasting=True):
        total += part.combined(every)
        variance += part.variances()
    return np.asarray(total + (every * (INEXACT * variance)) @ every.T)


def doubt(
    probe: Probe, law: Law, values: Values, theta: np.ndarray, gain: np.ndarray
) -> np.ndarray:
    """The same from what no track tells, see ``Fit``, at its own time alone."""
    every = _of_all(probe, gain)
    parts = _parts(probe, law, values, theta, probe.fit.doubt)
    return np.asarray(sum(part.combined(every) for part in parts))


def _of_all(probe: Probe, gain: np.ndarray) -> np.ndarray:
    """Combinations of all rows from those of kept ones."""
    every = np.zeros((len(gain), len(probe.keep)))
    every[:, probe.keep] = gain
    return every


def missed(probe: Probe) -> np.ndarray:
    """The same from what the motion misses of forces (see ``Force``), beyond their own noise.

    A window whose rows would be off by some amounts, had the motion been made of the force, may be off
    by as much, all alike, and no window tells of another.
    """
    left = {k: 0.0 * f.value if f.missed is None else f.missed for k, f in probe.forces.items()}
    off = probe.pushed(probe.along(probe.motion), left)
    own = np.diag(from_forces(probe))[probe.keep]
    window = np.flatnonzero(probe.keep) // (len(probe.keep) // len(probe.windows))
    together = window[:, None] == window
    size = np.maximum(together @ off**2, np.finfo(float).tiny)
    beyond = np.maximum(1.0 - together @ own / size, 0.0)
    return np.asarray(together * beyond * np.outer(off, off))


def from_forces(probe: Probe) -> np.ndarray:
    """From the forces alone, of all rows."""
    counts = [len(f.names) for f in probe.fields]
    m, W = sum(counts), len(probe.windows)
    total = np.zeros((W * m, W * m))
    acting = [f.acting(probe.motion) for f in probe.fields]
    for tool, force in probe.forces.items():
        none = [np.zeros((len(probe.motion.time), n, 3)) for n in counts]
        end = np.concatenate([a.get(tool, z) for a, z in zip(acting, none, strict=True)], axis=1)
        psi = probe.powers(force, end, np.ones_like(force.value))
        rows = np.einsum("ws,sfd->wfsd", probe.impulses[tool], psi, optimize=True)
        rows = rows.reshape(W * m, -1)
        total += force.noise**2 * (rows @ rows.T)
    return total


def _parts(
    probe: Probe,
    law: Law,
    values: Values,
    theta: np.ndarray,
    spread: tuple[Spread, ...],
    *,
    lasting: bool = False,
) -> Iterator[Part]:
    """Parts of the errors of the rows from some of those of the motion."""
    motion = probe.motion
    rates, unload, own = "rate" in law.needs, None, motion.F
    if law.flow == "plastic":
        elastic = probe.elastic(law, values, motion)
        first = np.broadcast_to(np.eye(3), elastic[:1].shape)
        unload = np.concatenate([first, inverse(motion.F[:-1]) @ elastic[:-1]])
    if probe.released:
        own = probe.stretched(law, values, theta)

    def tangents(at: np.ndarray, material: bool) -> Tangent:
        state = State(
            own[at],
            motion.L[at],
            unload=None if unload is None else unload[at],
            seen=motion.F[at] if probe.released else None,
            axes=probe.released,
            pressure=None if motion.pressure is None else motion.pressure[at],
        )
        met = tangent(law, state, values, theta, material=material, rates=rates)
        if state.pressure is None:
            return met
        return under(met, motion.F[at], state.pressure, material=material)

    width = float(np.diff(probe.windows.ends, axis=1).min())
    step = float(np.median(np.diff(motion.time)))
    every = max(1, int(np.ceil(width / step / LOOKS - 1e-6)))
    at = np.arange(0, len(motion.time), every)
    bases = Bases.of(probe.fit, probe.sampling, spread)
    count = max(1, POINTS // len(motion.X))
    blocks = [at[n : n + count] for n in range(0, len(at), count)]
    families = [
        Slopes.joined([slopes(f, motion, b, tangents, probe.gravity, rates, bases) for b in blocks])
        for f in probe.fields
    ]
    history = []
    if lasting and law.flow == "plastic" and not probe.released:
        history = _history(probe, law, values, theta, bases, every)
    return parts_of(bases, families, every, probe.windows, history)


def _history(
    probe: Probe, law: Law, values: Values, theta: np.ndarray, bases: Bases, every: int
) -> list[Past]:
    """What lasts of the motion in plastic strain, looks of ``every`` times together."""
    motion = probe.motion

    def back(trial: np.ndarray, first: int) -> Tangent:
        own = slice(first, first + len(trial))
        p = None if motion.pressure is None else motion.pressure[own]
        state = State(trial, motion.L[own], pressure=p)
        return tangent(law, state, values, theta, elastic=True)

    def pairing(at: slice) -> np.ndarray:
        look, found = motion.at(at), []
        for fields in probe.fields:
            gradient = fields.at(look).gradient
            paired = gradient @ look.inverse[:, None] if fields.material else gradient
            found.append(motion.volume[:, None, None] * paired)
        return np.concatenate(found, axis=1)

    elastic = probe.elastic(law, values, motion)
    found = lasting_rows(motion.F, elastic, pairing, probe.windows.chi, back, POINTS, every)
    return [Past.of(own, bases) for own in found]
