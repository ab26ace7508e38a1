"""Pictures of a station with its soft body, rendered without a display."""

import io
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    GeometryId,
    InMemoryMesh,
    LightParameter,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngine,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    Role,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context
from pydrake.systems.sensors import CameraInfo, ImageRgba8U

from form_drake.files import whole
from form_drake.skin import Skin, field_named
from form_drake.systems.station import Station

COLOURS = "viridis"
SMOOTH = 2  # pixels rendered along each edge of one that is given
BACKGROUND = (0.93, 0.95, 0.97)
CLAY = (0.82, 0.45, 0.30)
LINES, LINE = 0.005, 0.0003  # distance and width of the lines on an uncoloured body [m]
TEXELS = 1024  # along an edge of its texture
NEAR, FAR = 0.02, 8.0  # what the camera sees [m]
SUN = LightParameter(type="directional", frame="world", direction=[-0.4, 0.5, -1.0], intensity=0.5)
# Lights at points cast no shadows: these show what lies in that of the sun.
FILL = (
    LightParameter(type="point", frame="camera", position=[-0.5, -0.3, -0.2], intensity=0.68),
    LightParameter(type="point", frame="world", position=[3.0, -1.0, 1.0], intensity=0.35),
    LightParameter(type="point", frame="world", position=[0.3, 0.0, 4.0], intensity=0.12),
)


@dataclass(frozen=True)
class Camera:
    """An ideal camera.

    Attributes:
        p_WC: where it is [m].
        p_WT: what it looks at, which is the middle of the picture [m].
        fov: vertical field of view [deg].
        width: of the picture [pixels].
        height: of the picture [pixels].
    """

    p_WC: tuple[float, float, float]
    p_WT: tuple[float, float, float]
    fov: float = 30.0
    width: int = 960
    height: int = 720

    @property
    def X_WC(self) -> RigidTransform:
        """Pose of the camera: z forward, x to the right."""
        forward = np.subtract(self.p_WT, self.p_WC)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        z, x = (v / np.linalg.norm(v) for v in (forward, right))
        R_WC = RotationMatrix(np.stack([x, np.cross(z, x), z], axis=1))
        return RigidTransform(R_WC, self.p_WC)

    def info(self, finer: int = 1) -> CameraInfo:
        """Its intrinsics, with ``finer`` pixels in place of one along each edge."""
        return CameraInfo(finer * self.width, finer * self.height, np.radians(self.fov))


def close_up(station: Station, **options: Any) -> Camera:
    """A camera that looks at specimen and tool."""
    rest = station.material.scene.rest
    middle, size = rest.mean(axis=0), np.ptp(rest, axis=0).max()
    eye = (0.22 + 2.4 * size) * np.array([0.5, -0.83, 0.25])
    return Camera(tuple(middle + eye), tuple(middle + np.array([0.0, 0.0, 0.01])), **options)


def overview(station: Station, **options: Any) -> Camera:
    """A camera that looks at the whole robot."""
    x, y, z = station.material.scene.rest.mean(axis=0)
    eye = (x + 0.85, y - 1.5, z + 0.62)
    return Camera(eye, (0.5 * x, 0.5 * y, z + 0.24), **options)


