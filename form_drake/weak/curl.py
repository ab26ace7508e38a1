"""Fields without divergence that move with the body: every pressure cancels (eq. 5).

A material vector potential a(X) gives w = Curl a, which has no divergence along X. Its Piola
transform psi = F w / J has none along x, whatever the motion, and vanishes wherever w does. All of
it is exact where F is the gradient of the fitted motion, so that a pressure cancels to round-off.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from form_drake.motion import Body, Motion
from form_drake.motion.splines import Splines, Tensor
from form_drake.weak.fields import Sampled

DEGREE = 3


@dataclass(frozen=True)
class CurlFields:
    """Piola transforms of curls of B-splines N e_d over the reference box.

    Attributes:
        basis: of the potentials.
        used: splines that vanish with their slope on every face that is not free, shape [used].
        names: of the fields.
    """

    basis: Tensor
    used: np.ndarray = field(repr=False)
    names: tuple[str, ...] = field(repr=False)
    material: bool = True
    fixed: bool = False

    @classmethod
    def of(cls, body: Body) -> "CurlFields":
        """All fields that the faces of a body admit, three splines to an axis where they fit."""
        axes = []
        for a in range(3):
            held = sum(f.condition != "free" for f in body.faces if f.axis == a)
            axes.append(Splines.uniform(body.low[a], body.high[a], 1 + held, DEGREE))
        basis = Tensor((axes[0], axes[1], axes[2]))
        shape = tuple(s.size for s in axes)
        index = np.indices(shape).reshape(3, -1)
        keep = np.ones(basis.size, dtype=bool)
        for face in body.faces:
            if face.condition != "free":
                own = index[face.axis]
                keep &= own < shape[face.axis] - 2 if face.side else own >= 2
        used = np.flatnonzero(keep)
        names = tuple(
            f"curl of {'xyz'[d]} at {' '.join(str(i) for i in index[:, n])}"
            for n in used
            for d in range(3)
        )
        return cls(basis, used, names)

    @property
    def tools(self) -> tuple[str, ...]:
        return ()

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        return {}

    @property
    def breaks(self) -> tuple[np.ndarray, ...]:
        return tuple(a.breaks for a in self.basis.axes)

    @cached_property
    def _tables(self) -> dict[bytes, tuple[np.ndarray, np.ndarray]]:
        return {}

    def curls(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """w [fields, points, 3] and dw_a/dX_b [fields, points, 3, 3]; the last X is remembered."""
        key = X.tobytes()
        if key not in self._tables:
            slope = self.basis.gradient(X)[:, self.used].swapaxes(0, 1)
            curve = self.basis.hessian(X)[:, self.used].swapaxes(0, 1)
            n, q = slope.shape[:2]
            w, dw = np.zeros((n, 3, q, 3)), np.zeros((n, 3, q, 3, 3))
            for d in range(3):  # Curl(N e_d) = grad N x e_d
                a, b = (d + 1) % 3, (d + 2) % 3
                w[:, d, :, a], w[:, d, :, b] = slope[..., b], -slope[..., a]
                dw[:, d, :, a], dw[:, d, :, b] = curve[:, :, b], -curve[:, :, a]
            self._tables.clear()
            self._tables[key] = w.reshape(3 * n, q, 3), dw.reshape(3 * n, q, 3, 3)
        return self._tables[key]

    def at(self, motion: Motion) -> Sampled:
        second, F, J = motion.second, motion.F, motion.J[:, None, :, None]
        assert second is not None
        w, dw = self.curls(motion.X)
        value = np.einsum("tqia,fqa->tfqi", F, w, optimize=True) / J
        # d log J / dX_c = F^-1_ki d F_ik / dX_c
        growth = np.einsum("tqki,tqikc->tqc", motion.inverse, second, optimize=True)
        gradient = np.einsum("tqiac,fqa->tfqic", second, w, optimize=True)
        gradient += np.einsum("tqia,fqac->tfqic", F, dw, optimize=True)
        gradient = gradient / J[..., None] - value[..., None] * growth[:, None, :, None]
        swell = np.trace(motion.L, axis1=2, axis2=3)[..., None, None] * np.eye(3)
        rate = ((motion.L - swell)[:, None] @ value[..., None])[..., 0]
        return Sampled(value, gradient, rate)

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        return np.ones(len(self.names), dtype=bool)
