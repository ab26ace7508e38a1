"""Figures of a diagnosis; matplotlib is imported where it is used."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from form_drake.diagnose.channel import Channel
from form_drake.diagnose.ledger import BOOKS, Ledger
from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Cause
from form_drake.diagnose.rollout import Astray
from form_drake.diagnose.score import Score
from form_drake.diagnose.verify import there
from form_drake.motion import Body
from form_drake.records import Recording


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def ranking(found: Sequence[Score], thresholds: Mapping[str, float], least: float) -> Any:
    """Scores as bars, and the band in which nothing missing may lie."""
    figure = _figure(8, 0.28 * len(found) + 1.0)
    axes = figure.add_subplot()
    names = [s.effect.id for s in found][::-1]
    limits = [max(thresholds.get(n, 0.0), least) for n in names]
    values = [max(s.score, 0.5) for s in found][::-1]
    colours = ["tab:red" if v > w else "tab:blue" for v, w in zip(values, limits, strict=True)]
    axes.barh(names, limits, color="0.88", height=0.9, label="where nothing is missing")
    axes.barh(names, values, color=colours, height=0.5)
    axes.set_xscale("log")
    axes.set_xlim(0.5, None)
    axes.set_xlabel("score")
    axes.legend(loc="lower right", frameon=False)
    return figure


def where(match: Match) -> Any:
    """What is left of every test field over time, in standard deviations, probe by probe."""
    probes = match.problem.probes
    figure = _figure(5.5 * len(probes), 4.0)
    ends = np.cumsum([0, *(int(p.keep.sum()) for p in probes)])
    parts = [match.left[a:z] for a, z in pairwise(ends)]
    top = max(float(np.abs(match.left).max()), 1.0)
    for n, (probe, left) in enumerate(zip(probes, parts, strict=True)):
        shown = np.full(probe.keep.shape, np.nan)
        shown[probe.keep] = left
        axes = figure.add_subplot(1, len(probes), n + 1)
        time = probe.windows.ends.mean(axis=1)
        image = axes.pcolormesh(
            time,
            np.arange(shown.size // len(time)),
            shown.reshape(len(time), -1).T,
            cmap="RdBu",
            vmin=-top,
            vmax=top,
            shading="nearest",
        )
        axes.set_title(probe.name)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("test field")
    figure.colorbar(image, ax=figure.axes, label="left over [standard deviations]")
    return figure


def places(
    before: Sequence[Ledger | Astray],
    after: Sequence[Ledger | Astray],
    causes: Sequence[Cause] = (),
    *,
    label: str = "mean square left over, less that of noise",
    scale: float = 1.0,
) -> Any:
    """Where something is left in the body, seen along each axis: probe by probe, first and last.

    Circles are the balls of the causes that have a place.

    Args:
        before: what is left at first, probe by probe.
        after: the same at the end.
        causes: what was found.
        label: of the colours, the brightest of which is one at least.
        scale: of what they stand for.
    """
    told = [one for pair in zip(before, after, strict=True) for one in pair]
    figure = _figure(9.0, 2.3 * len(told) + 0.3)
    grid = figure.subplots(len(told), 3, squeeze=False)
    looks = [[scale * _seen(one.heat, along) for along in range(3)] for one in told]
    top = max([1.0, *(float(np.nanmax(look)) for own in looks[::2] for look in own)])
    balls = [c.shape for c in causes if "radius" in c.shape]
    for n, (line, one, own) in enumerate(zip(grid, told, looks, strict=True)):
        for along, (axes, look) in enumerate(zip(line, own, strict=True)):
            image = _place(axes, one.body, along, look, top, balls)
        line[1].set_title(f"{one.name}, {'after' if n % 2 else 'before'}")
    figure.colorbar(image, ax=grid.ravel().tolist(), label=label)
    return figure


def _seen(heat: np.ndarray, axis: int) -> np.ndarray:
    """Means along an axis, not a number where no cell is seen."""
    count = np.isfinite(heat).sum(axis=axis)
    found: np.ndarray = np.nansum(heat, axis=axis) / np.where(count, count, np.nan)
    return found


def _place(
    axes: Any,
    body: Body,
    along: int,
    look: np.ndarray,
    top: float,
    balls: Sequence[Mapping[str, float]],
) -> Any:
    """One look through the body along an axis."""
    from matplotlib.patches import Circle

    across, up = [a for a in range(3) if a != along]
    low, high = 1e3 * body.low, 1e3 * body.high
    image = axes.imshow(
        np.maximum(look, 0.0).T,
        origin="lower",
        extent=(low[across], high[across], low[up], high[up]),
        cmap="viridis",
        vmin=0.0,
        vmax=top,
    )
    for ball in balls:
        centre = (1e3 * ball["xyz"[across]], 1e3 * ball["xyz"[up]])
        axes.add_patch(Circle(centre, 1e3 * ball["radius"], fill=False, color="tab:red", lw=1.5))
    axes.set_xlabel(f"{'xyz'[across]} [mm]")
    axes.set_ylabel(f"{'xyz'[up]} [mm]")
    return image


def moments(before: Sequence[Ledger], after: Sequence[Ledger]) -> Any:
    """When something is left: mean squares of windows, first and last, and what noise may reach."""
    figure = _figure(5.0 * len(before), 3.2)
    for n, (first, last) in enumerate(zip(before, after, strict=True)):
        axes = figure.add_subplot(1, len(before), n + 1)
        rows = np.maximum(np.bincount(first.window, minlength=len(first.time)), 1)
        for one, name, colour in ((first, "before", "0.5"), (last, "after", "tab:green")):
            axes.plot(one.time, one.spent / rows, "o-", ms=3, color=colour, label=name)
        axes.plot(first.time, first.limit / rows, "k--", lw=1, label="limit of noise")
        if first.onset is not None:
            axes.axvline(first.onset, color="tab:red", lw=1, label="onset")
        _decades(axes)
        axes.set_title(first.name)
        axes.set_xlabel("middle of the window [s]")
        axes.set_ylabel("mean square left over")
        axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4)
    return figure


def _decades(axes: Any) -> None:
    """A logarithmic axis upwards that is labelled in plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def passes(found: Sequence[Sequence[Ledger]]) -> Any:
    """Mean squares left over when each pass begins, by probe and ledger."""
    figure = _figure(5.0 * len(found[0]), 2.8)
    for n, told in enumerate(zip(*found, strict=True)):
        axes = figure.add_subplot(1, len(found[0]), n + 1)
        for book in BOOKS:
            means = [one.mean(book) for one in told]
            if None not in means:
                axes.plot(np.arange(1, len(told) + 1), means, "o-", label=book)
        axes.axhline(1.0, color="k", ls="--", lw=1, label="noise")
        _decades(axes)
        axes.set_xticks(np.arange(1, len(told) + 1))
        axes.set_title(told[0].name)
        axes.set_xlabel("pass")
        axes.set_ylabel("mean square left over")
        axes.legend(frameon=False)
    return figure


