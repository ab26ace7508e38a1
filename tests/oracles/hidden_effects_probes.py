"""The probes of a hidden-effects case, simulated. SI units.

Effects that are not part of the law, with their coefficients:

    gravity-tilt    gravity turned by angle from -z towards the azimuth
    density         (1 + excess) times the stated density
    added-mass      mass spread evenly in a ball
    drag            the force -c v per mass, v in world
    tool-friction   Coulomb, at a plate stated to be frictionless; none at the start
    adhesion        a plate stated frictionless holds on up to strength, lost linearly in 0.2 mm
    floor-slip      the floor holds z; tangentially a layer of shear [Pa/m], or Coulomb friction
    inclusion       mu and kappa times factor in a ball
    crack           mu and kappa times left in a thin upright layer
    hidden-wall     a rigid frictionless wall that stands gap off a side of a pressed block

Contact of a frictionless plate is a spring of 2e10 Pa/m, with hidden friction or where it opens of
2e9 Pa/m, that of the hidden wall one of 2e9 Pa/m. Friction sticks with 2e8 Pa/m. Plate and walls meet only the face that they face at first.
"""

import numpy as np
from hidden_effects_cases import GRAVITY, PRELOAD, along, burst, plate_motion
from hidden_effects_material import Material
from hidden_effects_mesh import IJK, Mesh
from hidden_effects_solver import Solver, Wall

DENSITY, FPS, FORCE_RATE = 1000.0, 60, 240
LAYERS = {"coarse": [1, 3.2], "medium": [1, 3, 4.4], "fine": [1, 2.5, 4.5, 5.5]}
STEPS = {"coarse": 120, "medium": 240, "fine": 480}  # per second, twice as many in shakes
INSIDE = "damping relaxation yield hardening stiffening rate-dependence anisotropy eigenstrain"
INSIDE = [*INSIDE.split(), "mullins", "modulus-drift"]  # effects of the law


def snapped(edges, *planes):
    """Edges with the inner one next to each of the planes moved onto it."""
    edges = edges.copy()
    for plane in planes:
        edges[1 + np.argmin(np.abs(edges[1:-1] - plane))] = plane
    return edges


def inside(body, rng, count):
    """Reference positions (count, 3) [m] drawn uniformly from the body."""
    x, y, z = body["size"]
    return rng.uniform([-x / 2, -y / 2, 0], [x / 2, y / 2, z], (count, 3))


def on_faces(body, rng, count):
    """Reference positions (count, 3) [m] drawn from the sides x+ and y+, alike by their areas."""
    x, y, z = body["size"]
    points = rng.uniform([-x / 2, -y / 2, 0], [x / 2, y / 2, z], (count, 3))
    first = rng.uniform(size=count) < y / (x + y)
    return np.stack(
        [np.where(first, x / 2, points[:, 0]), np.where(first, points[:, 1], y / 2), points[:, 2]],
        axis=1,
    )


def mesh_of(truth, level):
    """The mesh, crowding towards the faces, with planes where a crack begins and ends."""
    size, edges = np.array(truth["body"]["size"]), []
    width = np.array(LAYERS[level] + LAYERS[level][::-1])
    for k, low in enumerate([-size[0] / 2, -size[1] / 2, 0.0]):
        edges.append(low + size[k] * np.concatenate([[0], np.cumsum(width)]) / width.sum())
    if crack := truth["effects"].get("crack"):
        k, low = crack["axis"], crack["at"] - crack["thickness"] / 2
        edges[k] = np.sort(np.append(snapped(edges[k], low), low + crack["thickness"]))
        edges[2] = snapped(edges[2], *crack["z"])
    return Mesh(edges)


def in_ball(mesh, centre, radius, count=5):
    """Share of each Gauss point's cell (27 E) that lies in a ball, from count^3 samples."""
    cut = np.array([-1, -4 / 9, 4 / 9, 1])
    s = cut[:-1, None] + np.diff(cut)[:, None] * (np.arange(count) + 0.5) / count
    middle, half = mesh.points.reshape(3, 27, -1)[:, 13], mesh.size / 2
    x, y, z = ((middle[k] + half[k] * s[IJK[k]][..., None] - centre[k]) ** 2 for k in range(3))
    squares = x[:, :, None, None] + y[:, None, :, None] + z[:, None, None]
    return (squares < radius**2).mean((1, 2, 3)).ravel()


def material_of(truth, mesh):
    """The law with the effects of the case."""
    E, nu, effects = truth["body"]["E"], truth["body"]["nu"], truth["effects"]
    p, scale = {"mu": E / (2 * (1 + nu)), "kappa": E / (3 * (1 - 2 * nu))}, 1.0
    for name in set(INSIDE) & set(effects):
        p |= effects[name]
    if ball := effects.get("inclusion"):
        scale = 1 + (ball["factor"] - 1) * in_ball(mesh, ball["centre"], ball["radius"])
    if crack := effects.get("crack"):
        z, (low, high) = mesh.points[2], crack["z"]
        cut = np.abs(mesh.points[crack["axis"]] - crack["at"]) < crack["thickness"] / 2
        scale = scale * np.where(cut & (low < z) & (z < high), crack["left"], 1.0)
    return Material(p, scale)


def masses(effects, mesh):
    """Masses of the nodes (n) [kg]."""
    mass = DENSITY * mesh.volume * (1 + effects.get("density", {"excess": 0})["excess"])
    if ball := effects.get("added-mass"):
        x = np.random.default_rng(0).uniform(-1, 1, (8000, 3))
        x = ball["centre"] + ball["radius"] * x[(x**2).sum(1) < 1]
        mass = mass + ball["mass"] * mesh.shared(x)
    return mass


