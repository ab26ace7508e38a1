"""Measured curves of rubber and tissue: laws fitted to some modes of loading predict the others.

Every table of a folder becomes one recording for each mode (``form_drake.bench.curves``) and goes
the whole way of the weak form. Each law is fitted to all modes of a table and to all but one.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.bench.cases import fingerprint, run_cases
from form_drake.bench.curves import BULK, Curve, read_curves
from form_drake.identify import Identification, identify
from form_drake.laws import KAPPA, Law, Term, law_named, load
from form_drake.laws.elastic import second_invariant
from form_drake.laws.named import OWN

SECOND_INVARIANT = Law(
    name="second-invariant",
    parameters=(
        Term(
            "C01",
            "Pa",
            second_invariant,
            signed=True,
            excited="stretch it in two directions",
        ),
        KAPPA,
    ),
    moduli=lambda v: (v["kappa"], 2.0 * v["C01"]),
    equation="2 C01 dev(I1 b - b b) + kappa J (J - 1) I",
)
ONES = ("neo-hookean", "mooney-rivlin", "yeoh", "gent")
SUMS = ("gent+second-invariant", "yeoh+second-invariant", "yeoh+gent")
SECONDS = {"linear": 0.9, "searched": 3.5}  # of one fit
PUBLISHED = {"I2": "second-invariant", "ln I2": "gent-thomas"}  # names in a folder's README
ORDER = ("equibiaxial", "pure-shear", "uniaxial")  # in which that README holds modes out
COLUMNS = ("uniaxial", "pure-shear", "equibiaxial")  # and states errors
STEP = 0.1  # of a standard deviation, in the differences below


@dataclass(frozen=True)
class Fit:
    """One fit of a bench.

    Attributes:
        path: of the table.
        law: name of the law.
        fitted: modes whose curves are seen.
    """

    path: Path
    law: str
    fitted: tuple[str, ...]

    def __call__(self) -> dict[str, Any]:
        """Fit the law, and how well it meets every mode."""
        curves = read_curves(self.path)
        start = {"file": self.path.stem, "law": self.law, "fitted": list(self.fitted)}
        try:
            answer = fitted(curves, self.law, self.fitted)
        except ValueError as refusal:
            empty: dict[str, Any] = {"rms_percent": {}, "rms_std": {}, "parameters": {}}
            return {**start, **empty, "refused": str(refusal)}
        law, values = answer.material.law, answer.material.values
        return {
            **start,
            "rms_percent": {m: c.rms(law, values) for m, c in curves.items()},
            "rms_std": {m: deviation(c, answer) for m, c in curves.items()},
            "parameters": {
                k: {"value": p.value, "std": p.std}
                for k, p in answer.material.parameters().items()
                if k in answer.material.keys
            },
            "model_error": answer.details["model_error"],
            "seconds": answer.seconds,
            "refused": None,
        }


def fitted(curves: dict[str, Curve], law: str, modes: Sequence[str]) -> Identification:
    """Identify a law from the recordings of some modes by the weak form.

    Raises:
        ValueError: the modes do not determine the law.
    """
    seen = [curves[m] for m in modes]
    given = {"kappa": BULK} if "kappa" in law_named(law).keys else {}
    return identify(
        [c.recording(known=given) for c in seen],
        law,
        method="weak",
        weak=[c.options() for c in seen],
    )


def deviation(curve: Curve, answer: Identification) -> float:
    """Standard deviation of a mode's error [percent] that the error bars of a fit make."""
    law, values = answer.material.law, dict(answer.material.values)
    keys, covariance = answer.material.keys, answer.material.covariance
    slopes = []
    for key, variance in zip(keys, np.diag(covariance), strict=True):
        step = STEP * float(np.sqrt(variance))
        step = min(step, 0.5 * values[key]) if values[key] > 0.0 else step
        up, down = (curve.rms(law, {**values, key: values[key] + s * step}) for s in (1.0, -1.0))
        slopes.append((up - down) / (2.0 * step))
    g = np.array(slopes)
    return float(np.sqrt(max(g @ covariance @ g, 0.0)))


