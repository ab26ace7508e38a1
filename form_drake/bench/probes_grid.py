"""Probes on three grids: whether what is identified, and the force, still depend on the spacing."""

from typing import Any

import numpy as np

from form_drake.bench.probes_motions import Motions, errors
from form_drake.identify import identify
from form_drake.records import Recording

SPACINGS = {  # [m]; the first is the scenario's own, specimens are whole numbers of half of each
    "press": (2.5e-3, 2.0e-3, 5e-3 / 3.0),
    "bend": (2.0e-3, 4e-3 / 3.0, 1.0e-3),
}
DEEPEST = 1e-5  # [m] from the largest stroke, within which the force is averaged


def grid_changes(name: str, dx: float) -> tuple[str, ...]:
    """Changes of a scenario that put it on another grid; where the grid lies follows the specimen."""
    from form_drake.systems.scenario import load_scenario

    own = np.isclose(dx, load_scenario(name).solver.dx)
    return () if own else (f"solver.dx={dx!r}",)


def deepest(recording: Recording) -> tuple[float, float]:
    """Force at the largest stroke, and the height of the tool frame there.

    Returns:
        [N] and [m], means over the time in which the stroke is the largest.
    """
    ((tool, force),) = recording.forces.items()
    size = np.linalg.norm(force.value, axis=1)
    push = -force.value[np.argmax(size)] / size.max()
    pose = recording.poses[tool]
    p_WT = [np.interp(force.time, pose.time, pose.value[:, i, 3]) for i in range(3)]
    stroke = push @ p_WT
    at = stroke > stroke.max() - DEEPEST
    return float(size[at].mean()), float(p_WT[2][at].mean())


def on_grid(motions: Motions, name: str, dx: float) -> dict[str, Any]:
    """Errors of the answer to exact tracks from a grid of spacing ``dx`` [m], and the force [N].

    Of a pressed block that yields the closed form sqrt(3/2) tau_y V / H [N] stands beside. A
    refusal to identify is told in the place of the errors.
    """
    from form_drake.systems.scenario import load_scenario

    made = grid_changes(name, dx)
    recording, specimen = motions.recording(name, made), load_scenario(name, made).specimen
    true = specimen.made()
    force, height = deepest(recording)
    found: dict[str, Any] = {"dx": dx, "force": force, "errors": {}}
    try:
        found["errors"] = errors(identify(recording, method="weak"), true)
    except ValueError as refusal:
        found["refused"] = str(refusal)
    if "tau_y" in true.values:
        opening = height - (specimen.p_WM[2] - 0.5 * specimen.size[2])
        volume = float(np.prod(specimen.size))
        found["closed_form"] = np.sqrt(1.5) * true.values["tau_y"] * volume / opening
    return found
