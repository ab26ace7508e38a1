"""Reference finite elements: a pressed block and a bent strip with known parameters. SI units.

An oracle that shares no code with the package it tests. Laws: ``finite_elements_laws``; elements,
contact and time stepping: ``finite_elements_solver``.

press-a, press-b
    Von Mises block of 30 x 30 x 25 mm on the floor z = 0, settled under its weight, then pressed
    by a plate whose height runs through PRESS. Floor and plate are frictionless; in
    press-bonded-a and -b the floor holds the block from the stress-free state on, and each node
    that touches the plate sticks to it. Tool ``plate``: origin on the plate's plane.
bend-a, bend-b
    Fixed-corotated strip of 12 x 4 x 100 mm, held where z > 85 mm, without gravity unless
    --gravity, which then hangs at rest at first. A frictionless cylinder along y (radius 10 mm,
    16 mm long, axis at z = 10 mm) pushes it towards -x: BEND is the x of its axis. It hits the
    undamped strip at 44 mm/s; the strip bounces, and no two meshes or steps agree on a bounce. In
    bend-touching-a and -b the pusher touches from the start (TOUCHING). Tools ``pusher``: origin
    on the axis; ``clamp``: origin on the strip's axis at z = 85 mm.

Between the knots (t_k, y_k) of a path y = y_k + (3 u^2 - 2 u^3) (y_k+1 - y_k),
u = (t - t_k)/(t_k+1 - t_k). Nothing else moves the body and nothing but plastic flow damps it.
The press is solved on the quarter x, y > 0 and the strip on the half y > 0, mirrored.

Files: CASE.npz with time (T), p_WQ (T, P, 3), p_reference (P, 3; uniform over the whole
stress-free body, or on a lattice), gravity, density, and at every step pose_<tool>_value (S, 4, 4) and, but for the
clamp, force_<tool>_value (S, 3): the force of the material on the tool, each beside its _time (S).
contact_pusher (S, 3) is the force-weighted point of contact, NaN without one. CASE.json holds
geometry, contact and law, CASE.truth.json the parameters.
"""

import argparse
import json
import time as clock
from pathlib import Path

import finite_elements_laws as laws
import numpy as np
from finite_elements_solver import GAUSS, GAUSS_WEIGHT, Mesh, Plate, Pusher, Solver

DENSITY, GRAVITY = 1000.0, np.array([0.0, 0.0, -9.81])
PRESS = np.array([(0, 26), (0.2, 26), (1.0, 24), (1.8, 20), (2.0, 20)]) * [1, 1e-3]
BEND = np.array([(0.25, 20), (0.3, 20), (0.9, -4), (1.05, -4), (1.17, 50), (1.3, 50)]) * [1, 1e-3]
BLOCK = np.array([[-15, -15, 0], [15, 15, 25]]) * 1e-3
TOUCHING = np.vstack([np.minimum(BEND[:2], [1, 0.016]), BEND[2:]])
STRIP = np.array([[-6, -2, 0], [6, 2, 100]]) * 1e-3
CLAMP, RADIUS, AXIS = 0.085, 0.01, 0.01
STIFFNESS, SPACING = 5e9, 5e-5  # of the pusher's penalty [Pa/m]; of its points along z [m]
PARAMETERS = {
    "press-a": {"E": 80e3, "nu": 0.30, "tau_y": 1e3},
    "press-b": {"E": 80e3, "nu": 0.30, "tau_y": 10e3},
    "bend-a": {"E": 80e3, "nu": 0.45},
    "bend-b": {"E": 240e3, "nu": 0.45},
}
for k in "ab":
    PARAMETERS |= {f"press-bonded-{k}": PARAMETERS[f"press-{k}"]}
    PARAMETERS |= {f"bend-touching-{k}": PARAMETERS[f"bend-{k}"]}
STEPS = {"press": 2.5e-3, "bend": 1.25e-3}  # longest time step [s]
LEVELS = {"coarse": 1, "medium": 2, "fine": 3, "finest": 4}


