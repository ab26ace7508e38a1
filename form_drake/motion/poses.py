"""Poses of a rigid tool between the stamps of a log."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from form_drake.records import Stream


@dataclass(frozen=True)
class Poses:
    """Poses X_WT at any time: cubic splines through those that were logged, still before and after them.

    Attributes:
        stream: the log.
    """

    stream: Stream

    @cached_property
    def _place(self) -> BSpline:
        stamps, X = self.stream.time, self.stream.value
        return make_interp_spline(stamps, X[:, :3, 3], k=min(3, len(stamps) - 1))

    @cached_property
    def _turn(self) -> RotationSpline:
        return RotationSpline(self.stream.time, Rotation.from_matrix(self.stream.value[:, :3, :3]))

    def at(self, time: np.ndarray) -> np.ndarray:
        """Poses at some times on the clock of the log [s], shape [times, 4, 4]."""
        stamps, X = self.stream.time, self.stream.value
        if len(stamps) == 1:
            return np.repeat(X, len(time), axis=0)
        when = np.clip(time, stamps[0], stamps[-1])
        found = np.tile(np.eye(4), (len(when), 1, 1))
        found[:, :3, :3] = self._turn(when).as_matrix()
        found[:, :3, 3] = self._place(when)
        return found
