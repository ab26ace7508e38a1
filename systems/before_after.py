"""A page that plays a measured motion beside what is predicted of it without and with effects."""

from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat

from form_drake.files import write_text
from form_drake.records import Recording
from form_drake.systems.page import HEIGHT, SCRIPT, STYLE, WIDTH, budget
from form_drake.systems.viewer import COLOURS, FOV, POINT_SIZE, cloud

LIMIT = 5_000_000  # bytes of a page
APART = 1.6  # distance of the bodies' middles as a share of their width
FLAT = 0.25  # of the largest extent of the points, that their other extents count as at least
FRAMES = "/frames"
FARTHEST = 0.99  # quantile of the distances at which the colours end
NAMES = ("before", "measured", "after")  # from left to right
EYE = (0.0, -1.2, 0.35)  # place of the camera from the middle, as a share of the width of all three
FILLED = 0.35  # width of a point as a share of the points' spacing
LABELS = """
#names span { position: fixed; bottom: 24px; transform: translateX(-50%);
  font: 600 16px system-ui, sans-serif; color: #1d232b; pointer-events: none; }
"""


@dataclass(frozen=True)
class Beside:
    """What is shown: three bodies beside each other.

    Attributes:
        time: of the frames [s], shape [frames].
        p_WQ: of the points before, measured and after, apart from each other, not a number where
            nothing was measured [m], shape [frames, 3, points, 3].
        apart: distance of the points from the measured ones [mm], shape [frames, 3, points].
        noise: root mean square distance that the noise of the measurement makes [mm]; zero: not stated.
    """

    time: np.ndarray
    p_WQ: np.ndarray
    apart: np.ndarray
    noise: float = 0.0

    @classmethod
    def of(cls, seen: Recording, before: Recording, after: Recording) -> "Beside":
        """Of recordings of the same points and frames.

        Raises:
            ValueError: they are of others.
        """
        shapes = [r.p_WQ.shape for r in (before, seen, after)]
        if len(set(shapes)) > 1:
            raise ValueError(f"frames, points and axes must be the same, got {shapes}")
        p = np.stack([r.p_WQ for r in (before, seen, after)], axis=1).astype(float)
        there = np.isfinite(p[:, 1]).all(axis=-1)
        there = there if seen.valid is None else there & seen.valid
        p = np.where(there[:, None, :, None], p, np.nan)
        apart = 1e3 * np.linalg.norm(p - p[:, 1:2], axis=-1)
        edges = np.ptp(seen.reference, axis=0)
        width = max(float(edges[0]), FLAT * float(edges.max()))
        p[..., 0] += APART * width * np.arange(-1.0, 2.0)[:, None]
        noise = 1e3 * np.sqrt(3.0) * (seen.noise or 0.0)
        return cls(np.asarray(seen.time) - seen.time[0], p, apart, float(noise))

    @property
    def rms(self) -> np.ndarray:
        """Of the distances before and after [mm], not a number where nothing was measured, shape
        [frames, 2].
        """
        seen = np.isfinite(self.apart[:, 1]).sum(axis=1)
        sums = np.nansum(self.apart[:, ::2] ** 2, axis=2)
        return np.sqrt(sums / np.where(seen > 0, seen, np.nan)[:, None])

    def chosen(self, frames: int, points: int) -> "Beside":
        """Some of the frames and points, evenly."""
        t = np.linspace(0, len(self.time) - 1, frames).round().astype(int)
        n = np.linspace(0, self.p_WQ.shape[2] - 1, points).round().astype(int)
        return replace(
            self, time=self.time[t], p_WQ=self.p_WQ[t][:, :, n], apart=self.apart[t][:, :, n]
        )


