"""The way of a body through all frames, each in balance after the one before it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from form_drake.interior.newton import balanced
from form_drake.interior.resistance import Resistance
from form_drake.interior.statics import Grip, Held, Rows, Statics
from form_drake.interior.surface import Seen
from form_drake.interior.tilt import level
from form_drake.motion import Fit
from form_drake.motion.fit import unfollowed
from form_drake.motion.pace import chosen_time
from form_drake.motion.smoothing import Smoothing, Spread

LOOKS = 12  # frames that stand for all, where not each is needed
SLIDES = 1.1  # times the squared error of a face that slides, up to which a bonded one sticks
FRICTIONS = (0.0, 0.1, 0.2, 0.4, 0.8)  # that are tried, as long as they come nearer
SHOWN = 1e-3  # share of a function that is no doubt left or no freedom
UNSETTLED = 0.1  # share of the frames that may not settle
STEPS = 100  # towards the likeliest sizes of errors
NOTHING = 1e-30  # a variance beside ones of about one
SAGS = 3  # rounds in which points find the places free of stress that sag to where they are seen


@dataclass(frozen=True)
class Path:
    """All frames of a body.

    Attributes:
        statics: of its material.
        seen: points that are seen, from where it is free of stress.
        friction: Coulomb's coefficient under bonded faces; infinite: they stick.
        frames: coefficients of the displacements in each.
    """

    statics: Statics
    seen: Seen
    friction: float
    frames: list[Held]

    @classmethod
    def of(
        cls,
        seen: Seen,
        resistance: Resistance,
        friction: float | None = None,
        near: "Path | None" = None,
    ) -> "Path":
        """That of a material, as far as it is known.

        Args:
            seen: what is seen of the body.
            resistance: of the material.
            friction: as of ``Path``; None: as ``friction_of`` finds it.
            near: the path of another material, from which this one is sought, and by which what tools add
                that turn is told from what is seen (see ``interior.tilt``); None: there is none.

        Raises:
            ValueError: no motion inside passes through the points.
        """
        friction = friction_of(seen, resistance) if friction is None else friction
        statics = _statics(seen, resistance)
        free = _from_rest(statics, seen, friction)
        if near:
            free = level(free, statics, near.frames, friction)
        frames, lost = list[Held](), 0
        for frame in _frames(statics, free, friction, near.frames if near else ()):
            frames.append(frame)
            lost += not frame.settled  # which costs as much as twenty others
            if lost > UNSETTLED * len(free.valid):
                raise ValueError(
                    f"in {lost} of {len(frames)} frames no motion inside the body balances the forces of"
                    f" {resistance.law.name} and passes through the points of its surface: are the faces"
                    " held as the recording states?"
                )
        return cls(statics, free, friction, frames)

    def fit(self) -> Fit:
        """The motion: splines in time through the frames, and their covariance.

        What the surface shows of the coefficients is as uncertain as its points. What it does not show is
        what the balance makes it, and as uncertain as that. How much either is shows in how points pull
        at the balance, frame by frame.
        """
        statics, seen, frames = self.statics, self.seen, self.frames
        looks = frames[:: max(1, len(frames) // LOOKS)]
        stiffness = np.mean([f.stiffness for f in looks], axis=0)
        normal = np.mean([f.rows.normal for f in looks], axis=0)
        factor = np.linalg.cholesky(normal + 0.5 * (stiffness + stiffness.T))
        half = solve_triangular(factor, normal, lower=True)
        told, turn = np.linalg.eigh(solve_triangular(factor, half.T, lower=True))
        told = np.clip(told, 0.0, 1.0)
        root = solve_triangular(factor, turn, lower=True, trans="T") / seen.sd
        z = np.array([seen.sd * (turn.T @ (factor.T @ f.y)) for f in frames])
        pulls = turn.T @ solve_triangular(factor, np.array([f.pull for f in frames]).T, lower=True)
        own, doubt = seen.sd * _sizes(pulls, told)
        splines = chosen_time(seen.time, z, seen.noise)
        Q, R = np.linalg.qr(splines.matrix(seen.time))
        back = np.linalg.inv(R)
        D = (seen.whitening @ statics.values(seen.X)).reshape(-1, len(z[0]))
        follows = ((Q @ (Q.T @ z)) @ root.T @ D.T).reshape(seen.u.shape)
        rest = seen.white - follows
        for left, valid in zip(rest, seen.valid, strict=True):
            left[valid] = seen.undrifted(left[valid, :, None], valid)[..., 0]
            left[~valid] = 0.0
        freedom = max(1.0 - told.sum() / len(D), SHOWN)
        beside = np.sqrt(np.maximum(own**2 - seen.noise**2, 0.0))
        lasting = _enlarged(unfollowed(rest, seen.noise, freedom), beside)
        spread = (
            Spread(np.sqrt(told)[:, None], seen.noise * back),
            Spread(np.sqrt(told)[:, None], back @ Q.T @ lasting),
        )
        unseen = Spread(np.sqrt(1.0 - told)[:, None], back @ Q.T @ doubt[:, None])
        return Fit(
            space=statics.space,
            time=splines,
            c=statics.space.tied(root @ (Q.T @ z).T @ back.T),
            noise=seen.noise,
            misfit=float(np.sqrt(np.mean(rest[seen.valid] ** 2) / freedom)),
            held_out=seen.sd,
            roots=(root,),
            spread=spread,
            smoothing=Smoothing.none(len(told)),
            response=spread,
            doubt=(unseen,),
        )


def _sizes(pulls: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Errors of the points, and of the balance out of which they pull a body, shape [2, frames].

    Errors of points pull as told (1 - told)^2 at the functions, as a variance, and errors of the balance
    as told^2 (1 - told): the likeliest sizes of both (steps of Zhou, Hu, Zhou and Lange, "MM algorithms
    for variance components models", 2019).

    Args:
        pulls: at the functions, shape [functions, frames].
        told: share of each that points tell, shape [functions].
    """
    some = (told > SHOWN) & (told < 1.0 - SHOWN)
    if not some.any():
        return np.zeros((2, pulls.shape[1]))
    t, square = told[some], pulls[some] ** 2
    level = np.maximum(square.mean(axis=0), np.finfo(float).tiny)
    shapes = np.stack([t * (1.0 - t) ** 2, t**2 * (1.0 - t)])
    size = np.ones((2, len(level)))
    for _ in range(STEPS):
        variance = shapes.T @ size + NOTHING
        by_square = shapes @ (square / level / variance**2)
        size *= np.sqrt(by_square / (shapes @ (1.0 / variance)))
    return np.asarray(np.sqrt(level * size))


