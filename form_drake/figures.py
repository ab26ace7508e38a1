"""Figures of the reports; matplotlib is imported where it is used."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from form_drake.mpm.prediction import Prediction
from form_drake.records import Recording


def _figure(width: float, height: float) -> Any:
    """A figure of its own, in inches, that no window or session state knows of."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def _axes(figure: Any, columns: int, index: int, points: np.ndarray, title: str) -> Any:
    axes = figure.add_subplot(1, columns, index, projection="3d")
    centre, half = points.mean(axis=0), 0.55 * np.ptp(points, axis=0).max()
    for name, middle in zip("xyz", centre, strict=True):
        getattr(axes, f"set_{name}lim")(middle - half, middle + half)
        getattr(axes, f"set_{name}ticks")([])
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=18, azim=-55)
    axes.set_title(title, fontsize=10)
    return axes


def motion_strip(recording: Recording, count: int = 5) -> Any:
    """Snapshots of the recorded points, coloured by their height at rest."""
    figure = _figure(3 * count, 3.2)
    everything = recording.p_WQ.reshape(-1, 3)
    height = recording.reference[:, 2]
    for i, frame in enumerate(np.linspace(0, recording.frames - 1, count).astype(int)):
        title = f"t = {1e3 * recording.time[frame]:.0f} ms"
        axes = _axes(figure, count, i + 1, everything, title)
        axes.scatter(*recording.p_WQ[frame].T, c=height, cmap="viridis", s=5)
    return figure


def most_deformed(recording: Recording) -> int:
    """Frame in which the points are squeezed most: least spread about their centroid."""
    spread = np.ptp(recording.p_WQ, axis=1).min(axis=1)
    return int(np.argmin(spread))


def before_and_after(unseen: Recording, before: Prediction, after: Prediction) -> Any:
    """The unseen motion's most deformed frame: truth, and both predictions coloured by error."""
    figure = _figure(13, 4.4)
    frame = most_deformed(unseen)
    true = unseen.p_WQ[frame]
    predicted = {"before": before, "after": after}
    errors = {
        k: 1e3 * np.linalg.norm(p.recording.p_WQ[frame] - true, axis=1)
        for k, p in predicted.items()
    }
    top = max(float(e.max()) for e in errors.values())
    axes = _axes(figure, 3, 1, true, f"true, t = {1e3 * unseen.time[frame]:.0f} ms")
    axes.scatter(*true.T, c="0.35", s=6)
    for i, (name, prediction) in enumerate(predicted.items()):
        title = f"predicted {name} (mean error {errors[name].mean():.2g} mm)"
        axes = _axes(figure, 3, i + 2, true, title)
        points = prediction.recording.p_WQ[frame]
        shown = axes.scatter(*points.T, c=errors[name], cmap="inferno", vmin=0, vmax=top, s=6)
    figure.colorbar(shown, ax=figure.axes, shrink=0.7, label="distance to the truth [mm]")
    return figure


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
