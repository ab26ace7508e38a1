"""Which motions a recording holds, told by the ways of its tools and their forces.

Names are those that effects have in ``shown``.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from form_drake.motion import Body, Face, body
from form_drake.motion.poses import Poses
from form_drake.records import Recording, Stream

TURN = 0.1  # of the whole way, less than which back and forth is no turn
PART = 0.25  # of the whole way, which a press is at least
STILL = 0.02  # of the whole way, within which a tool is still
FAST = 0.2  # of the body's height, in a second
HELD, WAITED, APART, BETWEEN = 0.15, 0.3, 0.1, 0.1  # [s]: the last at most, the others at least
LIGHT = 0.1  # of the whole way, below which a body is let go
DEPTHS, SPEEDS = 1.5, 10.0  # times, by which depths and speeds differ at least
NONE = 3.0  # times its noise, below which a force is none
NOISE = 0.01  # of the largest force, where no noise is stated
ASIDE = 0.03  # of the body's height, by which a push from the side goes at least
MOVED = 1e-3  # of the body's height, that a press goes at least, and a shake, rms
ACROSS = 0.2  # of the way along one direction, which a shake along two has along the other


@dataclass(frozen=True)
class Leg:
    """A part of a tool's way between two turns or rests, or a rest.

    Attributes:
        start: [s].
        end: [s].
        low: depth at the start, as a share of the body's height.
        high: that at the end.
    """

    start: float
    end: float
    low: float
    high: float

    @property
    def rise(self) -> float:
        """How much deeper it ends."""
        return self.high - self.low

    @property
    def speed(self) -> float:
        """Of the body's height in a second."""
        return abs(self.rise) / max(self.end - self.start, 1e-9)


def motions(recording: Recording) -> frozenset[str]:
    """As effects name them; of a tool that touches no face nothing is told."""
    found, shape = set[str](), body(recording)
    held = [face for face in shape.faces if face.condition != "free"]
    for face in held:
        if (pose := recording.poses.get(face.tool)) is None:
            continue
        pose = _among(pose, recording.time[[0, -1]])
        force = recording.forces.get(face.tool)
        if force is None or len(held) == 1:  # nothing that it could press against
            found.update(_shake(pose, _height(face, shape)))
        else:
            found.update(_press(face, pose, force, shape))
    return frozenset(found)


def _among(pose: Stream, ends: np.ndarray) -> Stream:
    """Poses from the first frame to the last [s]."""
    inside = pose.time[(pose.time > ends[0]) & (pose.time < ends[1])]
    time = np.concatenate([ends[:1], inside, ends[1:]])
    return replace(pose, time=time, value=Poses(pose).at(time))


def _height(face: Face, shape: Body) -> float:
    return float(shape.high[face.axis] - shape.low[face.axis])


def _shake(pose: Stream, height: float) -> Iterator[str]:
    way = pose.value[:, :3, 3] - pose.value[:, :3, 3].mean(axis=0)
    along = np.linalg.svd(way, compute_uv=False) / np.sqrt(len(way))
    if along[0] > MOVED * height:
        yield "shake"
        if along[1] > ACROSS * along[0]:
            yield "shakes along two directions"


def _press(face: Face, pose: Stream, force: Stream, shape: Body) -> Iterator[str]:
    height, depth = _height(face, shape), _depth(face, pose, shape)
    across = pose.value[:, :3, 3] @ (np.eye(3) - np.outer(face.normal, face.normal))
    aside = across[depth >= 0.0]
    if np.linalg.norm(aside - aside[:1], axis=1).max(initial=0.0) > ASIDE * height:
        yield "a push from the side"
    if depth.max() > MOVED:
        yield "press"
        if face.condition == "frictionless":
            yield "press between plates that do not hold the body"
    depth = np.maximum(depth, 0.0)
    if (most := float(np.ptp(depth))) > MOVED:
        legs = list(_legs(pose.time, depth))
        yield from _depths(legs, most)
        yield from _speeds(legs, most)
    yield from _contactless(force)


