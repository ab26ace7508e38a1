"""The problem that recordings pose: fields, windows and who balances pressure, chosen or as stated."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from form_drake.identify.options import Reader, WeakOptions
from form_drake.identify.problem import Problem
from form_drake.identify.solve import Unidentifiable
from form_drake.laws import Law
from form_drake.motion import Body, Fit
from form_drake.records import Recording
from form_drake.weak.choice import (
    chosen_pressure,
    chosen_windows,
    seen_through,
    spaced,
    told_apart,
    traction_free,
    traction_free_as,
    while_pressed,
)
from form_drake.weak.families import chosen_fields
from form_drake.weak.probe import Probe
from form_drake.weak.ready import check_loads, feel_pressure, mirrored, prepared
from form_drake.weak.unknowns import Pressure, Unknowns


def posed(
    recordings: Sequence[Recording],
    law: Law,
    known: Mapping[str, float],
    each: Sequence[WeakOptions],
    read: Reader,
) -> Problem:
    """Probes of one material and what is sought of its law.

    Args:
        recordings: of the probes.
        law: the law.
        known: given values.
        each: options of every probe; those of the whole are the first one's.
        read: makes the body and the fitted motion of a recording.

    Raises:
        ValueError: options that a recording does not bear, or nothing is left to identify.
        Unidentifiable: nobody balances the pressure that a parameter acts by.
    """
    if each[0].pressure == "supplied" and any(r.pressure is None for r in recordings):
        raise ValueError(
            "pressure supplied: a recording holds none; give it (points/pressure), or let the law balance"
            " it (pressure law)"
        )
    fitted = [(r, *read(r)) for r in recordings]
    for given in fitted:
        check_loads(*given)
    unknowns = Unknowns.of(law, known, _pressure(fitted, law, each))
    if unknowns.undecided:
        raise Unidentifiable.of(law, unknowns.undecided, "pressure is free or supplied")
    if not unknowns.keys and not unknowns.searched:
        raise ValueError("every parameter is known: nothing is left to identify")
    probes = []
    for n, (given, own) in enumerate(zip(fitted, each, strict=True)):
        probes.append(_probe(f"probe {n + 1}", *given, own, unknowns, read, len(fitted)))
    return Problem.of(probes, unknowns, each[0].level)


def _pressure(
    fitted: Sequence[tuple[Recording, Body, Fit]], law: Law, each: Sequence[WeakOptions]
) -> Pressure:
    thin = any(own.free for own in each)
    pressure = each[0].pressure or chosen_pressure(fitted, law, thin=thin)
    if thin and pressure == "free":
        raise ValueError(
            "pressure free: across a thin body it is what leaves the sides free of stress; let the law"
            " balance it (pressure law), or leave out the traction-free axes"
        )
    return pressure


def _probe(
    name: str,
    recording: Recording,
    shape: Body,
    fit: Fit,
    own: WeakOptions,
    unknowns: Unknowns,
    read: Reader,
    probes: int,
) -> Probe:
    """One of some ``probes``, with its fields and windows."""
    law, ends = unknowns.law, np.array(own.ends)
    if not own.ends:
        ends = chosen_windows(recording, law, own.window)
        if recording.on_surface:
            ends = told_apart(while_pressed(ends, recording, shape), recording, fit)
    fields = chosen_fields(own.fields, recording, shape, fit, ends, unknowns)
    if not mirrored(fit, fields):
        # a field and its image would give one row twice
        fit = read(recording, False)[1]
        fields = chosen_fields(own.fields, recording, shape, fit, ends, unknowns)
    if not own.ends:
        ends = spaced(ends, fields, probes, some=recording.on_surface)
        ends = seen_through(ends, recording.time)
    free = traction_free(fields) if own.free is None else traction_free_as(own.free, law)
    # what the law balances must not act twice
    held = replace(recording, pressure=None) if unknowns.pressure == "law" else recording
    probe = prepared(held, name, fields, ends, shape, fit, free)
    if unknowns.pressure == "free" and (feeling := feel_pressure(probe)):
        raise ValueError(
            f"pressure free: test fields {', '.join(feeling)} feel the pressure that is left out;"
            " choose axial, bend-curl or potential, or let the law balance it (pressure law)"
        )
    return probe
