"""Probes in the station: what they identify, against what was simulated.

Four named scenarios and ten specimens drawn by seeds 0 to 9, none left out. Each motion is simulated
once by the arm in its station and kept; noise is added to it afterwards. Beside the answer stands the
one with the twin: the same probe simulated again at the identified values and read the same way.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import PACKAGE, fingerprint, run_cases
from form_drake.identify import Identification, Unidentifiable, identify
from form_drake.material import Material
from form_drake.records import Recording, Stream, read, write_recording

NAMED = ("press_a", "press_b", "bend_a", "bend_b")
SPECIMENS = 10
SEEDS = 20
NOISE = 20e-6  # of tracked points [m]
FORCE_NOISE = 0.01  # of the largest force
STIFFNESS, STRENGTH, POISSON = (20e3, 300e3), (0.01, 0.15), (0.30, 0.45)
OWN_WEIGHT = 3.0  # least uniaxial yield stress over rho g H
NORMAL_90 = 1.645
SECONDS = {"press": 60.0, "bend": 150.0}  # of one simulation
READING = {"press": 8.0, "bend": 12.0}  # of one identification
GOALS = {"median": 0.5, "worst": 1.0}


def specimen(seed: int) -> dict[str, float]:
    """E, nu and tau_y of a specimen that bears its own weight.

    E is log-uniform from 20 to 300 kPa, tau_y / E log-uniform from 0.01 to 0.15, nu uniform from
    0.30 to 0.45, drawn again until sqrt(3/2) tau_y is at least 3 rho g H of the pressed block.
    """
    rng = np.random.default_rng(seed)
    weight = 1000.0 * 9.81 * 0.025
    while True:
        E, share = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (STIFFNESS, STRENGTH))
        nu = float(rng.uniform(*POISSON))
        if np.sqrt(1.5) * share * E >= OWN_WEIGHT * weight:
            return {"E": E, "nu": nu, "tau_y": share * E}


def changes(probe: str, seed: int) -> tuple[str, ...]:
    """Changes of ``press_b`` or ``bend_a`` that put a specimen in."""
    values = specimen(seed)
    keys = ("E", "nu", "tau_y") if probe == "press" else ("E", "nu")
    return tuple(f"specimen.material.{k}={values[k]}" for k in keys)


def planned_cases(specimens: int) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Scenario and changes by name of the case."""
    cases: dict[str, tuple[str, tuple[str, ...]]] = {name: (name, ()) for name in NAMED}
    for seed in range(specimens):
        cases[f"press-{seed}"] = ("press_b", changes("press", seed))
    for seed in range(specimens):
        cases[f"bend-{seed}"] = ("bend_a", changes("bend", seed))
    return cases


class Motions:
    """Simulated probes, kept in a folder from one run of the bench to the next."""

    def __init__(self, folder: Path):
        self._folder = folder

    def recording(self, scenario: str, made: tuple[str, ...], *, unseen: bool = False) -> Recording:
        """The probe, or the unseen motion, without noise; simulated if it is not there yet."""
        from form_drake.systems.probe import prepare, record
        from form_drake.systems.scenario import held_out, load_scenario, scenario_text

        text = scenario_text(scenario, made) + ("unseen" if unseen else "")
        mark = hashlib.sha256((text + _code()).encode()).hexdigest()[:16]
        path = self._folder / f"{mark}.h5"
        if not path.is_file():
            chosen = load_scenario(scenario, made)
            write_recording(record(prepare(held_out(chosen) if unseen else chosen)), path)
        return read(path).measured_by("sensor")


def _code() -> str:
    """Digest of what a simulated motion depends on."""
    digest = hashlib.sha256()
    for room in ("mpm", "laws", "systems", "models"):
        for path in sorted((PACKAGE / room).resolve().rglob("*")):
            if path.suffix in (".py", ".yaml", ".sdf", ".urdf"):
                digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def noisy(recording: Recording, seed: int) -> Recording:
    """With 20 um on every coordinate and 1 % of the largest force on the force."""
    rng = np.random.default_rng((seed, 1))
    p_WQ = recording.p_WQ + rng.normal(0.0, NOISE, recording.p_WQ.shape)
    forces = {}
    for name, stream in recording.forces.items():
        sd = FORCE_NOISE * float(np.linalg.norm(stream.value, axis=1).max())
        forces[name] = Stream(stream.time, stream.value + rng.normal(0.0, sd, stream.value.shape))
    return replace(recording, p_WQ=p_WQ, forces=forces)


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


def without_noise(
    motions: Motions, name: str, made: tuple[str, ...], with_twin: bool
) -> dict[str, Any]:
    """The answer to exact tracks, with or without the twin."""
    from form_drake.systems.replay import twin
    from form_drake.systems.scenario import load_scenario

    recording, scenario = motions.recording(name, made), load_scenario(name, made)
    true = scenario.specimen.made()

    again = twin(scenario, recording) if with_twin else None
    answer = identify(recording, method="weak", twin=again)
    return {
        "errors": errors(answer, true),
        "rows": answer.rows,
        "condition": answer.condition,
        "seconds": answer.seconds,
    }


