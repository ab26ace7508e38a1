"""Probes seen by two cameras, from rendered pictures to the law, against what was simulated.

Motions are those of ``bench probes``, presses on a finer grid, with all particles: pictures are rendered, tracked and
identified from. Beside each answer stands that to exact tracks of some particles of the same motion.
Then motions of finite elements, pictures as large and as quiet as the paper's, and one disturbance
after another at growing levels.
"""

import re
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.oracles import ORACLES
from form_drake.bench.perception_sweeps import SWEEPS, Level
from form_drake.bench.perception_tables import GOALS, table
from form_drake.bench.perception_views import SHOWN_AS, Views
from form_drake.bench.probes import NAMED, SPECIMENS, planned_cases
from form_drake.bench.probes_grid import SPACINGS, grid_changes
from form_drake.bench.probes_motions import code, errors
from form_drake.identify import Identification, Unidentifiable, identify
from form_drake.material import Material, checked_values
from form_drake.motion import Sampling
from form_drake.records import Recording

PAPER = {  # 1280 x 1280 pixels, 100 frames a second, grey noise 0.5, focal length [px]
    name: (
        "stereo.size=[1280, 1280]",
        "stereo.rate=100",
        "stereo.noise=0.5",
        f"stereo.focus={focus}",
    )
    for name, focus in {"press": 4800, "bend": 3800}.items()
}
FINITE = ("press-a", "bend-touching-a")
SWEPT = ("press_a", "bend_a")
TRUTH = {"press": SPACINGS["press"][-1]}  # [m] of grids: the finest of ``bench probes``
EXACT = 400  # particles of exact tracks
SECONDS = {"press": 500.0, "bend": 240.0}  # of pictures, tracks and answer
TIMES_PAPER = 4.0

__all__ = ["planned", "run_perception", "table"]


def from_pictures(views: Views, name: str, made: tuple[str, ...], level: Level) -> dict[str, Any]:
    """Errors of the answer to what the cameras see."""
    from form_drake.systems.scenario import load_scenario

    true = load_scenario(name, made).specimen.made()
    try:
        seen = views.tracks(name, made, level.look, level.kept)
    except ValueError as refusal:  # of the pictures
        none = dict.fromkeys(("points", "frames", "held", "noise_um", "seconds"), 0)
        return {"errors": {}, "refused": str(refusal), **none}
    return _answered(level.edit(seen), true)[0]


def beside_exact(views: Views, name: str, made: tuple[str, ...]) -> dict[str, Any]:
    """The same, and errors of the answer to exact tracks of the same motion."""
    from form_drake.systems.scenario import load_scenario

    scenario = load_scenario(name, made)
    exact = views.some(name, made, scenario.stereo.rate, EXACT)
    beside = _errors(_identified(exact), scenario.specimen.made())
    true = scenario.specimen.made()
    found, answer = _answered(views.tracks(name, made), true)
    inside = {} if answer is None else _inside(answer, exact)
    return {**found, **inside, "exact": beside}


def from_finite_elements(views: Views, case: str) -> dict[str, Any]:
    """Errors of the answer to pictures of a finite element motion."""
    from form_drake.systems.scenario import load_scenario

    seen, values = views.finite(case)
    law = load_scenario(SHOWN_AS[case.split("-")[0]]).specimen.made().law
    return _answered(seen, Material(law, checked_values(law, values)))[0]


Answered = Identification | str  # or why there is none


def _identified(seen: Recording) -> Answered:
    try:
        return identify(seen, method="weak")
    except (Unidentifiable, ValueError) as refusal:
        return str(refusal)


def _answered(seen: Recording, true: Material) -> tuple[dict[str, Any], Identification | None]:
    """What is told of a case, and the answer if there is one."""
    begun = time.perf_counter()
    answer = _identified(seen)
    facts = {
        "points": seen.points,
        "frames": seen.frames,
        "held": 1.0 if seen.valid is None else float(seen.valid.mean()),
        "noise_um": 1e6 * (seen.noise or 0.0),
        "seconds": time.perf_counter() - begun,
    }
    return {**_errors(answer, true), **facts}, None if isinstance(answer, str) else answer


def _errors(answer: Answered, true: Material) -> dict[str, Any]:
    if isinstance(answer, str):
        return {"errors": {}, "refused": answer}
    passes = answer.details.get("passes_inside")
    return {"errors": errors(answer, true), **({} if passes is None else {"passes": passes})}


def _inside(answer: Identification, exact: Recording) -> dict[str, float]:
    """How far the reconstructed motion is from that of exact tracks throughout the body, root mean square."""
    fit, X = answer.weak.problem.probes[0].fit, exact.reference
    time = exact.time - exact.time[0]
    motion = Sampling.of(fit, time, X, np.ones(len(X)), 1.0).motion(fit.c)
    off, moved = motion.x - exact.p_WQ, exact.p_WQ - X
    return {
        "inside_um": 1e6 * float(np.sqrt(np.mean(np.sum(off**2, axis=2)))),
        "moved_um": 1e6 * float(np.sqrt(np.mean(np.sum(moved**2, axis=2)))),
    }


Cases = dict[str, Callable[[], dict[str, Any]]]


def planned(views: Views, specimens: int) -> tuple[Cases, dict[str, float]]:
    """Cases by name, and how many seconds each is expected to take."""
    cases: Cases = {}
    expected: dict[str, float] = {}

    def add(name: str, probe: str, times: float, run: Callable[..., Any], *given: Any) -> None:
        cases[name] = partial(run, views, *given)
        expected[name] = times * SECONDS[probe]

    for case, (name, made) in planned_cases(specimens).items():
        add(f"stereo/{case}", name.split("_")[0], 1.3, beside_exact, name, (*made, *_true(name)))
    if (ORACLES / "finite_elements.py").is_file():
        for case in FINITE:
            add(f"fe/{case}", case.split("-")[0], 1.5, from_finite_elements, case)
    for name in NAMED:
        probe = name.split("_")[0]
        level = Level(look=PAPER[probe])
        add(f"paper/{name}", probe, TIMES_PAPER, from_pictures, name, _true(name), level)
    for kind, levels in SWEEPS.items():
        for name in SWEPT:
            for value, level in levels.items():
                case = f"sweep/{_plain(kind)}/{value}/{name}"
                add(case, name.split("_")[0], 1.0, from_pictures, name, _true(name), level)
    return cases, expected


def _true(name: str) -> tuple[str, ...]:
    """Changes that simulate a probe on the grid of its truth."""
    probe = name.split("_")[0]
    return grid_changes(name, TRUTH[probe]) if probe in TRUTH else ()


def _plain(kind: str) -> str:
    """A name for files and ``--only``: the first words, without the unit."""
    return re.sub(r" \[.*", "", kind).replace(" ", "-")


def run_perception(
    *, store: Path, only: tuple[str, ...] = (), specimens: int = SPECIMENS
) -> dict[str, Any]:
    """All cases; see the module's text.

    Raises:
        ValueError: ``only`` leaves nothing.
    """
    cases, expected = planned(Views(store.parent / "motions"), specimens)
    mark = fingerprint() + code()[:8]
    found = run_cases(cases, store=store, mark=mark, estimates=expected, only=only)
    return {"bench": "perception", "cases": found, "goals": GOALS}
