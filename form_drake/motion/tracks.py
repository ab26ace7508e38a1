"""What a recording tells of a body's points: displacements, and how noisy they are."""

import numpy as np

from form_drake.motion.body import Body
from form_drake.motion.modes import white_noise
from form_drake.records import Recording, picked

NEAR = np.array([-2, -1, 1, 2])  # neighbours of a stamp
FLAT = 0.02  # of the widest extent of the points, in units of the box, below which they are a plane
OUTSIDE = 0.02  # of the box, by which points may lie beyond it
ASIDE = 0.1  # of its longest side, by which the points of a face may lie off that face together
POINTS, FRAMES = 8, 8  # fewer than which tell no motion
SIGHTED = 0.5  # of the points, fewer than which make a frame blind


def valid_points(recording: Recording) -> np.ndarray:
    """Which points are measured in which frame, shape [frames, points]."""
    found = np.isfinite(recording.p_WQ).all(axis=2)
    return found if recording.valid is None else found & recording.valid


def sighted(recording: Recording) -> Recording:
    """Without the frames in which less than half of the points are seen that are seen at all.

    What fills them would count as measured. The first one is kept where points have their stress-free
    positions from it.

    Raises:
        ValueError: fewer than two frames are left.
    """
    valid = valid_points(recording)
    share = valid[:, valid.any(axis=0)]
    kept = np.mean(share, axis=1) >= SIGHTED if share.size else np.ones(len(valid), dtype=bool)
    kept[0] |= recording.p_reference is None
    if kept.sum() < 2:
        raise ValueError(
            f"in {int(kept.sum())} of {len(kept)} frames half of the points are seen: two at least are wanted;"
            " track points that stay in sight"
        )
    return recording if kept.all() else picked(recording, np.flatnonzero(kept))


def placed(recording: Recording) -> np.ndarray:
    """Which points have a stress-free position that is known, shape [points]."""
    found = np.isfinite(recording.reference).all(axis=1)
    if recording.valid is not None and recording.p_reference is None:
        found &= recording.valid[0]
    return np.asarray(found)


