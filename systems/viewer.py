"""A live view of soft bodies in Meshcat, kept frame by frame for a page."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Rgba, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.perception import BaseField, Fields, PointCloud
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem

from form_drake.mpm.exchange import Snapshot
from form_drake.skin import field_named, outermost_first
from form_drake.systems.material import MaterialSystem

POINT_SIZE = 1.1  # of their spacing
FOV = 40.0  # of the camera [deg]
ARROW = 0.06  # length of the largest force [m]
FAINT = 0.02  # of the largest force, below which no arrow is drawn
ENDS = (0.001, 0.999)  # quantiles at which a colour range ends
COLOURS = "viridis"
LIVE, FORCE = "/material/live", "/material/force"


@dataclass(frozen=True)
class View:
    """What is shown of soft bodies.

    Attributes:
        field: that colours the particles, see ``form_drake.skin.FIELDS``.
        range: ends of the colour map in the field's unit; None: those of what was seen.
        rate: frames per second of simulated time.
        points: most particles that are shown.
        inside: show particles that are not at the surface of the body free of stress, too.
        eye: place of the camera in W, from the middle of the particles [m].
        aim: what it looks at, likewise [m].
        record: keep the frames, for a page.
    """

    field: str = "displacement"
    range: tuple[float, float] | None = None
    rate: float = 30.0
    points: int = 6000
    inside: bool = False
    eye: tuple[float, float, float] = (0.19, -0.33, 0.07)
    aim: tuple[float, float, float] = (0.0, 0.0, 0.02)
    record: bool = True


@dataclass(frozen=True)
class Frame:
    """What is shown at one time.

    Attributes:
        time: [s].
        p_WQ: of the shown particles [m], shape [points, 3].
        value: of the field, shape [points].
        force: on every arrow's geometry in W [N], shape [arrows, 3].
        p_WG: where that is [m], shape [arrows, 3].
    """

    time: float
    p_WQ: np.ndarray
    value: np.ndarray
    force: np.ndarray
    p_WG: np.ndarray


class ParticleViewer(LeafSystem):
    """Draws soft bodies as coloured points and the forces on moving bodies as arrows.

    The frames that it has drawn are kept beside the Context, as Meshcat's recording is.

    Ports: in ``particles`` (``Snapshot``) and ``body_poses``.

    Args:
        meshcat: to draw into.
        material: whose particles and touching geometries are drawn.
        moving: indices of the touching geometries that get an arrow.
        view: see there.

    Raises:
        ValueError: no such field.
    """

    def __init__(
        self, meshcat: Meshcat, material: MaterialSystem, moving: Sequence[int], view: View
    ):
        super().__init__()
        self.meshcat, self.view, self.field = meshcat, view, field_named(view.field)
        self.rest = material.scene.rest
        order, self.outer = outermost_first(self.rest)
        self.chosen = order[: view.points if view.inside else min(view.points, self.outer)]
        spacing = float(np.cbrt(material.scene.simulation.body.volume.min()))
        # Meshcat draws points as large as a camera of 90 degrees would see them
        self.point_size = POINT_SIZE * spacing / np.tan(np.radians(FOV) / 2.0)
        self.arrows = [material.touching[n] for n in moving]
        self._moving = list(moving)
        self.frames: dict[int, Frame] = {}
        self.pages = 0
        self._seen: tuple[float, float] | None = None
        self._strongest = 0.0
        self._particles = self.DeclareAbstractInputPort("particles", Value[object](None))
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self.DeclarePeriodicPublishEvent(1.0 / view.rate, 0.0, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def frame(self, context: Context) -> Frame:
        """What is to be shown now."""
        now: Snapshot = self._particles.Eval(context)
        poses = self._poses.Eval(context)
        p_WG = [poses[t.body].multiply(t.X_BG.translation()) for t in self.arrows]
        return Frame(
            context.get_time(),
            now.p_WQ[self.chosen],
            self.field.value(self.rest, now)[self.chosen],
            now.force[self._moving],
            np.reshape(p_WG, (-1, 3)),
        )

    def limits(self, values: np.ndarray) -> tuple[float, float]:
        """Ends of the colour map for these values, or those that the view states."""
        if self.view.range is not None:
            return self.view.range
        low, high = np.quantile(values, ENDS)
        low = low if self.field.signed else 0.0
        return float(low), max(float(high), float(low) + 1e-9)

    def _publish(self, context: Context) -> EventStatus:
        frame = self.frame(context)
        if self.view.record:
            now = round(frame.time * self.view.rate)
            self.frames = {n: f for n, f in self.frames.items() if n < now} | {now: frame}
        low, high = self.limits(frame.value)
        seen = self._seen or (low, high)
        self._seen = (min(low, seen[0]), max(high, seen[1]))
        self._strongest = max(self._strongest, strongest([frame]))
        self.meshcat.SetObject(
            LIVE, cloud(frame.p_WQ, frame.value, self._seen), point_size=self.point_size
        )
        for n in range(len(self.arrows)):
            X_WA, scale = arrow(frame, n, self._strongest)
            path = f"{FORCE}/{n}"
            self.meshcat.SetTransform(path, X_WA)
            self.meshcat.SetProperty(f"{path}/arrow", "scale", scale)
            self.meshcat.SetProperty(path, "visible", scale[2] > FAINT)
        return EventStatus.Succeeded()


def cloud(
    p_WQ: np.ndarray, value: np.ndarray, limits: tuple[float, float], colours: str = COLOURS
) -> PointCloud:
    """Points [m] coloured by their values between the ends of the colour map."""
    from matplotlib import colormaps

    low, high = limits
    made = PointCloud(len(p_WQ), Fields(BaseField.kXYZs | BaseField.kRGBs))
    made.mutable_xyzs()[:] = p_WQ.T
    share = np.clip((value - low) / (high - low), 0.0, 1.0)
    # Meshcat takes the colours of points for light intensities
    made.mutable_rgbs()[:] = 255.0 * colormaps[colours](share)[:, :3].T ** 2.2
    return made


def strongest(frames: Sequence[Frame]) -> float:
    """Largest force of all arrows [N]."""
    return max((float(np.linalg.norm(f.force, axis=1).max(initial=0.0)) for f in frames), default=0)


def arrow(frame: Frame, n: int, largest: float) -> tuple[RigidTransform, list[float]]:
    """Pose of an arrow, and its size as a share of the largest one's, along it for z."""
    size = float(np.linalg.norm(frame.force[n]))
    share = max(size / largest, 1e-6) if largest > 0.0 else 1e-6
    along = frame.force[n] / size if share > 1e-6 else np.array([0.0, 0.0, 1.0])
    R_WA = RotationMatrix.MakeFromOneVector(along, 2)
    return RigidTransform(R_WA, frame.p_WG[n]), [1.0, 1.0, share]


