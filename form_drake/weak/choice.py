"""Choices where the person makes none: windows, who balances pressure, and what is free of traction."""

from collections.abc import Sequence

import numpy as np

from form_drake.laws import Law
from form_drake.motion import Body, Fit, Sampling
from form_drake.motion.tracks import placed
from form_drake.records import Recording
from form_drake.weak.bend import BendFields
from form_drake.weak.fields import Fields
from form_drake.weak.force import holding, pressed
from form_drake.weak.stress import volumetric
from form_drake.weak.unknowns import Pressure
from form_drake.weak.windows import even

ISOCHORIC = 2e-3  # |J - 1| below this share of the strain is no change of volume
LONGEST, SHORTEST = 0.16, 0.08  # width of windows [s]: as a rule, and where material yields
DRAWS, LOUD = 4, 1.1  # of noise, and times what they make of volume that is no change of it
FRAMES = 8  # fewest frames in a window
STRIDE = 0.4  # of windows, as a share of their width, where that gives no more than
MOST_ROWS = 2000
GAP = 2.5  # times the usual one, beyond which a time between frames is a gap
STILL = 0.01  # of the largest displacement, below which a body stands still


def chosen_windows(recording: Recording, law: Law, width: float | None) -> np.ndarray:
    """Ends of the windows [s], from the first frame on, shape [windows, 2].

    Raises:
        ValueError: the window is longer than the recording.
    """
    last = float(recording.time[-1] - recording.time[0])
    if width is None:
        frame = float(np.median(np.diff(recording.time)))
        usual = SHORTEST if law.flow == "plastic" else LONGEST
        width = min(max(usual, FRAMES * frame), last)
    elif not 0.0 < width < np.inf:
        raise ValueError(f"window {width} s: a positive width is wanted")
    return even(0.0, last, width, STRIDE * width)