def path(knots):
    """The smooth function of time through knots (K, 2), constant beyond them."""
    t, y = knots.T

    def value(time):
        k = int(np.clip(np.searchsorted(t, time, "right") - 1, 0, len(t) - 2))
        u = np.clip((time - t[k]) / (t[k + 1] - t[k]), 0, 1)
        return y[k] + (3 * u**2 - 2 * u**3) * (y[k + 1] - y[k])

    return value


def crowded(start, end, count):
    """``count`` + 1 planes from start to end [m] that crowd towards both."""
    return start + (end - start) * (1 - np.cos(np.pi * np.arange(count + 1) / count)) / 2


def press(p, level, *, sticking=False):
    """Solver of the block, settled at t = 0, on a mesh of ``level``."""
    low, high = BLOCK
    if sticking:  # finer towards the edges where the stress is singular
        n, layers = 2 * level, 3 * level
        edges = [crowded(-high[k], high[k], 2 * n)[n:] for k in (0, 1)]
        edges.append(crowded(low[2], high[2], layers))
    else:
        counts = np.array([1, 1, 2]) * (level + 1)
        edges = [np.linspace(0, high[k], counts[k] + 1) for k in range(3)]
    mesh = Mesh(edges)
    fixed, touches = mesh.X < 1e-9, mesh.X > high - 1e-9
    plates = [Plate(np.flatnonzero(touches[:, 2]), path(PRESS))]
    if sticking:  # to the sides too where they roll onto floor or plate
        fixed |= fixed[:, 2:]
        nodes = np.flatnonzero(touches.any(1) & ~fixed[:, 2])
        floor = Plate(nodes, lambda t: 0.0, side=-1, sticking=True)
        plates = [Plate(nodes, path(PRESS), sticking=True), floor]
    setting = {"density": DENSITY, "gravity": GRAVITY, "fixed": fixed, "plates": plates}
    solver = Solver(mesh, laws.von_mises, p, **setting)
    solver.rest(PRESS[0, 0])
    return solver


def bend(p, level, knots, *, gravity=False):
    """Solver of the strip, at rest at the start of the pusher's knots, on a mesh of ``level``."""
    low, high = STRIP
    free = np.linspace(0, 0.072, 6 * level + 1)[:-1]
    held = CLAMP - (CLAMP - 0.072) * 0.35 ** np.arange(level + 2)  # singular edges at the clamp
    z = np.concatenate([free, held, [CLAMP, high[2]]])
    mesh = Mesh([crowded(low[0], high[0], 2 * level), [0, high[1]], z])
    fixed = np.repeat(mesh.X[:, 2:] > CLAMP - 1e-9, 3, axis=1)
    fixed[:, 1] |= mesh.X[:, 1] < 1e-9
    along = np.arange(SPACING / 2, 0.03, SPACING)
    across = high[1] / 2 * (1 + GAUSS)
    points = np.stack(np.meshgrid(high[0], across, along, indexing="ij"), -1).reshape(-1, 3)
    area = np.repeat(high[1] / 2 * GAUSS_WEIGHT * SPACING, len(along))
    x = path(knots)
    grip = {"radius": RADIUS, "stiffness": STIFFNESS}
    pusher = Pusher(mesh, points, area, lambda t: np.array([x(t), 0, AXIS]), **grip)
    setting = {"density": DENSITY, "gravity": GRAVITY * gravity, "fixed": fixed}
    solver = Solver(mesh, laws.fixed_corotated, p, pusher=pusher, **setting)
    solver.rest(knots[0, 0])
    return solver


def prepared(case, level, *, gravity=False):
    """The solver of ``case`` at its start."""
    if case.startswith("bend"):
        knots = TOUCHING if "touching" in case else BEND
        return bend(PARAMETERS[case], level, knots, gravity=gravity)
    return press(PARAMETERS[case], level, sticking="bonded" in case)


