"""What sealed verdicts are worth, once the key is open."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.blind import sealed, verdicts
from form_drake.bench.blind_sizes import SIZES, compared, first_scores, limits
from form_drake.bench.blind_sizes import found as sized
from form_drake.diagnose.verdict import LEAST
from form_drake.effects import CATALOGUE
from form_drake.files import read_mapping

SAME = (  # beside what the catalogue says of itself: one class by their definition
    {"yield", "hardening"},
)
Truth = Mapping[str, Any]
Verdict = Mapping[str, Any]


def digest(key: Mapping[str, Truth]) -> str:
    """The seal: SHA-256 of ids, seeds, kinds and names of effects of a key."""
    told = [[n, t["seed"], t["kind"], sorted(t["effects"])] for n, t in sorted(key.items())]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def wilson(hits: int, count: int) -> tuple[float, float]:
    """The 95 % interval of a rate (Wilson 1927)."""
    if not count:
        return 0.0, 1.0
    z, p = 1.96, hits / count
    middle = p + z * z / (2.0 * count)
    half = z * np.sqrt(p * (1.0 - p) / count + z * z / (4.0 * count**2))
    low, high = ((middle + s * half) / (1.0 + z * z / count) for s in (-1.0, 1.0))
    return max(float(low), 0.0), min(float(high), 1.0)  # round-off leaves the range


def right(effect: str, named: Mapping[str, Any]) -> bool:
    """Whether what was named is of one class with an effect, by declaration or by the verdict's own word."""
    return bool(_classes(effect) & {named["name"], *named["class"]})


def _classes(effect: str) -> set[str]:
    """Effects that are declared to be of one class with it, whatever a verdict says."""
    own = CATALOGUE[effect].same if effect in CATALOGUE else ()
    return {effect, *own, *(n for same in SAME if effect in same for n in same)}


def _strictly(one: Verdict, truth: Truth) -> bool:
    """``first`` by declared classes alone, and of the right sign if by its own name."""
    (effect,), named = truth["effects"], [*_told(one)][:1]
    if not named or named[0]["name"] not in _classes(effect):
        return False
    wanted = SIZES[effect](truth["effects"][effect], truth["body"])
    return named[0]["name"] != effect or wanted is None or sized(named[0])[0] * wanted > 0.0


def _sure(one: Verdict) -> bool:
    """Whether effects were named without reserve."""
    return bool(one["verdict"] == "named")


def _open(one: Verdict, truth: Truth) -> bool:
    """Whether it is left open that something is missing: by the verdict, or by a doubt beside it."""
    return one["verdict"] != "none" or bool(one.get("doubts"))


def _told(one: Verdict) -> Sequence[Mapping[str, Any]]:
    """Effects that were named, with reserve or without; what was found and is refused is none."""
    told: Sequence[Mapping[str, Any]] = one.get("effects", ())
    return told if one["verdict"] in ("named", "ambiguous") else ()


def _wrong(one: Verdict, truth: Truth) -> bool:
    return _sure(one) and not all(
        any(right(t, e) for t in truth["effects"]) for e in one["effects"]
    )


def _all(one: Verdict, truth: Truth) -> bool:
    hidden = list(truth["effects"])
    every = permutations(_told(one), len(hidden))  # each for one effect
    return any(all(map(right, hidden, named)) for named in every)


def _exactly(one: Verdict, truth: Truth) -> bool:
    """Whether nothing else was named than what is hidden."""
    return _all(one, truth) and len(_told(one)) == len(truth["effects"])


def first(one: Verdict, truth: Truth) -> bool:
    """Whether what was named first is of the class of the one effect that is hidden."""
    (effect,) = truth["effects"]
    return bool(_told(one)) and right(effect, _told(one)[0])


