"""Where cameras see points, and where points are that several cameras see.

Camera frame C: x to the right, y down, z forward; pixel centres are integers (as Drake has them).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from form_drake.records import Camera

ROUNDS = 5  # Gauss-Newton steps from the middle of two rays
LENS = 10  # Newton's steps, in which a lens is undone
MISSED = 1e-9  # of the focal length, by which a ray may miss its pixel then
STEP = 1e-6  # of a point's distance, by which differences are taken


def looking(
    p_WC: np.ndarray,
    p_WT: np.ndarray,
    focus: float,
    size: tuple[int, int],
    distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
    down: Sequence[float] = (0.0, 1.0, 0.0),
) -> Camera:
    """A camera that sees a point in the middle of its pictures.

    Args:
        p_WC: where it is [m], shape [3].
        p_WT: what it looks at [m], shape [3].
        focus: focal length [px].
        size: width and height [px].
        distortion: Brown-Conrady coefficients k1 k2 p1 p2 k3.
        down: direction in world that is downwards in the pictures.

    Raises:
        ValueError: it looks along that direction.
    """
    z = np.asarray(p_WT, float) - p_WC
    x = np.cross(np.asarray(down, float), z)
    if not np.linalg.norm(x) > STEP * np.linalg.norm(z):
        raise ValueError(
            f"a camera that looks along {z.tolist()}: not along {list(down)}, its down"
        )
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    X_WC = np.eye(4)
    X_WC[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    X_WC[:3, 3] = p_WC
    K = np.array([[focus, 0.0, 0.5 * (size[0] - 1)], [0.0, focus, 0.5 * (size[1] - 1)], [0, 0, 1]])
    return Camera(K, X_WC, np.array(distortion, float), size)


def projected(camera: Camera, p_WQ: np.ndarray) -> np.ndarray:
    """Where points are seen [px]; NaN behind the camera, shape [..., 2]."""
    X_CW = np.linalg.inv(camera.X_WC)
    p_CQ = p_WQ @ X_CW[:3, :3].T + X_CW[:3, 3]
    depth = np.where(p_CQ[..., 2] > 0.0, p_CQ[..., 2], np.nan)
    ray = _bent(camera.distortion, p_CQ[..., :2] / depth[..., None])
    return np.asarray(ray @ camera.K[:2, :2].T + camera.K[:2, 2])


def rays(camera: Camera, pixel: np.ndarray) -> np.ndarray:
    """Directions from the camera through pixels, in world, one long along its axis, shape [..., 3].

    NaN where no ray is found that the lens would bend there.
    """
    seen = (pixel - camera.K[:2, 2]) @ np.linalg.inv(camera.K[:2, :2]).T
    ray = seen
    for _ in range(LENS):
        ray = ray + _unbent(camera.distortion, ray, seen - _bent(camera.distortion, ray))
    missed = np.linalg.norm(seen - _bent(camera.distortion, ray), axis=-1)
    ray = np.where((missed < MISSED)[..., None], ray, np.nan)
    d_C = np.concatenate([ray, np.ones((*ray.shape[:-1], 1))], axis=-1)
    return np.asarray(d_C @ camera.X_WC[:3, :3].T)


def _bent(k: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """What a lens does to x/z and y/z: Brown-Conrady, k1 k2 p1 p2 k3."""
    x, y = ray[..., 0], ray[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    side = np.stack(
        [
            2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
            k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
        ],
        axis=-1,
    )
    return np.asarray(ray * radial[..., None] + side)


def _unbent(k: np.ndarray, ray: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A small step behind the lens from one before it: by the inverse of the derivative of ``_bent``."""
    x, y = ray[..., 0], ray[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4]))
    a = radial + slope * x * x + 2.0 * k[2] * y + 6.0 * k[3] * x
    b = slope * x * y + 2.0 * (k[2] * x + k[3] * y)
    d = radial + slope * y * y + 6.0 * k[2] * y + 2.0 * k[3] * x
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = np.stack(
            [d * step[..., 0] - b * step[..., 1], a * step[..., 1] - b * step[..., 0]], axis=-1
        )
        return np.asarray(found / (a * d - b * b)[..., None])


