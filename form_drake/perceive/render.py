"""Pictures of a textured surface, as a camera takes them.

One ray through the middle of each pixel finds the triangle that is seen; rays about it meet that
triangle's plane and read the texture there, whose bilinear interpolant is the surface's own: no
filter stands between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter

from form_drake.perceive.kernels import pixels
from form_drake.perceive.optics import rays
from form_drake.records import Camera

RAYS = 4  # along each side of a pixel
GROUND = 20.0  # grey value where nothing is seen


@dataclass(frozen=True)
class Surface:
    """Triangles in world, and what is painted on them.

    Attributes:
        p_WV: vertices [m], shape [vertices, 3].
        triangles: their vertices, shape [triangles, 3].
        uv: places of their corners in the texture, column and row [texels], shape [triangles, 3, 2].
        texture: grey values, shape [rows, columns].
        plain: grey value of a triangle without texture; NaN: it has one, shape [triangles].
    """

    p_WV: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray
    texture: np.ndarray = field(repr=False)
    plain: np.ndarray

    @classmethod
    def of(
        cls, p_WV: np.ndarray, triangles: np.ndarray, uv: np.ndarray, texture: np.ndarray
    ) -> "Surface":
        """All of it textured."""
        return cls(p_WV, triangles, uv, texture, np.full(len(triangles), np.nan))

    def moved(self, p_WV: np.ndarray) -> "Surface":
        """The same with its vertices elsewhere."""
        return replace(self, p_WV=p_WV)

    def beside(self, p_WV: np.ndarray, triangles: np.ndarray, grey: float) -> "Surface":
        """With something before or behind it that has no texture, such as a tool."""
        more = len(triangles)
        return Surface(
            np.concatenate([self.p_WV, p_WV]),
            np.concatenate([self.triangles, triangles + len(self.p_WV)]),
            np.concatenate([self.uv, np.zeros((more, 3, 2))]),
            self.texture,
            np.concatenate([self.plain, np.full(more, grey)]),
        )


@dataclass(frozen=True)
class Light:
    """What a sensor makes of light.

    Attributes:
        noise: standard deviation of a grey value.
        blur: of the lens [px].
        gain: factor on grey values.
        offset: added to them.
    """

    noise: float = 2.0
    blur: float = 0.0
    gain: float = 1.0
    offset: float = 0.0

    def seen(self, picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A picture of eight bits."""
        light = gaussian_filter(picture, self.blur) if self.blur > 0.0 else picture
        noise = self.noise * rng.standard_normal(picture.shape)
        return np.clip(np.round(self.gain * light + self.offset + noise), 0, 255).astype(np.uint8)


class Renderer:
    """Cameras whose rays are known."""

    def __init__(self, cameras: Sequence[Camera], device: str = "cpu"):
        """Find the rays of every pixel.

        Args:
            cameras: calibrated, with a size.
            device: Warp device.
        """
        self.cameras, self.device = tuple(cameras), device
        self._rays = [
            [wp.array(d, dtype=wp.vec3, device=device) for d in _directions(camera)]
            for camera in cameras
        ]

    def pictures(self, surface: Surface) -> list[np.ndarray]:
        """Grey values without noise, one picture for each camera, shape [rows, columns]."""
        middle = surface.p_WV.mean(axis=0)  # float32 resolves nanometres about it
        points = (surface.p_WV - middle).astype(np.float32)
        mesh = wp.Mesh(
            points=wp.array(points, dtype=wp.vec3, device=self.device),
            indices=wp.array(surface.triangles.ravel(), dtype=wp.int32, device=self.device),
        )
        uv, texture, plain = (
            wp.array(a.astype(np.float32), dtype=kind, device=self.device)
            for a, kind in (
                (surface.uv.reshape(-1, 2), wp.vec2),
                (surface.texture, wp.float32),
                (surface.plain, wp.float32),
            )
        )
        found = []
        for camera, ways in zip(self.cameras, self._rays, strict=True):
            origin = wp.vec3(*(camera.X_WC[:3, 3] - middle).tolist())
            seen = wp.zeros(ways[0].shape, dtype=wp.float32, device=self.device)
            inputs = [mesh.id, origin, *ways, uv, texture, plain, RAYS, GROUND]
            wp.launch(pixels(), seen.shape, inputs, [seen], device=self.device)
            found.append(seen.numpy().astype(float))
        return found


def _directions(camera: Camera) -> list[np.ndarray]:
    """Rays through the middles of pixels, and by how much they turn to the next column and row."""
    width, height = camera.size
    at = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
    steps = np.eye(2) * 0.5
    turns = [rays(camera, at + s) - rays(camera, at - s) for s in steps]
    return [d.astype(np.float32) for d in (rays(camera, at), *turns)]
