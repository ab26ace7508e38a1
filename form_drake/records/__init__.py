"""Recordings of interactions, and readers of trajectories from elsewhere."""

from pathlib import Path

from form_drake.records.degrade import degraded, framed, picked, restated, thinned
from form_drake.records.hdf5 import SUFFIXES, read_recording, write_recording
from form_drake.records.nclaw import read_nclaw
from form_drake.records.recording import Camera, Recording, States, Stream
from form_drake.records.solver import Solver, Wall
from form_drake.records.stepped import Stepped, rest_shape, stepped

READERS = {**dict.fromkeys(SUFFIXES, read_recording), ".npz": read_nclaw}


def read(path: Path) -> Recording:
    """A recording from a file, by its suffix.

    Raises:
        ValueError: unknown suffix, or what is wrong with the file.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path}: is a folder; a recording in it is wanted, such as recording.h5")
    if path.suffix not in READERS:
        raise ValueError(f"{path}: a recording ends in {', '.join(READERS)}, not {path.suffix!r}")
    return READERS[path.suffix](path)


__all__ = [
    "Camera",
    "Recording",
    "Solver",
    "States",
    "Stepped",
    "Stream",
    "Wall",
    "degraded",
    "framed",
    "picked",
    "read",
    "read_nclaw",
    "read_recording",
    "rest_shape",
    "restated",
    "stepped",
    "thinned",
    "write_recording",
]
