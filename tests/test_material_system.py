"""Soft bodies in a Drake diagram: exchange of momentum, the Context, what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.common.value import Value
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, HalfSpace, Mesh, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    ExternallyAppliedSpatialForce,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from form_drake.laws import LAWS
from form_drake.material import Acting, Material, read_material
from form_drake.systems.arm import add_package
from form_drake.systems.deformable import deformable_config
from form_drake.systems.shapes import edges, solid
from form_drake.systems.soft import GRIDS, AddMaterial, over_rest, particles

G = np.array([0.0, 0.0, -9.81])
STEP = 1e-3
EDGE = 0.03
MASS = 0.05
SOFT = Material(LAWS["fixed-corotated"], {"mu": 30e3, "lam": 45e3}, density=1000.0)


def on_the_floor(
    *,
    drop=0.0,
    sampled=False,
    finalize=True,
    floor=None,
    twin=False,
    step=STEP,
    arm=0.0,
    fed=lambda builder, plant: None,
    **options,
):
    """A soft cube on a floor under a falling ball, in a plant of its own."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=step, use_sampled_output_ports=sampled)
    plant, scene_graph = AddMultibodyPlant(config, builder)
    rough = CoulombFriction(0.4, 0.4)
    floor = floor or Box(1.0, 1.0, 0.1)
    below = RigidTransform([0, 0, -0.05])
    plant.RegisterCollisionGeometry(plant.world_body(), below, floor, "floor", rough)
    ball = plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(MASS, 0.01))
    X_BG = RigidTransform([0.0, 0.0, arm])
    plant.RegisterCollisionGeometry(ball, X_BG, Sphere(0.01), "ball", rough)
    if twin:
        other = plant.AddModelInstance("other")
        second = plant.AddRigidBody("ball", other, SpatialInertia.SolidSphereWithMass(MASS, 0.01))
        plant.RegisterCollisionGeometry(second, RigidTransform(), Sphere(0.01), "ball", rough)
        plant.SetDefaultFloatingBaseBodyPose(second, RigidTransform([0.2, 0.0, 0.2]))
    if finalize:
        plant.Finalize()
    fed(builder, plant)
    options = {"dx": 5e-3, "precision": "float64"} | options
    X_WM = RigidTransform([0.0, 0.0, EDGE / 2])
    cube = Box(EDGE, EDGE, EDGE)
    system = AddMaterial(builder, plant, scene_graph, SOFT, cube, X_WM, **options)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    own = plant.GetMyMutableContextFromRoot(context)
    plant.SetFreeBodyPose(own, ball, RigidTransform([0.003, 0.0, EDGE + 0.011 + drop]))
    simulator.Initialize()
    return simulator, plant, system


def momentum(simulator, plant, system):
    """Of the material and of the ball [N s]."""
    context = simulator.get_context()
    scene = system.scene
    v = system.snapshot(system.GetMyContextFromRoot(context)).state.v
    soft = (scene.simulation.body.mass[:, None] * v).sum(axis=0)
    own = plant.GetMyContextFromRoot(context)
    ball = plant.EvalBodySpatialVelocityInWorld(own, plant.GetBodyByName("ball"))
    return soft, MASS * ball.translational()


def with_a_soft_ball(builder, plant):
    """Material of the plant before."""
    scene_graph = builder.GetSubsystemByName("scene_graph")
    AddMaterial(
        builder, plant, scene_graph, SOFT, Sphere(0.01), RigidTransform([0.1, 0.0, 0.1]), dx=5e-3
    )


def exported(builder, plant):
    """The port of its forces leads out of the diagram."""
    builder.ExportInput(plant.get_applied_spatial_force_input_port(), "forces")


def lifted(builder, plant):
    """Another system bears the ball's weight."""
    force = ExternallyAppliedSpatialForce()
    force.body_index = plant.GetBodyByName("ball").index()
    force.F_Bq_W = SpatialForce(np.zeros(3), -MASS * G)
    source = builder.AddSystem(
        ConstantValueSource(Value[list[ExternallyAppliedSpatialForce]]([force]))
    )
    builder.Connect(source.get_output_port(), plant.get_applied_spatial_force_input_port())