class Studio:
    """A render engine that holds the visible geometry of a station.

    Its pictures leave the Context as it is.

    Args:
        station: whose rigid geometry is drawn as its models say.
        shadows: whether lights cast them.
    """

    def __init__(self, station: Station, *, shadows: bool = True):
        self._station, self._engine = station, _engine(shadows)
        scene, bodies = station.material.scene, station.material.scene.simulation.bodies
        ends = np.cumsum([len(b.x) for b in bodies])
        self._rest = scene.rest
        self._parts = [slice(end - len(b.x), end) for end, b in zip(ends, bodies, strict=True)]
        self._skins = [Skin.of(self._rest[part]) for part in self._parts]
        self._ids = [GeometryId.get_new_id() for _ in bodies]
        self._poses: dict[GeometryId, RigidTransform] = {}

    def picture(
        self,
        context: Context,
        camera: Camera,
        *,
        field: str | None = None,
        limits: tuple[float, float] | None = None,
        specimen: bool = True,
    ) -> np.ndarray:
        """The station as it is in a Context.

        Args:
            context: root Context of the station's diagram, or of one that holds it.
            camera: that looks.
            field: that colours the specimen, see ``form_drake.skin.FIELDS``; None: plain, with
                lines every 5 mm of the body free of stress.
            limits: ends of the colour map in the field's unit; None: those of this state.
            specimen: whether it is drawn.

        Returns:
            Colours, uint8, shape [height, width, 3].

        Raises:
            ValueError: no such field.
        """
        own = self._station.diagram.GetMyContextFromRoot(context)
        self._place(self._station.diagram.GetOutputPort("query_object").Eval(own))
        for geometry in self._ids:
            self._engine.RemoveGeometry(geometry)
        if specimen:
            self._dress(own, field, limits)
        self._engine.UpdateViewpoint(camera.X_WC)
        fine = camera.info(SMOOTH)
        core = RenderCameraCore("", fine, ClippingRange(NEAR, FAR), RigidTransform())
        image = ImageRgba8U(fine.width(), fine.height())
        self._engine.RenderColorImage(ColorRenderCamera(core, False), image)
        blocks = image.data[:, :, :3].reshape(camera.height, SMOOTH, camera.width, SMOOTH, 3)
        return blocks.mean(axis=(1, 3)).round().astype(np.uint8)

    def _place(self, query: Any) -> None:
        """Put rigid geometry where it is now; the engine's own way to move it is not in Python."""
        inspector = query.inspector()
        for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
            X_WG = query.GetPoseInWorld(geometry)
            if geometry in self._poses and X_WG.IsExactlyEqualTo(self._poses[geometry]):
                continue
            self._engine.RemoveGeometry(geometry)
            shown = inspector.GetIllustrationProperties(geometry)
            colour = shown.GetPropertyOrDefault("phong", "diffuse", Rgba(0.8, 0.8, 0.8))
            shape = inspector.GetShape(geometry)
            self._engine.RegisterVisual(geometry, shape, _look(colour), X_WG, False)
            self._poses[geometry] = X_WG

    def _dress(self, own: Context, field: str | None, limits: tuple[float, float] | None) -> None:
        """Put the bodies where they are now."""
        now = self._station.diagram.GetOutputPort("material.particles").Eval(own)
        value = (
            np.zeros(len(self._rest))
            if field is None
            else field_named(field).value(self._rest, now)
        )
        low, high = limits or (min(value.min(), 0.0), value.max())
        for geometry, part, skin in zip(self._ids, self._parts, self._skins, strict=True):
            points = skin.points(now.p_WQ[part])
            span = float(skin.mark.max())
            uv = skin.mark / span
            if field is not None:
                share = np.clip((skin.points(value[part]) - low) / max(high - low, 1e-12), 0.0, 1.0)
                uv = np.stack([(1.0 + 254.0 * share) / 256.0, np.full(len(share), 0.5)], axis=1)
            mesh = _mesh(
                skin.faces,
                points,
                skin.normals(points),
                uv,
                _lined(span) if field is None else _strip(),
            )
            self._engine.RegisterVisual(geometry, mesh, _look(), RigidTransform(), False)


def snapshot(station: Station, context: Context, camera: Camera, **options: Any) -> np.ndarray:
    """One picture of a station, shape [height, width, 3]; for several see ``Studio``."""
    return Studio(station).picture(context, camera, **options)


def write_snapshot(path: Path, picture: np.ndarray) -> None:
    """Write a picture as a PNG file, whole or not at all.

    Raises:
        ValueError: no file can be put there.
    """
    with whole(path) as temporary:
        temporary.write_bytes(_png(picture))


def _engine(shadows: bool) -> RenderEngine:
    return MakeRenderEngineVtk(
        RenderEngineVtkParams(
            default_clear_color=list(BACKGROUND),
            lights=[SUN, *FILL],
            cast_shadows=shadows,
            shadow_map_size=2048,
        )
    )


def _look(colour: Rgba | None = None) -> PerceptionProperties:
    made = PerceptionProperties()
    if colour is not None:
        made.AddProperty("phong", "diffuse", colour)
    made.AddProperty("label", "id", RenderLabel.kDontCare)
    return made


def _mesh(
    faces: np.ndarray, points: np.ndarray, normals: np.ndarray, uv: np.ndarray, texture: bytes
) -> Mesh:
    """A textured surface."""
    lines = ["mtllib skin.mtl", "usemtl skin"]
    for name, rows in (("v", points), ("vn", normals), ("vt", uv)):
        lines += [f"{name} " + " ".join(f"{x:.7g}" for x in row) for row in rows.tolist()]
    lines += ["f " + " ".join(f"{k}/{k}/{k}" for k in row) for row in (faces + 1).tolist()]
    return Mesh(
        InMemoryMesh(
            mesh_file=MemoryFile("\n".join(lines) + "\n", ".obj", "skin.obj"),
            supporting_files={
                "skin.mtl": MemoryFile("newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n", ".mtl", "skin"),
                "skin.png": MemoryFile(texture, ".png", "skin.png"),
            },
        )
    )


@cache
def _strip() -> bytes:
    """The colour map from left to right."""
    from matplotlib import colormaps

    strip = colormaps[COLOURS](np.linspace(0.0, 1.0, 256), bytes=True)[None, :, :3]
    return _png(np.repeat(strip, 4, axis=0))


@cache
def _lined(span: float) -> bytes:
    """A square of clay of an edge [m] with lines on it."""
    at = (np.arange(TEXELS) + 0.5) / TEXELS * span
    lined = np.abs(at - LINES * np.round(at / LINES)) < 0.5 * LINE
    picture = np.where((lined[:, None] | lined)[..., None], 0.5, 1.0) * CLAY
    return _png((255 * picture[::-1]).astype(np.uint8))


def _png(picture: np.ndarray) -> bytes:
    from matplotlib.image import imsave

    stream = io.BytesIO()
    imsave(stream, picture, format="png")
    return stream.getvalue()
