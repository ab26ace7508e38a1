"""Effects with their sizes: what they make of a scene, and of what sensors record of it."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from form_drake.effects.effect import Effect, Shape, ball
from form_drake.effects.world import World
from form_drake.laws import Law

WHOLE = 1.0 + 1e-9  # the stress, of which effects take shares, with what adding up rounds


class Told(Protocol):
    """An effect as a file tells it, see ``form_drake.material.Acting``."""

    @property
    def id(self) -> str: ...

    @property
    def coefficient(self) -> float: ...

    @property
    def shape(self) -> Shape: ...


@dataclass(frozen=True)
class Known:
    """An effect of a catalogue with its size.

    Attributes:
        effect: of the catalogue.
        coefficient: in its unit.
        shape: values of its shape parameters.
    """

    effect: Effect
    coefficient: float
    shape: Shape


def known(told: Iterable[Told], law: Law, effects: Mapping[str, Effect]) -> tuple[Known, ...]:
    """Effects that a file tells beside a law, in a catalogue by id.

    Raises:
        ValueError: an effect that the catalogue does not have, that does not fit the law, or whose
            coefficient or shape there cannot be.
    """
    found = list[Known]()
    for one in told:
        if one.id not in effects:
            raise ValueError(
                f"effect {one.id!r}: choose from {', '.join(effects)}; --effects FILE adds your own"
            )
        effect = effects[one.id]
        effect.check(one.coefficient, one.shape)
        if not effect.fits(law):
            raise ValueError(
                f"effect {one.id} does not fit law {law.name}, which has it already or is of another kind"
            )
        if not effect.shapes and any(other.effect is effect for other in found):
            raise ValueError(
                f"effect {one.id} is named twice: one coefficient, their sum, says the same"
            )
        found.append(Known(effect, one.coefficient, one.shape))
    shares = [one for one in found if one.effect.share]
    if sum(one.coefficient for one in shares) > WHOLE:
        raise ValueError(
            f"effects {', '.join(one.effect.id for one in shares)}: together they take more than all of the stress; their"
            " coefficients must add up to one at most"
        )
    return tuple(found)


def placed(acting: Iterable[Known], low: np.ndarray, high: np.ndarray) -> None:
    """Refuse places that lie outside of a body.

    Args:
        acting: effects with their sizes.
        low: corner of the box about the body when free of stress [m], shape [3].
        high: the opposite corner.

    Raises:
        ValueError: the ball of one reaches nowhere into the box.
    """
    for one in acting:
        if "radius" in one.effect.shapes and not ball(one.shape).meets(low, high):
            raise ValueError(
                f"effect {one.effect.id}: a ball of {one.shape['radius']:g} m about"
                f" {[one.shape[axis] for axis in 'xyz']} m lies outside of the body, which reaches from"
                f" {np.round(low, 6).tolist()} to {np.round(high, 6).tolist()}"
            )


def changed(world: World, acting: Iterable[Known]) -> World:
    """A scene with the effects of the world in it.

    Raises:
        ValueError: one of them fails, or makes no scene.
    """
    for one in acting:
        if one.effect.world is not None:
            world = _switched(one, one.effect.world, world)
    return world


def sensed(recording: Any, acting: Iterable[Known]) -> Any:
    """What sensors with their effects tell of what they would record without.

    Raises:
        ValueError: one of them fails, or tells no recording.
    """
    for one in acting:
        if one.effect.sensor is not None:
            recording = _switched(one, one.effect.sensor, recording)
    return recording


def _switched(one: Known, switch: Callable[[Any, float, Shape], Any], what: Any) -> Any:
    try:
        found = switch(what, one.coefficient, one.shape)
    except ValueError:
        raise
    except Exception as error:
        raise failure(one.effect, error) from error
    if not isinstance(found, type(what)):
        kind, got = type(what).__name__, type(found).__name__
        raise ValueError(f"effect {one.effect.id}: it must return a {kind}, got {got}")
    return found


def failure(effect: Effect, error: Exception) -> ValueError:
    """What a function of an effect raises, as one line."""
    kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}, "
    return ValueError(f"effect {effect.id}: {kind}{error}")