def test_forces_of_another_system_act_beside_those_of_the_material():
    """What bears the ball's weight goes on to, and the floor feels its push."""
    simulator, plant, system = on_the_floor(fed=lifted)
    simulator.AdvanceTo(0.03)
    soft, ball = momentum(simulator, plant, system)
    assert ball == pytest.approx(0.0, abs=1e-12)
    assert np.abs(soft).max() > 0.0
    own = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    down = SpatialVelocity(np.zeros(3), [0.0, 0.0, -0.2])
    plant.SetFreeBodySpatialVelocity(own, plant.GetBodyByName("ball"), down)
    simulator.AdvanceTo(0.06)
    assert momentum(simulator, plant, system)[1][2] > -0.1 * MASS  # the cube stops it


@pytest.mark.parametrize("grid", GRIDS)
def test_momentum_of_the_whole_diagram(grid):
    """Material, ball and floor exchange what gravity brings, without a lag, to round-off."""
    simulator, plant, system = on_the_floor(grid=grid)
    weight = (MASS + 1000.0 * EDGE**3) * G
    floor = np.zeros(3)
    start, largest = sum(momentum(simulator, plant, system)), 0.0
    for k in range(150):
        simulator.AdvanceTo((k + 1) * STEP)
        context = system.GetMyContextFromRoot(simulator.get_context())
        floor += STEP * system.GetOutputPort("world.wrench").Eval(context)[3:]
        ball = system.GetOutputPort("ball.wrench").Eval(context)[3:]
        largest = max(largest, np.abs(ball).max())
        gained = sum(momentum(simulator, plant, system)) - start
        assert gained + floor == pytest.approx((k + 1) * STEP * weight, abs=1e-9 * 0.1)
    assert largest > 2.0 * MASS * 9.81  # the ball did land on it


@pytest.mark.parametrize("grid", GRIDS)
def test_the_floor_carries_the_weight_at_rest(grid):
    simulator, _, system = on_the_floor(drop=0.2, settle=(300.0, 0.1), grid=grid)
    simulator.AdvanceTo(0.1)
    context = system.GetMyContextFromRoot(simulator.get_context())
    wrench = system.GetOutputPort("world.wrench").Eval(context)
    assert wrench[3:] == pytest.approx(1000.0 * EDGE**3 * G, rel=0.01, abs=2e-3)
    assert wrench[:3] == pytest.approx(0.0, abs=1e-4)  # it rests about the origin


@pytest.mark.parametrize("grid", GRIDS)
def test_clone_rewind_and_replay(grid):
    """A cloned Context goes on to the very same particles, whatever ran in between."""
    simulator, _, system = on_the_floor(grid=grid)
    simulator.AdvanceTo(0.04)
    kept = simulator.get_context().Clone()
    simulator.AdvanceTo(0.08)
    first = system.snapshot(system.GetMyContextFromRoot(simulator.get_context()))
    again = Simulator(simulator.get_system(), kept)
    again.Initialize()
    again.AdvanceTo(0.08)
    second = system.snapshot(system.GetMyContextFromRoot(kept))
    for name in ("x", "v", "C", "F", "tau"):
        assert np.array_equal(getattr(first.state, name), getattr(second.state, name)), name
    assert np.array_equal(first.force, second.force)
    fresh = simulator.get_system().CreateDefaultContext()
    assert np.array_equal(
        system.snapshot(system.GetMyContextFromRoot(fresh)).p_WQ, system.scene.rest
    )


def test_wrench_is_about_the_body_not_the_geometry():
    """The floor's geometry hangs 5 cm below the world's origin: the moment is about the latter."""
    simulator, _, system = on_the_floor()
    simulator.AdvanceTo(0.06)
    context = system.GetMyContextFromRoot(simulator.get_context())
    snapshot = system.snapshot(context)
    (n,) = (i for i, t in enumerate(system.touching) if t.name == "world")
    expected = snapshot.moment[n] + np.cross([0.0, 0.0, -0.05], snapshot.force[n])
    wrench = system.GetOutputPort("world.wrench").Eval(context)
    assert wrench == pytest.approx([*expected, *snapshot.force[n]], abs=1e-12)


