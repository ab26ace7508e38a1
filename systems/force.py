"""Force as the robot measures it: external joint torques, sensor errors, the wrench at the tool."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from form_drake.control import tool_wrench
from form_drake.systems.arm import JOINTS, arm_joints


def draws(seed: int, signal: str, number: int) -> np.random.Generator:
    """What the noise of one sample of a signal is drawn from: the same whenever it is asked for."""
    return np.random.default_rng((seed, *signal.encode(), number))


@dataclass
class SensorErrors:
    """What a sensor adds to a signal. The defaults add nothing.

    Attributes:
        bias: constant error, one value or one each, in the unit of the signal.
        noise: standard deviation of white noise, one value or one each, in the unit of the signal.
        bandwidth: of a first-order low-pass filter [Hz]; 0: none.
        period: between samples [s].
        seed: of the noise.
    """

    bias: list[float] = field(default_factory=lambda: [0.0])
    noise: list[float] = field(default_factory=lambda: [0.0])
    bandwidth: float = 0.0
    period: float = 0.001
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.noise, default=-1.0) < 0.0 or self.bandwidth < 0.0 or not self.period > 0.0:
            raise ValueError(
                f"sensor noise {self.noise}, bandwidth {self.bandwidth:g} Hz, period"
                f" {self.period:g} s: noise and bandwidth must not be negative, the period positive"
            )


class Sensor(LeafSystem):
    """A signal as a sensor reports it: biased, noisy, low-passed, held between samples not at all.

    Noise is a function of seed, signal and sample number, the filter's memory is in the Context: a
    cloned or rewound Context repeats every sample. At sample times the output has no delay but the
    filter's.

    Args:
        size: of the signal.
        errors: of the sensor.
        signal: what it is, so that sensors of one seed are independent.
    """

    def __init__(self, size: int, errors: SensorErrors, signal: str = "force") -> None:
        super().__init__()
        for name in ("bias", "noise"):
            if len(getattr(errors, name)) not in (1, size):
                raise ValueError(
                    f"{name} of the sensor has {len(getattr(errors, name))} values: give 1 or"
                    f" {size}"
                )
        self._errors, self._size, self._signal = errors, size, signal
        cutoff = 2.0 * np.pi * errors.bandwidth * errors.period
        self._share = -np.expm1(-cutoff) if errors.bandwidth else 1.0
        self.DeclareVectorInputPort("ideal", size)
        self.DeclareVectorOutputPort("measured", size, self._calc)
        self._memory = self.DeclareDiscreteState(np.zeros(size))
        # before what else changes at that time, as a recorder reads it
        self.DeclarePeriodicUnrestrictedUpdateEvent(errors.period, 0.0, self._remember)

    def _measured(self, context: Context) -> np.ndarray:
        errors = self._errors
        sample = round(context.get_time() / errors.period)
        drawn = draws(errors.seed, self._signal, sample).standard_normal(self._size)
        raw = self.get_input_port().Eval(context) + errors.bias + errors.noise * drawn
        last = context.get_discrete_state(self._memory).value()
        return last + self._share * (raw - last)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._measured(context))

    def _remember(self, context: Context, state: State) -> EventStatus:
        memory = state.get_mutable_discrete_state().get_mutable_vector(self._memory)
        memory.SetFromVector(self._measured(context))
        return EventStatus.Succeeded()


class ToolForce(LeafSystem):
    """The force of the material on the tool, from the arm's joints.

    Ports: in ``position`` [rad] and ``torque_external`` [N m], seven each; out ``force``, f_T_W [N]
    at the tool frame's origin in W, and ``wrench``, F_T_W: moment [N m] above force [N].
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        tool: Frame,
        *,
        model: str = "panda",
        sd: np.ndarray | None = None,
    ) -> None:
        """Args as for ``tool_wrench``; ``tool`` is the frame T, moved by the arm ``model``."""
        super().__init__()
        self._plant, self._tool, self._sd = plant, tool, sd
        joints = arm_joints(plant, model)
        self._positions = np.array([j.position_start() for j in joints])
        self._velocities = np.array([j.velocity_start() for j in joints])
        self._context = plant.CreateDefaultContext()
        self.DeclareVectorInputPort("position", JOINTS)
        self.DeclareVectorInputPort("torque_external", JOINTS)
        self.DeclareVectorOutputPort("wrench", 6, self._calc_wrench)
        self.DeclareVectorOutputPort("force", 3, self._calc_force)

    def _wrench(self, context: Context) -> np.ndarray:
        position, torque = (self.get_input_port(i).Eval(context) for i in range(2))
        q = self._plant.GetPositions(self._context)
        q[self._positions] = position
        self._plant.SetPositions(self._context, q)
        world = self._plant.world_frame()
        J = self._plant.CalcJacobianSpatialVelocity(
            self._context, JacobianWrtVariable.kV, self._tool, np.zeros(3), world, world
        )
        return tool_wrench(J[:, self._velocities], torque, self._sd)[0]

    def _calc_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._wrench(context))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._wrench(context)[3:])
