"""Pictures of a simulated specimen, as two cameras beside the station take them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from form_drake.motion.body import Face
from form_drake.perceive.optics import looking
from form_drake.perceive.render import Light, Renderer, Surface
from form_drake.perceive.rig import Rig
from form_drake.perceive.speckle import speckle
from form_drake.records import Camera, Recording
from form_drake.skin import Patch
from form_drake.systems.scenario import Scenario, StereoPair
from form_drake.systems.station import specimen_corners

TEXELS = 6.0  # along a pixel
CELL = 1.5  # pixels, as long as the sides of the quads that are rendered
NAMES = ("left", "right")


def rig_of(scenario: Scenario, rate: float) -> Rig:
    """The calibrated cameras of a scenario, and the face that they see.

    Raises:
        ValueError: the scenario says of no face that it is seen.
    """
    view = scenario.stereo
    try:
        face = Face.named(view.face)
    except ValueError as error:
        raise ValueError(f"stereo.face in scenario {scenario.name}: {error}") from None
    low, high = specimen_corners(scenario)
    aim = np.array(view.aim or face.middle(low, high), dtype=float)
    right = np.cross(view.down, -face.normal)
    right /= max(float(np.linalg.norm(right)), 1e-12)  # none: refused below
    cameras = {
        name: looking(
            aim + view.distance * face.normal + share * view.baseline * right,
            aim,
            view.focus,
            (view.size[0], view.size[1]),
            view.distortion,
            view.down,
        )
        for name, share in zip(NAMES, (-0.5, 0.5), strict=True)
    }
    return Rig(cameras, rate, low, high, face, view.half, view.spacing)


def seen_by_cameras(scenario: Scenario) -> Scenario:
    """A scenario in which all particles are recorded at the cameras' rate, for pictures of them.

    Raises:
        ValueError: as of ``rig_of``.
    """
    rig_of(scenario, scenario.stereo.rate)
    measure = replace(scenario.measure, points=0, noise=0.0, rate=scenario.stereo.rate)
    return replace(scenario, measure=measure)


def frames_a_second(particles: Recording) -> float:
    """The rate of a simulation's frames [Hz]: that of the scenario or a little more, as its solver steps."""
    return 1.0 / float(np.median(np.diff(particles.time)))


def turned(camera: Camera, degrees: list[float]) -> Camera:
    """A camera that is turned about its own axes."""
    X_WC = camera.X_WC.copy()
    X_WC[:3, :3] = X_WC[:3, :3] @ Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    return replace(camera, X_WC=X_WC)


class Photographer:
    """Takes pictures of a specimen's particles with both cameras.

    Args:
        scenario: of the specimen.
        rig: its calibrated cameras.
        rest: places of all particles free of stress [m], shape [particles, 3].
        frames: how many there will be: at the last one the light has drifted as far as stated.
        device: Warp device.
    """

    def __init__(
        self, scenario: Scenario, rig: Rig, rest: np.ndarray, frames: int, device: str = "cpu"
    ):
        view = self._view = scenario.stereo
        self._rest, self._last = rest, max(frames - 1, 1)
        left, right = rig.cameras.values()
        self._patch = Patch.of(rest, rig.low, rig.high, rig.face, CELL * rig.pixel)
        self._surface = _painted(self._patch, rig, view, np.random.default_rng((view.seed, 0)))
        self._renderer = Renderer([left, turned(right, view.turned_deg)], device)

    def pair(self, frame: int, p_WQ: np.ndarray) -> list[np.ndarray]:
        """Grey values in a frame, uint8, one picture of each camera.

        Args:
            frame: its number.
            p_WQ: of all particles [m], shape [particles, 3].
        """
        view, rng = self._view, np.random.default_rng((self._view.seed, 1 + frame))
        light = Light(view.noise, view.blur, 1.0 + view.drift * frame / self._last)
        moved = self._surface.moved(self._patch.points(p_WQ, self._rest))
        return [light.seen(picture, rng) for picture in self._renderer.pictures(moved)]


def write_pictures(
    folder: Path,
    scenario: Scenario,
    rig: Rig,
    particles: Recording,
    device: str = "cpu",
    progress: Callable[[], object] = lambda: None,
) -> None:
    """Write what both cameras see, as ``left_00000.png`` and so on.

    Args:
        folder: that exists.
        scenario: of the specimen.
        rig: its calibrated cameras.
        particles: of the specimen, all of them.
        device: Warp device.
        progress: called after every frame.
    """
    import cv2

    photographer = Photographer(scenario, rig, particles.reference, particles.frames, device)
    for n, p_WQ in enumerate(particles.p_WQ):
        for name, picture in zip(NAMES, photographer.pair(n, p_WQ), strict=True):
            path = folder / f"{name}_{n:05d}.png"
            if not cv2.imwrite(str(path), picture):
                raise ValueError(f"{path}: cannot be written")
        progress()


def _painted(patch: Patch, rig: Rig, view: StereoPair, rng: np.random.Generator) -> Surface:
    """The patch with speckle on it."""
    sides = [a for a in range(3) if a != rig.face.axis]
    mark = (patch.X - rig.low)[:, sides] * TEXELS / rig.pixel
    columns, rows = (int(np.ceil(size)) + 2 for size in mark.max(axis=0))
    texture = speckle((rows, columns), view.speckle * TEXELS, rng)
    return Surface.of(patch.X, patch.triangles, mark[patch.triangles], texture)


def beside_pictures(particles: Recording, symmetry: str) -> Recording:
    """What is measured beside the pictures: all of a recording but its points; one, the tool's origin.

    Args:
        particles: the recording.
        symmetry: stated of the motion, or empty.
    """
    (tool,) = particles.poses
    stream = particles.poses[tool]
    nearest = np.abs(stream.time - particles.time[:, None]).argmin(axis=1)
    p_WT = stream.value[nearest][:, None, :3, 3]
    return replace(without_points(particles, symmetry), p_WQ=p_WT)


def without_points(particles: Recording, symmetry: str) -> Recording:
    """A recording of which a tracker's points are still to come: of the first particle, where it is.

    Args:
        particles: the recording.
        symmetry: stated of the motion, or empty.
    """
    geometry = {k: v for k, v in particles.geometry.items() if k not in ("low", "high")}
    return replace(
        particles,
        p_WQ=particles.p_WQ[:, :1],
        p_reference=None,
        noise=None,
        geometry={**geometry, **({"symmetry": symmetry} if symmetry else {})},
    )