def test_the_moment_of_a_wrench_follows_its_body():
    """A port that was read before the plant was moved is read anew: the floor's arm is not the ball's."""
    simulator, plant, system = on_the_floor(arm=0.004)
    simulator.AdvanceTo(0.06)
    context = simulator.get_mutable_context()
    port, own = system.GetOutputPort("ball.wrench"), system.GetMyContextFromRoot(context)
    before = port.Eval(own)
    ball, state = plant.GetBodyByName("ball"), plant.GetMyMutableContextFromRoot(context)
    turn = RotationMatrix.MakeYRotation(0.5 * np.pi)
    X_WB = plant.GetFreeBodyPose(state, ball)
    plant.SetFreeBodyPose(state, ball, RigidTransform(turn, X_WB.translation()))
    (n,) = (i for i, t in enumerate(system.touching) if t.name == "ball")
    snapshot = system.snapshot(own)
    expected = snapshot.moment[n] + np.cross(turn @ [0.0, 0.0, 0.004], snapshot.force[n])
    assert port.Eval(own)[:3] == pytest.approx(expected, abs=1e-12)
    assert np.abs(port.Eval(own)[:3] - before[:3]).max() > 1e-4


def test_bodies_of_one_name_have_wrenches_of_their_own():
    """They are told apart by their models, in contacts too."""
    _, _, system = on_the_floor(twin=True, contact={"other::ball": 0.1})
    own = "DefaultModelInstance::ball"
    assert {t.name for t in system.touching} == {"world", own, "other::ball"}
    assert {t.name: t.tool.contact for t in system.touching} == {
        "world": 0.4,
        own: 0.4,
        "other::ball": 0.1,
    }
    assert all(system.HasOutputPort(f"{t.name}.wrench") for t in system.touching)


def test_a_mesh_that_stands_below_is_touched(tmp_path):
    """Its middle is further from the cube than its baked distance reaches."""
    path = tmp_path / "slab.obj"
    trimesh.creation.box((0.2, 0.2, 0.1)).export(path)
    simulator, _, system = on_the_floor(floor=Mesh(str(path)), dx=EDGE / 6.0)
    assert {t.name for t in system.touching} == {"world", "ball"}
    simulator.AdvanceTo(0.03)
    own = system.GetMyContextFromRoot(simulator.get_context())
    assert system.snapshot(own).p_WQ[:, 2].min() > -1e-4


@pytest.mark.parametrize(
    "shape",
    [Capsule(0.01, 0.02), Ellipsoid(0.01, 0.02, 0.015), Cylinder(0.01, 0.03)],
    ids=lambda s: type(s).__name__,
)
def test_drake_shapes_as_solids(shape):
    """Volumes of the particles inside, against the closed forms."""
    volumes = {
        Capsule: np.pi * 1e-4 * 0.02 + 4 / 3 * np.pi * 1e-6,
        Ellipsoid: 4 / 3 * np.pi * 3e-6,
        Cylinder: np.pi * 1e-4 * 0.03,
    }
    X_WM = RigidTransform(RotationMatrix.MakeXRotation(0.3), [0.1, 0.2, 0.3])
    body = particles(shape, X_WM, 1.5e-3)
    assert body.volume.sum() == pytest.approx(volumes[type(shape)], rel=0.02)
    assert body.x.mean(axis=0) == pytest.approx([0.1, 0.2, 0.3], abs=1e-5)


def test_convex_hull_of_a_file(tmp_path):
    path = tmp_path / "tetrahedron.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    made = solid(Convex(str(path), 0.03), 1e-3)
    inside, outside = [[0.004] * 3], [[0.02] * 3]
    assert made.distance(np.array(inside))[0] < 0 < made.distance(np.array(outside))[0]


def test_a_gltf_file_stands_as_in_drake(tmp_path):
    """Its y is up, Drake's z."""
    made = trimesh.creation.box((0.02, 0.03, 0.06))
    made.apply_translation([0.01, 0.02, 0.05])
    for name, content in made.scene().export(file_type="gltf").items():
        (tmp_path / name).write_bytes(content)
    mesh = Mesh(str(tmp_path / "model.gltf"), np.array([1.0, 2.0, 3.0]))
    hull = mesh.GetConvexHull()
    corners = np.array([hull.vertex(n) for n in range(hull.num_vertices())])
    assert edges(mesh) == pytest.approx(np.ptp(corners, axis=0))
    middle = corners.mean(axis=0)
    ends = np.concatenate([0.99 * (corners - middle), 1.05 * (corners - middle)]) + middle
    inside = solid(mesh, 2.5e-3).distance(ends) < 0.0
    assert inside.tolist() == [True] * len(corners) + [False] * len(corners)


