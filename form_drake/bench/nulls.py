"""Scores where nothing is missing: what thresholds of a diagnosis stand on.

Data come from a grid that is finer than the twin's, and from finite elements of an independent
code, so that what discretisation costs is in them. Noise is drawn several times on each, and the rows
are assembled again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.oracles import recorded, run
from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.prepare import read
from form_drake.diagnose.score import scores
from form_drake.diagnose.search import matched
from form_drake.effects import CATALOGUE
from form_drake.files import read_mapping
from form_drake.laws import LAWS
from form_drake.records import Recording, Stream

FINER = 1.5  # times as many cells along every axis as the twin's
SIZE = np.array([0.036, 0.034, 0.030])
MATERIALS = ((20e3, 0.33), (45e3, 0.38), (80e3, 0.42), (120e3, 0.30))  # E [Pa], nu
PLATES = ("bonded", "frictionless")
POINTS, RATE, STAMPS = 330, 60.0, 240.0  # tracks; frames and force samples per second
NOISE, FORCE_NOISE = 5e-5, 0.01  # [m]; of the largest force
DEPTH, PRELOAD = 0.075, 0.007  # of the height
PRESS = ((0.15, 0.0), (0.9, 0.85), (1.15, 0.85), (1.4, 0.4), (1.55, 1.0), (1.8, 1.0), (2.7, 0.1))
SEEDS = (1, 2, 3)  # of the independent code
DRAWS = 16
LAW = LAWS["neo-hookean"]


def _way(knots: tuple[tuple[float, float], ...], time: np.ndarray) -> np.ndarray:
    """A way with two continuous derivatives through knots (time, value)."""
    t, y = np.array(knots).T
    k = np.clip(np.searchsorted(t, time, "right") - 1, 0, len(t) - 2)
    s = np.clip((time - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)
    found: np.ndarray = y[k] + (y[k + 1] - y[k]) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return found


def _recording(seconds: float, tool: str, way: np.ndarray, top: str, *, force: bool) -> Recording:
    """A block whose tool's origin goes a way [m], shape [stamps, 3], before it is simulated."""
    time, stamps = (np.arange(0.0, seconds + 1e-9, 1.0 / rate) for rate in (RATE, STAMPS))
    low = np.array([-0.5 * SIZE[0], -0.5 * SIZE[1], 0.0])
    X = low + SIZE * np.random.default_rng(0).uniform(0.03, 0.97, (POINTS, 3))
    X_WT = np.tile(np.eye(4), (len(stamps), 1, 1))
    X_WT[:, :3, 3] = way
    none = np.zeros((len(stamps), 3))
    return Recording.from_arrays(
        time,
        np.tile(X, (len(time), 1, 1)),
        p_reference=X,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={
            "shape": "box",
            "low": " ".join(map(str, low)),
            "high": " ".join(map(str, low + SIZE)),
        },
        contact={"z-": "bonded floor", "z+": top, "other": "free"},
        poses={tool: Stream(stamps, X_WT)},
        forces={tool: Stream(stamps, none)} if force else {},
        law="neo-hookean",
    )


def press(plate: str) -> Recording:
    """Slow press, hold, partial release, fast press, oscillation and return."""
    stamps = np.arange(0.0, 2.8 + 1e-9, 1.0 / STAMPS)
    start = PRELOAD if plate == "frictionless" else 0.0
    depth = start + (DEPTH - start) * _way(PRESS, stamps)
    beat = np.clip((stamps - 1.8) / 0.8, 0.0, 1.0)
    depth += 0.004 * np.sin(np.pi * beat) ** 3 * np.sin(2.0 * np.pi * 5.0 * stamps)
    way = np.zeros((len(stamps), 3))
    way[:, 2] = SIZE[2] * (1.0 - depth)
    return _recording(2.8, "plate", way, f"{plate} plate", force=True)


