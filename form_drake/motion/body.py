"""The body between the tracked points: where its volume integrals are taken."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from form_drake.effects.effect import CONDITIONS
from form_drake.records import Recording
from form_drake.records.recording import FACES

JITTER = 5e-5  # [m] over which the logged poses of a tool that stands still may go


@dataclass(frozen=True)
class Face:
    """A face of the reference box and what acts on it.

    Attributes:
        axis: 0, 1 or 2.
        side: 0 below, 1 above.
        condition: ``free`` of traction, of ``unknown`` traction, ``bonded`` or ``frictionless``
            over the whole face, or ``touched`` somewhere.
        tool: the tool or support that touches it; "" for none.
    """

    axis: int
    side: int
    condition: str = "unknown"
    tool: str = ""

    @classmethod
    def named(cls, name: str) -> "Face":
        """A face such as ``x+``, of which nothing else is known.

        Raises:
            ValueError: there is none of that name.
        """
        if name not in FACES:
            raise ValueError(f"no face {name!r}; allowed are {', '.join(FACES)}")
        return cls(*divmod(FACES.index(name), 2))

    @property
    def index(self) -> int:
        """As recordings count them: 0 is x-, 5 is z+."""
        return 2 * self.axis + self.side

    @property
    def name(self) -> str:
        """Such as ``x+``."""
        return FACES[self.index]

    @property
    def normal(self) -> np.ndarray:
        """Outward, shape [3]."""
        return (2.0 * self.side - 1.0) * np.eye(3)[self.axis]

    def middle(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Middle of this face of a box between two corners [m], shape [3]."""
        found = 0.5 * (low + high)
        found[self.axis] = (low, high)[self.side][self.axis]
        return found


@dataclass(frozen=True)
class Body:
    """Reference shape of a specimen.

    Attributes:
        low: lower corner of its box in stress-free coordinates [m], shape [3].
        high: upper corner [m], shape [3].
        faces: its six faces.
        density: mass per reference volume [kg/m^3].
    """

    low: np.ndarray
    high: np.ndarray
    faces: tuple[Face, ...]
    density: float

    def gauss(
        self, breaks: Sequence[np.ndarray], count: int | Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gauss points [m], shape [points, 3], and their reference volumes [m^3], shape [points].

        Args:
            breaks: ends of the cells along each axis [m].
            count: points in each cell along each axis; or those of every cell, for each axis.
        """
        at, share = [], []
        for n, ends in enumerate(breaks):
            own = np.full(len(ends) - 1, count) if isinstance(count, int) else count[n]
            rules = [np.polynomial.legendre.leggauss(points) for points in own]
            half = 0.5 * np.diff(ends)
            cells = zip(ends[:-1], half, rules, strict=True)
            at.append(np.concatenate([low + h * (x + 1.0) for low, h, (x, _) in cells]))
            share.append(np.concatenate([h * w for h, (_, w) in zip(half, rules, strict=True)]))
        grid = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1).reshape(-1, 3)
        return grid, np.einsum("i,j,k->ijk", *share).ravel()

    def face_points(self, face: Face, n: int = 6) -> np.ndarray:
        """Points of an even grid on a face [m], shape [n^2, 3]."""
        s = np.linspace(0.0, 1.0, n)
        axes = [s, s, s]
        axes[face.axis] = np.array([float(face.side)])
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return self.low + grid * (self.high - self.low)


def body(recording: Recording) -> Body:
    """The reference body that a recording states: a box, its faces and its density.

    Raises:
        ValueError: geometry or density are missing, or make no sense.
    """
    if recording.density is None:
        raise ValueError("the weak form needs the recording's density [kg/m^3]")
    shape = recording.geometry.get("shape")
    if shape != "box":
        raise ValueError(
            f"geometry: shape {shape!r}; the weak form needs shape box with its corners low and"
            ' high in stress-free coordinates [m], such as {"shape": "box", "low": "0 0 0",'
            ' "high": "0.03 0.03 0.025"}'
        )
    low, high = (_corner(recording.geometry, name) for name in ("low", "high"))
    if not np.all(high > low):
        raise ValueError(f"geometry: low {low} must lie below high {high} along every axis")
    return Body(low, high, faces(recording), recording.density)


def _corner(geometry: Mapping[str, str], name: str) -> np.ndarray:
    try:
        corner = np.array([float(part) for part in str(geometry[name]).split()])
    except (KeyError, ValueError):
        corner = np.zeros(0)
    if corner.shape != (3,) or not np.isfinite(corner).all():
        raise ValueError(f"geometry: {name} must be three numbers [m], got {geometry.get(name)!r}")
    return corner


def faces(recording: Recording) -> tuple[Face, ...]:
    """The six faces; what is not stated of a face is ``unknown``.

    Raises:
        ValueError: a condition that is not known, or a tool that the recording does not hold.
    """
    stated = {k: v for k, v in recording.contact.items() if k in FACES or k == "other"}
    found = []
    for n, name in enumerate(FACES):
        words = stated.get(name, stated.get("other", "unknown")).split()
        most = 1 if words and words[0] in CONDITIONS[:2] else 2
        if not words or words[0] not in CONDITIONS or len(words) > most:
            raise ValueError(
                f"contact {name}: {' '.join(words)!r}; allowed are {', '.join(CONDITIONS)}, the last"
                " three followed by the name of a tool or support"
            )
        found.append(Face(n // 2, n % 2, words[0], words[1] if len(words) == 2 else ""))
    named = {f.tool for f in found if f.tool}
    twice = [t for t in recording.forces if sum(f.tool == t for f in found) > 1]
    if twice:
        raise ValueError(
            f"force of {', '.join(twice)}: contact names it on several faces, and one force does not tell"
            " them apart: record a tool of its own for each"
        )
    lost = sorted(set(recording.forces) - named)
    if lost and named:
        raise ValueError(
            f"force of {', '.join(lost)}: no face names it in contact; named are"
            f" {', '.join(sorted(named))}"
        )
    for face in found:
        pose = recording.poses.get(face.tool)
        if pose is None or face.tool in recording.forces or face.condition == "bonded":
            continue  # what is bonded to a support may be shaken: the fields vanish there
        ends = recording.time[[0, -1]]
        if _moves(pose.value[(pose.time >= ends[0]) & (pose.time <= ends[1])]):
            raise unmeasured(face)
    return tuple(found)


def unmeasured(face: Face) -> ValueError:
    """The refusal of a tool that moves and whose force is not there."""
    return ValueError(
        f"{face.tool} touches {face.name} and moves, but the recording holds no force of it: add"
        f" forces={{{face.tool!r}: Stream(...)}}"
    )


def _moves(X_WT: np.ndarray) -> bool:
    """Whether a tool is carried by more than a log jitters."""
    return len(X_WT) > 0 and bool(np.ptp(X_WT[:, :3, 3], axis=0).max() > JITTER)
