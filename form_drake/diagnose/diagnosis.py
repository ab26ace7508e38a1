"""The whole of a diagnosis: read, name, add, verify."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from form_drake.diagnose.admitted import require_one_specimen, require_solid, require_stated
from form_drake.diagnose.advice import Advice
from form_drake.diagnose.channel import Channel
from form_drake.diagnose.doubts import SILENT, UNSEEN, doubts, needless
from form_drake.diagnose.ledger import Ledger, ledgers
from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.placebo import Placebo, Removed, placebos, removals
from form_drake.diagnose.prepare import given, read
from form_drake.diagnose.rollout import Astray, astray
from form_drake.diagnose.verdict import Naming, Verdict, named
from form_drake.diagnose.verify import Check, Predicted
from form_drake.effects import Effect
from form_drake.identify.stated import numbered, of_one_material
from form_drake.laws import Law
from form_drake.material import Material
from form_drake.motion.tracks import sighted
from form_drake.records import Recording
from form_drake.workers import single


@dataclass(frozen=True)
class Diagnosis:
    """What was found.

    Attributes:
        naming: passes of scoring and adding.
        without: what fits best with nothing added.
        density: of the specimen [kg/m^3].
        check: held-out motions; None: there are none, or they could not be predicted.
        after: the same, predicted with what was added; the same as before where nothing was.
        placebos: wrong effects beside those that were added, if they were asked for.
        removed: each of several effects taken out again.
        unverified: why held-out motions verify nothing; "": they do, or there are none.
        lost: why held-out motion cannot be predicted with what was added, though without; "": it can.
        doubts: what stays open beside the verdict, in sentences; with one nothing is named without reserve.
    """

    naming: Naming
    without: Model
    density: float
    check: Check | None = None
    after: Predicted | None = None
    placebos: tuple[Placebo, ...] = ()
    removed: tuple[Removed, ...] = ()
    unverified: str = ""
    doubts: tuple[str, ...] = ()
    lost: str = ""

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Errors on held-out motions."""
        return tuple(self.check.channels(self.after)) if self.check and self.after else ()

    @cached_property
    def verdict(self) -> Verdict:
        """That of the naming, unless held-out motion does not bear it out."""
        refused = self.check and self.after and not self.check.stands(self.after)
        if self.lost or (self.naming.added and refused):
            return "unnamed"
        if self.naming.verdict == "named" and self.doubts:
            return "ambiguous"
        return self.naming.verdict

    @cached_property
    def ledgers(self) -> tuple[tuple[Ledger, ...], ...]:
        """What is left in every pass, probe by probe."""
        return tuple(ledgers(one.match) for one in self.naming.passes)

    @cached_property
    def astray(self) -> tuple[tuple[Mapping[str, Astray], ...], ...]:
        """How far the simulation is off in every pass, probe by probe."""
        return tuple(astray(one.match) for one in self.naming.passes)

    @property
    def advice(self) -> Advice:
        """What these recordings can show, and what to record next."""
        return Advice.of(self.naming, self.verdict)

    @property
    def model(self) -> Model:
        """With the effects, unless they do not explain what is left."""
        return self.without if self.verdict == "unnamed" else self.naming.model

    @property
    def material(self) -> Material:
        """That model, as it would be written."""
        return self.model.material(self.density)

    def sentence(self) -> str:
        """The verdict in words."""
        told = "; ".join(
            f"{c.effect.sentence} ({c.effect.id} {_size(c)}"
            + (f"; these recordings do not tell it from {', '.join(p.alike)})" if p.alike else ")")
            for c, p in zip(self.naming.added, self.naming.passes, strict=False)
        )
        if self.verdict == "none":
            if self.doubts:
                return "Nothing stands out in these recordings, but there is a doubt."
            if blind := len(self.advice.blind):
                unseen = f"most likely sizes of {blind} of {len(self.advice.limits)} effects"
                return (
                    f"Nothing is missing that these recordings show, but {unseen} would go unseen."
                )
            return "Nothing is missing: what is left is noise."
        if self.verdict == "unnamed":
            if failed := self.lost or self.naming.failed:
                return f"Something is missing. What comes nearest fails, {failed}"
            tried = f" The nearest, {told}, does not explain it." if told else ""
            return f"Something is missing that is not in the catalogue.{tried}"
        if self.verdict == "ambiguous":
            rivals = sorted({r for p in self.naming.passes for r in p.rivals})
            others = f"these recordings would allow {', '.join(rivals)} as well"
            return f"Missing, it seems: {told}; {others if rivals else 'but there is a doubt'}."
        return f"Missing: {told}."

    def __str__(self) -> str:
        """Verdict, scores and held-out errors as a table."""
        lines = [self.sentence(), *self.doubts, ""]
        for n, one in enumerate(self.naming.passes, start=1):
            told = ", ".join(f"{s.effect.id} {s.score:.0f}" for s in one.ranked[:5])
            lines.append(f"pass {n}: {told}")
        if self.channels:
            lines += [
                "",
                f"{'held out':24} {'before':>10} {'after':>10} {'floor':>10} {'closed':>8}",
            ]
        for c in self.channels:
            closed = f"{100.0 * c.closure:6.0f} %" if c.counts else "       -"
            numbers = " ".join(f"{v:10.3g}" for v in (c.before, c.after, c.floor))
            lines.append(f"{c.name:24} {numbers} {closed} {c.unit}")
        if self.check and self.check.unread:
            lines.append(f"the balance of held-out motion is not compared: {self.check.unread}")
        if self.unverified:
            lines += ["", f"held-out motion verifies nothing: {self.unverified}"]
        for r in self.removed:
            left = ", ".join(f"{c.name} {c.before:.3g} {c.unit}" for c in r.channels)
            lines.append(f"without {r.effect.id}: {left}")
        for p in self.placebos:
            closed = ", ".join(f"{100.0 * c.closure:.0f} %" for c in p.channels if c.counts)
            lines.append(f"placebo {p.effect.id} closes {closed or 'what is too small to tell'}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """``discrepancy.json``."""
        passes = self.naming.passes
        effects = []
        for n, cause in enumerate(self.naming.added):
            effects.append(
                {
                    "name": cause.effect.id,
                    "class": sorted({cause.effect.id, *passes[n].alike}),
                    "coefficient": cause.coefficient,
                    "std": cause.told,
                    "unit": cause.effect.unit,
                    "where": dict(cause.shape),
                    "spread": dict(cause.spread),
                    "onset": {one.name: one.onset for one in self.ledgers[n]},
                }
            )
        return {
            "verdict": self.verdict,
            "sentence": self.sentence(),
            "failed": self.lost or self.naming.failed or None,
            "doubts": list(self.doubts),
            "effects": effects,
            "values": dict(self.naming.model.values),
            "stds": self.naming.model.stds,
            "without": dict(self.without.values),
            "without_stds": self.without.stds,
            "passes": [
                {
                    "residual": float(p.match.left @ p.match.left / len(p.match.left)),
                    "scores": {s.effect.id: s.score for s in p.ranked},
                    "limits": {s.effect.id: s.limit for s in p.ranked},
                    "rivals": list(p.rivals),
                    "gone": list(p.gone),
                    "ledgers": [
                        one.to_json() | {book: own.to_json() for book, own in off.items()}
                        for one, off in zip(left, gone, strict=True)
                    ],
                }
                for p, left, gone in zip(passes, self.ledgers, self.astray, strict=True)
            ],
            "advice": self.advice.to_json(),
            "gap": [c.to_json() for c in self.channels],
            "dx": list(self.check.scenes.dx) if self.check else [],
            "unverified": self.unverified or None,
            "placebos": [p.to_json() for p in self.placebos],
            "removed": [r.to_json() for r in self.removed],
        }


def _size(cause: Cause) -> str:
    size, unit = f"{cause.coefficient:.3g}", cause.effect.unit
    if cause.told is None:
        return f"{size} {unit}, or another size: these recordings do not tell"
    return f"{size} ± {cause.told:.1g} {unit}"


@single
def diagnosed(
    recordings: Sequence[Recording],
    law: Law,
    *,
    effects: Sequence[Effect],
    thresholds: Mapping[str, float],
    start: Model | None = None,
    holdout: Sequence[Recording] = (),
    placebo: int | None = None,
    dx: float | None = None,
    device: str = "cpu",
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:
    """Find what a simulation of some recordings is missing.

    Args:
        recordings: of one specimen; one at least holds a force, which tells the scale of its moduli.
        law: of the specimen, a solid; values that the recordings declare as known stay.
        effects: a catalogue.
        thresholds: scores by effect's id that nothing missing may reach.
        start: law and values to begin with; None: identified.
        holdout: recordings on which what is found is verified.
        placebo: seed by which a wrong effect is drawn to be verified beside it; None: none is.
        dx: grid spacing of the twin [m]; None: chosen, see ``Scenes``.
        device: Warp device.
        progress: hears what is done.

    Returns:
        What was found; print it, or write it with ``to_json``.

    Raises:
        ValueError: the law is of what flows; recordings without force, or that do not state what is needed,
            those that are held back among them; that hold one motion twice, are of another box or density
            than the first, or declare other values than another or ``start``.
    """
    every = (*recordings, *holdout)
    require_solid(law)
    of_one_material(every, law.name)
    require_one_specimen(numbered(every))
    for n, recording in enumerate(every):
        require_stated(recording, dx, held_back=n >= len(recordings))
    known = given(recordings, law, start)
    scenes = Scenes.of(tuple(sighted(r) for r in recordings), dx, device)
    progress("reading the tracks")
    problem, found = read(scenes, law, known)
    naming = named(problem, scenes, start or found, effects, thresholds, progress)
    without = naming.passes[0].match.told
    density = problem.probes[0].body.density
    told = Diagnosis(naming, without, density, doubts=doubts(recordings, start, naming.model))
    if not holdout:
        return told
    progress("predicting the held-out motion")
    try:
        held = Scenes.of(tuple(sighted(r) for r in holdout), dx, device)
        check = Check.of(held, naming.passes[0].match)
    except ValueError as error:
        return replace(told, unverified=str(error))
    return _verified(replace(told, check=check), check, placebo, progress)


def _verified(
    told: Diagnosis, check: Check, placebo: int | None, progress: Callable[[str], None]
) -> Diagnosis:
    """With held-out motion predicted with what was added, without one of several, and with placebos."""
    naming, fitted = told.naming, told.naming.match if told.naming.added else None
    try:
        after = check.before if fitted is None else check.predicted(fitted)
    except ValueError as error:
        return replace(told, lost=f"held-out motion as predicted: {error}")
    if naming.verdict != "unnamed" and not check.stands(after):
        progress("predicting the held-out motion on a finer grid")
        check, after = check.finer(naming.passes[0].match, fitted, after)
    told = replace(told, check=check, after=after)
    if not naming.added:
        off = not check.bears_out(after)
        return replace(told, doubts=(*told.doubts, *((UNSEEN,) if off else ())))
    removed = tuple(removals(naming, check, after, progress))
    wrong = () if placebo is None else tuple(placebos(naming, check, placebo, progress))
    return replace(
        told,
        placebos=wrong,
        removed=removed,
        unverified="" if check.shows(after) else SILENT,
        doubts=(*told.doubts, *needless(removed)),
    )
