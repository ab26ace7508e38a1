"""What recordings and their readers state of a material, and whether it fits together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from form_drake.laws import LAWS, Law, law_named
from form_drake.laws.values import LAME, checked_values, finite, has_lame
from form_drake.records import Recording


def declared_law(recording: Recording, name: str | None) -> Law:
    """The named law, or the one that the recording declares.

    Raises:
        ValueError: neither is there, or there is no such law.
    """
    name = name or recording.law
    if name is None:
        raise ValueError(f"the recording declares no law: choose --law from {', '.join(LAWS)}")
    return law_named(name)


def declared_values(recording: Recording, law: Law) -> dict[str, float]:
    """Values that the recording declares as known, for a law that has them all.

    Raises:
        ValueError: the law lacks one of them.
    """
    found = {k: v for k, v in recording.known.items() if k != "density"}
    strange = [k for k in found if k not in law.keys]
    if strange:
        raise ValueError(
            f"the recording declares {', '.join(strange)} as known, which {law.name} does not hold as"
            f" a parameter: its parameters are {', '.join(law.keys)}"
        )
    return found


def numbered(recordings: Sequence[Recording]) -> list[tuple[str, Recording]]:
    """Recordings beside the names by which refusals tell of them."""
    return [(f"recording {n}", one) for n, one in enumerate(recordings, start=1)]


def of_one_material(recordings: Sequence[Recording], law: str | None) -> None:
    """Refuse recordings that declare different materials.

    Args:
        recordings: of probes.
        law: name of the law that is given in place of the declared ones; None: none is.

    Raises:
        ValueError: saying what differs.
    """
    told: dict[str, list[float | str | None]] = {
        f"known {k}": [r.known.get(k) for r in recordings] for r in recordings for k in r.known
    }
    told["density"] = [r.density for r in recordings]
    if law is None:
        told["law"] = [r.law for r in recordings]
    for name, values in told.items():
        stated = list(dict.fromkeys(v for v in values if v is not None))
        if len(stated) > 1:
            raise ValueError(
                f"{name}: the recordings declare {' and '.join(map(str, stated))}; probes of one material"
                " are wanted"
            )


def require_distinct(recordings: Sequence[tuple[str, Recording]]) -> None:
    """Refuse one motion given twice.

    Args:
        recordings: each beside its name.

    Raises:
        ValueError: naming both.
    """
    for (earlier, seen), (name, other) in combinations(recordings, 2):
        if _same_motion(seen, other):
            raise ValueError(
                f"{name}: the same motion as {earlier}, or a part of it: give each motion once"
            )


def _same_motion(one: Recording, other: Recording) -> bool:
    """Whether two recordings are the same, or most that the shorter shows was cut from the other."""
    if np.array_equal(one.p_WQ, other.p_WQ, equal_nan=True):
        return True
    seen, shown = ({frame.tobytes() for frame in r.p_WQ} for r in (one, other))
    return len(seen & shown) > max(1.0, 0.5 * min(len(seen), len(shown)))  # one frame is no motion


def refuse_flags(flags: Mapping[str, bool], reason: str) -> None:
    """Refuse options that are given where nothing reads them, which ``reason`` says.

    Raises:
        ValueError: some are on.
    """
    found = [f"--{k.replace('_', '-')}" for k, on in flags.items() if on]
    if found:
        raise ValueError(f"{', '.join(found)} applies to {reason}")


def weak_known(
    recordings: Sequence[Recording], law: Law, known: Mapping[str, Any]
) -> dict[str, float]:
    """Given values of the weak form; nu may stand alone."""
    given: dict[str, float] = {}
    stated = dict(known)
    for recording in recordings:
        declared = dict(recording.known)
        if "nu" in declared and has_lame(law):
            stated = {"nu": declared.pop("nu"), **stated}
        given |= declared_values(replace(recording, known=declared), law)
    if "nu" in stated and "E" not in stated and has_lame(law):
        nu = finite("nu", stated.pop("nu"))
        if not -1.0 < nu < 0.5:
            raise ValueError(f"nu: must lie between -1 and 0.5, got {nu}")
        given["nu"] = nu
    given |= checked_values(law, stated)
    both = [k for k in LAME if "nu" in given and k in given]
    if both:
        raise ValueError(
            f"nu and {both[0]} are both known, from which the other Lame parameter follows: state"
            f" {' and '.join(LAME)} alone, or nu alone"
        )
    return given
