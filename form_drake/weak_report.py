"""HTML report of a weak identification: parameters, fit, residuals, windows, tracks and forces."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from form_drake.figures import fit_of_rows, fit_over_time, forces_and_windows, residual_map
from form_drake.identify import Identification
from form_drake.identify.options import WeakFit
from form_drake.report import Report
from form_drake.weak.probe import Probe

MOST_PANELS = 6
PRESSURES = {
    "law": "the volumetric part of the law",
    "free": "any pressure (it cancels in every row)",
    "supplied": "the pressure that the recording supplies",
}


@dataclass(frozen=True)
class ProbeRows:
    """The rows of one probe.

    Attributes:
        probe: where they come from.
        measured: b, shape [rows].
        fitted: A theta, shape [rows].
        scale: size of each row, in the unit of b, shape [rows].
        deviation: standard deviation of each row from noise and model error, shape [rows].
    """

    probe: Probe
    measured: np.ndarray
    fitted: np.ndarray
    scale: np.ndarray
    deviation: np.ndarray

    @cached_property
    def names(self) -> list[str]:
        """Of all test fields."""
        return [n for f in self.probe.fields for n in f.names]

    @cached_property
    def window(self) -> np.ndarray:
        """Index of each row's window, shape [rows]."""
        found: np.ndarray = np.flatnonzero(self.probe.keep) // len(self.names)
        return found

    @cached_property
    def field(self) -> np.ndarray:
        """Index of each row's test field, shape [rows]."""
        found: np.ndarray = np.flatnonzero(self.probe.keep) % len(self.names)
        return found

    @property
    def used(self) -> np.ndarray:
        """Share of the test fields that each window uses, shape [windows]."""
        found: np.ndarray = self.probe.keep.reshape(-1, len(self.names)).mean(axis=1)
        return found

    @property
    def white(self) -> np.ndarray:
        """Residuals in standard deviations, NaN where not used, shape [windows, fields]."""
        found = np.full(self.probe.keep.shape, np.nan)
        found[self.probe.keep] = (self.measured - self.fitted) / self.deviation
        return found.reshape(-1, len(self.names))

    @cached_property
    def pushed(self) -> np.ndarray:
        """Which test fields a measured tool works on, shape [fields]."""
        families = []
        for f in self.probe.fields:
            own = np.zeros(len(f.names), dtype=bool)
            for psi in f.acting(self.probe.motion).values():
                own |= np.any(psi != 0.0, axis=(0, 2))
            families.append(own)
        found: np.ndarray = np.concatenate(families)
        return found

    def curves(self) -> dict[str, tuple[np.ndarray, ...]]:
        """Mean forces of windows for every field that a tool works on, as ``fit_over_time``."""
        weight = self.probe.windows.chi.sum(axis=1)
        found: dict[str, tuple[np.ndarray, ...]] = {}
        for n in np.flatnonzero(self.pushed):
            rows = self.field == n
            window = self.window[rows]
            middle = self.probe.windows.ends[window].mean(axis=1)
            values = (self.measured, self.deviation, self.fitted)
            measured, deviation, fitted = (v[rows] / weight[window] for v in values)
            found[self.names[n]] = (middle, measured, deviation, fitted)
        return found


def probe_rows(fit: WeakFit) -> list[ProbeRows]:
    """The rows of a weak fit, probe by probe."""
    system = fit.system
    deviation = np.hypot(fit.noise, fit.error * system.scale)
    fitted = system.A @ fit.theta
    found, start = [], 0
    for probe in fit.problem.probes:
        own = slice(start, start + int(probe.keep.sum()))
        start = own.stop
        found.append(
            ProbeRows(
                probe,
                fitted[own] + fit.residual[own],
                fitted[own],
                system.scale[own],
                deviation[own],
            )
        )
    return found


def weak_report(answer: Identification, path: Path) -> None:
    """Write the report of a weak identification.

    Args:
        answer: of ``identify`` with method ``weak``.
        path: HTML file to write.

    Raises:
        ValueError: the answer comes from another method.
    """
    fit = answer.weak
    if fit is None:
        raise ValueError(f"a report of the weak form needs its rows, not those of {answer.method}")
    probes = probe_rows(fit)
    page = Report(f"Identified: {answer.material.law.name}")
    _parameters(page, answer, fit)
    _equations(page, answer, fit, probes)
    for rows in probes:
        page.heading(rows.probe.name.capitalize())
        _probe(page, rows)
    page.heading("What the intervals do not hold")
    page.paragraph(
        "Intervals follow from noise in tracks and forces and from a model error that makes the"
        " residual as large as its covariance says. A wrong law, density, geometry or statement"
        " about a face, or clocks of force and tracks that differ, can move the parameters further"
        " than that; look for patterns in the residuals."
    )
    page.write(path)