def gaps(channels: Sequence[Channel]) -> Any:
    """Errors on held-out motion after, and the floor, in units of the error before, where a gap counts."""
    channels = [c for c in channels if c.counts]
    figure = _figure(8, 0.5 * len(channels) + 1.2)
    axes = figure.add_subplot()
    at = np.arange(len(channels))
    for shift, name, colour in ((0.2, "before", "0.6"), (-0.2, "after", "tab:green")):
        axes.barh(
            at + shift,
            [getattr(c, name) / c.before for c in channels],
            0.36,
            color=colour,
            label=name,
        )
    for n, c in zip(at, channels, strict=True):
        axes.plot([c.floor / c.before] * 2, [n - 0.4, n + 0.4], "k--", lw=1)
    axes.set_yticks(at, [c.name for c in channels], parse_math=False)
    axes.set_xlabel("error beyond noise as a share of that before (dashed: floor)")
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def overlay(seen: Recording, before: Recording, after: Recording) -> Any:
    """Measured and predicted forces, along the axis on which they change most, and mean motion."""
    tools = list(seen.forces)
    figure = _figure(9, 2.6 * (len(tools) + 1))
    rows = []
    for t in tools:
        axis = int(np.argmax(np.ptp(seen.forces[t].value, axis=0)))
        every = (r.forces[t] for r in (seen, before, after))
        curves = [(one.time, np.asarray(one.value)[:, axis]) for one in every]
        rows.append((f"force on {t} along {'xyz'[axis]} [N]", curves))
    use = there(seen)
    count = np.where(use.any(axis=1), use.sum(axis=1), np.nan)
    squares = [
        np.where(use, np.sum((r.p_WQ - seen.p_WQ) ** 2, axis=2), 0.0) for r in (before, after)
    ]
    for n, (label, curves) in enumerate(rows):
        axes = figure.add_subplot(len(rows) + 1, 1, n + 1)
        for (time, value), name, style in zip(
            curves, ("measured", "before", "after"), ("k.", "-", "-"), strict=True
        ):
            axes.plot(time - seen.time[0], value, style, ms=2, label=name)
        axes.set_ylabel(label)
        axes.legend(frameon=False)
    axes = figure.add_subplot(len(rows) + 1, 1, len(rows) + 1)
    for square, name in zip(squares, ("before", "after"), strict=True):
        axes.plot(seen.time - seen.time[0], 1e3 * np.sqrt(square.sum(axis=1) / count), label=name)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("distance of tracks, rms [mm]")
    axes.legend(frameon=False)
    return figure
