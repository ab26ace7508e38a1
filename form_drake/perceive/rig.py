"""Two cameras and the face that they look at, as a YAML file states them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from form_drake.files import about, plain, read_mapping, write_text
from form_drake.motion.body import Face
from form_drake.perceive.optics import projected
from form_drake.records import Camera

VERSION = 1
ENTRIES = {"form_drake_rig", "rate", "low", "high", "face", "cameras", "half", "spacing"}
OPTIONAL = {"half", "spacing"}
RIGID = 1e-6  # by which a pose may not be a rotation
HALF = 12
# pixels beside a part from which pictures, blurred and read by splines, still tell: past an edge, another thing
RIM = 4
ALIKE = 1e-3  # radians between two views of the face, below which they tell no depth
NEAR = 1e-3  # of the box, across which pixels are counted


@dataclass(frozen=True)
class Rig:
    """What is known before the first picture is read.

    Attributes:
        cameras: left and right, by name.
        rate: of the pictures [1/s].
        low: lower corner of the specimen's box in world, as it stands free of stress [m], shape [3].
        high: upper corner [m], shape [3].
        face: that is seen.
        half: pixels from a point to the rim of what is compared.
        spacing: of the points [m]; None: ``half`` pixels and a third of it.
    """

    cameras: Mapping[str, Camera]
    rate: float
    low: np.ndarray
    high: np.ndarray
    face: Face
    half: int = HALF
    spacing: float | None = None

    def __post_init__(self) -> None:
        if len(self.cameras) != 2:
            raise ValueError(f"cameras: two are wanted, got {', '.join(self.cameras) or 'none'}")
        if not 0.0 < self.rate < np.inf:
            raise ValueError(f"rate: frames a second are wanted, got {self.rate}")
        if not np.all(self.high > self.low):
            raise ValueError(f"low {self.low} must lie below high {self.high} along every axis")
        if not 3 <= self.half <= 100:
            raise ValueError(f"half {self.half}: 3 to 100 pixels are wanted")
        if self.spacing is not None and not 0.0 < self.spacing < np.inf:
            raise ValueError(f"spacing {self.spacing}: a positive length is wanted [m]")
        a, b = (
            self.face.middle(self.low, self.high) - c.X_WC[:3, 3] for c in self.cameras.values()
        )
        if not np.linalg.norm(np.cross(a, b)) > ALIKE * np.linalg.norm(a) * np.linalg.norm(b):
            raise ValueError(
                f"cameras {' and '.join(self.cameras)} see the face from one direction, which tells no depth: is"
                " X_WC of each its own?"
            )

    @property
    def pixel(self) -> float:
        """What a pixel of the first camera shows of the face's middle [m]."""
        camera = next(iter(self.cameras.values()))
        middle = self.face.middle(self.low, self.high)
        depth = float((middle - camera.X_WC[:3, 3]) @ camera.X_WC[:3, 2])
        return depth / float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))

    def points(self) -> np.ndarray:
        """An even grid of points whose parts lie on the face [m], shape [points, 3].

        Raises:
            ValueError: the face is too small, or lies behind the cameras.
        """
        pixel = self.pixel
        if not pixel > 0.0:
            raise ValueError(
                "the face lies behind the first camera: is X_WC its pose in the world?"
            )
        step = self.spacing or self.half * 4.0 / 3.0 * pixel
        sides = []
        for a in range(3):
            margin = (self.half + RIM) * self._widest(a)
            low, high = self.low[a] + margin, self.high[a] - margin
            count = int((high - low) / step) + 1 if high > low else 0
            sides.append(low + (high - low - (count - 1) * step) / 2.0 + step * np.arange(count))
        sides[self.face.axis] = self.face.middle(self.low, self.high)[[self.face.axis]]
        grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
        if len(grid) < 8:
            raise ValueError(
                f"{len(grid)} points fit on face {self.face.name} with parts of {2 * self.half + 1} pixels of"
                f" {1e6 * pixel:.3g} um: come nearer, or take a smaller half or spacing"
            )
        return grid

    def _widest(self, axis: int) -> float:
        """What a pixel shows along an axis, at the corner of the face where either camera sees that worst [m]."""
        if axis == self.face.axis:
            return 0.0
        ends = [*map(list, zip(self.low, self.high, strict=True))]
        ends[self.face.axis] = ends[self.face.axis][self.face.side :][:1]
        corners = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 3)
        inward = NEAR * (0.5 * (self.low + self.high) - corners)[:, axis]
        beside = corners + inward[:, None] * np.eye(3)[axis]
        seen = [projected(c, beside) - projected(c, corners) for c in self.cameras.values()]
        return float(np.max(np.abs(inward) / np.linalg.norm(seen, axis=2)))

    @classmethod
    def read(cls, path: Path) -> "Rig":
        """A rig from its YAML file.

        Raises:
            ValueError: what is wrong with it.
        """
        content = read_mapping(path)
        with about(path):
            return cls._made(content)

    @classmethod
    def _made(cls, content: Mapping[str, Any]) -> "Rig":
        strange, missing = set(content) - ENTRIES, ENTRIES - OPTIONAL - set(content)
        if strange or missing:
            told = [f"no entry {n}" for n in sorted(missing)]
            told += [f"unknown entry {n}" for n in sorted(strange)]
            raise ValueError(f"{', '.join(told)}; a rig holds {', '.join(sorted(ENTRIES))}")
        if content["form_drake_rig"] != VERSION:
            raise ValueError(f"form_drake_rig {content['form_drake_rig']!r}: {VERSION} is read")
        cameras = content["cameras"]
        if not isinstance(cameras, dict) or not all(isinstance(c, dict) for c in cameras.values()):
            raise ValueError(
                "cameras: a mapping of names to size, K, distortion and X_WC is wanted"
            )
        spacing = content.get("spacing")
        return cls(
            {str(name): camera(str(name), c) for name, c in cameras.items()},
            float(_numbers("rate", content["rate"], ())),
            _numbers("low", content["low"], (3,)),
            _numbers("high", content["high"], (3,)),
            Face.named(str(content["face"])),
            _whole("half", content.get("half", HALF)),
            None if spacing is None else float(_numbers("spacing", spacing, ())),
        )

    def write(self, path: Path) -> None:
        """Write the YAML file, whole."""
        cameras = {
            name: {
                "size": list(c.size),
                "K": c.K,
                "distortion": c.distortion,
                "X_WC": c.X_WC,
            }
            for name, c in self.cameras.items()
        }
        content = {"form_drake_rig": VERSION, "rate": self.rate, "low": self.low, "high": self.high}
        content |= {"face": self.face.name, "half": self.half, "cameras": cameras}
        if self.spacing is not None:
            content["spacing"] = self.spacing
        write_text(path, yaml.safe_dump(plain(content), sort_keys=False, default_flow_style=None))


