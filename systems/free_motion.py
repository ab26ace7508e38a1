"""Smooth motions from one posture to another, clear of everything that stands around."""

import numpy as np
from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
from pydrake.planning import KinematicTrajectoryOptimization
from pydrake.solvers import MathematicalProgramResult, SnoptSolver, Solve
from pydrake.trajectories import BsplineTrajectory

from form_drake.systems.arm import HOME, Arm
from form_drake.systems.kinematics import outside
from form_drake.systems.motion import check_limits

JERK = np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0])
"""Largest jerks [rad/s^3]: Franka Control Interface documentation, limits for Panda."""
INFLUENCE = 0.02
"""Distance [m] above the clearance at which a pair of bodies begins to count."""
ITERATIONS = 40
"""Of the solver; a motion that then keeps all limits is taken though it is not yet the shortest."""
EXTRA = 0.002
"""Clearance [m] asked of the program beyond the wanted one: it looks at samples only."""


def free_move(
    arm: Arm,
    q_start: np.ndarray,
    q_end: np.ndarray,
    *,
    clearance: float | None = 0.01,
    fraction: float = 0.5,
    control_points: int = 12,
) -> BsplineTrajectory:
    """A short smooth motion between two postures, from rest to rest.

    Drake's ``KinematicTrajectoryOptimization``: a B-spline of order 5 with velocity, acceleration
    and jerk limits, first without obstacles, then pushed clear of them. Torques are checked after.

    Args:
        arm: the arm and its scene.
        q_start: joint angles at the beginning [rad], shape [7].
        q_end: joint angles at the end [rad], shape [7].
        clearance: smallest distance [m] between any two bodies on the way; None: not looked at.
        fraction: of the velocity, acceleration and jerk limits to be used.
        control_points: of the B-spline.

    Returns:
        Joint angles [rad], 7 rows, from time 0.

    Raises:
        ValueError: an end is outside the joint limits or too near something, or no motion is found.
    """
    for name, q in (("start", q_start), ("end", q_end)):
        _check_end(arm, name, np.asarray(q, dtype=float), clearance)
    plan = _program(arm, q_start, q_end, fraction, control_points)
    found = Solve(plan.prog())
    motion = _motion(arm, plan, found)
    if clearance is not None and _nearest(arm, motion, clearance)[0] < clearance:
        _keep_clear(arm, plan, (q_start, q_end), clearance)
        for guess in _detours(arm, plan, motion):
            plan.SetInitialGuess(guess)
            found = Solve(plan.prog())
            motion = _motion(arm, plan, found)
            if _feasible(plan, found) and _nearest(arm, motion, clearance)[0] >= clearance:
                break
    if clearance is not None:
        _check_clearance(arm, motion, clearance)
    if not _feasible(plan, found):
        raise ValueError(
            "no motion between the postures keeps the joint limits: give a via posture, or a"
            f" larger fraction of the limits than {fraction:g}"
        )
    check_limits(arm, motion)
    return motion


def _program(
    arm: Arm, q_start: np.ndarray, q_end: np.ndarray, fraction: float, control_points: int
) -> KinematicTrajectoryOptimization:
    n, limits = arm.plant.num_positions(), arm.limits.scaled(fraction)
    plan = KinematicTrajectoryOptimization(n, control_points, spline_order=5, duration=2.0)
    ends = [arm.whole(np.asarray(q, dtype=float)) for q in (q_start, q_end)]
    zero = np.zeros((n, 1))
    for s, q in zip((0.0, 1.0), ends, strict=True):
        plan.AddPathPositionConstraint(q, q, s)
        plan.AddPathVelocityConstraint(zero, zero, s)
        plan.AddPathAccelerationConstraint(zero, zero, s)
    lower, upper, velocity, acceleration, jerk = (ends[0].copy(), ends[0].copy(), *np.ones((3, n)))
    lower[arm.index], upper[arm.index] = limits.lower, limits.upper
    velocity[arm.index], acceleration[arm.index] = limits.velocity, limits.acceleration
    jerk[arm.index] = fraction * JERK
    plan.AddPositionBounds(lower, upper)
    plan.AddVelocityBounds(-velocity, velocity)
    plan.AddAccelerationBounds(-acceleration, acceleration)
    plan.AddJerkBounds(-jerk, jerk)
    plan.AddDurationConstraint(0.05, 20.0)
    plan.AddDurationCost(1.0)
    plan.AddPathEnergyCost(1.0)
    share = np.linspace(0.0, 1.0, control_points)
    points = np.outer(ends[0], 1.0 - share) + np.outer(ends[1], share)
    snopt = SnoptSolver.id()
    plan.get_mutable_prog().SetSolverOption(snopt, "Major optimality tolerance", 1e-3)
    plan.get_mutable_prog().SetSolverOption(snopt, "Major iterations limit", ITERATIONS)
    plan.SetInitialGuess(BsplineTrajectory(plan.basis(), list(points.T[:, :, None])))
    return plan