def gravity_of(effects):
    """True acceleration (3) [m/s^2]."""
    tilt = effects.get("gravity-tilt", {"angle": 0, "azimuth": 0})
    side = np.sin(tilt["angle"]) * np.array([np.cos(tilt["azimuth"]), np.sin(tilt["azimuth"])])
    return GRAVITY * np.append(side, -np.cos(tilt["angle"]))


def motion_of(truth, probe):
    """The motion of the plate or, of a shake, the floor."""
    body, p = truth["body"], truth["body"][probe]
    end, height = p["duration"], body["size"][2]
    if probe == "shake":
        c, s = np.cos(p["azimuth"]), np.sin(p["azimuth"])
        if truth["small"]:
            return along(([c, s, p["rise"]], burst(0, end, p["slow"], p["f_slow"])))
        slow = burst(0.05 * end, 0.6 * end, p["slow"], p["f_slow"])
        fast = burst(0.45 * end, 0.97 * end, p["fast"], p["f_fast"])
        return along(([c, s, p["rise"]], slow), ([-s, c, p["rise"]], fast))
    start = 0.0 if body["bonded"] else PRELOAD
    last = -PRELOAD if body["opens"] and not body["bonded"] else start + 0.02 * p["depth"]
    depths = height * np.array([start, p["depth"], last, 0.005])
    return plate_motion(*depths, p["frequency"], end)


def still(time):
    """No motion."""
    return np.zeros((3, 3))


def wall_of(mesh, on, motion, axis=2, **setting):
    """A wall against the nodes ``on`` (n)."""
    nodes = np.flatnonzero(on)
    return Wall(nodes, mesh.area(axis)[nodes], motion, axis=axis, **setting)


def solver_of(truth, probe, level):
    """The solver at rest, and the function that tells the force of the material on the plate."""
    mesh, effects, body = mesh_of(truth, level), truth["effects"], truth["body"]
    top, bottom = mesh.X[2] > body["size"][2] - 1e-9, mesh.X[2] < 1e-9
    press, motion, held, walls = probe != "shake", motion_of(truth, probe), [], []
    floor = still if press else motion
    if press and body["bonded"]:
        held.append((np.tile(top, (3, 1)), motion))
    elif press:
        grip = effects.get("adhesion", {}) | effects.get("tool-friction", {})
        grip["stiffness"] = 2e9 if grip or body["opens"] else 2e10
        walls.append(wall_of(mesh, top, motion, side=-1, **grip))
    if layer := effects.get("floor-slip"):
        layer = {"friction": np.inf} | layer | {"strength": np.inf}
        walls.append(wall_of(mesh, bottom, floor, **layer))
    else:
        held.append((np.tile(bottom, (3, 1)), floor))
    if press and (wall := effects.get("hidden-wall")):
        axis = wall["axis"]
        on = mesh.X[axis] > body["size"][axis] / 2 - 1e-9
        walls.append(wall_of(mesh, on, still, axis, side=-1, gap=wall["gap"], stiffness=2e9))
    setting = {"gravity": gravity_of(effects), "held": held, "walls": walls}
    drag = effects.get("drag", {"c": 0.0})["c"]
    solver = Solver(mesh, material_of(truth, mesh), masses(effects, mesh), drag=drag, **setting)
    settle(solver, walls)
    if press and not body["bonded"]:
        return solver, lambda: -solver.pushes[0].sum(1)
    return solver, lambda: -solver.reaction[:, top].sum(1)


def settle(solver, walls):
    """Static equilibrium, on a floor that sticks and without friction of a plate."""
    friction = [wall.friction for wall in walls]
    for wall in walls:
        wall.friction = np.inf if wall.friction and wall.side > 0 else 0.0
    solver.rest()
    for wall, value in zip(walls, friction, strict=True):
        wall.friction = value


def simulated(truth, probe, points, level, rate=None):
    """What a probe shows.

    Args:
        truth: The case.
        probe: press, shake or heldout.
        points: Reference positions (P, 3) [m].
        level: That of the mesh.
        rate: Steps per second, a multiple of 120; by default that of the level.

    Returns:
        By name: time (T) [s], p_WQ (T, P, 3) [m], stamps (S) [s], pose (S, 4, 4) and force (S, 3)
        [N] of the tool, and the solver.
    """
    rate = rate or STEPS[level] * (1 + (probe == "shake"))
    solver, force = solver_of(truth, probe, level)
    motion, sampler = motion_of(truth, probe), solver.mesh.sampler(points)
    stamps, frames, forces, shifts = [], [], [], []
    for k in range(round(truth["body"][probe]["duration"] * FPS) * rate // FPS + 1):
        if k:
            solver.step(1 / rate)
            solver.time = k / rate
        if k % max(rate // FORCE_RATE, 1) == 0:
            stamps.append(k / rate)
            forces.append(force())
            shifts.append(motion(k / rate)[0])
        if k % (rate // FPS) == 0:
            frames.append(points + sampler @ solver.u.T)
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    height = 0.0 if probe == "shake" else truth["body"]["size"][2]
    poses[:, :3, 3] = np.add(shifts, [0, 0, height])
    found = {"time": np.arange(len(frames)) / FPS, "p_WQ": np.array(frames), "pose": poses}
    return found | {"stamps": np.array(stamps), "force": np.array(forces), "solver": solver}
