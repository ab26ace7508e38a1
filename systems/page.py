"""The recording of a viewer as one HTML file of limited size that plays in any browser."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from form_drake.files import write_text
from form_drake.systems.viewer import (
    COLOURS,
    FAINT,
    FORCE,
    LIVE,
    Frame,
    ParticleViewer,
    arrow,
    cloud,
    strongest,
)

LIMIT = 15_000_000  # bytes of a page
POINT = 33  # bytes of a point in a page
FRAME = 1_500  # bytes of a frame beside its points
FEWEST = 2_500  # points that a page keeps as long as it can give up frames
SLOWEST = 0.4  # share of the frames that a page keeps as long as it can give up points
FRAMES = "/material/frames"
WIDTH, HEIGHT = 300, 56  # of the force's curve [pixels]

STYLE = """
#legend { position: fixed; left: 12px; top: 12px; width: 300px; padding: 10px 12px;
  font: 13px/1.45 system-ui, sans-serif; color: #1d232b; background: rgba(255, 255, 255, .85);
  border-radius: 6px; pointer-events: none; }
#legend .bar { height: 10px; border-radius: 2px; margin-top: 4px; }
#legend .ends { display: flex; justify-content: space-between; }
#legend svg { display: block; margin: 6px 0 2px; }
"""
# Meshcat tells the time of its animation only through the actions that it plays.
SCRIPT = """
(() => { const T = %s, F = %s, end = T[T.length - 1];
  window.tellTime = () => {
    const t = viewer.animator.actions.reduce((a, b) => Math.max(a, b.time), 0) + T[0];
    let k = T.findIndex(u => u > t + 1e-6); k = (k < 0 ? T.length : Math.max(k, 1)) - 1;
    document.getElementById("now").textContent = "t = " + T[k].toFixed(2) + " s" + F[k];
    const x = %d * (T[k] - T[0]) / Math.max(end - T[0], 1e-9);
    document.getElementById("cursor").setAttribute("transform", `translate(${x} 0)`); };
  const again = () => { tellTime(); requestAnimationFrame(again); };
  again(); })();