def camera(name: str, stated: Mapping[str, Any]) -> Camera:
    """A calibrated camera.

    Raises:
        ValueError: an entry is missing or makes no sense.
    """
    wanted = {"size", "K", "distortion", "X_WC"}
    if set(stated) != wanted:
        raise ValueError(
            f"camera {name}: wanted are {', '.join(sorted(wanted))}, got {', '.join(sorted(map(str, stated)))}"
        )
    K = _numbers(f"camera {name}: K", stated["K"], (3, 3))
    X_WC = _numbers(f"camera {name}: X_WC", stated["X_WC"], (4, 4))
    size = _numbers(f"camera {name}: size", stated["size"], (2,))
    R = X_WC[:3, :3]
    if not (K[0, 0] > 0 and K[1, 1] > 0 and K[1, 0] == 0 and np.array_equal(K[2], [0, 0, 1])):
        raise ValueError(
            f"camera {name}: K {K.tolist()} is no intrinsic matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
        )
    if not (
        np.allclose(R @ R.T, np.eye(3), atol=RIGID)
        and np.linalg.det(R) > 0
        and np.array_equal(X_WC[3], [0, 0, 0, 1])
    ):
        raise ValueError(
            f"camera {name}: X_WC is no pose: its first three columns must be orthonormal and right-handed"
        )
    if not (size == np.round(size)).all() or not (size >= 8).all():
        raise ValueError(f"camera {name}: size {size.tolist()}: width and height [px] are wanted")
    distortion = _numbers(f"camera {name}: distortion", stated["distortion"], (5,))
    return Camera(K, X_WC, distortion, (int(size[0]), int(size[1])))


def _whole(name: str, value: Any) -> int:
    found = float(_numbers(name, value, ()))
    if found != round(found):
        raise ValueError(f"{name}: a whole number is wanted, got {value}")
    return int(found)


def _numbers(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        found = np.array(value, dtype=float)
    except (OverflowError, TypeError, ValueError):
        found = np.full(1, np.nan)
    if found.shape != shape or not np.isfinite(found).all():
        words = (
            " x ".join(map(str, shape)) + " finite numbers are" if shape else "a finite number is"
        )
        raise ValueError(f"{name}: {words} wanted, got {str(value)[:60]}")
    return found
