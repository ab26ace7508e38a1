"""Points of a surface that two cameras follow, in space."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from form_drake.perceive.correlate import ALIKE, Parts, grid, matched
from form_drake.perceive.optics import Places, projected, rays, triangulated
from form_drake.perceive.pictures import ends
from form_drake.perceive.splines import seen_in
from form_drake.perceive.track import Known, Points, Tracker
from form_drake.perceive.warps import affine
from form_drake.records import Camera

APART = 8.0  # pixels, by which a point may be off where the stated surface would have it
TOGETHER = 0.5  # of them, in which points may differ: cameras that are a little off shift all alike
CLEAR = 0.05  # the same, above which it is asked whether left is right
LIKELIER = 0.5  # times the scatter, below which that is so
ENDS = 0.5  # share of a part's pixels that may be black or white to the end of the sensor
FEW, HALF = 0.1, 0.5  # shares of the points that are left at least, and that are found again
DOUBT = "are left and right swapped, or the cameras calibrated otherwise?"
OUTSIDE = f"lie outside of a picture: {DOUBT}"
DARK = "are black or white to the end of the sensor: change the exposure"
PLAIN = "lie where a picture has no texture that would show how they move: take larger parts"
UNLIKE = f"look otherwise in the right picture, or lie elsewhere: {DOUBT}"


@dataclass(frozen=True)
class Stereo:
    """A pair of cameras, and trackers that begin with the first picture of each.

    Attributes:
        cameras: left and right.
        trackers: of the same points.
        chosen: which of the points that were asked for both cameras see, shape [points].
        gap: how far points in the first pictures are from where the cameras would see them in space, by
            matching and calibration; the same in all pictures [px], shape [cameras, points, 2].
    """

    cameras: tuple[Camera, Camera]
    trackers: tuple[Tracker, Tracker]
    chosen: np.ndarray
    gap: np.ndarray

    @classmethod
    def of(
        cls,
        cameras: Sequence[Camera],
        pictures: Sequence[np.ndarray],
        p_WQ: np.ndarray,
        normal_W: np.ndarray,
        half: int = 12,
        device: str = "cpu",
    ) -> "Stereo":
        """Find points of a stated surface in the first pictures of two cameras.

        Args:
            cameras: left and right, calibrated.
            pictures: grey values of each, shape [rows, columns].
            p_WQ: points of the surface as it is stated [m], shape [points, 3].
            normal_W: of the surface there, shape [points, 3].
            half: pixels from a point to the rim of what is compared.
            device: Warp device.

        Raises:
            ValueError: hardly a point is found in both pictures: cameras, exposure or texture are wrong, or
                left is right.
        """
        chosen, pixel = _found(cameras, pictures, p_WQ, normal_W, half, device)
        one, other = (
            Tracker.of(picture, places, half, device)
            for picture, places in zip(pictures, pixel, strict=True)
        )
        left, right = cameras
        first = triangulated(cameras, pixel, np.tile(np.eye(2), (*pixel.shape[:2], 1, 1)))
        gap = pixel - np.stack([projected(camera, first.p_WQ) for camera in cameras])
        return cls((left, right), (one, other), chosen, gap)

    def begun(self, pair: Sequence[np.ndarray]) -> "Followed":
        """Its points in the first pictures of both cameras."""
        first = [tracker.first for tracker in self.trackers]
        return Followed(self, tuple(zip(pair, first, strict=True)), tuple(first))

    def follow(self, pairs: Iterable[Sequence[np.ndarray]]) -> Iterator[Places]:
        """Points in space in each of some pairs of pictures; the first is that which was begun with.

        Covariances are of how points move: that of where they began is not in them.
        """
        now: Followed | None = None
        for pair in pairs:
            now = self.begun(pair) if now is None else now.next(pair)
            yield now.places

    def places(self, points: Sequence[Points]) -> Places:
        """Points in space from where both cameras see them.

        Rays that pass each other from the first do so alike ever after: else a point would move where
        its pixels become less sure.
        """
        pixel = np.stack([p.pixel for p in points]) - self.gap
        spread = np.stack([p.covariance for p in points])
        still = spread.trace(axis1=2, axis2=3) <= 0.0  # the first pictures: nothing has moved
        spread[still] = np.eye(2) * np.finfo(float).eps
        return triangulated(self.cameras, pixel, spread)


@dataclass(frozen=True)
class Followed:
    """How far a pair of cameras has followed its points.

    Attributes:
        stereo: the cameras and their trackers.
        known: the newest picture of each in which points were found, and where.
        points: where each camera sees them now.
    """

    stereo: Stereo
    known: tuple[Known, ...]
    points: tuple[Points, ...]

    def next(self, pair: Sequence[np.ndarray]) -> "Followed":
        """Followed into the next pictures."""
        ways = zip(self.stereo.trackers, self.known, pair, strict=True)
        points = tuple(tracker.next(known, picture) for tracker, known, picture in ways)
        newer = zip(self.known, pair, points, strict=True)
        known = tuple((new, p) if p.held.any() else last for last, new, p in newer)
        return Followed(self.stereo, known, points)

    @property
    def places(self) -> Places:
        """Points in space."""
        return self.stereo.places(self.points)

    @property
    def likeness(self) -> np.ndarray:
        """Correlation with the first pictures, the worse of both cameras', shape [points]."""
        return np.min([p.likeness for p in self.points], axis=0)


