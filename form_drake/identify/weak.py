"""Identification from the weak momentum balance: tracks and forces at camera rate."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from form_drake.identify.options import Reader, WeakFit, WeakOptions, Weighed
from form_drake.identify.posed import posed
from form_drake.identify.scene import Twin, twin_offset
from form_drake.identify.search import searched
from form_drake.identify.sign import require_sign
from form_drake.identify.solve import Identification, Unidentifiable, require_given
from form_drake.identify.surface import balanced_inside
from form_drake.identify.twin import Offset, with_twins
from form_drake.identify.weighing import weighing
from form_drake.identify.worth import at_bound, noise_bias, parameters, refuse
from form_drake.laws import Law
from form_drake.material import Material
from form_drake.records import Recording
from form_drake.weak.probe import Probe
from form_drake.weak.ready import probe_body
from form_drake.weak.solve import (
    Weights,
    gains,
    ordinary,
    passed_on,
    solved,
    throughout,
    totals,
    weights,
)

# of a row's size, by which all rows of a test field may be off alike where stress follows from a history
# between frames: a choice, of the order by which exact presses of specimens that no table shows (seeds 10 to
# 19) came out wrong on the grid of their scenario, before jolts between frames counted; wide on finer grids
PATH = 1e-3
UNEXPLAINED = 0.5  # of the stress integrals, rms: a residual that calls for a look at the forces


def identify_weak(
    recordings: Sequence[Recording],
    law: Law,
    known: Mapping[str, float],
    options: WeakOptions | Sequence[WeakOptions] | None = None,
    twin: Twin | None = None,
) -> Identification:
    """Identify a law from the weak momentum balance of one or several probes.

    Args:
        recordings: probes of one material.
        law: the law.
        known: given values; ``nu`` ties mu and lam.
        options: of the weak form; of every probe, where they differ in fields and windows.
        twin: simulates the scenes with given parameters, see ``form_drake.identify.scene``. Its
            offset is put into the columns; ``details`` then holds the answer without it.

    Raises:
        ValueError: a recording lacks what the balance needs, or forces are those of the other sign.
        Unidentifiable: the motions do not determine the parameters.
    """
    each = _of_every_probe(options, len(recordings))
    if any(r.on_surface for r in recordings):
        if twin is not None:
            raise ValueError(
                "a twin is of points throughout the body, not of points on its surface"
            )
        return balanced_inside(
            recordings,
            law,
            known,
            lambda given, read: estimated(weighed(given, law, known, each, read), each[0]),
        )
    ready = weighed(recordings, law, known, each)
    try:
        first = estimated(ready, each[0])
    except Unidentifiable:
        require_sign(ready)
        raise
    if first.residual > UNEXPLAINED:
        require_sign(ready)
    if twin is None:
        return first

    def offset(answer: Identification) -> Offset:
        return twin_offset(ready.problem, recordings, twin, answer.material.values)

    def again(found: Offset, _: Identification) -> Identification:
        return estimated(weighing(replace(ready.problem, offset=found.share)), each[0])

    answers = with_twins(first, offset, again)
    without, last = first.material.parameters(), answers[-1]
    details = {
        **last.details,
        "twins": len(answers) - 1,
        "without_twin": {k: {"value": v.value, "std": v.std} for k, v in without.items()},
    }
    return replace(last, details=details, seconds=sum(a.seconds for a in answers))


def weighed(
    recordings: Sequence[Recording],
    law: Law,
    known: Mapping[str, float],
    options: WeakOptions | Sequence[WeakOptions] | None = None,
    read: Reader = probe_body,
) -> Weighed:
    """Read the motions, search, and weigh the rows; arguments as of ``identify_weak``, and who reads."""
    begun = time.perf_counter()
    require_given(law.name, [k for k in law.constants("given") if k not in known])
    problem = posed(recordings, law, known, _of_every_probe(options, len(recordings)), read)
    reading = time.perf_counter() - begun
    found = weighing(problem)
    return replace(found, seconds=found.seconds + reading)


def estimated(ready: Weighed, options: WeakOptions) -> Identification:
    """The answer of one estimator.

    Raises:
        Unidentifiable: the motions do not determine the parameters.
    """
    begun = time.perf_counter()
    answer, fit = _answer(ready, options)
    details = {
        "pressure": ready.problem.unknowns.pressure,
        "known": dict(ready.problem.unknowns.known),
        "estimator": options.estimator,
        "probes": [_described(p) for p in ready.problem.probes],
        "model_error": fit.error,
        "bias_removed": fit.bias,
        **answer.details,
    }
    seconds = ready.seconds + time.perf_counter() - begun
    return replace(answer, details=details, seconds=seconds, weak=fit)


def _of_every_probe(
    options: WeakOptions | Sequence[WeakOptions] | None, count: int
) -> list[WeakOptions]:
    if options is None or isinstance(options, WeakOptions):
        return [options or WeakOptions()] * count
    if len(options) != count:
        raise ValueError(f"options of {len(options)} weak forms for {count} recordings")
    return list(options)


def _described(probe: Probe) -> dict[str, object]:
    return {
        "name": probe.name,
        **probe.fit.describe(),
        "windows": len(probe.windows),
        "window": float(np.diff(probe.windows.ends, axis=1).mean()),
        "fields": [n for f in probe.fields for n in f.names],
        "force_noise": {k: f.noise for k, f in probe.forces.items()},
        "force_too_fast": {k: f.fast for k, f in probe.forces.items() if f.fast is not None},
    }


def _answer(ready: Weighed, options: WeakOptions) -> tuple[Identification, WeakFit]:
    problem, eta, solution, by = ready.problem, ready.eta, ready.solution, ready.by
    noise = ready.noise
    if options.estimator == "ols":
        equal = Weights(tuple(np.eye(len(n)) for n in noise), by.error)
        eta = searched(problem, equal)
        solution = problem.solved(problem.system(eta), equal)
    theta = problem.unknowns.theta(solution.theta)
    system = problem.system(eta, theta)
    J = problem.jacobian(eta, theta)
    target = system.b - system.A @ theta + J[:, : len(solution.theta)] @ solution.theta
    free = solved(J, target, by)
    if options.estimator == "ols":
        free = ordinary(J, target, totals(noise, system.scale, by.error))
        by = equal
    gain = gains(J, by)
    if problem.unknowns.law.flow == "plastic":
        path = throughout(system, theta, max(by.error, PATH), list(map(len, noise)))
        own = totals(problem.missed, system.scale, by.error)
        true = [t + p for t, p in zip(own, path, strict=True)]
        covariance = problem.passed(eta, theta, gain) + passed_on(gain, true)
        free = replace(free, covariance=covariance)
    if any(p.fit.doubt for p in problem.probes):
        free = replace(free, covariance=free.covariance + problem.doubt(eta, theta, gain))
    phi = solution.theta
    refuse(problem, system, phi, free)
    keys, point, spread = parameters(problem, phi, eta)
    bias = np.zeros(len(phi) + len(eta))
    if options.draws:
        bias, mixed = noise_bias(problem.coarser, eta, J, by, options.draws, options.seed)
        if options.estimator == "ols":
            bias, mixed = np.zeros_like(bias), np.zeros_like(mixed)
        free = replace(free, covariance=free.covariance + mixed)
        refuse(problem, system, phi, free)
    freed = np.maximum(phi - bias[: len(phi)], problem.floors(system))
    value = parameters(problem, freed, eta - bias[len(phi) :])[1]
    covariance = spread @ free.covariance @ spread.T
    given = {k: v for k, v in problem.unknowns.known.items() if k in problem.unknowns.law.keys}
    removed = dict(zip(keys, (point - value).tolist(), strict=True))
    material = Material(
        problem.unknowns.law,
        {**given, **dict(zip(keys, value.tolist(), strict=True))},
        density=problem.probes[0].body.density,
        covariance=covariance,
        keys=keys,
    )
    residual = system.b - system.A @ theta
    row_noise = np.sqrt(np.concatenate([np.diag(n) for n in noise]))
    white = weights(noise, system.scale, 0.0).white(residual)
    answer = Identification(
        material=material,
        method="weak",
        observed="tracks and force" if any(p.forces for p in problem.probes) else "tracks",
        condition=free.condition,
        residual=float(np.sqrt(np.mean((residual / system.scale) ** 2))),
        residual_unit="of the stress integrals",
        rows=len(residual),
        seconds=0.0,
        details={
            "effective_rows": free.effective,
            "at_bound": at_bound(problem, system, freed),
            "noise_misfit": float(np.sqrt(np.mean(white**2))),
        },
    )
    return answer, WeakFit(problem, system, theta, residual, row_noise, by.error, removed)
