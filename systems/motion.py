"""Motions of the arm: along a tool path, on a given schedule, and freely between two postures."""

from collections.abc import Callable

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.optimization import CalcGridPointsOptions, Toppra
from pydrake.multibody.tree import MultibodyForces
from pydrake.trajectories import (
    PathParameterizedTrajectory,
    PiecewisePolynomial,
    PiecewiseQuaternionSlerp,
    Trajectory,
)

from form_drake.systems.arm import Arm, Limits
from form_drake.systems.kinematics import allowed, inverse_kinematics, newton, outside

SLACK = 1.02
"""Share of a limit at which a motion is refused; planners stay below the limit itself."""
LOOK, FEWEST = 0.005, 400
"""Time between looks at the limits [s], and the fewest looks."""

Path = Callable[[float], RigidTransform]


def straight(X_WA: RigidTransform, X_WB: RigidTransform) -> Path:
    """The straight tool path from A (s = 0) to B (s = 1), turning evenly."""
    turn = PiecewiseQuaternionSlerp([0.0, 1.0], [X.rotation().ToQuaternion() for X in (X_WA, X_WB)])
    p_A, p_B = X_WA.translation(), X_WB.translation()

    def path(s: float) -> RigidTransform:
        return RigidTransform(RotationMatrix(turn.orientation(s)), p_A + s * (p_B - p_A))

    return path


def tool_path(
    arm: Arm,
    X_WT: Path,
    *,
    start: np.ndarray | None = None,
    knots: int = 51,
    speed: float | None = None,
    fraction: float = 0.9,
    clearance: float | None = None,
) -> Trajectory:
    """The fastest motion along a tool path, from rest to rest.

    Warm-started inverse kinematics at the knots, cubic joint splines between them, and Toppra
    (Pham and Pham, IEEE T-RO 2018) for the speed along them.

    Args:
        arm: the arm and its scene.
        X_WT: tool pose as a function of the path parameter in [0, 1], twice differentiable.
        start: joint angles [rad] near which the path begins, shape [7].
        knots: poses along the path that are met exactly.
        speed: largest speed of the tool frame's origin [m/s]; None: as the joints allow.
        fraction: of the joints' velocity, acceleration and torque limits to be used.
        clearance: smallest distance [m] between any two bodies at the knots; None: not looked at.

    Returns:
        Joint angles [rad], 7 rows, from time 0.

    Raises:
        ValueError: a pose is not reachable or too near something, or Toppra finds no speed.
    """
    s = np.linspace(0.0, 1.0, knots)
    q = _follow(arm, X_WT, s, start, clearance, "path parameter", "")
    path = _spline(s, q)
    whole = _spline(s, arm.whole(q))
    grid = Toppra.CalcGridPoints(whole, CalcGridPointsOptions())
    toppra = Toppra(whole, arm.plant, grid)
    bounds = _plant_bounds(arm, arm.limits.scaled(fraction))
    toppra.AddJointVelocityLimit(-bounds[0], bounds[0])
    toppra.AddJointAccelerationLimit(-bounds[1], bounds[1])
    toppra.AddJointTorqueLimit(-bounds[2], bounds[2])
    if speed is not None:
        toppra.AddFrameTranslationalSpeedLimit(arm.tool, speed)
    schedule = toppra.SolvePathParameterization()
    if schedule is None:
        raise ValueError("no speed along the tool path keeps the joint limits: use a smoother path")
    found = PathParameterizedTrajectory(path, schedule)
    check_limits(arm, found)
    return found


def timed_path(
    arm: Arm,
    X_WT: Path,
    duration: float,
    *,
    start: np.ndarray | None = None,
    period: float = 0.01,
    fraction: float = 1.0,
    clearance: float | None = None,
) -> Trajectory:
    """A motion that puts the tool where it is wanted at every time.

    Args:
        arm: the arm and its scene.
        X_WT: tool pose as a function of time [s] in [0, duration].
        duration: length of the motion [s].
        start: joint angles [rad] near which it begins, shape [7].
        period: time between the poses that are met exactly [s]; splines lie between them.
        fraction: of the joints' velocity, acceleration and torque limits that may be used.
        clearance: smallest distance [m] between any two bodies at the knots; None: not looked at.

    Returns:
        Joint angles [rad], 7 rows, over [0, duration].

    Raises:
        ValueError: a pose is not reachable or too near something, or a joint limit is exceeded;
            the line names the joint, the limit and the time.
    """
    if not duration > 0.0:
        raise ValueError(f"the motion lasts {duration:g} s: give a positive duration")
    times = np.linspace(0.0, duration, max(3, int(np.ceil(duration / period - 1e-9)) + 1))
    q = _follow(arm, X_WT, times, start, clearance, "time", " s")
    found = _spline(times, q)
    check_limits(arm, found, fraction=fraction)
    return found


