"""Points of a first picture, followed through those after it.

Optical flow from one picture to the next, fitted by lines among neighbours, tells where to begin;
correlation with the first picture tells where a point is, so that no error adds up. What is lost is
said, and sought again from its neighbours in every picture.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from form_drake.perceive.correlate import ALIKE, Matches, Parts, matched, place
from form_drake.perceive.splines import seen_in
from form_drake.perceive.warps import affine

NEIGHBOURS = 12  # whose flow is fitted by a line
BENT = 9.0  # variances of a second-order warp's shift, from which its square counts
FAR = 6.0  # times the scatter of its neighbours, by which a point is off them
LEAST = 0.05  # pixels, of that scatter
ROBUST = 4  # rounds of weights that grow smaller with distance
RIDGE = (1e-9, 1e-3, 1e-3)  # keeps points without neighbours still
TINY = 1e-9
WINDOW, LEVELS = 21, 3  # of the optical flow


@dataclass(frozen=True)
class Points:
    """Where points are in one picture.

    Attributes:
        pixel: x to the right and y down [px]; NaN: it is lost, shape [points, 2].
        covariance: [px^2], shape [points, 2, 2].
        likeness: correlation with the first picture, shape [points].
        warps: about each, shape [points, 12]; of lost ones those of their neighbours.
    """

    pixel: np.ndarray
    covariance: np.ndarray
    likeness: np.ndarray
    warps: np.ndarray

    @property
    def held(self) -> np.ndarray:
        """Which are not lost, shape [points]."""
        return np.asarray(np.isfinite(self.pixel[:, 0]))


Known = tuple[np.ndarray, Points]  # a picture, and where points are in it


@dataclass(frozen=True)
class Tracker:
    """Parts of a first picture, and who their neighbours are.

    Attributes:
        straight: parts whose warps are of first order.
        bent: the same of second order.
        near: neighbours, shape [points, neighbours].
    """

    straight: Parts
    bent: Parts
    near: np.ndarray

    @classmethod
    def of(
        cls, picture: np.ndarray, points: np.ndarray, half: int = 12, device: str = "cpu"
    ) -> "Tracker":
        """Begin with a first picture.

        Args:
            picture: grey values, 0 to 255, shape [rows, columns].
            points: [px], shape [points, 2].
            half: pixels from a point to the rim of what is compared.
            device: Warp device.

        Raises:
            ValueError: fewer than three points, one that leaves the picture, or one about which no texture
                shows how it moves.
        """
        if len(points) < 3:
            raise ValueError(f"{len(points)} points: three are wanted at least")
        seen = seen_in(picture)
        straight, bent = (
            Parts.of(seen, points, half, affine=a, device=device) for a in (True, False)
        )
        if not bent.shows.all():
            raise ValueError(
                f"a part at {place(points[bent.shows.argmin()])} px has no texture that would show how it moves:"
                " choose another place or larger parts"
            )
        count = min(NEIGHBOURS + 1, len(points))
        near = cKDTree(points).query(points, count)[1][:, 1:]
        return cls(straight, bent, near)

    @property
    def first(self) -> Points:
        """In the first picture."""
        count = len(self.straight.middle)
        return Points(
            self.straight.middle, np.zeros((count, 2, 2)), np.ones(count), np.zeros((count, 12))
        )

    def follow(self, pictures: Iterable[np.ndarray]) -> Iterator[Points]:
        """Points in each of some pictures; the first is that in which they were chosen."""
        known: Known | None = None
        for picture in pictures:
            points = self.first if known is None else self.next(known, picture)
            known = (picture, points) if known is None or points.held.any() else known
            yield points

    def next(self, known: Known, picture: np.ndarray) -> Points:
        """Points in the picture after one in which they are known.

        Raises:
            ValueError: pictures of other sizes.
        """
        before, points = known
        if picture.shape != before.shape:
            now, then = (f"{p.shape[1]} x {p.shape[0]} px" for p in (picture, before))
            raise ValueError(f"a picture of {now} after one of {then}")
        flow = flown(before, picture, points.warps[:, [0, 6]] + self.straight.middle)
        shift = points.warps[:, [0, 6]] + flow
        shift[~points.held] = np.nan
        seen = seen_in(picture)
        found = self._matched(seen, self._lines(shift, points.warps))
        again = ~found.held
        if again.any():
            moved = found.pixel - self.straight.middle
            second = self._matched(seen, self._lines(moved, points.warps))
            found = _where(again & second.held, second, found)
        return found

    def _matched(self, seen: np.ndarray, start: np.ndarray) -> Points:
        line = matched(self.straight, seen, start)
        curve = matched(self.bent, seen, line.warps)
        bent = curve.settled & self._bends(line, curve)
        warps = np.where(bent[:, None], curve.warps, line.warps)
        likeness = np.where(bent, curve.likeness, line.likeness)
        covariance = np.where(bent[:, None, None], curve.covariance, line.covariance)
        held = (bent | line.settled) & (likeness > ALIKE)
        pixel = self.straight.middle + warps[:, [0, 6]]
        pixel[~held] = np.nan
        off = self._off(pixel - self.straight.middle, start)
        pixel[off] = np.nan
        lost = ~np.isfinite(pixel[:, 0])
        warps = np.where(lost[:, None], self._lines(pixel - self.straight.middle, start), warps)
        return Points(pixel, covariance, likeness, warps)

    @staticmethod
    def _bends(line: Matches, curve: Matches) -> np.ndarray:
        """Where second order shifts a point by more than noise does (Hausman 1978)."""
        apart = curve.shift - line.shift
        spread = np.maximum(np.trace(curve.covariance - line.covariance, axis1=1, axis2=2), 1e-12)
        return np.asarray(~line.settled | (2.0 * np.sum(apart**2, axis=1) > BENT * spread))

    def _lines(self, shift: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Warps of first order from the shifts of neighbours; ``last`` ones where all of them are lost."""
        middle = self.straight.middle
        everyone = np.concatenate([np.arange(len(middle))[:, None], self.near], axis=1)
        known = np.isfinite(shift[everyone, 0])
        d = middle[everyone] - middle[:, None]
        b = np.where(known[..., None], shift[everyone], 0.0)
        A = np.concatenate([np.ones((*d.shape[:2], 1)), d], axis=2)
        weight = known.astype(float)
        for _ in range(ROBUST):
            normal = np.einsum("sni,sn,snj->sij", A, weight, A) + np.diag(RIDGE)
            x = np.linalg.solve(normal, np.einsum("sni,sn,snk->sik", A, weight, b))
            off = np.linalg.norm(b - A @ x, axis=2)
            scatter = _median(np.where(known, off, np.nan))[:, None]
            weight = known * np.minimum(1.0, 2.0 * scatter / np.maximum(off, TINY))
        found = affine(x[:, 0], x[:, 1:].transpose(0, 2, 1))
        return np.where(known.any(axis=1)[:, None], found, last)

    def _off(self, shift: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Which points go another way than their neighbours."""
        start = self._lines(shift, last)
        off = np.linalg.norm(shift - start[:, [0, 6]], axis=1)
        return np.asarray(off > FAR * _median(off[self.near]))


def _median(off: np.ndarray) -> np.ndarray:
    """Of each row, what is lost left out, and ``LEAST`` at least."""
    known = np.isfinite(off).any(axis=1)
    found = np.full(len(off), LEAST)
    found[known] = np.nanmedian(off[known], axis=1)
    return np.maximum(found, LEAST)


def flown(before: np.ndarray, picture: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Optical flow of places [px] (Lucas and Kanade 1981, by pyramids); NaN: unknown, shape [points, 2]."""
    import cv2

    pair = [np.clip(p, 0, 255).astype(np.uint8) for p in (before, picture)]
    there, known, _ = cv2.calcOpticalFlowPyrLK(
        *pair, at.astype(np.float32)[:, None], None, winSize=(WINDOW, WINDOW), maxLevel=LEVELS
    )
    flow = there[:, 0].astype(float) - at
    flow[known[:, 0] == 0] = np.nan
    return flow


def _where(chosen: np.ndarray, one: Points, other: Points) -> Points:
    """Some points of one, the rest of another."""
    fields = {
        name: np.where(
            chosen.reshape(-1, *[1] * (getattr(one, name).ndim - 1)),
            getattr(one, name),
            getattr(other, name),
        )
        for name in ("pixel", "covariance", "likeness", "warps")
    }
    return replace(other, **fields)