def tables(data: Path) -> list[Path]:
    """The tables of a folder.

    Raises:
        ValueError: there is none.
    """
    found = sorted(Path(data).glob("*.csv"))
    if not found:
        raise ValueError(f"{data}: holds no table of measured curves (.csv)")
    return found


def laws(own: Path | None) -> tuple[str, ...]:
    """Names of the laws that are fitted; those of a file of one's own, alone and beside yeoh."""
    OWN.setdefault(SECOND_INVARIANT.name, SECOND_INVARIANT)
    added = [] if own is None else [law for law in load(own) if law.flow == "elastic"]
    return (*ONES, *SUMS, *(f"{first}{law.name}" for law in added for first in ("", "yeoh+")))


def run_rubber(
    data: Path, *, store: Path, own: Path | None = None, only: tuple[str, ...] = ()
) -> dict[str, Any]:
    """All fits of all tables of a folder; see the module's text."""
    cases: dict[str, Callable[[], dict[str, Any]]] = {}
    estimates: dict[str, float] = {}
    for path in tables(data):
        modes = tuple(read_curves(path))
        left = [m for m in modes if len(modes) > 1]
        for law in laws(own):
            for out in (None, *left):
                name = f"{path.stem}/{law}/{'all' if out is None else f'without-{out}'}"
                cases[name] = Fit(path, law, tuple(m for m in modes if m != out))
                kind = "searched" if law_named(law).constants("shape") else "linear"
                estimates[name] = SECONDS[kind]
    inputs = [*tables(data), *([] if own is None else [own])]
    found = run_cases(cases, store=store, mark=fingerprint(*inputs), estimates=estimates, only=only)
    fits = list(found.values())
    return {
        "bench": "rubber",
        "fits": fits,
        "reference": reference(data),
        "chosen": {file: chosen(fits, file) for file in dict.fromkeys(f["file"] for f in fits)},
    }


def held_out(fits: list[dict[str, Any]], file: str, law: str) -> tuple[float, float] | None:
    """Root mean square of a law's errors at held-out modes and its deviation [percent].

    None where a fit is refused or not there.
    """
    own = [f for f in fits if (f["file"], f["law"]) == (file, law)]
    modes = {m for f in own for m in (*f["fitted"], *f["rms_percent"])}
    parts = [f for f in own if len(f["fitted"]) == len(modes) - 1]
    if len(modes) < 2 or len(parts) < len(modes) or any(f["refused"] for f in parts):
        return None
    pairs = [
        (f["rms_percent"][m], f["rms_std"][m]) for f in parts for m in modes - set(f["fitted"])
    ]
    e, s = np.array(pairs).T
    score = float(np.sqrt(np.mean(e**2)))
    return score, float(np.sqrt(np.sum((e * s) ** 2))) / (len(e) * max(score, 1e-12))


def chosen(fits: list[dict[str, Any]], file: str) -> dict[str, Any]:
    """Which law predicts the held-out modes of a table best, and which are no worse for certain."""
    names = dict.fromkeys(f["law"] for f in fits if f["file"] == file)
    scores = {law: s for law in names if (s := held_out(fits, file, law)) is not None}
    refused = [law for law in names if law not in scores]
    if not scores:
        return {"law": None, "held_out_percent": {}, "cannot_tell": [], "refused": refused}
    best = min(scores, key=lambda law: scores[law][0])
    value, own = scores[best]
    alike = [n for n, (v, s) in scores.items() if n != best and v - value < np.hypot(own, s)]
    return {
        "law": best,
        "held_out_percent": {n: {"value": v, "std": s} for n, (v, s) in scores.items()},
        "cannot_tell": alike,
        "refused": refused,
    }


