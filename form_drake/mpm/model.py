"""What is simulated: particles of a material, their state, and the time step they allow."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from form_drake.laws import Law, Values

CFL = 0.4
SLOWER = 3.0  # than the acoustic limit, steps may have to be for viscosity's sake


@dataclass(frozen=True)
class Body:
    """Particles of one material.

    Attributes:
        x: positions at rest [m], shape [particles, 3].
        volume: reference volumes [m^3], shape [particles].
        density: reference density [kg/m^3]; of joined bodies one for each particle.
        edges: of the boxes at rest that particles stand for [m], shape [3] or [particles, 3]; None: cubes.
    """

    x: np.ndarray
    volume: np.ndarray
    density: float | np.ndarray
    edges: np.ndarray | None = None

    @property
    def mass(self) -> np.ndarray:
        """Of every particle [kg], shape [particles]."""
        return np.broadcast_to(self.volume, len(self.x)) * self.density

    @property
    def half(self) -> np.ndarray:
        """Half the edges of the boxes [m], shape [particles, 3]."""
        edges = np.cbrt(self.volume)[..., None] if self.edges is None else self.edges
        return 0.5 * np.broadcast_to(edges, (len(self.x), 3))


def joined(bodies: Sequence[Body]) -> Body:
    """The particles of several bodies, one body after the other."""
    if len(bodies) == 1:
        return bodies[0]
    density = np.concatenate([np.full(len(b.x), b.density) for b in bodies])
    volume = np.concatenate([np.broadcast_to(b.volume, len(b.x)) for b in bodies])
    edges = 2.0 * np.concatenate([b.half for b in bodies])
    return Body(np.concatenate([b.x for b in bodies]), volume, density, edges)


@dataclass(frozen=True)
class State:
    """Everything that a simulation needs to go on, as host arrays.

    Attributes:
        x: positions [m], shape [particles, 3].
        v: velocities [m/s], shape [particles, 3].
        C: affine velocity matrices [1/s], over the rest shape if the grid is, shape [particles, 3, 3].
        L: velocity gradients [1/s], shape [particles, 3, 3].
        F: elastic deformation gradients [-], shape [particles, 3, 3].
        tau: Kirchhoff stresses [Pa], shape [particles, 3, 3].
        slip: see ``Tools.slip``, [m], shape [tools, particles, 3].
        face: see ``Plates.face``, [m], in double precision, shape [tools, columns, 3].
        anchor: see ``Plates.anchor``, [m], shape [tools, columns, 3].
        grid: velocities of the nodes, of a grid over the rest shape [m/s], shape [nodes, 3]; none: those of
            the particles.
        step: steps made so far.
        parts: elastic parts that are remembered, shape [memories, particles, 3, 3].
        plastic: their plastic strains, shape [memories, particles].
        T: deformation gradients since rest, of a grid over the rest shape, shape [particles, 3, 3].
        lost: what sums of F have lost to rounding, on such a grid, shape [particles, 3, 3].
        late: velocity gradients that lag, of such a grid [1/s], shape [2, particles, 3, 3].
        felt: those that viscosity feels [1/s], shape [particles, 3, 3].
    """

    x: np.ndarray
    v: np.ndarray
    C: np.ndarray
    L: np.ndarray
    F: np.ndarray
    tau: np.ndarray
    slip: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    face: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    anchor: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    grid: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    step: int = 0
    parts: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3, 3)))
    plastic: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    T: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    lost: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    late: np.ndarray = field(default_factory=lambda: np.zeros((2, 0, 3, 3)))
    felt: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))


def stable_dt(
    law: Law,
    values: Values,
    density: float,
    dx: float,
    speed: float = 0.0,
    cfl: float = CFL,
    *,
    lagging: bool = False,
) -> float:
    """Largest stable time step [s] for particles moving at up to ``speed`` [m/s].

    The acoustic limit cfl dx / (c + speed) and, for viscous laws, the diffusive limit
    rho dx^2 / (6 eta) with the largest viscosity that the regularisation admits; with a ``spring``
    beside what is viscous (``lagging``) at least 1/``SLOWER`` of the former.
    """
    limit = cfl * dx / (law.wave_speed(values, density) + speed + 1e-12)
    eta = law.viscosity(values)
    if eta > 0.0:
        diffusive = density * dx * dx / (6.0 * eta)
        return min(limit, max(diffusive, limit / SLOWER if lagging else 0.0))
    return limit


def spring(law: Law, values: Values, density: float, dx: float) -> float:
    """Shear modulus [Pa] of a spring in series with what is viscous; 0: none is needed.

    Twice as stiff to what is fast (see ``form_drake.laws.kernels.lag``), it lets waves be ``SLOWER`` times
    as fast at most, however large the viscosity is.
    """
    if stable_dt(law, values, density, dx) >= stable_dt(law, values, density, dx, lagging=True):
        return 0.0
    return 0.375 * (SLOWER**2 - 1.0) * density * law.wave_speed(values, density) ** 2
