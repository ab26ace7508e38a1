"""Bending fields of a strip that is held at one end and pushed sideways near the other.

Every cross-section is turned rigidly by beta(s) about its own centre x_c as it stands now, and the
centres move so that the centre line is neither stretched nor sheared,

    w = a + beta n x (x - x_c),   da/dX_a = beta n x dx_c/dX_a,   a = 0 at the held end.

Then P : grad w = beta' [n x (x - x_c)] . P e_a: bending moments alone do work, however far the
strip has turned, since P F^T is symmetric; shear and stretch, which tracks tell poorly, cancel.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from form_drake.motion import Motion
from form_drake.weak.axial import smoothstep
from form_drake.weak.fields import Sampled


@dataclass(frozen=True)
class Strip:
    """A strip that a tool bends, and the ramps of its test fields.

    Attributes:
        axis: a, along the strip.
        push: the direction of bending.
        middle: coordinate of the strip's middle along ``push`` [m].
        held: coordinate of the held end along the axis [m].
        length: of the strip between its ends [m].
        sign: +1 where the held end is the upper one.
        ramps: where fields begin and end to turn, from the free end on, as shares of the length.
        tool: the pusher, which acts before every ramp and so sees one translation.
        breaks: as in ``Fields``.
    """

    axis: int
    push: int
    middle: float
    held: float
    length: float
    sign: int
    ramps: tuple[tuple[float, float], ...]
    tool: str
    breaks: tuple[np.ndarray, ...]

    @property
    def tools(self) -> tuple[str, ...]:
        return (self.tool,)

    def even(self, axis: int, middle: float, near: float) -> bool:
        return axis == 3 - self.axis - self.push  # wherever the middle

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.ramps), dtype=bool)

    def risen(
        self, at: np.ndarray, ramp: tuple[float, float], derivatives: int
    ) -> tuple[np.ndarray, ...]:
        """A step over a ramp at coordinates along the axis [m], and its first derivatives along it."""
        lo, hi = ramp
        s = 1.0 + self.sign * (at - self.held) / self.length
        scale = self.sign / (self.length * (hi - lo))
        found = smoothstep((s - lo) / (hi - lo), derivatives)
        return tuple(f * scale**n for n, f in enumerate(found))


@dataclass(frozen=True)
class BendFields(Strip):
    """Fields as above, one for each ramp in which beta is not zero."""

    material: bool = True
    fixed: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"bend {'xyz'[self.push]} over {lo:g}-{hi:g}" for lo, hi in self.ramps)

    @property
    def normal(self) -> np.ndarray:
        """Axis of the rotations."""
        return np.cross(np.eye(3)[self.axis], np.eye(3)[self.push])

    def _turns(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """beta [1/m] and its derivative along the axis, shape [ramps, points]."""
        steps = [self.risen(at, ramp, 2) for ramp in self.ramps]
        beta, slope = (np.array([f[n] for f in steps]) for n in (1, 2))
        return self.sign * beta, self.sign * slope

    @cached_property
    def _last(self) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
        return {}

    def _integrals(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of int beta f from the held end to every section, and to before the ramps.

        Args:
            at: coordinates of the sections [m], shape [sections]; the last are remembered.

        Returns:
            shapes [ramps, sections, sections] and [ramps, 1, sections].
        """
        key = at.tobytes()
        if key not in self._last:
            beta, _ = self._turns(at)
            found = CubicSpline(at, np.eye(len(at))).antiderivative()
            free = self.held - self.sign * self.length
            start = found(np.clip([self.held], at[0], at[-1]))
            whole = found(np.clip([free], at[0], at[-1])) - start
            self._last.clear()
            self._last[key] = (found(at) - start) * beta[:, None], whole * beta[:, None]
        return self._last[key]

    def _means(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates of the sections [m], that of every point, and the mean over each."""
        at, index = np.unique(np.round(X[:, self.axis], 12), return_inverse=True)
        own = index == np.arange(len(at))[:, None]
        return at, index, own / own.sum(axis=1)[:, None]

    def at(self, motion: Motion) -> Sampled:
        at, index, mean = self._means(motion.X)
        beta, slope = (t[..., None] for t in self._turns(motion.X[:, self.axis]))
        turn = np.cross(self.normal, np.eye(3))  # v @ turn = normal x v
        along = motion.F[..., self.axis]
        stretched = (motion.L @ along[..., None])[..., 0]
        weights, _ = self._integrals(at)
        shift, drift = (weights @ (mean @ v @ turn)[:, None] for v in (along, stretched))
        arm, spin = ((v - (mean @ v)[:, index]) @ turn for v in (motion.x, motion.v))
        arm, spin = arm[:, None], spin[:, None]
        gradient = beta[..., None] * (turn.T @ motion.F)[:, None]
        gradient[..., self.axis] += slope * arm
        return Sampled(shift[:, :, index] + beta * arm, gradient, drift[:, :, index] + beta * spin)

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        at, _, mean = self._means(motion.X)
        slope = np.cross(self.normal, mean @ motion.F[..., self.axis])
        return {self.tool: (self._integrals(at)[1] @ slope[:, None])[:, :, 0]}
