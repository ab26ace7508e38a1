"""What stays open beside a verdict, in sentences: nothing is named without reserve where there is a doubt."""

from collections.abc import Iterable, Sequence

import numpy as np

from form_drake.diagnose.model import Model
from form_drake.diagnose.placebo import Removed
from form_drake.motion.lasting import intervals
from form_drake.records import Recording

RESTED = 20  # frames of a rest that shows errors which last a dozen frames; what fewer show is too little
OTHER = 1.5  # times a shear modulus, by which a specimen is another
UNSEEN = (
    "Held-out motion is off by more than noise, grid and moduli explain: something is missing there that the"
    " other recordings do not name. Read it too, and hold another back."
)
SILENT = (
    "it shows no more of what was added than noise, and neither bears it out nor speaks against it"
)


def doubts(recordings: Sequence[Recording], start: Model | None, found: Model) -> tuple[str, ...]:
    """What may be wrong with recordings or with the material that was begun with."""
    told = [
        f"How noisy the tracks of recording {n} are was told by their own jitter: errors that last"
        f" longer than a frame would be taken for motion; intervals of rest, of {RESTED} frames or more, show them."
        for n, one in enumerate(recordings, start=1)
        if one.noise is None and not any(map(_long, intervals(one.time, one.rest)))
    ]
    if start is not None:
        (_, was), (_, seen) = (one.law.moduli(one.values) for one in (start, found))
        if not 1.0 / OTHER < seen / was < OTHER:
            told.append(
                f"The material has a shear modulus of {was:.3g} Pa, these recordings show {seen:.3g} Pa: it may be"
                " that of another specimen."
            )
    return tuple(told)


def _long(frames: np.ndarray) -> bool:
    return bool(frames.sum() >= RESTED)


def needless(removed: Iterable[Removed]) -> tuple[str, ...]:
    """Effects with which held-out motion is worse than without."""
    return tuple(
        f"Held-out motion is predicted worse with {one.effect.id} than without it."
        for one in removed
        if any(c.worse for c in one.channels)
    )
