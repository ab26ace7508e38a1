"""Drake's deformable bodies as the material: a pressed block and a bent strip. SI units.

An oracle that no code of the package takes part in: linear tetrahedra of Drake's ``DeformableModel``
with ``MaterialModel.kCorotated``, whose energy mu |F - R|^2 + lam/2 (J - 1)^2 is that of the
package's ``fixed-corotated``; E 80 kPa, nu 0.30, no damping, no gravity. Boxes are cut into cells of
six tetrahedra each, mirrored from cell to cell.

press-*
    Block of 30 x 30 x 25 mm that sticks to the floor z = 0 and to a plate that its upper face is
    fixed to and that comes down by 3 mm.
bend-*
    Strip of 24 x 12 x 96 mm that sticks to a clamp at z = 96 mm. A pad sticks to its face x+ where
    z <= 12 mm; the tool ``pusher`` holds the pad in a hinge along y at z = 9 mm, slides freely along
    z and is carried by 16 mm towards -x, so that it feels a force along x alone.

The stroke runs through a quintic step of 0.5 s and is held for 0.1 s. A stiff drive moves a tool
of known mass; the force of the material on it is that mass times its acceleration less what the
drive exerts, and the pose is where it really is.

Drake takes steps of first order, and solves for a grip's forces with the body linearised about where
it would spring to in this step without them. Steps must be short for the elements that the grips
hold, or the force comes out too small: by 1 % at 2.5 ms on the press's coarse mesh. The press
is therefore made with MASS times the mass, which its CASE.json states; it is nearly quasi-static still.
The bend has its true mass: internal and reported forces agree within 0.3 % there.

Files: CASE.npz with time (T), p_reference (P, 3) of vertices drawn by the seed, ``steps`` (T - 1, P,
3), whose running sum times ``resolution`` is their displacement, gravity, density, and for the tool
pose_<tool>_value (S, 4, 4), force_<tool>_value (S, 3) beside their _time (S). CASE.json: what a
person would state. CASE.truth.json: E, nu, the mesh, and the apparent modulus: the linear
tetrahedra are too stiff, and a fine mesh of quadratic bricks (``finite_elements_solver``) would need
this E to bear the same force at the same held stroke. It is computed from force and stroke alone.
"""

import argparse
import json
import tempfile
import time as clock
from itertools import permutations
from pathlib import Path

import numpy as np
from drake_deformable_reference import AXIS, BOX, DENSITY, NU, ORIGIN, PAD, E, reference
from pydrake.geometry import AddContactMaterial, Box, GeometryInstance, ProximityProperties
from pydrake.geometry import Mesh as MeshFile
from pydrake.math import RigidTransform
from pydrake.multibody.fem import DeformableBodyConfig, MaterialModel
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

TOOL = {"press": "plate", "bend": "pusher"}
STROKE = {"press": -3e-3, "bend": -16e-3}  # [m]
CELLS = {"press": np.array([2, 2, 2]), "bend": np.array([2, 1, 8])}  # times the factor of the mesh
MESHES = {"coarse": 3, "medium": 4, "fine": 5}
MASS = {"press": 25.0, "bend": 1.0}  # factor on the density of what is simulated
STEP = {"press": 1.25e-3, "bend": 2.5e-3}  # [s]
EPS = 1e-5  # by how much boxes overlap the vertices that they hold [m]
LINK = 1e-3  # mass of the tool and of each slide before it [kg]
RAMP, HOLD, FPS = 0.5, 0.1, 100
AVERAGED = 0.05  # of the hold, from its end, over which force and stroke are averaged [s]
RESOLUTION = 1e-7  # of stored displacements [m]


def cut(box, cells):
    """Vertices (N, 3) [m] and tetrahedra (M, 4) of a box (2, 3) of cells (3)."""
    lines = [np.linspace(a, z, n + 1) for a, z, n in zip(*box, cells, strict=True)]
    X = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3)
    cell = np.indices(cells).reshape(3, -1).T
    found = []
    for order in permutations(range(3)):  # each a walk along edges to the opposite corner
        corner = np.vstack([np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(order)], 0)])
        mirrored = np.where(cell[:, None] % 2, 1 - corner, corner)
        at = np.moveaxis(cell[:, None] + mirrored, -1, 0)
        found.append(np.ravel_multi_index(tuple(at), tuple(np.add(cells, 1))))
    tets = np.concatenate(found)
    turned = np.linalg.det(X[tets[:, 1:]] - X[tets[:, :1]]) < 0
    tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    return X, tets