"""


def budget(frames: int, points: int, room: float = LIMIT) -> tuple[int, int]:
    """Frames and points per frame that fit into ``room`` bytes.

    Points go first, down to 2500; then frames, down to 0.4 of them; then points again, and frames.

    Raises:
        ValueError: there is no room for a single frame of a hundred points.
    """

    def most_points(n: int) -> int:
        return max(int((room / n - FRAME) / POINT), 0)

    def most_frames(m: int) -> int:
        return max(int(room / (FRAME + m * POINT)), 0)

    if not frames or not points:
        return frames, points
    least = min(100, points)
    if most_frames(least) < 1:
        raise ValueError(f"no room for material in {room:.0f} bytes: show fewer or plainer models")
    shown = min(points, max(most_points(frames), min(FEWEST, points)))
    kept = min(frames, max(most_frames(shown), int(np.ceil(SLOWEST * frames))))
    shown = min(shown, max(most_points(kept), least))
    return min(kept, most_frames(shown)), shown


def write_page(
    viewer: ParticleViewer, path: Path, title: str = "", limit: int = LIMIT
) -> tuple[int, int]:
    """Write what was recorded as a page that plays it, whole or not at all.

    Args:
        viewer: of a simulation that has run.
        path: of the page.
        title: told in the page, such as the scenario's name.
        limit: largest size [bytes]; frames and points are lowered to it.

    Returns:
        Frames and points per frame that the page holds.

    Raises:
        ValueError: nothing was recorded, or the page cannot be made that small.
    """
    if not viewer.frames:
        raise ValueError("no frames to write: run the simulation with a view that records")
    meshcat = viewer.meshcat
    meshcat.Delete(LIVE)
    meshcat.Delete(FRAMES)
    viewer.pages += 1  # in the path of the frames: a recording never forgets what it said of one
    meshcat.PublishRecording()
    recorded = [viewer.frames[k] for k in sorted(viewer.frames)]
    room = 0.98 * limit - len(meshcat.StaticHtml().encode())
    count, points = budget(len(recorded), len(viewer.chosen), room)
    frames = [recorded[k] for k in np.linspace(0, len(recorded) - 1, count).round().astype(int)]
    limits = viewer.limits(np.concatenate([f.value for f in frames]))
    _animate(viewer, frames, points, limits)
    legend = _legend(viewer, frames, points, limits, title)
    page = meshcat.StaticHtml().replace("</body>", f"{legend}</body>")
    size = len(page.encode())
    if size > limit:
        raise ValueError(f"{path}: the page takes {size} bytes, {limit} are allowed")
    write_text(path, page)
    return count, points


def _animate(
    viewer: ParticleViewer, frames: Sequence[Frame], points: int, limits: tuple[float, float]
) -> None:
    """One object per frame, each seen until the next: Meshcat records properties, not objects."""
    meshcat, recording = viewer.meshcat, viewer.meshcat.get_mutable_recording()
    # fewer points cover the same surface
    size = viewer.point_size * np.sqrt(max(viewer.outer / points, 1.0))
    at = [recording.frame(f.time) for f in frames]
    largest = strongest(frames)
    for k, frame in enumerate(frames):
        path = f"{FRAMES}/{viewer.pages}/{k}"
        shown = cloud(frame.p_WQ[:points], frame.value[:points], limits)
        meshcat.SetObject(path, shown, point_size=size)
        meshcat.SetProperty(path, "visible", k == 0)
        recording.SetProperty(at[0], path, "visible", k == 0)
        recording.SetProperty(at[k], path, "visible", True)
        if k + 1 < len(frames):
            recording.SetProperty(at[k + 1], path, "visible", False)
        for n in range(len(viewer.arrows)):
            X_WA, scale = arrow(frame, n, largest)
            recording.SetTransform(at[k], f"{FORCE}/{n}", X_WA)
            recording.SetProperty(at[k], f"{FORCE}/{n}/arrow", "scale", scale)
            recording.SetProperty(at[k], f"{FORCE}/{n}", "visible", scale[2] > FAINT)
    meshcat.PublishRecording()


def _legend(
    viewer: ParticleViewer,
    frames: Sequence[Frame],
    points: int,
    limits: tuple[float, float],
    title: str,
) -> str:
    """HTML that lies over the page and says what it shows."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    time = np.array([f.time for f in frames])
    duration = time[-1] - time[0]
    rate = (len(frames) - 1) / duration if duration > 0.0 else 0.0
    kind = " (at the surface)" if points <= viewer.outer < len(viewer.rest) else ""
    lines = [
        f"{len(frames)} frames, {rate:.3g} per second of {duration:.3g} s",
        f"{points} of {len(viewer.rest)} particles{kind}",
    ]
    if viewer.arrows:
        names = ", ".join(dict.fromkeys(t.name for t in viewer.arrows))
        lines.append(f"arrow: force on {names}, at most {_newton(strongest(frames))}")
    strip = ", ".join(to_hex(colormaps[COLOURS](u)) for u in np.linspace(0.0, 1.0, 9))
    low, high = (f"{v:.3g}" for v in limits)
    return (
        f'<style>{STYLE}</style><div id="legend"><b>{escape(title)}</b>'
        + "".join(f"<div>{escape(line)}</div>" for line in lines)
        + f'<div class="bar" style="background: linear-gradient(90deg, {strip})"></div>'
        f'<div class="ends"><span>{low}</span><span>{viewer.view.field} [{viewer.field.unit}]'
        f"</span><span>{high}</span></div>{_curve(time, frames)}</div>"
    )


def _curve(time: np.ndarray, frames: Sequence[Frame]) -> str:
    """The largest force over time, with what it is at the moment that is shown."""
    force = np.array([strongest([f]) for f in frames])
    x = WIDTH * (time - time[0]) / max(time[-1] - time[0], 1e-9)
    y = HEIGHT - 1 - (HEIGHT - 2) * force / max(force.max(), 1e-30)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    told = [f", force {_newton(f)}" for f in force] if force.any() else [""] * len(force)
    script = SCRIPT % (np.round(time, 4).tolist(), told, WIDTH)
    return (
        f'<svg width="{WIDTH}" height="{HEIGHT}"><polyline points="{points}" fill="none"'
        ' stroke="#d91f26" stroke-width="1.5"/><line id="cursor" y2="56" stroke="#1d232b"/></svg>'
        f'<div id="now"></div><script>{script}</script>'
    )


def _newton(force: float) -> str:
    return f"{force:.3g} N" if force >= 1.0 else f"{1e3 * force:.3g} mN"
