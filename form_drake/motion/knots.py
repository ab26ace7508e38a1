"""Which splines follow a motion: chosen inside one recording, by error at left-out tracks.

A linear fit gives that error in closed form, residual / (1 - leverage).

Motion of few degrees of freedom stands out of the noise as few modes, sums of products of a field and
a time series (singular vectors of the tracks as a matrix). Each gathers what all frames, or all
points, tell of it. Bases are chosen by the modes: frame by frame the noise would hide what a basis
cannot follow, while the balance, which gathers frames too, would see it as a bias.
"""

from collections.abc import Sequence
from contextlib import suppress
from itertools import permutations, product

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from form_drake.motion.body import Body
from form_drake.motion.drift import centred
from form_drake.motion.modes import modes
from form_drake.motion.space import Space, Symmetry, paired
from form_drake.motion.splines import Splines, Tensor
from form_drake.workers import parted

# (spans, degree) along one axis in the order in which they are tried
LADDER = (
    *((1, d) for d in range(1, 6)),
    *((n, 5) for n in (2, 3, 4, 6, 8)),
)
CLIMBS = (*np.eye(3, dtype=int), *(2 * np.eye(3, dtype=int)), np.ones(3, dtype=int))
# A basis is enlarged while the error at left-out tracks stays below this share of the least and
# this much of the noise, as squares: the balance knows what noise does to it, but not what a basis
# cannot follow.
SLACK, ROOM = 1.1, 0.6
KEEPS = 1.01  # the same of a symmetry, which has fewer functions and so must follow as well
LIKE = 0.9  # of the functions of a basis that one has to have to take its place
KEPT = 0.95  # share of the tracks, best first: one that stands alone says little of the others
LARGEST = 0.6  # functions for each track and component
FINEST = 2.5  # splines for each track, of which symmetry makes functions
SURE = 3.0  # deviations of chance, below which no basis is better than another
TINY = 1e-100  # [m^2]
FAINT = 1e-4  # of the first mode, below which one says nothing of a spatial basis
LOOKS = 24  # frames by which spatial bases are compared
PASSES = 30  # of filling points that are missing from some frames


