"""Motions that a diagnosis advises, as a scenario that the station can run."""

import json
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from form_drake.material import Material
from form_drake.systems.scenario import holding, scenario_text

LIKE = "press_elastic"  # what the scenario shares arm, cell and measurement with
CELLS = 10  # of the grid, along the least edge
FOOT = (0.5, 0.0, 0.05)  # of a block, in the middle of the stand [m]
CLEAR = 1e-3  # between plate and block where nothing is pressed [m]
STILL = 0.3  # before the plate moves [s]: a specimen settles first
WIDEST = 0.06  # a block, of which the plate presses all [m]
AWAY = -1.0  # a share that stands for CLEAR

# Motion, as effects name it: seconds that each part takes, and the share of the height that is pressed then.
MOTIONS: dict[str, tuple[tuple[float, float], ...]] = {
    "fast press": ((0.15, 0.12), (0.3, AWAY)),
    "press and lift off": ((0.4, 0.15), (0.15, AWAY)),
    "press, hold and release": ((0.3, 0.15), (0.6, 0.15), (0.2, AWAY), (0.3, AWAY)),
    "press, release and wait": ((0.4, 0.2), (0.2, AWAY), (0.6, AWAY)),
    "presses of two depths": ((0.4, 0.08), (0.3, AWAY), (0.6, 0.2), (0.4, AWAY)),
    "presses of two depths, each with release": ((0.4, 0.08), (0.3, AWAY), (0.6, 0.2), (0.4, AWAY)),
    "presses at speeds ten times apart": ((1.5, 0.15), (0.4, AWAY), (0.15, 0.15), (0.3, AWAY)),
    "a fast reversal": ((0.3, 0.12), (0.1, 0.06), (0.1, 0.12), (0.3, AWAY)),
    "a moment without contact": ((0.3, AWAY),),
    "moments without contact before and after": ((0.3, AWAY),),
}


def advised(
    motions: Iterable[str], low: np.ndarray, high: np.ndarray, held: str, material: Material
) -> str:
    """YAML of a scenario in which a plate presses a block as some motions have it, one after the other.

    Args:
        motions: as effects name them; those that the station cannot do are left out.
        low: least corner of the block, free of stress [m].
        high: its greatest corner [m]; z is upwards.
        held: what is known of its foot; the station has it ``bonded`` or ``frictionless``.
        material: of the block; effects are left out.

    Returns:
        What ``form-drake simulate`` takes; "": the station can do none of them, or not with this block.
    """
    done = [motion for motion in dict.fromkeys(motions) if motion in MOTIONS]
    parts = [part for parts in dict.fromkeys(MOTIONS[m] for m in done) for part in parts]
    size = np.asarray(high) - np.asarray(low)
    if not parts or held not in ("bonded", "frictionless") or max(size[:2]) > WIDEST:
        return ""
    middle = np.add(FOOT, [0.0, 0.0, 0.5 * size[2]])
    room = [*(0.4 * size[:2]), 4.0 * CLEAR]
    changes = (
        "name=next",
        *holding(replace(material, effects=())),
        "specimen.known=[]",
        f"specimen.size={_numbers(size)}",
        f"specimen.p_WM={_numbers(middle)}",
        f"specimen.faces.z-={held} specimen_stand",
        f"specimen.contact.specimen_stand={'stick' if held == 'bonded' else 0.0}",
        f"solver.dx={float(size.min()) / CELLS:.4g}",
        f"solver.room={_numbers(room)}",
        f"probe.waypoints={_waypoints(parts, size[2])}",
        "probe.unseen=[]",
    )
    return f"# {'; '.join(done)}\n{scenario_text(LIKE, changes)}"


def _waypoints(parts: Iterable[tuple[float, float]], height: float) -> str:
    """Of the plate's face: it is at rest first, and at the end of every part."""
    found, end = [], 0.0
    for seconds, share in ((0.0, AWAY), (STILL, AWAY), *parts):
        end += seconds
        way = -CLEAR if share == AWAY else share * height
        p_WT = [*FOOT[:2], round(float(FOOT[2] + height - way), 6)]
        found.append({"time": round(end, 3), "p_WT": p_WT})
    return json.dumps(found)


def _numbers(values: Iterable[float]) -> str:
    return str([round(float(v), 6) for v in values])
