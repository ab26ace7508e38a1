"""Measured stress-stretch curves as recordings of a cube that is stretched step by step.

A table of nominal stress over stretch says nothing of positions, but the deformation that it
belongs to is homogeneous and keeps the volume, so the motion of a cube follows from it. Every
table point becomes a hold of constant stretch and force, reached over a short ramp. Weak windows
inside the holds then see exactly the table.
"""

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from form_drake.identify import WeakOptions
from form_drake.laws import Law, Values
from form_drake.motion import Motion
from form_drake.records import Recording, Stream
from form_drake.weak.fields import Sampled
from form_drake.weak.stress import unit_stresses

SIDE = 0.01  # of the cube [m]
DENSITY = 1000.0  # [kg/m^3]; the holds are at rest, so that it does not matter
BULK = 2e9  # declared bulk modulus [Pa]: nearly incompressible, its pressure cancels in every row
NOISE = 1e-6  # of a coordinate [m]: what the fitted motion may leave of the tracks
PERIOD, RAMP = 1.0, 0.15  # of a table point, and the part of it that changes the stretch [s]
FRAMES = (9, 10)  # in a ramp and in a hold
SAMPLES = (8, 24)  # of the force, likewise
STEP = 1e-6  # of time, in the differences below [s]
COLUMNS = ("mode", "stretch", "nominal_stress_Pa")


@dataclass(frozen=True)
class Mode:
    """A homogeneous deformation that keeps the volume, with the force that drives it.

    Attributes:
        gradient: stretch -> deformation gradients, shape [n, 3, 3].
        contact: condition of every face.
        shares: direction in which each tool pulls, times its share of the test field at the tool.
        virtual: traceless gradient of the test field times the driven length, shape [3, 3].
        driven: stretch -> driven length as a share of the side, shape [n].
    """

    gradient: Callable[[np.ndarray], np.ndarray]
    contact: dict[str, str]
    shares: dict[str, np.ndarray]
    virtual: np.ndarray
    driven: Callable[[np.ndarray], np.ndarray] = lambda stretch: stretch


