"""How long the steps of a simulation may be."""

import math
from collections.abc import Sequence

import numpy as np

from form_drake.laws import Law, Values
from form_drake.mpm.model import CFL, Body, stable_dt
from form_drake.records.solver import Solver

STEPS = 20  # for which a step stays stable while gravity acts


class Pace:
    """The time step that all bodies allow.

    Args:
        solver: grid and gravity.
        laws: of the bodies.
        bodies: that share the grid.
        lagging: see ``stable_dt``.
        cfl: see ``stable_dt``.
    """

    def __init__(
        self,
        solver: Solver,
        laws: Sequence[Law],
        bodies: Sequence[Body],
        *,
        lagging: bool,
        cfl: float = CFL,
    ):
        self._dx, self._lagging, self._cfl = solver.dx, lagging, cfl
        self._g = float(np.linalg.norm(solver.gravity))
        self._laws = tuple(laws)
        self._densities = [float(np.min(body.density)) for body in bodies]
        self._values: list[Values | None] = [None] * len(bodies)
        self._found: dict[tuple[float, float], float] = {}  # the last one, by speed and share

    @property
    def known(self) -> bool:
        """Whether every body has a material."""
        return None not in self._values

    def set_material(self, values: Values, body: int) -> None:
        """Give every parameter of a body's law a value (SI units)."""
        self._values[body], self._found = dict(values), {}

    @property
    def elastic(self) -> float:
        """The longest step at rest [s] if nothing were viscous; every body has a material."""
        parts = zip(self._laws, self._values, self._densities, strict=True)
        fastest = max(law.wave_speed(v, least) for law, v, least in parts if v is not None)
        return self._cfl * self._dx / (fastest + 1e-12)

    def stable(self, speed: float = 0.0, cfl: float | None = None) -> float:
        """The smallest ``stable_dt`` of the bodies [s]; with another ``cfl`` than the pace's, if given."""
        cfl = self._cfl if cfl is None else cfl
        if (speed, cfl) not in self._found:
            parts = zip(self._laws, self._values, self._densities, strict=True)
            limits = [
                stable_dt(law, values, least, self._dx, speed, cfl, lagging=self._lagging)
                for law, values, least in parts
                if values is not None
            ]
            self._found = {(speed, cfl): min(limits)}
        return self._found[speed, cfl]

    def falling(self, fastest: float) -> float:
        """Step [s] that stays stable for ``STEPS`` steps in which gravity acts on the ``fastest`` [m/s]."""
        limit = self.stable(fastest)
        # dt (cfl dx / limit + STEPS g dt) = cfl dx
        gain = STEPS * self._g * limit**2 / (self._cfl * self._dx)
        return 2.0 * limit / (1.0 + math.sqrt(1.0 + 4.0 * gain))
