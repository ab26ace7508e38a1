"""Planned motions of the arm: where the tool goes, what the joints may do, and refusals."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import LoadModelDirectivesFromString
from pydrake.trajectories import PiecewisePolynomial

from form_drake.systems.arm import HOME, Arm, Limits
from form_drake.systems.free_motion import free_move
from form_drake.systems.kinematics import inverse_kinematics, pose_error
from form_drake.systems.motion import check_limits, straight, timed_path, tool_path, torques

SCENE = """
directives:
- add_model:
    name: panda
    file: package://form_drake/panda/panda.urdf
    default_joint_positions: {{panda_finger_joint1: [0.0055], panda_finger_joint2: [0.0055]}}
- add_weld: {{parent: world, child: panda::panda_link0}}
- add_model: {{name: table, file: package://form_drake/table/table.sdf}}
- add_weld: {{parent: world, child: table::top, X_PC: {{translation: [0.3, 0, 0]}}}}
- add_model: {{name: stand, file: package://form_drake/table/{stand}.sdf}}
- add_weld:
    parent: world
    child: stand::base
    X_PC: {{translation: {where}, rotation: !Rpy {{deg: [0, 0, 180]}}}}
- add_model: {{name: tool, file: package://form_drake/tools/{tool}.sdf}}
- add_weld: {{parent: panda::panda_hand_tcp, child: tool::mount}}
"""


def load(tool, stand, where):
    text = SCENE.format(tool=tool, stand=stand, where=where)
    return Arm.load(LoadModelDirectivesFromString(text), tool="tool::tool")


@pytest.fixture(scope="module")
def press():
    return load("press_plate", "specimen_stand", [0.45, 0, 0])


@pytest.fixture(scope="module")
def bend():
    return load("bending_pusher", "strip_clamp", [0.5, 0, 0])


def down(x, y, z, yaw=0.0):
    return RigidTransform(RollPitchYaw(np.pi, 0.0, yaw), [x, y, z])


def smoothstep(u):
    u = np.clip(u, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def errors(arm, motion, wanted, samples=400):
    """Largest distance [m] and angle [rad] of the tool from a pose that is a function of time."""
    found = [
        pose_error(arm.pose(motion.value(t)[:, 0]), wanted(t))
        for t in np.linspace(0.0, motion.end_time(), samples)
    ]
    turn, shift = np.split(np.abs(found), 2, axis=1)
    return np.linalg.norm(shift, axis=1).max(), np.linalg.norm(turn, axis=1).max()


# --- inverse kinematics ---------------------------------------------------------------------------
def test_inverse_kinematics_reaches_poses_from_anywhere(press):
    rng = np.random.default_rng(1)
    for _ in range(12):
        x, y, z = rng.uniform([0.35, -0.3, 0.1], [0.6, 0.3, 0.4])
        X = down(x, y, z, yaw=rng.uniform(-0.5, 0.5))
        q = inverse_kinematics(press, X, clearance=0.01)
        assert np.abs(pose_error(press.pose(q), X)).max() < 1e-8
        assert np.all(q > press.limits.lower) and np.all(q < press.limits.upper)
        assert press.nearest(q, 0.05)[0] >= 0.01


def test_a_warm_start_stays_in_its_posture(press):
    q = inverse_kinematics(press, down(0.45, 0.0, 0.12))
    near = inverse_kinematics(press, down(0.45, 0.001, 0.12), start=q)
    assert np.abs(near - q).max() < 0.01
    assert np.array_equal(q, inverse_kinematics(press, down(0.45, 0.0, 0.12)))


@pytest.mark.parametrize(
    "X, clearance, why",
    [
        (down(1.2, 0.0, 0.1), None, r"cannot reach .* 1\.222 m from the shoulder"),
        (RigidTransform(RollPitchYaw(0, np.pi, 0), [0.8, 0, 0.2]), None, "wanted orientation"),
        (down(0.45, 0.0, 0.055), 0.01, "comes within 5.0 mm of .*; allowed are 10.0 mm"),
    ],
)
def test_a_refusal_names_the_constraint(press, X, clearance, why):
    with pytest.raises(ValueError, match=why):
        inverse_kinematics(press, X, clearance=clearance)


def test_a_refusal_names_the_joint_that_would_turn_too_far(bend):
    forward = RotationMatrix(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))
    X_WM = RigidTransform(forward, [0.5, 0.0, 0.35])
    X_MT = bend.plant.GetFrameByName("mount").CalcPose(bend.context, bend.tool).inverse()
    with pytest.raises(ValueError, match=r"only with joint \d at .* rad, outside"):
        inverse_kinematics(bend, X_WM @ X_MT)


def test_the_scene_must_be_still_and_have_the_frame(press):
    text = SCENE.format(tool="press_plate", stand="specimen_stand", where=[0.45, 0, 0])
    loose = text[: text.rindex("- add_weld")]
    with pytest.raises(ValueError, match="moving bodies besides the arm"):
        Arm.load(LoadModelDirectivesFromString(loose), tool="tool::tool")
    with pytest.raises(ValueError, match=r"has no frame 'tip'; it has: .*tool"):
        Arm.load(LoadModelDirectivesFromString(text), tool="tool::tip")
    with pytest.raises(ValueError, match="write model::frame"):
        Arm.load(LoadModelDirectivesFromString(text), tool="tool")


# --- tool paths -----------------------------------------------------------------------------------
@pytest.mark.parametrize("speed", [None, 0.02])
def test_a_straight_path_is_straight_and_keeps_the_limits(press, speed):
    X_WA, X_WB = down(0.3, -0.3, 0.15, yaw=0.2), down(0.55, 0.3, 0.35, yaw=-0.2)
    motion = tool_path(press, straight(X_WA, X_WB), speed=speed, clearance=0.01)
    p_A, p_B = X_WA.translation(), X_WB.translation()
    along = (p_B - p_A) / np.linalg.norm(p_B - p_A)
    times = np.linspace(0.0, motion.end_time(), 800)
    p = np.array([press.pose(motion.value(t)[:, 0]).translation() for t in times])
    off = (p - p_A) - np.outer((p - p_A) @ along, along)
    assert np.linalg.norm(off, axis=1).max() < 0.05e-3
    assert p[0] == pytest.approx(p_A, abs=1e-6) and p[-1] == pytest.approx(p_B, abs=1e-6)
    rates = np.linalg.norm(np.diff(p, axis=0), axis=1) / np.diff(times)
    if speed is None:
        check_limits(press, motion)
    else:
        assert rates.max() == pytest.approx(speed, rel=0.01)
    assert np.abs(motion.EvalDerivative(0.0, 1)).max() < 1e-6


def test_a_press_follows_its_schedule(press):
    """The paper's plate opening: (0, 26) (0.2, 26) (1.0, 24) (1.8, 20) (2.0, 20) s, mm."""

    def wanted(t):
        stages = 2.0 * smoothstep((t - 0.2) / 0.8) + 4.0 * smoothstep((t - 1.0) / 0.8)
        return down(0.45, 0.0, 0.05 + 1e-3 * (26.0 - stages))

    motion = timed_path(press, wanted, 2.0, clearance=0.01)
    assert motion.end_time() == 2.0
    shift, turn = errors(press, motion, wanted)
    assert shift < 1e-6 and turn < 1e-5


def test_a_bend_pushes_sideways_below_the_clamp(bend):
    """24 mm in 0.6 s; the hand stays above the clamp."""
    turned = RollPitchYaw(np.pi, 0, 0).ToRotationMatrix() @ RotationMatrix.MakeYRotation(np.pi / 2)

    def wanted(t):
        return RigidTransform(turned, [0.48 + 0.024 * smoothstep(t / 0.6), 0.0, 0.1625])

    motion = timed_path(bend, wanted, 0.6, clearance=0.01)
    shift, turn = errors(bend, motion, wanted)
    assert shift < 1e-6 and turn < 1e-5


def test_a_hasty_schedule_is_refused(press):
    def wanted(duration, way=0.1):
        return lambda t: down(0.45 + way * smoothstep(t / duration), 0.0, 0.2)

    with pytest.raises(ValueError, match=r"the speed of joint \d is .* rad/s at 0\.\d+ s; allowed"):
        timed_path(press, wanted(0.1), 0.1)
    with pytest.raises(ValueError, match=r"the acceleration of joint \d is .* rad/s\^2 at"):
        timed_path(press, wanted(0.04, 0.004), 0.04)
    with pytest.raises(ValueError, match=r"at time .* s: the tool reaches .* not with"):
        timed_path(press, lambda t: down(0.45 + 0.9 * t, 0.0, 0.2), 1.0)
    with pytest.raises(ValueError, match="lasts 0 s"):
        timed_path(press, wanted(1.0), 0.0)
    with pytest.raises(ValueError, match="give 0 < it <= 1"):
        tool_path(press, straight(down(0.4, 0, 0.2), down(0.5, 0, 0.2)), fraction=2.0)


def test_torques_hold_the_arm_up_and_are_limited(press, monkeypatch):
    q, still = HOME[None], np.zeros((1, 7))
    gravity = press.plant.CalcGravityGeneralizedForces(press.place(HOME))[press.index]
    held = torques(press, q, still, still)
    assert held[0] == pytest.approx(-gravity)
    assert np.abs(held).max() > 10.0
    rows = np.array([getattr(press.limits, n) for n in ("lower", "upper", "velocity")])
    weak = Limits(*rows, press.limits.acceleration, np.full(7, 1.0))
    monkeypatch.setitem(press.__dict__, "limits", weak)
    with pytest.raises(ValueError, match="torque of joint 2"):
        timed_path(press, lambda t: down(0.45, 0.0, 0.2), 0.1)


# --- free moves -----------------------------------------------------------------------------------
def test_a_free_move_goes_around_the_stand(press):
    ends = [inverse_kinematics(press, down(0.45, y, 0.03), clearance=0.01) for y in (-0.2, 0.2)]
    motion = free_move(press, *ends, clearance=0.01)
    times = np.linspace(0.0, motion.end_time(), 200)
    q = np.array([motion.value(t)[:, 0] for t in times])
    assert q[[0, -1]] == pytest.approx(np.array(ends), abs=1e-6)
    assert min(press.nearest(a, 0.05)[0] for a in q) >= 0.0095
    for order, most in ((1, press.limits.velocity), (2, press.limits.acceleration)):
        rates = np.array([motion.EvalDerivative(t, order)[:, 0] for t in times])
        assert np.all(np.abs(rates).max(axis=0) <= 0.5 * most * 1.01)
        assert np.abs(rates[[0, -1]]).max() < 1e-3
    blind = free_move(press, *ends, clearance=None)
    assert min(press.nearest(blind.value(t)[:, 0], 0.05)[0] for t in times) < 0.0


def test_a_free_move_brings_the_pusher_past_the_clamp(bend):
    turned = RollPitchYaw(np.pi, 0, 0).ToRotationMatrix() @ RotationMatrix.MakeYRotation(np.pi / 2)
    end = inverse_kinematics(bend, RigidTransform(turned, [0.48, 0.0, 0.1625]), clearance=0.01)
    motion = free_move(bend, HOME, end, clearance=0.005)
    times = np.linspace(0.0, motion.end_time(), 200)
    assert min(bend.nearest(motion.value(t)[:, 0], 0.05)[0] for t in times) >= 0.0045
    check_limits(bend, motion, fraction=0.6)


def test_a_long_motion_is_looked_at_as_closely_as_a_short_one(press):
    """A joint that hurries for 50 ms is found in a minute too."""
    for duration in (4.0, 60.0):
        knots = [0.0, 0.4 * duration, 0.4 * duration + 0.05, duration]
        q = np.tile(HOME, (4, 1)).T
        q[0, 2:] += 0.3
        hurried = PiecewisePolynomial.FirstOrderHold(knots, q)
        with pytest.raises(ValueError, match="speed of joint 1 is 6 rad/s"):
            check_limits(press, hurried)


def test_a_free_move_refuses_bad_ends(press):
    far = HOME + 3.0 * np.eye(7)[3]
    with pytest.raises(ValueError, match=r"the end posture has joint 4 at 0.800 rad"):
        free_move(press, HOME, far)
    low = inverse_kinematics(press, down(0.45, 0.0, 0.055))
    with pytest.raises(ValueError, match=r"in the start posture .* is 5.0 mm from"):
        free_move(press, low, HOME, clearance=0.01)
