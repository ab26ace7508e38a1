"""Specimens with an effect that nobody knows, drawn from a seed, at sizes that a press and a shake show."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.motions import DEPTH, Block, noisy
from form_drake.effects import CATALOGUE, Effect
from form_drake.laws import LAWS
from form_drake.records import Recording

STIFFNESS, RATIO = (30e3, 90e3), (0.30, 0.42)  # E [Pa], log-uniform; Poisson's ratio
Unit = Literal["", "E", "1/E", "force"]  # force: E times area times strain of the deepest press
SIZES: dict[str, tuple[float, float, Unit]] = {  # log-uniform
    "damping": (100.0, 500.0, ""),
    "relaxation": (0.1, 0.3, ""),
    "yield": (1.0, 1.0, ""),
    "hardening": (1.0, 1.0, ""),
    "stiffening": (0.5, 2.0, "E"),
    "rate-dependence": (60.0, 300.0, ""),
    "anisotropy": (0.2, 0.8, "E"),
    "inclusion": (2.0, 6.0, ""),
    "eigenstrain": (5e-3, 2e-2, ""),
    "gravity-tilt": (0.1, 0.3, ""),
    "density": (0.15, 0.4, ""),
    "added-mass": (4e-3, 1.2e-2, ""),
    "drag": (30.0, 100.0, ""),
    "tool-friction": (0.1, 0.4, ""),
    "adhesion": (400.0, 1500.0, ""),
    "floor-slip": (1e-3, 1e-2, "1/E"),
    "force-gain": (0.05, 0.2, ""),
    "force-bias": (0.03, 0.2, "force"),
    "force-drift": (0.02, 0.1, "force"),
    "force-delay": (8e-3, 3e-2, ""),
    "camera-scale": (4e-3, 2e-2, ""),
    "camera-pose": (8e-3, 4e-2, ""),
}
SHAPES = {"time": (0.1, 0.4), "strain": (0.015, 0.03), "growth": (0.1, 0.5), "n": (0.3, 0.7)}
CENTRE, RADIUS = 0.15, (0.18, 0.26)  # of the edges, off the middle; of the height
ALONE = {"tool-friction", "adhesion"}  # seen under a plate that does not hold the body
LEAVING = {"adhesion"}  # and where it leaves


@dataclass(frozen=True)
class Hidden:
    """What was drawn.

    Attributes:
        block: the specimen, and how it is seen.
        values: of its law.
        plate: how the plate holds it: ``bonded`` or ``frictionless``.
        cause: the effect.
    """

    block: Block
    values: dict[str, float]
    plate: str
    cause: Cause

    @classmethod
    def drawn(
        cls, block: Block, name: str, rng: np.random.Generator, at: float | None = None
    ) -> "Hidden":
        """A specimen with an effect.

        Args:
            block: neo-Hookean.
            name: id of the effect.
            rng: of material, plate, size and shape.
            at: size of the effect, from 0 for the least to 1 for the largest; None: drawn.
        """
        E, nu = _between(rng, STIFFNESS), float(rng.uniform(*RATIO))
        values = {"C10": E / (4.0 * (1.0 + nu)), "kappa": E / (3.0 * (1.0 - 2.0 * nu))}
        plate = "frictionless" if rng.random() < 0.5 or name in ALONE else "bonded"
        low, high, unit = SIZES[name]
        share = float(rng.random()) if at is None else at
        force = E * block.size[0] * block.size[1] * DEPTH
        size = low * (high / low) ** share * {"": 1.0, "E": E, "1/E": 1.0 / E, "force": force}[unit]
        effect = CATALOGUE[name]
        return cls(block, values, plate, Cause(effect, size, _shape(effect, block, rng)))

    @property
    def model(self) -> Model:
        """The specimen with its effect."""
        return Model(LAWS[self.block.law], self.values, (self.cause,))

    def press(self, **how: float) -> Recording:
        """A press of its plate, yet to be simulated; see ``Block.press``."""
        return self.block.press(self.plate, opens=self.cause.effect.id in LEAVING, **how)

    def recorded(
        self,
        planned: tuple[Recording, ...],
        finer: float,
        rng: np.random.Generator,
        dx: float | None = None,
    ) -> list[Recording]:
        """What is recorded of it, with noise.

        Args:
            planned: recordings yet to be simulated.
            finer: times as many cells along every axis as a twin has.
            rng: of the noise.
            dx: grid spacing of a twin [m]; None: chosen, see ``Scenes``.
        """
        scenes = Scenes.of(planned, dx)
        scenes = replace(scenes, dx=tuple(dx / finer for dx in scenes.dx))
        return [noisy(made, rng) for made in scenes.rolled(self.model)]

    def to_json(self) -> dict[str, Any]:
        """The truth, for a file."""
        cause = self.cause
        effect = {"name": cause.effect.id, "coefficient": cause.coefficient}
        return {"values": self.values, "effect": {**effect, "where": dict(cause.shape)}}


def _between(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def _shape(effect: Effect, block: Block, rng: np.random.Generator) -> dict[str, float]:
    if "radius" in effect.shapes:
        size = np.array(block.size)
        place = size * np.array([0.0, 0.0, 0.5]) + size * rng.uniform(-CENTRE, CENTRE, 3)
        radius = float(size[2] * rng.uniform(*RADIUS))
        return {**dict(zip("xyz", place.tolist(), strict=True)), "radius": radius}
    ends = {k: SHAPES.get(k, (min(t), max(t))) for k, t in effect.shapes.items() if t}
    return {k: float(rng.uniform(*both)) for k, both in ends.items()}
