"""The simulated Panda: it holds, follows, and measures what pushes its tool."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.common.yaml import yaml_load_typed
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import LoadModelDirectivesFromString, Parser, ProcessModelDirectives
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    ExternallyAppliedSpatialForce,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource, LogVectorOutput

from form_drake.control import Follow, Progress, advanced, tool_wrench
from form_drake.systems.arm import Arm, add_package, exclude_held_tool
from form_drake.systems.follower import PathFollower
from form_drake.systems.force import Sensor, SensorErrors, ToolForce
from form_drake.systems.kinematics import inverse_kinematics
from form_drake.systems.motion import straight, timed_path, tool_path
from form_drake.systems.panda import PandaDriver, add_panda, apply_panda

SCENE = LoadModelDirectivesFromString("""
directives:
- add_model:
    name: panda
    file: package://form_drake/panda/panda.urdf
    default_joint_positions: {panda_finger_joint1: [0.0055], panda_finger_joint2: [0.0055]}
- add_weld: {parent: world, child: panda::panda_link0}
- add_model: {name: press_plate, file: package://form_drake/tools/press_plate.sdf}
- add_weld: {parent: panda::panda_hand_tcp, child: press_plate::mount}
""")
F = np.array([0.2, -0.1, 0.3, 1.0, 2.0, 30.0])  # a wrench on the tool [N m, N]


def down(x, y, z):
    return RigidTransform(RollPitchYaw(np.pi, 0.0, 0.0), [x, y, z])


@pytest.fixture(scope="module")
def arm():
    return Arm.load(SCENE)


@pytest.fixture(scope="module")
def q0(arm):
    return inverse_kinematics(arm, down(0.45, 0.0, 0.12))


class Spring(LeafSystem):
    """A one-sided spring under the tool, as a force on it: 5 kN/m below z = 0.11 m."""

    def __init__(self, plant, tool):
        super().__init__()
        self._body, self._p_BT = tool.body(), tool.GetFixedPoseInBodyFrame().translation()
        self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        empty = [ExternallyAppliedSpatialForce()]
        self.DeclareAbstractOutputPort("forces", lambda: AbstractValue.Make(empty), self._calc)

    def _calc(self, context, output):
        X_WB = self.get_input_port().Eval(context)[int(self._body.index())]
        depth = max(0.0, 0.11 - (X_WB @ self._p_BT)[2])
        output.set_value([applied(self._body, self._p_BT, [0, 0, 0, 0, 0, 5e3 * depth])])


def applied(body, p_BT, wrench):
    force = ExternallyAppliedSpatialForce()
    force.body_index, force.p_BoBq_B = body.index(), p_BT
    force.F_Bq_W = SpatialForce(np.asarray(wrench, dtype=float))
    return force


class Bench:
    """A Panda with the press plate, driven by ``source``, and what it measures."""

    def __init__(self, q0, *, source=None, wrench=None, load=0.0, spring=False, driver=None):
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=1e-3, use_sampled_output_ports=False)
        config.discrete_contact_approximation = "lagged"
        self.plant, scene_graph = AddMultibodyPlant(config, builder)
        parser = Parser(self.plant)
        add_package(parser)
        ProcessModelDirectives(SCENE, parser)
        exclude_held_tool(self.plant, scene_graph, tool="press_plate")
        model = self.plant.GetModelInstanceByName("press_plate")
        self.tool = self.plant.GetFrameByName("tool", model)
        if load:
            inertia = SpatialInertia.SolidSphereWithMass(load, 0.02)
            body = self.plant.AddRigidBody("load", self.plant.AddModelInstance("load"), inertia)
            self.plant.WeldFrames(self.tool, body.body_frame(), RigidTransform([0, 0, 0.05]))
        driver = driver or PandaDriver(compensated=["press_plate"])
        apply_panda(self.plant, driver)
        self.plant.Finalize()
        panda = add_panda(builder, self.plant, driver)
        self.force = builder.AddSystem(ToolForce(self.plant, self.tool))
        for theirs, ours in (("position_measured", "position"), ("torque_external",) * 2):
            builder.Connect(panda.GetOutputPort(theirs), self.force.GetInputPort(ours))
        source = builder.AddSystem(source or ConstantVectorSource(q0))
        builder.Connect(source.get_output_port(0), panda.GetInputPort("position"))
        if isinstance(source, PathFollower):
            builder.Connect(self.force.GetOutputPort("force"), source.GetInputPort("force"))
        self._push(builder, wrench, spring)
        self.log = LogVectorOutput(self.force.GetOutputPort("wrench"), builder, 0.01)
        self.q_log = LogVectorOutput(panda.GetOutputPort("position_measured"), builder, 0.01)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        instance = self.plant.GetModelInstanceByName("panda")
        self.plant.SetPositions(self.plant_context, instance, np.append(q0, [0.0055, 0.0055]))

    def _push(self, builder, wrench, spring):
        port = self.plant.get_applied_spatial_force_input_port()
        p_BT = self.tool.GetFixedPoseInBodyFrame().translation()
        if wrench is not None:
            force = [applied(self.tool.body(), p_BT, wrench)]
            source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(force)))
            builder.Connect(source.get_output_port(), port)
        if spring:
            spring = builder.AddSystem(Spring(self.plant, self.tool))
            builder.Connect(self.plant.get_body_poses_output_port(), spring.get_input_port())
            builder.Connect(spring.get_output_port(), port)

    @property
    def plant_context(self):
        return self.plant.GetMyMutableContextFromRoot(self.context)

    def wrench(self):
        context = self.force.GetMyContextFromRoot(self.context)
        return self.force.GetOutputPort("wrench").Eval(context)

    def p_WT(self):
        return self.tool.CalcPoseInWorld(self.plant_context).translation()


# --- what the arm feels ---------------------------------------------------------------------------
def test_a_kilogram_on_the_tool_weighs_a_kilogram(q0):
    bench = Bench(q0, load=1.0)
    bench.simulator.AdvanceTo(0.8)
    moment, force = np.split(bench.wrench(), 2)
    assert force == pytest.approx((0.0, 0.0, -9.81), abs=1e-3)
    assert moment == pytest.approx(np.zeros(3), abs=5e-3)


def test_the_arm_feels_a_wrench_at_rest_and_at_once(q0):
    bench = Bench(q0, wrench=F)
    bench.simulator.AdvanceTo(0.002)
    assert bench.wrench() == pytest.approx(F, abs=1e-4)
    bench.simulator.AdvanceTo(0.8)
    assert bench.wrench() == pytest.approx(F, abs=1e-4)


def test_the_arm_feels_the_wrench_while_it_moves(arm, q0):
    motion = tool_path(arm, straight(down(0.45, 0, 0.12), down(0.45, 0.1, 0.2)), start=q0)
    bench = Bench(q0, source=PathFollower(motion, Follow()), wrench=F)
    bench.simulator.AdvanceTo(motion.end_time())
    assert np.abs(bench.log.FindLog(bench.context).data() - F[:, None]).max() < 1e-3


def test_a_tool_it_was_not_told_of_is_felt(q0):
    bench = Bench(q0, driver=PandaDriver())
    bench.simulator.AdvanceTo(0.8)
    assert bench.wrench()[3:] == pytest.approx((0.0, 0.0, -0.0865 * 9.81), abs=1e-3)


def test_the_arm_follows_a_slow_press(arm, q0):
    motion = timed_path(arm, lambda t: down(0.45, 0.0, 0.12 - 0.02 * t * t), 1.0, start=q0)
    bench = Bench(q0, source=PathFollower(motion, Follow()))
    bench.simulator.AdvanceTo(1.0)
    log = bench.q_log.FindLog(bench.context)
    wanted = np.array([motion.value(t)[:, 0] for t in log.sample_times()])
    assert np.abs(log.data().T - wanted).max() < 3e-4


# --- the wrench from joint torques ----------------------------------------------------------------
def test_the_wrench_is_the_least_squares_one(arm, q0):
    J = arm.jacobian(q0)
    found, condition = tool_wrench(J, J.T @ F)
    assert found == pytest.approx(F, abs=1e-4)
    assert 15.0 < condition < 30.0
    rng = np.random.default_rng(0)
    sd = np.array([0.2, 0.2, 0.2, 0.2, 0.05, 0.05, 0.05])
    noise = rng.standard_normal((2000, 7)) * sd
    plain, weighted = (
        np.std([tool_wrench(J, J.T @ F + n, s)[0] for n in noise], axis=0) for s in (None, sd)
    )
    expected = np.sqrt(np.diag(np.linalg.inv(J @ np.diag(sd**-2) @ J.T)))
    assert weighted == pytest.approx(expected, rel=0.06)
    assert np.all(weighted <= 1.02 * plain)


class Ramp(LeafSystem):
    def __init__(self, size):
        super().__init__()
        self.DeclareVectorOutputPort("y", size, self._calc)

    def _calc(self, context, output: BasicVector):
        output.SetFromVector(np.full(output.size(), context.get_time()))


class Advancing(LeafSystem):
    """Is one from a time on, by an update like that of a material: the mean of the period that follows."""

    def __init__(self, at):
        super().__init__()
        self._at = at
        self._value = self.DeclareAbstractState(Value[object](0.0))
        ticket = {self.abstract_state_ticket(self._value)}
        self.DeclareVectorOutputPort("y", 3, self._calc, ticket)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1e-3, 0.0, self._update)

    def _calc(self, context, output: BasicVector):
        output.SetFromVector(np.full(3, context.get_abstract_state(int(self._value)).get_value()))

    def _update(self, context, state):
        now = float(context.get_time() > self._at - 1e-9)
        state.get_mutable_abstract_state(int(self._value)).set_value(now)
        return EventStatus.Succeeded()


class Listener(LeafSystem):
    """Hears a signal as the recorder does."""

    def __init__(self):
        super().__init__()
        self.heard = []
        self.DeclareVectorInputPort("y", 3)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1e-3, 0.0, self._hear)

    def _hear(self, context, state):
        self.heard.append(self.get_input_port().Eval(context)[0])
        return EventStatus.Succeeded()


def measured(errors, *, size=3, source=None, until=2.0, signal="force"):
    builder = DiagramBuilder()
    source = builder.AddSystem(source or ConstantVectorSource(np.ones(size)))
    sensor = builder.AddSystem(Sensor(size, errors, signal))
    builder.Connect(source.get_output_port(0), sensor.get_input_port())
    log = LogVectorOutput(sensor.get_output_port(), builder, errors.period)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(until)
    return log.FindLog(simulator.get_context()), simulator


def test_bias_and_noise_have_the_stated_sizes():
    bias, noise = [0.1, -0.2, 0.3], [0.05, 0.02, 0.01]
    log, _ = measured(SensorErrors(bias=bias, noise=noise, seed=3))
    y = log.data()
    assert y.mean(axis=1) - 1.0 == pytest.approx(bias, abs=5e-3)
    assert y.std(axis=1) == pytest.approx(noise, rel=0.06)
    white = (y[0] - y[0].mean()) / y[0].std()
    assert abs(np.mean(white[1:] * white[:-1])) < 0.07
    other = measured(SensorErrors(bias=bias, noise=noise, seed=4), until=0.1)[0].data()
    assert not np.allclose(other, y[:, : other.shape[1]])


def test_a_perfect_sensor_adds_and_delays_nothing():
    log, _ = measured(SensorErrors(), source=Ramp(3), until=0.05)
    assert log.data()[0] == pytest.approx(log.sample_times(), abs=1e-15)


def test_the_filter_is_of_first_order():
    log, _ = measured(SensorErrors(bandwidth=10.0), until=0.1)
    t = log.sample_times() + 1e-3
    assert log.data()[0] == pytest.approx(1.0 - np.exp(-2 * np.pi * 10.0 * t), abs=1e-9)


def test_a_filter_takes_in_every_sample_once():
    """A force that a material begins to exert at 20 ms is heard one period later, through the filter."""
    errors = SensorErrors(bandwidth=50.0)
    builder = DiagramBuilder()
    sensor, ear = builder.AddSystem(Sensor(3, errors)), builder.AddSystem(Listener())
    source = builder.AddSystem(Advancing(0.02))
    builder.Connect(source.get_output_port(), sensor.get_input_port())
    builder.Connect(sensor.get_output_port(), ear.get_input_port())
    Simulator(builder.Build()).AdvanceTo(0.04)
    share = 1.0 - np.exp(-2.0 * np.pi * 50.0 * 1e-3)
    expected = 1.0 - (1.0 - share) ** np.arange(1, 20)
    assert not np.any(ear.heard[:21]) and ear.heard[21:40] == pytest.approx(expected, abs=1e-12)


def test_sensors_of_one_seed_are_independent():
    errors = SensorErrors(noise=[1.0])
    one, other = (
        measured(errors, until=0.5, signal=s)[0].data() - 1.0 for s in ("force", "torque")
    )
    assert abs(np.mean(one * other)) < 0.1 < np.mean(one**2)


def test_a_cloned_context_repeats_every_sample(arm, q0):
    _, simulator = measured(SensorErrors(noise=[1.0], bandwidth=50.0, seed=7), until=0.05)
    motion = tool_path(arm, straight(down(0.45, 0, 0.12), down(0.45, 0, 0.1)), start=q0)
    bench = Bench(q0, source=PathFollower(motion, Follow(until_force=10.0)), spring=True)
    bench.simulator.AdvanceTo(0.05)
    for run in (simulator, bench.simulator):
        replay = Simulator(run.get_system(), run.get_context().Clone())
        for each in (run, replay):
            each.AdvanceTo(0.1)
        one, two = (r.get_context().get_discrete_state() for r in (run, replay))
        for i in range(one.num_groups()):
            assert np.array_equal(one.value(i), two.value(i))


# --- following a path up to a force ---------------------------------------------------------------
def test_a_press_stops_at_the_force_and_returns(arm, q0):
    path = straight(down(0.45, 0, 0.112), down(0.45, 0, 0.10))
    motion = tool_path(arm, path, start=q0, speed=0.01)
    follow = Follow(begin=0.1, until_force=10.0, hold=0.3)
    source = PathFollower(motion, follow)
    bench = Bench(motion.value(0.0)[:, 0], source=source, spring=True)
    context, along = source.GetMyContextFromRoot(bench.context), source.GetOutputPort("time_along")
    bench.simulator.AdvanceTo(0.9)
    assert 0.0 < along.Eval(context)[0] < motion.end_time()
    assert 10.0 < bench.log.FindLog(bench.context).data()[5].max() < 11.0
    assert bench.wrench()[5] == pytest.approx(5e3 * (0.11 - bench.p_WT()[2]), rel=0.01)
    bench.simulator.AdvanceTo(1.8)
    assert along.Eval(context)[0] == 0.0
    assert bench.p_WT() == pytest.approx((0.45, 0.0, 0.112), abs=1e-4)


def test_an_unhindered_follower_is_on_time():
    now, follow = Progress(), Follow(begin=0.01)
    for n in range(100):
        now = advanced(now, follow, time=1e-3 * n, step=1e-3, end=0.05, force=1e9)
        assert now.along == pytest.approx(np.clip(1e-3 * (n + 1) - 0.01, 0.0, 0.05), abs=1e-12)
    assert not now.stopped


def test_a_stop_stays_when_it_is_not_told_to_return():
    now, follow = Progress(along=0.5, rate=1.0), Follow(until_force=5.0, brake=0.01)
    rates = []
    for n in range(50):
        now = advanced(now, follow, time=1e-3 * n, step=1e-3, end=1.0, force=6.0 if n == 0 else 0.0)
        rates.append(now.rate)
    assert np.all(np.diff(rates) <= 0.0) and now.rate == 0.0
    assert now.along == pytest.approx(0.505)


def test_a_follower_without_force_says_so(arm, q0):
    motion = tool_path(arm, straight(down(0.45, 0, 0.12), down(0.45, 0, 0.1)), start=q0)
    follower = PathFollower(motion, Follow(until_force=10.0))
    with pytest.raises(ValueError, match="needs the port force"):
        Simulator(follower).AdvanceTo(0.01)


# --- settings -------------------------------------------------------------------------------------
def test_settings_load_from_yaml():
    text = "{stiffness: [4000, 4000, 4000, 4000, 4000, 4000, 4000], compensated: [press_plate]}"
    driver = yaml_load_typed(schema=PandaDriver, data=text)
    assert driver.stiffness[0] == 4000.0 and driver.compensated == ["press_plate"]
    errors = yaml_load_typed(schema=SensorErrors, data="{noise: [0.1], bandwidth: 30, seed: 2}")
    assert errors == SensorErrors(noise=[0.1], bandwidth=30.0, seed=2)
    assert yaml_load_typed(schema=Follow, data="{until_force: 10}") == Follow(until_force=10.0)


@pytest.mark.parametrize(
    "make, why",
    [
        (lambda: PandaDriver(control_mode="torque"), "'torque' .* allowed: position"),
        (lambda: PandaDriver(stiffness=[1.0]), "give 7 positive values"),
        (lambda: PandaDriver(fingers=0.1), "give 0 to 0.04"),
        (lambda: SensorErrors(noise=[-1.0]), "must not be negative"),
        (lambda: Sensor(3, SensorErrors(bias=[1.0, 2.0])), "give 1 or 3"),
        (lambda: Follow(until_force=-1.0), "give a positive force"),
        (lambda: Follow(brake=0.0), "brake must be positive"),
    ],
)
def test_bad_settings_are_refused(make, why):
    with pytest.raises(ValueError, match=why):
        make()


def test_a_tool_that_is_not_there_cannot_be_compensated(q0):
    with pytest.raises(ValueError, match="'spoon', which is not in the scene"):
        Bench(q0, driver=PandaDriver(compensated=["spoon"]))