def test_a_body_over_its_rest_falls_onto_a_floor_beyond_its_region():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(time_step=STEP, use_sampled_output_ports=False), builder
    )
    below, rough = RigidTransform([0, 0, -0.05]), CoulombFriction(0.4, 0.4)
    plant.RegisterCollisionGeometry(plant.world_body(), below, Box(1.0, 1.0, 0.1), "floor", rough)
    plant.Finalize()
    high = RigidTransform([0.0, 0.0, 0.5])
    system = AddMaterial(
        builder, plant, scene_graph, SOFT, Box(EDGE, EDGE, EDGE), high, grid="rest", dx=EDGE / 4.0
    )
    assert [t.name for t in system.touching] == ["world"]


def test_a_mesh_that_looks_inwards_is_as_solid_as_another(tmp_path):
    cube = trimesh.creation.box((0.04, 0.04, 0.04))
    cube.invert()
    cube.export(tmp_path / "inward.obj")
    inside = solid(Mesh(str(tmp_path / "inward.obj")), 2.5e-3).distance(np.zeros((1, 3)))
    assert inside == pytest.approx(-0.02, abs=1e-3)
    cube.faces[0] = cube.faces[0][::-1]
    cube.export(tmp_path / "both.obj")
    with pytest.raises(ValueError, match="its triangles look to both sides of its surface"):
        solid(Mesh(str(tmp_path / "both.obj")), 2.5e-3)


def test_a_soft_mesh_may_be_large_and_off_its_origin(tmp_path):
    """Its default grid is that of a box of its size."""
    path = str(tmp_path / "base.obj")
    made = trimesh.creation.box((0.4, 0.3, 0.3))
    made.apply_translation([0.0, 0.0, 0.15])
    made.export(path)
    spacings = []
    for shape, X_WM in ((Mesh(path), RigidTransform()), (Box(0.4, 0.3, 0.3), RigidTransform())):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=STEP, use_sampled_output_ports=False)
        plant, scene_graph = AddMultibodyPlant(config, builder)
        plant.Finalize()
        soft = AddMaterial(builder, plant, scene_graph, SOFT, shape, X_WM)
        spacings.append(soft.scene.simulation.solver.dx)
    assert spacings == pytest.approx([0.05, 0.05])


def test_a_mesh_that_cannot_be_used_is_named(tmp_path):
    (tmp_path / "a.vtk").touch()
    with pytest.raises(ValueError, match=r"a.vtk is of a kind that is not read: take .obj"):
        solid(Mesh(str(tmp_path / "a.vtk")), STEP)
    large = tmp_path / "large.obj"
    trimesh.creation.box((2.0, 2.0, 2.0)).export(large)
    with pytest.raises(ValueError, match=r"body world: .* at most .* leave it out of bodies"):
        on_the_floor(floor=Mesh(str(large)))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"sampled": True}, "SetUseSampledOutputPorts"),
        ({"finalize": False}, "Finalize"),
        ({"contact": {"plate": 0.1}}, "plate"),
        ({"drop": -0.005}, "ball by 3.9 mm"),
        (
            {"contact": {"ball": "bonded"}, "grid": "rest"},
            "ball is bonded where .* starts elsewhere",
        ),
        ({"region": np.array([[-0.01] * 3, [0.01] * 3])}, "enlarge the region"),
        ({"grid": "time"}, "'time': choose from rest, space"),
        ({"per_cell": (2, 0, 2)}, "three whole numbers"),
        ({"step": 2.5e-3}, "period 0.001 s: one or several steps of the plant"),
        ({"step": 7e-4}, "which are 0.0007 s"),
        ({"step": 0.0, "period": 0.0}, "period: a positive number"),
        ({"dx": 0.0}, "dx: a positive number is wanted, got 0"),
        ({"mass_scale": -1.0}, "mass_scale: a positive number"),
        ({"settle": (-5.0, 0.1)}, "settle: rate .* must not be negative"),
        ({"region": [0.0, 1.0, 1.0]}, "region: two corners are wanted"),
        ({"fed": with_a_soft_ball}, "the plant has material: give all to one AddMaterial"),
        ({"fed": exported}, "applied_spatial_force port is an input of the diagram"),
    ],
)
def test_what_does_not_fit_is_refused(options, said):
    with pytest.raises(ValueError, match=said):
        on_the_floor(**options)


def test_what_flows_is_not_laid_out_over_a_rest_shape():
    water = Material(LAWS["newtonian"], {"eta": 1.0, "kappa": 1e4}, density=1000.0)
    with pytest.raises(ValueError, match="one solid, got newtonian: choose space"):
        over_rest([water], "rest")
    with pytest.raises(ValueError, match="got fixed-corotated, fixed-corotated"):
        over_rest([SOFT, SOFT], "rest")