def _parameters(page: Report, answer: Identification, fit: WeakFit) -> None:
    rows = []
    for key, p in answer.material.parameters().items():
        half = "given" if p.std is None else f"{1.96 * p.std:.2g}"
        removed = f"{fit.bias[key]:+.2g}" if key in fit.bias else ""
        name = f"{key} (derived)" if p.derived else key
        rows.append([name, f"{p.value:.6g}", half, "" if p.unit == "-" else p.unit, removed])
    page.paragraph(f"Kirchhoff stress: {answer.material.law.equation}")
    page.table(["parameter", "value", "± 95 %", "unit", "noise bias removed"], rows)
    page.paragraph(
        "Noise in the tracks stands on both sides of the balance, so that it shifts the answer on"
        " average; the last column is what was taken off for it."
    )


def _equations(page: Report, answer: Identification, fit: WeakFit, probes: list[ProbeRows]) -> None:
    details = answer.details
    page.heading("Equations")
    facts = [
        ["rows", f"{answer.rows}"],
        ["rows that carry the answer", f"{details['effective_rows']:.3g}"],
        ["condition number of the weighted columns", f"{answer.condition:.3g}"],
        ["estimator", str(details["estimator"])],
        ["pressure is balanced by", PRESSURES[str(details["pressure"])]],
        ["residual, rms share of a row's size", f"{answer.residual:.3g}"],
        ["residual, rms in units of the noise alone", f"{details['noise_misfit']:.3g}"],
        ["model error, share of a row's size", f"{fit.error:.3g}"],
    ]
    page.table(["of the whole system", ""], facts)
    page.paragraph(
        "A row's size is the integral of |stress| |gradient of the test field| over its window."
        " Its standard deviation, in the figures below, holds the noise of tracks and forces and"
        " the model error."
    )
    values = [(r.measured / r.scale, r.fitted / r.scale, r.deviation / r.scale) for r in probes]
    figure = fit_of_rows(*(np.concatenate(v) for v in zip(*values, strict=True)))
    page.figure(
        figure,
        "All rows. Left: measured against fitted side as shares of the row's size; on the line"
        " they agree. Right: residuals, and the standard normal density; residuals beyond the"
        " axis are counted in the last bins.",
    )


def _probe(page: Report, rows: ProbeRows) -> None:
    probe = rows.probe
    page.table(["tracks and forces", ""], _facts(rows))
    forces = {name: (f.time, f.value) for name, f in probe.forces.items()}
    shown = " Above: measured forces of the material on the tools." if forces else ""
    page.figure(
        forces_and_windows(forces, probe.windows.ends, rows.used),
        "Windows in time, in four lanes; the paler one is, the fewer test fields it uses." + shown,
    )
    curves = rows.curves()
    if curves:
        chosen = dict(list(curves.items())[:MOST_PANELS])
        left = len(curves) - len(chosen)
        page.figure(
            fit_over_time(chosen),
            "Test fields that move with a tool: the force on the body, less weight and inertia, as"
            " the mean of each window, and the integral of the fitted stress. Bars are 95 %."
            + (f" {left} more are not shown." if left else ""),
        )
    page.figure(
        residual_map(rows.white, probe.windows.ends.mean(axis=1), rows.names),
        "Residuals by window (across) and test field (down), named by direction and by the place of"
        " its spline along x y z, from 0 at the lower face; grey rows are not used, because their"
        " field meets a face of unknown force. Above: their root mean square, which is near 1 where"
        " the row's standard deviation explains it.",
    )


def _facts(rows: ProbeRows) -> list[list[str]]:
    probe = rows.probe
    fit, ends = probe.fit, probe.windows.ends
    bases = [
        f"{axis}: {_count(len(s.breaks) - 1, 'span')} of degree {s.degree}"
        for axis, s in zip("xyz", fit.space.scalar.axes, strict=True)
    ]
    spans = np.diff(fit.time.breaks)
    faces = [
        f"{'xyz'[f.axis]}{'-+'[f.side]} {f.condition} {f.tool}".strip() for f in probe.body.faces
    ]
    found = [
        ["splines in space", "; ".join(bases)],
        ["symmetry", fit.space.symmetry.describe() or "none found"],
        ["splines in time", f"{_count(len(spans), 'span')}, the shortest {_si(spans.min(), 's')}"],
        ["noise of a coordinate", _si(fit.noise, "m")],
        ["misfit of the tracks", _si(fit.misfit, "m")],
        ["error at held-out tracks", _si(fit.held_out, "m")],
        ["windows", f"{len(ends)} of {_si(float(np.diff(ends, axis=1).mean()), 's')}"],
        ["rows used", f"{len(rows.measured)} of {len(probe.keep)}"],
        ["faces", "; ".join(faces)],
    ]
    for tool, force in probe.forces.items():
        found.append([f"noise of the force on {tool}", _si(force.noise, "N")])
        if force.fast is not None:
            told = f"{100.0 * force.fast:.2g} % of its rms"
            found.append([f"force on {tool} that swings faster than half the frame rate", told])
    return found


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _si(value: float, unit: str) -> str:
    """A value with three digits and the prefix that suits it."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.1g} {unit}"