def with_noise(motions: Motions, name: str, made: tuple[str, ...], seeds: int) -> dict[str, Any]:
    """Median size of the error and coverage of the 90 % intervals over noise seeds."""
    from form_drake.systems.scenario import load_scenario

    recording, true = motions.recording(name, made), load_scenario(name, made).specimen.made()
    found: list[dict[str, dict[str, float]]] = []
    refused = 0
    for seed in range(seeds):
        try:
            found.append(errors(identify(noisy(recording, seed), method="weak"), true))
        except Unidentifiable:
            refused += 1
    sizes = {k: np.abs([f[k]["error"] for f in found]) for k in (found[0] if found else ())}
    return {
        "median": {k: float(np.median(e)) for k, e in sizes.items()},
        "p90": {k: float(np.quantile(e, 0.9)) for k, e in sizes.items()},
        "worst": {k: float(e.max()) for k, e in sizes.items()},
        "coverage_90": {
            k: float(np.mean([abs(f[k]["error"]) <= NORMAL_90 * f[k]["std"] for f in found]))
            for k in sizes
        },
        "errors": {k: [f[k]["error"] for f in found] for k in sizes},
        "refused": refused,
        "seeds": seeds,
    }


def unseen(motions: Motions, name: str, made: tuple[str, ...]) -> dict[str, Any]:
    """Errors of a motion that was not used, predicted with the answer to exact tracks."""
    from form_drake.systems.replay import replay
    from form_drake.systems.scenario import load_scenario

    material = identify(motions.recording(name, made), method="weak").material
    measured = motions.recording(name, made, unseen=True)
    found = replay(load_scenario(name, made), material, measured)
    return {
        "shape_rms_mm": 1e3 * found.shape_rms,
        "force_rms": 100.0 * found.force_rms,
        "peak_error": 100.0 * found.peak_error,
    }


def run_probes(
    *, store: Path, only: tuple[str, ...] = (), seeds: int = SEEDS, specimens: int = SPECIMENS
) -> dict[str, Any]:
    """All cases; see the module's text.

    Raises:
        ValueError: no seed is wanted, or ``only`` leaves nothing.
    """
    if seeds < 1:
        raise ValueError(f"--seeds {seeds}: one or more are wanted")
    motions = Motions(store.parent / "motions")
    cases: dict[str, Callable[[], dict[str, Any]]] = {}
    estimates: dict[str, float] = {}
    for name, (scenario, made) in planned_cases(specimens).items():
        probe = scenario.split("_")[0]
        for kind, twice in (("exact", False), ("twin", True)):
            cases[f"{kind}/{name}"] = partial(without_noise, motions, scenario, made, twice)
            estimates[f"{kind}/{name}"] = SECONDS[probe] * (1 + 2 * twice) + READING[probe] * (
                1 + 2 * twice
            )
        cases[f"noise/{name}/seeds{seeds}"] = partial(with_noise, motions, scenario, made, seeds)
        estimates[f"noise/{name}/seeds{seeds}"] = READING[probe] * seeds
    for name in NAMED:
        cases[f"unseen/{name}"] = partial(unseen, motions, name, ())
        estimates[f"unseen/{name}"] = 2.0 * SECONDS[name.split("_")[0]]
    mark = fingerprint() + _code()[:8]
    found = run_cases(cases, store=store, mark=mark, estimates=estimates, only=only)
    return {"bench": "probes", "cases": found, "goals": GOALS}


# --- as a table ---------------------------------------------------------------------------------
def table(result: dict[str, Any]) -> str:
    """The result as plain tables, one for each kind of case that was run."""
    titles = {
        "exact": "exact tracks: error [%]",
        "twin": "exact tracks, with the twin: error [%]",
        "unseen": "a motion that was not used: shape [mm rms], force [% of its peak, rms], peak force [%]",
        "noise": "20 um and 1 % of the largest force: median, 90th percentile, worst size of the"
        " error [%], coverage of the 90 % intervals",
    }
    blocks = []
    for kind, title in titles.items():
        own = {n.split("/")[1]: r for n, r in result["cases"].items() if n.split("/")[0] == kind}
        if own:
            lines = {"noise": _noisy_lines, "unseen": _unseen_lines}.get(kind, _exact_lines)
            blocks.append("\n".join([title, *lines(own)]))
    return "\n\n".join(blocks)


def _exact_lines(own: dict[str, Any]) -> list[str]:
    lines = []
    for name, r in own.items():
        cells = "  ".join(
            f"{k} {e['error']:+.3f} ± {1.96 * e['std']:.3f}" for k, e in r["errors"].items()
        )
        lines.append(
            f"{name:10}{r['rows']:>6}{r['condition']:>8.1f}{r['seconds']:>7.1f} s  {cells}"
        )
    for group in ("press", "bend"):
        drawn = [r["errors"] for n, r in own.items() if n.startswith(f"{group}-")]
        for key in drawn[0] if drawn else ():
            sizes = [abs(e[key]["error"]) for e in drawn]
            lines.append(
                f"{group} {key}, {len(sizes)} specimens: median {np.median(sizes):.2f}, worst"
                f" {max(sizes):.2f}"
            )
    return lines


def _noisy_lines(own: dict[str, Any]) -> list[str]:
    return [
        f"{name:10}{key:>7}{r['median'][key]:>8.2f}{r['p90'][key]:>8.2f}{r['worst'][key]:>8.2f}"
        f"{r['coverage_90'][key]:>7.0%}{r['refused']:>4} refused of {r['seeds']}"
        for name, r in own.items()
        for key in r["median"]
    ]


def _unseen_lines(own: dict[str, Any]) -> list[str]:
    return [
        f"{name:10}{r['shape_rms_mm']:>8.3f}{r['force_rms']:>8.2f}{r['peak_error']:>+8.2f}"
        for name, r in own.items()
    ]
