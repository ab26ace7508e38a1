"""A weak system: rows of the momentum balance, linear in the coefficients of a law."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """Where a row of a weak system comes from."""

    window: tuple[float, float]
    field: str
    probe: str = ""


@dataclass(frozen=True)
class WeakSystem:
    """A theta = b; ``+`` stacks probes and specimens.

    Attributes:
        A: one column for each term, shape [rows, terms] [N m s per unit].
        b: shape [rows] [N m s].
        scale: size of the stress integral of each row, cancellation apart [N m s], shape [rows].
        sizes: the same for each column, shape [rows, terms].
        rows: labels.
    """

    A: np.ndarray
    b: np.ndarray
    scale: np.ndarray
    sizes: np.ndarray
    rows: tuple[Row, ...]

    def __add__(self, other: "WeakSystem") -> "WeakSystem":
        if self.A.shape[1] != other.A.shape[1]:
            raise ValueError(
                f"weak systems of {self.A.shape[1]} and {other.A.shape[1]} terms do not stack"
            )
        return WeakSystem(
            np.vstack([self.A, other.A]),
            np.append(self.b, other.b),
            np.append(self.scale, other.scale),
            np.vstack([self.sizes, other.sizes]),
            self.rows + other.rows,
        )


def stacked(systems: Sequence[WeakSystem]) -> WeakSystem:
    """All systems as one."""
    total = systems[0]
    for system in systems[1:]:
        total = total + system
    return total
