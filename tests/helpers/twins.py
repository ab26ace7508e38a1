"""A small block under a plate, and its twin."""

from functools import cache

import numpy as np

from form_drake.diagnose import Model, Scenes
from form_drake.diagnose.match import Match
from form_drake.diagnose.motions import Block, noisy
from form_drake.diagnose.prepare import read
from form_drake.laws import LAWS

BLOCK = Block(size=(0.024, 0.022, 0.02), points=90)
MODEL = Model(LAWS[BLOCK.law], {"C10": 4e3, "kappa": 15e3})


@cache
def begun(plate, seconds, **more):
    """A twin beside noisy data of the same model."""
    plan = BLOCK.press(plate, seconds, **more)
    return beside(plan, MODEL)


def beside(plan, model):
    """A twin beside noisy data of another model, on one grid."""
    (made,) = Scenes.of((plan,)).rough.rolled(model)
    scenes = Scenes.of((noisy(made, np.random.default_rng(0)),))
    problem, _ = read(scenes, MODEL.law, {})
    return Match.of(problem, scenes, MODEL)