def _found(
    cameras: Sequence[Camera],
    pictures: Sequence[np.ndarray],
    p_WQ: np.ndarray,
    normal_W: np.ndarray,
    half: int,
    device: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Which points both first pictures show, and where [px], shape [2, chosen, 2]; as of ``Stereo.of``."""
    left, right = cameras
    seen = [seen_in(picture) for picture in pictures]
    at = projected(left, p_WQ)
    start = _across(left, right, at, p_WQ, normal_W)
    turned = _across(right, left, at, p_WQ, normal_W)[:, [0, 6]]
    inside = _inside(left, at, half) & _inside(right, at + start[:, [0, 6]], half)
    chosen = _kept(np.ones(len(at), bool), inside, OUTSIDE, 0.0)
    chosen = _kept(chosen, _lit(pictures[0], at, chosen, half), DARK)
    parts = Parts.of(seen[0], at[chosen], half, device=device)
    across = matched(parts, seen[1], start[chosen])
    off = across.shift - start[chosen][:, [0, 6]]
    good = across.settled & (across.likeness > ALIKE) & (np.linalg.norm(off, axis=1) < APART)
    _agreed(off[good], (across.shift - turned[chosen])[good])
    told = (parts.shows, good, at[chosen] + across.shift)
    shows, alike, found = (_filled(chosen, values) for values in told)
    chosen = _kept(chosen, shows, PLAIN)
    chosen = _kept(chosen, alike, UNLIKE, HALF)
    chosen = _kept(chosen, _inside(right, found, half), OUTSIDE)
    chosen = _kept(chosen, _lit(pictures[1], found, chosen, half), DARK)
    parts = Parts.of(seen[1], found[chosen], half, device=device)
    chosen = _kept(chosen, _filled(chosen, parts.shows), PLAIN)
    return chosen, np.stack([at[chosen], found[chosen]])


def _agreed(off: np.ndarray, turned: np.ndarray) -> None:
    """Refuse pictures in which the surface is bent, as it is where left is right.

    Args:
        off: how far points of the right picture are from where the stated surface has them [px].
        turned: the same, were left right and right left.

    Raises:
        ValueError: see there.
    """
    if not len(off):
        return
    scatter, other = (
        float(np.sqrt(np.mean((o - np.median(o, axis=0)) ** 2))) for o in (off, turned)
    )
    if scatter > TOGETHER or (scatter > CLEAR and other < LIKELIER * scatter):
        raise ValueError(
            f"points of the left picture are found {scatter:.2g} px, not alike, from where the right"
            f" camera would see the stated surface, and {other:.2g} px if left were right: {DOUBT}"
        )


def _kept(before: np.ndarray, good: np.ndarray, others: str, share: float = FEW) -> np.ndarray:
    """Which points of those before are good.

    Raises:
        ValueError: fewer than three are, or than a share of them; what the others are.
    """
    found = before & good
    if found.sum() < max(3.0, share * before.sum()):
        raise ValueError(f"{int((before & ~good).sum())} of {int(before.sum())} points {others}")
    return np.asarray(found)


def _filled(chosen: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of the chosen points among all, zero elsewhere."""
    found = np.zeros((len(chosen), *values.shape[1:]), values.dtype)
    found[chosen] = values
    return found


def _lit(picture: np.ndarray, pixel: np.ndarray, chosen: np.ndarray, half: int) -> np.ndarray:
    """About which of the chosen points a picture is neither black nor white."""
    x, y = np.round(pixel[chosen][:, None] + grid(half)).astype(int).T
    return _filled(chosen, ends(picture)[y, x].mean(axis=0) <= ENDS)


def _inside(camera: Camera, pixel: np.ndarray, half: int) -> np.ndarray:
    """Whether parts about pixels are in a camera's picture, with room to be read."""
    room = half + 4.0
    high = np.array(camera.size) - 1.0 - room
    return np.asarray(np.all((pixel > room) & (pixel < high), axis=1))


def _across(
    left: Camera, right: Camera, at: np.ndarray, p_WQ: np.ndarray, normal_W: np.ndarray
) -> np.ndarray:
    """Warps from the left to the right picture, where the surface is as stated, shape [points, 12]."""

    def through(pixel: np.ndarray) -> np.ndarray:
        d = rays(left, pixel)
        along = np.sum((p_WQ - left.X_WC[:3, 3]) * normal_W, axis=1) / np.sum(d * normal_W, axis=1)
        return projected(right, left.X_WC[:3, 3] + along[:, None] * d) - pixel

    slope = [0.5 * (through(at + e) - through(at - e)) for e in np.eye(2)]
    return affine(through(at), np.stack(slope, axis=-1))
