"""Quadratic bricks under the press and the bend of ``drake_deformable``, at rest. SI units.

What a converged mesh of the same box, law and grips bears at the same stroke: the force is
proportional to Young's modulus, so that the ratio of two forces is a ratio of moduli. Elements, laws
and Newton's method are those of ``finite_elements_solver`` and ``finite_elements_laws``.
"""

import finite_elements_laws as laws
import numpy as np
from finite_elements import crowded
from finite_elements_solver import Mesh, Solver

E, NU, DENSITY = 80e3, 0.30, 1000.0
BOX = {
    "press": np.array([[-15, -15, 0], [15, 15, 25]]) * 1e-3,
    "bend": np.array([[-12, -6, 0], [12, 6, 96]]) * 1e-3,
}
AXIS = {"press": 2, "bend": 0}  # that the tool is carried along
ORIGIN = {"press": np.array([0, 0, 0.025]), "bend": np.array([0.012, 0, 0.009])}  # of the tool [m]
PAD = 0.012  # upper end of the pad [m]


def about_y(angle):
    """Rotation matrix about y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def bricks(kind, level):
    """The undeformed solver on the quarter or half x, y > 0 and its nodes (N,) that the tool holds."""
    low, high = BOX[kind]
    half = [crowded(-high[k], high[k], 4 * level)[2 * level :] for k in (0, 1)]
    if kind == "press":
        mesh = Mesh([*half, crowded(0, high[2], 4 * level)])
        held, clamped = mesh.X[:, 2] > high[2] - 1e-9, mesh.X[:, 2] < 1e-9
    else:
        across, above = crowded(low[0], high[0], 3 * level), crowded(PAD, high[2], 6 * level)
        mesh = Mesh([across, half[1], np.r_[crowded(0, PAD, 3 * level)[:-1], above]])
        held = (mesh.X[:, 0] > high[0] - 1e-9) & (mesh.X[:, 2] < PAD + 1e-9)
        clamped = mesh.X[:, 2] > high[2] - 1e-9
    fixed = np.repeat((held | clamped)[:, None], 3, 1)
    fixed[:, 1] |= mesh.X[:, 1] < 1e-9
    fixed[:, 0] |= (mesh.X[:, 0] < 1e-9) & (kind == "press")
    given = {"density": DENSITY, "gravity": np.zeros(3), "fixed": fixed}
    return Solver(mesh, laws.fixed_corotated, {"E": E, "nu": NU}, **given), held


def balanced(solver, held, u, travel, angle, origin):
    """Equilibrium u (N, 3) with the held nodes moved rigidly, and what they exert on the tool.

    Returns:
        u, force (3,) [N] of the meshed part, and its moment about y at the tool's origin [N m].
    """
    arm = (solver.mesh.X[held] - origin) @ about_y(angle).T
    u = u.copy()
    u[held] = origin + travel + arm - solver.mesh.X[held]
    u, reaction, _ = solver.newton(u, solver.fixed, 0.0, np.zeros_like(u), 0.0)
    force = -reaction[held]
    return u, force.sum(0), (arm[:, 2] * force[:, 0] - arm[:, 0] * force[:, 2]).sum()


def settled(kind, solver, held, u, free, travel):
    """Equilibrium after ``travel`` [m] of the tool along its axis, near a guess.

    Args:
        u: guess (N, 3) [m].
        free: guess of the pad's slide along z [m] and of its angle about y, shape (2,).

    Returns:
        u and free of the equilibrium, and the force on the tool along its axis [N].
    """
    axis = AXIS[kind]

    def at(u, free):
        moved = travel * np.eye(3)[axis] + [0, 0, free[0]]
        u, force, moment = balanced(solver, held, u, moved, free[1], ORIGIN[kind])
        return u, force[axis], np.array([force[2], moment / PAD])

    u, force, rest = at(u, free)
    while kind == "bend" and np.abs(rest).max() > 1e-7:  # N that the hinge would bear along z
        columns = [(at(u, free + d)[2] - rest) / d.sum() for d in np.diag([1e-5, 1e-3])]
        free = free - np.linalg.solve(np.stack(columns, -1), rest)
        u, force, rest = at(u, free)
    return u, free, force * (4 if kind == "press" else 2)


def guess(kind, X, travel):
    """Displacements (N, 3) [m] of an even press or a slender cantilever, slide and angle (2,)."""
    if kind == "press":
        return np.outer(X[:, 2] / ORIGIN[kind][2], [0, 0, travel]), np.zeros(2)
    top = BOX[kind][1, 2]
    length = top - ORIGIN[kind][2]
    s = (top - X[:, 2]) / length
    angle = -travel * (3 * s - 1.5 * s**2) / length
    bent = travel * (1.5 * s**2 - 0.5 * s**3)
    return np.stack([bent, 0 * s, -angle * X[:, 0]], -1), np.array([0, -1.5 * travel / length])


def reference(kind, travel, level, *, parts=8):
    """Forces on the tool [N] that quadratic bricks of levels 1 to ``level`` show after ``travel``."""
    forces, coarser, u, free = [], None, np.zeros((0, 3)), np.zeros(2)
    for one in range(1, level + 1):
        solver, held = bricks(kind, one)
        X = solver.mesh.X
        for part in np.arange(1, parts + 1) if coarser is None else [parts]:
            if coarser is not None:
                u = coarser.sampler(X) @ u
            elif part == 1:
                u, free = guess(kind, X, travel / parts)
            else:
                u, free = u * part / (part - 1), free * part / (part - 1)
            u[solver.fixed & ~held[:, None]] = 0
            u, free, force = settled(kind, solver, held, u, free, travel * part / parts)
        forces.append(force)
        coarser = solver.mesh
    return forces
