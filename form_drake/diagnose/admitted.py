"""Which recordings a diagnosis takes; each is told of by its name."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from form_drake.diagnose.verify import require_stated
from form_drake.identify.stated import same_motion
from form_drake.motion import body
from form_drake.records import Recording

Named = Sequence[tuple[str, Recording]]


@contextmanager
def about(name: object) -> Iterator[None]:
    """Say of what a mistake is."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def require_one_specimen(recordings: Named) -> None:
    """Refuse recordings of different specimens, and one motion twice.

    Raises:
        ValueError: see there.
    """
    bodies = []
    for name, recording in recordings:
        with about(name):
            bodies.append(body(recording))
    (first, _), *rest = recordings
    shape, *sizes = bodies
    for n, ((name, other), size) in enumerate(zip(rest, sizes, strict=True), start=1):
        same = np.allclose([size.low, size.high], [shape.low, shape.high], rtol=0.0, atol=1e-6)
        if not same or not np.isclose(size.density, shape.density):
            raise ValueError(
                f"{name}: another specimen than {first}; boxes and densities must agree"
            )
        for earlier, seen in recordings[:n]:
            if same_motion(seen, other):
                raise ValueError(f"{name}: the same motion as {earlier}")


def require_all_stated(recordings: Named, read: int, dx: float | None = None) -> None:
    """Refuse recordings that could not be simulated or compared, the first ``read`` being read.

    Raises:
        ValueError: see ``require_stated``.
    """
    for n, (name, recording) in enumerate(recordings):
        with about(name):
            require_stated(recording, dx, held_back=n >= read)
