"""The simulated Panda: position control as the robot does it, and what the robot reports.

The arm follows joint angles by implicit proportional-derivative control, its own weight and that of
the tool it holds compensated, as the Franka Control Interface does. Ports have the names and signs
of ``PandaStatusReceiver``, but ``torque_external`` follows Drake: the torque that the world exerts
on the joints.
"""

from dataclasses import dataclass, field

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, PdControllerGains
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Demultiplexer

from form_drake.systems.arm import JOINTS, arm_joints

FINGERS = 2
MOTORS = tuple(f"panda_motor{i + 1}" for i in range(JOINTS))
FINGER_MOTORS = tuple(f"panda_finger_motor{i + 1}" for i in range(FINGERS))
FINGER_GAINS = (2000.0, 40.0)
"""Stiffness [N/m] and damping [N s/m] that hold a finger."""


@dataclass
class PandaDriver:
    """How a simulated Panda is driven.

    Attributes:
        control_mode: "position", the only mode yet.
        stiffness: of the joints [N m/rad], shape [7]; libfranka's own values for joint impedance,
            by which a tool that presses with 30 N gives way by 5 mm and 10 mrad.
        damping: of the joints [N m s/rad], shape [7].
        fingers: where each finger is held [m], 0 (closed) to 0.04.
        compensated: models besides the arm whose weight the robot knows and bears: its tools.
    """

    control_mode: str = "position"
    stiffness: list[float] = field(
        default_factory=lambda: [3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0]
    )
    damping: list[float] = field(
        default_factory=lambda: [110.0, 110.0, 90.0, 80.0, 50.0, 40.0, 40.0]
    )
    fingers: float = 0.0055
    compensated: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.control_mode != "position":
            raise ValueError(
                f"control_mode {self.control_mode!r} of the Panda is not known; allowed: position"
            )
        for name in ("stiffness", "damping"):
            values = getattr(self, name)
            if len(values) != JOINTS or min(values) <= 0.0:
                raise ValueError(f"{name} of the Panda is {values}: give {JOINTS} positive values")
        if not 0.0 <= self.fingers <= 0.04:
            raise ValueError(f"the fingers are at {self.fingers:g} m: give 0 to 0.04")


def apply_panda(plant: MultibodyPlant, driver: PandaDriver, *, model: str = "panda") -> None:
    """Gives the arm its controller; before ``plant.Finalize()``.

    Args:
        plant: discrete, with a SAP contact solver (``discrete_contact_approximation`` other than
            ``tamsi``): Drake's implicit control needs it.
        driver: gains and compensated models.
        model: name of the arm's model.

    Raises:
        ValueError: a compensated model is not in the plant.
    """
    instance = plant.GetModelInstanceByName(model)
    plant.set_gravity_enabled(instance, False)
    for name in driver.compensated:
        if not plant.HasModelInstanceNamed(name):
            raise ValueError(f"the Panda is to compensate {name!r}, which is not in the scene")
        plant.set_gravity_enabled(plant.GetModelInstanceByName(name), False)
    arm = zip(MOTORS, zip(driver.stiffness, driver.damping, strict=True), strict=True)
    for name, (p, d) in (*arm, *((finger, FINGER_GAINS) for finger in FINGER_MOTORS)):
        motor = plant.GetJointActuatorByName(name, instance)
        motor.set_controller_gains(PdControllerGains(p=p, d=d))


