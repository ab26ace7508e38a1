"""The catalogue of what a simulation may leave out, each effect declared once.

An effect is a column of the weak balance and a switch of the simulation, or of the sensors; one
test holds for all of them: simulated with the effect, its coefficient is found.
"""

from pathlib import Path

from form_drake.effects.contact import ADHESION, FLOOR_SLIP, TOOL_FRICTION
from form_drake.effects.effect import Effect, Reading, Shape
from form_drake.effects.inertia import ADDED_MASS, DENSITY, DRAG, GRAVITY_TILT
from form_drake.effects.material import (
    ANISOTROPY,
    DAMPING,
    EIGENSTRAIN,
    HARDENING,
    INCLUSION,
    RATE_DEPENDENCE,
    RELAXATION,
    STIFFENING,
    YIELD,
)
from form_drake.effects.own import load
from form_drake.effects.sensor import (
    CAMERA_POSE,
    CAMERA_SCALE,
    FORCE_BIAS,
    FORCE_DELAY,
    FORCE_DRIFT,
    FORCE_GAIN,
)
from form_drake.effects.world import AddedMass, Ball, Inclusion, World

__all__ = [
    "CATALOGUE",
    "AddedMass",
    "Ball",
    "Effect",
    "Inclusion",
    "Reading",
    "Shape",
    "World",
    "catalogue",
    "load",
]

CATALOGUE: dict[str, Effect] = {
    effect.id: effect
    for effect in (
        DAMPING,
        RELAXATION,
        YIELD,
        HARDENING,
        STIFFENING,
        RATE_DEPENDENCE,
        ANISOTROPY,
        INCLUSION,
        EIGENSTRAIN,
        GRAVITY_TILT,
        DENSITY,
        ADDED_MASS,
        DRAG,
        TOOL_FRICTION,
        ADHESION,
        FLOOR_SLIP,
        FORCE_GAIN,
        FORCE_BIAS,
        FORCE_DRIFT,
        FORCE_DELAY,
        CAMERA_SCALE,
        CAMERA_POSE,
    )
}


def catalogue(own: Path | None = None) -> dict[str, Effect]:
    """``CATALOGUE``, and the effects that a file declares beside it; see ``load``."""
    return CATALOGUE | (load(own, CATALOGUE) if own else {})