def seen_through(ends: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Windows [s] without a gap between frames, at these times [s], that is longer than half of them.

    What bridges a gap is no measurement.

    Raises:
        ValueError: there is none.
    """
    first, last = time[:-1] - time[0], time[1:] - time[0]
    wide = last - first > GAP * np.median(last - first)
    meets = (ends[:, :1] < last[wide]) & (ends[:, 1:] > first[wide])
    hidden = meets & (last - first > 0.5 * np.diff(ends))[:, wide]
    kept = ~hidden.any(axis=1)
    if not kept.any():
        raise ValueError(
            f"every window of {float(np.diff(ends[:1])[0, 0]):.3g} s lies over a gap between frames that is longer"
            " than half of it: too many frames are missing"
        )
    return ends[kept]


def told_apart(ends: np.ndarray, recording: Recording, fit: Fit) -> np.ndarray:
    """Windows between which the body moves, where the law itself has completed its motion.

    What that gets wrong lasts for as long as the body stands still: windows that repeat it would outvote
    those in which it moves. And a body that stands as it did at first was balanced by the law that is sought.

    Args:
        ends: of the windows [s], shape [windows, 2].
        recording: of the body.
        fit: its motion.
    """
    X, times = recording.reference[placed(recording)], np.append(0.0, ends.mean(axis=1))
    x = Sampling.of(fit, times, X, np.ones(len(X)), 1.0).motion(fit.c).x
    far = STILL * np.sqrt(np.mean((x - x[0]) ** 2, axis=(1, 2))).max()
    last, kept = 0, []
    for n in range(1, len(x)):
        if np.sqrt(np.mean((x[n] - x[last]) ** 2)) > far:
            last = n
            kept.append(n - 1)
    return ends[kept] if kept else ends


def while_pressed(ends: np.ndarray, recording: Recording, shape: Body) -> np.ndarray:
    """Windows at whose end a tool presses a whole face, of a body whose inside the law completes as statics.

    A block that is let go swings: what its surface shows is inertia, which that would take for stress. Of a
    strip, which is touched somewhere, the surface shows nearly all.

    Args:
        ends: of the windows [s], shape [windows, 2].
        recording: of the body; where nothing presses then, all windows are kept.
        shape: its reference shape.
    """
    tools = holding(shape) & set(recording.forces)
    if not tools:
        return ends
    presses = np.any([pressed(recording, tool) for tool in tools], axis=0)
    last = np.searchsorted(recording.time - recording.time[0], ends[:, 1], side="right") - 1
    return ends[presses[last]] if presses[last].any() else ends


def spaced(
    ends: np.ndarray, fields: Sequence[Fields], probes: int, *, some: bool = False
) -> np.ndarray:
    """Fewer of the windows where the rows of all probes would be more than ``MOST_ROWS``.

    Args:
        ends: of the windows [s], shape [windows, 2].
        fields: test fields.
        probes: how many there are.
        some: whether these are a choice, of which fewer are left; else wider ones take their place.
    """
    most = max(MOST_ROWS // probes // sum(len(f.names) for f in fields), 2)
    if len(ends) <= most:
        return ends
    if some:
        return ends[np.linspace(0, len(ends) - 1, most).round().astype(int)]
    last = float(ends[-1, 1])
    width = max(float(ends[0, 1] - ends[0, 0]), last / most)  # no time between them is left out
    return even(0.0, last, width, (last - width) / (most - 1))


def bent(recording: Recording, shape: Body) -> bool:
    """Whether a tool with a force touches part of a face."""
    return any(f.condition == "touched" and f.tool in recording.forces for f in shape.faces)


def chosen_pressure(
    fitted: Sequence[tuple[Recording, Body, Fit]], law: Law, *, thin: bool = False
) -> Pressure:
    """Who balances pressure: the law, unless it is supplied or no volume changes.

    That of a strip, or of another ``thin`` body, is what leaves its faces free.
    """
    if all(r.pressure is not None for r, _, _ in fitted):
        return "supplied"
    given = [t.given for t, v in zip(law.terms, volumetric(law), strict=True) if v]
    if given and all(given) and law.pressure is None:
        return "free"  # the law's bulk modulus is a numerical constant
    if thin or any(bent(recording, shape) for recording, shape, _ in fitted):
        return "law"
    rng = np.random.default_rng(0)
    change, noise, strain = 0.0, 0.0, 0.0
    for recording, _, fit in fitted:
        X = recording.reference[placed(recording)]
        time = np.linspace(0.0, recording.time[-1] - recording.time[0], 24)
        sampling = Sampling.of(fit, time, X, np.ones(len(X)), 1.0)
        motion = sampling.motion(fit.c)
        drawn = [sampling.motion(fit.c + fit.draw(rng)).J - motion.J for _ in range(DRAWS)]
        change += float(np.mean((motion.J - 1.0) ** 2))
        noise += float(np.mean(np.square(drawn)))
        strain += float(np.mean((motion.F @ motion.F.swapaxes(-1, -2) - np.eye(3)) ** 2))
    return "free" if change < ISOCHORIC**2 * strain + LOUD * noise else "law"


def traction_free(fields: Sequence[Fields]) -> tuple[int, ...]:
    """Both directions across a strip, where bending fields alone are used."""
    if all(isinstance(f, BendFields) for f in fields):
        axis, *more = {f.axis for f in fields if isinstance(f, BendFields)}
        if more:
            raise ValueError(
                "a strip is bent along two of its axes: read one of the recordings alone"
            )
        return tuple(a for a in range(3) if a != axis)
    return ()


def traction_free_as(axes: Sequence[int], law: Law) -> tuple[int, ...]:
    """The axes as they are given.

    Raises:
        ValueError: not one or two axes, or a law whose stress is not elastic.
    """
    found = tuple(sorted(set(axes)))
    if len(found) > 2 or not set(found) <= {0, 1, 2}:
        raise ValueError(f"traction-free axes {list(axes)}: at most two of 0, 1, 2 are wanted")
    if found and law.flow != "elastic":
        raise ValueError(
            f"traction-free axes: {law.name} is not elastic, and stretches across a thin body are"
            " found for elastic laws alone"
        )
    return found
