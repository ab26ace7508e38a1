"""From pictures of two cameras to a recording of the points of a face."""

from collections.abc import Callable
from dataclasses import replace
from itertools import chain

import numpy as np

from form_drake.perceive.optics import Places
from form_drake.perceive.pictures import Pictures
from form_drake.perceive.rig import Rig
from form_drake.perceive.stereo import Stereo
from form_drake.records import Recording

SEEN = 0.3  # share of all points in all frames that is to be held


def tracked(
    rig: Rig,
    pictures: Pictures,
    begin: float = 0.0,
    device: str = "cpu",
    progress: Callable[[int, Places], None] = lambda *_: None,
) -> Recording:
    """Follow the points of a face through all pictures.

    Args:
        rig: cameras and face.
        pictures: of them.
        begin: stamp of frame 0 [s].
        device: Warp device.
        progress: called with the number of frames done and the points of the last.

    Returns:
        Points of the face, with what is lost marked; no forces and no poses yet.

    Raises:
        ValueError: pictures in which the face is not found, or hardly a point is held.
    """
    cameras = list(rig.cameras.values())
    X = rig.points()
    pairs = pictures.read(cameras)
    first = next(pairs)
    stereo = Stereo.of(cameras, first, X, np.tile(rig.face.normal, (len(X), 1)), rig.half, device)
    found: list[Places] = []
    for places in stereo.follow(chain([first], pairs)):
        found.append(places)
        progress(len(found), places)
    p_WQ = np.stack([f.p_WQ for f in found])
    valid = np.isfinite(p_WQ).all(axis=2)
    if valid[1:].mean() < SEEN:
        lost = pictures.frames[1 + int(np.argmax(valid[1:].mean(axis=1) < SEEN))]
        raise ValueError(
            f"from frame {lost} on, {100.0 * valid[1:].mean():.0f} % of the {valid.shape[1]} points are found"
            " again: too fast, too dark, or hidden?"
        )
    kept = valid[1:].any(axis=0)
    p_WQ, valid = p_WQ[:, kept], valid[:, kept]
    covariance = np.nanmean([f.covariance[kept] for f in found[1:]], axis=0)
    low, high = (" ".join(f"{v:.9g}" for v in corner) for corner in (rig.low, rig.high))
    return Recording.from_arrays(
        begin + np.array(pictures.frames) / rig.rate,
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
    """Tracks with what was measured beside them: poses, forces, joints and statements."""
    return replace(
        probe,
        time=tracks.time,
        p_WQ=tracks.p_WQ,
        valid=tracks.valid,
        visible=tracks.visible,
        face=tracks.face,
        p_reference=None,
        noise=tracks.noise,
        covariance=tracks.covariance,
        cameras=tracks.cameras,
        geometry={**probe.geometry, **tracks.geometry},
    )
