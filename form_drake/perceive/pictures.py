"""Pictures of several cameras in files, brought together frame by frame."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from form_drake.records import Camera

NAME = re.compile(r"(?P<camera>.+)_(?P<frame>\d+)\.(png|tif|tiff|bmp|pgm|jpg|jpeg)", re.IGNORECASE)
DARK, BRIGHT = 2, 253  # grey values at which a sensor may be at its end
ENDS = 0.5  # share of the pixels that may be there


@dataclass(frozen=True)
class Pictures:
    """Files by frame, for the cameras in their order.

    Attributes:
        files: of each frame, one of each camera; frames in which one is missing are left out.
        frames: their numbers.
        missing: frames that are left out, and the cameras that have no picture there.
    """

    files: tuple[tuple[Path, ...], ...]
    frames: tuple[int, ...]
    missing: dict[int, tuple[str, ...]]

    @classmethod
    def found(cls, places: Sequence[Path], cameras: Sequence[str]) -> "Pictures":
        """Pictures named CAMERA_NUMBER.png in folders, or given by name.

        Args:
            places: folders and files.
            cameras: names, in the order that is wanted.

        Raises:
            ValueError: a place that is not there, a picture of no camera, two of one frame, or no frame
                that all cameras show.
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
        every = sorted(set().union(*by.values()))
        span = range(every[0], every[-1] + 1) if every else range(0)
        missing = {n: lost for n in span if (lost := tuple(c for c in cameras if n not in by[c]))}
        frames = tuple(n for n in span if n not in missing)
        if len(frames) < 2 or frames[0] != span[0]:
            counts = ", ".join(f"{len(by[c])} of {c}" for c in cameras)
            raise ValueError(
                f"pictures: {counts}; the first frame and one more must be seen by all cameras"
            )
        return cls(tuple(tuple(by[c][n] for c in cameras) for n in frames), frames, missing)

    def read(self, cameras: Sequence[Camera]) -> Iterator[list[np.ndarray]]:
        """Grey values of every frame, one picture of each camera, shape [rows, columns].

        Raises:
            ValueError: a file that is no picture, of another size than its camera's, or that is mostly
                black or white.
        """
        for n in range(len(self.files)):
            yield self.pair(n, cameras)

    def pair(self, n: int, cameras: Sequence[Camera]) -> list[np.ndarray]:
        """Grey values of frame ``frames[n]``; otherwise as of ``read``."""
        files = self.files[n]
        return [_grey(path, camera) for path, camera in zip(files, cameras, strict=True)]


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


def _grey(path: Path, camera: Camera) -> np.ndarray:
    import cv2

    found = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if found is None:
        raise ValueError(f"{path}: not a picture that can be read")
    height, width = found.shape
    if (width, height) != camera.size:
        raise ValueError(
            f"{path}: {width} x {height} px, calibrated are {camera.size[0]} x {camera.size[1]}"
        )
    ends = float(np.mean((found <= DARK) | (found >= BRIGHT)))
    if ends > ENDS:
        raise ValueError(
            f"{path}: {100 * ends:.0f} % of the picture is black or white to the end of the sensor:"
            " change the exposure"
        )
    return np.asarray(found)
