"""The layer of particles that is tied to a plane: what nodes cannot tell of it.

Depths of tied particles add up to the force that holds them. Depths that differ from particle to particle
within a cell move no node: nothing answers them, and they would add up without end. So what a layer has
added up tends to its share that nodes tell.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

RATE = 200.0  # [1/s]


@dataclass(frozen=True)
class Layer:
    """Tied particles.

    Attributes:
        tied: their indices.
        mean: values of nodes in the plane from those of particles, shape [nodes, tied].
        at: values at particles from those of nodes, quadratic splines, shape [tied, nodes].
    """

    tied: np.ndarray
    mean: csr_array
    at: csr_array

    @classmethod
    def of(cls, tied: np.ndarray, place: np.ndarray, dx: float) -> "Layer":
        """Particles with these places in the plane [m], shape [tied, 2], among nodes ``dx`` [m] apart."""
        u = (place - place.min(axis=0, initial=np.inf)) / dx + 1.0
        first = np.floor(u - 0.5).astype(int)
        s = u - first
        share = np.stack([0.5 * (1.5 - s) ** 2, 0.75 - (s - 1.0) ** 2, 0.5 * (s - 0.5) ** 2])
        width = int(first.max(initial=0)) + 3
        rows = np.repeat(np.arange(len(u)), 9)
        nodes = [(first[:, 0] + a) * width + first[:, 1] + b for a in range(3) for b in range(3)]
        shares = [share[a, :, 0] * share[b, :, 1] for a in range(3) for b in range(3)]
        entries = np.stack(shares, axis=1).ravel(), (rows, np.stack(nodes, axis=1).ravel())
        at = csr_array(entries, shape=(len(u), width * width))
        whole = np.maximum(at.sum(axis=0), 1e-12)
        return cls(tied, csr_array((at / whole).T), at)

    def told(self, values: np.ndarray, duration: float) -> np.ndarray:
        """Values of the particles [tied, 3] a time [s] later."""
        part = 1.0 - np.exp(-RATE * duration)
        found: np.ndarray = values + part * (self.at @ (self.mean @ values) - values)
        return found
