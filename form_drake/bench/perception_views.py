"""Tracks from rendered pictures of simulated probes, kept from one run of the bench to the next."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from form_drake.bench import oracles
from form_drake.bench.probes_motions import Motions, code
from form_drake.files import read_mapping
from form_drake.perceive.pictures import Pictures
from form_drake.perceive.seen import completed, tracked
from form_drake.records import Recording, Stream, read, write_recording

if TYPE_CHECKING:
    from form_drake.systems.scenario import Scenario

PHOTOGRAPH = "form_drake.systems.pictures"
TRACK = "form_drake.perceive.seen"
LATTICE = 1.25e-3  # [m] between points of a finite element motion that are shown
SHOWN_AS = {"press": "press_a", "bend": "bend_a"}  # cameras of a finite element motion

FRAMES = 1000  # more than any probe has

Kept = Callable[[int], bool]


def every(frame: int) -> bool:
    """All frames are seen."""
    return True


@dataclass(frozen=True)
class Views:
    """What two cameras see of probes.

    Attributes:
        folder: of simulated motions and of tracks.
    """

    folder: Path

    def particles(self, name: str, made: tuple[str, ...], rate: float) -> Recording:
        """All particles of a simulated probe at the cameras' rate."""
        every_one = ("measure.points=0", "measure.noise=0", f"measure.rate={rate}")
        return Motions(self.folder).recording(name, (*made, *every_one))

    def some(self, name: str, made: tuple[str, ...], rate: float, count: int) -> Recording:
        """Particles of the same, drawn by seed 0."""
        from form_drake.systems.scenario import scenario_text

        def drawn() -> Recording:
            every_one = self.particles(name, made, rate)
            rng = np.random.default_rng(0)
            chosen = np.sort(rng.choice(every_one.points, count, replace=False))
            p_WQ, reference = every_one.p_WQ[:, chosen], every_one.reference[chosen]
            return replace(every_one, p_WQ=p_WQ, p_reference=reference)

        return self._kept("some", f"{scenario_text(name, made)}{rate} {count}" + code(), drawn)

    def tracks(
        self,
        name: str,
        made: tuple[str, ...] = (),
        look: tuple[str, ...] = (),
        kept: Kept = every,
    ) -> Recording:
        """Points of the face that a scenario's cameras see.

        Args:
            name: of the scenario.
            made: changes of the specimen.
            look: changes of the cameras.
            kept: frames of which there are pictures.
        """
        from form_drake.systems.scenario import load_scenario, scenario_text

        left = "".join("01"[kept(n)] for n in range(FRAMES))
        scenario = load_scenario(name, (*made, *look))

        def seen() -> Recording:
            moved = self.particles(name, made, scenario.stereo.rate)
            return _looked(scenario, moved, kept)

        return self._kept("tracks", scenario_text(name, (*made, *look)) + left + _code(), seen)

    def finite(self, case: str) -> tuple[Recording, dict[str, float]]:
        """Points of the face of a finite element motion, and the true values."""
        from form_drake.systems.scenario import load_scenario, scenario_text

        name = SHOWN_AS[case.split("-")[0]]
        scenario = load_scenario(name)
        rate = scenario.stereo.rate
        digest = hashlib.sha256(f"{LATTICE} {rate:.0f}\n".encode())
        for path in sorted(oracles.ORACLES.glob("finite*.py")):
            digest.update(path.read_bytes())
        folder = self.folder / f"finite-{digest.hexdigest()[:12]}"
        truth = folder / f"{case}.truth.json"
        if not truth.is_file():
            words = ["--lattice", str(LATTICE), "--fps", f"{rate:.0f}", "--out", folder]
            hangs = ["--gravity"] * case.startswith("bend")
            oracles.run("finite_elements.py", case, *words, *hangs)

        def seen() -> Recording:
            return _looked(scenario, _placed(folder / case, scenario), every)

        key = scenario_text(name) + case + digest.hexdigest() + _code()
        return self._kept("tracks", key, seen), read_mapping(truth)

    def _kept(self, kind: str, key: str, made: Callable[[], Recording]) -> Recording:
        mark = hashlib.sha256(key.encode()).hexdigest()[:16]
        path = self.folder / f"{kind}-{mark}.h5"
        if not path.is_file():
            write_recording(made(), path)
        return read(path)


def _code() -> str:
    """Digest of what tracks depend on beside a scenario: simulated, photographed, tracked."""
    opencv = version("opencv-python-headless")
    return code() + code(begin=PHOTOGRAPH) + code(begin=TRACK, readers=()) + opencv


def _looked(scenario: "Scenario", particles: Recording, kept: Kept) -> Recording:
    """Render, leave out frames, track."""
    from form_drake.systems.pictures import (
        beside_pictures,
        frames_a_second,
        rig_of,
        write_pictures,
    )

    rig = rig_of(scenario, frames_a_second(particles))
    probe = beside_pictures(particles, scenario.stereo.symmetry)
    with TemporaryDirectory() as place:
        folder = Path(place)
        write_pictures(folder, scenario, rig, particles)
        for n in range(particles.frames):
            if n and not kept(n):
                for path in folder.glob(f"*_{n:05d}.png"):
                    path.unlink()
        pictures = Pictures.found([folder], rig.cameras)
        return completed(tracked(rig, pictures, float(probe.time[0])), probe)


def _placed(path: Path, scenario: "Scenario") -> Recording:
    """A finite element motion where the scenario's cameras look, with what is stated of it."""
    from form_drake.systems.station import specimen_corners

    made = oracles.recorded(path)
    bent = path.name.startswith("bend")
    geometry = oracles.BENT["geometry"] if bent else made.geometry
    low = np.array([float(v) for v in str(geometry["low"]).split()])
    shift = specimen_corners(scenario)[0] - low
    poses = {}
    for tool in made.forces:
        stream = made.poses[tool]
        X = stream.value.copy()
        X[:, :3, 3] += shift
        poses[tool] = Stream(stream.time, X)
    return replace(
        made,
        p_WQ=made.p_WQ + shift,
        p_reference=made.reference + shift,
        poses=poses,
        known={"nu": scenario.specimen.material["nu"]},
        **({"contact": oracles.BENT["contact"]} if bent else {}),
    )
