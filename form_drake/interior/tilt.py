"""What tools that turn add to a motion that is mirrored.

A tool that turns a little presses one side of a body more than the other. Where one of two mirrored faces is
seen, that is not the mean of both. To first order, what is added is odd along the mirrored axis, and the slope
of the law's forces on the mirrored motion tells it from the turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from form_drake.interior.faces import POINTS, Hold
from form_drake.interior.statics import EXACT, Held, Statics, slopes, values
from form_drake.interior.surface import Seen
from form_drake.motion.space import Space, Symmetry
from form_drake.motion.splines import Splines, Tensor

CELLS, DEGREE = 2, 3  # along each axis
TURNED = 1e-9  # [m] by which a turn may move a face unnoticed
FLOATS = 1e-5  # of the stiffness, that keeps from drifting away what nothing holds
# of the stiffness at rest, that is always left: flow under pressure has none or less than none, and what is
# added to that would be whatever rounding makes it
SOFT = 0.1


@dataclass(frozen=True)
class Odd:
    """Fields odd along one axis, on a motion that is mirrored along it.

    Attributes:
        statics: of that motion.
        axis: along which it is mirrored.
        holds: of its faces.
        friction: under bonded ones; infinite: they stick.
    """

    statics: Statics
    axis: int
    holds: tuple[Hold, ...]
    friction: float

    @cached_property
    def space(self) -> Space:
        """A few functions: what a turn adds is smooth."""
        body, mirrors = self.statics.body, self.statics.space.symmetry.mirrors
        a, b, c = (
            Splines.graded(low, high, CELLS, DEGREE, (False, False))
            for low, high in zip(body.low, body.high, strict=True)
        )
        return Space(Tensor((a, b, c)), Symmetry(mirrors, odd=(self.axis,)), joined=True)

    @cached_property
    def _slopes(self) -> np.ndarray:
        """dF / dy at the points of ``Statics.unfolded``, shape [points, 9, size]."""
        return slopes(self.space, self.statics.unfolded)

    def stiffness(self, frame: Held, last: Held) -> np.ndarray:
        """Slope of the law's forces in ``frame`` after ``last`` [1/m^2], nowhere too soft, shape [size, size]."""
        root = self._rest
        half = solve_triangular(root, self._slope(frame, last), lower=True)
        share, turn = np.linalg.eigh(solve_triangular(root, half.T, lower=True))
        back = root @ turn
        return np.asarray((back * np.maximum(share, SOFT)) @ back.T)

    def _slope(self, frame: Held, last: Held) -> np.ndarray:
        size = self.space.size
        stiff, flat = self.statics.stiff(frame.y, last.past), self._slopes.reshape(-1, size)
        slope = flat.T @ (stiff @ self._slopes).reshape(-1, size)
        return np.asarray(0.5 * (slope + slope.T))

    @cached_property
    def _rest(self) -> np.ndarray:
        """Cholesky factor of the slope at rest, and a little more."""
        rest = self.statics.rest
        slope = self._slope(rest, rest)
        floats = FLOATS * np.trace(slope) / len(slope)
        return np.linalg.cholesky(slope + floats * np.eye(len(slope)))

    @cached_property
    def _grips(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of every hold, rows of what it holds, and where its turns bring that [m], [frames, rows]."""
        found = []
        for hold in self.holds:
            sticks = hold.face.condition == "bonded" and np.isinf(self.friction)
            axes = [0, 1, 2] if sticks else [hold.face.axis]
            D = values(self.space, self.statics.body.face_points(hold.face, POINTS))[:, axes]
            turned = hold.turned[..., axes]
            found.append((D.reshape(-1, D.shape[-1]), turned.reshape(len(turned), -1)))
        return found

    def added(self, frames: Sequence[Held]) -> np.ndarray:
        """Coefficients of what turns have added until each frame [m], shape [frames, size].

        A tool that lets go takes back what the law does not keep; one that comes again turns from where it
        finds the face.
        """
        y, left = np.zeros((len(frames), self.space.size)), np.zeros(self.space.size)
        begun = [-turned[0] for _, turned in self._grips]
        for n in range(1, len(frames)):
            slope = self.stiffness(frames[n], frames[n - 1])
            K, right = slope.copy(), -left
            for k, ((D, turned), hold) in enumerate(zip(self._grips, self.holds, strict=True)):
                if not hold.presses[n]:
                    continue
                if not hold.presses[n - 1]:
                    begun[k] = D @ y[n - 1] - turned[n - 1]
                K += D.T @ D / EXACT**2
                right += D.T @ (begun[k] + turned[n] - D @ y[n - 1]) / EXACT**2
            step = np.linalg.solve(K, right)
            left = left + slope @ step
            y[n] = y[n - 1] + step
        return y


def level(seen: Seen, statics: Statics, frames: Sequence[Held], friction: float) -> Seen:
    """What would be seen if no tool had turned.

    Args:
        seen: what is seen.
        statics: of the body, all whose faces are held evenly.
        frames: its motion, as far as it is known.
        friction: as of ``Odd``.
    """
    if not any(np.abs(hold.turned).max() > TURNED for hold in seen.holds):
        return seen
    u = seen.u
    for axis in seen.one_sided:
        odd = Odd(statics, axis, seen.holds, friction)
        u = u - np.einsum(
            "pin,fn->fpi", values(odd.space, seen.X), odd.added(frames), optimize=True
        )
    return replace(seen, u=u)