def bridged(u: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Displacements with lines from frame to frame where a point is not seen."""
    u = u.copy()
    frames = np.arange(len(u))
    for p in np.flatnonzero(~valid.all(axis=0) & valid.any(axis=0)):
        seen = valid[:, p]
        for i in range(3):
            u[~seen, p, i] = np.interp(frames[~seen], frames[seen], u[seen, p, i])
    return u


def require_frames(recording: Recording) -> None:
    """Refuse a recording that is too short to show how points move.

    Raises:
        ValueError: see there.
    """
    if recording.frames < FRAMES:
        raise ValueError(f"{recording.frames} frames: {FRAMES} or more are needed")


def tracks(
    recording: Recording, body: Body, *, throughout: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stress-free positions, displacements, validity and time of the points ever seen, and which they are.

    Displacements of points that are not seen lie on lines from frame to frame. Points of a face that lie
    off it together, as where cameras have turned since they were calibrated, are moved onto it.

    Raises:
        ValueError: too few points or frames, points off their face or in other units than the box, or
            points that do not lie ``throughout`` the body.
    """
    valid = valid_points(recording)
    stated = recording.p_reference is not None
    known = valid.any(axis=0) if stated else valid[0]  # others have no stress-free position
    reference = _on_faces(recording, body) if recording.on_surface else recording.reference
    edge = OUTSIDE * (body.high - body.low)
    inside = (reference >= body.low - edge) & (reference <= body.high + edge)
    used = (valid.sum(axis=0) >= 0.5 * recording.frames) & inside.all(axis=1) & known
    if known.any():
        _check_units(reference[known], body, inside[known].all(axis=1))
    X = reference[used]
    if len(X) < POINTS:
        first = "" if stated else ", and in the first, which gives their stress-free positions"
        raise ValueError(
            f"{len(X)} points are seen in half of the frames{first}: {POINTS} or more are needed"
        )
    require_frames(recording)
    flat = np.linalg.svd((X - X.mean(axis=0)) / (body.high - body.low), compute_uv=False)
    if throughout and flat[-1] < FLAT * flat[0]:
        raise ValueError(
            "all points lie on one plane: motion inside the body needs points throughout it, or the"
            " face that each lies on (points/face), from which the inside is reconstructed"
        )
    u = np.where(valid[:, :, None], recording.p_WQ - recording.reference, 0.0)
    time = recording.time - recording.time[0]
    return X, bridged(u[:, used], valid[:, used]), valid[:, used], time, used


def _on_faces(recording: Recording, body: Body) -> np.ndarray:
    """Stress-free positions [m], those of the points of each face moved onto it together."""
    X, most = recording.reference.copy(), ASIDE * float(np.max(body.high - body.low))
    assert recording.face is not None
    known = placed(recording)
    for face in body.faces:
        own = recording.face == face.index
        if not np.any(own & known):
            continue
        place = float((body.low, body.high)[face.side][face.axis])
        off = float(np.median(X[own & known, face.axis])) - place
        if abs(off) <= most:
            X[own, face.axis] -= off
        elif abs(off) < 10.0 * most:  # else lengths may be in other units
            raise ValueError(
                f"points of face {face.name} lie {1e3 * abs(off):.3g} mm off that face of the stated box, up"
                f" to {1e3 * most:.3g} mm are allowed: is the box stated where it stood, and have the cameras"
                " turned since they were calibrated?"
            )
    return X


def _check_units(X: np.ndarray, body: Body, inside: np.ndarray) -> None:
    size, spread = float(np.max(body.high - body.low)), float(np.max(np.ptp(X, axis=0)))
    if not 0.02 < spread / size < 50.0 or inside.mean() < 0.2:
        raise ValueError(
            f"points span {spread:.4g} m, the stated box {size:.4g} m, and {inside.sum()} of"
            f" {len(X)} points lie in it; lengths are metres: are some in millimetres?"
        )


def neighbours(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the cubic through four neighbours of every stamp, shape [middles, 4], and its index."""
    middle = np.arange(2, len(time) - 2)
    t = time[middle[:, None] + NEAR] - time[middle, None]
    weights = [
        np.prod([-t[:, j] / (t[:, i] - t[:, j]) for j in range(4) if j != i], axis=0)
        for i in range(4)
    ]
    return np.stack(weights, axis=1), middle


def noise_of(time: np.ndarray, u: np.ndarray, valid: np.ndarray) -> float:
    """Noise of one coordinate [m]: what is neither a mode of the motion nor smooth in time.

    Raises:
        ValueError: too much is missing to tell.
    """
    found = jitter(time, u, valid)
    whole = valid.all(axis=0)
    found = min(found, white_noise(u[:, whole])) if whole.any() else found
    if not np.isfinite(found):
        raise ValueError(
            "no point is seen in all frames, or in five running: how noisy tracks are cannot be told; state"
            " noise [m]"
        )
    return found


def jitter(time: np.ndarray, u: np.ndarray, valid: np.ndarray) -> float:
    """Noise of one coordinate [m] from its deviation from the cubic through four neighbours.

    The median over frames, so that moments of fast motion do not count; infinite where no point is seen
    in five frames running.
    """
    weights, middle = neighbours(time)
    error = u[middle] - np.einsum("fk,fkpi->fpi", weights, u[middle[:, None] + NEAR], optimize=True)
    error /= np.sqrt(1.0 + np.sum(weights**2, axis=1))[:, None, None]
    sure = valid[middle] & valid[middle[:, None] + NEAR].all(axis=1)
    square = np.array(
        [np.mean(e[s] ** 2) if s.any() else np.nan for e, s in zip(error, sure, strict=True)]
    )
    square = square[np.isfinite(square)]
    return float(np.sqrt(np.median(square))) if len(square) else np.inf
