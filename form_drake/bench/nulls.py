"""Scores where nothing is missing: what thresholds of a diagnosis stand on.

Data come from a grid that is finer than the twin's, and from finite elements of an independent
code, so that what discretisation costs is in them. Noise is drawn several times on each, and the rows
are assembled again. The scenes may be those of recordings of one's own.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.oracles import recorded, run
from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.motions import NOISE, Block, noisy
from form_drake.diagnose.prepare import read
from form_drake.diagnose.score import scores
from form_drake.diagnose.search import matched
from form_drake.diagnose.thresholds import noises
from form_drake.diagnose.verify import tracking_noise
from form_drake.effects import CATALOGUE
from form_drake.files import read_mapping
from form_drake.identify.stated import weak_known
from form_drake.laws import LAWS
from form_drake.motion.tracks import sighted
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
    return _scored(lambda rng: [noisy(r, rng) for r in made], model, None, {}, seeds)


def _scored(
    drawn: Callable[[np.random.Generator], Sequence[Recording]],
    truth: Model,
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
        for score in scores(match, CATALOGUE.values()):
            name = score.effect.id
            largest[name] = max(largest.get(name, 0.0), score.score)
    return {"scores": largest, "errors": errors, "draws": len(seeds)}


def run_like(
    recordings: Sequence[Recording],
    model: Model,
    *,
    dx: float | None,
    draws: int,
    store: Path,
    only: tuple[str, ...] = (),
) -> dict[str, Any]:
    """The bench on scenes of one's own, kept by recordings, model and grid.

    Args:
        recordings: of one specimen, whose noise is drawn again: that of tracks and forces, not what lasts.
        model: of the specimen; its effects are known ones.
        dx: grid spacing of the twin [m]; None: chosen, see ``Scenes``.
        draws: of noise.
        store: folder for what is finished.
        only: parts of names, see ``run_cases``.
    """
    seen = tuple(sighted(r) for r in recordings)
    scenes = Scenes.of(seen, dx)
    known = weak_known(list(recordings), model.law, {})
    known |= {k: model.values[k] for k in model.law.constants("given")}

    @cache
    def made() -> list[Recording]:
        return scenes.times(1.0 / FINER).rolled(model)

    def own(seeds: Sequence[int]) -> dict[str, Any]:
        pairs = list(zip(made(), scenes.recordings, strict=True))
        return _scored(lambda rng: [_drawn(*p, rng) for p in pairs], model, dx, known, seeds)

    name = f"null/like/{_digest(scenes, model)}"
    parts = (range(n, min(n + TOGETHER, draws)) for n in range(0, draws, TOGETHER))
    cases = {f"{name}/draws{part[0]}-{part[-1]}": partial(own, part) for part in parts}
    estimates = dict.fromkeys(cases, 60.0 + 100.0 * TOGETHER)
    results = run_cases(cases, store=store, mark=fingerprint(), estimates=estimates, only=only)
    kept = {"law": model.law.name, "noise": noises(seen), "dx": scenes.dx}
    count = sum(r["draws"] for r in results.values())
    return {"cases": results, "scores": _largest(results), **kept, "draws": count}


def _digest(scenes: Scenes, model: Model) -> str:
    """Of recordings, model and grid."""
    causes = [(c.effect.id, c.coefficient, c.shape) for c in model.causes]
    told = (model.law.name, model.values, causes, scenes.dx, noises(scenes.recordings))
    found = hashlib.sha256(repr(told).encode())
    for recording in scenes.recordings:
        found.update(recording.p_WQ.tobytes())
        for stream in recording.forces.values():
            found.update(stream.value.tobytes())
    return found.hexdigest()[:12]


def _drawn(made: Recording, seen: Recording, rng: np.random.Generator) -> Recording:
    """A simulated recording with the noise and the gaps of a measured one."""
    noise, forces = tracking_noise(seen), {}
    for tool, force in measured(seen, 0.0, float(np.ptp(seen.time))).items():
        stream = made.forces[tool]
        value = stream.value + force.noise * rng.standard_normal(stream.value.shape)
        forces[tool] = replace(stream, value=value, noise=force.noise)
    p_WQ = made.p_WQ + noise * rng.standard_normal(made.p_WQ.shape)
    p_WQ[~np.isfinite(seen.p_WQ)] = np.nan
    return replace(made, p_WQ=p_WQ, noise=noise, forces=forces)


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
    return {"cases": results, "scores": _largest(results), "noise": NOISE, "draws": draws}


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
    return "\n".join([*lines, "", f"largest error of a modulus {100.0 * worst:.1f} %"])