def _stretches(powers: tuple[float, ...]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda a: np.asarray(a)[:, None, None] ** np.array(powers)[:, None] * np.eye(3)


def _sheared(gamma: np.ndarray) -> np.ndarray:
    return np.eye(3) + np.asarray(gamma)[:, None, None] * SHEARED


X, Y, _ = np.eye(3)
SHEARED = np.outer(X, Y)
PULLED = {"x-": "frictionless base", "x+": "frictionless pull_x", "other": "free"}
MODES = {
    "uniaxial": Mode(
        _stretches((1.0, -0.5, -0.5)), PULLED, {"pull_x": X}, np.diag([1.0, -0.5, -0.5])
    ),
    "pure-shear": Mode(
        _stretches((1.0, 0.0, -1.0)),
        {**PULLED, "y-": "frictionless clamps", "y+": "frictionless clamps"},
        {"pull_x": X},
        np.diag([1.0, 0.0, -1.0]),
    ),
    "equibiaxial": Mode(
        _stretches((1.0, 1.0, -2.0)),
        {**PULLED, "y-": "frictionless side", "y+": "frictionless pull_y"},
        {"pull_x": 0.5 * X, "pull_y": 0.5 * Y},
        np.diag([0.5, 0.5, -1.0]),
    ),
    # what the slanted faces of simple shear carry is equal and opposite and does no work here
    "shear": Mode(
        _sheared,
        {"y-": "bonded base", "y+": "bonded plate", "z-": "free", "z+": "free"},
        {"plate": X},
        SHEARED,
        np.ones_like,
    ),
}


@dataclass(frozen=True)
class Curve:
    """A measured curve.

    Attributes:
        mode: key of ``MODES``.
        stretch: in the driven direction, or the amount of shear, shape [points].
        stress: nominal (first Piola-Kirchhoff) [Pa], shape [points].
    """

    mode: str
    stretch: np.ndarray
    stress: np.ndarray

    @property
    def largest(self) -> float:
        """Largest stress [Pa]."""
        return float(np.abs(self.stress).max())

    @property
    def ends(self) -> np.ndarray:
        """First and last moment of every hold [s], shape [points, 2]."""
        starts = PERIOD * np.arange(1, len(self.stretch) + 1)
        return np.stack([starts + RAMP, starts + PERIOD], axis=1)

    def driven(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stretch and nominal stress [Pa] at moments of the stepped test [s]."""
        rest = 0.0 if self.mode == "shear" else 1.0
        step = np.clip((time / PERIOD).astype(int), 0, len(self.stretch))
        s = np.where(step > 0, np.clip((time - PERIOD * step) / RAMP, 0.0, 1.0), 1.0)
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        found = []
        for first, series in ((rest, self.stretch), (0.0, self.stress)):
            held = np.append(first, series)
            before = held[np.maximum(step - 1, 0)]
            found.append(before + s * (held[step] - before))
        return found[0], found[1]

    def recording(self, source: str = "", known: Values = MappingProxyType({})) -> Recording:
        """The cube in this mode: 27 points and the forces on its tools; ``known`` is declared."""
        mode, holds = MODES[self.mode], len(self.stretch) + 1
        s = np.linspace(0.0, SIDE, 3)
        reference = np.stack(np.meshgrid(s, s, s, indexing="ij"), axis=-1).reshape(-1, 3)
        time, stamps = (_stamps(holds, *counts) for counts in (FRAMES, SAMPLES))
        F = mode.gradient(self.driven(time)[0])
        pull = -self.driven(stamps)[1][:, None] * SIDE**2
        units = {tool: share / np.linalg.norm(share) for tool, share in mode.shares.items()}
        return Recording.from_arrays(
            time,
            np.einsum("tij,pj->tpi", F, reference),
            p_reference=reference,
            noise=NOISE,
            density=DENSITY,
            known=dict(known),
            forces={tool: Stream(stamps, pull * unit, noise=0.0) for tool, unit in units.items()},
            geometry={"shape": "box", "low": "0 0 0", "high": " ".join([f"{SIDE:g}"] * 3)},
            contact=mode.contact,
            source=source,
        )

    def options(self) -> WeakOptions:
        """A window in every hold, and one test field that weighs the mode as its largest stress.

        Ordinary least squares of the rows is that of (law - measured) / largest stress, all modes
        alike.
        """
        width = PERIOD - RAMP
        weight = 1.0 / (width * SIDE**2 * self.largest * np.sqrt(len(self.stretch)))
        ends = tuple((float(a), float(z)) for a, z in self.ends)
        return WeakOptions(
            fields=(Homogeneous(self, weight),),
            ends=ends,
            pressure="free",
            estimator="ols",
            draws=0,
            level="probe",
        )

    def predicted(self, law: Law, values: Values) -> np.ndarray:
        """Nominal stress of a law at the stretches of the table [Pa], any pressure eliminated."""
        mode = MODES[self.mode]
        F = mode.gradient(self.stretch)
        tau = np.tensordot(law.theta(values), unit_stresses(law, F, 0.0 * F, values), axes=1)
        found: np.ndarray = np.sum(tau * mode.virtual, axis=(1, 2)) / mode.driven(self.stretch)
        return found

    def rms(self, law: Law, values: Values) -> float:
        """Root mean square of predicted minus measured stress in percent of the largest."""
        error = (self.predicted(law, values) - self.stress) / self.largest
        return 100.0 * float(np.sqrt(np.mean(error**2)))


def _stamps(holds: int, ramp: int, hold: int) -> np.ndarray:
    """Stamps of a stepped test [s]: a hold at rest, then ramps and holds."""
    first = np.linspace(0.0, RAMP, ramp, endpoint=False)
    one = np.append(first, np.linspace(RAMP, PERIOD, hold, endpoint=False))
    every = (PERIOD * np.arange(holds)[:, None] + one).ravel()
    return np.append(every, PERIOD * holds)


@dataclass(frozen=True)
class Homogeneous:
    """The one test field of a homogeneous test: it follows the body and keeps the volume.

    Attributes:
        curve: of the test.
        weight: value of the field at the tools, up to their share.
    """

    curve: Curve
    weight: float
    names = ("homogeneous",)
    material = False
    fixed = False
    breaks = (np.array([0.0, SIDE]),) * 3

    @property
    def tools(self) -> tuple[str, ...]:
        """Tools of the test."""
        return tuple(MODES[self.curve.mode].shares)

    def acting(self, motion: Motion) -> dict[str, np.ndarray]:
        """Value at the tools, shape [times, 1, 3]."""
        shares = MODES[self.curve.mode].shares
        times = len(motion.time)
        return {k: np.tile(self.weight * share, (times, 1, 1)) for k, share in shares.items()}

    def at(self, motion: Motion) -> Sampled:
        """The field at all points and times of a motion."""
        mode = MODES[self.curve.mode]
        near = [np.clip(motion.time + step, 0.0, None) for step in (-STEP, 0.0, STEP)]
        a, b, c = (mode.driven(self.curve.driven(t)[0]) for t in near)
        rate = -(c - a) / (near[2] - near[0]) / b
        G = self.weight * mode.virtual / (b * SIDE)[:, None, None]
        value = motion.x @ G.swapaxes(1, 2)
        shape = (len(motion.time), 1, *motion.F.shape[1:])
        gradient = np.broadcast_to(G[:, None, None], shape)
        return Sampled(value[:, None], gradient, (rate[:, None, None] * value)[:, None])

    def inside(self, boundary: np.ndarray) -> np.ndarray:
        """It works on no unknown force in any window."""
        return np.ones(1, dtype=bool)


def read_curves(path: Path) -> dict[str, Curve]:
    """The curves of a table, by mode in the order of the file.

    Args:
        path: comma-separated text with a head line ``mode,stretch,nominal_stress_Pa``; lines that
            start with ``#`` are comments.

    Raises:
        ValueError: one line: a column is missing, or a line holds no known mode or no number.
    """
    rows: dict[str, list[tuple[float, float]]] = {}
    for number, row in _lines(Path(path)):
        where = f"{path}, line {number}"
        if row["mode"] not in MODES:
            raise ValueError(f"{where}: mode {row['mode']!r}; known are {', '.join(MODES)}")
        pair = tuple(_number(where, column, row[column]) for column in COLUMNS[1:])
        if row["mode"] != "shear" and not pair[0] > 0.0:
            raise ValueError(f"{where}: stretch {pair[0]:g}: a stretch is positive")
        rows.setdefault(row["mode"], []).append((pair[0], pair[1]))
    few = [mode for mode, pairs in rows.items() if len(pairs) < 3]
    if few or not rows:
        fault = f"{few[0]} has fewer than three points" if few else "holds no point"
        raise ValueError(f"{path}: {fault}")
    found = {mode: Curve(mode, *np.array(pairs).T) for mode, pairs in rows.items()}
    dead = [c.mode for c in found.values() if not c.largest > 0.0]
    if dead:
        raise ValueError(f"{path}: every stress of {dead[0]} is zero")
    return found


def _lines(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Line numbers and cells by column."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    lines = [(n, t) for n, t in enumerate(text.splitlines(), 1) if t and not t.startswith("#")]
    head = next(csv.reader([lines[0][1]])) if lines else []
    lost = [column for column in COLUMNS if column not in head]
    if lost:
        raise ValueError(f"{path}: no column {lost[0]}; wanted are {', '.join(COLUMNS)}")
    for number, line in lines[1:]:
        cells = [c.strip() for c in next(csv.reader([line]))]
        if len(cells) != len(head):
            raise ValueError(f"{path}, line {number}: {len(cells)} cells, wanted {len(head)}")
        yield number, dict(zip(head, cells, strict=True))


def _number(where: str, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"{where}: {column} {cell!r} is no finite number")
    return value


def recordings(path: Path) -> dict[str, Recording]:
    """The recordings of a table of measured curves, by mode.

    Example:
        >>> probes = recordings(Path("treloar1944.csv"))  # doctest: +SKIP
        >>> print(identify(list(probes.values()), "yeoh"))  # doctest: +SKIP
    """
    source = f"{Path(path).name}: measured curves as a stepped test of a {1e3 * SIDE:g} mm cube"
    return {m: c.recording(source, {"kappa": BULK}) for m, c in read_curves(path).items()}