def write_before_after(
    seen: Recording,
    before: Recording,
    after: Recording,
    path: Path,
    title: str,
    limit: int = LIMIT,
) -> tuple[int, int]:
    """Write a page that plays three bodies, coloured by how far points are from the measured ones.

    Args:
        seen: the measured motion.
        before: predicted without effects, at the same points and frames.
        after: predicted with them, likewise.
        path: of the page.
        title: told in the page.
        limit: largest size [bytes]; frames and points are lowered to it.

    Returns:
        Frames and points of each body that the page holds.

    Raises:
        ValueError: points or frames differ, or the page cannot be made that small.
    """
    whole, meshcat = Beside.of(seen, before, after), Meshcat()
    room = 0.98 * limit - len(meshcat.StaticHtml().encode())
    frames, points = budget(len(whole.time), 3 * whole.p_WQ.shape[2], room)
    shown = whole.chosen(frames, max(points // 3, 1))
    top = max(float(np.nanquantile(whole.apart, FARTHEST)), 1e-9)
    _animate(meshcat, shown, top)
    page = meshcat.StaticHtml().replace("</body>", f"{_legend(shown, top, title)}</body>")
    size = len(page.encode())
    if size > limit:
        raise ValueError(f"{path}: the page takes {size} bytes, {limit} are allowed")
    write_text(path, page)
    return frames, shown.p_WQ.shape[2]


def _animate(meshcat: Meshcat, shown: Beside, top: float) -> None:
    """One object per frame, each seen until the next."""
    low, high = np.nanmin(shown.p_WQ, axis=(0, 1, 2)), np.nanmax(shown.p_WQ, axis=(0, 1, 2))
    middle, size = 0.5 * (low + high), high - low
    size = np.maximum(size, FLAT * size[0] / (1.0 + 2.0 * APART))
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.80, 0.83, 0.86])
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=FOV))
    meshcat.SetCameraPose(middle + size[0] * np.array(EYE), middle)
    spacing = FILLED * np.cbrt(np.prod(size) / (3 * shown.p_WQ.shape[2]))
    width = POINT_SIZE * float(spacing) / np.tan(np.radians(FOV) / 2.0)
    duration = float(shown.time[-1])
    rate = (len(shown.time) - 1) / duration if duration > 0.0 else 30.0
    meshcat.StartRecording(frames_per_second=rate)
    recording = meshcat.get_mutable_recording()
    at = [recording.frame(float(t)) for t in shown.time]
    for k, (p_WQ, apart) in enumerate(zip(shown.p_WQ, shown.apart, strict=True)):
        path = f"{FRAMES}/{k}"
        there = np.isfinite(apart)
        meshcat.SetObject(path, cloud(p_WQ[there], apart[there], (0.0, top)), point_size=width)
        meshcat.SetProperty(path, "visible", k == 0)
        recording.SetProperty(at[0], path, "visible", k == 0)
        recording.SetProperty(at[k], path, "visible", True)
        if k + 1 < len(at):
            recording.SetProperty(at[k + 1], path, "visible", False)
    meshcat.PublishRecording()


def _legend(shown: Beside, top: float, title: str) -> str:
    """HTML that lies over the page and says what it shows."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    strip = ", ".join(to_hex(colormaps[COLOURS](u)) for u in np.linspace(0.0, 1.0, 9))
    names = "".join(
        f'<span style="left: calc(50% + {aside:.1f}vh)">{name}</span>'
        for name, aside in zip(NAMES, _aside(shown), strict=True)
    )
    noise = f", noise alone makes {shown.noise:.2g} mm" if shown.noise else ""
    return (
        f'<style>{STYLE}{LABELS}</style><div id="legend"><b>{escape(title)}</b>'
        f"<div>{len(shown.time)} frames, {shown.p_WQ.shape[2]} points{noise}</div>"
        f'<div class="bar" style="background: linear-gradient(90deg, {strip})"></div>'
        f'<div class="ends"><span>0</span><span>distance from measured points [mm]</span>'
        f'<span>{top:.2g}</span></div>{_curves(shown)}</div><div id="names">{names}</div>'
    )


def _aside(shown: Beside) -> np.ndarray:
    """Where the bodies' middles are seen from the middle, in hundredths of the window's height."""
    x = shown.p_WQ[..., 0]
    low, high = np.nanmin(x), np.nanmax(x)
    place = np.nanmean(x, axis=(0, 2)) - 0.5 * (low + high)
    far = float((high - low) * np.linalg.norm(EYE))
    return np.asarray(50.0 * place / (far * np.tan(np.radians(FOV) / 2.0)))


def _curves(shown: Beside) -> str:
    """The distances over time, with what they are at the moment that is shown."""
    rms = shown.rms
    x = WIDTH * shown.time / max(float(shown.time[-1]), 1e-9)
    scale = (HEIGHT - 2) / max(float(np.nanmax(rms)), shown.noise, 1e-30)
    y, floor = HEIGHT - 1 - scale * rms, HEIGHT - 1 - scale * shown.noise
    lines = (
        f'<line y1="{floor:.1f}" y2="{floor:.1f}" x2="{WIDTH}" stroke="#1d232b"'
        ' stroke-dasharray="4 4"/>'
        if shown.noise
        else ""
    )
    for colour, own in zip(("#8a939d", "#2a9d4a"), y.T, strict=True):
        known = np.isfinite(own)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[known], own[known], strict=True))
        lines += f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>'
    told = [
        f", rms {a:.2g} mm before (grey), {b:.2g} mm after (green)"
        if np.isfinite(a)
        else ", nothing measured"
        for a, b in rms
    ]
    script = SCRIPT % (np.round(shown.time, 4).tolist(), told, WIDTH)
    return (
        f'<svg width="{WIDTH}" height="{HEIGHT}">{lines}'
        f'<line id="cursor" y2="{HEIGHT}" stroke="#1d232b"/></svg>'
        f'<div id="now"></div><script>{script}</script>'
    )
