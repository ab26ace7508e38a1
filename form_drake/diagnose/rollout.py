"""Where and when a simulation goes another way than a measured motion: ledgers of rollout and of volume.

Both motions are compared as they were read, so that what smoothing takes off is off both. What noise adds
to a mean square is taken off, and what the grid of the simulation has wrong, by a finer one, where that
is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from form_drake.diagnose.ledger import CELLS, cell_of, nested
from form_drake.diagnose.match import Match
from form_drake.motion import Body, Motion
from form_drake.weak.probe import Probe
from form_drake.weak.windows import trapezoid

DRAWS = 4  # of noise
UNITS = {"rollout": "m", "volume": "1"}  # displacements; volumes, as shares of those free of stress


@dataclass(frozen=True)
class Astray:
    """Root mean squares of how far a simulation is off, beyond noise.

    Attributes:
        name: of the probe.
        book: the ledger, one of ``UNITS``, which has the unit of all numbers.
        body: the specimen.
        time: middles of the windows, from the first frame on [s], shape [windows].
        whole: of all moments and points.
        noise: of what was measured.
        grid: what a finer grid changes of the simulation, taken off; None: it is not known, and still there.
        windows: of all points, shape [windows].
        heat: of all moments, shape [cells, cells, cells]; not a number where no point is.
    """

    name: str
    book: str
    body: Body
    time: np.ndarray
    whole: float
    noise: float
    grid: float | None
    windows: np.ndarray
    heat: np.ndarray

    def to_json(self) -> dict[str, Any]:
        """As in ``discrepancy.json``; cells are nested along x, y and z, None: no point is there."""
        return {
            "unit": UNITS[self.book],
            "whole": self.whole,
            "noise": self.noise,
            "grid": self.grid,
            "windows": self.windows.tolist(),
            "cells": nested(self.heat),
        }


def astray(match: Match) -> tuple[Mapping[str, Astray], ...]:
    """By ledger, of every probe of a match."""
    pairs = zip(match.problem.probes, match.twin.probes, strict=True)
    none = None if match.grid is None else 0.0
    bent = match.bent or (none,) * len(match.twin.probes)
    return tuple(_astray(*pair, one) for pair, one in zip(pairs, bent, strict=True))


def _astray(data: Probe, twin: Probe, bent: np.ndarray | float | None) -> Mapping[str, Astray]:
    """By ledger; ``bent`` as in ``Match``, None: it is not known."""
    fine = twin if bent is None else replace(twin, fit=replace(twin.fit, c=twin.fit.c + bent))
    rng, (seen, rough, own) = np.random.default_rng(0), map(_told, (data, twin, fine))
    noise = dict.fromkeys(UNITS, np.zeros(()))
    for _ in range(DRAWS):
        shaken = fine.disturbed(data.sampling.displaced(data.fit.draw(rng)), 1.0)
        for book, value in _told(fine, shaken).items():
            noise[book] = noise[book] + _square(value - own[book]) / DRAWS
    found = {}
    for book in UNITS:
        gap, grid = (_square(one[book] - own[book]) for one in (seen, rough))
        found[book] = _booked(data, book, gap, None if bent is None else grid, noise[book])
    return found


def _square(gap: np.ndarray) -> np.ndarray:
    return np.asarray(np.sum(gap**2, axis=-1))


def _told(probe: Probe, motion: Motion | None = None) -> dict[str, np.ndarray]:
    """Of every ledger in a motion, its own unless another is given, shape [times, points, components]."""
    motion = probe.motion if motion is None else motion
    return {"rollout": motion.x, "volume": motion.J[..., None]}


def _booked(
    probe: Probe, book: str, gap: np.ndarray, grid: np.ndarray | None, noise: np.ndarray
) -> Astray:
    """Of squares, shape [times, points]."""
    motion, chi, left = probe.motion.at(slice(0, 1)), probe.windows.chi, gap - noise
    weight, cell = motion.volume / motion.volume.sum(), cell_of(probe.body, motion.X)
    step = trapezoid(probe.windows.time)
    step /= step.sum()
    total = np.bincount(cell, weight * (step @ left), CELLS**3)
    count = np.bincount(cell, weight, CELLS**3)
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0.0)
    return Astray(
        name=probe.name,
        book=book,
        body=probe.body,
        time=probe.windows.ends.mean(axis=1),
        whole=float(_root(step @ left @ weight)),
        noise=float(_root(step @ noise @ weight)),
        grid=None if grid is None else float(_root(step @ grid @ weight)),
        windows=_root(chi @ left @ weight / chi.sum(axis=1)),
        heat=_root(mean).reshape((CELLS,) * 3),
    )


def _root(square: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(square, 0.0))
