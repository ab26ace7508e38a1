"""The report of a diagnosis: one HTML page."""

from collections.abc import Mapping
from pathlib import Path

from form_drake.diagnose.diagnosis import Diagnosis
from form_drake.diagnose.figures import gaps, overlay, ranking, where
from form_drake.diagnose.score import Score
from form_drake.diagnose.verdict import LEAST
from form_drake.report import Report

UNVERIFIED = (
    "Thresholds come from neo-Hookean blocks that were pressed and shaken between bonded faces,"
    " simulated with this solver and with finite elements, with noise of 50 um in tracks and of 1 % in"
    " forces; other bodies, laws, motions and noises may need others. Where an effect acts, and how"
    " large its place is, was found before it was added and is not found again after."
)


def diagnosis_page(found: Diagnosis, thresholds: Mapping[str, float], path: Path) -> None:
    """Write the page."""
    page = Report(found.sentence())
    last = found.naming.model
    page.heading("The specimen")
    rows = [
        [key, f"{found.without.values[key]:.5g}", f"{last.values[key]:.5g}", last.law.unit(key)]
        for key in last.law.keys
    ]
    page.table(["parameter", "without effects", "with them", "unit"], rows)
    if last.causes:
        page.table(
            ["effect", "coefficient", "standard deviation", "unit", "where"],
            [
                [
                    c.effect.id,
                    f"{c.coefficient:.4g}",
                    f"{c.std:.2g}",
                    c.effect.unit,
                    ", ".join(f"{k} {v:.4g}" for k, v in c.shape.items()),
                ]
                for c in last.causes
            ],
        )
    for n, one in enumerate(found.naming.passes, start=1):
        page.heading(f"Pass {n}: {_added(one.best)}")
        left = float(one.match.left @ one.match.left / len(one.match.left))
        page.paragraph(f"What is left, mean square in units of the noise: {left:.3g}.")
        if one.alike:
            page.paragraph(f"These recordings cannot tell it from {', '.join(one.alike)}.")
        if one.rivals:
            page.paragraph(f"Nearly as good: {', '.join(one.rivals)}.")
        page.figure(ranking(one.ranked, thresholds, LEAST), "How much each effect explains.")
        page.figure(where(one.match), "Where and when the balance is not closed.")
    if found.channels:
        page.heading("Held-out motion")
        page.table(
            ["", "before", "after", "floor", "grid", "closed"],
            [
                [
                    c.name,
                    *(f"{v:.3g} {c.unit}" for v in (c.before, c.after, c.floor, c.grid)),
                    f"{100.0 * c.closure:.0f} %" if c.counts else "too near to floor or grid",
                ]
                for c in found.channels
            ],
        )
        page.figure(gaps(found.channels), "Errors before and after.")
        before, after = found.simulated
        for seen, a, b in zip(found.measured, before, after, strict=True):
            page.figure(overlay(seen, a, b), "Measured and predicted.")
    page.heading("Not verified")
    page.paragraph(UNVERIFIED)
    page.write(path)


def _added(best: Score | None) -> str:
    return "nothing stands out" if best is None else f"{best.effect.id} stands out"
