"""Sizes of hidden effects beside those that were found, in the units of the catalogue.

The independent code has units of its own: each row below is one of its effects as the catalogue has it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from form_drake.diagnose.score import DETECTED, RADIUS, named_from
from form_drake.diagnose.verdict import LEAST
from form_drake.effects import CATALOGUE

Truth = Mapping[str, Any]
Size = Callable[[Mapping[str, Any], Truth], float | None]
ROUGH = (
    "tool-friction",
    "floor-slip",
    "added-mass",
    "inclusion",
)  # a fifth is wanted, else a twentieth
UNLIKE = ("yield", "hardening")  # their coefficients are no measure of how strong they are
LINEAR = 5.0  # times the predicted limit, up to which a score grows as the square of a size
CLOSE = 1.5  # factor within which a limit is predicted well
COVERED = 1.645  # standard deviations of a 90 % interval


def _of(key: str) -> Size:
    return lambda told, body: float(told[key])


def _slip(told: Mapping[str, Any], body: Truth) -> float | None:
    return 1.0 / told["shear"] if "shear" in told else None


def _rate(told: Mapping[str, Any], body: Truth) -> float:
    """Its rate is |D|, that of the catalogue sqrt(2) |D|."""
    return float(told["eta_n"] * 2.0 ** (0.5 * (1.0 - told["n"])))


def _yielding(told: Mapping[str, Any], body: Truth) -> float:
    """The strain |dev e| at which |s| = tau_y."""
    return float(told["tau_y"] * (1.0 + body["nu"]) / body["E"])


SIZES: dict[str, Size] = {
    "damping": _of("eta"),
    "relaxation": _of("g"),
    "yield": _yielding,
    "hardening": _yielding,
    "stiffening": _of("C2"),
    "rate-dependence": _rate,
    "anisotropy": _of("k_f"),
    "inclusion": lambda told, body: (told["factor"] - 1.0) * told["radius"] ** 3,
    "eigenstrain": _of("swelling"),
    "gravity-tilt": _of("angle"),
    "density": _of("excess"),
    "added-mass": _of("mass"),
    "drag": _of("c"),
    "tool-friction": _of("friction"),
    "adhesion": _of("strength"),
    "floor-slip": _slip,
    "force-gain": _of("gain"),
    "force-bias": _of("bias"),
    "force-drift": _of("rate"),
    "force-delay": _of("delay"),
    "camera-scale": _of("scale"),
    "camera-pose": _of("angle"),
}


def found(named: Mapping[str, Any]) -> tuple[float, float]:
    """Size of what was named, and its standard deviation; signs of directed effects are their direction's."""
    size, where = named["coefficient"], named["where"]
    std = np.nan if named["std"] is None else named["std"]
    if named["name"] in ("yield", "hardening"):
        return where["strain"], named.get("spread", {}).get("strain", np.nan)
    if named["name"] == "inclusion":
        return size * where["radius"] ** 3, np.nan
    return (abs(size) if {"azimuth", "elevation"} & set(where) else size), std


def compared(results: Sequence[Mapping[str, Any]], truth: Mapping[str, Truth]) -> dict[str, Any]:
    """Errors of sizes of strong singles that were named by their own name, by effect.

    ``errors`` are relative; ``untold`` are effects whose standard deviation is none or as large as they
    are. Of the others ``within`` counts truths within the 90 % interval, and ``pull`` is the root mean
    square of errors by standard deviations; ``centres`` are distances of inclusions from where they are
    [m], ``stiff`` those of stiff ones.
    """
    errors: dict[str, list[float]] = {}
    centres, stiff, pulls, untold = list[float](), list[float](), list[float](), list[str]()
    for one in results:
        told = truth[one["id"]]
        named = one.get("effects") or []
        if _anew(one, told):
            continue
        if told["kind"] != "single" or not named or named[0]["name"] not in told["effects"]:
            continue
        if one["verdict"] not in ("named", "ambiguous"):
            continue
        name = named[0]["name"]
        own = told["effects"][name]
        wanted, (size, std) = SIZES[name](own, told["body"]), found(named[0])
        if wanted is None:
            continue
        errors.setdefault(name, []).append(size / wanted - 1.0)
        if name == "inclusion":
            place = np.array([named[0]["where"][k] for k in "xyz"])
            centres.append(float(np.linalg.norm(place - own["centre"])))
            stiff += centres[-1:] if own["factor"] > 1.0 else []
        if named[0]["std"] is None or std >= abs(size):
            untold.append(name)
        elif np.isfinite(std):
            pulls.append((size - wanted) / std)
    return {
        "errors": errors,
        "within": int(np.sum(np.abs(pulls) <= COVERED)),
        "of": len(pulls),
        "pull": float(np.sqrt(np.mean(np.square(pulls)))) if pulls else None,
        "centres": centres,
        "stiff": stiff,
        "untold": sorted(untold),
        **_medians(errors),
    }


def limits(results: Sequence[Mapping[str, Any]], truth: Mapping[str, Truth]) -> dict[str, Any]:
    """Least sizes that are named beside those that were predicted, of single effects that are faint.

    A score, and what it lost for the number of shapes, grow as the square of a size: the size at which
    half of such cases would exceed the threshold is that of the case times the root of threshold over
    score, with this. ``ratios`` are medians of observed over predicted, by effect, each over so many ``cases``; none: most
    are not seen at all.
    """
    found: dict[str, list[float]] = {}
    for one in results:
        told, (name, *others) = truth[one["id"]], [*truth[one["id"]]["effects"], ""]
        predicted = one.get("limits", {}).get(name)
        if _anew(one, told):
            continue
        if told["kind"] not in ("single", "near") or others != [""] or name in UNLIKE:
            continue
        size = SIZES[name](told["effects"][name], told["body"])
        if predicted is None or size is None:
            continue
        effect = CATALOGUE[name]
        least = predicted * named_from(effect, LEAST) / DETECTED
        if name == "inclusion":
            least *= (RADIUS * min(told["body"]["size"])) ** 3
        if abs(size) < LINEAR * least:
            score = first_scores(one).get(name, 0.0)
            share = named_from(effect, LEAST) / named_from(effect, score) if score else np.inf
            least_seen = size * share
            found.setdefault(name, []).append(float(abs(least_seen) / least))
    ratios = {name: float(np.median(values)) for name, values in sorted(found.items())}
    close = sum(1.0 / CLOSE <= r <= CLOSE for r in ratios.values())
    told = {name: r if np.isfinite(r) else None for name, r in ratios.items()}
    counts = {name: len(found[name]) for name in ratios}
    return {"ratios": told, "cases": counts, "close": close, "of": len(ratios)}


def first_scores(one: Mapping[str, Any]) -> Mapping[str, float]:
    """Scores beside the bare twin; earlier verdicts hold those of their first pass, of what did not go again."""
    told: Mapping[str, float] = one.get("scores") or one["passes"][0]["scores"]
    return told


def _anew(one: Mapping[str, Any], told: Truth) -> bool:
    """Whether a case was made with other coefficients than the key holds; earlier verdicts do not tell."""
    return bool(one.get("draw", told.get("draw", 0)) != told.get("draw", 0))


def _medians(errors: Mapping[str, Sequence[float]]) -> dict[str, float | None]:
    groups = {"rough": [], "fine": []}  # type: dict[str, list[float]]
    for name, values in errors.items():
        groups["rough" if name in ROUGH else "fine"] += np.abs(values).tolist()
    return {k: float(np.median(v)) if v else None for k, v in groups.items()}
