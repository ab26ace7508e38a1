"""Where and when a twin leaves something over: rows by ledger, place in the body and moment.

Rows whose field carries a measured force are the tool's ledger, those that tell how far held faces have
gone that of kinematics, forces that tools should not feel that of contact, all others that of the interior.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import chdtri

from form_drake.diagnose.match import Match
from form_drake.motion import Body
from form_drake.weak.contact import HeldFields, OpenFields
from form_drake.weak.probe import Probe
from form_drake.weak.solve import Weights

BOOKS = ("interior", "tool", "contact", "kinematics")
ASIDE = {OpenFields: "contact", HeldFields: "kinematics"}  # rows beside the balance
CELLS = 6  # of the body along each axis
RARE = 1e-3  # chance that noise alone reaches the limit of a window


@dataclass(frozen=True)
class Ledger:
    """What is left of one probe.

    Attributes:
        name: of the probe.
        body: the specimen.
        time: middles of the windows, from the first frame on [s], shape [windows].
        square: of what is left, one on average where that is noise, shape [rows].
        window: of every row, shape [rows].
        field: of every row, shape [rows].
        book: the ledger of every row, one of ``BOOKS``, shape [rows].
        share: of every field's weight in every cell of the body, shape [fields, cells, cells, cells].
    """

    name: str
    body: Body
    time: np.ndarray
    square: np.ndarray
    window: np.ndarray
    field: np.ndarray
    book: np.ndarray
    share: np.ndarray

    @property
    def spent(self) -> np.ndarray:
        """Sums of squares of every window, shape [windows]."""
        return np.bincount(self.window, self.square, len(self.time))

    @property
    def limit(self) -> np.ndarray:
        """What noise alone exceeds in one of a thousand windows, shape [windows]."""
        rows = np.bincount(self.window, minlength=len(self.time))
        return np.asarray(np.where(rows > 0, chdtri(np.maximum(rows, 1), RARE), np.inf))

    @property
    def onset(self) -> float | None:
        """Middle of the first of two windows running that exceed the limit [s]; None: there are none."""
        above = self.spent > self.limit
        first = np.flatnonzero(above[:-1] & above[1:])
        return float(self.time[first[0]]) if len(first) else None

    def mean(self, book: str) -> float | None:
        """Mean square of one ledger; None: it has no rows."""
        rows = self.book == book
        return float(self.square[rows].mean()) if rows.any() else None

    def of(self, book: str) -> "Ledger":
        """One ledger alone."""
        own = self.book == book
        square, window, field = self.square[own], self.window[own], self.field[own]
        return replace(self, square=square, window=window, field=field, book=self.book[own])

    @property
    def means(self) -> list[float | None]:
        """Mean squares of windows; None: no row is there."""
        rows = np.bincount(self.window, minlength=len(self.time))
        return [float(s / n) if n else None for s, n in zip(self.spent, rows, strict=True)]

    @property
    def heat(self) -> np.ndarray:
        """Squares less one, averaged over the rows that see a cell, shape [cells, cells, cells].

        Not a number where no row sees.
        """
        count = len(self.share)
        excess = np.bincount(self.field, self.square - 1.0, count)
        seen = np.tensordot(np.bincount(self.field, minlength=count), self.share, axes=1)
        heat: np.ndarray = np.tensordot(excess, self.share, axes=1)
        return np.divide(heat, seen, out=np.full(heat.shape, np.nan), where=seen > 0.0)

    def to_json(self) -> dict[str, Any]:
        """Mean squares, one on average where noise is left: of ledgers, of windows, and in cells less one,
        of all and of each ledger.

        Times are in s from the first frame on, cells are nested along x, y and z; None: no row is there.
        """
        parts = {book: self.of(book) for book in BOOKS if book in self.book}
        return {
            "probe": self.name,
            **{book: self.mean(book) for book in BOOKS},
            "onset": self.onset,
            "time": self.time.tolist(),
            "windows": self.means,
            "cells": nested(self.heat),
            "books": {
                book: {"onset": own.onset, "windows": own.means, "cells": nested(own.heat)}
                for book, own in parts.items()
            },
        }


def cell_of(body: Body, X: np.ndarray) -> np.ndarray:
    """Cells in which points are that are free of stress at X [m], x outermost, shape [points]."""
    place = np.floor(CELLS * (X - body.low) / (body.high - body.low)).astype(int)
    i, j, k = np.clip(place, 0, CELLS - 1).T
    found: np.ndarray = (i * CELLS + j) * CELLS + k
    return found


def nested(heat: np.ndarray) -> Any:
    """Numbers of cells as lists along x, y and z; None: there is none."""
    found = heat.astype(object)
    found[~np.isfinite(heat)] = None
    return found.tolist()


def ledgers(match: Match) -> tuple[Ledger, ...]:
    """Those of every probe of a match."""
    ends = np.cumsum([0, *map(len, match.by.factors)])
    parts = [match.left[a:z] for a, z in pairwise(ends)]
    rows = zip(match.twin.probes, parts, strict=True)
    return tuple(_ledger(probe, match.by.of(n), left) for n, (probe, left) in enumerate(rows))


def _ledger(probe: Probe, by: Weights, left: np.ndarray) -> Ledger:
    share, book = _weights(probe)
    window, field = np.divmod(np.flatnonzero(probe.keep), len(share))
    square, raw = np.empty(len(left)), by.coloured(left)
    for n in np.unique(window):
        own = window == n
        square[own] = _apart(by.covariance(own), raw[own]) ** 2
    time = probe.windows.ends.mean(axis=1)
    return Ledger(probe.name, probe.body, time, square, window, field, book[field], share)


def _apart(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows whitened so that each is as near as can be to its own row, shape [rows].

    Each window by itself: with the rows before it known, what stays would seem to fade, since noise
    of smooth tracks lasts. And not by a Cholesky factor, which gives what rows share to the first.

    Args:
        covariance: of the rows of a window, shape [rows, rows].
        rows: shape [rows].
    """
    scale = np.sqrt(np.diag(covariance))
    size, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    found: np.ndarray = axes @ ((axes.T @ (rows / scale)) / np.sqrt(np.maximum(size, 1e-300)))
    return found


def _weights(probe: Probe) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the fields' sizes in the cells, and the ledger of every field."""
    motion, body = probe.motion.at(slice(0, 1)), probe.body
    cell, shares, books = cell_of(body, motion.X), [], []
    for family in probe.fields:
        size = np.linalg.norm(family.at(motion).value[0], axis=-1)
        if not isinstance(family, HeldFields):
            size *= motion.volume
        total = np.stack([np.bincount(cell, one, CELLS**3) for one in size])
        shares.append(total / np.maximum(total.sum(axis=1, keepdims=True), 1e-300))
        ends = (np.abs(e).sum(axis=(0, 2)) for e in family.acting(motion).values())
        carries = sum(ends, np.zeros(len(size))) > 0.0
        own = np.where(carries, "tool", "interior")
        aside = ASIDE.get(type(family))
        books.append(own if aside is None else np.full(len(own), aside))
    share = np.concatenate(shares).reshape(-1, CELLS, CELLS, CELLS)
    return share, np.concatenate(books)