def tool(solver):
    """Origin (3,) of the moving tool [m], force on it (3,) [N] and point of contact (3,) [m]."""
    if solver.plates:
        plate = solver.plates[0]
        held = solver.reaction[plate.nodes[plate.active]]
        origin = np.array([0, 0, plate.height(solver.time)])
        return origin, np.array([0, 0, 0 - 4 * held[:, 2].sum()]), origin
    x, force = solver.pusher.forces(solver.u, solver.time)
    share = np.linalg.norm(force, axis=1)
    point = share @ x / share.sum() if share.any() else np.full(3, np.nan)
    total = 0 - 2 * force.sum(0)
    return solver.pusher.centre(solver.time), total * [1, 0, 1], point * [1, 0, 1]


def simulate(solver, points, *, end, fps, h):
    """Run until ``end`` [s] in steps of at most h [s].

    Args:
        solver: At its start.
        points: Reference positions (P, 3) [m] anywhere in the body.
        end: Time of the last frame [s].
        fps: Frames per second.
        h: Longest step [s].

    Returns:
        By name: frames (T) [s], their positions (T, P, 3) [m], and per step the stamps (S) [s] and
        the three results of ``tool``.
    """
    mirror = np.array([-1, -1, 1]) if solver.plates else np.array([1, -1, 1])
    sign = np.where((points < 0) & (mirror < 0), -1.0, 1.0)
    sampler = solver.mesh.sampler(points * sign)
    start, each = solver.time, int(np.ceil(1 / (fps * h) - 1e-9))
    count = round((end - start) * fps)
    frames, stamps, tools = [points + sign * (sampler @ solver.u)], [start], [tool(solver)]
    for step in range(1, count * each + 1):
        solver.step(1 / (fps * each))
        solver.time = start + step / (fps * each)
        stamps.append(solver.time)
        tools.append(tool(solver))
        if step % each == 0:
            frames.append(points + sign * (sampler @ solver.u))
    origin, force, contact = (np.array(x) for x in zip(*tools, strict=True))
    named = {"frames": start + np.arange(count + 1) / fps, "positions": np.array(frames)}
    return named | {"time": np.array(stamps), "origin": origin, "force": force, "contact": contact}


def drawn(box, count, seed, face=None):
    """Positions (count, 3) [m] drawn uniformly from box (2, 3), or from a face such as "x+"."""
    points = np.random.default_rng(seed).uniform(*box, (count, 3))
    if face:
        axis = "xyz".index(face[0])
        points[:, axis] = box[int(face[1] == "+"), axis]
    return points


def filled(box, spacing):
    """Positions [m] in the middles of equal cells of about ``spacing`` [m] that fill box (2, 3)."""
    counts = np.maximum(1, np.round((box[1] - box[0]) / spacing)).astype(int)
    middles = [(np.arange(n) + 0.5) / n for n in counts]
    grid = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 3)
    return box[0] + grid * (box[1] - box[0])


def run(case, args, level, h):
    """The run of ``case`` on a mesh level with steps of h [s], and its solver."""
    solver = prepared(case, level, gravity=args.gravity)
    box, knots = (STRIP, BEND) if case.startswith("bend") else (BLOCK, PRESS)
    points = drawn(box, args.points, args.seed, args.face)
    if args.lattice:
        points = filled(box, args.lattice)
    found = simulate(solver, points, end=knots[-1, 0], fps=args.fps, h=h)
    return found | {"reference": points}, solver


def described(case):
    """What CASE.json says."""
    bent = case.startswith("bend")
    low, high = STRIP if bent else BLOCK
    shape = {"shape": "box", "low": "{:g} {:g} {:g}".format(*low)}
    kind = "bonded" if "bonded" in case else "frictionless"
    contact = {"z-": f"{kind} floor", "z+": f"{kind} plate"}
    if bent:
        contact = {"z+": "bonded clamp", "x+": "frictionless pusher"}
    return {
        "geometry": shape | {"high": "{:g} {:g} {:g}".format(*high)},
        "contact": contact | {"other": "free"},
        "law": "fixed-corotated" if bent else "von-mises",
        "known": {},
    }


