"""Scores where nothing is missing: what thresholds of a diagnosis stand on.

Data come from a grid that is finer than the twin's, and from finite elements of an independent
code, so that what discretisation costs is in them. Noise is drawn several times on each, and the rows
are assembled again. The scenes may be those of recordings of one's own.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.oracles import recorded, run
from form_drake.diagnose.diagnosis import given
from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.motions import NOISE, Block, noisy
from form_drake.diagnose.prepare import read
from form_drake.diagnose.score import scores
from form_drake.diagnose.search import matched
from form_drake.diagnose.thresholds import likeness
from form_drake.diagnose.verify import tracking_noise
from form_drake.effects import CATALOGUE, Effect
from form_drake.files import read_mapping
from form_drake.laws import LAWS, Law
from form_drake.motion.tracks import sighted, valid_points
from form_drake.records import Recording
from form_drake.weak.force import measured

FINER = 1.5  # times as many cells along every axis as the twin's
MATERIALS = ((20e3, 0.33), (45e3, 0.38), (80e3, 0.42), (120e3, 0.30))  # E [Pa], nu
PLATES = ("bonded", "frictionless")
BLOCK = Block()
SEEDS = (1, 2, 3)  # of the independent code
DRAWS = 16
TOGETHER = 4  # draws on scenes of one's own, kept when they are finished
LAW = LAWS[BLOCK.law]


def _finer(E: float, nu: float, plate: str, draws: int) -> dict[str, Any]:
    """On a specimen of our own solver."""
    scenes = Scenes.of((BLOCK.press(plate), BLOCK.shake()))
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
    model, seeds = Model(LAW, truth), range(draws)
    every = list(CATALOGUE.values())
    return _scored(lambda rng: [noisy(r, rng) for r in made], model, every, None, {}, seeds)


def _scored(
    drawn: Callable[[np.random.Generator], Sequence[Recording]],
    truth: Model,
    effects: Sequence[Effect],
    dx: float | None,
    known: Mapping[str, float],
    seeds: Sequence[int],
) -> dict[str, Any]:
    """Largest scores over draws of noise, each fitted from what the one before has found."""
    largest: dict[str, float] = {}
    start, errors = None, []
    for seed in seeds:
        scenes = Scenes.of(tuple(drawn(np.random.default_rng(seed))), dx)
        problem, found = read(scenes, truth.law, known)
        first = replace(found, causes=truth.causes)
        match = matched(Match.of(problem, scenes, start or first))
        start = match.model
        errors.append([start.values[k] / v - 1.0 for k, v in truth.values.items() if v])
        for score in scores(match, effects):
            name = score.effect.id
            largest[name] = max(largest.get(name, 0.0), score.score)
    return {"scores": largest, "errors": errors, "draws": len(seeds)}


def run_like(
    recordings: Sequence[Recording],
    model: Model,
    *,
    effects: Sequence[Effect],
    dx: float | None,
    draws: int,
    store: Path,
    only: tuple[str, ...] = (),
    inputs: Sequence[Path] = (),
) -> dict[str, Any]:
    """The bench on scenes of one's own, kept by recordings, model and grid.

    Args:
        recordings: of one specimen, whose noise is drawn again: that of tracks and forces, not what lasts,
            nor where plates are.
        model: of the specimen; its effects are known ones.
        effects: a catalogue.
        dx: grid spacing of the twin [m]; None: chosen, see ``Scenes``.
        draws: of noise.
        store: folder for what is finished.
        only: parts of names, see ``run_cases``.
        inputs: files that hold effects of one's own; where they change, nothing that is finished counts.

    Raises:
        ValueError: no recording holds a force, or the model has other values than they declare.
    """
    scenes = Scenes.of(tuple(sighted(r) for r in recordings), dx)
    known = given(list(recordings), model.law, model)

    @cache
    def made() -> list[Recording]:
        return scenes.times(1.0 / FINER).rolled(model)

    def own(seeds: Sequence[int]) -> dict[str, Any]:
        pairs = list(zip(made(), scenes.recordings, strict=True))
        drawn = partial(_again, pairs)
        return _scored(drawn, model, effects, dx, known, seeds)

    name = f"null/like/{_digest(scenes.recordings, model, scenes.dx)}"
    parts = (range(n, min(n + TOGETHER, draws)) for n in range(0, draws, TOGETHER))
    cases = {f"{name}/draws{part[0]}-{part[-1]}": partial(own, part) for part in parts}
    estimates = dict.fromkeys(cases, 60.0 + 100.0 * TOGETHER)
    mark = fingerprint(*inputs)
    results = run_cases(cases, store=store, mark=mark, estimates=estimates, only=only)
    count = sum(r["draws"] for r in results.values())
    of = likeness(scenes, model.law, model.causes)
    return {"cases": results, "scores": _largest(results), "draws": count, "of": of}


def _digest(*told: Any) -> str:
    """Of all that is in recordings and beside them, arrays, mappings and objects of data."""
    found = hashlib.sha256()
    left = [*told]
    while left:
        one = left.pop()
        if isinstance(one, np.ndarray):
            found.update(f"{one.dtype} {one.shape}".encode() + one.tobytes())
        elif isinstance(one, Effect | Law):
            found.update(str(getattr(one, "id", getattr(one, "name", ""))).encode())
        elif is_dataclass(one):
            left += [(f.name, getattr(one, f.name)) for f in fields(one)]
        elif isinstance(one, Mapping):
            left += sorted(one.items())
        elif isinstance(one, list | tuple):
            found.update(f"{len(one)}".encode())
            left += one
        else:
            found.update(f"{one!r} ".encode())
    return found.hexdigest()[:12]


def _again(
    pairs: Sequence[tuple[Recording, Recording]], rng: np.random.Generator
) -> list[Recording]:
    """Simulated recordings with the noise and the gaps of measured ones."""
    found = []
    for made, seen in pairs:
        forces, there = {}, valid_points(seen)
        for tool, force in measured(seen, 0.0, float(np.ptp(seen.time))).items():
            stream = made.forces[tool]
            value = stream.value + force.noise * rng.standard_normal(stream.value.shape)
            forces[tool] = replace(stream, value=value, noise=seen.forces[tool].noise)
        p_WQ = made.p_WQ + tracking_noise(seen) * rng.standard_normal(made.p_WQ.shape)
        p_WQ[~there] = np.nan
        found.append(replace(made, p_WQ=p_WQ, valid=there, noise=seen.noise, forces=forces))
    return found


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
    told = {"scores": _largest(results), "noise": NOISE, "draws": draws}
    return {"bench": "nulls", "cases": results, **told}


def _largest(results: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Scores by effect's id."""
    names = sorted({name for r in results.values() for name in r["scores"]})
    return {n: max(r["scores"].get(n, 0.0) for r in results.values()) for n in names}


def table(result: Mapping[str, Any]) -> str:
    """As printed."""
    draws = sum(r["draws"] for r in result["cases"].values())
    lines = [f"{len(result['cases'])} cases, {draws} draws of noise", ""]
    lines += [f"{name:18} {score:8.1f}" for name, score in result["scores"].items()]
    worst = max(abs(e) for r in result["cases"].values() for pair in r["errors"] for e in pair)
    return "\n".join([*lines, "", f"largest error of a parameter {100.0 * worst:.1f} %"])