RATES = {  # name -> kind, what counts
    "right class, strong singles": ("single", first),
    "right class and named": ("single", lambda o, t: _sure(o) and first(o, t)),
    "right class and nothing else": ("single", _exactly),
    "right by declared classes, and sign": ("single", _strictly),
    "false alarms on nulls": ("null", lambda o, t: bool(o.get("effects"))),
    "nulls, not told that nothing is missing": ("null", _open),
    "out of catalogue, refused": ("outside", lambda o, t: o["verdict"] == "unnamed"),
    "out of catalogue, refused without held-out": (
        "outside",
        lambda o, t: o.get("named") == "unnamed",
    ),
    "out of catalogue, confidently misnamed": ("outside", lambda o, t: _sure(o)),
    "near threshold, confidently wrong": ("near", _wrong),
    "near threshold, right class": ("near", first),
    "pairs, both named": ("pair", _all),
    "pairs, both named and nothing else": ("pair", _exactly),
    "wrong noise, confident names": ("noise", lambda o, t: _sure(o)),
    "wrong noise, confidently wrong": ("noise", _wrong),
}
MISNAMED = (  # rates that errors do not lower: these are left out
    "false alarms on nulls",
    "out of catalogue, confidently misnamed",
    "near threshold, confidently wrong",
    "wrong noise, confident names",
    "wrong noise, confidently wrong",
)


def score(out: Path, key: Path, seal: Path) -> dict[str, Any]:
    """Rates of a file of verdicts; a case that has none counts as an error.

    Raises:
        ValueError: the key is not the one that was sealed, or cases are not in it.
    """
    truth, (head, results) = read_mapping(key), verdicts(out)
    told = all(
        isinstance(t, dict)
        and {"seed", "kind", "effects", "body"} <= set(t)
        and all(isinstance(t[k], dict) for k in ("effects", "body"))
        for t in truth.values()
    )
    if not told:
        raise ValueError(f"{key}: no key; each case has a seed, a kind, a body and effects")
    if sealed(seal) != head["seal"]:
        raise ValueError(f"{seal}: another seal than that of the verdicts in {out}, {head['seal']}")
    if digest(truth) != head["seal"]:
        raise ValueError(f"{key}: not the key that {seal} and {out} were sealed with")
    ids = {one["id"] for one in results}
    if lost := sorted(ids - set(truth)):
        raise ValueError(f"{out}: case {lost[0]} is not in {key}")
    results = [*results, *({"id": n, "verdict": "error"} for n in truth if n not in ids)]
    try:
        return {**head, **_worth(results, truth)}
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{out}, {key}: what is scored is not there, {error}") from None