# --- the published errors that a folder's README may state ---------------------------------------
def reference(data: Path) -> list[dict[str, Any]]:
    """The fits that the table in the folder's README states; none where there is no such table.

    Its columns are a law, then for a table of curves "NAME: all three", or "held out in turn" for
    the table before it.
    """
    try:
        lines = (Path(data) / "README.md").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in lines if line[:1] == "|"]
    if len(rows) < 3 or rows[0][0] != "law":
        return []
    stems = [path.stem for path in tables(data)]
    found = []
    for name, *cells in rows[2:]:
        law = "+".join(PUBLISHED.get(part, part) for part in name.split(" + "))
        file = ""
        for title, cell in zip(rows[0][1:], cells, strict=False):
            first = title.split(":")[0].lower()
            file = next((s for s in stems if s.startswith(first)), file)
            found += _stated(file, law, cell, turned="held out" in title)
    return found


def _stated(file: str, law: str, cell: str, *, turned: bool) -> list[dict[str, Any]]:
    numbers = [float(n) for n in re.findall(r"[0-9.]+", cell)]
    if len(numbers) != len(COLUMNS):
        return []
    if not turned:
        errors = dict(zip(COLUMNS, numbers, strict=True))
        return [{"file": file, "law": law, "fitted": list(COLUMNS), "rms_percent": errors}]
    return [
        {
            "file": file,
            "law": law,
            "fitted": [m for m in COLUMNS if m != out],
            "rms_percent": {out: number},
        }
        for out, number in zip(ORDER, numbers, strict=True)
    ]


# --- as a table ---------------------------------------------------------------------------------
def table(result: dict[str, Any]) -> str:
    """The fits as a plain table; ``*`` marks a mode that was held out, with its deviation."""
    lines = []
    for file, verdict in result["chosen"].items():
        fits = [f for f in result["fits"] if f["file"] == file]
        modes = tuple(dict.fromkeys(m for f in fits for m in f["fitted"]))
        head = "".join(f"{m:>22}" for m in modes)
        lines += [f"{file}: stress RMS in % of the mode's largest stress", f"{'law':24}{head}"]
        for fit in fits:
            stated = _published(result["reference"], fit)
            cells = "".join(f"{_cell(fit, stated, m):>22}" for m in modes)
            lines.append(
                f"{fit['law']:24}{cells if not fit['refused'] else '  refused: ' + _short(fit)}"
            )
        lines += [_verdict(verdict), ""]
    if result["reference"]:
        lines.append("In brackets: a direct fit of the curves, as the folder's README states it.")
    return "\n".join(lines)


def _published(stated: list[dict[str, Any]], fit: dict[str, Any]) -> dict[str, float]:
    for r in stated:
        if all(r[k] == fit[k] for k in ("file", "law")) and set(r["fitted"]) == set(fit["fitted"]):
            return r["rms_percent"]
    return {}


def _cell(fit: dict[str, Any], stated: dict[str, float], mode: str) -> str:
    if mode not in fit["rms_percent"]:
        return ""
    mark = "" if mode in fit["fitted"] else f" ± {fit['rms_std'][mode]:.1f}*"
    beside = f" ({stated[mode]:.1f})" if mode in stated else ""
    return f"{fit['rms_percent'][mode]:.1f}{mark}{beside}"


def _short(fit: dict[str, Any]) -> str:
    return str(fit["refused"]).split(":")[0]


def _verdict(found: dict[str, Any]) -> str:
    if found["law"] is None:
        return "held-out modes choose no law"
    best = found["held_out_percent"][found["law"]]
    text = f"held-out modes choose {found['law']}: {best['value']:.1f} ± {best['std']:.1f} %"
    alike = [
        f"{n} ({found['held_out_percent'][n]['value']:.1f} ± {found['held_out_percent'][n]['std']:.1f})"
        for n in found["cannot_tell"]
    ]
    return f"{text}; cannot tell it from {', '.join(alike)}" if alike else text
