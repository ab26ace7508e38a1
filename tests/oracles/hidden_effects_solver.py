"""Contact and time stepping of the hidden-effects solids. SI units.

Arrays carry components first: u (3, n) over nodes. The balance of nodes with lumped masses m is

    m a + int P grad N dV - m (g - c v) - walls - reaction = 0

Time: Wood, Bossak and Zienkiewicz, second order, balanced at the end of each step:

    a -> (1 - B) a1 + B a0,  u1 = u0 + h v0 + h^2 ((1/2 - b) a0 + b a1),  v1 = v0 + h ((1 - c) a0 + c a1)
    B = (r - 1)/(r + 1),  c = 1/2 - B,  b = (1 - B)^2/4

r = RHO is the spectral radius of infinitely fast modes. Held nodes follow their motion exactly.
Newton keeps its factors while they serve.
"""

import numpy as np
from hidden_effects_factors import Factors, Secants
from numpy.linalg import norm

RHO = 0.8
BOSSAK = (RHO - 1) / (RHO + 1)
NEWMARK_C, NEWMARK_B = 0.5 - BOSSAK, (1 - BOSSAK) ** 2 / 4
FACTORS = 30  # cost of a factorisation, in iterations
DEPTH, PATIENCE, MOST = 12, 6, 60  # secants kept, iterations before new factors, and at most
HOLD, WARY = 6, 5  # changes of contact before a search along steps, steps that then begin with it
TOLERANCE = 1e-9, 2e-6  # largest Newton correction [m] and force [N] on a free node left


class Wall:
    """A rigid plane moving with ``motion``, against nodes with areas: stiff springs per area.

    With g the distance from the plane, d the tangential displacement from the wall and k, k_t the
    springs [Pa/m], the pressure is -k g for g < 0. Tension is k g up to ``strength`` [Pa], then
    falls linearly to zero over ``separation`` [m]. The tangential traction k_t (slip - d) is cut
    to ``friction`` times the pressure (infinite: never) that the last two steps lead to expect,
    and slip follows.
    """

    def __init__(self, nodes, area, motion, *, axis=2, side=1, gap=0.0, stiffness=2e10,
                 strength=0.0, separation=2e-4, friction=0.0, shear=2e8):  # fmt: skip
        """Stand ``gap`` [m] off the nodes before any motion, normal to ``axis``, body on ``side``."""
        self.nodes, self.area, self.motion = nodes, area, motion
        self.axis, self.side, self.gap, self.stiffness = axis, side, gap, stiffness
        self.strength, self.separation, self.friction = strength, separation, friction
        self.shear, self.slip = shear, np.zeros((3, len(nodes)))
        self.past = np.zeros((2, len(nodes)))  # pressures
        self.seen = None, None

    def place(self, time):
        """Displacement (3) [m] of the wall."""
        if self.seen[0] != time:
            self.seen = time, self.motion(time)[0]
        return self.seen[1]

    def force(self, u, time):
        """Forces on the nodes (3, m) [N] at displacements u (3, m) [m], slips and pressures."""
        d = u - self.place(time)[:, None]
        g = self.side * d[self.axis] + self.gap
        wide = (g - self.strength / self.stiffness) / self.separation
        most = self.strength * np.maximum(1 - wide, 0)
        pressure = -np.minimum(self.stiffness * g, np.where(g < 0, 0, most))
        across = (np.arange(3) != self.axis)[:, None]
        pull, slip = across * self.shear * (self.slip - d), self.slip
        if np.isfinite(self.friction):
            most = self.friction * np.maximum(2 * self.past[0] - self.past[1], 0)
            pull = pull * np.minimum(1, most / np.maximum(np.sqrt((pull**2).sum(0)), 1e-12))
            slip = across * d + pull / self.shear
        normal = (self.side * pressure) * (~across)
        return self.area * (normal + pull), slip, pressure

    def tangent(self, u, time):
        """-d force/du (3, 3, m) [N/m]."""
        d = u - self.place(time)[:, None]
        g = self.side * d[self.axis] + self.gap
        wide = (g - self.strength / self.stiffness) / self.separation
        soft = np.where(wide < 1, -self.strength / self.separation, 0.0)
        k = np.where((g < 0) | (wide < 0), self.stiffness, soft)
        normal, across = np.outer(*[np.arange(3) == self.axis] * 2), np.arange(3) != self.axis
        K = across[:, None, None] * np.eye(3)[:, :, None] * self.shear * np.ones(u.shape[1])
        if np.isfinite(self.friction):
            pull = across[:, None] * self.shear * (self.slip - d)
            size = np.maximum(np.sqrt((pull**2).sum(0)), 1e-12)
            most = self.friction * np.maximum(2 * self.past[0] - self.past[1], 0)
            ray = pull / size
            K = np.where(size > most, (K - self.shear * ray * ray[:, None]) * most / size, K)
        return self.area * (K + normal[:, :, None] * k)


