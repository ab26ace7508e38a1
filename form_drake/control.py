"""What a position-controlled arm needs besides its model: a path in time, when to stop, what it feels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

LENGTH = 0.1
"""Length [m] by which moments are divided before they are weighed against forces."""
DAMPING = 1e-4
"""Tikhonov damping as a share of the largest singular value."""
TOUCH = 0.02
"""Share of the largest force, from which on a tool is driven by force."""
RESPONSE = 0.04
"""Time [s] in which it follows."""


def smooth(stamps: Sequence[float], places: Sequence[Sequence[float]], time: float) -> np.ndarray:
    """Place [m] at a time: 3u^2 - 2u^3 between places, at rest at each.

    Args:
        stamps: of the places [s], increasing.
        places: [m], shape [places, 3].
        time: [s]; before and after the stamps the place is the first and the last.
    """
    n = int(np.clip(np.searchsorted(stamps, time, side="right") - 1, 0, len(stamps) - 2))
    u = np.clip((time - stamps[n]) / (stamps[n + 1] - stamps[n]), 0.0, 1.0)
    a, b = (np.asarray(places[i], dtype=float) for i in (n, n + 1))
    place: np.ndarray = a + (3.0 * u**2 - 2.0 * u**3) * (b - a)
    return place


def tool_wrench(
    J: np.ndarray, torque: np.ndarray, sd: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """The wrench on a tool that best explains external joint torques.

    Minimizes |S^-1 (torque - J^T F)|^2 + (DAMPING sigma_max)^2 |F'|^2, where S = diag(sd), F' is F
    with its moment divided by ``LENGTH``, and sigma_max the largest singular value: weighted,
    lightly damped least squares, of bias (DAMPING times condition)^2.

    Args:
        J: Jacobian of V_WT, rotation above translation, in W; shape [6, n].
        torque: external joint torques [N m], shape [n].
        sd: their standard deviations [N m], shape [n]; None: all alike.

    Returns:
        The spatial force F_T_W on the tool, moment [N m] above force [N], shape [6]; and the
        condition number of the scaled problem.
    """
    weight = np.ones(len(torque)) if sd is None else np.min(sd) / sd
    scale = np.array([LENGTH] * 3 + [1.0] * 3)
    U, s, Vt = np.linalg.svd((J * scale[:, None]).T * weight[:, None], full_matrices=False)
    gain = s / (s**2 + (DAMPING * s[0]) ** 2)
    return scale * (Vt.T @ (gain * (U.T @ (weight * torque)))), float(s[0] / s[-1])


@dataclass(frozen=True)
class Progress:
    """Where a follower is on its path.

    Attributes:
        along: time along the path [s].
        rate: seconds of the path per second: 1 follows it as planned, -1 goes back.
        stopped: whether the force was reached, or the end of a path that is to be gone back.
        rest: how long it has stood since [s].
    """

    along: float = 0.0
    rate: float = 0.0
    stopped: bool = False
    rest: float = 0.0


@dataclass
class Follow:
    """How a path is followed.

    Attributes:
        begin: when it begins [s].
        until_force: size of the measured force [N] at which it stops; None: goes to the end.
        brake: time in which it comes to a stop there, and in which it sets out to go back [s].
        hold: how long it stands there before it goes back the way it came [s]; None: it stays.
    """

    begin: float = 0.0
    until_force: float | None = None
    brake: float = 0.02
    hold: float | None = None

    def __post_init__(self) -> None:
        if self.until_force is not None and not self.until_force > 0.0:
            raise ValueError(f"until_force is {self.until_force:g} N: give a positive force")
        if not self.brake > 0.0 or self.begin < 0.0 or (self.hold is not None and self.hold < 0.0):
            raise ValueError(
                f"begin {self.begin:g} s, brake {self.brake:g} s, hold {self.hold} s: begin and"
                " hold must not be negative, brake must be positive"
            )


def advanced(
    now: Progress, follow: Follow, *, time: float, step: float, end: float, force: float
) -> Progress:
    """The progress one step later.

    Args:
        now: progress at ``time``.
        follow: the rules.
        time: [s].
        step: length of the step [s].
        end: length of the path [s].
        force: size of the measured force at ``time`` [N].
    """
    if time < follow.begin - 0.5 * step:
        return now
    reached = follow.until_force is not None and force >= follow.until_force
    ended = follow.hold is not None and now.along >= end
    stopped = now.stopped or reached or ended
    back = stopped and follow.hold is not None and now.rest >= follow.hold
    if not stopped:
        return replace(now, along=min(now.along + step, end), rate=1.0)
    change = step / follow.brake
    rate = now.rate + float(np.clip((-1.0 if back else 0.0) - now.rate, -change, change))
    along = float(np.clip(now.along + 0.5 * step * (now.rate + rate), 0.0, end))
    rest = now.rest + (step if rate == 0.0 else 0.0)
    return Progress(along, rate, stopped, rest)


@dataclass(frozen=True)
class ForceServo:
    """Moves the tool along the measured push until it feels the measured force.

    Attributes:
        time: stamps of the measured force [s], shape [samples].
        push: its part along ``along`` [N], shape [samples].
        along: direction of the tool's push, unit vector in W.
        stiffness: measured force over measured stroke [N/m].
        touch: from when to when the tool was felt [s].
    """

    time: np.ndarray
    push: np.ndarray
    along: np.ndarray
    stiffness: float
    touch: tuple[float, float]

    @classmethod
    def of(cls, time: np.ndarray, force: np.ndarray, p_WT: np.ndarray) -> "ForceServo":
        """From the recorded force on the tool in W [N] and its place [m], shape [samples, 3] each.

        Raises:
            ValueError: there is no force.
        """
        size = np.linalg.norm(force, axis=1)
        felt = np.flatnonzero(size > TOUCH * size.max())
        if not len(felt):
            raise ValueError("the recorded force is zero throughout: nothing can be driven by it")
        most = int(np.argmax(size))
        along = -force[most] / size[most]
        stroke = (p_WT[most] - p_WT[felt[0]]) @ along
        touch = float(time[felt[0]]), float(time[felt[-1]])
        return cls(time, -force @ along, along, size[most] / max(stroke, 1e-6), touch)

    def moved(
        self,
        time: float,
        period: float,
        offset: np.ndarray,
        felt: np.ndarray,
        recorded: np.ndarray,
    ) -> np.ndarray:
        """Offset from the recorded pose at the end of a step [m]; none is added before and after touch.

        Args:
            time: where the step begins [s].
            period: its length [s].
            offset: at ``time`` [m], shape [3].
            felt: force on the tool at ``time`` [N], shape [3].
            recorded: the recorded motion in the step [m], shape [3]; it does not count while the
                tool is felt.
        """
        if not self.touch[0] <= time <= self.touch[1]:
            return offset
        # what follows with a delay is told in advance
        wanted = np.interp(time + RESPONSE, self.time, self.push)
        rate = (wanted + felt @ self.along) / (self.stiffness * RESPONSE)
        return offset + (rate * period - recorded @ self.along) * self.along
