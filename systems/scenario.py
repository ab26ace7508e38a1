"""Scenarios: what a station holds, what it does and what is measured, as typed YAML."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.systems.sensors import CameraConfig

from form_drake.effects import CATALOGUE
from form_drake.effects import Effect as Known
from form_drake.laws import Law, law_named
from form_drake.laws.values import check_moduli, checked_values, finite
from form_drake.material import Acting, Material
from form_drake.systems.force import SensorErrors
from form_drake.systems.layers import check, layered
from form_drake.systems.panda import PandaDriver
from form_drake.systems.sensible import parameters, sensible


@dataclass
class Effect:
    """What acts on the specimen or its sensors beside the law, see ``form_drake.effects``.

    Attributes:
        id: of the effect.
        coefficient: in the effect's unit; not a number: none is given.
        shape: values of its shape parameters.
    """

    id: str = ""
    coefficient: float = math.nan
    shape: dict[str, float] = field(default_factory=dict)


@dataclass
class Specimen:
    """The soft body.

    Attributes:
        size: edges of a box [m].
        p_WM: its centre when free of stress [m].
        law: constitutive law.
        material: values of the law's parameters (SI units), or of E and nu, and density [kg/m^3].
        known: parameters that are declared to the identification.
        faces: what is known of each face, see ``Recording.contact``.
        contact: by body: a Coulomb coefficient, ``stick``, which is one without bound, or ``bonded``, which
            does not let go.
        clamped: by face: length inside of a clamp there [m], which is neither simulated nor recorded.
        effects: that act beside the law, and of which the recording says nothing.
    """

    size: list[float] = field(default_factory=list)
    p_WM: list[float] = field(default_factory=list)
    law: str = "fixed-corotated"
    material: dict[str, float] = field(default_factory=dict)
    known: list[str] = field(default_factory=list)
    faces: dict[str, str] = field(default_factory=dict)
    contact: dict[str, str] = field(default_factory=dict)
    clamped: dict[str, float] = field(default_factory=dict)
    effects: list[Effect] = field(default_factory=list)

    def made(self) -> Material:
        """The material that is simulated.

        Raises:
            ValueError: an unknown law, a missing value or a value out of range.
        """
        law = law_named(self.law)
        values = dict(self.material)
        density = finite("density", values.pop("density", None))
        if not density > 0.0:
            raise ValueError(f"density: must be positive, got {density:g}")
        acting = tuple(Acting(e.id, e.coefficient, e.shape) for e in self.effects)
        made = Material(law, checked_values(law, values), density, effects=acting)
        check_moduli(law, made.values)
        return made

    def told(self) -> dict[str, float]:
        """Values that are declared known, as they are stated, or follow from what is."""
        made = self.made()
        follow = {key: p.value for key, p in made.parameters().items()}
        every = {**follow, "density": made.density, **self.material}
        return {key: every[key] for key in self.known if key in every}


@dataclass
class Stepping:
    """How the material is simulated.

    Attributes:
        dx: grid spacing [m].
        grid: ``rest`` or ``space``, see ``AddMaterial``.
        per_cell: particles in a cell of the grid along each axis.
        period: of the exchange between material and plant, and of the plant's steps [s].
        mass_scale: see ``Scene``.
        precision: ``float32`` or ``float64``.
        device: Warp device.
        damping: rate at which velocities decay while the specimen settles [1/s].
        settle: until when [s].
        room: how far beyond the specimen particles may go, along each axis [m].
    """

    dx: float = 0.0025
    grid: str = "space"
    per_cell: list[int] = field(default_factory=lambda: [2, 2, 2])
    period: float = 0.001
    mass_scale: float = 1.0
    precision: str = "float32"
    device: str = "cpu"
    damping: float = 0.0
    settle: float = 0.0
    room: list[float] = field(default_factory=lambda: [0.02, 0.02, 0.02])


@dataclass
class Waypoint:
    """Where the tool is at a time: it gets there and leaves at rest.

    Attributes:
        time: [s].
        p_WT: place of the tool frame [m].
    """

    time: float = 0.0
    p_WT: list[float] = field(default_factory=list)


@dataclass
class Probe:
    """What the arm does.

    Attributes:
        tool: scoped name of the tool frame T.
        rpy_deg: its orientation in the world, roll, pitch, yaw [deg].
        waypoints: the tool's path, 3u^2 - 2u^3 between them.
        unseen: another path, for tests of a prediction.
        until_force: force [N] at which the tool stops on its way; None: it goes to the end.
    """

    tool: str = ""
    rpy_deg: list[float] = field(default_factory=lambda: [180.0, 0.0, 0.0])
    waypoints: list[Waypoint] = field(default_factory=list)
    unseen: list[Waypoint] = field(default_factory=list)
    until_force: float | None = None


@dataclass
class Measurement:
    """What is recorded.

    Attributes:
        rate: of the tracked points [Hz], or a little faster: whole periods of the solver.
        points: how many particles are tracked; 0: all.
        noise: standard deviation of a coordinate [m].
        place: the same of where the tool is said to be [m]: an error that stays, drawn once.
        seed: of the choice of points, of their noise and of that.
        sensor: errors of the force sensor at the tool [N].
        torque: errors of the external joint torques [N m].
    """

    rate: float = 100.0
    points: int = 400
    noise: float = 0.0
    place: float = 0.0
    seed: int = 0
    sensor: SensorErrors = field(default_factory=SensorErrors)
    torque: SensorErrors = field(default_factory=SensorErrors)


@dataclass
class StereoPair:
    """Two cameras that look at a face of the specimen, on which speckle is sprayed.

    Attributes:
        face: that is seen, such as ``x+``; empty: none.
        symmetry: that the recording states of the motion, see ``docs/recording.md``.
        aim: what they look at in world [m]; empty: the middle of the face.
        down: direction in world that is downwards in the pictures.
        size: width and height of a picture [px].
        focus: focal length [px].
        distance: of the cameras from what they look at [m].
        baseline: between the cameras [m].
        distortion: of both lenses, k1 k2 p1 p2 k3.
        turned_deg: by how much the right camera is turned about its axes from its calibration [deg].
        rate: of the pictures [Hz], or a little faster: whole periods of the solver.
        half: pixels from a point to the rim of what is compared.
        spacing: of the points [m]; None: chosen.
        speckle: radius of the speckle's discs [px].
        noise: standard deviation of a grey value.
        blur: of the lens [px].
        drift: by which grey values have grown at the end, as a share.
        seed: of speckle and noise.
    """

    face: str = ""
    symmetry: str = ""
    aim: list[float] = field(default_factory=list)
    down: list[float] = field(default_factory=lambda: [0.0, 0.0, -1.0])
    size: list[int] = field(default_factory=lambda: [640, 480])
    focus: float = 4000.0
    distance: float = 0.3
    baseline: float = 0.1
    distortion: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0, 0.0])
    turned_deg: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rate: float = 60.0
    half: int = 12
    spacing: float | None = None
    speckle: float = 1.65
    noise: float = 2.0
    blur: float = 0.0
    drift: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        lengths = {
            "aim": (0, 3),
            "down": (3,),
            "size": (2,),
            "distortion": (5,),
            "turned_deg": (3,),
        }
        for name, allowed in lengths.items():
            if len(own := getattr(self, name)) not in allowed:
                raise ValueError(f"{name}: {allowed[-1]} numbers are wanted, got {own}")
        if min(self.size) < 1:
            raise ValueError(f"size: positive numbers of pixels are wanted, got {self.size}")
        for name in ("focus", "distance", "baseline", "rate", "half", "speckle", "spacing"):
            if (value := getattr(self, name)) is not None and not value > 0:
                raise ValueError(f"{name}: a positive number is wanted, got {value}")
        for name in ("noise", "blur"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name}: must not be negative, got {getattr(self, name)}")


@dataclass
class Scenario:
    """A station and a probe.

    Attributes:
        name: of the scenario.
        arm: model directives of the arm, a ``package://`` name or a file, named from that of the scenario:
            the Panda of this package, or ``package://form_drake/panda/drake_models.dmd.yaml`` for that of
            Drake's models.
        cell: model directives of tools and stands, likewise.
        packages: folders of further packages by name, such as ``drake_models``.
        panda: driver of the arm.
        specimen: the soft body.
        solver: its simulation.
        probe: what the arm does.
        measure: what is recorded.
        stereo: cameras that see the specimen for ``simulate --perception stereo``.
        cameras: by name.
    """

    name: str = ""
    arm: str = "package://form_drake/panda/panda.dmd.yaml"
    cell: str = ""
    packages: dict[str, str] = field(default_factory=dict)
    panda: PandaDriver = field(default_factory=PandaDriver)
    specimen: Specimen = field(default_factory=Specimen)
    solver: Stepping = field(default_factory=Stepping)
    probe: Probe = field(default_factory=Probe)
    measure: Measurement = field(default_factory=Measurement)
    stereo: StereoPair = field(default_factory=StereoPair)
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


def load_scenario(
    name: str | Path,
    changes: Sequence[str] = (),
    effects: Mapping[str, Known] = CATALOGUE,
) -> Scenario:
    """A scenario by name or from a file, with changes such as ``specimen.material.E=63e3``.

    ``effects`` are those that it may name, by id.

    Raises:
        ValueError: an unknown name or key, a value of the wrong kind, or inheritance without end;
            the message says what is allowed.
    """
    try:
        found = yaml_load_typed(
            schema=Scenario, data=scenario_text(name, changes), defaults=Scenario()
        )
        sensible(found, effects)
        return found
    except AssertionError as error:  # of Drake's reader
        raise ValueError(f"scenario {name}: entries are wanted in the place of {error}") from None
    except (OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"scenario {name}: {error}") from None


def holding(material: Material) -> tuple[str, ...]:
    """Changes by which a scenario's specimen is of a material, effects and all."""
    acting = [
        {"id": e.id, "coefficient": e.coefficient, "shape": dict(e.shape)} for e in material.effects
    ]
    values = {**material.values, "density": material.density}
    written = (yaml.safe_dump(v, default_flow_style=True, width=math.inf) for v in (values, acting))
    numbers, effects = (text.strip() for text in written)
    return (
        f"specimen.law={material.law.name}",
        f"specimen.material={numbers}",
        f"specimen.effects={effects}",
    )


