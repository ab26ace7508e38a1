"""What effects change of a twin, as differences of simulations: on which grid they are taken."""

import numpy as np
import pytest

from form_drake.diagnose import Model, Scenes
from form_drake.diagnose.columns import rest_of, twin_of
from form_drake.diagnose.match import Match
from form_drake.diagnose.motions import Block, noisy
from form_drake.diagnose.prepare import read
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS

BLOCK = Block(size=(0.024, 0.022, 0.02), points=90)
MODEL = Model(LAWS[BLOCK.law], {"C10": 4e3, "kappa": 15e3})


@pytest.mark.parametrize("plate", ["frictionless", "bonded"])
def test_a_coarser_grid_tells_what_no_held_layer_does(plate):
    """8 cells along an edge are 5.3 in the search, and 3.6 for a difference, unless layers bear what is measured."""
    plan = BLOCK.press(plate, 0.7)
    (made,) = Scenes.of((plan,)).rough.rolled(MODEL)
    scenes = Scenes.of((noisy(made, np.random.default_rng(0)),))
    problem, _ = read(scenes, MODEL.law, {})
    match, effect = Match.of(problem, scenes, MODEL), CATALOGUE["density"]
    eta, theta = match.twin.coordinates(MODEL.values)
    more = twin_of(problem, scenes.rough, MODEL.more(effect, effect.trial, {}))
    plain, other = (rest_of(t.rows(eta, theta), theta) for t in (match.twin, more))
    own = match.by.white((other - plain) / effect.trial)
    found = match.columns(effect, [{}])[:, 0]
    assert np.allclose(found, own) is (plate == "bonded")
    assert found @ own > 0.97 * np.linalg.norm(found) * np.linalg.norm(own)
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(own), rel=0.1)
