"""The robot and its tools as files: frames, limits, masses, and shapes that enclose the real ones."""

from importlib.resources import files

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Role, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import LoadModelDirectivesFromString, Parser, ProcessModelDirectives
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from form_drake.systems.arm import add_package
from form_drake.systems.scenario import load_scenario
from form_drake.systems.station import make_station

# Bounds of the meshes that Franka publishes (franka_description), as the glTF accessors of
# drake_models state them, in the link's frame [mm]. Of link0 only what is not cable.
PUBLISHED = {
    "panda_link1": ((-55, -129.4, -192), (55, 55, 55)),
    "panda_link2": ((-55, -194, -55), (55, 55, 129.2)),
    "panda_link3": ((-54.9, -54.9, -121), (137.5, 111, 54.9)),
    "panda_link4": ((-137.5, -55, -55), (55, 124, 111)),
    "panda_link5": ((-54.9, -55, -259), (54.9, 129.9, 52.2)),
    "panda_link6": ((-48, -51.2, -43.9), (131.9, 81.7, 56.3)),
    "panda_link7": ((-44, -44, 52), (81.3, 81.3, 106.8)),
    "panda_hand": ((-31.5, -103, -14.5), (31.5, 100.6, 66)),
    "panda_leftfinger": ((-10.5, 0, 0), (10.5, 26.3, 53.9)),
}
TOOLS = (
    "tools/press_plate",
    "tools/bending_pusher",
    "table/table",
    "table/strip_clamp",
    "table/specimen_stand",
)


@pytest.fixture(scope="module")
def panda():
    return scene("panda/panda.urdf", "panda_link0")


def scene(path, root):
    """Diagram, plant and context of one model, welded to the world by ``root``."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = Parser(plant)
    add_package(parser)
    parser.AddModels(url=f"package://form_drake/{path}")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root))
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    return diagram, plant, context, plant.GetMyContextFromRoot(context)


def shapes(plant, context, body, role):
    """Shapes of a body and their poses X_BG."""
    inspector = plant.get_geometry_query_input_port().Eval(context).inspector()
    frame = plant.GetBodyFrameIdOrThrow(body.index())
    ids = inspector.GetGeometries(frame, role)
    return [(inspector.GetShape(g), inspector.GetPoseInFrame(g), inspector.GetName(g)) for g in ids]


def surface(shape, X_BG):
    """Points on a primitive's surface, shape [n, 3]."""
    if isinstance(shape, Box):
        unit = np.linspace(-0.5, 0.5, 9)
        p = np.stack(np.meshgrid(unit, unit, unit), axis=-1).reshape(-1, 3)
        p = p[np.abs(p).max(axis=1) > 0.499] * shape.size()
    elif isinstance(shape, Sphere):
        p = shape.radius() * directions()
    elif isinstance(shape, Capsule):
        p = shape.radius() * directions()
        p = p + np.sign(p[:, 2:]) * [0.0, 0.0, shape.length() / 2]
    else:
        turn, z = np.meshgrid(np.linspace(0, 2 * np.pi, 48), np.linspace(-0.5, 0.5, 15))
        p = np.stack([shape.radius() * np.cos(turn), shape.radius() * np.sin(turn)], axis=-1)
        p = np.concatenate([p, shape.length() * z[..., None]], axis=-1).reshape(-1, 3)
    return (X_BG @ p.T).T


def directions():
    z, turn = np.linspace(-1, 1, 41), 2.399963 * np.arange(41)
    z, turn = np.concatenate([z, [0] * 16]), np.append(turn, np.linspace(0, 2 * np.pi, 16))
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def distance(shape, X_BG, p_BQ):
    """Signed distance of points from a sphere or box [m]; negative inside."""
    p = (X_BG.inverse() @ p_BQ.T).T
    if isinstance(shape, Sphere):
        return np.linalg.norm(p, axis=1) - shape.radius()
    assert isinstance(shape, Box)
    gap = np.abs(p) - shape.size() / 2
    return np.linalg.norm(np.maximum(gap, 0.0), axis=1) + np.minimum(gap.max(axis=1), 0.0)


