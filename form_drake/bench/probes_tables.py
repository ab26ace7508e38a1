"""The result of the bench of the probes as plain tables."""

from typing import Any

import numpy as np

from form_drake.bench import weak_form

FINITE_KINDS = ("fe", "fe-noise")  # as ``bench weak-form`` names them
GOALS: dict[str, Any] = {  # largest errors and changes [%]
    "median": 0.5,
    "worst": 1.0,
    "own-stress": {"press": 0.3, "bend": 0.8},
    "dx": 0.3,
    "noise": {"press": {"median": 1.0, "p90": 2.0}, "bend": {"median": 1.5, "worst": 4.0}},
    "coverage_90": [0.8, 0.98],
    **{kind: weak_form.GOALS[kind] for kind in FINITE_KINDS},
}
TITLES = {
    "exact": "exact tracks: error [%]",
    "twin": "exact tracks, with the twin: error [%]",
    "own-stress": "the solver's own stress at all particles in the balance: error [%] of E before"
    " anything yields, of tau_y while most of the body does, and of all rows",
    "rate": "the same for frames at other rates [Hz], of several first frames: least and largest",
    "dx": "exact tracks from three grids: error [%], force at the largest stroke, and the closed"
    " form sqrt(3/2) tau_y V / H",
    "unseen": "a motion that was not used: shape [mm rms], force [% of its peak, rms], peak force [%]",
    "noise": "20 um and 1 % of the largest force: median, 90th percentile, worst size of the"
    " error [%], coverage of the 90 % intervals",
}


def table(result: dict[str, Any]) -> str:
    """The result as plain tables, one for each kind of case that was run."""
    cases, blocks = result["cases"], []
    special = {
        "noise": _noisy_lines,
        "unseen": _unseen_lines,
        "own-stress": _own_lines,
        "rate": _rate_lines,
        "dx": _grid_lines,
    }
    for kind, title in TITLES.items():
        own = {n.split("/", 1)[1]: r for n, r in cases.items() if n.split("/")[0] == kind}
        if own:
            blocks.append("\n".join([title, *special.get(kind, _exact_lines)(own)]))
    finite = {n: r for n, r in cases.items() if n.split("/")[0] in FINITE_KINDS}
    if finite:
        blocks.append(weak_form.table({"cases": finite, "goals": weak_form.GOALS}))
    return "\n\n".join(blocks)


def met(size: float, goal: float) -> str:
    """Whether a size [%] is within its goal, in words."""
    return f"{'met' if size <= goal else 'MISSED'} (goal {goal:g})"


def _own_lines(own: dict[str, Any]) -> list[str]:
    lines = []
    for name, r in own.items():
        goal = next(g for probe, g in GOALS["own-stress"].items() if name.startswith(probe))
        cells = "  ".join(
            f"{k} {e['error']:+.3f} ({e['rows']} rows)" for k, e in r["errors"].items()
        )
        size = max(abs(e["error"]) for k, e in r["errors"].items() if k != "all")
        lines.append(f"{name:10}{cells}  {met(size, goal)}")
    return lines


def _rate_lines(own: dict[str, Any]) -> list[str]:
    lines = []
    for name, r in own.items():
        for rate, errors in r["rates"].items():
            found = {k: [e[k] for e in errors if k in e] for k in errors[0]}
            cells = "  ".join(f"{k} {min(v):+.3f} to {max(v):+.3f}" for k, v in found.items())
            lines.append(f"{name:10}{rate:>6}  {cells}")
    return lines


def _grid_lines(own: dict[str, Any]) -> list[str]:
    lines = []
    groups: dict[str, list[dict[str, Any]]] = {}
    for name, r in own.items():
        groups.setdefault(name.split("/")[0], []).append(r)
    for name, group in groups.items():
        for r in group:
            cells = "  ".join(f"{k} {e['error']:+.3f}" for k, e in r["errors"].items())
            force = f"{r['force']:.4g} N"
            if "closed_form" in r:
                beside = 100.0 * (r["force"] / r["closed_form"] - 1.0)
                force += f", closed form {r['closed_form']:.4g} N ({beside:+.2f} %)"
            told = cells or f"refused: {r['refused']}"
            lines.append(f"{name:10}{1e3 * r['dx']:6.3f} mm  {told}  force {force}")
        answered = [r["errors"] for r in group if r["errors"]]
        for key in answered[0] if len(answered) > 1 else ():
            found = [e[key]["error"] for e in answered]
            change = max(found) - min(found)
            lines.append(f"{name:10}{key}: largest change {change:.3f}  {met(change, GOALS['dx'])}")
    return lines


def _exact_lines(own: dict[str, Any]) -> list[str]:
    lines = []
    for name, r in own.items():
        cells = "  ".join(
            f"{k} {e['error']:+.3f} ± {1.96 * e['std']:.3f}" for k, e in r["errors"].items()
        )
        lines.append(
            f"{name:10}{r['rows']:>6}{r['condition']:>8.1f}{r['seconds']:>7.1f} s  {cells}"
        )
    for group in ("press", "bend"):
        drawn = [r["errors"] for n, r in own.items() if n.startswith(f"{group}-")]
        for key in drawn[0] if drawn else ():
            sizes = [abs(e[key]["error"]) for e in drawn]
            lines.append(
                f"{group} {key}, {len(sizes)} specimens: median {np.median(sizes):.2f}, worst"
                f" {max(sizes):.2f}"
            )
    return lines


def _noisy_lines(own: dict[str, Any]) -> list[str]:
    lines = [
        f"{name.split('/')[0]:10}{key:>7}{r['median'][key]:>8.2f}{r['p90'][key]:>8.2f}{r['worst'][key]:>8.2f}"
        f"{r['coverage_90'][key]:>7.0%}{r['refused']:>4} refused of {r['seeds']}"
        for name, r in own.items()
        for key in r["median"]
    ]
    for group, goals in GOALS["noise"].items():
        drawn = [r for n, r in own.items() if n.startswith(f"{group}-")]
        keys = {key: None for r in drawn for key in r["median"]}
        lines += [_over_specimens(group, key, drawn, goals) for key in keys]
    return lines


def _over_specimens(
    group: str, key: str, drawn: list[dict[str, Any]], goals: dict[str, float]
) -> str:
    """All answers of the drawn specimens of a probe together, beside the goals."""
    drawn = [r for r in drawn if key in r["median"]]
    sizes = np.abs(np.concatenate([r["errors"][key] for r in drawn]))
    held = sum(r["coverage_90"][key] * len(r["errors"][key]) for r in drawn) / len(sizes)
    low, high = GOALS["coverage_90"]
    found = {"median": np.median(sizes), "p90": np.quantile(sizes, 0.9), "worst": sizes.max()}
    cells = [
        f"{k} {v:.2f}" + (f" {met(v, goals[k])}" if k in goals else "") for k, v in found.items()
    ]
    cover = f"{held:.0%} {'met' if low <= held <= high else 'MISSED'} (goal {100 * low:g} to {100 * high:g} %)"
    return f"{group} {key}, {len(drawn)} specimens: {', '.join(cells)}, 90 % intervals hold {cover}"


def _unseen_lines(own: dict[str, Any]) -> list[str]:
    return [
        f"{name:10}{r['shape_rms_mm']:>8.3f}{r['force_rms']:>8.2f}{r['peak_error']:>+8.2f}"
        for name, r in own.items()
    ]
