"""Figures of the reports; matplotlib is imported where it is used."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from form_drake.perceive.correlate import ALIKE

UNLIKE = (1e-5, 1.0 - ALIKE)  # range of 1 - likeness that is coloured
ROOM = 12  # pixels about the points that are shown


def _figure(width: float, height: float) -> Any:
    """A figure of its own, in inches, that no window or session state knows of."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def error_over_time(time: np.ndarray, curves: Mapping[str, np.ndarray]) -> Any:
    """Root mean square distances [mm] over time [s], on a logarithmic scale."""
    figure = _figure(8, 3.2)
    axes = figure.add_subplot()
    for name, curve in curves.items():
        axes.semilogy(1e3 * time, np.maximum(curve, 1e-6), label=name)
    axes.set_xlabel("time [ms]")
    axes.set_ylabel("rms distance [mm]")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure


def force_over_time(curves: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Any:
    """Forces of several sources by component; those below 5 % of the largest are left out.

    Args:
        curves: by source: stamps [s] and forces [N], shape [samples, 3].
    """
    top = max(float(np.abs(force).max(initial=0.0)) for _, force in curves.values())
    factor, unit = (1.0, "N") if top >= 1.0 else (1e3, "mN")
    figure = _figure(8, 3.4)
    figure.set_layout_engine("constrained")
    axes = figure.add_subplot()
    for n, (name, (time, force)) in enumerate(curves.items()):
        style = ("-", "--", "-.", ":")[n % 4]
        for axis, component in zip("xyz", force.T, strict=True):
            if np.abs(component).max(initial=0.0) > 0.05 * top:
                axes.plot(time, factor * component, style, lw=1.4, label=f"{name}, {axis}")
    axes.set(xlabel="time [s]", ylabel=f"force [{unit}]")
    axes.grid(alpha=0.3)
    if axes.lines:
        axes.legend(fontsize=8)
    return figure


def _panels(count: int, height: float) -> tuple[Any, list[Any]]:
    """A figure of up to three panels in a row."""
    columns = min(count, 3)
    lines = -(-count // columns)
    figure = _figure(3.0 + 3.2 * columns, 0.4 + height * lines)
    figure.set_layout_engine("constrained")
    return figure, list(np.ravel(figure.subplots(lines, columns, squeeze=False)))


def forces_and_windows(
    forces: Mapping[str, tuple[np.ndarray, np.ndarray]], ends: np.ndarray, used: np.ndarray
) -> Any:
    """Components of measured forces over time, and the windows that the rows come from.

    Args:
        forces: stamps [s] and forces [N], shape [samples, 3], by tool; may be empty.
        ends: first and last moment of each window [s], shape [windows, 2].
        used: share of the test fields that each window uses, shape [windows].
    """
    figure = _figure(9, 4.6 if forces else 2.0)
    figure.set_layout_engine("constrained")
    ratios = [3, 2] if forces else [1]
    axes = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
    if forces:
        top = max(float(np.abs(value).max()) for _, value in forces.values())
        for n, (name, (time, value)) in enumerate(forces.items()):
            for axis, component in zip("xyz", value.T, strict=True):
                if np.abs(component).max() > 0.01 * top:
                    style = ("-", "--", "-.", ":")[n % 4]
                    axes[0].plot(time, component, style, label=f"{axis} on {name}")
        for start, end in ends[used > 0]:
            axes[0].axvspan(start, end, color="0.5", alpha=0.06, lw=0)
        axes[0].set_ylabel("force [N]")
        axes[0].legend(fontsize=8)
    lanes = np.arange(len(ends)) % 4
    bars = {"edgecolor": "white", "height": 0.8, "left": ends[:, 0]}
    colours = [(0.16, 0.40, 0.65, 0.15 + 0.85 * share) for share in used]
    axes[-1].barh(lanes, np.diff(ends, axis=1)[:, 0], color=colours, **bars)
    axes[-1].set(
        xlabel="time since the first frame [s]",
        ylabel="windows",
        yticks=[],
        ylim=(lanes.max() + 0.6, -0.6),
    )
    axes[-1].set_xlim(ends.min(), ends.max())
    return figure


def fit_over_time(curves: Mapping[str, tuple[np.ndarray, ...]]) -> Any:
    """Measured and fitted mean force of every window.

    Args:
        curves: by test field: middles of windows [s], measured force [N], its standard deviation
            [N], fitted force [N].
    """
    figure, panels = _panels(len(curves), 2.9)
    for (name, (time, measured, deviation, fitted)), axes in zip(
        curves.items(), panels, strict=False
    ):
        axes.errorbar(
            time, measured, 1.96 * deviation, fmt="o", ms=4, color="0.25", label="measured"
        )
        axes.plot(time, fitted, color="tab:orange", lw=1.6, label="fitted")
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("time [s]")
        axes.grid(alpha=0.3)
    for axes in panels[len(curves) :]:
        axes.set_axis_off()
    panels[0].set_ylabel("mean force in the window [N]")
    panels[0].legend(fontsize=8)
    return figure


def fit_of_rows(measured: np.ndarray, fitted: np.ndarray, deviation: np.ndarray) -> Any:
    """Measured against fitted side of rows, and their residuals; all as shares of a row's size."""
    figure, (axes, rest) = _panels(2, 3.4)
    low, high = float(np.min([measured, fitted])), float(np.max([measured, fitted]))
    ends = np.array([low, high]) + 0.06 * (high - low) * np.array([-1.0, 1.0])
    axes.plot(ends, ends, color="0.7", lw=1)
    axes.plot(fitted, measured, ".", ms=4, color="tab:blue", alpha=0.6)
    axes.set(xlabel="fitted, A \N{GREEK SMALL LETTER THETA}", ylabel="measured, b", aspect="equal")
    axes.set(xlim=ends, ylim=ends)
    axes.locator_params(nbins=5)
    white = (measured - fitted) / deviation
    edge = max(4.0, float(np.quantile(np.abs(white), 0.99)))
    bins = np.linspace(-edge, edge, 41)
    rest.hist(np.clip(white, -edge, edge), bins, density=True, color="tab:blue", alpha=0.6)
    rest.plot(bins, np.exp(-0.5 * bins**2) / np.sqrt(2.0 * np.pi), color="0.25", lw=1)
    rest.set(xlabel="residual [standard deviations]", ylabel="density", yticks=[])
    return figure


def residual_map(white: np.ndarray, middles: np.ndarray, names: Sequence[str]) -> Any:
    """Residuals in standard deviations by window and test field, and their size in each window.

    Args:
        white: residuals, NaN where a row is not used, shape [windows, fields].
        middles: of the windows [s].
        names: of the test fields.
    """
    most = 100
    height = 0.115 * min(max(len(names), 14), most)
    figure = _figure(9, 2.2 + height)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(
        2, 2, squeeze=False, height_ratios=[1.3, height], width_ratios=[8, 0.25], sharex="col"
    )
    above, axes = grid[:, 0]
    grid[0, 1].set_axis_off()
    at = np.arange(len(middles))
    square = np.nanmean(np.where(np.isnan(white).all(axis=1)[:, None], 0.0, white) ** 2, axis=1)
    above.bar(at, np.sqrt(square), color="0.55")
    above.axhline(1.0, color="tab:red", lw=1, ls="--")
    above.set_ylabel("rms")
    axes.set_facecolor("0.85")
    edge = max(3.0, float(np.nanquantile(np.abs(white), 0.99)))
    shown = axes.pcolormesh(
        at, np.arange(len(names)), white.T, cmap="RdBu_r", vmin=-edge, vmax=edge
    )
    every = -(-len(names) // most)
    axes.set_yticks(
        np.arange(len(names))[::every], list(names)[::every], fontsize=6, parse_math=False
    )
    axes.set_ylim(len(names) - 0.5, -0.5)
    step = -(-len(middles) // 12)
    axes.set_xticks(at[::step], [f"{m:.3g}" for m in middles[::step]])
    axes.set_xlabel("middle of the window [s]")
    figure.colorbar(shown, cax=grid[1, 1], label="residual [standard deviations]")
    return figure


def points_on_picture(
    rows: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]], titles: Sequence[str]
) -> Any:
    """Pictures of one camera with points on them.

    Args:
        rows: of each picture: grey values, places of points [px] (NaN: lost), their likeness, and where those
            that are lost were seen last [px].
        titles: of the pictures.
    """
    from matplotlib.colors import LogNorm

    figure = _figure(4.6 * len(rows), 3.9)
    shown = None
    for n, ((picture, pixel, likeness, lost), title) in enumerate(zip(rows, titles, strict=True)):
        axes = _picture(figure, len(rows), n + 1, picture, title)
        unlike = np.maximum(1.0 - likeness, UNLIKE[0])
        shown = axes.scatter(
            *pixel.T, c=unlike, s=9, cmap="plasma", norm=LogNorm(*UNLIKE), linewidths=0
        )
        axes.scatter(*lost.T, c="#00c8ff", s=22, marker="x", linewidths=1)
    _closer(figure.axes, np.concatenate([places for _, *two in rows for places in two[::2]]))
    figure.colorbar(shown, ax=figure.axes, shrink=0.8, label="1 - likeness")
    return figure


def rests_on_picture(
    picture: np.ndarray, pixel: np.ndarray, across: np.ndarray, out: np.ndarray
) -> Any:
    """What is wrong with points [um], on a picture: arrows in it, colours for what sticks out of the face."""
    figure = _figure(9, 6)
    axes = _picture(figure, 1, 1, picture, "")
    size = float(np.nanquantile(np.linalg.norm(across, axis=1), 0.9))
    arrows = axes.quiver(
        *pixel.T,
        *across.T,
        angles="xy",
        scale_units="xy",
        scale=max(size, 1e-9) / 14.0,
        color="#ffd21f",
        width=0.002,
    )
    axes.quiverkey(
        arrows, 0.05, -0.06, size, f"{size:.2g} um in the face", labelpos="E", color="#b08a00"
    )
    _closer([axes], pixel)
    most = float(np.nanquantile(np.abs(out), 0.95))
    shown = axes.scatter(*pixel.T, c=out, s=10, cmap="coolwarm", vmin=-most, vmax=most)
    figure.colorbar(shown, ax=axes, shrink=0.8, label="out of the face [um]")
    return figure


def likeness_over_time(
    time: np.ndarray, held: np.ndarray, likeness: np.ndarray, rest: Mapping[str, np.ndarray]
) -> Any:
    """Share of points that is held, likeness [frames, points] and root mean squares [um] over time [s]."""
    figure = _figure(11, 3.2)
    for n, label in enumerate(("share held", "likeness", "not shared [um]")):
        axes = figure.add_subplot(1, 3, n + 1)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    first, second, third = figure.axes
    first.plot(time, held)
    first.set_ylim(0.0, 1.05)
    second.plot(time, np.nanmedian(likeness, axis=1), label="median")
    second.plot(time, np.nanquantile(likeness, 0.05, axis=1), label="worst twentieth")
    for name, curve in rest.items():
        third.plot(time, curve, label=name)
    for axes in (second, third):
        axes.legend(fontsize=8)
    figure.tight_layout()
    return figure


def _closer(every: Sequence[Any], pixel: np.ndarray) -> None:
    """Show the part of pictures that holds some places [px]."""
    low, high = np.nanmin(pixel, axis=0) - ROOM, np.nanmax(pixel, axis=0) + ROOM
    for axes in every:
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(high[1], low[1])


def _picture(figure: Any, columns: int, index: int, picture: np.ndarray, title: str) -> Any:
    axes = figure.add_subplot(1, columns, index)
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255)
    axes.set_title(title, fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])
    return axes