# --- the arm --------------------------------------------------------------------------------------
def test_the_panda_has_drake_models_names_and_nine_motors(panda):
    _, plant, _, context = panda
    assert plant.num_positions() == plant.num_actuators() == 9
    for i in range(9):
        assert plant.HasBodyNamed(f"panda_link{i}")
    for name in ("panda_hand", "panda_leftfinger", "panda_rightfinger"):
        assert plant.HasBodyNamed(name)
    for i, inertia in enumerate([0.605721456] * 2 + [0.462474144] * 2 + [0.205544064] * 3, 1):
        motor = plant.GetJointActuatorByName(f"panda_motor{i}")
        assert motor.joint().name() == f"panda_joint{i}"
        reflected = motor.default_gear_ratio() ** 2 * motor.default_rotor_inertia()
        assert reflected == pytest.approx(inertia)
    assert plant.CalcTotalMass(context) == pytest.approx(17.45, abs=0.01)


def test_forward_kinematics_as_published(panda):
    _, plant, _, _ = panda
    context = plant.CreateDefaultContext()
    flange = plant.GetFrameByName("panda_link8")
    for q, p in (
        (np.zeros(7), (0.088, 0.0, 0.926)),
        ((0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4), (0.3069, 0.0, 0.5903)),
    ):
        plant.SetPositions(context, np.append(q, [0.0, 0.0]))
        assert flange.CalcPoseInWorld(context).translation() == pytest.approx(p, abs=1e-4)
    tcp = plant.GetFrameByName("panda_hand_tcp").CalcPose(context, flange)
    assert tcp.translation() == pytest.approx((0.0, 0.0, 0.1034))


def test_limits_as_published(panda):
    _, plant, _, _ = panda
    assert plant.GetPositionLowerLimits()[:7] == pytest.approx(
        (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973)
    )
    assert plant.GetPositionUpperLimits() == pytest.approx(
        (2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973, 0.04, 0.04)
    )
    assert plant.GetVelocityUpperLimits()[:7] == pytest.approx((2.175,) * 4 + (2.61,) * 3)
    assert plant.GetAccelerationUpperLimits()[:7] == pytest.approx((15, 7.5, 10, 12.5, 15, 20, 20))
    assert plant.GetEffortUpperLimits()[:7] == pytest.approx((87,) * 4 + (12,) * 3)


def test_no_self_collision_when_ready_and_valid_inertias(panda):
    _, plant, _, context = panda
    plant.SetPositions(context, [0, -0.785, 0, -2.356, 0, 1.571, 0.785, 0.02, 0.02])
    query = plant.get_geometry_query_input_port().Eval(context)
    pairs = query.ComputeSignedDistancePairwiseClosestPoints(0.1)
    assert min(pair.distance for pair in pairs) > 0.02
    for i in plant.GetBodyIndices(plant.GetModelInstanceByName("panda")):
        assert plant.get_body(i).CalcSpatialInertiaInBodyFrame(context).IsPhysicallyValid()


@pytest.mark.parametrize("link", PUBLISHED)
def test_shapes_have_the_published_extents(panda, link):
    _, plant, _, context = panda
    body = plant.GetBodyByName(link)
    low, high = 1e-3 * np.array(PUBLISHED[link])
    drawn = shapes(plant, context, body, Role.kIllustration)
    seen = np.concatenate([surface(s, X) for s, X, _ in drawn])
    solid = shapes(plant, context, body, Role.kProximity)
    assert all(isinstance(s, Sphere | Box) for s, _, _ in solid)
    assert seen.min(axis=0) == pytest.approx(low, abs=6e-3)
    assert seen.max(axis=0) == pytest.approx(high, abs=6e-3)
    around = np.concatenate([surface(s, X) for s, X, _ in solid])
    assert np.all(around.min(axis=0) < low + 1e-3) and np.all(around.max(axis=0) > high - 1e-3)
    # Where a column ends in the next link's, the sphere around its rim reaches into that one.
    assert np.all(around.min(axis=0) > low - 0.045) and np.all(around.max(axis=0) < high + 0.045)
    outside = np.min([distance(s, X, seen) for s, X, _ in solid], axis=0)
    assert outside.max() < 5e-4


def test_distance_queries_never_fail(panda):
    _, plant, _, context = panda
    rng = np.random.default_rng(0)
    query = plant.get_geometry_query_input_port()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    for _ in range(300):
        plant.SetPositions(context, rng.uniform(lower, upper))
        query.Eval(context).ComputeSignedDistancePairwiseClosestPoints(0.1)


