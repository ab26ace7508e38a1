"""Fields of a press, a pull or a stretch between two faces, without divergence."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from form_drake.motion import Motion
from form_drake.weak.fields import Sampled


def smoothstep(s: np.ndarray, derivatives: int = 2) -> tuple[np.ndarray, ...]:
    """Quintic from 0 to 1 over s in [0, 1], with its first derivatives."""
    s = np.clip(s, 0.0, 1.0)
    square, left = s * s, 1.0 - s
    found = [s * square * (10.0 - 15.0 * s + 6.0 * square)]
    if derivatives > 0:
        found.append(30.0 * square * left**2)
    if derivatives > 1:
        found.append(60.0 * s * left * (1.0 - 2.0 * s))
    if derivatives > 2:
        inside = (s > 0.0) & (s < 1.0)
        found.append(60.0 * (1.0 - 6.0 * s + 6.0 * square) * inside)
    return tuple(found)


@dataclass(frozen=True)
class AxialFields:
    """Divergence-free fields f(s) e_a - f'(s) (x_l - o_l) e_l: press, pull and stretch.

    Each moves the loaded end along axis a and lets the body contract along the lateral axis l,
    whose faces are free. f rises from 0 to 1 between ``ramps`` of the length that the body has
    along a at the time. With sticking ends the ramps end inside the body.

    Attributes:
        axis: the loaded axis a.
        origin: a point of the body's axis [m], shape [3].
        time: at which the next two are given [s], shape [times].
        start: coordinate of the support face along the axis [m], shape [times].
        length: of the body along the axis [m], shape [times].
        lateral: share of the contraction along every axis, shape [laterals, 3], each summing to 1.
        ramps: where f starts and ends as shares of ``length``, shape [ramps, 2].
        sign: +1 where the loaded face is the upper one, -1 else.
        tool: the tool on the loaded face.
        breaks: as in ``Fields``.
        names: of the fields.
    """

    axis: int
    origin: np.ndarray
    time: np.ndarray
    start: np.ndarray
    length: np.ndarray
    lateral: np.ndarray
    ramps: tuple[tuple[float, float], ...]
    sign: int
    tool: str
    breaks: tuple[np.ndarray, ...]
    material: bool = False
    fixed: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(
            f"{'xyz'[self.axis]} over {lo:g}-{hi:g}, contracting {_axes(share)}"
            for share in self.lateral
            for lo, hi in self.ramps
        )

    @property
    def tools(self) -> tuple[str, ...]:
        return (self.tool,)

    def even(self, axis: int, middle: float, near: float) -> bool:
        return axis != self.axis and abs(float(self.origin[axis]) - middle) <= near

    def exchanged(self, a: int, b: int) -> bool:
        return self.axis not in (a, b) and bool(np.all(self.lateral[:, a] == self.lateral[:, b]))

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        end = np.zeros((len(motion.time), len(self.names), 3))
        end[:, :, self.axis] = 1.0
        return {self.tool: end}

    @cached_property
    def _ends(self) -> tuple[CubicSpline, CubicSpline]:
        """Start and length over time, and their rates."""
        spline = CubicSpline(self.time, np.stack([self.start, self.length], axis=-1))
        return spline, spline.derivative()

    def at(self, motion: Motion) -> Sampled:
        y = motion.x - self.origin
        ends, rates = (f(motion.time)[:, :, None] for f in self._ends)
        (start, length), (drift, growth) = ends.swapaxes(0, 1), rates.swapaxes(0, 1)
        s = self.sign * (motion.x[..., self.axis] - start) / length
        shape = (len(s), len(self.lateral), len(self.ramps), y.shape[1])
        value, rate, gradient = (np.zeros((*shape, *ends)) for ends in ((3,), (3,), (3, 3)))
        for n, (lo, hi) in enumerate(self.ramps):
            f, f1, f2 = smoothstep((s - lo) / (hi - lo))
            scale = self.sign / (length * (hi - lo))
            # d/dt of the ramp's argument at fixed x
            late = -(growth * s + self.sign * drift) / (length * (hi - lo))
            later = (f2 * late - f1 * growth / length) * scale
            ours = (slice(None), slice(None), n, slice(None))
            value[ours][..., self.axis] = f[:, None]
            rate[ours][..., self.axis] = (f1 * late)[:, None]
            f1, f2 = f1 * scale, f2 * scale**2
            gradient[ours][..., self.axis, self.axis] = f1[:, None]
            for k, share in enumerate(self.lateral):
                for a in np.flatnonzero(share):
                    value[:, k, n, :, a] = -share[a] * f1 * y[..., a]
                    rate[:, k, n, :, a] = -share[a] * later * y[..., a]
                    gradient[:, k, n, :, a, a] = -share[a] * f1
                    gradient[:, k, n, :, a, self.axis] = -share[a] * f2 * y[..., a]
        flat = (len(s), len(self.names), y.shape[1])
        return Sampled(
            value.reshape(*flat, 3), gradient.reshape(*flat, 3, 3), rate.reshape(*flat, 3)
        )

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.names), dtype=bool)


def _axes(share: np.ndarray) -> str:
    return " and ".join("xyz"[a] for a in np.flatnonzero(share))
