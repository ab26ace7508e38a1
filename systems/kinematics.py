"""Joint angles that put the tool where it is wanted, or the constraint that forbids it."""

from collections.abc import Iterator

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.solvers import Solve

from form_drake.systems.arm import HOME, JOINTS, Arm

POSITION = 1e-9
"""Residual to which Newton's method brings a pose, [m] and [rad]."""
BOX = (1e-4, 1e-3)
"""Position [m] and angle [rad] that the nonlinear program must reach before Newton's method."""
MARGIN = 1e-3
"""Distance [rad] kept from the joints' ends."""


def inverse_kinematics(
    arm: Arm,
    X_WT: RigidTransform,
    *,
    start: np.ndarray | None = None,
    clearance: float | None = None,
    seeds: int = 8,
) -> np.ndarray:
    """Joint angles with the tool at X_WT, near ``start``.

    The nonlinear program of Drake's ``InverseKinematics`` from several guesses, then Newton's
    method on the pose alone.

    Args:
        arm: the arm and its scene.
        X_WT: wanted pose of the tool frame.
        start: joint angles [rad] to stay near, shape [7]; None: ``HOME``.
        clearance: smallest distance [m] between any two bodies; None: bodies may touch.
        seeds: how many guesses are tried; the first is ``start``, the others are drawn, always
            the same ones.

    Returns:
        Joint angles [rad], shape [7].

    Raises:
        ValueError: no such joint angles; the line says which constraint forbids them.
    """
    start = HOME if start is None else np.asarray(start, dtype=float)
    for guess in _guesses(arm, start, seeds):
        q = _solved(arm, X_WT, guess, start)
        if q is not None and allowed(arm, q, clearance):
            return q
        if clearance is not None:
            q = _solved(arm, X_WT, guess if q is None else q, start, clearance=clearance)
            if q is not None:
                return q
    raise ValueError(_reason(arm, X_WT, start, seeds, clearance))


def newton(arm: Arm, X_WT: RigidTransform, q: np.ndarray, *, steps: int = 8) -> np.ndarray | None:
    """The joint angles nearest to q that put the tool at X_WT, regardless of limits.

    Args:
        arm: the arm.
        X_WT: wanted pose of the tool frame.
        q: where to begin [rad], shape [7].
        steps: Newton steps at most, each of the least length (Moore-Penrose).

    Returns:
        Joint angles [rad], shape [7]; None: not reached.
    """
    q = np.array(q, dtype=float)
    for _ in range(steps):
        error = pose_error(arm.pose(q), X_WT)
        if np.abs(error).max() < POSITION:
            return q
        q = q + np.linalg.lstsq(arm.jacobian(q), error, rcond=1e-6)[0]
    return q if np.abs(pose_error(arm.pose(q), X_WT)).max() < POSITION else None


def pose_error(X_WA: RigidTransform, X_WB: RigidTransform) -> np.ndarray:
    """Rotation vector [rad] and translation [m] from A to B, in W; shape [6]."""
    turn = (X_WB.rotation() @ X_WA.rotation().inverse()).ToAngleAxis()
    return np.append(turn.angle() * turn.axis(), X_WB.translation() - X_WA.translation())


def outside(arm: Arm, q: np.ndarray) -> np.ndarray:
    """By how much joints are beyond their ends [rad], shape of q."""
    return np.maximum(arm.limits.lower - q, q - arm.limits.upper)


def allowed(arm: Arm, q: np.ndarray, clearance: float | None) -> bool:
    """Whether q [rad] is within the joint limits and, unless None, keeps the clearance [m]."""
    if outside(arm, q).max() > 0.0:
        return False
    return clearance is None or arm.nearest(q, clearance + 0.01)[0] >= clearance


def _guesses(arm: Arm, start: np.ndarray, seeds: int) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(0)
    yield start
    for n in range(1, seeds):
        share = n / seeds
        drawn = rng.uniform(arm.limits.lower, arm.limits.upper)
        yield (1.0 - share) * start + share * drawn


def _solved(
    arm: Arm,
    X_WT: RigidTransform,
    guess: np.ndarray,
    near: np.ndarray,
    *,
    clearance: float | None = None,
    limits: bool = True,
    orientation: bool = True,
) -> np.ndarray | None:
    arm.place(guess)
    ik = InverseKinematics(arm.plant, arm.context, with_joint_limits=False)
    q, world, zero = ik.q(), arm.plant.world_frame(), np.zeros(3)
    _bound(arm, ik, limits)
    p = X_WT.translation()
    ik.AddPositionConstraint(arm.tool, zero, world, p - BOX[0] / 2, p + BOX[0] / 2)
    if orientation:
        ik.AddOrientationConstraint(world, X_WT.rotation(), arm.tool, RotationMatrix(), BOX[1] / 2)
    if clearance is not None:
        ik.AddMinimumDistanceLowerBoundConstraint(clearance + BOX[0], 0.05)
    ik.prog().AddQuadraticErrorCost(np.eye(JOINTS), near, q[arm.index])
    ik.prog().SetInitialGuess(q, arm.whole(guess))
    found = Solve(ik.prog())
    if not found.is_success():
        return None
    angles = found.GetSolution(q)[arm.index]
    if not orientation:
        return angles
    angles = newton(arm, X_WT, angles)
    if angles is None:
        return None
    return angles if not limits or allowed(arm, angles, clearance) else None


def _bound(arm: Arm, ik: InverseKinematics, limits: bool) -> None:
    """Holds all but the arm's joints where they are, and these within their limits."""
    rest = arm.plant.GetDefaultPositions()
    lower, upper = rest.copy(), rest.copy()
    lower[arm.index] = arm.limits.lower + MARGIN if limits else -2.0 * np.pi
    upper[arm.index] = arm.limits.upper - MARGIN if limits else 2.0 * np.pi
    ik.prog().AddBoundingBoxConstraint(lower, upper, ik.q())


def _reason(
    arm: Arm, X_WT: RigidTransform, start: np.ndarray, seeds: int, clearance: float | None
) -> str:
    """Which constraint forbids a pose: reach, orientation, joint limits or clearance."""
    at = "[" + ", ".join(f"{x:.3f}" for x in X_WT.translation()) + "] m"
    guesses = list(_guesses(arm, start, seeds))

    def first(**rules):
        tried = (_solved(arm, X_WT, g, start, **rules) for g in guesses)
        return next((q for q in tried if q is not None), None)

    free = first(limits=False)
    if free is None:
        if first(limits=False, orientation=False) is not None:
            return f"the tool reaches {at}, but not with the wanted orientation: turn it"
        body = arm.plant.GetBodyByName("panda_link2", arm.plant.GetModelInstanceByName(arm.model))
        shoulder = body.EvalPoseInWorld(arm.place(start)).translation()
        away = np.linalg.norm(X_WT.translation() - shoulder)
        return (
            f"the tool cannot reach {at}, {away:.3f} m from the shoulder (the flange reaches"
            " 0.855 m): move the pose nearer"
        )
    within = first()
    if within is None:
        beyond = outside(arm, free)
        worst = int(np.argmax(beyond))
        return (
            f"the tool reaches {at} only with joint {worst + 1} at {free[worst]:.3f} rad, outside"
            f" {arm.limits.lower[worst]:.3f} to {arm.limits.upper[worst]:.3f}: move or turn the pose"
        )
    distance, a, b = arm.nearest(within, clearance + 0.01)
    return (
        f"with the tool at {at}, {a} comes within {distance * 1e3:.1f} mm of {b}; allowed are"
        f" {clearance * 1e3:.1f} mm: move the pose or lower the clearance"
    )