def add_panda(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    driver: PandaDriver,
    *,
    model: str = "panda",
) -> Diagram:
    """Connects the arm to its controller; after ``plant.Finalize()``.

    Args:
        builder: holds ``plant``.
        plant: prepared by ``apply_panda``; ``use_sampled_output_ports=False`` makes the external
            torque that of the instant.
        driver: as given to ``apply_panda``.
        model: name of the arm's model.

    Returns:
        A Diagram with input ``position`` [rad] and outputs ``position_measured`` [rad],
        ``velocity_measured`` [rad/s] and ``torque_external`` [N m], seven each.
    """
    instance = plant.GetModelInstanceByName(model)
    inside = DiagramBuilder()
    command = inside.AddNamedSystem("command", PositionCommand(driver, plant.time_step()))
    states = inside.AddNamedSystem("state", Demultiplexer([JOINTS, FINGERS, JOINTS, FINGERS]))
    external = inside.AddNamedSystem("external", ExternalTorque(plant, model))
    inside.ExportInput(command.get_input_port(), "position")
    inside.ExportInput(states.get_input_port(), "state")
    for name in ("plant_state", "acceleration", "actuation"):
        inside.ExportInput(external.GetInputPort(name), name)
    inside.ExportOutput(command.get_output_port(), "desired_state")
    inside.ExportOutput(states.get_output_port(0), "position_measured")
    inside.ExportOutput(states.get_output_port(2), "velocity_measured")
    inside.ExportOutput(external.get_output_port(), "torque_external")
    panda = builder.AddNamedSystem(f"{model}_driver", inside.Build())
    for source, name in (
        (plant.get_state_output_port(instance), "state"),
        (plant.get_state_output_port(), "plant_state"),
        (plant.get_generalized_acceleration_output_port(), "acceleration"),
        (plant.get_net_actuation_output_port(), "actuation"),
    ):
        builder.Connect(source, panda.GetInputPort(name))
    builder.Connect(
        panda.GetOutputPort("desired_state"), plant.get_desired_state_input_port(instance)
    )
    return panda


class PositionCommand(LeafSystem):
    """Joint positions in, the state that the controller follows out.

    Speeds are backward differences over one period [s], so that the damping does not drag; none before
    the first sample is remembered. Nothing is delayed: the output belongs to the time of the input.
    """

    def __init__(self, driver: PandaDriver, period: float) -> None:
        super().__init__()
        self._driver, self._period = driver, period
        self.DeclareVectorInputPort("position", JOINTS)
        self._previous = self.DeclareDiscreteState(np.zeros(JOINTS + 1))
        self.DeclareVectorOutputPort("desired_state", 2 * (JOINTS + FINGERS), self._calc)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._remember)

    def _calc(self, context: Context, output: BasicVector) -> None:
        q = self.get_input_port().Eval(context)
        *last, begun = context.get_discrete_state(self._previous).value()
        v = begun * (q - np.array(last)) / self._period
        fingers = np.full(FINGERS, self._driver.fingers)
        output.SetFromVector(np.concatenate([q, fingers, v, np.zeros(FINGERS)]))

    def _remember(self, context: Context, state) -> None:
        q = self.get_input_port().Eval(context)
        state.get_mutable_vector(self._previous).SetFromVector(np.append(q, 1.0))


class ExternalTorque(LeafSystem):
    """The torque that the world exerts on the joints: what the motors do not account for.

    tau_external = M(q) vdot + C(q, v) v - tau_motor, with M and C of the arm and all that is welded
    to it; what the robot reports from its torque sensors, without their errors. It feels contacts,
    applied forces and the weight of what it was not told to carry. Under wrenches F it is J^T F, in
    motion too, for it is taken from the plant's own step.
    """

    def __init__(self, plant: MultibodyPlant, model: str) -> None:
        super().__init__()
        self._plant = plant
        instance = plant.GetModelInstanceByName(model)
        self._rows = np.array([j.velocity_start() for j in arm_joints(plant, model)])
        motors = (plant.GetJointActuatorByName(name, instance) for name in MOTORS)
        self._motors = np.array([m.input_start() for m in motors])
        self._context = plant.CreateDefaultContext()
        nx = plant.num_multibody_states()
        self.DeclareVectorInputPort("plant_state", nx)
        self.DeclareVectorInputPort("acceleration", plant.num_velocities())
        self.DeclareVectorInputPort("actuation", plant.num_actuated_dofs())
        self.DeclareVectorOutputPort("torque_external", JOINTS, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        x, vdot, motors = (self.get_input_port(i).Eval(context) for i in range(3))
        self._plant.SetPositionsAndVelocities(self._context, x)
        none = MultibodyForces(self._plant)
        needed = self._plant.CalcInverseDynamics(self._context, vdot, none)
        output.SetFromVector(needed[self._rows] - motors[self._motors])
