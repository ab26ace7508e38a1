"""From pictures of two cameras to a recording of the points of a face."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from form_drake.perceive.pictures import Pictures
from form_drake.perceive.rig import Rig
from form_drake.perceive.stereo import Followed, Stereo
from form_drake.records import Recording

SEEN = 0.3  # share of all points in all frames that is to be held
APART = 20.0  # deviations, by which rays to the middle point may pass each other: pictures of one time do by one


def _none() -> np.ndarray:
    return np.zeros(0)


@dataclass(frozen=True)
class Sight:
    """Points of a face at one time.

    Attributes:
        time: [s].
        p_WQ: [m]; NaN: lost, shape [points, 3].
        covariance: of how they moved [m^2], shape [points, 3, 3].
        likeness: correlation with the first pictures, 1 at best, shape [points].
        pixel: where each camera sees them [px]; NaN: lost, shape [cameras, points, 2].
        apart: by how many deviations rays to the middle point pass each other; above ``APART``, the pictures
            are not of one time, and no point is in space.

    What is not of cameras has none of the last four.
    """

    time: float
    p_WQ: np.ndarray
    covariance: np.ndarray = field(default_factory=_none)
    likeness: np.ndarray = field(default_factory=_none)
    pixel: np.ndarray = field(default_factory=_none)
    apart: float = 0.0

    @classmethod
    def of(cls, time: float, now: Followed) -> "Sight":
        """What is seen of points that were followed."""
        places = now.places
        pixel = np.stack([points.pixel for points in now.points])
        seen = places.off[np.isfinite(places.off)]
        apart = float(np.median(seen)) if len(seen) else 0.0
        p_WQ = np.where(apart > APART, np.nan, places.p_WQ)
        return cls(time, p_WQ, places.covariance, now.likeness, pixel, apart)

    @property
    def held(self) -> np.ndarray:
        """Which points are not lost, shape [points]."""
        return np.asarray(np.isfinite(self.p_WQ).all(axis=1))


@dataclass(frozen=True)
class Count:
    """How many points were followed.

    Attributes:
        asked: points of the rig.
        first: of them, those found in the first pictures.
        again: of these, those ever found again.
        held: share of all that were asked for in all frames after the first.
    """

    asked: int
    first: int
    again: int
    held: float

    @classmethod
    def of(cls, rig: Rig, sights: Sequence[Sight]) -> "Count":
        """Of what was seen at two times at least."""
        asked, held = len(rig.points()), np.array([sight.held for sight in sights[1:]])
        again = int(held.any(axis=0).sum())
        return cls(asked, held.shape[1], again, float(held.sum() / (len(held) * asked)))

    def __str__(self) -> str:
        return (
            f"{self.asked} asked for, {self.first} found in the first pictures, {self.again} found again,"
            f" {100.0 * self.held:.1f} % held"
        )


def tracked(
    rig: Rig,
    pictures: Pictures,
    begin: float = 0.0,
    device: str = "cpu",
    progress: Callable[[int, Sight], None] = lambda *_: None,
) -> Recording:
    """Follow the points of a face through all pictures.

    Args:
        rig: cameras and face.
        pictures: of them.
        begin: stamp of frame 0 [s].
        device: Warp device.
        progress: called with the number of frames done and what is seen in the last.

    Returns:
        Points of the face, with what is lost marked; no forces and no poses yet.

    Raises:
        ValueError: pictures in which the face is not found, or hardly a point is held.
    """
    pairs = pictures.read()
    now: Followed | None = None
    found: list[Sight] = []
    for frame, pair in zip(pictures.frames, pairs, strict=True):
        now = followed(rig, now, pair, device)
        found.append(Sight.of(begin + frame / rig.rate, now))
        progress(len(found), found[-1])
    valid = np.array([sight.held for sight in found])
    if valid[1:].mean() < SEEN:
        lost = pictures.frames[1 + int(np.argmax(valid[1:].mean(axis=1) < SEEN))]
        raise ValueError(
            f"from frame {lost} on, {100.0 * valid[1:].mean():.0f} % of the {valid.shape[1]} points are found"
            " again: too fast, too dark, hidden, or not seen by both cameras at one time?"
        )
    return gathered(rig, found)


def followed(
    rig: Rig, before: Followed | None, pair: Sequence[np.ndarray], device: str = "cpu"
) -> Followed:
    """Points of a rig's face in the next pictures of its cameras; in the first, where there are none before.

    Raises:
        ValueError: first pictures in which the face is not found, or pictures of other sizes.
    """
    if before is not None:
        return before.next(pair)
    X, cameras = rig.points(), list(rig.cameras.values())
    normal = np.tile(rig.face.normal, (len(X), 1))
    return Stereo.of(cameras, pair, X, normal, rig.half, device).begun(pair)


def gathered(rig: Rig, sights: Sequence[Sight]) -> Recording:
    """What was seen at two times at least, as a recording without forces and poses.

    Raises:
        ValueError: no point was found again.
    """
    p_WQ = np.stack([sight.p_WQ for sight in sights])
    valid = np.stack([sight.held for sight in sights])
    kept = valid[1:].any(axis=0)
    if not kept.any():
        raise ValueError(
            f"none of {valid.shape[1]} points is found again in {len(sights) - 1} frames: too fast, too dark, or hidden?"
        )
    p_WQ, valid = p_WQ[:, kept], valid[:, kept]
    covariance = np.nanmean([sight.covariance[kept] for sight in sights[1:]], axis=0)
    low, high = (" ".join(f"{v:.9g}" for v in corner) for corner in (rig.low, rig.high))
    return Recording.from_arrays(
        np.array([sight.time for sight in sights]),
        np.where(valid[..., None], p_WQ, 0.0),
        valid=valid,
        visible=valid,
        face=np.full(valid.shape[1], rig.face.index),
        noise=float(np.sqrt(np.mean(covariance.trace(axis1=1, axis2=2)) / 3.0)),
        covariance=covariance,
        geometry={"shape": "box", "low": low, "high": high},
        cameras=dict(rig.cameras),
        source="form-drake track",
    )


def completed(tracks: Recording, probe: Recording) -> Recording:
    """Tracks with what was measured beside them: poses, forces, joints and statements.

    Of points and frames is told what the tracks tell: those of the probe are others.
    """
    own = [
        f.name for f in fields(Recording) if {"points", "frames"} & {*f.metadata.get("dims", ())}
    ]
    return replace(
        probe,
        **{name: getattr(tracks, name) for name in (*own, "states", "noise", "cameras")},
        geometry={**probe.geometry, **tracks.geometry},
    )
