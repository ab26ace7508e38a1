"""Columns that were simulated beside one twin and serve others nearby: a search makes most once."""

from dataclasses import dataclass, field

import numpy as np

from form_drake.diagnose.model import Cause

GROWN = 0.3  # of its size, and
MOVED = 0.5  # of the widths of its shape parameters, by which a cause is another


@dataclass(frozen=True)
class Kept:
    """What was made on the way.

    Attributes:
        own: columns of the law beside effects that bend them, shape [rows, unknowns]; None: they are made.
        acting: causes that act as a whole as they were when their columns were made, and these.
    """

    own: np.ndarray | None = field(default=None, repr=False)
    acting: tuple[tuple[Cause, np.ndarray], ...] = field(default=(), repr=False)

    def of(self, cause: Cause) -> tuple[Cause, np.ndarray] | None:
        """Those of one that is much the same; None: they are made."""
        same = (one for one in self.acting if one[0].effect is cause.effect)
        return next((one for one in same if _near(one[0], cause)), None)


def _near(made: Cause, now: Cause) -> bool:
    size, *turns = np.abs(made.towards(now))
    return bool(size <= GROWN * abs(made.coefficient) and np.all(turns <= MOVED * made.widths))
