"""What sealed verdicts are worth, as printed, beside what is wanted of them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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
FACES = {  # other goals where two sides and the force are all there is
    "right class, strong singles": (">=", 0.90),
}


@dataclass(frozen=True)
class Line:
    """One thing that verdicts are judged by.

    Attributes:
        name: what it is.
        told: what was reached.
        between: the 95 % interval of a rate; "": it is none.
        goal: what is wanted; "": nothing.
        met: whether that was reached; None: nothing is wanted, or nothing tells.
    """

    name: str
    told: str
    between: str = ""
    goal: str = ""
    met: bool | None = None

    def __str__(self) -> str:
        judged = "" if self.met is None else "met " if self.met else "MISSED "
        goal = f"(goal {self.goal})" if self.goal else ""
        return f"{self.name:44} {self.told + self.between:25}{judged}{goal}".rstrip()


def lines(result: Result) -> list[Line]:
    """What a set is judged by, first to last."""
    goals = RATES | (FACES if result.get("probes") == "faces" else {})
    found = [_rate(k, r["hits"], r["of"], goals.get(k)) for k, r in result["rates"].items()]
    if count := result["missing"]:
        found.insert(0, Line("cases without a verdict, which count as errors", str(count)))
    found += [*_sizes(result["sizes"]), *_held_out(result)]
    found += _time(result["seconds"], result["reading"])
    for way, own in result["ablation"].items():
        found += [
            _rate(f"columns alone, {way}: {told}", *own[k])
            for k, told in (("right", "right"), ("false", f"nulls over {LEAST:g}"))
        ]
    return found


def table(result: Result) -> str:
    """As printed."""
    told = [f"code {result['code']}, seal {result['seal'][:12]}", "", *map(str, lines(result))]
    plain = result.get("before", {"nulls": {}, "limits": {}})
    for title, numbers in (
        ("median errors of sizes, by effect", _by_effect(result["sizes"]["errors"])),
        ("held out, medians of single effects named rightly", result["gap"]),
        ("closure with a wrong effect in the place of the right one", result["placebos"]),
        ("largest scores where nothing is hidden", result["nulls"]),
        ("the same with what the grid has wrong", plain["nulls"]),
        ("seconds of a core for a verdict", result["seconds"]),
    ):
        told += _numbers(title, numbers)
    told += ["", "limits, observed over predicted, and cases that they are read off"]
    for name, ratio in (seen := result["limits"])["ratios"].items():
        told.append(
            f"  {name:24} {'-' if ratio is None else f'{ratio:.3g}':9} {seen['cases'][name]}"
        )
    told += _numbers("the same with what the grid has wrong", plain["limits"])
    told += ["", "strong singles not named: hidden, verdict, named"]
    told += [f"  {effect:24} {verdict:10} {told}" for effect, verdict, told in result["confusions"]]
    return "\n".join(told)


def _numbers(title: str, numbers: Mapping[str, float | None]) -> list[str]:
    """A block of a table, by name; nothing where there are none."""
    told = [f"  {k:24} {'-' if v is None else f'{v:.3g}'}" for k, v in numbers.items()]
    return ["", title, *told] if told else []


def _rate(name: str, hits: int, count: int, goal: tuple[str, float] | None = None) -> Line:
    low, high = (100.0 * x for x in wilson(hits, count))
    line = Line(name, f"{hits:3d} of {count:3d}", f"   {low:3.0f}-{high:3.0f} %")
    return line if goal is None or not count else _judged(line, hits / count, *goal, "%")


def _judged(line: Line, value: float, way: str, goal: float, unit: str = "") -> Line:
    wanted = f"{100.0 * goal:g} %" if unit == "%" else f"{goal:g} {unit}".strip()
    met = value >= goal if way == ">=" else value <= goal
    return replace(line, goal=f"{way} {wanted}", met=met)


def _value(name: str, value: float, told: str, way: str, goal: float, unit: str = "") -> Line:
    return _judged(Line(name, told), value, way, goal, unit)


def _sizes(sizes: Result) -> Iterator[Line]:
    for group, told, goal in (
        ("fine", "sizes", 0.05),
        ("rough", "friction, slip, masses, inclusions", 0.20),
    ):
        if (error := sizes[group]) is not None:
            yield _value(f"median error, {told}", error, f"{100.0 * error:.1f} %", "<=", goal, "%")
    if sizes["untold"]:
        yield Line("sizes that recordings do not tell", ", ".join(sizes["untold"]))
    hits, count = sizes["within"], sizes["of"]
    covered = _rate("truth within the 90 % interval", hits, count)
    if count:
        covered = replace(covered, goal="85 to 95 %", met=0.85 <= hits / count <= 0.95)
    yield covered
    if sizes["pull"] is not None:
        yield Line("errors by standard deviation, rms", f"{sizes['pull']:.2f}")
    for key, which, goal in ("centres", "", 3.0), ("stiff", "stiff ", 6.0):
        if sizes[key]:
            middle = 1e3 * float(np.median(sizes[key]))
            name = f"centre of {which}inclusions, median"
            told = f"{middle:.1f} mm of {len(sizes[key])}"
            yield _value(name, middle, told, "<=", goal, "mm")


def _held_out(result: Result) -> Iterator[Line]:
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


def _time(seconds: Result, reading: Sequence[float]) -> Iterator[Line]:
    name = "seconds of a core without simulations, most"
    if reading:
        most = max(reading)
        yield _value(name, most, f"{most:.0f}", "<=", READING)
    else:
        yield Line(name, "not told", goal=f"<= {READING:g}")
    if seconds:
        hours = seconds["all"] / 7200.0
        yield _value("hours of two cores, without making cases", hours, f"{hours:.1f}", "<=", HOURS)
        yield _value(
            "verdicts over 1200 s of a core", over := seconds["over 1200"], f"{over:d}", "<=", 0
        )


def _by_effect(errors: Mapping[str, list[float]]) -> dict[str, float]:
    return {name: float(np.median(np.abs(own))) for name, own in sorted(errors.items())}
