"""The grid of a simulation: particles give it momentum, it steps, and particles go with it.

Over the rest shape the nodes are the same from step to step, and keep their velocities: particles give them
only a share anew. What particles hardly see of these, such as what differs in sign from node to node, would
be lost in every step if all came from particles (APIC, the share 1): it would creep, by dt f/m in a step,
and a body that has been pressed would keep stresses for tenths of a second. With none it would ring.
"""

from functools import cache

import numpy as np
import warp as wp

from form_drake.laws.kernels import types
from form_drake.mpm.boundary import Boundary
from form_drake.mpm.held import Held
from form_drake.mpm.model import Body
from form_drake.mpm.pencils import Pencils
from form_drake.mpm.transfer import g2p, p2g, pulled
from form_drake.records.solver import Solver

FAR = 100.0  # times its size that a body over its rest shape may go: tools may carry it


class Grid:
    """Momentum and mass at the nodes, and the transfers to and from particles.

    Args:
        solver: grid, walls and transfers.
        body: all particles.
        mass: of them, on the device.
        total: whether the grid is laid over the rest shape; its particles keep their nodes.
        device: Warp device.

    Attributes:
        share: of its nodes' velocities, that particles give anew in a step.
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
        self._low, self._high = (t.vec3(*end) for end in self._domain(body.x))
        self._boundary = Boundary(solver, device)
        self._kernels = (
            p2g(solver.gradient, solver.precision),
            g2p(solver.gradient, solver.precision, total),
        )
        self._pencils = None
        single = solver.precision == "float32" and solver.gradient == "mls"
        if total and single and wp.get_device(device).is_cpu:
            own = body.x, body.mass, np.broadcast_to(body.volume, n)
            self._pencils = Pencils.of(*own, solver.dx, nodes)
        self.share = Held(wp.ones(1, dtype=t.real, device=device))

    def _domain(self, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends of where particles may be [m]."""
        dx, margin = self._solver.dx, self._solver.margin
        if self._total:
            low, high = rest.min(axis=0), rest.max(axis=0)
            far = FAR * max(float((high - low).max()), dx)
            return low - far, high + far
        extent = np.array(self._solver.nodes) * dx
        edges = (0.5, 1.5) if margin is None else (margin, margin)
        return np.full(3, edges[0] * dx), extent - edges[1] * dx

    def begin(self, x, v, C, T) -> None:
        """Over the rest shape: let nodes have the velocities of the particles."""
        own, device = types(self._solver.precision), self._device
        still = wp.zeros(1, dtype=own.vec4, device=device)
        whole = wp.ones(1, dtype=own.real, device=device)
        self.values.zero_()
        if self._pencils is not None:
            wp.copy(self.values, self._pencils.mass)
        self._particles(whole, x, v, C, wp.zeros_like(C), T, still)
        self._boundary.step(self.values, still, wp.zeros(1, dtype=int, device=device))

    @property
    def velocity(self) -> np.ndarray:
        """Of the nodes [m/s], shape [nodes, 3], after a step."""
        return self.values.numpy()[:, :3].copy()

    @velocity.setter
    def velocity(self, value: np.ndarray) -> None:
        now = self.values.numpy().copy()
        now[:, :3] = value
        self.values.assign(now)

    def scatter(self, x, v, C, tau, T, clock, decay) -> None:
        """Particles give mass, momentum, and what their stress does in a step.

        ``decay`` [1/s] is the rate at which what nodes keep of their velocity decays.
        """
        if self._total:
            stays = self._pencils is not None
            kept = [self.values, clock, decay, self.share.array, stays]
            self._launch(keep(self._solver.precision), len(self.values), kept)
        else:
            self.values.zero_()
        self._particles(self.share.array, x, v, C, tau, T, clock)

    def _particles(self, share, x, v, C, tau, T, clock) -> None:
        if self._pencils is not None:
            own = [self.values, v, C, tau, T, share, clock]
            self._pencils.scatter(*own, self._dx, self.nodes)
            return
        place, flux = x, tau
        if self._total:
            place, flux = self._rest, self._flux
            self._launch(pulled(self._solver.precision), len(x), [tau, T, flux])
        particles = [place, v, C, flux, self._mass, self._volume, share]
        domain = [clock, self._dx, self.nodes, self.values]
        self._launch(self._kernels[0], len(x), [*particles, *domain])

    def step(self, clock, steps) -> None:
        """Momentum becomes velocity; ``steps`` counts the step."""
        self._boundary.step(self.values, clock, steps)

    def gather(self, x, v, C, L, F, lost, T, fault, steps, clock) -> None:
        """Particles go on with the velocities of the grid."""
        domain = [self.values, clock, self._dx, self.nodes, self._low, self._high]
        moved = [x, v, C, L, F, lost, T, fault, steps]
        if self._pencils is not None:
            self._pencils.gather(*domain, *moved)
            return
        held, place = self._solver.margin is not None, self._rest if self._total else x
        self._launch(self._kernels[1], len(x), [*domain, held, place, *moved])

    def _launch(self, kernel, dim, inputs) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device)


@cache
def keep(precision: str):
    """Kernel: velocities of the last step to the momentum that nodes keep; mass ``stays`` or comes anew."""
    t = types(precision)
    real = t.real

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        grid: wp.array(dtype=t.vec4),
        clock: wp.array(dtype=t.vec4),
        decay: wp.array(dtype=real),
        share: wp.array(dtype=real),
        stays: wp.bool,
    ):
        i = wp.tid()
        g = grid[i]
        m = (real(1.0) - share[0]) * g[3]
        if decay[0] > real(0.0):
            m = m * wp.exp(-decay[0] * clock[0][0])
        grid[i] = t.vec4(m * g[0], m * g[1], m * g[2], wp.where(stays, g[3], real(0.0)))

    return kernel
