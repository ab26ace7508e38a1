"""Twins of measured scenes: simulated recordings that the weak form reads as it reads the data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from form_drake.identify.led import rolled
from form_drake.identify.problem import Problem
from form_drake.identify.twin import Offset
from form_drake.laws import Law
from form_drake.motion import fit_tracks
from form_drake.motion.tracks import valid_points
from form_drake.records import Recording
from form_drake.weak.ready import prepared

# values of all parameters -> the scene of every probe, without noise, at the points and frames of
# the measured one
Twin = Callable[[dict[str, float]], Recording | Sequence[Recording]]


def twin_offset(
    problem: Problem, recordings: Sequence[Recording], twin: Twin, values: Mapping[str, float]
) -> Offset:
    """What reading the scenes does to the rows of a problem, from a twin with given parameters.

    Raises:
        ValueError: as of ``twin_problem``.
    """
    read = twin_problem(problem, recordings, twin, values)
    eta, theta = problem.coordinates(values)
    return Offset.of(read.system(eta, theta), theta)


def twin_problem(
    problem: Problem, recordings: Sequence[Recording], twin: Twin, values: Mapping[str, float]
) -> Problem:
    """The scenes of a twin with given parameters, read as those of a problem.

    Bases, test fields, windows and quadrature are those of the data.

    Raises:
        ValueError: the twin holds other probes, points or frames than the data.
    """
    made = twin(dict(values))
    made = [made] if isinstance(made, Recording) else list(made)
    if [r.p_WQ.shape for r in made] != [r.p_WQ.shape for r in recordings] or not all(
        np.allclose(m.time - m.time[0], r.time - r.time[0], rtol=1e-6)
        for m, r in zip(made, recordings, strict=True)
    ):
        raise ValueError(
            f"the twin's frames, points and axes {[r.p_WQ.shape for r in made]} and its stamps must"
            f" be those of the recording, {[r.p_WQ.shape for r in recordings]}"
        )
    probes = []
    for probe, own, data in zip(problem.probes, made, recordings, strict=True):
        # smoothed as the data are, whose noise decides by how much
        alike = replace(own, valid=valid_points(data), noise=probe.fit.noise)
        fit = fit_tracks(alike, probe.body, like=probe.fit)
        read = prepared(
            alike, probe.name, probe.fields, probe.windows.ends, probe.body, fit, probe.released
        )
        probes.append(replace(read, keep=probe.keep))
    return replace(problem, probes=tuple(probes), offset=None)


def stated_scenes(recordings: Sequence[Recording], law: Law) -> Twin:
    """Rollouts of recordings that state their own solver, and whose points are its particles.

    Raises:
        ValueError: a recording does not state how it was stepped.
    """
    for recording in recordings:
        if recording.solver is None or recording.step is None or recording.v_0 is None:
            raise ValueError(
                "--twin rolls the scene again: a recording must state its solver, every frame's step"
                " and the initial velocities"
            )
    return lambda values: [rolled(r, law, values) for r in recordings]
