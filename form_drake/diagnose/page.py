"""The report of a diagnosis: one HTML page."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from form_drake.diagnose.advice import Limit
from form_drake.diagnose.channel import Channel
from form_drake.diagnose.diagnosis import Diagnosis
from form_drake.diagnose.figures import gaps, moments, overlay, passes, places, ranking, where
from form_drake.diagnose.ledger import BOOKS, Ledger
from form_drake.diagnose.model import Model
from form_drake.diagnose.rollout import Astray
from form_drake.diagnose.score import DETECTED, Score, named_from
from form_drake.diagnose.thresholds import Nulls
from form_drake.diagnose.verdict import LEAST
from form_drake.report import Report


def diagnosis_page(
    found: Diagnosis,
    nulls: Nulls,
    *,
    command: str = "",
    scenarios: Sequence[str] = (),
    played: str = "",
) -> Report:
    """The page, yet to be written.

    Args:
        found: of a diagnosis.
        nulls: that its thresholds come from.
        command: that diagnoses again with a further recording.
        scenarios: names of files in which the station does what should be recorded next.
        played: name of the file that plays a held-out motion.
    """
    page, thresholds = Report(found.sentence()), nulls.thresholds
    for doubt in found.doubts:
        page.paragraph(doubt)
    _specimen(page, found)
    _left(page, found)
    _passes(page, found, thresholds)
    if found.channels:
        _held_out(page, found, played)
    if found.unverified and not found.channels:
        page.heading("Held-out motion")
    if found.unverified:
        page.paragraph(f"Held-out motion verifies nothing: {found.unverified}.")
    _next(page, found, thresholds, command, scenarios)
    page.heading("Not verified")
    page.paragraph(nulls.basis)
    return page


def _with_std(model: Model, key: str) -> str:
    told = f"{model.values[key]:.5g}"
    return f"{told} ± {model.stds[key]:.2g}" if key in model.stds else told


def _specimen(page: Report, found: Diagnosis) -> None:
    last = found.naming.model
    page.heading("The specimen")
    rows = [
        [key, *(_with_std(one, key) for one in (found.without, last)), last.law.unit(key)]
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
                    "not told" if c.told is None else f"{c.told:.2g}",
                    c.effect.unit,
                    ", ".join(f"{k} {v:.4g}" for k, v in c.shape.items()),
                ]
                for c in last.causes
            ],
        )


def _left(page: Report, found: Diagnosis) -> None:
    """Where and when something is left, before anything was added and at the end."""
    before, after = found.ledgers[0], found.ledgers[-1]
    page.heading("Where and when")
    page.table(
        ["ledger", "rows", "mean square before", "after", "onset before [s]", "after [s]"],
        [row for pair in zip(before, after, strict=True) for row in _ledger_rows(*pair)],
    )
    page.paragraph(
        "Each window is whitened by itself: its mean square is one where nothing but noise is left. The"
        " onset is the middle of the first of two windows running in which more is left than noise leaves in one"
        " window of a thousand; what the grid costs can be more than that from the start."
    )
    caption = "Where it is left in the body free of stress, looking along each axis"
    circles = any("radius" in c.shape for c in found.naming.model.causes)
    caption += "; circles: what was found there" if circles else ""
    blank = any(np.isnan(one.heat).any() for one in before)
    caption += "; blank: no test field is there." if blank else "."
    page.figure(places(before, after, found.naming.model.causes), caption)
    page.figure(moments(before, after), "When it is left.")
    _astray(page, found)


def _ledger_rows(before: Ledger, after: Ledger) -> list[list[str]]:
    rows = []
    told = ("interior", "force on tools", "force that none should feel", "way of held faces")
    for book, name in zip(BOOKS, told, strict=True):
        means = [one.mean(book) for one in (before, after)]
        if None in means:
            continue
        onsets = [one.of(book).onset for one in (before, after)]
        starts = ["never" if onset is None else f"{onset:.2f}" for onset in onsets]
        count = str(int(np.sum(before.book == book)))
        rows.append([f"{before.name}, {name}", count, *(f"{m:.3g}" for m in means), *starts])
    return rows


def _astray(page: Report, found: Diagnosis) -> None:
    """How far the simulation goes another way, before anything was added and at the end."""
    before, after = found.astray[0], found.astray[-1]
    page.table(
        ["simulation is off by", "before", "after", "noise", "grid"],
        [row for pair in zip(before, after, strict=True) for row in _astray_rows(*pair)],
    )
    page.paragraph(
        "Root mean squares between the motions that were read, beyond noise, and without what a finer grid"
        " changes of the simulation; where nothing is missing, chance leaves as much as the noise or less. Volumes"
        " are shares of those free of stress."
    )
    first, last = ([one["rollout"] for one in part] for part in (before, after))
    label = "displacement off by [um]"
    shown = places(first, last, found.naming.model.causes, label=label, scale=1e6)
    page.figure(shown, "Where the simulation is off, looking along each axis.")


def _astray_rows(before: Mapping[str, Astray], after: Mapping[str, Astray]) -> Iterator[list[str]]:
    told = {"rollout": (1e3, "displacement [mm]"), "volume": (1e2, "volume [%]")}
    for book, one in before.items():
        scale, name = told[book]
        values = (one.whole, after[book].whole, one.noise)
        grid = "not known" if one.grid is None else f"{scale * one.grid:.2g}"
        yield [f"{one.name}, {name}", *(f"{scale * v:.2g}" for v in values), grid]


def _passes(page: Report, found: Diagnosis, thresholds: Mapping[str, float]) -> None:
    page.heading("Pass by pass")
    page.figure(passes(found.ledgers), "What is left when each pass begins, by ledger.")
    for n, one in enumerate(found.naming.passes, start=1):
        page.heading(f"Pass {n}: {_added(one.best)}")
        left = float(one.match.left @ one.match.left / len(one.match.left))
        page.paragraph(f"What is left, all windows whitened together, mean square: {left:.3g}.")
        if one.gone:
            page.paragraph(
                f"{', '.join(one.gone)}: added first, and needless beside what was added later."
            )
        if one.alike:
            page.paragraph(f"These recordings cannot tell it from {', '.join(one.alike)}.")
        if one.rivals:
            page.paragraph(f"Nearly as good: {', '.join(one.rivals)}.")
        if one.refused:
            told = (
                f"{', '.join(one.refused)}: simulated, it explains less than its threshold demands."
            )
            page.paragraph(told)
        page.figure(
            ranking(one.ranked, thresholds, max(LEAST, one.doubt)), "How much each effect explains."
        )
        page.figure(where(one.match), "What is left of every test field.")


def _held_out(page: Report, found: Diagnosis, played: str) -> None:
    page.heading("Held-out motion")
    page.table(
        ["", "before", "after", "noise", "floor", "grid", "closed"],
        [
            [
                c.name,
                *(f"{v:.3g} {c.unit}" for v in (c.before, c.after, c.noise, c.floor, c.grid)),
                _closed(c),
            ]
            for c in found.channels
        ],
    )
    if not found.naming.added:
        page.paragraph("Nothing was added: before and after are one prediction.")
    if found.check is not None and found.check.unread:
        page.paragraph(f"The balance of held-out motion is not compared: {found.check.unread}.")
    page.paragraph(
        "Errors are root mean squares of the predictions' own: what noise adds to a mean square is taken off."
        " The floor is what noise leaves of them by chance, and closed the share of the gap above it that is."
    )
    aside = sum(not c.counts for c in found.channels)
    page.paragraph(
        f"{aside} of {len(found.channels)} are too near to floor or grid, and count for nothing."
    )
    if aside < len(found.channels):
        caption = "Errors before and after, where the gap is clear of floor and grid."
        page.figure(gaps(found.channels), caption)
    if played:
        page.paragraph(f"{played} plays the first of them: measured, predicted before and after.")
    _otherwise(page, found)
    if found.check is None or found.after is None:
        return
    pairs = zip(found.check.before.recordings, found.after.recordings, strict=True)
    for seen, (a, b) in zip(found.check.measured, pairs, strict=True):
        page.figure(overlay(seen, a, b), "Measured and predicted.")


def _otherwise(page: Report, found: Diagnosis) -> None:
    """Held-out motion without one of several effects, and with wrong ones."""
    if found.removed:
        page.table(
            ["without", *(c.name for c in found.channels)],
            [
                [r.effect.id, *(f"{c.before:.3g} {c.unit}" for c in r.channels)]
                for r in found.removed
            ],
        )
        page.paragraph(
            "Errors where one of the effects is taken out again, all others and the moduli refitted."
        )
    if found.placebos:
        page.table(
            ["placebo", "fitted", "unit", *(f"{c.name} closed" for c in found.channels)],
            [
                [
                    p.effect.id,
                    f"{p.cause.coefficient:.3g}",
                    p.effect.unit,
                    *map(_closed, p.channels),
                ]
                for p in found.placebos
            ],
        )
        page.paragraph(
            "Placebos are effects of other classes, fitted to the same recordings: the best of them by"
            " its score, and one drawn by lot. What is named should close more than they do."
        )


def _closed(channel: Channel) -> str:
    return f"{100.0 * channel.closure:.0f} %" if channel.counts else "too near to floor or grid"


def _next(
    page: Report,
    found: Diagnosis,
    thresholds: Mapping[str, float],
    command: str,
    scenarios: Sequence[str],
) -> None:
    """What these recordings can show, and what to record next."""
    advice = found.advice
    page.heading("What to record next")
    for sentence in advice.sentences() or ("These recordings leave nothing open.",):
        page.paragraph(sentence)
    if scenarios:
        page.paragraph(
            "The arm of a station does what it can of these motions by form-drake simulate with:"
            f" {', '.join(scenarios)}."
        )
    if command:
        page.paragraph(f"With a further recording NEXT.h5: {command}")
    page.table(
        ["effect", "seen from", "named from", "likely sizes", "unit", "missed"],
        [
            [
                one.effect.id,
                *(_size(one, share) for share in (1.0, _naming(one, thresholds))),
                " to ".join(f"{v:g}" for v in one.effect.prior),
                one.effect.unit,
                f"{100.0 * one.missed:.0f} %",
            ]
            for one in advice.limits
        ],
    )
    page.paragraph(
        "Seen are five standard deviations, at the place and direction at which the effect explains"
        " most, or the median over all where it explains nothing; named is what exceeds its threshold,"
        " which is the higher the more places and directions are tried. Missed are likely sizes, evenly by their"
        " logarithm, that are not seen."
    )


def _naming(one: Limit, thresholds: Mapping[str, float]) -> float:
    """Times the least size that is seen, at which a score exceeds its threshold."""
    wanted = max(thresholds.get(one.effect.id, 0.0), LEAST)
    return named_from(one.effect, wanted) / DETECTED


def _size(one: Limit, share: float) -> str:
    size = share * one.size
    return f"{size:.2g}" if size < one.effect.prior[1] else f"over {one.effect.prior[1]:g}"


def _added(best: Score | None) -> str:
    return "nothing stands out" if best is None else f"{best.effect.id} stands out"