class Solver:
    """A body in motion: displacement u, velocity v, acceleration a (3, n), state of the law.

    ``reaction`` (3, n) [N] is the force of what holds nodes on them, ``pushes`` those of the walls.
    """

    def __init__(self, mesh, material, mass, *, gravity, held=(), walls=(), drag=0.0):
        """Start stress-free.

        Args:
            mesh: The mesh.
            material: The law.
            mass: Masses of the nodes (n) [kg].
            gravity: Acceleration (3) [m/s^2].
            held: Pairs of a mask (3, n) and the motion (displacement, velocity, acceleration, each
                (3)) as function of time that the held components follow.
            walls: Walls.
            drag: Force per mass and velocity [1/s].
        """
        self.mesh, self.material, self.mass, self.drag = mesh, material, mass, drag
        self.held, self.walls, self.gravity = held, walls, np.asarray(gravity)[:, None]
        self.u, self.v, self.a = (np.zeros_like(mesh.X) for _ in range(3))
        self.state = material.start(mesh.weight.size)
        fixed = np.any([mask for mask, _ in held], 0) if held else np.zeros(mesh.X.shape, bool)
        self.fixed, self.factors, self.key = fixed, Factors(mesh, fixed), None
        self.spent, self.served, self.wary = 0, 0, 0
        self.old, self.secants = True, Secants(DEPTH)
        self.change, self.trend = np.zeros_like(self.u), np.zeros_like(self.u)
        self.time, self.factorisations, self.iterations = 0.0, 0, 0

    def follow(self, u, v, a, time):
        """Let the held components follow their motions."""
        for mask, motion in self.held:
            for field, value in zip((u, v, a), motion(time), strict=True):
                field[mask] = np.broadcast_to(np.asarray(value)[:, None], u.shape)[mask]

    def residual(self, u, v, a, time, h):
        """Reaction (3, n) [N] that the balance asks for, the state, and what the walls tell."""
        grad, rate = self.mesh.gradient(u), None if np.isinf(h) else self.mesh.gradient(v)
        P, state = self.material.stress(grad + np.eye(3)[:, :, None], rate, self.state, time, h)
        force = self.mesh.internal(P) + self.mass * (a + self.drag * v - self.gravity)
        pushes = [wall.force(u[:, wall.nodes], time) for wall in self.walls]
        for wall, (push, _, _) in zip(self.walls, pushes, strict=True):
            force[:, wall.nodes] -= push
        return force, state, pushes

    def springs(self, u, time):
        """Stiffness (3, 3, n) [N/m] of the walls at the nodes."""
        blocks = np.zeros((3, *u.shape))
        for wall in self.walls:
            blocks[:, :, wall.nodes] += wall.tangent(u[:, wall.nodes], time)
        return blocks

    def factorise(self, u, v, speed, inertia, time, h):
        """Factorise the tangent at u; ``speed`` = dv/du [1/s], ``inertia`` = da/du [1/s^2]."""
        F, rate = self.mesh.gradient(u) + np.eye(3)[:, :, None], None
        if np.isfinite(h):
            rate = self.mesh.gradient(v)
        A = self.material.tangent(F, rate, speed, self.state, time, h)
        walls = self.springs(u, time)
        blocks = walls + np.eye(3)[:, :, None] * self.mass * (inertia + self.drag * speed)
        self.factors.factorise(self.mesh.stiffness(A, blocks), walls)
        self.secants.clear()
        self.factorisations += 1
        self.spent, self.served, self.old = 0, 0, False

    def balance(self, u, v, a, time, h, speed=0.0, inertia=0.0, share=1.0):
        """Bring the free components into balance at ``time`` [s] and commit what follows.

        Args:
            u: Guess (3, n) [m], held components in place, with v and a that belong to it.
            v: Velocities [m/s].
            a: Accelerations [m/s^2].
            time: End of the step [s].
            h: Its length [s].
            speed: dv/du [1/s].
            inertia: da/du [1/s^2].
            share: Weight of a beside that at the start of the step.
        """
        old = np.where(self.fixed, 0.0, (1 - share) * self.a)
        share = np.where(self.fixed, 1.0, share)
        if self.key != h:
            self.old, self.key = True, h

        def state(new):
            """v, a and the residual at displacements."""
            now = v + speed * (new - u), a + inertia * (new - u)
            return now, self.residual(new, now[0], share * now[1] + old, time, h)

        def factorise(new):
            self.factorise(new, v + speed * (new - u), speed, inertia * share, time, h)

        before = self.iterations
        try:
            if self.wary:
                raise FloatingPointError
            u, (now, found) = self.bold(u, state, factorise, time)
        except FloatingPointError:
            self.wary = self.wary - 1 if self.wary else WARY
            u, (now, found) = self.cautious(u, state, factorise, time)
        self.u, (self.v, self.a), self.time = u, now, time
        self.spent, self.served = self.spent + self.iterations - before, self.served + 1
        self.old = self.iterations - before > 1 + 1.2 * (FACTORS + self.spent) / self.served
        force, self.state, pushes = found
        self.reaction, self.pushes = force * self.fixed, [push for push, _, _ in pushes]
        for wall, (_, slip, pressure) in zip(self.walls, pushes, strict=True):
            wall.slip, wall.past = slip, np.stack([pressure, wall.past[0]])

    def bold(self, u, state, factorise, time):
        """Whole steps of Newton's method with factors that are kept, and Anderson's mixing."""
        sizes, expected, before, turns = [], np.inf, None, 0
        for _ in range(MOST):
            self.iterations += 1
            found = state(u)
            force = found[1][0]
            small = np.abs(force[~self.fixed]).max() < TOLERANCE[1]
            if small and expected < TOLERANCE[0]:
                return u, found
            slow = len(sizes) > PATIENCE and sizes[-1] > 0.3 * sizes[-1 - PATIENCE]
            if self.old or slow:
                factorise(u)
                sizes, before = [], None
            elif self.factors.update(self.springs(u, time)):
                self.secants.clear()
                before, turns = None, turns + 1
                if turns > HOLD:
                    break
            change = self.factors.solve(-force)
            if before:
                self.secants.learn(u - before[0], change - before[1])
            before, change = (u, change), self.secants.corrected(change)
            sizes.append(np.abs(change).max())
            if small and sizes[-1] < TOLERANCE[0]:
                return u, found
            if len(sizes) > 1:
                expected = sizes[-1] * min(1, sizes[-1] / sizes[-2])
            u = u + change
        raise FloatingPointError(f"no balance at {time} s: corrections of {sizes[-1]:.1e} m")

    def cautious(self, u, state, factorise, time):
        """Newton's method, cut where the work of the residual along a step overshoots.

        A step is cut where that work is beyond zero by half of what it was short of zero.
        """
        base, move, last, scale, gain = u, np.zeros_like(u), np.inf, 1.0, np.inf
        self.secants.clear()
        slow = 0
        for _ in range(80):
            self.iterations += 1
            new = base + scale * move
            try:
                found = state(new)
            except FloatingPointError:
                if np.isinf(last):
                    raise
                scale /= 2
                continue
            force = found[1][0]
            over = (move * force).sum()
            if over > 0.5 * gain and scale > 1e-3:
                scale *= max(gain / (gain + over), 0.1)
                continue
            if self.old:
                factorise(new)
            moved = self.factors.update(self.springs(new, time))
            change = self.factors.solve(-force)
            size = np.abs(change).max()
            if size < TOLERANCE[0] and np.abs(force[~self.fixed]).max() < TOLERANCE[1]:
                return new, found
            slow += not moved and size > 0.3 * last
            if slow > 2:
                slow = 0
                factorise(new)
                change = self.factors.solve(-force)
                size = np.abs(change).max()
            base, move, last, scale, gain = new, change, size, 1.0, -(change * force).sum()
        raise FloatingPointError(f"no balance at {time} s: corrections of {size:.1e} m")

    def rest(self, time=0.0):
        """Go to static equilibrium at ``time`` [s]."""
        u, v, a = self.u.copy(), np.zeros_like(self.u), np.zeros_like(self.u)
        self.follow(u, v, a, time)
        self.balance(u, np.zeros_like(u), np.zeros_like(u), time, np.inf)
        for wall in self.walls:
            wall.past[1] = wall.past[0]

    def step(self, h):
        """Move on by h [s], in halves where Newton fails."""
        last, inertia = self.a, 1 / (NEWMARK_B * h**2)
        a = last + self.trend * (self.key == h)
        u = self.u + h * self.v + h**2 * ((0.5 - NEWMARK_B) * last + NEWMARK_B * a)
        v = self.v + h * ((1 - NEWMARK_C) * last + NEWMARK_C * a)
        speed = NEWMARK_C * h * inertia
        self.follow(u, v, a, self.time + h)
        for wall in self.walls:  # what touches is guessed to keep its gap
            on, k = wall.nodes[wall.past[0] > 0], wall.axis
            moved = -wall.place(self.time)[k] + wall.place(self.time + h)[k]
            change = self.u[k, on] + moved - u[k, on]
            u[k, on] += change
            v[k, on] += speed * change
            a[k, on] += inertia * change
        try:
            self.balance(u, v, a, self.time + h, h, speed, inertia, 1 - BOSSAK)
        except FloatingPointError:
            if h < 2e-5:
                raise
            self.step(h / 2)
            self.step(h / 2)
        else:  # where the change of a before would have served as a guess, the next one follows it
            change, self.change = self.change, self.a - last
            self.trend = self.change * (norm(self.change - change) < norm(self.change))
