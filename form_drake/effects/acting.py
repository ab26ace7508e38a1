"""Effects with their sizes: what they make of a scene, and of what sensors record of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from form_drake.effects.effect import Effect, Shape
from form_drake.effects.world import World


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


def known(told: Iterable[Told], effects: Mapping[str, Effect]) -> tuple[Known, ...]:
    """Effects that a file tells, in a catalogue by id.

    Raises:
        ValueError: an effect that the catalogue does not have, or shape parameters that are not its
            own.
    """
    found = []
    for one in told:
        if one.id not in effects:
            raise ValueError(f"effect {one.id!r}: choose from {', '.join(effects)}")
        effect = effects[one.id]
        if set(one.shape) != set(effect.shapes):
            raise ValueError(
                f"effect {one.id}: shape {sorted(one.shape)} is given,"
                f" {sorted(effect.shapes) or 'none'} is wanted"
            )
        found.append(Known(effect, one.coefficient, one.shape))
    return tuple(found)


def changed(world: World, acting: Iterable[Known]) -> World:
    """A scene with the effects of the world in it."""
    for one in acting:
        if one.effect.world is not None:
            world = one.effect.world(world, one.coefficient, one.shape)
    return world


def sensed(recording: Any, acting: Iterable[Known]) -> Any:
    """What sensors with their effects tell of what they would record without."""
    for one in acting:
        if one.effect.sensor is not None:
            recording = one.effect.sensor(recording, one.coefficient, one.shape)
    return recording
