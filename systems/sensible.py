"""Numbers and names of a scenario that no station can have, and what nobody would read."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from form_drake.effects import Effect
from form_drake.effects.acting import known, placed
from form_drake.files import about
from form_drake.laws import Law, law_named
from form_drake.laws.values import ENGINEERING, has_lame
from form_drake.motion.body import CONDITIONS, FACES

if TYPE_CHECKING:
    from form_drake.systems.scenario import Scenario, Specimen


def parameters(law: Law) -> tuple[str, ...]:
    """What can be stated, and be known, of a material of a law."""
    return (*law.keys, *(ENGINEERING if has_lame(law) else ()), "density")


def sensible(scenario: "Scenario", effects: Mapping[str, Effect]) -> None:
    """Refuse numbers that no station can have, and effects that are not among ``effects``."""
    specimen, solver, measure = scenario.specimen, scenario.solver, scenario.measure
    name = scenario.name
    if Path(name).name != name or name in ("", ".."):
        raise ValueError(f"name: that of a folder in runs is wanted, got {name!r}")
    triples = {
        "specimen.size": specimen.size,
        "specimen.p_WM": specimen.p_WM,
        "solver.room": solver.room,
        "probe.rpy_deg": scenario.probe.rpy_deg,
    }
    for name, values in triples.items():
        if len(values) != 3 or not all(math.isfinite(v) for v in values):
            raise ValueError(f"{name}: three numbers are wanted, got {values}")
    positive = {
        "specimen.size": min(specimen.size),
        "solver.dx": solver.dx,
        "solver.period": solver.period,
        "solver.mass_scale": solver.mass_scale,
        "measure.rate": measure.rate,
    }
    for name, value in positive.items():
        if not 0.0 < value < math.inf:
            raise ValueError(f"{name}: a positive number is wanted, got {value}")
    positive_or_zero = {
        **{f"specimen.clamped.{face}": length for face, length in specimen.clamped.items()},
        "solver.damping": solver.damping,
        "solver.settle": solver.settle,
        "solver.room": min(solver.room),
        "measure.points": measure.points,
        "measure.noise": measure.noise,
        "measure.place": measure.place,
        "measure.seed": measure.seed,
        "measure.sensor.seed": measure.sensor.seed,
        "measure.torque.seed": measure.torque.seed,
        "stereo.seed": scenario.stereo.seed,
    }
    for name, value in positive_or_zero.items():
        if not 0 <= value < math.inf:
            raise ValueError(f"{name}: must not be negative, got {value}")
    _declared(specimen)
    with about("specimen.effects"):
        _acting(specimen, effects)
    # read from a file, parts are changed after they were made
    checked = {
        "panda": scenario.panda,
        "measure.sensor": measure.sensor,
        "measure.torque": measure.torque,
        "stereo": scenario.stereo,
    }
    for name, part in checked.items():
        with about(name):
            part.__post_init__()
    if measure.rate * solver.period > 1.0 + 1e-6:
        raise ValueError(
            f"measure.rate: {measure.rate:g} Hz is more often than the material steps, every"
            f" {solver.period:g} s (solver.period)"
        )
    for name in ("sensor", "torque"):
        if (period := getattr(measure, name).period) > solver.period * (1.0 + 1e-9):
            raise ValueError(
                f"measure.{name}.period: {period:g} s is longer than solver.period, {solver.period:g} s, in which"
                " forces are recorded: they would be recorded twice, and their noise with them"
            )
    for name, camera in scenario.cameras.items():
        if not (camera.rgb or camera.depth):
            raise ValueError(f"cameras.{name}: neither rgb nor depth is wanted of it")


def _acting(specimen: "Specimen", effects: Mapping[str, Effect]) -> None:
    """Refuse effects that no file can state, and those outside of the body."""
    for one in specimen.effects:
        if not one.id or math.isnan(one.coefficient):
            lacks = "coefficient" if one.id else "id"
            raise ValueError(
                f"an entry has no {lacks}: id and coefficient are wanted, such as"
                f" {{id: {one.id or 'tool-friction'}, coefficient: 0.03}}"
            )
    acting = known(specimen.effects, law_named(specimen.law), effects)
    middle, half = np.array(specimen.p_WM), 0.5 * np.array(specimen.size)
    placed(acting, middle - half, middle + half)


def _declared(specimen: "Specimen") -> None:
    """Refuse what nobody would read of a specimen's faces and known parameters."""
    for name, words in specimen.faces.items():
        if name not in (*FACES, "other"):
            raise ValueError(
                f"specimen.faces: no face {name!r}; allowed are {', '.join(FACES)} and other"
            )
        told = words.split()
        if not 1 <= len(told) <= 2 or told[0] not in CONDITIONS:
            raise ValueError(
                f"specimen.faces.{name}: {words!r}; allowed are {', '.join(CONDITIONS)}, the last three"
                " followed by the name of a tool or support"
            )
    allowed = parameters(law_named(specimen.law))
    for name in specimen.known:
        if name not in allowed:
            raise ValueError(
                f"specimen.known: {specimen.law} has no parameter {name!r}: choose from"
                f" {', '.join(allowed)}"
            )
