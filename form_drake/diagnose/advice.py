"""What recordings can show, and what to record next."""

from collections.abc import Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from form_drake.diagnose.recorded import motions
from form_drake.diagnose.score import DETECTED
from form_drake.diagnose.verdict import Found, Naming
from form_drake.effects import Effect

BLIND = 0.5  # share of the likely sizes that go unseen, from which more should be recorded


@dataclass(frozen=True)
class Limit:
    """The least size of an effect that recordings show.

    Attributes:
        effect: of the catalogue.
        size: five standard deviations, in the effect's unit; infinite: no row sees it.
    """

    effect: Effect
    size: float

    @property
    def missed(self) -> float:
        """Share of the likely sizes, evenly by their logarithm, that are smaller."""
        low, high = np.log(self.effect.prior)
        return float(np.clip((np.log(max(self.size, 1e-300)) - low) / (high - low), 0.0, 1.0))

    def sentence(self, recorded: Set[str]) -> str:
        """What would show the effect; ``recorded`` are motions that are there already."""
        unit = "" if self.effect.unit == "-" else f" {self.effect.unit}"
        least = f" below {self.size:.2g}{unit}" if self.missed < 1.0 else " of any likely size"
        shown = [f"{m}, stronger or longer" if m in recorded else m for m in self.effect.shown]
        return f"{self.effect.id}{least} would not be seen; shown by: {'; '.join(shown)}."


@dataclass(frozen=True)
class Apart:
    """Two effects that recordings cannot tell apart, and what could.

    Attributes:
        found: which was added.
        other: which would do as well.
        shown: what is not recorded yet and shows either, with the ids that it shows; first what
            shows one of them alone.
    """

    found: Effect
    other: Effect
    shown: tuple[tuple[str, tuple[str, ...]], ...]

    def sentence(self) -> str:
        """In words."""
        told = "; ".join(f"{motion} (shows {' and '.join(ids)})" for motion, ids in self.shown)
        return f"To tell {self.found.id} from {self.other.id}: {told or 'nothing is known'}."


@dataclass(frozen=True)
class Advice:
    """What to do next.

    Attributes:
        limits: of every effect, those that are seen best first.
        apart: pairs that are not told apart.
        verdict: of the naming, as it is told.
        recorded: kinds of motion that are there already, as effects name them.
    """

    limits: tuple[Limit, ...]
    apart: tuple[Apart, ...]
    verdict: str
    recorded: frozenset[str]

    @classmethod
    def of(cls, naming: Naming, verdict: str) -> "Advice":
        """From all passes; limits are those of the last one that has them, in which what was found is known."""
        found: dict[str, Limit] = {}
        for one in naming.passes:
            seen = [Limit(s.effect, s.limit) for s in one.ranked]
            blind = [Limit(effect, np.inf) for effect in one.unseen]
            found |= {limit.effect.id: limit for limit in (*seen, *blind)}
        for c in naming.added:
            found.pop(c.effect.id, None)
            if c.told is not None:
                found[c.effect.id] = Limit(c.effect, DETECTED * c.least)
        limits = sorted(found.values(), key=lambda one: (one.missed, one.effect.id))
        recorded = _recorded(naming)
        pairs = (pair for found in naming.passes for pair in _pairs(found, recorded))
        return cls(tuple(limits), tuple(pairs), verdict, recorded)

    @property
    def blind(self) -> tuple[Limit, ...]:
        """Effects of which most likely sizes go unseen, those that are seen least first."""
        return tuple(one for one in self.limits[::-1] if one.missed > BLIND)

    @property
    def motions(self) -> tuple[str, ...]:
        """What to record next, as effects name motions; first what tells effects apart."""
        told = [motion for pair in self.apart for motion, _ in pair.shown]
        told += [motion for one in self.blind for motion in one.effect.shown]
        return tuple(m for m in dict.fromkeys(told) if m not in self.recorded)

    def sentences(self) -> tuple[str, ...]:
        """What to record or to measure next, in words."""
        found = [pair.sentence() for pair in self.apart]
        if self.verdict == "unnamed":
            found.append(
                "No effect of the catalogue explains what is left: look where and when it is left,"
                " and declare an effect of your own (--effects)."
            )
        found += [one.sentence(self.recorded) for one in self.blind if one.effect.shown]
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """For ``discrepancy.json``."""
        return {
            "limits": [
                {
                    "effect": one.effect.id,
                    "limit": one.size if np.isfinite(one.size) else None,
                    "unit": one.effect.unit,
                    "prior": list(one.effect.prior),
                    "missed": one.missed,
                }
                for one in self.limits
            ],
            "apart": [
                {
                    "effect": pair.found.id,
                    "other": pair.other.id,
                    "shown": [{"by": motion, "effects": ids} for motion, ids in pair.shown],
                }
                for pair in self.apart
            ],
            "next": list(self.sentences()),
        }


def _recorded(naming: Naming) -> frozenset[str]:
    recordings = naming.passes[0].match.scenes.recordings
    return frozenset[str]().union(*map(motions, recordings))


def _pairs(found: Found, recorded: Set[str]) -> list[Apart]:
    if found.best is None:
        return []
    own, effects = found.best.effect, {s.effect.id: s.effect for s in found.ranked}
    others = [effects[name] for name in dict.fromkeys((*found.alike, *found.rivals))]
    return [Apart(own, other, _shown(own, other, recorded)) for other in others]


def _shown(a: Effect, b: Effect, recorded: Set[str]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    motions = [m for m in dict.fromkeys((*a.shown, *b.shown)) if m not in recorded]
    told = [(m, tuple(e.id for e in (a, b) if m in e.shown)) for m in motions]
    return tuple(sorted(told, key=lambda one: len(one[1])))