def _worth(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> dict[str, Any]:
    rates, worked = {}, [float(one["seconds"]) for one in results if "seconds" in one]
    for name, (kind, counts) in RATES.items():
        own = [(one, truth[one["id"]]) for one in results if truth[one["id"]]["kind"] == kind]
        if name in MISNAMED:
            own = [(one, t) for one, t in own if one["verdict"] != "error"]
        hits = sum(bool(counts(one, t)) for one, t in own)
        rates[name] = {"hits": hits, "of": len(own), "interval": wilson(hits, len(own))}
    return {
        "rates": rates,
        "confusions": _confusions(results, truth),
        "sizes": compared(results, truth),
        "limits": limits(results, truth),
        "gap": _gaps(results, truth),
        "placebos": _placebos(results, truth),
        "nulls": _nulls(results, truth),
        **before(results, truth),
        "ablation": _ablation(results, truth),
        "seconds": _seconds(worked) if worked else {},
        "reading": [float(one["reading"]) for one in results if "reading" in one],
        "errors": [one["id"] for one in results if one["verdict"] == "error"],
        "missing": sum("seconds" not in one for one in results),
    }


def _confusions(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> list[list[str]]:
    """Strong singles that were named otherwise: truth, verdict, what was named."""
    found = []
    for one in results:
        t = truth[one["id"]]
        if t["kind"] == "single" and not (_sure(one) and first(one, t)):
            told = ", ".join(e["name"] for e in one.get("effects", [])) or "nothing"
            found.append([*t["effects"], one["verdict"], told])
    return sorted(found)


def _gaps(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> dict[str, Any]:
    """Held-out errors of rightly named singles, channels that are clear of floor and grid alone.

    Errors after by those before: of predictions, the noise of what is measured taken off, and with that
    noise in both, beside the least that could be then.
    """
    rows = [
        c
        for one in results
        if truth[one["id"]]["kind"] == "single" and first(one, truth[one["id"]])
        for c in one["gap"]
    ]
    clear = [c for c in rows if c["closure"] is not None]
    if not clear:
        return {"channels": 0, "excluded": len(rows)}
    pure, loud, noise = (np.array(e) for e in zip(*map(_errors, clear), strict=True))
    return {
        "channels": len(clear),
        "excluded": len(rows) - len(clear),
        "beyond noise": float(np.median(pure[:, 1] / pure[:, 0])),
        "with noise": float(np.median(loud[:, 1] / loud[:, 0])),
        "noise alone": float(np.median(noise / loud[:, 0])),
        "closure": float(np.median([c["closure"] for c in clear])),
    }


def _seconds(worked: Sequence[float]) -> dict[str, float]:
    """Of a core, for a verdict; how many took more than two cores have in the ten minutes that are the goal."""
    most = 2.0 * 600.0
    over = sum(one > most for one in worked)
    return {
        "median": float(np.median(worked)),
        "longest": max(worked),
        f"over {most:g}": over,
        "all": sum(worked),
    }


def _errors(channel: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, float]:
    """Of predictions before and after, the same with noise, and the noise; earlier verdicts hold the second."""
    told = np.array([channel["before"], channel["after"]])
    if "noise" in channel:
        return told, np.hypot(told, channel["noise"]), channel["noise"]
    noise = channel["floor"]
    return np.sqrt(np.maximum(told**2 - noise**2, 0.0)), told, noise


def _placebos(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> dict[str, Any]:
    """Closures of rightly named singles beside those of wrong effects in their place, medians.

    Channels are those that are clear of floor and grid, which are the same for all.
    """
    closed: dict[str, list[float]] = {"named": [], "runner-up": [], "drawn": []}
    count = 0
    for one in results:
        wrong = one.get("placebos") or []
        if truth[one["id"]]["kind"] != "single" or not (wrong and first(one, truth[one["id"]])):
            continue
        count += 1
        for name, gap in zip(closed, (one["gap"], *(w["gap"] for w in wrong)), strict=False):
            closed[name] += [c["closure"] for c in gap if c["closure"] is not None]
    medians = {k: float(np.median(v)) for k, v in closed.items() if v}
    return {"cases": count, **medians}


def _ablation(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> dict[str, Any]:
    """By statistics: strong singles whose class scores highest, and nulls with a score above the least."""
    counts: dict[str, Any] = {}
    for one in results:
        kind, (effect, *_) = truth[one["id"]]["kind"], (*truth[one["id"]]["effects"], "")
        if kind not in ("single", "null") or not one.get("passes"):
            continue
        tops = {**one.get("lesser", {}), "full": first_scores(one)}
        for way, found in tops.items():
            own = counts.setdefault(way, {"right": [0, 0], "false": [0, 0]})
            name, score = max(found.items(), key=lambda s: s[1], default=("", 0.0))
            hit = right(effect, {"name": name, "class": []}) if effect else score > LEAST
            tally = own["right" if effect else "false"]
            tally[0] += bool(hit)
            tally[1] += 1
    return counts


def _nulls(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> dict[str, float]:
    """Largest score of every effect where nothing was hidden."""
    found: dict[str, float] = {}
    for one in results:
        if truth[one["id"]]["kind"] == "null" and one.get("passes"):
            for name, value in first_scores(one).items():
                found[name] = max(found.get(name, 0.0), value)
    return found


def before(results: Sequence[Verdict], truth: Mapping[str, Truth]) -> dict[str, Any]:
    """Nulls and limits without what the grid has wrong, where that was told."""
    plain = [
        {**one, "scores": one["lesser"]["uncorrected"], **one["before"]}
        for one in results
        if "before" in one
    ]
    if not plain:
        return {}
    return {"before": {"nulls": _nulls(plain, truth), "limits": limits(plain, truth)["ratios"]}}
