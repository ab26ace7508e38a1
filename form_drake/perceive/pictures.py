"""Pictures of several cameras in files, brought together frame by frame."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from form_drake.records import Camera

NAME = re.compile(r"(?P<camera>.+)_(?P<frame>\d+)\.(png|tif|tiff|bmp|pgm|jpg|jpeg)", re.IGNORECASE)
DARK, BRIGHT = 2, 253  # grey values at which a sensor may be at its end
BLANK = 0.99  # share of the pixels there, with which a picture shows nothing
SPARSE = 8  # frames to a picture, above which numbers are stamps
JPEG, SCAN, END = (".jpg", ".jpeg"), b"\xff\xda", b"\xff\xd9"  # and markers, which no data hold
WHITE = 255.0  # the brightest grey value, and that of eight bits


class UnusableError(ValueError):
    """A picture that shows nothing."""


@dataclass(frozen=True)
class Pictures:
    """Files by frame, for the cameras in their order.

    Attributes:
        cameras: by name.
        files: of each frame, one of each camera; frames of which one cannot be used are left out.
        frames: their numbers.
        missing: frames that are left out, and the cameras that have no picture there.
        unusable: frames that are left out because a picture shows nothing, and why.
    """

    cameras: Mapping[str, Camera]
    files: tuple[tuple[Path, ...], ...]
    frames: tuple[int, ...]
    missing: dict[int, tuple[str, ...]]
    unusable: dict[int, str] = field(default_factory=dict)

    @classmethod
    def found(cls, places: Sequence[Path], cameras: Mapping[str, Camera]) -> "Pictures":
        """Pictures named CAMERA_NUMBER.png in folders, or given by name; each is read once.

        Args:
            places: folders and files.
            cameras: by name, in the order that is wanted.

        Raises:
            ValueError: a place that is not there, a picture of no camera or of another size than its
                camera's or of neither 8 nor 16 bits, two of one frame, numbers that count no frames, or
                fewer than two frames, the first among them, that all cameras show.
        """
        by: dict[str, dict[int, Path]] = {name: {} for name in cameras}
        for path in _listed(places):
            match = NAME.fullmatch(path.name)
            if match is None or match["camera"] not in by:
                raise ValueError(
                    f"{path}: pictures are named CAMERA_NUMBER.png with CAMERA {' or '.join(cameras)}"
                )
            own, frame = by[match["camera"]], int(match["frame"])
            if frame in own:
                raise ValueError(
                    f"{path} and {own[frame]} are both frame {frame} of {match['camera']}"
                )
            own[frame] = path
        span = _span(sorted(set().union(*by.values())))
        missing = {n: lost for n in span if (lost := tuple(c for c in cameras if n not in by[c]))}
        frames = tuple(n for n in span if n not in missing)
        if len(frames) < 2 or frames[0] != span[0]:
            counts = ", ".join(f"{len(by[c])} of {c}" for c in cameras)
            raise ValueError(
                f"pictures: {counts}; the first frame and one more must be seen by all cameras"
            )
        files = tuple(tuple(by[c][n] for c in cameras) for n in frames)
        return cls(cameras, files, frames, missing)._usable()

    def _usable(self) -> "Pictures":
        """Without frames of which a picture shows nothing."""
        why: dict[int, str] = {}
        for n, frame in enumerate(self.frames):
            try:
                self.pair(n)
            except UnusableError as error:
                if n == 0 or len(why) + 2 == len(self.frames):
                    raise
                why[frame] = str(error)
        kept = [n for n, frame in enumerate(self.frames) if frame not in why]
        files = tuple(self.files[n] for n in kept)
        return replace(self, files=files, frames=tuple(self.frames[n] for n in kept), unusable=why)

    @property
    def left_out(self) -> dict[int, str]:
        """Frames that are left out, and why."""
        absent = {n: f"no picture of {' and '.join(c)}" for n, c in self.missing.items()}
        return dict(sorted({**absent, **self.unusable}.items()))

    @cached_property
    def white(self) -> tuple[float, ...]:
        """Of each camera, what stands in files for white: the most of its first picture's bits, 8 at least."""
        most = [int(_told(path).max()).bit_length() for path in self.files[0]]
        return tuple(float(2 ** max(bits, 8) - 1) for bits in most)

    def read(self) -> Iterator[list[np.ndarray]]:
        """Grey values of every frame, 0 to 255, one picture of each camera, shape [rows, columns]."""
        for n in range(len(self.files)):
            yield self.pair(n)

    def pair(self, n: int) -> list[np.ndarray]:
        """Grey values of frame ``frames[n]``, as of ``read``."""
        ways = zip(self.files[n], self.cameras.values(), self.white, strict=True)
        return [_grey(path, camera, white) for path, camera, white in ways]


def ends(grey: np.ndarray) -> np.ndarray:
    """Where a picture is black or white to the end of the sensor, shape as given."""
    return np.asarray((grey <= DARK) | (grey >= BRIGHT))


def _span(frames: Sequence[int]) -> range:
    """All numbers from the first to the last."""
    if not frames:
        return range(0)
    if frames[-1] - frames[0] >= SPARSE * len(frames):
        raise ValueError(
            f"pictures are numbered from {frames[0]} to {frames[-1]}, and {len(frames)} of these numbers are"
            " there: a number counts frames at the rate of the rig, it is no stamp; number them 0, 1, 2 and on"
        )
    return range(frames[0], frames[-1] + 1)


def _listed(places: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for place in places:
        if place.is_dir():
            inside = sorted(p for p in place.iterdir() if NAME.fullmatch(p.name))
            if not inside:
                raise ValueError(f"{place}: holds no pictures named CAMERA_NUMBER.png")
            found += inside
        elif place.is_file():
            found.append(place)
        else:
            raise ValueError(f"{place}: no such file or folder")
    return found


def _told(path: Path) -> np.ndarray:
    """Grey values as they stand in a file, whichever way up it says that it is."""
    import cv2

    ways = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        found = cv2.imread(str(path), ways)
    except cv2.error:  # a header that no picture has
        found = None
    if found is None or _cut(path):
        raise UnusableError(f"{path}: not a picture that can be read")
    if found.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: grey values of {found.dtype}; 8 and 16 bits are read")
    return np.asarray(found)


def _cut(path: Path) -> bool:
    """Whether a JPEG ends within its last scan, of which OpenCV makes up the rest."""
    if path.suffix.lower() not in JPEG:
        return False
    held = path.read_bytes()
    return held.rfind(END) < held.rfind(SCAN)


def _grey(path: Path, camera: Camera, white: float) -> np.ndarray:
    found = _told(path)
    height, width = found.shape
    if (width, height) != camera.size:
        raise ValueError(
            f"{path}: {width} x {height} px, calibrated are {camera.size[0]} x {camera.size[1]}"
        )
    grey = found if found.dtype == np.uint8 else found * (WHITE / white)
    if np.mean(ends(grey)) > BLANK:
        raise UnusableError(
            f"{path}: the whole picture is black or white to the end of the sensor: change the exposure"
        )
    return grey
