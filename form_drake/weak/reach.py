"""Which test fields meet no face of unknown force during a window."""

from collections.abc import Sequence

import numpy as np

from form_drake.motion import Body, Fit, Sampling
from form_drake.weak.fields import Fields

EDGE, MOMENTS = 9, 5  # points along an edge of a face, and times in a window, looked at


def usable(shape: Body, fit: Fit, fields: Sequence[Fields], ends: np.ndarray) -> np.ndarray:
    """Rows whose field vanishes on held faces all through its window, shape [windows * fields].

    Raises:
        ValueError: there is none.
    """
    held = [shape.face_points(f, EDGE) for f in shape.faces if f.condition != "free"]
    if not held:
        return np.ones(len(ends) * sum(len(f.names) for f in fields), dtype=bool)
    X = np.concatenate(held)
    time = np.linspace(ends[:, 0], ends[:, 1], MOMENTS).T.ravel()
    x = Sampling.of(fit, time, X, np.ones(len(X)), 1.0).motion(fit.c).x
    moments = [np.concatenate([f.inside(at) for f in fields]) for at in x]
    keep: np.ndarray = np.array(moments).reshape(len(ends), MOMENTS, -1).all(axis=1).ravel()
    if not keep.any():
        raise ValueError("every test field meets a face of unknown force in every window")
    return keep
