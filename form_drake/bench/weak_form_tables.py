"""The result of the bench of the weak form as plain tables."""

from typing import Any

from scipy.stats import binom

from form_drake.identify import Estimator

ESTIMATORS: tuple[Estimator, ...] = ("gls", "ols")
GOALS: dict[str, Any] = {  # largest error [percent]
    "exact": 0.5,
    "fe": 0.5,
    "fe-noise": {
        "press-a": {"E": 3.0, "tau_y": 2.0},
        "press-b": {"E": 1.5, "tau_y": 1.5},
        "bend-touching-a": {"E": 1.5},
        "bend-touching-b": {"E": 1.5},
    },
}
MEDIAN = {"1": 2.0}  # largest median error [percent] by the noise [percent]
COVERAGE = (0.8, 0.98)  # share of true values in 90 % intervals
CHANCE = 0.05  # that any of the rows of honest intervals were called too narrow
ASSEMBLY = 2.0  # seconds of A and b


def table(result: dict[str, Any]) -> str:
    """The result as plain tables, one for each kind of case that was run."""
    cases, goals = result["cases"], result["goals"]
    parts = {
        "exact": ("without noise, error [%], goal", _exact_lines, goals["exact"]),
        "refused": (
            "motion inside the body alone: parameters that the refusal names",
            _named,
            None,
        ),
        "fe": ("finite elements without noise, error [%], goal", _exact_lines, goals["fe"]),
        "fe-noise": (
            "finite elements, 20 um and 1 % of the largest force: median size of the error [%],"
            " coverage of the 90 % intervals",
            _finite_lines,
            goals["fe-noise"],
        ),
        "noise": (
            "noise in % of the rms of what is measured: median size of the error [%], coverage of"
            " the 90 % intervals",
            _noise_lines,
            None,
        ),
        "time": ("seconds of the processor", _time_lines, None),
    }
    blocks = []
    for kind, (title, lines, goal) in parts.items():
        own = {n.split("/", 1)[1]: r for n, r in cases.items() if n.split("/")[0] == kind}
        if own:
            head = f"{title} {goal:g}" if isinstance(goal, float) else title
            blocks.append("\n".join([head, *lines(own, goal)]))
    return "\n\n".join(blocks)


def _met(met: bool) -> str:
    return "met" if met else "MISSED"


def _exact_lines(own: dict[str, Any], goal: float) -> list[str]:
    lines = [f"{'':20}{'rows':>6}{'condition':>11}{'s':>7}"]
    for name, r in own.items():
        if "refused" in r:
            lines.append(f"{name:20}  refused: {', '.join(r['refused'])}  MISSED")
            continue
        met = _met(max(abs(e) for e in r["errors"].values()) <= goal)
        errors = "  ".join(f"{k} {e:+.3f}" for k, e in r["errors"].items())
        size = f"{r['rows']:>6}{r['condition']:>11.1f}{r['seconds']:>7.1f}"
        lines.append(f"{name:20}{size}  {errors}  {met}")
    return lines


def _named(own: dict[str, Any], _: None) -> list[str]:
    return [
        f"{name:20}{', '.join(r['named']) or 'not refused'}  {_met(r['named'] == r['expected'])}"
        for name, r in own.items()
    ]


def _noise_lines(own: dict[str, Any], _: None) -> list[str]:
    head = "".join(f"{c:>9}" for e in ESTIMATORS for c in (e, "cover", "refused"))
    lines = [f"{'':20}{'noise':>6} {'':9}{head}{'seeds':>7}"]
    for name, r in own.items():
        law, level, _seeds = name.split("/")
        keys = dict.fromkeys(k for e in ESTIMATORS for k in r[e]["median"]) or {"-": None}
        for key in keys:
            cells = "".join(_cells(r[e], key) for e in ESTIMATORS)
            lines.append(f"{law:20}{level:>6} {key:9}{cells}{r['seeds']:>7}")
    return lines + _noise_goals(own)


def _noise_goals(own: dict[str, Any]) -> list[str]:
    """How the default estimator does over all cases."""
    lines = []
    held, answers = 0.0, 0
    covers: list[tuple[str, float, int]] = []
    above: dict[str, list[str]] = {level: [] for level in MEDIAN}
    for name, r in own.items():
        law, level, _seeds = name.split("/")
        found = r[ESTIMATORS[0]]
        count = r["seeds"] - found["refused"]
        held += count * sum(found["coverage_90"].values())
        answers += count * len(found["coverage_90"])
        covers += [(f"{law} {level} {k}", c, count) for k, c in found["coverage_90"].items()]
        if level in MEDIAN:
            most = MEDIAN[level]
            above[level] += [f"{law} {k}" for k, v in found["median"].items() if not v <= most]
    for level, names in above.items():
        if any(name.split("/")[1] == level for name in own):
            told = f"MISSED: {', '.join(names)}" if names else "met"
            lines.append(f"gls, {level} %: median at most {MEDIAN[level]:g}  {told}")
    low, high = COVERAGE
    narrow = [(n, c, k) for n, c, k in covers if c < low]
    if narrow:
        rows = ", ".join(f"{name} {c:.0%}" for name, c, _ in narrow)
        lines.append(f"gls, covered in less than {low:.0%}: {rows}")
        sure = [n for n, c, k in narrow if binom.cdf(round(c * k), k, 0.9) < CHANCE / len(covers)]
        lines.append(
            f"of these by more than chance in {len(covers)} rows: {', '.join(sure) or 'none'}"
        )
    if answers:
        told = f"hold the truth in {held / answers:.0%} (goal {low:.0%} to {high:.0%})"
        lines.append(
            f"gls: 90 % intervals of all {answers} values {told}  {_met(low <= held / answers <= high)}"
        )
    return ["", *lines]


def _cells(found: dict[str, Any], key: str) -> str:
    median, cover = (found[n].get(key) for n in ("median", "coverage_90"))
    shown = ("-", "-") if median is None else (f"{median:.3f}", f"{cover:.0%}")
    return "".join(f"{c:>9}" for c in (*shown, found["refused"]))


def _finite_lines(own: dict[str, Any], goals: dict[str, dict[str, float]]) -> list[str]:
    lines = [f"{'':20}{'':9}{'error':>9}{'cover':>9}{'refused':>9}{'seeds':>7}{'goal':>6}"]
    for name, r in own.items():
        case = name.split("/")[0]
        for key, goal in goals[case].items():
            median = r["gls"]["median"].get(key)
            met = _met(median is not None and median <= goal)
            cells = _cells(r["gls"], key)
            lines.append(f"{case:20}{key:9}{cells}{r['seeds']:>7}{goal:>6.1f}  {met}")
    return lines


def _time_lines(own: dict[str, Any], _: None) -> list[str]:
    lines = []
    for name, r in own.items():
        size = f"{r['rows']} rows, {r['points']} points, {r['frames']} frames"
        seconds, whole = r["assembly_seconds"], r["identification_seconds"]
        every, half = r["assembly_megabytes"]
        lines += [
            f"{name}: {size}: A and b once {seconds:.2f} (goal {ASSEMBLY:g} {_met(seconds <= ASSEMBLY)}),"
            f" whole identification {whole:.1f}, that is {whole / seconds:.0f} times as much",
            f"memory of an assembly: {every:.0f} MB, of the first half of the frames {half:.0f} MB",
        ]
    return lines