def check_limits(arm: Arm, motion: Trajectory, *, fraction: float = 1.0) -> None:
    """Refuses a motion that exceeds a joint limit, looked at every ``LOOK`` seconds at least.

    Args:
        arm: the arm.
        motion: joint angles [rad], 7 rows.
        fraction: of the velocity, acceleration and torque limits that may be used.

    Raises:
        ValueError: naming the joint, the limit and the time.
    """
    limits = arm.limits.scaled(fraction)
    start, end = motion.start_time(), motion.end_time()
    times = np.linspace(start, end, max(FEWEST, int(np.ceil((end - start) / LOOK)) + 1))
    q, v, a = (_values(motion, times, order) for order in range(3))
    torque = torques(arm, q, v, a)
    if outside(arm, q).max() > 0.0:
        n, i = np.unravel_index(np.argmax(outside(arm, q)), q.shape)
        raise ValueError(
            f"joint {i + 1} turns to {q[n, i]:.3f} rad at {times[n]:.3f} s; allowed are"
            f" {limits.lower[i]:.3f} to {limits.upper[i]:.3f} rad: move or turn the tool path"
        )
    rules = (
        ("speed", v, limits.velocity, "rad/s", "give the motion more time"),
        ("acceleration", a, limits.acceleration, "rad/s^2", "make the motion smoother or slower"),
        ("torque", torque, limits.torque, "N m", "move slower or nearer to the base"),
    )
    for name, value, most, unit, remedy in rules:
        share = np.abs(value) / most
        n, i = np.unravel_index(np.argmax(share), share.shape)
        if share[n, i] > SLACK:
            raise ValueError(
                f"the {name} of joint {i + 1} is {abs(value[n, i]):.3g} {unit} at {times[n]:.3f} s;"
                f" allowed are {most[i]:.3g} {unit}: {remedy}"
            )


def torques(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Joint torques of a motion, gravity included [N m], shape [times, 7].

    Args:
        arm: the arm.
        q: joint angles [rad], shape [times, 7].
        v: their rates [rad/s], shape [times, 7].
        a: their accelerations [rad/s^2], shape [times, 7].
    """
    plant, forces, found = arm.plant, MultibodyForces(arm.plant), np.empty_like(q)
    rate, acceleration = (np.zeros(plant.num_velocities()) for _ in range(2))
    for n in range(len(q)):
        context = arm.place(q[n])
        rate[arm.index], acceleration[arm.index] = v[n], a[n]
        plant.SetVelocities(context, rate)
        plant.CalcForceElementsContribution(context, forces)
        found[n] = plant.CalcInverseDynamics(context, acceleration, forces)[arm.index]
    return found


def _follow(
    arm: Arm,
    X_WT: Path,
    places: np.ndarray,
    start: np.ndarray | None,
    clearance: float | None,
    name: str,
    unit: str,
) -> np.ndarray:
    """Joint angles at the given places of a path, each begun from the one before."""
    found = np.empty((len(places), len(arm.index)))
    for n, s in enumerate(places):
        X = X_WT(float(s))
        q = None if n == 0 else newton(arm, X, found[n - 1])
        if q is None or not allowed(arm, q, clearance):
            try:
                q = inverse_kinematics(
                    arm, X, start=start if n == 0 else found[n - 1], clearance=clearance
                )
            except ValueError as error:
                raise ValueError(f"at {name} {s:.4g}{unit}: {error}") from None
        if n and np.abs(q - found[n - 1]).max() > 0.3:
            raise ValueError(
                f"at {name} {s:.4g}{unit} the arm would have to jump to another posture: begin"
                " elsewhere or shorten the tool path"
            )
        found[n] = q
    return found


def _spline(s: np.ndarray, q: np.ndarray) -> PiecewisePolynomial:
    """Cubics with continuous second derivatives through q."""
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(s, q.T)


def _plant_bounds(arm: Arm, limits: Limits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity, acceleration and torque bounds for all of the plant's velocities."""
    ample = np.full(arm.plant.num_velocities(), 1e3)
    found = (ample.copy(), ample.copy(), ample.copy())
    for bound, most in zip(
        found, (limits.velocity, limits.acceleration, limits.torque), strict=True
    ):
        bound[arm.index] = most
    return found


def _values(motion: Trajectory, times: np.ndarray, order: int) -> np.ndarray:
    """A motion's values or derivatives, shape [times, 7]."""
    if order:
        return np.array([motion.EvalDerivative(t, order)[:, 0] for t in times])
    return np.array([motion.value(t)[:, 0] for t in times])
