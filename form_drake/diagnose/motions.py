"""Motions of a block that show most of what may be hidden in it, as recordings yet to be simulated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from form_drake.records import Recording, Stream

NOISE, FORCE_NOISE = 5e-5, 0.01  # of tracks [m]; of forces, of the largest
DEPTH, PRELOAD = 0.075, 0.007  # of the height
PRESS = ((0.15, 0.0), (0.9, 0.85), (1.15, 0.85), (1.4, 0.4), (1.55, 1.0), (1.8, 1.0), (2.7, 0.1))
PRESSING, SHAKING = 2.8, 1.3  # [s]
LEFT = -0.3  # where a plate that leaves ends, as a share of the press
GRAVITY = 9.81


@dataclass(frozen=True)
class Block:
    """A block on a floor that holds it.

    Attributes:
        size: edges [m].
        points: tracks throughout it.
        rate: frames per second.
        stamps: samples of poses and forces per second.
        density: stated [kg/m^3].
        law: declared.
        seed: of where the tracks are.
    """

    size: tuple[float, float, float] = (0.036, 0.034, 0.030)
    points: int = 330
    rate: float = 60.0
    stamps: float = 240.0
    density: float = 1000.0
    law: str = "neo-hookean"
    seed: int = 0

    def press(
        self,
        plate: str,
        seconds: float = PRESSING,
        depth: float = DEPTH,
        beat: float = 5.0,
        *,
        opens: bool = False,
    ) -> Recording:
        """Slow press, hold, partial release, fast press, oscillation and return.

        Args:
            plate: ``bonded``, or ``frictionless`` and a little deep from the start.
            seconds: how long it takes.
            depth: largest, as a share of the height.
            beat: of the oscillation [Hz].
            opens: whether the plate leaves the body at the end.
        """
        stamps = self._stamps(seconds)
        pace = stamps * PRESSING / seconds
        start = PRELOAD if plate == "frictionless" else 0.0
        *knots, (end, last) = PRESS
        knots.append((end, LEFT if opens else last))
        way = start + (depth - start) * _way(knots, pace)
        share = np.clip((pace - 1.8) / 0.8, 0.0, 1.0)
        way += 0.004 * np.sin(np.pi * share) ** 3 * np.sin(2.0 * np.pi * beat * stamps)
        X_WT = np.zeros((len(stamps), 3))
        X_WT[:, 2] = self.size[2] * (1.0 - way)
        return self._recording(seconds, "plate", X_WT, f"{plate} plate")

    def shake(self, seconds: float = SHAKING) -> Recording:
        """The floor moves sideways, and a little up and down; nothing touches the block."""
        stamps = self._stamps(seconds)
        slow, fast = (
            np.sin(np.pi * np.clip((stamps * SHAKING / seconds - a) / w, 0.0, 1.0)) ** 3
            for a, w in ((0.05, 0.75), (0.6, 0.6))
        )
        way = np.zeros((len(stamps), 3))
        way[:, 0] = 4e-3 * slow * np.sin(2.0 * np.pi * 3.0 * stamps)
        way[:, 1] = 1.5e-3 * fast * np.sin(2.0 * np.pi * 7.0 * stamps)
        way[:, 2] = 4e-4 * (slow + fast) * np.sin(2.0 * np.pi * 5.0 * stamps)
        return self._recording(seconds, "floor", way, "free")

    def _stamps(self, seconds: float) -> np.ndarray:
        return np.arange(0.0, seconds + 1e-9, 1.0 / self.stamps)

    def _recording(self, seconds: float, tool: str, way: np.ndarray, top: str) -> Recording:
        """A tool's origin goes a way [m], shape [stamps, 3]; forces are those of a plate."""
        time, stamps = np.arange(0.0, seconds + 1e-9, 1.0 / self.rate), self._stamps(seconds)
        size = np.array(self.size)
        low = np.array([-0.5 * size[0], -0.5 * size[1], 0.0])
        X = low + size * np.random.default_rng(self.seed).uniform(0.03, 0.97, (self.points, 3))
        X_WT = np.tile(np.eye(4), (len(stamps), 1, 1))
        X_WT[:, :3, 3] = way
        box = {"low": " ".join(map(str, low)), "high": " ".join(map(str, low + size))}
        none = np.zeros((len(stamps), 3))
        return Recording.from_arrays(
            time,
            np.tile(X, (len(time), 1, 1)),
            p_reference=X,
            density=self.density,
            gravity=np.array([0.0, 0.0, -GRAVITY]),
            geometry={"shape": "box", **box},
            contact={"z-": "bonded floor", "z+": top, "other": "free"},
            poses={tool: Stream(stamps, X_WT)},
            forces={tool: Stream(stamps, none)} if tool == "plate" else {},
            law=self.law,
        )


def noisy(recording: Recording, rng: np.random.Generator) -> Recording:
    """With noise in tracks and forces, which is stated."""
    streams = {}
    for tool, stream in recording.forces.items():
        size = FORCE_NOISE * float(np.abs(stream.value).max())
        value = stream.value + size * rng.standard_normal(stream.value.shape)
        streams[tool] = Stream(stream.time, value, noise=size)
    p_WQ = recording.p_WQ + NOISE * rng.standard_normal(recording.p_WQ.shape)
    return replace(recording, p_WQ=p_WQ, noise=NOISE, forces=streams)


def _way(knots: Sequence[tuple[float, float]], time: np.ndarray) -> np.ndarray:
    """A way with two continuous derivatives through knots (time, value)."""
    t, y = np.array(knots).T
    k = np.clip(np.searchsorted(t, time, "right") - 1, 0, len(t) - 2)
    s = np.clip((time - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)
    found: np.ndarray = y[k] + (y[k + 1] - y[k]) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return found