def add_viewer(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    material: MaterialSystem,
    meshcat: Meshcat,
    view: View | None = None,
) -> ParticleViewer:
    """Show a plant and its soft bodies in Meshcat, and record them unless the view says not to.

    Raises:
        ValueError: the view's field is none.
    """
    view = view or View()
    params = MeshcatVisualizerParams(publish_period=1.0 / view.rate)
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
    moving = [
        n for n, t in enumerate(material.touching) if not plant.IsAnchored(plant.get_body(t.body))
    ]
    viewer = builder.AddNamedSystem(
        "particle_viewer", ParticleViewer(meshcat, material, moving, view)
    )
    builder.Connect(material.GetOutputPort("particles"), viewer.GetInputPort("particles"))
    builder.Connect(plant.get_body_poses_output_port(), viewer.GetInputPort("body_poses"))
    middle = viewer.rest.mean(axis=0)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.80, 0.83, 0.86])
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=FOV))
    meshcat.SetCameraPose(middle + view.eye, middle + view.aim)
    vertices, faces = arrow_mesh()
    for n in range(len(moving)):
        path = f"{FORCE}/{n}/arrow"
        meshcat.SetTriangleMesh(path, vertices, faces, Rgba(1.0, 0.15, 0.15))
        meshcat.SetProperty(f"{path}/<object>", "material.depthTest", False)  # seen in the hand
    if view.record:
        meshcat.StartRecording(frames_per_second=view.rate)
    return viewer


def arrow_mesh(sides: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """The largest arrow, from the origin along z: vertices [3, n] and triangles [3, m]."""
    outline = np.array([[0.0, 0.0], [0.02, 0.0], [0.02, 0.75], [0.055, 0.75], [0.0, 1.0]]) * ARROW
    angle = 2.0 * np.pi * np.arange(sides) / sides
    rings = [[r * np.cos(angle), r * np.sin(angle), np.full(sides, z)] for r, z in outline]
    here, k = np.arange(sides), np.arange(len(outline) - 1)[:, None] * sides
    a, b = here + k, (here + 1) % sides + k
    quads = np.stack([a, b, b + sides, a + sides]).reshape(4, -1)
    triangles = np.concatenate([quads[[0, 1, 2]], quads[[0, 2, 3]]], axis=1)
    return np.concatenate(rings, axis=1), triangles
