"""Motions that a diagnosis advises, as scenarios that the station can run."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from form_drake.material import Material
from form_drake.systems.scenario import holding, scenario_text

CELLS = 10  # of the grid, along the least edge
FOOT = (0.5, 0.0, 0.05)  # of a block, in the middle of the stand [m]
CLEAR = 1e-3  # between plate and block where nothing is pressed [m]
GLUE = 1e-3  # of a block inside a plate that holds it, which is not simulated [m]
STILL = 0.3  # before the plate moves [s]: a specimen settles first
WIDEST = 0.06  # a block, of which the plate presses all [m]
AWAY = -1.0  # a share that stands for CLEAR

Part = tuple[
    float, float, float, float
]  # seconds; shares of the height aside, along y, and pressed


def _pressed(*parts: tuple[float, float]) -> tuple[Part, ...]:
    return tuple((seconds, 0.0, 0.0, share) for seconds, share in parts)


# Motion, as effects name it: seconds that each part takes, and where the plate is then.
MOTIONS: dict[str, tuple[Part, ...]] = {
    "fast press": _pressed((0.15, 0.12), (0.3, AWAY)),
    "press and lift off": _pressed((0.4, 0.15), (0.15, AWAY), (0.2, AWAY)),
    "press, hold and release": _pressed((0.3, 0.15), (0.6, 0.15), (0.2, AWAY), (0.3, AWAY)),
    "press, release and wait": _pressed((0.4, 0.2), (0.2, AWAY), (0.6, AWAY)),
    "presses of two depths": _pressed((0.4, 0.08), (0.3, AWAY), (0.6, 0.2), (0.4, AWAY)),
    "presses of two depths, each with release": _pressed(
        (0.4, 0.08), (0.3, AWAY), (0.6, 0.2), (0.4, AWAY)
    ),
    "presses at speeds ten times apart": _pressed(
        (2.0, 0.15), (0.4, AWAY), (0.13, 0.15), (0.3, AWAY)
    ),
    "a fast reversal": _pressed((0.3, 0.12), (0.1, 0.06), (0.1, 0.12), (0.3, AWAY)),
    "a moment without contact": _pressed((0.3, AWAY)),
    "moments without contact before and after": _pressed((0.4, 0.1), (0.3, AWAY), (0.3, AWAY)),
}
TO_AND_FRO = ((0.1, 1.0), (0.15, -1.0), (0.15, 1.0), (0.15, -1.0), (0.15, 1.0), (0.1, 0.0))
SHAKES: dict[str, tuple[Part, ...]] = {
    "shake": tuple((t, 0.13 * s, 0.0, 0.0) for t, s in TO_AND_FRO),
    "shakes along two directions": (
        *((t, 0.13 * s, 0.0, 0.0) for t, s in TO_AND_FRO),
        *((t, 0.0, 0.13 * s, 0.0) for t, s in TO_AND_FRO),
    ),
}
PUSHES: dict[str, tuple[Part, ...]] = {
    "a push from the side": tuple(
        (t, x, y, 0.0)
        for t, x, y in (
            (0.5, 0.1, 0.0),
            (0.5, -0.1, 0.0),
            (0.3, 0.0, 0.0),
            (0.5, 0.0, 0.1),
            (0.5, 0.0, 0.0),
        )
    ),
}


@dataclass(frozen=True)
class Setup:
    """How the station does some motions.

    Attributes:
        like: scenario that shares arm, cell and measurement.
        motions: as above.
        plate: condition of the face that it touches.
        hangs: whether the block hangs from it; else it stands.
        of_use: conditions of a standing foot with which it is of use.
    """

    like: str
    motions: Mapping[str, tuple[Part, ...]]
    plate: str
    hangs: bool = False
    of_use: tuple[str, ...] = ("bonded", "frictionless")


SETUPS = {  # by name of the file
    "next.yaml": Setup("press_elastic", MOTIONS, "frictionless"),
    "next-shake.yaml": Setup("shake_elastic", SHAKES, "bonded", hangs=True),
    "next-push.yaml": Setup("press_elastic", PUSHES, "bonded", of_use=("bonded",)),
}


def advised(
    motions: Iterable[str], low: np.ndarray, high: np.ndarray, held: str, material: Material
) -> dict[str, str]:
    """Scenarios in which the arm does some motions with a block, one after the other: of a plate that presses it,
    of one that it hangs from and is shaken by, and of one that pushes its top aside.

    Args:
        motions: as effects name them; those that the station cannot do are left out.
        low: least corner of the block, free of stress [m].
        high: its greatest corner [m]; z is upwards.
        held: what is known of its foot; the station has it ``bonded`` or ``frictionless``.
        material: of the block; effects are left out.

    Returns:
        What ``form-drake simulate`` takes, by name of the file; none that the station cannot do.
    """
    size, wanted = np.asarray(high) - np.asarray(low), list(dict.fromkeys(motions))
    found = {}
    for name, setup in SETUPS.items():
        done = [motion for motion in wanted if motion in setup.motions]
        if not done or held not in setup.of_use or max(size[:2]) > WIDEST:
            continue
        every = dict.fromkeys(setup.motions[motion] for motion in done)
        parts = [p for one in every if not _begins(one, every) for p in one]
        bonded = setup.plate == "bonded"
        changes = (
            f"name={name.removesuffix('.yaml')}",
            *holding(replace(material, effects=())),
            *_block(size, "free" if setup.hangs else held, bonded=bonded),
            f"probe.waypoints={_waypoints(parts, size[2], bonded=bonded)}",
        )
        found[name] = f"# {'; '.join(done)}\n{scenario_text(setup.like, changes)}"
    return found


def _begins(one: tuple[Part, ...], every: Iterable[tuple[Part, ...]]) -> bool:
    """Whether another motion goes on where this one ends, so that it need not be done apart."""
    return any(other != one and other[: len(one)] == one for other in every)


def _block(size: np.ndarray, foot: str, *, bonded: bool) -> tuple[str, ...]:
    """Changes that hold a block between plate and stand, or let it hang; of the grid, too."""
    glue, plate = (GLUE, "bonded") if bonded else (0.0, "frictionless")
    middle = np.add(FOOT, [0.0, 0.0, 0.5 * (size[2] + glue)])
    stands = "free" if foot == "free" else f"{foot} specimen_stand"
    faces = {"z-": stands, "z+": f"{plate} press_plate", "other": "free"}
    contact: dict[str, str | float] = {"press_plate": "bonded" if bonded else 0.0}
    if foot != "free":
        sticks = "bonded" if bonded else "stick"  # pushed aside, it would tip
        contact["specimen_stand"] = sticks if foot == "bonded" else 0.0
    return (
        "specimen.known=[]",
        f"specimen.size={_numbers([*size[:2], size[2] + glue])}",
        f"specimen.p_WM={_numbers(middle)}",
        f"specimen.clamped={json.dumps({'z+': glue} if bonded else {})}",
        f"specimen.faces={json.dumps(faces)}",
        f"specimen.contact={json.dumps(contact)}",
        f"solver.dx={float(size.min()) / CELLS:.4g}",
        f"solver.room={_numbers([*(0.4 * size[:2]), 0.2 * size[2] if bonded else 4.0 * CLEAR])}",
        "probe.unseen=[]",
    )


def _waypoints(parts: Iterable[Part], height: float, *, bonded: bool) -> str:
    """Of the plate's face: it is at rest first, and at the end of every part."""
    start = 0.0 if bonded else AWAY
    found, end = [], 0.0
    for seconds, x, y, share in ((0.0, 0.0, 0.0, start), (STILL, 0.0, 0.0, start), *parts):
        end += seconds
        way = -CLEAR if share == AWAY else share * height
        p_WT = [FOOT[0] + x * height, FOOT[1] + y * height, FOOT[2] + height - way]
        found.append({"time": round(end, 3), "p_WT": _numbers(p_WT)})
    return json.dumps(found)


def _numbers(values: Iterable[float]) -> list[float]:
    return [round(float(v), 6) for v in values]
