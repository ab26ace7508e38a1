"""Recordings of one specimen read for a diagnosis: which test fields and windows, and a first model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from form_drake.diagnose.model import FIRM, Model, Scenes, firm
from form_drake.identify.problem import Problem
from form_drake.identify.sign import require_sign, terms_of
from form_drake.identify.solve import require_given
from form_drake.identify.stated import weak_known
from form_drake.identify.weighing import weighing
from form_drake.laws import Law
from form_drake.material import Material
from form_drake.motion import body, fit_tracks
from form_drake.motion.tracks import placed
from form_drake.records import Recording
from form_drake.weak.choice import seen_through
from form_drake.weak.contact import HeldFields, OpenFields, seeing, tests
from form_drake.weak.fields import BoxFields, Fields
from form_drake.weak.probe import Probe
from form_drake.weak.ready import prepared
from form_drake.weak.unknowns import Unknowns
from form_drake.weak.windows import even

WINDOW = 0.2  # [s]
STRIDE = 0.5  # of windows, as a share of their width
UNKNOWN = (
    8.0 / 3.0
)  # bulk by shear modulus where the first is not to be believed: Poisson's ratio is a third
APART = 2.0  # the same, for a first model
SPANS = 2  # of the fields along each axis, one more for each held face
CLEAR = 1.0  # of the grid spacing, kept from held faces
DEEP = 0.1  # of the least edge, from every face, where a point lies inside
THROUGHOUT = 0.05  # of the points, that lie inside at least
AGREED = 1e-6  # of a known value, by which a material's may be written otherwise


def fields(recording: Recording, dx: float) -> list[Fields]:
    """Test fields that keep clear of the layers at held faces, in which simulations err most.

    Beside them: how far held faces have gone, and forces that tools should not feel.
    """
    shape = body(recording)
    held = np.zeros(3, dtype=int)
    for face in shape.faces:
        held[face.axis] += face.condition in ("bonded", "frictionless")
    spans = tuple((SPANS + held).tolist())
    tools = frozenset(recording.forces)
    tests = BoxFields.of(shape, tools, spans, clear=CLEAR * dx)
    beside = (HeldFields.of(shape), OpenFields.of(recording, shape))
    return [tests, *(f for f in beside if f is not None)]


def require_throughout(recording: Recording) -> None:
    """Refuse points of the surface alone, which leave the motion inside, and so the balance, open.

    Raises:
        ValueError: all points are stated to lie on faces, or hardly any lies inside.
    """
    shape, X = body(recording), recording.reference[placed(recording)]
    depth = DEEP * float(np.min(shape.high - shape.low))
    deep = np.all((X > shape.low + depth) & (X < shape.high - depth), axis=1)
    if recording.on_surface or deep.sum() < THROUGHOUT * len(X):
        where = f"{deep.sum()} of {len(X)} points lie deeper than {1e3 * depth:.3g} mm inside"
        if recording.on_surface:
            where = "all points are stated to lie on faces (points/face)"
        raise ValueError(
            f"{where}: the balance of a diagnosis needs points throughout the body; what faces show is"
            " compared in Python, see Sight in docs/effects.md"
        )


def probe(recording: Recording, name: str, dx: float, stride: float = STRIDE) -> Probe:
    """A recording read with these fields; no symmetry is taken, since an effect may break it.

    Raises:
        ValueError: points lie on faces alone, or the recording lacks what the balance needs.
    """
    require_throughout(recording)
    shape = body(recording)
    last = float(recording.time[-1] - recording.time[0])
    width = min(WINDOW, last)
    ends = seen_through(even(0.0, last, width, stride * width), recording.time)
    fit = fit_tracks(recording, shape, symmetric=False)
    made = prepared(recording, name, fields(recording, dx), ends, shape, fit)
    return replace(made, keep=made.keep & seeing(made.fields, made.windows))


def read(scenes: Scenes, law: Law, known: Mapping[str, float]) -> tuple[Problem, Model]:
    """The problem of all recordings, and what it says of the law without a twin.

    Args:
        scenes: of the recordings.
        law: of the specimen.
        known: given values; ``nu`` ties mu and lam.

    Raises:
        ValueError: constants of the law that must be given are not, a recording lacks what the
            balance needs, or forces seem to be of the other sign.
    """
    missing = [k for k in law.constants("given") if k not in known]
    require_given(law.name, missing, "in a --material, or in the recordings as known")
    unknowns = Unknowns.of(law, known, "law")
    problem, few = (problem_of(scenes, unknowns, stride) for stride in (STRIDE, APART))
    balance = [replace(p, keep=p.keep & tests(p.fields, p.windows)) for p in few.probes]
    found = weighing(replace(few, probes=tuple(balance)))
    require_sign(found)
    values = problem.values(found.eta) | terms_of(problem.unknowns, found.solution.theta)
    K, G = law.moduli(values)
    return problem, Model(law, firm(law, values, known, UNKNOWN) if K < FIRM * G else values)


def problem_of(scenes: Scenes, unknowns: Unknowns, stride: float = STRIDE) -> Problem:
    """Recordings of one specimen, read with these fields."""
    pairs = enumerate(zip(scenes.recordings, scenes.dx, strict=True), start=1)
    probes = [probe(recording, f"probe {n}", dx, stride) for n, (recording, dx) in pairs]
    return Problem.of(probes, unknowns, "borne")


def given(recordings: Sequence[Recording], law: Law, start: Model | None) -> dict[str, float]:
    """Constants that nothing finds, of recordings and of what is begun with.

    Raises:
        ValueError: no recording holds a force, or ``start`` has other values than they declare.
    """
    if not any(r.forces for r in recordings):
        raise ValueError(
            "no recording holds a force: the scale of the moduli cannot be told; add"
            " forces={tool: Stream(...)} to one of them"
        )
    known = weak_known(recordings, law, {})
    if start is None:
        return known
    own = Material(start.law, dict(start.values)).parameters()
    for key, value in known.items():
        if not np.isclose(own[key].value, value, rtol=AGREED):
            raise ValueError(
                f"the material has {key} {own[key].value:g}, the recordings declare {value:g} as known: begin"
                " with a material that agrees"
            )
    return known | {k: start.values[k] for k in start.law.constants("given")}