def _enlarged(series: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Series [frames, n] of which all together are in each frame at least as large, shape [frames]."""
    size = np.maximum(np.linalg.norm(series, axis=1), NOTHING)
    return series * np.maximum(least / size, 1.0)[:, None]


def friction_of(seen: Seen, resistance: Resistance) -> float:
    """Coulomb's coefficient under bonded faces; infinite where they stick.

    With it, balance alone comes nearest to the points, on the way to the largest displacement.

    Args:
        seen: what is seen of the body.
        resistance: of its material.
    """
    if not any(hold.face.condition == "bonded" for hold in seen.holds):
        return 0.0
    statics, looks = _statics(seen, resistance), _looks(seen)

    def off(friction: float) -> float:
        free = _from_rest(statics, seen, friction)
        holds = tuple(hold.at(looks) for hold in free.holds)
        few = replace(free, u=free.u[looks], valid=free.valid[looks], holds=holds)
        D = few.whitening @ statics.values(few.X)
        frames = list(_frames(statics, few, friction))
        rest = [few.white[n] - D @ frame.alone for n, frame in enumerate(frames)]
        left = [few.undrifted(r[v, :, None], v) for r, v in zip(rest, few.valid, strict=True)]
        return float(sum(np.log(np.mean(r**2)) for r in left if len(r)))

    sticking = off(np.inf)
    sliding, friction = _least(off, FRICTIONS)
    return np.inf if sticking <= sliding + len(looks) * np.log(SLIDES) else friction


def _looks(seen: Seen) -> np.ndarray:
    """Frames on the way to the largest displacement that stand for all."""
    size = np.linalg.norm(seen.u, axis=(1, 2))
    steps = np.linspace(0.0, size.max(), LOOKS + 1)[1:]
    return np.unique([int(np.argmax(size >= step)) for step in steps])


def _frames(
    statics: Statics, seen: Seen, friction: float, near: Sequence[Held] = ()
) -> Iterator[Held]:
    """Every frame after the one before it; ``near`` are those of a body of nearly the same material."""
    D = seen.whitening @ statics.values(seen.X)
    own = [hold.grip(statics, friction) for hold in seen.holds]
    last = statics.rest
    for n, valid in enumerate(seen.valid):
        rows = Rows.of(seen.undrifted(D[valid], valid), seen.white[n, valid], seen.sd)
        grips = [grip for hold in own if (grip := hold(n))]
        last = _held(statics, rows, grips, last, (near[n - 1], near[n]) if n and near else None)
        yield last


def _held(
    statics: Statics, rows: Rows, grips: list[Grip], last: Held, near: tuple[Held, Held] | None
) -> Held:
    """The frame after ``last``, from that of another material where this leads there."""
    if near:
        try:
            held = balanced(statics, rows, grips, last, near)
        except ValueError:  # lost on the way
            held = None
        if held is not None and held.settled:
            return held
    return balanced(statics, rows, grips, last)


def _statics(seen: Seen, resistance: Resistance) -> Statics:
    return Statics(seen.space, seen.body, resistance, seen.force)


def _from_rest(statics: Statics, seen: Seen, friction: float) -> Seen:
    """What is seen, from where points were before the weight moved them to where they are seen first."""
    if not (seen.bent and statics.resistance.weighs):
        return seen
    size = float(np.max(statics.body.high - statics.body.low))
    x, X = seen.X, seen.X
    rows = Rows.of(statics.values(x), np.zeros(x.shape), size)  # so that nothing floats away
    grips = [grip for hold in seen.holds if (grip := hold.grip(statics, friction)(0))]
    y = balanced(statics, rows, grips, statics.rest).y
    for _ in range(SAGS):
        X = x - statics.values(X) @ y
    return replace(seen, X=X, u=seen.u + (x - X))


def _least(function: Callable[[float], float], places: Sequence[float]) -> tuple[float, float]:
    """The least value, and where a parabola through it and its neighbours is least.

    There is one least value, looked for from the second place on to the side where it lies, until a place
    is no better than the one before it. The parabola is one through places half-way to the neighbours on
    both sides: the misfit is sharper than any parabola, and uneven places would pull it aside.
    """
    found = {place: function(place) for place in places[1:3]}
    falling = found[places[2]] < found[places[1]]
    for place in places[3:] if falling else places[:1]:
        found[place] = function(place)
        if found[place] > min(found.values()):
            break
    tried = sorted(found)
    n = tried.index(min(found, key=found.__getitem__))
    for one, other in pairwise(tried[max(n - 1, 0) : n + 2]):
        half = 0.5 * (one + other)
        found[half] = function(half)
    return min(found.values()), _bottom(found)


def _bottom(found: dict[float, float]) -> float:
    """Where a parabola through the least value and its neighbours is least, none beyond the ends."""
    places = sorted(found)
    best = places.index(min(found, key=found.__getitem__))
    first = min(max(best - 1, 0), len(places) - 3)
    near = places[first : first + 3]
    bend, slope, _ = np.polyfit(near, [found[p] for p in near], 2)
    least = -0.5 * slope / bend if bend > 0.0 else places[best]
    return float(np.clip(least, near[0], near[-1]))