@dataclass(frozen=True)
class Places:
    """Points in space.

    Attributes:
        p_WQ: [m]; NaN: not seen by two cameras, shape [points, 3].
        covariance: [m^2], shape [points, 3, 3].
        off: how far pixels are from what cameras would see of the points, in standard deviations, root
            mean square, shape [points]: far above one, cameras or matches are wrong.
    """

    p_WQ: np.ndarray
    covariance: np.ndarray
    off: np.ndarray


def triangulated(cameras: Sequence[Camera], pixel: np.ndarray, covariance: np.ndarray) -> Places:
    """Points in space by least squares over all cameras that see them.

    Args:
        cameras: calibrated.
        pixel: [px]; NaN: not seen, shape [cameras, points, 2].
        covariance: [px^2], shape [cameras, points, 2, 2].

    Raises:
        ValueError: there are fewer than two cameras, or pixels are not those of as many.
    """
    if len(cameras) < 2 or len(pixel) != len(cameras):
        raise ValueError(
            f"{len(cameras)} cameras and pixels of {len(pixel)}: two are wanted at least, and as many"
        )
    seen = np.isfinite(pixel).all(axis=2)
    use: np.ndarray = seen.sum(axis=0) > 1
    weight = np.zeros((*seen.shape, 2, 2))
    weight[seen] = np.linalg.inv(covariance[seen])
    weight[:, ~use] = 0.0
    p = _nearest(cameras, np.where(seen[..., None], pixel, 0.0), seen & use)
    for n in range(ROUNDS + 1):
        gap, J = _linear(cameras, pixel, weight, p)
        spread = np.linalg.inv(
            np.einsum("cpai,cpab,cpbj->pij", J, weight, J) + np.eye(3) * ~use[:, None, None]
        )
        if n < ROUNDS:
            p = p + np.einsum("pij,cpaj,cpab,cpb->pi", spread, J, weight, gap)
    square = np.einsum("cpa,cpab,cpb->p", gap, weight, gap)
    off = np.sqrt(square / np.maximum(2 * seen.sum(axis=0) - 3, 1))
    none = np.where(use, 0.0, np.nan)
    return Places(p + none[:, None], spread + none[:, None, None], off + none)


def _nearest(cameras: Sequence[Camera], pixel: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Points nearest to all rays, shape [points, 3]."""
    normal, right = np.zeros((pixel.shape[1], 3, 3)), np.zeros((pixel.shape[1], 3))
    for camera, at, own in zip(cameras, pixel, seen, strict=True):
        d = rays(camera, at)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        across = (np.eye(3) - d[:, :, None] * d[:, None]) * own[:, None, None]
        normal += across
        right += across @ camera.X_WC[:3, 3]
    dark = ~np.asarray(seen.any(axis=0))
    normal += np.eye(3) * dark[:, None, None]
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0])


def _linear(
    cameras: Sequence[Camera], pixel: np.ndarray, weight: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels less what cameras see of points, and the latter's derivatives, zero where not seen."""
    gap, J = np.zeros(pixel.shape), np.zeros((*pixel.shape, 3))
    for c, camera in enumerate(cameras):
        step = STEP * np.linalg.norm(p - camera.X_WC[:3, 3], axis=1)[:, None]
        ways = [projected(camera, p + s * step * e) for e in np.eye(3) for s in (1.0, -1.0)]
        turn = [(a - b) / (2.0 * step) for a, b in zip(ways[::2], ways[1::2], strict=True)]
        J[c] = np.stack(turn, axis=-1)
        gap[c] = pixel[c] - projected(camera, p)
    held = weight[..., :1, 0] > 0.0
    return np.where(held, gap, 0.0), np.where(held[..., None], J, 0.0)
