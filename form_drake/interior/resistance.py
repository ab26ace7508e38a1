"""What a law answers to a deformation: stress, its slope, and what plastic flow leaves behind."""

from dataclasses import dataclass

import numpy as np

from form_drake.laws import Law, law_named
from form_drake.material import Material
from form_drake.weak.tangent import stride

PLAIN = "von-mises"  # stands in while nothing is known of a law but Poisson's ratio: Hencky's elasticity,
NEVER = 1e9  # since this is where it yields, in shear moduli; it resists being folded
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
        P, elastic, _ = stride(self.law, F, past.F, past.elastic, self.values, self._theta)
        return P, elastic

    def slope(self, F: np.ndarray, past: Past) -> np.ndarray:
        """Derivative dP_ij / dF_kl of the stress of ``answer``, shape [points, 9, 9].

        A stride so long that flow is followed along it in parts has a slope that is right to some
        thousandths.
        """
        given = F, past.F, past.elastic
        found = stride(self.law, *given, self.values, self._theta, slopes=True)[2]
        assert found is not None
        return found

    @property
    def _theta(self) -> np.ndarray:
        """Coefficients of the law's terms by the modulus."""
        return np.asarray(self.law.theta(self.values)) / self.modulus


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