def declaring(known: Sequence[str], law: Law) -> str:
    """Change by which a scenario declares as known what a law has, of what it has declared."""
    return f"specimen.known=[{', '.join(k for k in known if k in parameters(law))}]"


def held_out(scenario: Scenario) -> Scenario:
    """The scenario with its unseen path in the place of the probe's.

    Raises:
        ValueError: it has none.
    """
    if not scenario.probe.unseen:
        raise ValueError(f"scenario {scenario.name} has no probe.unseen: add a path to test with")
    probe = dataclasses.replace(scenario.probe, waypoints=scenario.probe.unseen)
    return dataclasses.replace(scenario, probe=probe)


def scenario_text(name: str | Path, changes: Sequence[str] = (), *, hidden: bool = False) -> str:
    """The YAML of a scenario with all that it inherits and the changes, in one piece.

    Args:
        name: of the scenario, or its file.
        changes: PATH=VALUE.
        hidden: leave out effects, and the values of the material that are not declared as known.

    Raises:
        ValueError: see ``load_scenario``.
    """
    content = layered(str(name), changes)
    content.setdefault("name", Path(str(name)).stem)
    check(Scenario, content, "")
    contact = content.get("specimen", {}).get("contact", {})
    contact.update({body: str(word) for body, word in contact.items()})
    if hidden:
        specimen = content["specimen"]
        kept = {"density", *specimen.get("known", ())}
        specimen["material"] = {k: v for k, v in specimen["material"].items() if k in kept}
        specimen.pop("effects", None)
    return yaml.safe_dump(content, sort_keys=False)