def write_vtk(path, X, tets):
    """A legacy VTK file, the only one that Drake reads tetrahedra from."""
    lines = ["# vtk DataFile Version 3.0", "box", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines += [f"POINTS {len(X)} double", *(" ".join(map(repr, x)) for x in X.tolist())]
    lines += [f"CELLS {len(tets)} {5 * len(tets)}"]
    lines += ["4 " + " ".join(map(str, t)) for t in tets.tolist()]
    lines += [f"CELL_TYPES {len(tets)}", *["10"] * len(tets)]
    path.write_text("\n".join(lines) + "\n")


def add_body(plant, X, tets, density):
    """Register the stress-free body of a density [kg/m^3]."""
    config = DeformableBodyConfig()
    config.set_youngs_modulus(E)
    config.set_poissons_ratio(NU)
    config.set_mass_density(density)
    config.set_material_model(MaterialModel.kCorotated)
    properties = ProximityProperties()
    AddContactMaterial(friction=CoulombFriction(0.0, 0.0), properties=properties)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "box.vtk"
        write_vtk(path, X, tets)
        shape = GeometryInstance(RigidTransform(), MeshFile(str(path)), "body")
        shape.set_proximity_properties(properties)
        return plant.mutable_deformable_model().RegisterDeformableBody(
            geometry_instance=shape, config=config, resolution_hint=1.0
        )


def add_tool(plant, kind):
    """The tool, held by its drive; returns the tool, the driven joint and all its joints."""
    name, axis = TOOL[kind], AXIS[kind]
    origin = RigidTransform(ORIGIN[kind])
    frame = plant.AddFrame(FixedOffsetFrame("start", plant.world_frame(), origin))
    names, joints = ([name] if kind == "press" else ["carriage", "slide", name]), []
    for body_name in names:
        small = SpatialInertia(LINK, np.zeros(3), UnitInertia.SolidCube(0.03))
        body = plant.AddRigidBody(body_name, small)
        if not joints:
            joint = PrismaticJoint("drive", frame, body.body_frame(), np.eye(3)[axis])
        elif body_name == "slide":
            joint = PrismaticJoint("free", frame, body.body_frame(), [0.0, 0.0, 1.0])
        else:
            joint = RevoluteJoint("hinge", frame, body.body_frame(), [0.0, 1.0, 0.0])
        joints.append(plant.AddJoint(joint))
        frame = body.body_frame()
    motor = plant.AddJointActuator("motor", joints[0])
    motor.set_controller_gains(PdControllerGains(p=1e7, d=1e3))
    return body, joints


def stroke(kind, t):
    """Wanted travel [m] and speed [m/s] of the tool at time t [s]."""
    s, whole = min(t / RAMP, 1.0), STROKE[kind]
    return whole * (6 * s**5 - 15 * s**4 + 10 * s**3), whole * 30 * (s - s * s) ** 2 / RAMP


def simulate(kind, cells):
    """Run on a mesh of cells (3).

    Returns:
        By name: X (N, 3) [m], time (S) [s] of the steps, x (S, N, 3) [m], the tool's travel (S, 3)
        [m] and the force on it (S, 3) [N].
    """
    (X, tets), h = cut(BOX[kind], cells), STEP[kind]
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlant(
        MultibodyPlantConfig(time_step=h, discrete_contact_approximation="lagged"), builder
    )
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    model, body = plant.mutable_deformable_model(), add_body(plant, X, tets, DENSITY * MASS[kind])
    tool, joints = add_tool(plant, kind)
    wall, up = (np.array([0, 0, EPS]), 1) if kind == "press" else (BOX[kind][1] - EPS, -1)
    model.SetWallBoundaryCondition(body, wall, [0, 0, up])
    o = ORIGIN[kind]
    low, high = (np.array([-1, -1, o[2]]), np.array([1, 1, o[2]]))
    if kind == "bend":
        low, high = np.array([o[0], -1, 0]), np.array([o[0], 1, PAD])
    held = Box(*(high - low + 2 * EPS)), RigidTransform((low + high) / 2 - o)
    model.AddFixedConstraint(body, tool, RigidTransform(-o), *held)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    wanted = plant.get_desired_state_input_port(joints[0].model_instance())
    axis, mass, last = AXIS[kind], LINK * len(joints), 0.0
    found = {"X": X, "time": [0.0], "x": [X], "travel": [np.zeros(3)], "force": [np.zeros(3)]}
    for k in range(1, round((RAMP + HOLD) / h) + 1):
        wanted.FixValue(context, stroke(kind, k * h))
        simulator.AdvanceTo(k * h)
        travel, force, v = np.zeros(3), np.zeros(3), joints[0].get_translation_rate(context)
        travel[axis] = joints[0].get_translation(context)
        travel[2] += joints[1].get_translation(context) if kind == "bend" else 0.0
        force[axis] = mass * (v - last) / h - plant.get_net_actuation_output_port().Eval(context)[0]
        last, x = v, model.GetPositions(context, body).T.copy()
        for name, value in (("time", k * h), ("x", x), ("travel", travel), ("force", force)):
            found[name].append(value)
    return {k: np.asarray(v) for k, v in found.items()}


def held_force(kind, found):
    """Mean travel [m] of the tool and force on it [N] along its axis, at the end of the hold."""
    late, axis = found["time"] > RAMP + HOLD - AVERAGED - 1e-9, AXIS[kind]
    return found["travel"][late, axis].mean(), found["force"][late, axis].mean()


def truth(kind, cells, found, level):
    """What CASE.truth.json says; ``level`` is that of the reference mesh."""
    travel, force = held_force(kind, found)
    forces = reference(kind, travel, level)
    return {
        "E": E,
        "nu": NU,
        "apparent": E * force / forces[-1],
        "cells": [int(n) for n in cells],
        "vertices": len(found["X"]),
        "spacing": float(np.ptp(BOX[kind][:, 0])) / int(cells[0]),
        "travel": travel,
        "force": force,
        "reference_forces": forces,
    }


def described(kind):
    """What CASE.json says."""
    low, high = ("{:g} {:g} {:g}".format(*corner) for corner in BOX[kind])
    contact = {"z-": "bonded floor", "z+": "bonded plate"}
    if kind == "bend":
        contact = {"z+": "bonded clamp", "x+": "touched pusher"}
    return {
        "geometry": {"shape": "box", "low": low, "high": high},
        "contact": contact | {"other": "free"},
        "law": "fixed-corotated",
        "known": {"nu": NU},
        "mass_scale": MASS[kind],
        "source": "Drake DeformableModel, kCorotated",
    }


def arrays(kind, found, count, seed):
    """What CASE.npz holds, of ``count`` vertices or of all where there are fewer."""
    name, every = TOOL[kind], round(1 / (FPS * STEP[kind]))
    drawn = np.random.default_rng(seed).permutation(len(found["X"]))[:count]
    drawn = np.sort(drawn)
    u = found["x"][::every, drawn] - found["X"][drawn]
    poses = np.tile(np.eye(4), (len(found["time"]), 1, 1))
    poses[:, :3, 3] = ORIGIN[kind] + found["travel"]
    return {
        "time": found["time"][::every],
        "p_reference": found["X"][drawn],
        "steps": np.diff(np.rint(u / RESOLUTION), axis=0).astype(np.int16),
        "resolution": RESOLUTION,
        "gravity": np.zeros(3),
        "density": DENSITY,
        f"pose_{name}_time": found["time"],
        f"pose_{name}_value": poses,
        f"force_{name}_time": found["time"],
        f"force_{name}_value": found["force"],
    }


def main():
    """Run cases and write their files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    cases = [f"{kind}-{mesh}" for kind in BOX for mesh in MESHES]
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(cases)}; or all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--points", type=int, default=400)
    parser.add_argument("--reference", type=int, default=3, help="level of the reference mesh")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for case in args.cases or cases:
        begun = clock.time()
        kind, mesh = case.split("-")
        cells = MESHES[mesh] * CELLS[kind]
        found = simulate(kind, cells)
        np.savez_compressed(args.out / f"{case}.npz", **arrays(kind, found, args.points, args.seed))
        facts = {"json": described(kind), "truth.json": truth(kind, cells, found, args.reference)}
        for suffix, content in facts.items():
            (args.out / f"{case}.{suffix}").write_text(json.dumps(content, indent=1) + "\n")
        print(f"{case}: {clock.time() - begun:.0f} s, {len(found['X'])} vertices", flush=True)


if __name__ == "__main__":
    main()
