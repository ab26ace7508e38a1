"""What a law answers to a deformation: stress, its slope, and what plastic flow leaves behind."""

from dataclasses import dataclass

import numpy as np

from form_drake.laws import Law, law_named
from form_drake.material import Material
from form_drake.motion.motion import inverse
from form_drake.weak.stress import elastic_part, unit_stresses

STEP = 1e-6  # of a deformation gradient, by which slopes are taken
PLAIN = "von-mises"  # stands in while nothing is known of a law but Poisson's ratio: Hencky's elasticity,
NEVER = 1e9  # since this is where it yields, in shear moduli; it resists being folded
_UNIT = np.eye(9).reshape(9, 3, 3)
_UPPER = [3 * i + j for i in range(3) for j in range(i, 3)]
STRETCHES = 0.5 * (_UNIT + _UNIT.swapaxes(1, 2))[_UPPER]  # six symmetric changes of shape
TURNS = 0.5 * (_UNIT - _UNIT.swapaxes(1, 2))[[1, 2, 5]]  # three turns
# shares of stretches and turns in each entry of a change
INTO = np.linalg.inv(np.concatenate([STRETCHES, TURNS]).reshape(9, 9).T)
POISSON = 0.4  # where that is not known either


@dataclass(frozen=True)
class Past:
    """What some points have gone through.

    Attributes:
        F: deformation gradients, shape [points, 3, 3].
        elastic: their elastic part, of the same shape.
    """

    F: np.ndarray
    elastic: np.ndarray

    @classmethod
    def none(cls, points: int) -> "Past":
        """Free of stress."""
        rest = np.tile(np.eye(3), (points, 1, 1))
        return cls(rest, rest)


@dataclass(frozen=True)
class Resistance:
    """A law with values, in units of its shear modulus.

    Attributes:
        law: the law.
        values: of all its parameters.
        weighs: whether the modulus is known, so that weight can be compared with it.
    """

    law: Law
    values: dict[str, float]
    weighs: bool

    @classmethod
    def plain(cls, nu: float | None = None) -> "Resistance":
        """Elasticity with Poisson's ratio ``nu`` and no known modulus."""
        nu = POISSON if nu is None else nu
        values = {"mu": 1.0, "lam": 2.0 * nu / (1.0 - 2.0 * nu), "tau_y": NEVER}
        return cls(law_named(PLAIN), values, False)

    @classmethod
    def of(cls, material: Material) -> "Resistance":
        """A material's.

        Raises:
            ValueError: as of ``stands``, or it does not resist being sheared or compressed at rest.
        """
        stands(material.law)
        if not min(material.law.moduli(material.values)) > 0.0:
            raise ValueError(_flows(material.law))
        return cls(material.law, dict(material.values), True)

    @property
    def modulus(self) -> float:
        """Shear modulus at rest [Pa]; 1 where it is not known."""
        return float(self.law.moduli(self.values)[1])

    def answer(self, F: np.ndarray, past: Past) -> tuple[np.ndarray, np.ndarray]:
        """Stress after a stride that begins where ``past`` ends.

        Args:
            F: deformation gradients, shape [points, 3, 3].
            past: of the same points.

        Returns:
            First Piola-Kirchhoff stress by the modulus, and the elastic part of F, both of shape [points, 3, 3].
        """
        P, elastic = self._pushed(F[None], past)
        return P[0], elastic[0]

    def slope(self, F: np.ndarray, past: Past) -> np.ndarray:
        """Derivative dP_ij / dF_kl of the stress of ``answer``, shape [points, 9, 9].

        Turns of the body turn the stress; only stretches are tried. A stride so long that flow is followed
        along it in parts has a slope that is right to some thousandths.
        """
        ways = np.concatenate([np.zeros((1, 3, 3)), STEP * STRETCHES])
        P, _ = self._pushed(F + ways[:, None] @ F, past)
        by_stretch = np.moveaxis((P[1:] - P[0]) / STEP, 0, -1)
        by_turn = np.einsum("nij,pjk->pikn", TURNS, P[0], optimize=True)
        by = np.concatenate([by_stretch, by_turn], axis=-1) @ INTO  # dP_ij / (dF F^-1)_km
        full = by.reshape(*P[0].shape, 3, 3) @ inverse(F).swapaxes(1, 2)[:, None, None]
        return np.asarray(full).reshape(len(F), 9, 9)

    def _pushed(self, ways: np.ndarray, past: Past) -> tuple[np.ndarray, np.ndarray]:
        """Stress and elastic part for several F of every point, shape [ways, points, 3, 3]."""
        flat, count = ways.reshape(-1, 3, 3), len(ways)
        elastic = flat
        if self.law.flow == "plastic":
            before = np.tile(past.elastic, (count, 1, 1))
            trial = flat @ np.tile(inverse(past.F), (count, 1, 1)) @ before
            radius = self.law.radius_vector(self.values)
            elastic = elastic_part(self.law, np.stack([before, trial]), radius)[1]
        T = unit_stresses(self.law, elastic, np.zeros_like(elastic), self.values)
        tau = np.tensordot(self.law.theta(self.values), T, axes=1) / self.modulus
        P = tau @ inverse(flat).swapaxes(1, 2)
        return P.reshape(ways.shape), elastic.reshape(ways.shape)


def stands(law: Law) -> None:
    """Refuse laws that flow at rest, as those of fluids and sand: their motion is no statics.

    Raises:
        ValueError: this is one.
    """
    if law.flow not in ("elastic", "plastic"):
        raise ValueError(_flows(law))


def _flows(law: Law) -> str:
    return (
        f"{law.name} does not resist shear at rest, so what is behind a surface does not follow from it:"
        " track points throughout the body"
    )