def test_particles_stand_closer_along_an_axis_of_a_box_however_it_is_turned():
    """Their boxes fill it after a quarter turn."""
    turn = RigidTransform(RotationMatrix.MakeZRotation(np.pi / 2.0), [0.1, 0.0, 0.0])
    body = particles(Box(0.012, 0.004, 0.02), turn, np.array([5e-4, 1e-3, 1e-3]))
    assert len(body.x) == 24 * 4 * 20
    assert 2.0 * body.half[0] == pytest.approx([1e-3, 5e-4, 1e-3])
    low, high = body.x.min(axis=0) - body.half[0], body.x.max(axis=0) + body.half[0]
    assert high - low == pytest.approx([0.004, 0.012, 0.02])


def test_bodies_may_touch_and_not_overlap():
    """As a body and a plant's may."""

    def second(x):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=STEP, use_sampled_output_ports=False)
        plant, scene_graph = AddMultibodyPlant(config, builder)
        plant.Finalize()
        shapes, places = [Box(0.02, 0.02, 0.02), Sphere(0.01)], [[0.0] * 3, [x, 0.0, 0.0]]
        poses = [RigidTransform(RotationMatrix.MakeZRotation(np.pi / 2), p) for p in places]
        return AddMaterial(builder, plant, scene_graph, [SOFT, SOFT], shapes, poses, dx=5e-3)

    assert len(second(0.02).scene.simulation.bodies) == 2
    with pytest.raises(ValueError, match="bodies 0 and 1 overlap: move one"):
        second(0.017)


def test_a_body_bears_less_than_its_own_inertia():
    """A box of 8 g that holds 3.2 g goes on evenly; one of 5.6 g would be thrown at metres a second."""

    def pushed(density, grid):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=STEP, use_sampled_output_ports=False)
        plant, scene_graph = AddMultibodyPlant(config, builder)
        cube, own = Box(0.02, 0.02, 0.02), SpatialInertia.SolidBoxWithDensity(density, *[0.02] * 3)
        box, rough = plant.AddRigidBody("box", own), CoulombFriction(0.3, 0.3)
        plant.RegisterCollisionGeometry(box, RigidTransform(), cube, "box", rough)
        plant.SetDefaultFloatingBaseBodyPose(box, RigidTransform([0.012, 0.0, 0.0]))
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
        plant.Finalize()
        told = {"dx": 4e-3, "grid": grid, "contact": {"box": "bonded"}, "precision": "float64"}
        AddMaterial(builder, plant, scene_graph, SOFT, cube, RigidTransform(), **told)
        simulator = Simulator(builder.Build())
        state = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        sideways = SpatialVelocity(np.zeros(3), [0.0, 0.0, 0.05])
        plant.SetFreeBodySpatialVelocity(state, box, sideways)
        simulator.AdvanceTo(0.1)
        return plant.EvalBodySpatialVelocityInWorld(state, box).translational()

    assert np.linalg.norm(pushed(1000.0, "space")) < 0.05
    for grid in GRIDS:
        with pytest.raises(
            ValueError, match=r"box holds 3.2 g of material, .* is 1.02 times its own"
        ):
            pushed(700.0, grid)


