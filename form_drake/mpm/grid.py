"""The grid of a simulation: particles give it momentum, it steps, and particles go with it."""

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.boundary import Boundary
from form_drake.mpm.eights import Eights
from form_drake.mpm.model import Body
from form_drake.mpm.transfer import g2p, p2g, pulled
from form_drake.records.solver import Solver

FAR = 1e6  # [m]


class Grid:
    """Momentum and mass at the nodes, and the transfers to and from particles.

    Args:
        solver: grid, walls and transfers.
        body: all particles.
        mass: of them, on the device.
        total: whether the grid is laid over the rest shape; its particles keep their nodes.
        device: Warp device.
    """

    def __init__(self, solver: Solver, body: Body, mass, total: bool, device: str):
        t, n, nodes = types(solver.precision), len(body.x), solver.nodes
        dtype = np.float32 if solver.precision == "float32" else np.float64
        self.nodes = wp.vec3i(*nodes)
        self.values = wp.zeros(nodes[0] * nodes[1] * nodes[2], dtype=t.vec4, device=device)
        self._solver, self._total, self._device, self._mass = solver, total, device, mass
        self._dx = t.real(solver.dx)
        volume = np.ascontiguousarray(body.volume, dtype=dtype)
        self._volume = wp.array(volume, dtype=t.real, device=device)
        rest = np.ascontiguousarray(body.x, dtype=dtype)
        self._rest = wp.array(rest, dtype=t.vec3, device=device) if total else None
        self._flux = wp.zeros(n if total else 0, dtype=t.mat, device=device)
        self._low, self._high = (t.vec3(*end) for end in self._domain())
        self._boundary = Boundary(solver, device)
        self._kernels = (
            p2g(solver.gradient, solver.precision),
            g2p(solver.gradient, solver.precision, total),
        )
        self._eights = None
        single = solver.precision == "float32" and solver.gradient == "mls"
        if total and single and wp.get_device(device).is_cpu:
            own = body.x, body.mass, np.broadcast_to(body.volume, n)
            self._eights = Eights.of(*own, solver.dx, nodes)

    def _domain(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends of where particles may be [m]."""
        if self._total:
            return np.full(3, -FAR), np.full(3, FAR)
        dx, margin = self._solver.dx, self._solver.margin
        extent = np.array(self._solver.nodes) * dx
        edges = (0.5, 1.5) if margin is None else (margin, margin)
        return np.full(3, edges[0] * dx), extent - edges[1] * dx

    def scatter(self, x, v, C, tau, T, clock) -> None:
        """Particles give mass, momentum, and what their stress does in a step."""
        if self._eights is not None:
            self._eights.scatter(self.values, v, C, tau, T, clock, self._dx, self.nodes)
            return
        place, flux = x, tau
        self.values.zero_()
        if self._total:
            place, flux = self._rest, self._flux
            self._launch(pulled(self._solver.precision), len(x), [tau, T, flux])
        particles = [place, v, C, flux, self._mass, self._volume]
        domain = [clock, self._dx, self.nodes, self.values]
        self._launch(self._kernels[0], len(x), [*particles, *domain])

    def step(self, clock, steps) -> None:
        """Momentum becomes velocity; ``steps`` counts the step."""
        self._boundary.step(self.values, clock, steps)

    def gather(self, x, v, C, L, F, T, fault, steps, clock) -> None:
        """Particles go on with the velocities of the grid."""
        domain = [self.values, clock, self._dx, self.nodes, self._low, self._high]
        moved = [x, v, C, L, F, T, fault, steps]
        if self._eights is not None:
            self._eights.gather(*domain, *moved)
            return
        held, place = self._solver.margin is not None, self._rest if self._total else x
        self._launch(self._kernels[1], len(x), [*domain, held, place, *moved])

    def _launch(self, kernel, dim, inputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device)
