"""Newton's steps to where a body balances in a frame.

The slope of the law, plastic flow included, is that where the frame before has settled, and is taken afresh
wherever this leads on too slowly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from form_drake.interior.statics import Forces, Grip, Held, Rows, Statics

ROUNDS = 60
FLOAT = 1e-6  # share of what is seen that keeps a body which nothing holds from floating away
CLOSE = 3e-5  # change of a deformation gradient in a step, below which it is the last
LONGEST = 0.2  # change of a deformation gradient in a step
RUBS = 4  # solutions at most, whose friction is bounded by the pressure of the one before
ALIKE = 0.01  # share of that bound that no longer matters
SLOW = 0.5  # of a step that the next may be with a slope from elsewhere

Solver = tuple[tuple[np.ndarray, np.ndarray], np.ndarray]  # LU factors, solutions for the pushes


def balanced(
    statics: Statics,
    rows: Rows,
    grips: Sequence[Grip],
    last: Held,
    near: tuple[Held, Held] | None = None,
) -> Held:
    """The frame after ``last``, with friction bounded by the pressure that there is then.

    Args:
        statics: of the body.
        rows: of what is seen.
        grips: of the tools.
        last: the frame before.
        near: the frame before and the frame, of a body of nearly the same material; None: neither is
            known.

    Raises:
        ValueError: no motion passes through what is seen without folding the body.
    """
    found = _steps_on(_Frame.of(statics, rows, grips, last), near)
    for _ in range(RUBS - 1):
        bounded = _bounded(last, found, grips)
        if bounded is None or not found.settled:
            break
        near, last = (last, found), bounded
        found = _steps_on(_Frame.of(statics, rows, grips, last), near)
    return found


def _bounded(last: Held, found: Held, grips: Sequence[Grip]) -> Held | None:
    """``last`` with the bounds of friction after it; None: it has them."""
    rubbed, off, size = {}, 0.0, 0.0
    for rub in (grip.rub for grip in grips if grip.rub):
        most, before = found.rubbed[rub.face].most, last.rubbed.get(rub.face, rub.none)
        rubbed[rub.face] = replace(before, most=most)
        off += float(np.abs(most - before.most).sum())
        size += float(most.sum())
    return None if off <= ALIKE * size else replace(last, rubbed=rubbed)


def _steps_on(frame: "_Frame", near: tuple[Held, Held] | None) -> Held:
    """A frame, with friction bounded as in the one before it; ``near`` as of ``balanced``."""
    statics, grips, last = frame.statics, frame.grips, frame.last
    ahead, alone, slope, push = last.ahead, last.ahead, last.slope, last.push
    if near is not None:
        earlier, there = near
        ahead, alone, slope = there.y - earlier.y, there.alone - earlier.alone, there.slope
        push = push + there.push - earlier.push
    at = [last.y + ahead, last.alone + alone][: len(frame.kept)]
    push = frame.B @ (frame.B.T @ push)
    slopes, shares = [slope] * len(at), [1.0] * len(at)
    strains = [np.inf] * len(at)
    for _ in range(ROUNDS):
        found = [statics.forces(y, grips, last) for y in at]
        before = strains
        steps, strains = frame.steps(at, push, found, slopes)
        slow = [s > SLOW * b for s, b in zip(strains, before, strict=True)]
        if any(slow):
            slopes = frame.afresh(at, slopes, slow)
            steps, strains = frame.steps(at, push, found, slopes)
        shares = [_damped(*each) for each in zip(shares, strains, before, strict=True)]
        taken = [
            d * min(1.0, LONGEST / max(s, LONGEST)) for d, s in zip(shares, strains, strict=True)
        ]
        at = [y + share * step for y, share, step in zip(at, taken, steps[:-1], strict=True)]
        push = push + min(taken) * steps[-1]
        if max(strains) < CLOSE:
            break
    return frame.settled(at, push, found[0], max(strains) < CLOSE)


@dataclass(frozen=True)
class _Frame:
    """What does not change while a frame is sought.

    Attributes:
        rows: of what is seen.
        kept: rows that hold the body as it is seen and, where tools push as they like, as balance alone
            would have it.
        B: directions of those pushes, orthonormal, shape [size, pushes].
    """

    statics: Statics
    grips: Sequence[Grip]
    last: Held
    rows: Rows
    kept: tuple[Rows, ...]
    B: np.ndarray

    @classmethod
    def of(cls, statics: Statics, rows: Rows, grips: Sequence[Grip], last: Held) -> "_Frame":
        size = statics.space.size
        own = sum((grip.rows for grip in grips), Rows.none(size))
        B = np.concatenate([np.zeros((size, 0)), *(grip.pushes for grip in grips)], axis=1)
        kept = (own + rows, own + rows * FLOAT)
        return cls(statics, grips, last, rows, kept if B.shape[1] else kept[:1], B)

    def steps(
        self,
        at: list[np.ndarray],
        push: np.ndarray,
        found: list[Forces],
        slopes: list[np.ndarray],
    ) -> tuple[list[np.ndarray], list[float]]:
        """Steps of the states and of the push, and the largest change of strain that each state makes."""
        states = list(zip(self.kept, slopes, found, at, strict=True))
        solvers = [self._solver(n, s, f.rubbing) for n, (_, s, f, _) in enumerate(states)]
        steps = [
            lu_solve(lu, rows.right - rows.normal @ y - forces.left + push, check_finite=False)
            for (lu, _), (rows, _, forces, y) in zip(solvers, states, strict=True)
        ]
        if len(at) == 1:
            steps.append(np.zeros_like(push))
        else:
            steps = self._together(steps, [back for _, back in solvers], at)
        strains = [float(np.abs(self.statics.strains(step)).max()) for step in steps[:-1]]
        if not np.isfinite(strains).all():
            raise ValueError("no motion inside the body passes through the points of its surface")
        return steps, strains

    def _solver(self, n: int, slope: np.ndarray, rubbing: np.ndarray) -> Solver:
        """Factors of the equations of a state, and their solutions for pushes along B."""
        known = self._known.get(n)
        if known is not None and known[0] is slope and not rubbing.any():
            return known[1]
        lu = lu_factor(self.kept[n].normal + slope + rubbing, check_finite=False)
        found = lu, lu_solve(lu, self.B, check_finite=False) if self.B.shape[1] else self.B
        if not rubbing.any():
            self._known[n] = slope, found
        return found

    @cached_property
    def _known(self) -> dict[int, tuple[np.ndarray, Solver]]:
        return {}

    def _together(
        self, steps: list[np.ndarray], backs: list[np.ndarray], at: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Steps of two states, and the push on both that brings them together along B."""
        (one, other), (A, C), B = steps, backs, self.B
        apart = B.T @ (at[1] - at[0] - one + other)
        size = np.linalg.solve(B.T @ (A - C), apart)
        return [one + A @ size, other + C @ size, B @ size]

    def afresh(
        self, at: list[np.ndarray], slopes: list[np.ndarray], slow: list[bool]
    ) -> list[np.ndarray]:
        """Slopes of the states that are slow."""
        return [
            self.statics.slope(y, self.last.past) if again else slope
            for y, slope, again in zip(at, slopes, slow, strict=True)
        ]

    def settled(self, at: list[np.ndarray], push: np.ndarray, found: Forces, close: bool) -> Held:
        """The frame, once it has come to ``at``."""
        y, last, rows = at[0], self.last, self.rows
        slope = self.statics.slope(y, last.past)
        stiffness = self.kept[0].normal - rows.normal + slope + found.rubbing
        rubs = [(grip.rub, grip.force(y, push)) for grip in self.grips if grip.rub]
        return Held(
            y=y,
            alone=at[-1],
            push=push,
            rows=rows,
            past=found.past,
            slope=slope,
            stiffness=stiffness - _borne(self.B, stiffness + FLOAT * rows.normal),
            pull=rows.right - rows.normal @ y,
            settled=close,
            rubbed={rub.face: rub.after(found.rubs[rub.face], held) for rub, held in rubs},
            ahead=y - last.y,
        )


def _damped(share: float, strain: float, before: float) -> float:
    """The share of a step to take: half of the last one where that has not led as far as it should."""
    return 0.5 * share if strain > (1.0 - 0.5 * share) * before else min(1.0, 1.2 * share)


def _borne(B: np.ndarray, K: np.ndarray) -> np.ndarray:
    """The stiffness that pushes along B take over, shape [size, size]."""
    if not B.shape[1]:
        return np.zeros_like(K)
    return np.asarray(B @ np.linalg.solve(B.T @ np.linalg.solve(K, B), B.T))
