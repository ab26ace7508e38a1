"""Bending fields of a strip that is held at one end and pushed sideways near the other."""

from dataclasses import dataclass

import numpy as np

from form_drake.motion import Frame
from form_drake.weak.fields import Sampled, smoothstep


@dataclass(frozen=True)
class BendFields:
    """Material fields psi(s) e_b - (X_b - o_b) psi'(s) e_a, with psi'' terms where volume counts.

    s runs along the strip's axis a from its free end; psi falls from 1 beyond the pushed part to 0
    before the held end, so that the pusher moves by e_b alone. With ``isochoric`` the field gains
    (X_b - o_b)^2 psi'' / 2 e_b and has no divergence in stress-free coordinates.

    Attributes:
        axis: a, along the strip.
        push: b, the direction of bending.
        origin: a point of the free end on the strip's axis [m], shape [3].
        length: of the strip between its ends [m].
        sign: +1 where the held end is the upper one along a.
        ramps: where psi leaves 1 and reaches 0, as shares of the length, shape [ramps, 2].
        tool: the pusher.
        isochoric: see above.
        breaks: as in ``Fields``.
    """

    axis: int
    push: int
    origin: np.ndarray
    length: float
    sign: int
    ramps: tuple[tuple[float, float], ...]
    tool: str
    isochoric: bool
    breaks: tuple[np.ndarray, ...]
    material: bool = True
    fixed: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"bend {'xyz'[self.push]} over {lo:g}-{hi:g}" for lo, hi in self.ramps)

    @property
    def tools(self) -> dict[str, np.ndarray]:
        end = np.zeros((len(self.ramps), 3))
        end[:, self.push] = 1.0
        return {self.tool: end}

    def at(self, frame: Frame) -> Sampled:
        X = frame.X
        a, b = self.axis, self.push
        y = X - self.origin
        s = self.sign * y[:, a] / self.length
        value = np.zeros((len(self.ramps), len(X), 3))
        gradient = np.zeros((*value.shape, 3))
        for n, (lo, hi) in enumerate(self.ramps):
            f, f1, f2, f3 = smoothstep((s - lo) / (hi - lo), 3)
            scale = self.sign / (self.length * (hi - lo))
            psi, p1, p2, p3 = 1.0 - f, -f1 * scale, -f2 * scale**2, -f3 * scale**3
            across = y[:, b]
            extra = 0.5 * across**2 if self.isochoric else np.zeros_like(across)
            value[n, :, b], value[n, :, a] = psi + extra * p2, -across * p1
            gradient[n, :, b, a] = p1 + extra * p3
            gradient[n, :, b, b] = across * p2 if self.isochoric else 0.0
            gradient[n, :, a, a], gradient[n, :, a, b] = -across * p2, -p1
        return Sampled(value, gradient)

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.ramps), dtype=bool)
