"""Spatial integrals of the momentum balance along a motion, and how noise in the motion moves them.

For every test field psi and time t

    stress_k = sum_p V T_k : grad psi        load = sum_p m (g + body force) . psi + V J p div psi
    momentum = sum_p m v . psi               carried = sum_p m v . (d psi / dt along the motion)

so that with a window chi the balance reads (eq. 9 of the paper)

    sum_k theta_k int chi stress_k dt
        = int chi (load + carried) + chi' momentum dt + int chi (force on the body) . psi dt.

V is the reference volume and T_k a Kirchhoff stress; material fields pair with the first Piola
stress T_k F^-T, so that their integrals are one matrix product over all times. All but the stress
integrals are the same for every law, and are found once.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from form_drake.laws import Law, Values
from form_drake.motion import Motion
from form_drake.weak.contact import HeldFields
from form_drake.weak.curl import CurlFields
from form_drake.weak.fields import Fields
from form_drake.weak.integrals import Balance, Curled, Fixed, Held, Moving
from form_drake.weak.stress import gathered, unit_stresses


def balance(fields: Fields, motion: Motion, gravity: np.ndarray) -> Balance:
    """Integrals of ``fields`` along a motion under ``gravity`` [m/s^2], shape [3]."""
    if isinstance(fields, CurlFields):
        return Curled(fields, motion, gravity)
    if isinstance(fields, HeldFields):
        return Held(fields, motion, gravity)
    return (Fixed if fields.fixed else Moving)(fields, motion, gravity)


@dataclass(frozen=True)
class Along:
    """All families of test fields along one motion.

    Attributes:
        families: integrals of each.
    """

    families: tuple[Balance, ...]

    @property
    def motion(self) -> Motion:
        return self.families[0].motion

    @cached_property
    def _last(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        return {}

    def stress(self, T: np.ndarray, chi: np.ndarray) -> np.ndarray:
        """As ``Balance.stress``; a search that leaves a term as it was costs nothing for it."""
        for k, Tk in enumerate(T):
            if k not in self._last or not np.array_equal(self._last[k][0], Tk):
                work = [f.stress(Tk, chi) for f in self.families]
                self._last[k] = Tk, np.concatenate(work, axis=1)
        return np.stack([self._last[k][1] for k in range(len(T))])

    def work(self, law: Law, F: np.ndarray, values: Values, chi: np.ndarray) -> np.ndarray:
        """Integrals of the stress of every term of a law, shape [terms, windows, fields].

        Args:
            law: the law.
            F: elastic deformation gradients, shape [times, points, 3, 3].
            values: constants of the law.
            chi: the windows [s], shape [windows, times].
        """
        motion, fixed = self.motion, [f for f in self.families if isinstance(f, Fixed)]
        if len(fixed) < len(self.families):
            return self.stress(unit_stresses(law, F, motion.L, values, motion.pressure), chi)
        met = gathered(law, F, motion, values, chi)
        return np.concatenate([f.paired(met) for f in fixed], axis=2)