def filled(space: Space, X: np.ndarray, u: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Displacements with the missing ones replaced by the fit's own, until they agree."""
    if valid.all():
        return u
    u = u.copy()
    D = [block.matrix(space.scalar.matrix(X)) for block in space.blocks]
    factors = [
        cho_factor(space.normal(own, block)) for own, block in zip(D, space.blocks, strict=True)
    ]
    for _ in range(PASSES):
        for own, factor, block in zip(D, factors, space.blocks, strict=True):
            y = cho_solve(factor, paired(own, u[:, :, block.axes]))
            again = np.moveaxis(own @ y, 2, 0)
            lost = ~valid
            for n, axis in enumerate(block.axes):
                u[lost, axis] = again[lost, n]
    return u


def press(
    space: Space, X: np.ndarray, u: np.ndarray, valid: np.ndarray
) -> tuple[float, float, float]:
    """Trimmed root mean square error [m] at left-out tracks; at the same tracks, none of them left out,
    the mean square residual [m^2], and what unit noise alone would make it.

    Raises:
        np.linalg.LinAlgError: a dependent basis.
    """
    Phi = space.scalar.matrix(X)
    square, rest, free = np.zeros((3, len(X)))
    for group in space.alike:
        D = group[0].matrix(Phi)
        root = np.linalg.cholesky(space.normal(D, group[0]))
        Q = solve_triangular(root, D.reshape(-1, group[0].size).T, lower=True).T
        own = np.concatenate([u[:, :, block.axes].transpose(1, 2, 0) for block in group], axis=2)
        flat = own.reshape(len(Q), -1)
        own = (flat - Q @ (Q.T @ flat)).reshape(own.shape)
        R = Q.reshape(D.shape)
        left = (1.0 + 1e-9) * np.eye(D.shape[1]) - R @ R.swapaxes(1, 2)
        seen = np.tile(valid.T, len(group))[:, None]
        square += np.sum((np.linalg.solve(left, own) * seen) ** 2, axis=(1, 2))
        rest += np.sum((own * seen) ** 2, axis=(1, 2))
        free += len(group) * np.trace(left, axis1=1, axis2=2) / 3.0
    count = np.maximum(3.0 * valid.sum(axis=0), 1.0)
    kept = np.argsort(square / count)[: int(KEPT * len(X))]
    error, rest = (np.mean((s / count)[kept]) for s in (square, rest))
    return float(np.sqrt(error)), float(rest) + TINY, float(np.mean(free[kept]))


def looked_at(u: np.ndarray, valid: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Fields by which bases are compared: modes, or some frames where points are missing."""
    if not valid.all():
        every = max(1, len(u) // LOOKS)
        return u[::every], valid[::every]
    _, S, Vt = modes(u.reshape(len(u), -1), noise)
    S, Vt = S[S > FAINT * S[0]], Vt[S > FAINT * S[0]]
    return (S[:, None] * Vt).reshape(-1, *u.shape[1:]), np.ones((len(S), u.shape[1]), dtype=bool)


def chosen_space(
    X: np.ndarray,
    u: np.ndarray,
    valid: np.ndarray,
    body: Body,
    noise: float,
    *,
    symmetric: bool = True,
) -> Space:
    """The basis, and where they are ``symmetric`` the symmetries, that the left-out tracks support.

    ``noise`` is the standard deviation of a coordinate [m].
    """
    if not np.any(u[valid]):
        raise ValueError("no point moves at all: there is no motion to read")
    u, valid = looked_at(u, valid, noise)
    floor = 1e-9 * float(np.sqrt(np.mean(u[valid] ** 2)))
    bases = _Bases(X, u, valid, body, noise)
    if not np.isfinite(bases.error((0, 0, 0), Symmetry())):
        raise ValueError(f"{len(X)} points do not determine even a linear motion; track more")
    rungs, lowest = bases.climbed(Symmetry(), floor)
    limit = bases.limit(lowest)

    def loss(wider: Symmetry) -> float:
        """Error with an operation more, as a share of that without."""
        even = wider.evened(rungs)
        error, before = bases.error(even, wider), bases.error(even, symmetry)
        return 0.0 if error <= floor else error / before if np.isfinite(before) else np.inf

    symmetry = Symmetry()
    while symmetric:
        tried = {wider: loss(wider) for wider in Symmetry.wider(body, symmetry)}
        best = min(tried, key=lambda wider: tried[wider], default=None)
        if best is None or not tried[best] < KEEPS:
            break
        symmetry = best
    if symmetry:
        own, least = bases.climbed(symmetry, floor)
        if least <= floor or least < limit:
            rungs = own
        else:
            symmetry = Symmetry()
    return bases.space(bases.traded(rungs, symmetry, floor), symmetry)


class _Bases:
    """Errors at left-out tracks of the bases on a ladder."""

    def __init__(self, X: np.ndarray, u: np.ndarray, valid: np.ndarray, body: Body, noise: float):
        self._tracks = X, u, valid
        self._body, self._noise = body, noise
        share = (X - body.low) / (body.high - body.low)
        self._places = [len(np.unique(np.round(s, 3))) for s in share.T]
        held = [f.condition == "bonded" for f in body.faces]
        self._held = [(held[2 * n], held[2 * n + 1]) for n in range(3)]
        self._known: dict[tuple[tuple[int, ...], Symmetry], tuple[float, float, float]] = {}
        self._axes: dict[tuple[int, int], Splines] = {}
        self._centred: dict[Symmetry, np.ndarray] = {}
        self._spaces: dict[tuple[tuple[int, ...], Symmetry], Space] = {}

    def space(self, rungs: tuple[int, ...], symmetry: Symmetry) -> Space:
        """The basis at a step of the ladder along every axis."""
        plain, own = (rungs, Symmetry()), (rungs, symmetry)
        if plain not in self._spaces:
            a, b, c = (self._axis(n, r) for n, r in enumerate(rungs))
            self._spaces[plain] = Space(Tensor((a, b, c)))
        if own not in self._spaces:
            self._spaces[own] = Space(self._spaces[plain].scalar, symmetry)
        return self._spaces[own]

    def _axis(self, n: int, rung: int) -> Splines:
        if (n, rung) not in self._axes:
            low, high = self._body.low[n], self._body.high[n]
            self._axes[n, rung] = Splines.graded(low, high, *LADDER[rung], self._held[n])
        return self._axes[n, rung]

    def error(self, rungs: tuple[int, ...], symmetry: Symmetry) -> float:
        """Error at left-out tracks [m]; infinite for more functions than the tracks could tell."""
        return self._left_out(rungs, symmetry)[0]

    def _left_out(self, rungs: tuple[int, ...], symmetry: Symmetry) -> tuple[float, float, float]:
        key = (rungs, symmetry)
        if key not in self._known:
            X, _, valid = self._tracks
            space = self.space(rungs, symmetry)
            told = zip(space.scalar.axes, self._places, strict=True)
            few = space.scalar.size <= FINEST * len(X) and all(s.size <= n for s, n in told)
            self._known[key] = np.inf, np.inf, 1.0
            with suppress(np.linalg.LinAlgError):
                if few and space.size <= 3.0 * LARGEST * len(X):
                    self._known[key] = press(space, X, self._whole(space), valid)
        return self._known[key]

    def _looked(self, some: Sequence[tuple[int, ...]], symmetry: Symmetry) -> None:
        """Errors of some bases, as many at a time as there are cores."""
        new = sorted({r for r in some if (r, symmetry) not in self._known})
        spaces = [self.space(r, symmetry) for r in new]  # which share what they are made of
        if spaces:
            self._whole(spaces[0])

        def each(part: slice) -> None:
            for rungs in new[part]:
                self._left_out(rungs, symmetry)

        parted(each, len(new), 1)

    def _missed(self, rungs: tuple[int, ...], symmetry: Symmetry) -> float:
        """Mean square error at left-out tracks [m^2], less the share that noise has in the residual."""
        error, rest, free = self._left_out(rungs, symmetry)
        return error**2 * (1.0 - free * self._noise**2 / rest)

    def _refined(self, rungs: tuple[int, ...], axes: Sequence[int]) -> float:
        """Sum of the squares of the distances of knots along some axes [m^2]."""
        size = [self._axis(n, r).size for n, r in enumerate(rungs)]
        return float(np.sum((((self._body.high - self._body.low) / size) ** 2)[list(axes)]))

    def _needed(self, now: tuple[int, ...], symmetry: Symmetry) -> list[int]:
        """Axes along which steps that were taken, or the next ones, surely gain or cannot be told."""

        def along(axis: int, rung: int) -> tuple[int, ...]:
            both = symmetry.exchange if axis in symmetry.exchange else (axis,)
            return tuple(rung if a in both else n for a, n in enumerate(now))

        def gains(axis: int) -> bool:
            less = along(axis, 0)
            more = [now] if now[axis] else [along(axis, 1), along(axis, 2)]
            untold = not all(np.isfinite(self.error(r, symmetry)) for r in more)
            return untold or any(not self._alike(less, r, less, symmetry) for r in more)

        return [axis for axis in range(3) if gains(axis)]

    def _step(
        self, now: tuple[int, ...], symmetry: Symmetry, limit: float
    ) -> tuple[int, ...] | None:
        """The step that gains most, where chance decides that the one that refines most for its
        functions, along axes that are needed; if that is too dear, the best of those that surely gain."""
        nexts = {symmetry.evened(tuple((np.array(now) + c).tolist())) for c in CLIMBS}
        near = [r for r in sorted(nexts) if max(r) < len(LADDER)]
        self._looked(near, symmetry)
        near = [r for r in near if np.isfinite(self.error(r, symmetry))]
        found = self._best(now, near, symmetry)
        if found is None or self.error(found, symmetry) < limit:
            return found
        sure = [r for r in near if not self._alike(now, r, now, symmetry)]
        return self._best(now, [r for r in sure if self.error(r, symmetry) < limit], symmetry)

    def _best(
        self, now: tuple[int, ...], tried: Sequence[tuple[int, ...]], symmetry: Symmetry
    ) -> tuple[int, ...] | None:
        if not tried:
            return None
        first = min(tried, key=lambda r: self._missed(r, symmetry))
        alike = [r for r in tried if self._alike(r, first, now, symmetry)]
        axes = self._needed(now, symmetry)

        def worth(r: tuple[int, ...]) -> float:
            gain = self._refined(now, axes) - self._refined(r, axes)
            return gain / self._added(now, r, symmetry)

        found = max(alike, key=worth)
        sure = not self._alike(now, found, now, symmetry)
        return found if sure or worth(found) > 0.0 else None

    def _alike(
        self, one: tuple[int, ...], other: tuple[int, ...], now: tuple[int, ...], symmetry: Symmetry
    ) -> bool:
        """Whether ``one`` misses no more than ``other`` but for chance, both with ``now`` in them."""
        u, (error, rest, _) = self._tracks[1], self._left_out(other, symmetry)
        free = (self._added(now, one, symmetry) + self._added(now, other, symmetry)) * len(u)
        chance = SURE * np.sqrt(2.0 * free) * self._noise**2 / u.size
        least = self._missed(other, symmetry)
        return bool(self._missed(one, symmetry) <= least + chance * error**2 / rest)

    def _added(self, now: tuple[int, ...], to: tuple[int, ...], symmetry: Symmetry) -> int:
        return max(self.space(to, symmetry).size - self.space(now, symmetry).size, 1)

    def _whole(self, space: Space) -> np.ndarray:
        """The tracks less their drift, what is missing as a space fills it; without gaps, remembered."""
        X, u, valid = self._tracks
        symmetry = space.symmetry
        if not valid.all():
            return centred(symmetry, self._body, X, filled(space, X, u, valid))
        if symmetry not in self._centred:
            self._centred[symmetry] = centred(symmetry, self._body, X, u)
        return self._centred[symmetry]

    def limit(self, lowest: float) -> float:
        """Error [m] below which a basis is as good as the one of the ``lowest`` [m]."""
        return float(np.hypot(SLACK * lowest, ROOM * self._noise))

    def climbed(self, symmetry: Symmetry, floor: float) -> tuple[tuple[int, ...], float]:
        """Climbs where a basis gains most, while the error stays near the least found."""
        best: tuple[int, ...] = (0, 0, 0)
        lowest = self.error(best, symmetry)
        while lowest > floor:
            step = self._step(best, symmetry, self.limit(lowest))
            if step is None:
                break
            best, lowest = step, min(lowest, self.error(step, symmetry))
        return best, lowest

    def traded(self, rungs: tuple[int, ...], symmetry: Symmetry, floor: float) -> tuple[int, ...]:
        """Steps along one axis given for steps along another, while the error becomes less.

        It must become less by more than the noise that ``ROOM`` leaves aside, with about as many
        functions: less noise in fewer functions is no better a fit.
        """
        best, least = rungs, LIKE * self.space(rungs, symmetry).size
        groups: list[tuple[int, ...]] = [(a,) for a in range(3) if a not in symmetry.exchange]
        groups += [symmetry.exchange] * bool(symmetry.exchange)
        while self.error(best, symmetry) > floor:
            keys = []
            for (less, more), down, up in product(permutations(groups, 2), (1, 2), (1, 2)):
                own = np.array(best)
                own[list(less)] -= down
                own[list(more)] += up
                key = tuple(own.tolist())
                if not 0 <= min(key) <= max(key) < len(LADDER):
                    continue
                if self.space(key, symmetry).size >= least:
                    keys.append(key)
            self._looked(keys, symmetry)
            tried = {key: self.error(key, symmetry) for key in (best, *keys)}
            found = min(tried, key=lambda r: tried[r])
            gain = tried[best] ** 2 - tried[found] ** 2
            if found == best or gain < (ROOM * self._noise) ** 2:
                break
            best = found
        return best
