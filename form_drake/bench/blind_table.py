"""What sealed verdicts are worth, as printed, beside what is wanted of them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from form_drake.bench.blind_score import wilson
from form_drake.diagnose.verdict import LEAST

Result = Mapping[str, Any]
READING = 60.0  # seconds that a diagnosis may take before it simulates
HOURS = 8.0  # that two cores may take for the whole set
RATES = {  # shares of the cases: at least, or at most
    "right class, strong singles": (">=", 0.98),
    "false alarms on nulls": ("<=", 1 / 40),
    "out of catalogue, refused": (">=", 0.80),
    "out of catalogue, confidently misnamed": ("<=", 0.10),
    "near threshold, confidently wrong": ("<=", 0.05),
    "pairs, both named": (">=", 0.85),
    "wrong noise, confident names": ("<=", 0.0),
}


def table(result: Result) -> str:
    """As printed."""
    lines = [f"code {result['code']}, seal {result['seal'][:12]}", ""]
    lines += [_rate(name, rate["hits"], rate["of"]) for name, rate in result["rates"].items()]
    lines += [*_sizes(result["sizes"]), *_held_out(result)]
    lines += _time(result["seconds"], result["reading"])
    for way, own in result["ablation"].items():
        lines += [
            _rate(f"columns alone, {way}: {told}", *own[k])
            for k, told in (("right", "right"), ("false", f"nulls over {LEAST:g}"))
        ]
    plain = result.get("before", {"nulls": {}, "limits": {}})
    for title, numbers in (
        ("median errors of sizes, by effect", _by_effect(result["sizes"]["errors"])),
        ("held out, medians of single effects named rightly", result["gap"]),
        ("closure with a wrong effect in the place of the right one", result["placebos"]),
        ("largest scores where nothing is hidden", result["nulls"]),
        ("the same with what the grid has wrong", plain["nulls"]),
        ("seconds of a core for a verdict", result["seconds"]),
        ("the same with what the grid has wrong", plain["limits"]),
    ):
        lines += ["", title] if numbers else []
        lines += [f"  {k:24} {'-' if v is None else f'{v:.3g}'}" for k, v in numbers.items()]
    lines += ["", "limits, observed over predicted, and cases that they are read off"]
    for name, ratio in (seen := result["limits"])["ratios"].items():
        lines.append(
            f"  {name:24} {'-' if ratio is None else f'{ratio:.3g}':9} {seen['cases'][name]}"
        )
    lines += ["", "strong singles not named: hidden, verdict, named"]
    lines += [
        f"  {effect:24} {verdict:10} {told}" for effect, verdict, told in result["confusions"]
    ]
    return "\n".join(lines)


def _rate(name: str, hits: int, count: int, goal: tuple[str, float] | None = None) -> str:
    low, high = (100.0 * x for x in wilson(hits, count))
    told = f"{name:44} {hits:3d} of {count:3d}   {low:3.0f}-{high:3.0f} %"
    goal = goal or RATES.get(name)
    return told if goal is None or not count else f"{told}   {_judged(hits / count, *goal, '%')}"


def _judged(value: float, way: str, goal: float, unit: str = "") -> str:
    met = value >= goal if way == ">=" else value <= goal
    told = f"{100.0 * goal:g} %" if unit == "%" else f"{goal:g} {unit}".strip()
    return f"{'met' if met else 'MISSED'} (goal {way} {told})"


def _value(name: str, value: float, told: str, way: str, goal: float, unit: str = "") -> str:
    return f"{name:44} {told:25} {_judged(value, way, goal, unit)}"


def _sizes(sizes: Result) -> Iterator[str]:
    for group, told, goal in (
        ("fine", "sizes", 0.05),
        ("rough", "friction, slip, masses, inclusions", 0.20),
    ):
        if (error := sizes[group]) is not None:
            yield _value(f"median error, {told}", error, f"{100.0 * error:.1f} %", "<=", goal, "%")
    if sizes["untold"]:
        yield f"{'sizes that recordings do not tell':44} {', '.join(sizes['untold'])}"
    hits, count = sizes["within"], sizes["of"]
    goal = (">=", 0.85) if not count or hits <= 0.95 * count else ("<=", 0.95)
    yield _rate("truth within the 90 % interval", hits, count, goal)
    if sizes["pull"] is not None:
        yield f"{'errors by standard deviation, rms':44} {sizes['pull']:.2f}"
    for key, told, goal in ("centres", "", 3.0), ("stiff", "stiff ", 6.0):
        if sizes[key]:
            middle = 1e3 * float(np.median(sizes[key]))
            name = f"centre of {told}inclusions, median"
            yield _value(name, middle, f"{middle:.1f} mm", "<=", goal, "mm")


def _held_out(result: Result) -> Iterator[str]:
    seen, gap, wrong = result["limits"], result["gap"], result["placebos"]
    yield _rate("limits predicted within 1.5", seen["close"], seen["of"], (">=", 0.80))
    if gap["channels"]:
        left, closed = gap["with noise"], gap["closure"]
        yield _value("held-out error, after by before", left, f"{left:.3f}", "<=", 0.15)
        yield _value("closure, median", closed, f"{100.0 * closed:.1f} %", ">=", 0.95, "%")
    if {"named", "runner-up"} <= set(wrong):
        less = wrong["named"] - wrong["runner-up"]
        told = f"{100.0 * less:.0f} points"
        yield _value("the runner-up closes less by", less, told, ">=", 0.30, "%")


def _time(seconds: Result, reading: Sequence[float]) -> Iterator[str]:
    name = "seconds of a core without simulations, most"
    if reading:
        most = max(reading)
        yield _value(name, most, f"{most:.0f}", "<=", READING)
    else:
        yield f"{name:44} not told (goal <= {READING:g})"
    if seconds:
        hours = seconds["all"] / 7200.0
        yield _value("hours of two cores, without making cases", hours, f"{hours:.1f}", "<=", HOURS)
        yield _value(
            "verdicts over 1200 s of a core", over := seconds["over 1200"], f"{over:d}", "<=", 0
        )


def _by_effect(errors: Mapping[str, list[float]]) -> dict[str, float]:
    return {name: float(np.median(np.abs(own))) for name, own in sorted(errors.items())}
