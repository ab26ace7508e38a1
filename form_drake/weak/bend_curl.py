"""Bending fields without divergence, fixed in space: those of a strip that turns little.

With q the coordinate of bending from the middle of the strip and z that along it, the curl of
g(z) + q^2 g''(z) / 2, integrated once along z, about the third axis is

    w = (g + q^2 g'' / 2) e_q - q g' e_z,   g = 1 at the free end, 0 at the held one.

Any pressure does no work on it, so that neither a bulk modulus nor what tracks tell of the change of
volume is needed. Unlike ``BendFields`` it also hears shear, and stretch once the strip has turned.
"""

from dataclasses import dataclass

import numpy as np

from form_drake.motion import Motion
from form_drake.weak.bend import Strip
from form_drake.weak.fields import Sampled


@dataclass(frozen=True)
class BendCurlFields(Strip):
    """Fields as above, one for each ramp over which g falls."""

    material: bool = False
    fixed: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"bend-curl {'xyz'[self.push]} over {lo:g}-{hi:g}" for lo, hi in self.ramps)

    def at(self, motion: Motion) -> Sampled:
        at, q = motion.x[..., self.axis], motion.x[..., self.push] - self.middle
        shape = (len(at), len(self.ramps), at.shape[1])
        value, gradient = np.zeros((*shape, 3)), np.zeros((*shape, 3, 3))
        z, x = self.axis, self.push
        for n, ramp in enumerate(self.ramps):
            step, *slopes = self.risen(at, ramp, 3)
            g1, g2, g3 = (-f for f in slopes)
            value[:, n, :, x] = 1.0 - step + 0.5 * q**2 * g2
            value[:, n, :, z] = -q * g1
            gradient[:, n, :, x, x] = q * g2
            gradient[:, n, :, x, z] = g1 + 0.5 * q**2 * g3
            gradient[:, n, :, z, x] = -g1
            gradient[:, n, :, z, z] = -q * g2
        return Sampled(value, gradient)

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        end = np.zeros((len(motion.time), len(self.ramps), 3))
        end[:, :, self.push] = 1.0
        return {self.tool: end}