def _motion(
    arm: Arm, plan: KinematicTrajectoryOptimization, found: MathematicalProgramResult
) -> BsplineTrajectory:
    """The arm's rows of a solution."""
    whole = plan.ReconstructTrajectory(found)
    points = np.array(whole.control_points())[:, arm.index]
    return BsplineTrajectory(whole.basis(), list(points))


def _feasible(plan: KinematicTrajectoryOptimization, found: MathematicalProgramResult) -> bool:
    return not found.GetInfeasibleConstraints(plan.prog(), 1e-4)


def _keep_clear(
    arm: Arm, plan: KinematicTrajectoryOptimization, ends: tuple, clearance: float
) -> None:
    """Asks for the clearance between the ends, and for more where the ends themselves have it."""
    room = min(arm.nearest(q, clearance + EXTRA)[0] for q in ends) - clearance
    samples = 3 * plan.num_control_points()
    for s in np.linspace(0.0, 1.0, samples)[1:-1]:
        away = MinimumDistanceLowerBoundConstraint(
            arm.plant, clearance + 0.9 * min(room, EXTRA), arm.place(ends[0]), None, INFLUENCE
        )
        plan.AddPathPositionConstraint(away, s)


def _detours(
    arm: Arm, plan: KinematicTrajectoryOptimization, motion: BsplineTrajectory
) -> list[BsplineTrajectory]:
    """First guesses: a motion itself, and the same drawn towards ``HOME`` half way."""
    q = np.array(motion.control_points())[:, :, 0]
    bump = np.sin(np.pi * np.linspace(0.0, 1.0, len(q)))[:, None]
    drawn = [q + share * bump * (HOME - q) for share in (0.0, 0.4, 0.8)]
    basis = motion.basis()
    return [BsplineTrajectory(basis, list(arm.whole(d)[:, :, None])) for d in drawn]


def _nearest(arm: Arm, motion: BsplineTrajectory, within: float) -> tuple[float, str, str, float]:
    """Smallest distance [m] on the way, between which bodies, and when [s]."""
    times = np.linspace(motion.start_time(), motion.end_time(), 121)
    return min((*arm.nearest(motion.value(t)[:, 0], within + 0.01), float(t)) for t in times)


def _check_end(arm: Arm, name: str, q: np.ndarray, clearance: float | None) -> None:
    beyond = outside(arm, q)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 0.0:
        raise ValueError(
            f"the {name} posture has joint {worst + 1} at {q[worst]:.3f} rad; allowed are"
            f" {arm.limits.lower[worst]:.3f} to {arm.limits.upper[worst]:.3f} rad"
        )
    if clearance is not None:
        distance, a, b = arm.nearest(q, clearance + 0.01)
        if distance < clearance:
            raise ValueError(
                f"in the {name} posture {a} is {distance * 1e3:.1f} mm from {b}; allowed are"
                f" {clearance * 1e3:.1f} mm: change the posture or lower the clearance"
            )


def _check_clearance(arm: Arm, motion: BsplineTrajectory, clearance: float) -> None:
    distance, a, b, t = _nearest(arm, motion, clearance)
    if distance < clearance:
        raise ValueError(
            f"no motion found clear of everything: {a} comes within {distance * 1e3:.1f} mm of {b}"
            f" at {t:.2f} s; allowed are {clearance * 1e3:.1f} mm: give a via posture or lower it"
        )