def poses(origin):
    """Transforms (S, 4, 4) with the origins (S, 3) and no rotation."""
    X = np.tile(np.eye(4), (len(origin), 1, 1))
    X[:, :3, 3] = origin
    return X


def write(folder, case, found, gravity):
    """Write the three files of ``case``."""
    bent = case.startswith("bend")
    name = "pusher" if bent else "plate"
    arrays = {"time": found["frames"], "p_WQ": found["positions"]}
    arrays |= {"p_reference": found["reference"], "gravity": gravity, "density": DENSITY}
    arrays |= {f"pose_{name}_time": found["time"], f"pose_{name}_value": poses(found["origin"])}
    arrays |= {f"force_{name}_time": found["time"], f"force_{name}_value": found["force"]}
    if bent:
        clamp = np.tile([0, 0, CLAMP], (len(found["time"]), 1))
        arrays |= {"pose_clamp_time": found["time"], "pose_clamp_value": poses(clamp)}
        arrays["contact_pusher"] = found["contact"]
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / f"{case}.npz", **arrays)
    for suffix, content in ("json", described(case)), ("truth.json", PARAMETERS[case]):
        (folder / f"{case}.{suffix}").write_text(json.dumps(content, indent=1) + "\n")


def compared(case, args):
    """Print the differences of meshes from the next finer one and of steps from half of them."""
    print("mesh, step [s], wall time [s]: differences of position [um], rms and largest;")
    print("of the force at the frames [mN], rms and largest; its rms [mN]")
    trials = [("coarse", 1), ("medium", 1), ("fine", 1), ("medium", 2), ("medium", 0.5)]
    found = {}
    for mesh, factor in trials:
        begun = clock.time()
        one, _ = run(case, args, LEVELS[mesh], args.step * factor)
        force = one["force"][:: (len(one["time"]) - 1) // (len(one["frames"]) - 1)]
        found[mesh, factor] = one["positions"] * 1e6, force * 1e3, clock.time() - begun
    for one, other in (0, 1), (1, 2), (3, 1), (1, 4):
        (x, F, wall), (y, better, _) = found[trials[one]], found[trials[other]]
        d, e = np.linalg.norm(x - y, axis=-1), np.linalg.norm(F - better, axis=-1)
        sizes = [np.sqrt((d**2).mean()), d.max(), np.sqrt((e**2).mean()), e.max()]
        sizes.append(np.sqrt((better**2).sum(-1).mean()))
        mesh, factor = trials[one]
        row = " ".join(f"{size:9.3f}" for size in sizes)
        print(f"{mesh:7} {args.step * factor:.5f} {wall:4.0f}: {row}", flush=True)


def main():
    """Run one case and write its files, or compare meshes and steps."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", choices=PARAMETERS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--face", choices=[a + s for a in "xyz" for s in "-+"])
    parser.add_argument("--lattice", type=float, help="spacing [m] of points that fill the body")
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--mesh", choices=LEVELS, default="medium")
    parser.add_argument("--points", type=int, default=400)
    parser.add_argument("--fps", type=int, default=100)
    parser.add_argument("--step", type=float, help="longest time step [s]")
    parser.add_argument("--gravity", action="store_true", help="let the strip hang in gravity")
    parser.add_argument("--convergence", action="store_true", help="compare; write nothing")
    args = parser.parse_args()
    args.step = args.step or STEPS[args.case.split("-")[0]]
    if args.convergence:
        return compared(args.case, args)
    begun = clock.time()
    found, solver = run(args.case, args, LEVELS[args.mesh], args.step)
    heavy = args.gravity or args.case.startswith("press")
    write(args.out, args.case, found, GRAVITY * heavy)
    print(
        f"{args.case}: {clock.time() - begun:.0f} s, {solver.u.size} dofs,"
        f" {solver.iterations} iterations, {solver.factorisations} factorisations"
    )


if __name__ == "__main__":
    main()
