"""Identification: from a recording to a material with error bars.

``step`` reads consecutive solver steps and is exact; ``rollout`` reads positions whose solver grid,
step and walls are stated; ``weak`` reads tracks and forces that no solver made.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Literal

import numpy as np

from form_drake.identify.options import Estimator, WeakOptions
from form_drake.identify.rollout import identify_rollout
from form_drake.identify.scene import Twin, stated_scenes
from form_drake.identify.solve import Identification, Unidentifiable
from form_drake.identify.start import default_start, is_led, leader, refuse_local_minimum
from form_drake.identify.stated import (
    declared_law,
    declared_values,
    numbered,
    of_one_material,
    refuse_flags,
    require_distinct,
    weak_known,
)
from form_drake.identify.step import identify_step
from form_drake.identify.trials import Guess, Rollouts, rigid_start
from form_drake.identify.weak import estimated, identify_weak, weighed
from form_drake.laws import Law
from form_drake.laws.values import checked_values
from form_drake.motion.tracks import sighted
from form_drake.records import Recording, degraded, rest_shape, restated, stepped, thinned
from form_drake.records.stepped import NEGLIGIBLE
from form_drake.workers import single

Observe = Literal["full", "no-stress", "positions"]
Method = Literal["step", "rollout", "weak"]


def most_observed(recording: Recording) -> Observe:
    """The most that a recording holds."""
    states = recording.states
    if states is None or not states.pairs():
        return "positions"
    stressed = states.tau is not None and np.isfinite(states.tau).any()
    return "full" if stressed else "no-stress"


def default_method(recording: Recording) -> Method:
    """``step`` where consecutive solver steps are held, ``rollout`` where the solver is stated."""
    if most_observed(recording) != "positions":
        return "step"
    return "rollout" if recording.solver is not None and recording.step is not None else "weak"


def chosen_method(
    recordings: Sequence[Recording], method: Method | None, observe: Observe | None
) -> Method:
    """The method that is asked for, or the first that recordings allow."""
    if method is None and observe is not None:
        return "rollout" if observe == "positions" else "step"
    return method or ("weak" if len(recordings) > 1 else default_method(recordings[0]))


@single
def identify(
    recording: Recording | Sequence[Recording],
    law: str | None = None,
    *,
    method: Method | None = None,
    observe: Observe | None = None,
    stride: int = 1,
    position_noise: float | None = None,
    add_noise: float | None = None,
    initial_velocity: Literal["known", "rigid"] | None = None,
    start: Mapping[str, Any] | None = None,
    known: Mapping[str, Any] | None = None,
    seed: int = 0,
    force: str = "sensor",
    weak: WeakOptions | Sequence[WeakOptions] | None = None,
    twin: Twin | Literal["stated"] | None = None,
) -> Identification:
    """Identify a material from a recording.

    Args:
        recording: what was measured; several probes of one material for the weak form.
        law: name of the law, or of several joined by ``+``; by default the one that the recording
            declares.
        method: ``step``, ``rollout`` or ``weak``; by default the first of them that the recording
            allows.
        observe: ``full`` (x, v, C, F and stress), ``no-stress`` or ``positions``; by default the
            most that the recording holds.
        stride: use every so many frames (positions only).
        position_noise: states the noise of the positions [m]; by default it is estimated.
        add_noise: degrades a copy of the positions by this much [m], with ``seed``.
        initial_velocity: ``known``, or ``rigid`` to find the rigid initial motion as well.
        start: where the rollouts start; by default a coarse scan decides.
        known: parameter values that are given; those that the recording declares count too. The
            weak form takes ``nu`` alone, which ties mu and lam.
        seed: of the added noise.
        force: source of the forces, see ``Recording.measured_by``.
        weak: how the weak form is set up; one for each recording, where fields or windows differ.
        twin: of the weak form: from values of all parameters to the scene simulated with them, at
            the points and frames of the recording; ``stated``: by the solver that it states. What
            reading the scene does to the answer is taken off it, and both answers are told.

    Raises:
        ValueError: the recording or an option is not as needed.
        Unidentifiable: the motion does not determine some parameters.
    """
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    if not recordings:
        raise ValueError("no recording is given")
    recordings = [r.measured_by(force) for r in recordings]
    of_one_material(recordings, law)
    require_distinct(numbered(recordings))
    first = recordings[0]
    chosen = declared_law(next((r for r in recordings if r.law is not None), first), law)
    method = chosen_method(recordings, method, observe)
    if method == "weak":
        flags = {
            "observe": observe is not None,
            "initial_velocity": initial_velocity is not None,
            "start": bool(start),
        }
        refuse_flags(flags, "step and rollout only: leave out --method weak")
        ready = [
            _degraded(sighted(r), stride, position_noise, add_noise, [seed, n] if n else seed)
            for n, r in enumerate(recordings)
        ]
        if twin == "stated":
            twin = stated_scenes(ready, chosen)
        given = weak_known(ready, chosen, known or {})
        return _noted(identify_weak(ready, chosen, given, weak, twin), add_noise)
    flags = {"twin": twin is not None} | _changed(weak)
    refuse_flags(flags, "the weak form: add --method weak")
    if len(recordings) > 1:
        raise ValueError(f"--method {method} takes one recording, got {len(recordings)}")
    seen = observe or most_observed(first)
    if method == "step" and seen == "positions":
        raise ValueError("--method step needs consecutive solver states, which the recording lacks")
    if method == "rollout":
        stepped(first)
    given = declared_values(first, chosen) | checked_values(chosen, known or {})
    if set(chosen.keys) <= set(given):
        raise ValueError("every parameter is known: nothing is left to identify")
    if method == "rollout":
        if observe not in (None, "positions"):
            raise ValueError(f"--method rollout observes positions, not {observe}")
        ready = [_degraded(first, stride, position_noise, add_noise, seed)]
        rest_shape(first)
        exact = first.p_reference is not None
        answer = _checked_positions(
            ready[0], chosen, given, start, initial_velocity, add_noise, exact
        )
        return _noted(answer, add_noise)
    flags = {
        "stride": stride != 1,
        "add_noise": add_noise is not None,
        "position_noise": position_noise is not None,
        "initial_velocity": initial_velocity == "rigid",
        "start": bool(start),
    }
    refuse_flags(flags, "positions only: add --observe positions")
    return identify_step(first, chosen, observe=seen, known=given)


@single
def estimates(
    recordings: Sequence[Recording], estimators: Sequence[Estimator], options: WeakOptions
) -> dict[str, Identification | Unidentifiable]:
    """What each estimator of the weak form says of the declared law; a refusal in its place.

    Motions are read and rows weighed once for all of them.
    """
    of_one_material(recordings, None)
    require_distinct(numbered(recordings))
    law = declared_law(recordings[0], None)
    recordings = [sighted(r) for r in recordings]
    try:
        ready = weighed(recordings, law, weak_known(recordings, law, {}), options)
    except Unidentifiable as refusal:
        return dict.fromkeys(estimators, refusal)
    found: dict[str, Identification | Unidentifiable] = {}
    for name in estimators:
        try:
            found[name] = estimated(ready, replace(options, estimator=name))
        except Unidentifiable as refusal:
            found[name] = refusal
    return found


def _degraded(
    recording: Recording,
    stride: int,
    position_noise: float | None,
    add_noise: float | None,
    seed: int | list[int],
) -> Recording:
    if position_noise is not None:
        recording = restated(recording, position_noise)
    recording = thinned(recording, stride)
    return recording if add_noise is None else degraded(recording, add_noise, seed)


def _checked_positions(
    recording: Recording,
    law: Law,
    given: dict[str, float],
    start: Mapping[str, Any] | None,
    initial_velocity: str | None,
    add_noise: float | None,
    exact: bool,
) -> Identification:
    answer = _identify_positions(recording, law, given, start, initial_velocity)
    explained = (add_noise or 0.0) + NEGLIGIBLE * float(np.max(np.ptp(recording.reference, axis=0)))
    if not exact and answer.residual > 1.2 * explained:
        raise ValueError(
            f"no rollout comes nearer than {answer.residual:.3g} m: either the first frame, taken for"
            " the rest shape, is noisy (state p_reference), or the law is another one"
        )
    return answer


def _noted(answer: Identification, add_noise: float | None) -> Identification:
    """The answer, which says what noise was added on purpose."""
    if add_noise is None:
        return answer
    return replace(answer, details={**answer.details, "added_noise": add_noise})


def _changed(weak: WeakOptions | Sequence[WeakOptions] | None) -> dict[str, bool]:
    """Which options of the weak form are not as they are by default, but for the seed."""
    every, plain = [weak] if isinstance(weak, WeakOptions) else list(weak or ()), WeakOptions()
    names = {f.name: f.name for f in fields(WeakOptions) if f.name != "seed"}
    names["free"] = "traction_free"
    return {
        told: any(getattr(one, name) != getattr(plain, name) for one in every)
        for name, told in names.items()
    }


def _identify_positions(
    recording: Recording,
    law: Law,
    given: dict[str, float],
    start: Mapping[str, Any] | None,
    initial_velocity: str | None,
) -> Identification:
    rigid = initial_velocity == "rigid" or recording.v_0 is None
    if initial_velocity == "known" and recording.v_0 is None:
        raise ValueError("the recording holds no initial velocities: use --initial-velocity rigid")
    twist = rigid_start(recording) if rigid else None
    begun = time.perf_counter()
    rollouts = Rollouts(recording, law, given)
    try:
        if not start and is_led(recording):
            leader(recording, law)
        compiled = time.perf_counter()
        if start:
            guess = Guess(_checked_start(law, given, start), twist)
        else:
            guess = default_start(rollouts, twist)
        answer = identify_rollout(rollouts, guess)
        if start:
            refuse_local_minimum(rollouts, answer, twist)
    finally:
        rollouts.close()
    details = {**answer.details, "start": guess.values}
    details["initial_velocity"] = "rigid" if rigid else "known"
    seconds = time.perf_counter() - compiled
    return replace(answer, details=details, seconds=seconds, compile_seconds=compiled - begun)


def _checked_start(
    law: Law, given: Mapping[str, float], start: Mapping[str, Any]
) -> dict[str, float]:
    values = checked_values(law, start)
    sought = [k for k in law.keys if k not in given]
    missing = [k for k in sought if k not in values]
    if missing:
        raise ValueError(f"--start lacks {', '.join(missing)}")
    bad = [k for k in sought if not values[k] > 0]
    if bad:
        raise ValueError(f"--start: {', '.join(bad)} must be positive")
    return {k: values[k] for k in sought}


__all__ = [
    "Estimator",
    "Identification",
    "Method",
    "Observe",
    "Twin",
    "Unidentifiable",
    "WeakOptions",
    "estimates",
    "identify",
]