# --- tools ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("path", TOOLS)
def test_a_tool_has_one_shape_for_contact_and_a_valid_inertia(path):
    name = path.rpartition("/")[2]
    _, plant, _, context = scene(f"{path}.sdf", name)
    body = plant.GetBodyByName(name)
    assert plant.num_positions() == 0
    assert body.CalcSpatialInertiaInBodyFrame(context).IsPhysicallyValid()
    solid = shapes(plant, context, body, Role.kProximity)
    assert [n.rpartition("::")[2] for _, _, n in solid].count("contact") == 1
    drawn = shapes(plant, context, body, Role.kIllustration)
    seen = np.concatenate([surface(s, X) for s, X, _ in drawn])
    center = body.default_com()
    assert np.all(center >= seen.min(axis=0)) and np.all(center <= seen.max(axis=0))


def test_tool_frames_lie_on_the_contact_shapes():
    _, plant, _, context = scene("tools/press_plate.sdf", "press_plate")
    ((plate, X_BG, _),) = shapes(
        plant, context, plant.GetBodyByName("press_plate"), Role.kProximity
    )
    assert plate.size() == pytest.approx((0.064, 0.064, 0.006))
    X_TG = plant.GetFrameByName("tool").GetFixedPoseInBodyFrame().inverse() @ X_BG
    assert X_TG.IsNearlyEqualTo(RigidTransform([0, 0, -0.003]), 1e-12)
    _, plant, _, context = scene("tools/bending_pusher.sdf", "bending_pusher")
    ((rod, X_BG, _),) = shapes(
        plant, context, plant.GetBodyByName("bending_pusher"), Role.kProximity
    )
    assert isinstance(rod, Cylinder)
    assert (2 * rod.radius(), rod.length()) == pytest.approx((0.02, 0.016))
    X_TG = plant.GetFrameByName("tool").GetFixedPoseInBodyFrame().inverse() @ X_BG
    assert X_TG.translation() == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.abs(X_TG.rotation().matrix()[:, 2]) == pytest.approx((0, 1, 0), abs=1e-9)


def test_the_clamp_holds_as_in_the_paper():
    _, plant, _, context = scene("table/strip_clamp.sdf", "base")
    body = plant.GetBodyByName("strip_clamp")
    solid = shapes(plant, context, body, Role.kProximity)
    jaw = next(s for s, _, n in solid if n.endswith("contact"))
    assert jaw.size() / 2 == pytest.approx((0.025, 0.03, 0.0125))
    p_WJ = plant.GetFrameByName("jaw").CalcPoseInWorld(context).translation()
    assert p_WJ == pytest.approx((0.0, 0.0, 0.25))


def test_models_load_from_directives_too():
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = Parser(plant)
    add_package(parser)
    add_package(parser)
    text = "directives: [{add_model: {name: arm, file: package://form_drake/panda/panda.urdf}}]"
    ProcessModelDirectives(LoadModelDirectivesFromString(text), parser)
    assert plant.HasModelInstanceNamed("arm")


def test_a_scenario_takes_the_arm_of_other_packages(tmp_path):
    """A folder that stands in for Drake's own models: names as theirs, without our frame of tools."""
    drake_arm = tmp_path / "franka_description" / "urdf" / "panda_arm_hand.urdf"
    drake_arm.parent.mkdir(parents=True)
    own = (files("form_drake") / "models" / "panda" / "panda.urdf").read_text()
    frame = next(line for line in own.splitlines() if 'name="panda_hand_tcp"' in line)
    drake_arm.write_text(own.replace(frame, "").replace('mass value="0.73"', 'mass value="0.5"'))
    changes = (
        "arm=package://form_drake/panda/drake_models.dmd.yaml",
        f"packages.drake_models={tmp_path}",
        "solver.dx=0.006",
    )
    station = make_station(load_scenario("press_a", changes))
    hand = station.plant.GetBodyByName("panda_hand")
    assert hand.default_mass() == 0.5
    with pytest.raises(ValueError, match=r"package drake_models: .*nowhere is no folder"):
        make_station(load_scenario("press_a", (*changes[:1], "packages.drake_models=/nowhere")))
