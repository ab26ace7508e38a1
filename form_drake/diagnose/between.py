"""What motions do between frames, of which rows that are read from frames know nothing.

A body that is let go rings, and may do so faster than frames tell: they show it as something slow, in a
twin at one moment of the ringing and in the data at another.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from form_drake.diagnose.columns import rest_of
from form_drake.diagnose.model import Model, Scenes
from form_drake.identify.problem import Problem
from form_drake.motion import fit_tracks
from form_drake.motion.tracks import valid_points
from form_drake.records import Recording
from form_drake.weak.probe import Probe

SLIGHT = 0.01  # of what is missed, in differences
PARTS = 4  # of the time from frame to frame
# Of them, a quarter before and after its middle: of any ringing one sees what the other does not.
LOOKS = (1, 3)


def denser(recording: Recording) -> Recording:
    """A scene to be simulated, whose frames are ``PARTS`` times as many."""
    count = len(recording.time)
    at = np.arange(PARTS * (count - 1) + 1) / PARTS
    time = np.interp(at, np.arange(count), recording.time)
    X = recording.reference
    return replace(
        recording,
        time=time,
        p_WQ=np.broadcast_to(X, (len(time), *X.shape)),
        p_reference=X,
        valid=None,
        visible=None,
        pressure=None,
        step=None,
        states=None,
    )


def between(problem: Problem, twin: Problem, scenes: Scenes, model: Model) -> np.ndarray:
    """What frames miss of a simulation, as errors of its rows, shape [rows, errors].

    Between frames positions differ from those of a spline through the frames; were frames at other moments,
    they would be off by as much.

    Args:
        problem: probes of the data.
        twin: the same of the simulation.
        scenes: of all of them.
        model: of the simulation.

    Raises:
        ValueError: the simulation fails.
    """
    dense = replace(scenes, recordings=tuple(denser(r) for r in scenes.recordings))
    made = dense.rough.rolled(model)
    own = list(zip(problem.probes, scenes.recordings, made, strict=True))
    eta, theta = twin.coordinates(model.values)
    rough, found = twin.coarser, []
    still = rest_of(rough.rows(eta, theta), theta)
    for look in LOOKS:
        off = rough.changes([(_missed(p, seen, one, look), {}) for p, seen, one in own])
        rows = rough.disturbed(eta, off, SLIGHT)
        if rows is None:  # it folds by next to nothing
            return np.zeros((len(still), 0))
        found.append((rest_of(rows, theta) - still) / (SLIGHT * np.sqrt(len(LOOKS))))
    return np.stack(found, axis=1)


def _missed(probe: Probe, seen: Recording, made: Recording, look: int) -> np.ndarray:
    """Coefficients of a fit to what frames miss of tracks [m]."""
    frames = CubicSpline(made.time[::PARTS], made.p_WQ[::PARTS])
    off = made.p_WQ[look::PARTS] - frames(made.time[look::PARTS])
    off = np.concatenate([off, off[-1:]])  # of the last frame, after which there is none
    alike = replace(
        seen,
        p_WQ=seen.reference + off,
        p_reference=seen.reference,
        valid=valid_points(seen),
        noise=probe.fit.noise,
    )
    return fit_tracks(alike, probe.body, like=probe.fit).c
