"""The result of the bench of perception as plain tables."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from form_drake.bench.probes import NORMAL_90, SPECIMENS
from form_drake.bench.probes_tables import met

GOALS: dict[str, Any] = {  # sizes of errors [%], share of true values in 90 % intervals
    "named": 0.7,
    "fe": 0.7,
    "median": 1.0,
    "worst": 3.0,
    "coverage_90": (0.8, 0.98),
    "broken": 3.0,
}
KEYS = {"press": ("E", "tau_y"), "bend": ("E",)}  # what probes tell
LOST = 0.5  # share of the points in all frames
PAPER = {
    "bend_a": {"E": 0.76},
    "bend_b": {"E": 3.38},
    "press_a": {"E": 0.99, "tau_y": 1.5},
    "press_b": {"E": 1.7, "tau_y": 1.8},
}
TITLES = {
    "stereo": "from pictures, and from exact tracks of the same motion: error [%] ± 1.96 std",
    "fe": "finite element motions from pictures: error [%] ± 1.96 std",
    "paper": "pictures as large and quiet as the paper's, and the paper's error [%]",
    "sweep": "disturbed: error [%]",
}


def table(result: dict[str, Any]) -> str:
    """The result as plain tables, one for each kind of case that was run."""
    lines = {"stereo": _stereo, "fe": _finite, "paper": _paper, "sweep": _swept}
    blocks = []
    for kind, title in TITLES.items():
        own = {n.split("/", 1)[1]: r for n, r in result["cases"].items() if n.split("/")[0] == kind}
        if own:
            blocks.append("\n".join([title, *lines[kind](own)]))
    return "\n\n".join(blocks)


def _cells(found: dict[str, Any]) -> str:
    if not found["errors"]:
        return f"refused: {found['refused']}"
    return "  ".join(
        f"{k} {e['error']:+.2f} ± {1.96 * e['std']:.2f}" for k, e in found["errors"].items()
    )


def _largest(found: dict[str, Any]) -> float:
    return max((abs(e["error"]) for e in found["errors"].values()), default=np.inf)


def _stereo(own: dict[str, Any]) -> list[str]:
    lines = []
    for name, r in own.items():
        goal = "" if "-" in name else f"  {met(_largest(r), GOALS['named'])}"
        lines.append(
            f"{name:9}{r['points']:>5}{100 * r['held']:>7.1f} %{r['noise_um']:>6.2f} um"
            f"{r['seconds']:>7.1f} s  {_cells(r):<40} exact: {_cells(r['exact'])}{_inside(r)}{goal}"
        )
    held: list[bool] = []
    drawn = {p: [r for n, r in own.items() if n.startswith(f"{p}-")] for p in ("press", "bend")}
    for probe, some in drawn.items():
        found, inside = _specimens(probe, some)
        lines, held = lines + found, held + inside
    if all(len(some) >= SPECIMENS for some in drawn.values()):
        told, verdict = _covered(held)
        lines.append(f"both probes together, {len(held)} values: {told}{verdict}")
    return lines


def _covered(held: Sequence[bool]) -> tuple[str, str]:
    """How many values their intervals hold, and whether that is as many as there should be."""
    low, high = GOALS["coverage_90"]
    share = float(np.mean(held))
    verdict = "met" if low <= share <= high else "MISSED"
    goal = f"(goal {100 * low:.0f} to {100 * high:.0f})"
    return f"90 % intervals hold {100 * share:.0f} %", f" {verdict} {goal}"


def _inside(found: dict[str, Any]) -> str:
    """How far the reconstruction is from the truth."""
    if "inside_um" not in found:
        return ""
    return f"  inside off by {found['inside_um']:.1f} of {found['moved_um']:.0f} um"


def _specimens(probe: str, drawn: list[dict[str, Any]]) -> tuple[list[str], list[bool]]:
    """Median and worst over the drawn specimens, and which values their intervals hold.

    One that is refused counts as endless, and as held by nothing. Goals are for all of them: fewer are
    told without a verdict.
    """
    lines, every = [], []
    answered = [r["errors"] for r in drawn if r["errors"]]
    for key in KEYS[probe] if drawn else ():
        found = np.array([[e[key]["error"], e[key]["std"]] for e in answered]).reshape(-1, 2)
        sizes = np.append(np.abs(found[:, 0]), np.full(len(drawn) - len(found), np.inf))
        z = found[:, 0] / found[:, 1]
        held = np.append(np.abs(z) <= NORMAL_90, np.zeros(len(drawn) - len(z), dtype=bool))
        median, worst = float(np.median(sizes)), float(sizes.max())
        share, within = _covered(held.tolist())
        verdicts = f" {met(median, GOALS['median'])}", f" {met(worst, GOALS['worst'])}", within
        middle, far, within = (v * (len(drawn) >= SPECIMENS) for v in verdicts)
        wide = f", rms of error / std {np.sqrt(np.mean(z**2)):.2f}" if len(z) else ""
        lines.append(
            f"{probe} {key}, {len(drawn)} of {SPECIMENS} specimens: median {median:.2f}{middle},"
            f" worst {worst:.2f}{far}, {share}{within}{wide}"
        )
        every += held.tolist()
    return lines, every


def _finite(own: dict[str, Any]) -> list[str]:
    return [
        f"{name:16}{r['seconds']:>7.1f} s  {_cells(r)}  {met(_largest(r), GOALS['fe'])}"
        for name, r in own.items()
    ]


def _paper(own: dict[str, Any]) -> list[str]:
    return [
        f"{name:9}{r['points']:>5}{r['frames']:>5}{r['seconds']:>7.1f} s  {_cells(r)}  paper: "
        + "  ".join(f"{k} {e}" for k, e in PAPER[name].items())
        for name, r in own.items()
    ]


def _swept(own: dict[str, Any]) -> list[str]:
    """Each disturbance's levels, and the first at which its answer is broken."""
    groups: dict[tuple[str, str], list[tuple[str, dict[str, Any]]]] = {}
    for name, r in own.items():
        kind, level, probe = name.split("/")
        groups.setdefault((kind, probe), []).append((level, r))
    lines = []
    for (kind, probe), levels in groups.items():
        lines += [
            f"{kind:16}{probe:9}{level:>6}{100 * r['held']:>7.1f} % held  {_cells(r)}"
            for level, r in levels
        ]
        broken = [level for level, r in levels if _largest(r) > GOALS["broken"] or r["held"] < LOST]
        told = f"from {broken[0]} on" if broken else f"not up to {levels[-1][0]}"
        lines.append(f"{kind:16}{probe:9}broken {told}")
    return lines
