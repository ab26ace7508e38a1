"""What real cameras and clocks do, each at growing levels."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from form_drake.bench.perception_views import Kept, every
from form_drake.records import Recording

GREY = 2.0  # standard deviation of a grey value, once
HIDDEN = (0.25, 0.75)  # of the time, in which points are occluded


def same(recording: Recording) -> Recording:
    """Nothing is done to the tracks."""
    return recording


@dataclass(frozen=True)
class Level:
    """One level of one disturbance.

    Attributes:
        look: changes of the cameras.
        kept: frames of which there are pictures.
        edit: what is done to the tracks.
    """

    look: tuple[str, ...] = ()
    kept: Kept = every
    edit: Callable[[Recording], Recording] = same


def occluded(share: float) -> Callable[[Recording], Recording]:
    """A corner of the face with a share of its points is hidden for half of the time."""

    def edit(recording: Recording) -> Recording:
        X, valid = recording.p_WQ[0], recording.valid
        wide = np.ptp(X, axis=0)
        place = ((X - X.min(axis=0)) / np.where(wide > 1e-6, wide, np.inf)).sum(axis=1)
        hidden = np.zeros(len(X), dtype=bool)
        hidden[np.argsort(place, kind="stable")[: round(share * len(X))]] = True
        count = recording.frames
        now = (np.arange(count) >= HIDDEN[0] * count) & (np.arange(count) < HIDDEN[1] * count)
        valid = np.ones((count, len(X)), dtype=bool) if valid is None else valid
        return replace(recording, valid=valid & ~np.outer(now, hidden))

    return edit


def delayed(seconds: float) -> Callable[[Recording], Recording]:
    """The force is stamped later than it was."""

    def edit(recording: Recording) -> Recording:
        forces = {k: replace(s, time=s.time + seconds) for k, s in recording.forces.items()}
        return replace(recording, forces=forces)

    return edit


def misstated(by: float) -> Callable[[Recording], Recording]:
    """Poisson's ratio is stated wrongly."""

    def edit(recording: Recording) -> Recording:
        return replace(recording, known={**recording.known, "nu": recording.known["nu"] + by})

    return edit


def dropped(share: float) -> Kept:
    """Frames are missing at random, the same in every run."""
    lost = np.random.default_rng(0).uniform(size=10_000) < share
    return lambda frame: not lost[frame]


def _looks(form: str, *levels: float) -> dict[str, Level]:
    return {f"{level:g}": Level(look=(form.format(level),)) for level in levels}


SWEEPS: dict[str, dict[str, Level]] = {
    "noise [x 2 grey values]": {
        f"{times:g}": Level(look=(f"stereo.noise={GREY * times}",)) for times in (2, 5, 10, 20)
    },
    "calibration [deg]": _looks("stereo.turned_deg=[0,{0},0]", 0.02, 0.05, 0.1),
    "blur [px]": _looks("stereo.blur={0}", 0.5, 1, 2),
    "brightness [share]": _looks("stereo.drift={0}", 0.1, 0.2, 0.5),
    "occluded [share]": {f"{s:g}": Level(edit=occluded(s)) for s in (0.1, 0.2, 0.4)},
    "dropped frames [share]": {f"{s:g}": Level(kept=dropped(s)) for s in (0.1, 0.2, 0.5)},
    "one frame in": {f"{n}": Level(kept=lambda k, n=n: k % n == 0) for n in (2, 4)},  # type: ignore[misc]
    "force delay [ms]": {f"{t:g}": Level(edit=delayed(1e-3 * t)) for t in (2, 5, 20)},
    "nu off by": {f"{d:+g}": Level(edit=misstated(d)) for d in (-0.05, 0.05)},
}
