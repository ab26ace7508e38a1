"""HTML report of points that two cameras have followed: pictures, what is wrong with points, and when."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.polynomial.chebyshev import chebvander2d

from form_drake.figures import likeness_over_time, points_on_picture, rests_on_picture
from form_drake.perceive.pictures import Pictures
from form_drake.perceive.rig import Rig
from form_drake.perceive.seen import Count, Sight
from form_drake.report import Report

ORDER, LEAST = 9, 3  # of a polynomial along the longer side of the face, and the least across
TOLD = 4.0  # points for each of its terms, at least
LOST = 5  # frames that are left out and are told one by one
LOOKS = 3  # pictures of each camera that are shown


def write_seen_report(path: Path, rig: Rig, pictures: Pictures, sights: Sequence[Sight]) -> None:
    """Write what cameras saw and how well points were followed.

    Args:
        path: of the page.
        rig: the cameras.
        pictures: that were read.
        sights: of every frame.
    """
    with catch_warnings():  # frames and points of which nothing was seen leave no means
        simplefilter("ignore", RuntimeWarning)
        _report(rig, pictures, sights).write(path)


def _report(rig: Rig, pictures: Pictures, sights: Sequence[Sight]) -> Report:
    report = Report(f"Points on face {rig.face.name}, followed by {' and '.join(rig.cameras)}")
    held = np.array([sight.held for sight in sights])
    rest = 1e6 * np.array([rests(rig, sight, sights[0]) for sight in sights])
    report.table(["what", "value"], _facts(rig, pictures, sights, rest))
    farthest = int(np.nanargmax([_moved(sight, sights[0]) for sight in sights]))
    looks = sorted({0, farthest, len(sights) - 1})
    if len(looks) < LOOKS:
        looks = sorted({*looks, farthest // 2})
    report.heading("What each camera sees")
    report.paragraph(
        "Points are coloured by how unlike their surroundings have become to the first picture; crosses are"
        " points that were lost, where they were seen last."
    )
    for n, name in enumerate(rig.cameras):
        rows = []
        for k in looks:
            picture, sight = pictures.pair(k)[n], sights[k]
            rows.append((picture, sight.pixel[n], sight.likeness, _last(sights[: k + 1], n)))
        titles = [f"{name}, t = {sights[k].time:.2f} s" for k in looks]
        report.figure(points_on_picture(rows, titles), f"Camera {name}")
    report.heading("What neighbours do not share")
    report.paragraph(
        f"Displacement of each point less a polynomial of order {ORDER} at most along the face, fitted to all"
        " of them: noise of the correlation, and what is finer than that polynomial. Arrows lie in the face; colours"
        " tell the part that sticks out of it."
    )
    picture = pictures.pair(farthest)[0]
    away = _on_picture(rig, sights[farthest], rest[farthest])
    if np.isfinite(rest[farthest]).any():
        report.figure(
            rests_on_picture(picture, sights[farthest].pixel[0], *away),
            f"The picture in which points have moved farthest, t = {sights[farthest].time:.2f} s",
        )
    report.heading("Over time")
    time = np.array([sight.time for sight in sights])
    likeness = np.array([np.where(s.held, s.likeness, np.nan) for s in sights])
    across = [a for a in range(3) if a != rig.face.axis]
    size = {
        "in the face": np.sqrt(np.nanmean(rest[:, :, across] ** 2, axis=(1, 2))),
        "out of it": np.sqrt(np.nanmean(rest[:, :, rig.face.axis] ** 2, axis=1)),
    }
    report.figure(
        likeness_over_time(time, held.mean(axis=1), likeness, size),
        "Share of the points that is held, likeness (median and worst twentieth), and what neighbours do not share",
    )
    return report


def rests(rig: Rig, sight: Sight, first: Sight) -> np.ndarray:
    """What a smooth field leaves of displacements from the first sight [m]; NaN: lost, shape [points, 3]."""
    found = np.full(sight.p_WQ.shape, np.nan)
    held = sight.held & first.held
    across = [a for a in range(3) if a != rig.face.axis]
    size = rig.high[across] - rig.low[across]
    at = 2.0 * (first.p_WQ[held][:, across] - rig.low[across]) / size - 1.0
    most = min(ORDER, int(np.sqrt(len(at) / TOLD)) - 1)
    if most < 1:
        return found
    orders = [min(most, max(LEAST, round(ORDER * float(s / size.max())))) for s in size]
    D = chebvander2d(at[:, 0], at[:, 1], orders)
    u = sight.p_WQ[held] - first.p_WQ[held]
    freedom = 1.0 - D.shape[1] / len(D)
    found[held] = (u - D @ np.linalg.lstsq(D, u, rcond=None)[0]) / np.sqrt(freedom)
    return found


def _moved(sight: Sight, first: Sight) -> float:
    held = sight.held & first.held
    if not held.any():
        return 0.0
    return float(np.mean(np.linalg.norm((sight.p_WQ - first.p_WQ)[held], axis=1)))


def _last(sights: Sequence[Sight], camera: int) -> np.ndarray:
    """Where points that are lost in the last of some sights were seen last [px], shape [lost, 2]."""
    lost = ~np.isfinite(sights[-1].pixel[camera, :, 0])
    found = np.full((int(lost.sum()), 2), np.nan)
    for sight in sights:
        now = sight.pixel[camera, lost]
        found = np.where(np.isfinite(now), now, found)
    return found


def _on_picture(rig: Rig, sight: Sight, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """In the first camera's picture: directions right and down, and out of the face [um]."""
    X_WC = next(iter(rig.cameras.values())).X_WC
    return rest @ X_WC[:3, :2], rest @ rig.face.normal


def _facts(
    rig: Rig, pictures: Pictures, sights: Sequence[Sight], rest: np.ndarray
) -> list[list[str]]:
    likeness = np.concatenate([s.likeness[s.held] for s in sights[1:]])
    stated = np.nanmean([s.covariance[s.held].mean(axis=0) for s in sights[1:]], axis=0)
    axis = rig.face.axis
    across = [a for a in range(3) if a != axis]
    deviation = 1e6 * np.sqrt(np.diag(stated))
    left_out = list(pictures.left_out)
    missing = ", ".join(map(str, left_out[:LOST])) or "none"
    missing += f" and {len(left_out) - LOST} more" * (len(left_out) > LOST)
    rows: list[tuple[str, Any]] = [
        ("frames", f"{len(sights)} at {rig.rate:.4g} Hz, without: {missing}"),
        ("points", str(Count.of(rig, sights))),
        (
            "likeness",
            f"median {np.median(likeness):.3f}, worst twentieth {np.quantile(likeness, 0.05):.3f}",
        ),
        (
            "stated deviation of a point",
            f"{np.sqrt(np.mean(deviation[across] ** 2)):.2g} um in the face, {deviation[axis]:.2g} um out of it",
        ),
        (
            "not shared by neighbours",
            f"{np.sqrt(np.nanmean(rest[1:][..., across] ** 2)):.2g} um in the face,"
            f" {np.sqrt(np.nanmean(rest[1:][..., axis] ** 2)):.2g} um out of it",
        ),
    ]
    return [[name, text] for name, text in rows]
