"""What was measured: one ``Recording`` per interaction, in memory and as an HDF5 file.

The table of fields below is the file's layout: every array field names its place in the file, its
dimensions and its unit once, and reading, writing, checking and printing follow from it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from form_drake.records.checks import (
    check_arrays,
    check_camera,
    check_consistency,
    check_rigid,
    check_statements,
    check_stream,
)
from form_drake.records.solver import Solver

VERSION = 1
FACES = tuple(axis + side for axis in "xyz" for side in "-+")


def array(place: str, dims: str, unit: str, *, default: Any = None, kind: str = "f") -> Any:
    """A field stored as dataset ``place`` with named dimensions, in ``unit``."""
    metadata = {"place": place, "dims": tuple(dims.split()), "unit": unit, "kind": kind}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class States:
    """Full solver states at some steps; consecutive steps make rows of the balance.

    Attributes:
        step: solver steps, increasing, shape [states].
        x: positions [m], shape [states, points, 3].
        v: velocities [m/s], shape [states, points, 3].
        C: affine velocity matrices [1/s], shape [states, points, 3, 3].
        F: elastic deformation gradients, shape [states, points, 3, 3].
        L: velocity gradients [1/s], shape [states, points, 3, 3]; None: equal to C.
        tau: Kirchhoff stresses [Pa] used in the step that follows, shape [states, points, 3, 3],
            NaN where not recorded.
    """

    step: np.ndarray = array("states/step", "states", "-", kind="i")
    x: np.ndarray = array("states/x", "states points 3", "m")
    v: np.ndarray = array("states/v", "states points 3", "m/s")
    C: np.ndarray = array("states/C", "states points 3 3", "1/s")
    F: np.ndarray = array("states/F", "states points 3 3", "-")
    L: np.ndarray | None = array("states/L", "states points 3 3", "1/s")
    tau: np.ndarray | None = array("states/tau", "states points 3 3", "Pa", kind="n")

    def pairs(self) -> list[tuple[int, int]]:
        """Indices of states that are one solver step apart."""
        where = {int(s): i for i, s in enumerate(self.step)}
        return [(i, where[s + 1]) for s, i in where.items() if s + 1 in where]


@dataclass(frozen=True)
class Stream:
    """A measured signal with clock readings of its own.

    Attributes:
        time: stamps [s], shape [samples], increasing.
        value: samples; poses X_WT are homogeneous matrices [samples, 4, 4], forces f_T_W [N]
            have shape [samples, 3], joint positions q [rad] shape [samples, joints].
        noise: standard deviation of one component, in the unit of the values; None: unknown. Of poses
            that of how far a place is off [m], which stays so; None: not at all.
    """

    time: np.ndarray
    value: np.ndarray
    noise: float | None = None

    def __post_init__(self) -> None:
        for name in ("time", "value"):
            object.__setattr__(self, name, np.asarray(getattr(self, name)))


@dataclass(frozen=True)
class Camera:
    """Calibration of one camera.

    Attributes:
        K: intrinsic matrix [px], shape [3, 3].
        X_WC: pose, homogeneous matrix, shape [4, 4].
        distortion: Brown-Conrady coefficients k1 k2 p1 p2 k3, shape [5].
        size: width and height [px].
    """

    K: np.ndarray
    X_WC: np.ndarray
    distortion: np.ndarray
    size: tuple[int, int]


@dataclass(frozen=True)
class Recording:
    """One observed interaction; every field but time and positions may be missing.

    Attributes:
        time: stamps of the tracked points [s], shape [frames].
        p_WQ: tracked points in world [m], shape [frames, points, 3].
        valid: which points were measured, shape [frames, points]; None: all.
        visible: which points a camera saw, shape [frames, points]; None: not known.
        face: face of the specimen that a point lies on, 0 to 5 for x- x+ y- y+ z- z+, -1 inside, shape
            [points].
        noise: standard deviation of one coordinate [m]; None: unknown.
        covariance: of each point's coordinates where they are not alike, mean over the frames [m^2], shape
            [points, 3, 3]; the root of the mean of its diagonals is the noise.
        p_reference: stress-free positions [m], shape [points, 3]; None: those of the first frame.
        v_0: velocities at the first frame [m/s], shape [points, 3].
        volume: reference volume of each point [m^3], shape [points].
        density: mass per reference volume [kg/m^3].
        mass_scale: factor on the masses of what moved, its inverse on gravity: a quasi-static
            simulation in larger steps; 1 for what was measured.
        gravity: acceleration [m/s^2], shape [3].
        pressure: supplied Cauchy pressure at the points [Pa], shape [frames, points].
        body_force: force per mass besides gravity [m/s^2], shape [frames, points, 3].
        step: solver step of each frame, shape [frames], where the motion was stepped.
        solver: how it was stepped.
        states: full solver states, where recorded.
        law: declared law class.
        known: declared parameter values, never one to be identified.
        poses: X_WT of tools and supports by name.
        forces: f_T_W by tool name: force of the material on the tool at the tool frame's origin;
            of another source than a sensor at the tool under ``TOOL:SOURCE``.
        joints: robot joint positions.
        cameras: calibration by camera name.
        geometry: specimen geometry in words and numbers, e.g. {"shape": "box", "low": "0 0 0", "high": "..."}.
        contact: condition per face, x- to z+ or other: free, unknown, bonded, frictionless or touched, the
            last three with the name of the tool or support, e.g. {"z-": "bonded floor", "other": "free"}.
        rest: intervals in which nothing moves [s], shape [intervals, 2]: what tracks do there is error.
        source: where the data came from.
    """

    time: np.ndarray = array("points/time", "frames", "s")
    p_WQ: np.ndarray = array("points/p_WQ", "frames points 3", "m", kind="n")
    valid: np.ndarray | None = array("points/valid", "frames points", "-", kind="b")
    visible: np.ndarray | None = array("points/visible", "frames points", "-", kind="b")
    face: np.ndarray | None = array("points/face", "points", "-", kind="i")
    covariance: np.ndarray | None = array("points/covariance", "points 3 3", "m^2")
    p_reference: np.ndarray | None = array("points/p_reference", "points 3", "m")
    v_0: np.ndarray | None = array("points/v_0", "points 3", "m/s")
    volume: np.ndarray | None = array("points/volume", "points", "m^3")
    gravity: np.ndarray | None = array("gravity", "3", "m/s^2")
    pressure: np.ndarray | None = array("points/pressure", "frames points", "Pa")
    body_force: np.ndarray | None = array("points/body_force", "frames points 3", "m/s^2")
    step: np.ndarray | None = array("points/step", "frames", "-", kind="i")
    rest: np.ndarray | None = array("rest", "intervals 2", "s")
    noise: float | None = None
    density: float | None = None
    mass_scale: float = 1.0
    solver: Solver | None = None
    states: States | None = None
    law: str | None = None
    known: Mapping[str, float] = field(default_factory=dict)
    poses: Mapping[str, Stream] = field(default_factory=dict)
    forces: Mapping[str, Stream] = field(default_factory=dict)
    joints: Stream | None = None
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    geometry: Mapping[str, str] = field(default_factory=dict)
    contact: Mapping[str, str] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        check_statements(self)
        sizes: dict[str, int] = {}
        check_arrays(self, sizes)
        if self.states is not None:
            check_arrays(self.states, sizes)
            if np.any(np.diff(self.states.step) <= 0):
                raise ValueError("states/step: steps must increase")
        if np.any(np.diff(self.time) <= 0):
            raise ValueError("points/time: time stamps must increase")
        if self.step is not None and np.any(np.diff(self.step) <= 0):
            raise ValueError("points/step: steps must increase")
        missing = ~np.isfinite(self.p_WQ).all(axis=2)
        if np.any(missing & (True if self.valid is None else self.valid)):
            frame, point = np.argwhere(missing)[0]
            raise ValueError(
                f"points/p_WQ: frame {frame}, point {point} is not finite; mark it in 'valid'"
            )
        for name, positive in (("volume", self.volume), ("density", self.density)):
            if positive is not None and not np.all(
                (np.asarray(positive) > 0) & np.isfinite(positive)
            ):
                raise ValueError(f"{name}: must be positive and finite")
        if self.rest is not None and np.any(self.rest[:, 1] <= self.rest[:, 0]):
            raise ValueError("rest: each interval is a start and a later end [s]")
        if not 0 < self.mass_scale < np.inf:
            raise ValueError(f"mass_scale: must be positive and finite, got {self.mass_scale}")
        if self.face is not None and not np.all((self.face >= -1) & (self.face < len(FACES))):
            wrong = self.face[(self.face < -1) | (self.face >= len(FACES))][0]
            raise ValueError(f"points/face: -1 to {len(FACES) - 1} are allowed, got {wrong}")
        for name, words in self.contact.items():
            if name not in (*FACES, "other"):
                raise ValueError(
                    f"contact: no face {name!r}; allowed are {', '.join(FACES)} and other"
                )
            if not isinstance(words, str):
                raise ValueError(
                    f"contact {name}: words such as 'bonded floor' are wanted, got {words!r}"
                )
        if self.covariance is not None and not np.all(np.linalg.eigvalsh(self.covariance) > 0.0):
            raise ValueError("points/covariance: every matrix must be positive definite")
        if self.noise is not None and not 0 <= self.noise < np.inf:
            raise ValueError(f"noise: must be finite and not negative, got {self.noise}")
        for name, stream in self.poses.items():
            check_stream(name, stream, (4, 4))
            check_rigid(f"poses/{name}", stream.value)
        for name, stream in self.forces.items():
            check_stream(name, stream, (3,))
        if self.joints is not None:
            check_stream("joints", self.joints, ("joints",))
        for name, camera in self.cameras.items():
            check_camera(name, camera)
        check_consistency(self)

    @classmethod
    def from_arrays(cls, time: Any, p_WQ: Any, **rest: Any) -> "Recording":
        """A recording of foreign data: stamps [s], points [m], and any other field by name.

        Example:
            >>> import numpy as np
            >>> time = np.linspace(0.0, 1.0, 5)
            >>> p_WQ = np.zeros((5, 8, 3)) + np.arange(8)[:, None] * 0.01
            >>> Recording.from_arrays(time, p_WQ, density=1000.0, noise=20e-6).points
            8
        """
        for f in fields(cls):
            if "kind" in f.metadata and rest.get(f.name) is not None:
                rest[f.name] = _cast(f.name, rest[f.name], f.metadata["kind"])
        return cls(time=np.asarray(time, dtype=float), p_WQ=np.asarray(p_WQ, dtype=float), **rest)

    def measured_by(self, source: str) -> "Recording":
        """With the forces of one source alone, named after their tools.

        Args:
            source: ``sensor`` for the streams that are named after a tool, or what follows the
                colon in the names of others, such as ``joint-torque``.

        Raises:
            ValueError: no force comes from this source.
        """
        split = {name: (name.partition(":")[::2]) for name in self.forces}
        sources = {(mark or "sensor") for _, mark in split.values()}
        if not self.forces:
            return self
        if source not in sources:
            raise ValueError(
                f"no force comes from {source}; the recording has {', '.join(sorted(sources))}"
            )
        chosen = {t: self.forces[n] for n, (t, m) in split.items() if (m or "sensor") == source}
        return replace(self, forces=chosen)

    @property
    def points(self) -> int:
        return self.p_WQ.shape[1]

    @property
    def frames(self) -> int:
        return len(self.time)

    @property
    def on_surface(self) -> bool:
        """Whether all points are stated to lie on faces of the body."""
        return self.face is not None and bool(np.all(self.face >= 0))

    @property
    def reference(self) -> np.ndarray:
        """Stress-free positions [m], shape [points, 3]."""
        return self.p_WQ[0] if self.p_reference is None else self.p_reference


def _cast(name: str, value: Any, kind: str) -> np.ndarray:
    found = np.asarray(value, dtype=_dtype(kind))
    if kind == "i" and not np.array_equal(found, np.asarray(value)):
        raise ValueError(f"{name}: whole numbers are wanted")
    return found


def _dtype(kind: str) -> Any:
    return {"f": float, "n": float, "i": np.int64, "b": bool}[kind]