def shake() -> Recording:
    """The floor moves sideways, and a little up and down."""
    stamps = np.arange(0.0, 1.3 + 1e-9, 1.0 / STAMPS)
    slow, fast = (
        np.sin(np.pi * np.clip((stamps - a) / w, 0.0, 1.0)) ** 3
        for a, w in ((0.05, 0.75), (0.6, 0.6))
    )
    way = np.zeros((len(stamps), 3))
    way[:, 0] = 4e-3 * slow * np.sin(2.0 * np.pi * 3.0 * stamps)
    way[:, 1] = 1.5e-3 * fast * np.sin(2.0 * np.pi * 7.0 * stamps)
    way[:, 2] = 4e-4 * (slow + fast) * np.sin(2.0 * np.pi * 5.0 * stamps)
    return _recording(1.3, "floor", way, "free", force=False)


def noisy(recording: Recording, rng: np.random.Generator) -> Recording:
    """With noise in tracks and forces, which is stated."""
    streams = {}
    for tool, stream in recording.forces.items():
        size = FORCE_NOISE * float(np.abs(stream.value).max())
        value = stream.value + size * rng.standard_normal(stream.value.shape)
        streams[tool] = Stream(stream.time, value, noise=size)
    p_WQ = recording.p_WQ + NOISE * rng.standard_normal(recording.p_WQ.shape)
    return replace(recording, p_WQ=p_WQ, noise=NOISE, forces=streams)


def _finer(E: float, nu: float, plate: str, draws: int) -> dict[str, Any]:
    """On a specimen of our own solver."""
    scenes = Scenes.of((press(plate), shake()))
    scenes = replace(scenes, dx=tuple(dx / FINER for dx in scenes.dx))
    return _case(scenes.rolled(Model(LAW, _truth(E, nu))), _truth(E, nu), draws)


def _independent(seed: int, draws: int) -> dict[str, Any]:
    """On a specimen of an independent code."""
    with TemporaryDirectory() as name:
        key, cases = Path(name) / "key.json", Path(name) / "cases"
        run(
            "hidden_effects.py", "--kind", "null", "--seed", str(seed), "--out", cases, "--key", key
        )
        ((case, told),) = read_mapping(key).items()
        made = [recorded(cases / case / probe) for probe in ("press", "shake")]
    return _case(made, _truth(told["body"]["E"], told["body"]["nu"]), draws)


def _truth(E: float, nu: float) -> dict[str, float]:
    return {"C10": E / (4.0 * (1.0 + nu)), "kappa": E / (3.0 * (1.0 - 2.0 * nu))}


def _case(made: Sequence[Recording], truth: dict[str, float], draws: int) -> dict[str, Any]:
    largest: dict[str, float] = {}
    start, errors = None, []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        scenes = Scenes.of(tuple(noisy(r, rng) for r in made))
        problem, found = read(scenes, LAW, {})
        match = matched(Match.of(problem, scenes, start or found))
        start = match.model
        errors.append([start.values[k] / truth[k] - 1.0 for k in truth])
        for score in scores(match, CATALOGUE.values()):
            name = score.effect.id
            largest[name] = max(largest.get(name, 0.0), score.score)
    return {"scores": largest, "errors": errors, "draws": draws}


def run_nulls(*, draws: int, store: Path, only: tuple[str, ...] = ()) -> dict[str, Any]:
    """The bench."""
    cases = {
        f"null/{plate}/E{E / 1e3:.0f}/draws{draws}": lambda E=E, nu=nu, plate=plate: _finer(
            E, nu, plate, draws
        )
        for plate in PLATES
        for E, nu in MATERIALS
    }
    cases |= {
        f"null/elements/seed{seed}/draws{draws}": lambda seed=seed: _independent(seed, draws)
        for seed in SEEDS
    }
    estimates = {name: 240.0 + 100.0 * draws for name in cases}
    results = run_cases(cases, store=store, mark=fingerprint(), estimates=estimates, only=only)
    names = {name for r in results.values() for name in r["scores"]}
    largest = {
        name: max(r["scores"].get(name, 0.0) for r in results.values()) for name in sorted(names)
    }
    return {"cases": results, "scores": largest, "noise": NOISE, "draws": draws}


def table(result: Mapping[str, Any]) -> str:
    """As printed."""
    lines = [f"{len(result['cases'])} specimens, {result['draws']} draws each", ""]
    lines += [f"{name:18} {score:8.1f}" for name, score in result["scores"].items()]
    worst = max(abs(e) for r in result["cases"].values() for pair in r["errors"] for e in pair)
    return "\n".join([*lines, "", f"largest error of a modulus {100.0 * worst:.1f} %"])