@pytest.mark.parametrize("grid", GRIDS)
def test_what_a_body_holds_is_where_the_body_is(grid):
    """A turning box that falls: held by velocities alone, its content would lag a step of 1 mm behind it."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=STEP, use_sampled_output_ports=False)
    plant, scene_graph = AddMultibodyPlant(config, builder)
    cube, own = Box(0.02, 0.02, 0.02), SpatialInertia.SolidBoxWithDensity(4000.0, *[0.02] * 3)
    box = plant.AddRigidBody("box", own)
    plant.RegisterCollisionGeometry(box, RigidTransform(), cube, "box", CoulombFriction(0.3, 0.3))
    plant.Finalize()
    told = {"dx": 4e-3, "grid": grid, "contact": {"box": "bonded"}, "precision": "float64"}
    told["region"] = np.array([[-0.02, -0.02, -0.08], [0.02, 0.02, 0.02]])
    soft = AddMaterial(
        builder, plant, scene_graph, SOFT, Box(*[0.012] * 3), RigidTransform(), **told
    )
    diagram = builder.Build()
    simulator = Simulator(diagram)
    state = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodySpatialVelocity(state, box, SpatialVelocity([0.0, 5.0, 0.0], np.zeros(3)))
    simulator.AdvanceTo(0.1)
    simulator.AdvancePendingEvents()
    context = simulator.get_context()
    X_WB = plant.EvalBodyPoseInWorld(plant.GetMyContextFromRoot(context), box)
    assert X_WB.translation()[2] == pytest.approx(-0.05, abs=2e-3)
    seen = soft.snapshot(soft.GetMyContextFromRoot(context)).p_WQ
    off = np.linalg.norm(
        seen - soft.scene.rest @ X_WB.rotation().matrix().T - X_WB.translation(), axis=1
    )
    assert off.max() < 1e-4


def test_half_space_cannot_be_filled():
    with pytest.raises(ValueError, match="half-space"):
        particles(HalfSpace(), RigidTransform(), 1e-3)


def test_a_gripper_holds_what_friction_can_carry():
    """Fingers of 3 N: friction 0.6 holds 26 g still, 0.02 lets it slip through."""
    fallen = {}
    for mu in (0.6, 0.02):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=STEP, use_sampled_output_ports=False)
        plant, scene_graph = AddMultibodyPlant(config, builder)
        parser = Parser(plant)
        add_package(parser)
        parser.AddModelsFromUrl("package://form_drake/tools/gripper.sdf")
        palm = plant.GetFrameByName("palm")
        plant.WeldFrames(plant.world_frame(), palm, RigidTransform([0.0, 0.0, 0.1]))
        plant.Finalize()
        cube, contact = Box(EDGE, EDGE, EDGE), dict.fromkeys(("left", "right"), mu)
        X_WM = RigidTransform([0.0, 0.0, 0.03])
        soft = AddMaterial(builder, plant, scene_graph, SOFT, cube, X_WM, contact=contact)
        force = builder.AddSystem(ConstantVectorSource([-3.0, -3.0]))
        builder.Connect(force.get_output_port(), plant.get_actuation_input_port())
        simulator = Simulator(builder.Build())
        context = simulator.get_mutable_context()
        own = plant.GetMyMutableContextFromRoot(context)
        plant.SetPositions(own, [0.016, 0.016])
        height = []
        for time in (0.03, 0.07):
            simulator.AdvanceTo(time)
            p_WQ = soft.snapshot(soft.GetMyContextFromRoot(simulator.get_context())).p_WQ
            height.append(p_WQ[:, 2].mean())
        fallen[mu] = height[0] - height[1]
    assert abs(fallen[0.6]) < 5e-4  # it sags between the fingers
    assert fallen[0.02] > 0.01


def test_elastic_materials_become_drakes_own():
    config = deformable_config(Material(SOFT.law, SOFT.values, density=1100.0))
    assert config.youngs_modulus() == pytest.approx(30e3 * (3 * 45 + 2 * 30) / (45 + 30))
    assert config.poissons_ratio() == pytest.approx(45 / (2 * (45 + 30)))
    assert config.mass_density() == 1100.0
    dough = Material(LAWS["von-mises"], {**SOFT.values, "tau_y": 1e3}, density=1000.0)
    with pytest.raises(ValueError, match="no deformable model of von-mises"):
        deformable_config(dough)
    dragged = Material(SOFT.law, SOFT.values, 1000.0, effects=(Acting("drag", 1.0, {}),))
    with pytest.raises(ValueError, match="have no drag: give the material without effects"):
        deformable_config(dragged)


def test_the_plant_of_the_readme(tmp_path, monkeypatch):
    """The block runs as it stands there, given what its names stand for."""
    root = Path(__file__).resolve().parents[1]
    blocks = re.findall(r"^```py\n(.*?)^```$", (root / "README.md").read_text(), re.S | re.M)
    (block,) = (b for b in blocks if "AddMaterial" in b)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").symlink_to(root / "models")
    (tmp_path / "gripper.sdf").symlink_to(root / "models" / "tools" / "gripper.sdf")
    known = {"builder": DiagramBuilder(), "X_WM": RigidTransform([0.0, 0.0, 0.3])}
    known |= {n: globals()[n] for n in ("AddMaterial", "AddMultibodyPlant", "Box", "Parser")}
    known |= {"MultibodyPlantConfig": MultibodyPlantConfig, "read_material": read_material}
    exec(block, known)
    simulator = Simulator(known["builder"].Build())
    simulator.AdvanceTo(2 * STEP)
    context = known["soft"].GetMyContextFromRoot(simulator.get_context())
    assert known["soft"].snapshot(context).p_WQ.shape[1] == 3
