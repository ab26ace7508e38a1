"""Simulated probes, kept in a folder under a key of all that they depend on, and errors."""

import ast
import hashlib
from importlib.metadata import version
from pathlib import Path

from form_drake.bench.cases import PACKAGE
from form_drake.identify import Identification
from form_drake.material import Material
from form_drake.records import Recording, read, write_recording

BEGIN = "form_drake.systems.probe"  # simulates and records
# What it imports beside and no motion depends on: these show one, see it, identify from it while it
# runs, or read it (the station takes the names of faces from there).
READERS = (
    "systems.identifier",
    "systems.page",
    "systems.seeing",
    "systems.viewer",
    "motion.body",
    "perceive.rig",
    "perceive.seen",
)
MODELS = (".sdf", ".urdf", ".yaml")


class Motions:
    """Simulated probes, kept in a folder from one run of the bench to the next."""

    def __init__(self, folder: Path):
        self._folder = folder

    def recording(self, scenario: str, made: tuple[str, ...], *, unseen: bool = False) -> Recording:
        """The probe, or the unseen motion, without noise; simulated if it is not there yet."""
        from form_drake.systems.probe import prepare, record
        from form_drake.systems.scenario import held_out, load_scenario, scenario_text

        text = scenario_text(scenario, made) + ("unseen" if unseen else "")
        mark = hashlib.sha256((text + code()).encode()).hexdigest()[:16]
        path = self._folder / f"{mark}.h5"
        if not path.is_file():
            chosen = load_scenario(scenario, made)
            write_recording(record(prepare(held_out(chosen) if unseen else chosen)), path)
        return read(path).measured_by("sensor")


def code(package: Path = PACKAGE, begin: str = BEGIN, readers: tuple[str, ...] = READERS) -> str:
    """Digest of what a simulated motion depends on: modules, models, and the libraries' versions."""
    digest = hashlib.sha256()
    for name in ("drake", "numpy", "scipy", "warp-lang"):
        digest.update(f"{name} {version(name)}\n".encode())
    models = [p for p in (package / "models").resolve().rglob("*") if p.suffix in MODELS]
    for path in (*sorted(modules(package, begin, readers)), *sorted(models)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def modules(
    package: Path = PACKAGE, begin: str = BEGIN, readers: tuple[str, ...] = READERS
) -> set[Path]:
    """Files of all modules that ``begin``, the simulation of a probe, imports, directly or not.

    Modules in ``readers`` are left out, and what they import.
    """
    found: dict[str, Path] = {}
    left = [begin]
    skipped = {f"{package.name}.{name}" for name in readers}
    while left:
        name = left.pop()
        place = package.joinpath(*name.split(".")[1:])
        path = next(
            (p for p in (place.with_suffix(".py"), place / "__init__.py") if p.is_file()), None
        )
        if path is None or name in found or name in skipped:
            continue
        found[name] = path
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.module:
                left += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
            elif isinstance(node, ast.Import):
                left += [a.name for a in node.names]
        left = [n for n in left if n.startswith(f"{package.name}.")]
    return set(found.values())


def errors(answer: Identification, true: Material) -> dict[str, dict[str, float]]:
    """Error [%] and standard deviation [%] of E and, where there is one, tau_y."""
    found, truth = answer.material.parameters(), true.parameters()
    return {
        key: {
            "error": 100.0 * (found[key].value / truth[key].value - 1.0),
            "std": 100.0 * (found[key].std or 0.0) / truth[key].value,
        }
        for key in ("E", "tau_y")
        if key in truth
    }
