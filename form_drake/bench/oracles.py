"""Motions that the scripts in ``tests/oracles`` make, read as a person's own arrays would be, and noise."""

import hashlib
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from form_drake.files import read_mapping
from form_drake.records import Recording, Stream

ORACLES = Path(__file__).resolve().parents[2] / "tests" / "oracles"
FINITE = {  # what is stated of the set-up beside the files: the Poisson ratio
    "press-a": 0.30,
    "press-b": 0.30,
    "bend-touching-a": 0.45,
    "bend-touching-b": 0.45,
}
BENT = {  # the clamp holds the strip beyond 85 mm: what is bent ends there
    "geometry": {"shape": "box", "low": "-0.006 -0.002 0", "high": "0.006 0.002 0.085"},
    "contact": {"z+": "bonded clamp", "x+": "touched pusher", "other": "free"},
}
POSITION_NOISE, FORCE_NOISE = 20e-6, 0.01  # [m]; share of the largest force


@dataclass(frozen=True)
class Motions:
    """Motions that the oracles have made or make when they are asked for.

    Attributes:
        folder: of their files.
    """

    folder: Path

    @classmethod
    def within(cls, store: Path) -> "Motions":
        """Those in a folder that is named by the oracles' code.

        Raises:
            ValueError: the package does not lie in a checkout of the project.
        """
        _present("exact_motion.py")
        digest = hashlib.sha256(b"".join(p.read_bytes() for p in sorted(ORACLES.glob("*.py"))))
        return cls(store / f"motions-{digest.hexdigest()[:12]}")

    def made(self, case: str) -> Path:
        """Path of a case's files without their endings; the truth is the last to be written.

        Raises:
            ValueError: the oracle failed.
        """
        path = self.folder / case
        if not Path(f"{path}.truth.json").is_file():
            name = "finite_elements.py" if case in FINITE else "exact_motion.py"
            run(name, case, "--seed", "0", "--out", self.folder)
        return path

    def recordings(self, cases: Sequence[str]) -> list[Recording]:
        """One recording for each case."""
        return [self.recording(case) for case in cases]

    def recording(self, case: str) -> Recording:
        """What a case's files and its set-up state."""
        found = recorded(self.made(case))
        held = {"pusher"} if case.startswith("bend") else set()
        poses = {tool: pose for tool, pose in found.poses.items() if tool in held}
        known = {"known": {"nu": FINITE[case]}} if case in FINITE else {}
        return replace(found, poses=poses, **known, **(BENT if held else {}))

    def truth(self, case: str) -> dict[str, float]:
        """True parameters."""
        return read_mapping(Path(f"{self.made(case)}.truth.json"))


def recorded(path: Path) -> Recording:
    """What the files of an oracle hold, from their path without its endings."""
    with np.load(f"{path}.npz") as file:
        a = dict(file)

    def streams(kind: str) -> dict[str, Stream]:
        tools = [
            k[len(kind) + 1 : -5] for k in a if k.startswith(f"{kind}_") and k.endswith("_time")
        ]
        return {
            t: Stream(a[f"{kind}_{t}_time"], a[f"{kind}_{t}_value"], noise=_noise(f"{kind}_{t}"))
            for t in tools
        }

    def _noise(name: str) -> float | None:
        return float(a[f"{name}_noise"]) if f"{name}_noise" in a else None

    stated = ("p_reference", "gravity", "body_force", "pressure")
    return Recording.from_arrays(
        a["time"],
        a["p_WQ"],
        density=float(a["density"]),
        forces=streams("force"),
        poses=streams("pose"),
        **{k: a[k] for k in stated if k in a},
        **read_mapping(Path(f"{path}.json")),
    )


def _present(script: str) -> None:
    if not (ORACLES / script).is_file():
        raise ValueError(
            f"{ORACLES}: not there; this bench runs the scripts of tests/oracles, which only a checkout"
            " of the project holds"
        )


def run(script: str, *words: str | Path) -> None:
    """Run an oracle.

    Raises:
        ValueError: it failed, or the package does not lie in a checkout of the project.
    """
    _present(script)
    command = [sys.executable, ORACLES / script, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ValueError(f"{script} {words[0]} failed: {last}")


def relative_noise(recording: Recording, rng: np.random.Generator, *, level: float) -> Recording:
    """Noise of ``level`` percent of the rms of displacement, of each force and of pressure."""
    share = level / 100.0

    def added(x: np.ndarray, size: np.ndarray) -> np.ndarray:
        return x + share * np.sqrt(np.mean(size**2)) * rng.standard_normal(x.shape)

    p_WQ = added(recording.p_WQ, recording.p_WQ - recording.reference)
    forces = {
        k: replace(s, value=added(s.value, np.linalg.norm(s.value, axis=1)))
        for k, s in recording.forces.items()
    }
    p = recording.pressure
    pressure = None if p is None else added(p, p)
    return replace(recording, p_WQ=p_WQ, forces=forces, pressure=pressure)


def laboratory_noise(recording: Recording, rng: np.random.Generator) -> Recording:
    """Noise of 20 um on every coordinate and of 1 % of the largest force."""
    p_WQ = recording.p_WQ + POSITION_NOISE * rng.standard_normal(recording.p_WQ.shape)
    forces = {}
    for key, s in recording.forces.items():
        size = FORCE_NOISE * np.linalg.norm(s.value, axis=1).max()
        forces[key] = replace(s, value=s.value + size * rng.standard_normal(s.value.shape))
    return replace(recording, p_WQ=p_WQ, forces=forces)