def _depth(face: Face, pose: Stream, shape: Body) -> np.ndarray:
    """How far the body is pressed at least, as a share of its height: below zero a tool is off."""
    way = -(pose.value[:, :3, 3] @ face.normal)
    free = way.min()  # of what is bonded
    if face.condition == "frictionless":
        free = -float((shape.low, shape.high)[face.side] @ face.normal)
    return np.asarray((way - free) / _height(face, shape))


def _legs(time: np.ndarray, depth: np.ndarray) -> Iterator[Leg]:
    """Between rests and turns."""
    most = float(np.ptp(depth))
    begun = 0
    while begun < len(time) - 1:
        off = np.abs(depth[begun:] - depth[begun]) > STILL * most
        rested = begun + (int(np.argmax(off)) if off.any() else len(off)) - 1
        end = rested if time[rested] - time[begun] >= HELD else _turn(depth, begun, TURN * most)
        end = max(end, begun + 1)
        yield Leg(time[begun], time[end], depth[begun], depth[end])
        begun = end


def _turn(depth: np.ndarray, begun: int, least: float) -> int:
    """Where a way that goes on from an index turns by more than ``least``, or comes to rest."""
    rise = depth[begun:] - depth[begun]
    sign = np.sign(rise[np.argmax(np.abs(rise) > 0.5 * least)]) or 1.0
    best = np.maximum.accumulate(sign * rise)
    back = best - sign * rise > least
    last = int(np.argmax(back)) if back.any() else len(rise)
    top = best[last - 1]
    return begun + int(np.argmax(sign * rise[:last] >= top - 0.2 * least))


def _depths(legs: list[Leg], most: float) -> Iterator[str]:
    """By how deep it goes, and where it stays."""
    rests = [n for n, leg in enumerate(legs) if abs(leg.rise) <= STILL * most]
    for n in rests:
        leg, later = legs[n], [one.high for one in legs[n + 1 :]]
        if leg.low > 0.5 * most and min(later, default=leg.low) < leg.low - PART * most:
            yield "press, hold and release"
        deepest = max((one.high for one in legs[:n]), default=0.0)
        let_go = leg.high < LIGHT * most and deepest > 0.5 * most
        if let_go and leg.end - leg.start >= WAITED:
            yield "press, release and wait"
    tops = [n for n, leg in enumerate(legs) if leg.rise > PART * most]
    for a, b in pairwise(tops):
        less, more = sorted((legs[a].high, legs[b].high))
        if more < DEPTHS * less:
            continue
        yield "presses of two depths"
        if min(one.high for one in legs[a:b]) < 0.5 * less:
            yield "presses of two depths, each with release"


def _speeds(legs: list[Leg], most: float) -> Iterator[str]:
    """By how fast it goes."""
    loads = [leg.speed for leg in legs if leg.rise > PART * most]
    if loads and max(loads) >= FAST:
        yield "fast press"
    if loads and max(loads) >= SPEEDS * min(loads):
        yield "presses at speeds ten times apart"
    fast = [leg for leg in legs if abs(leg.rise) > TURN * most and leg.speed >= FAST]
    for one, other in pairwise(fast):
        if one.rise * other.rise < 0.0 and other.start - one.end <= BETWEEN:
            yield "a fast reversal"


def _contactless(force: Stream) -> Iterator[str]:
    """By when nothing acts on a tool."""
    size = np.linalg.norm(force.value, axis=1)
    noise = float(np.max(force.noise)) if force.noise else NOISE * float(size.max())
    middle = force.time[int(np.argmax(size))]
    off = np.concatenate([[False], size < NONE * np.sqrt(3.0) * noise, [False]])
    ends = np.flatnonzero(off[1:] != off[:-1]).reshape(-1, 2) - [0, 1]
    spans = [(force.time[a], force.time[b]) for a, b in ends]
    long = [middle < a for a, b in spans if b - a >= APART]
    if long:
        yield "a moment without contact"
    if any(long):
        yield "press and lift off"
    if len(set(long)) == 2:
        yield "moments without contact before and after"
