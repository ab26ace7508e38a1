"""Effects scored along tracks: the hidden one stands out, and nothing does where nothing is hidden.

Data and twin come from one solver here, at moduli that the twin has to find: what the simulator
itself would be wrong by is not in it.
"""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.diagnose.match import matched
from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.score import coherence, scores, shapes
from form_drake.effects import CATALOGUE
from form_drake.identify.problem import Problem
from form_drake.laws import LAWS
from form_drake.material import Material
from form_drake.motion import body, fit_tracks
from form_drake.mpm.stage import Stage
from form_drake.records import Recording, Stream
from form_drake.weak.fields import BoxFields
from form_drake.weak.ready import prepared
from form_drake.weak.unknowns import Unknowns
from form_drake.weak.windows import even

DX, NOISE = 0.004, 5e-6
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
START = {"mu": 19e3, "lam": 42e3}
NAMES = ("stiffening", "anisotropy", "eigenstrain", "drag", "density", "force-bias", "force-delay")
EFFECTS = [CATALOGUE[name] for name in NAMES]


def probe():
    """A block under a bonded plate that presses, holds and goes back."""
    low, size = np.array([-0.01, -0.01, 0.0]), np.full(3, 0.02)
    X = low + size * np.random.default_rng(0).uniform(0.04, 0.96, (120, 3))
    t = np.linspace(0.0, 0.4, 61)
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    pose[:, 2, 3] = 0.02 - 1.6e-3 * np.sin(np.pi * t / 0.4) ** 2 - 2e-4 * np.sin(50.0 * t)
    return Recording.from_arrays(
        t,
        np.tile(X, (len(t), 1, 1)),
        p_reference=X,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.02"},
        contact={"z-": "bonded floor", "z+": "bonded plate", "other": "free"},
        poses={"plate": Stream(t, pose)},
        forces={"plate": Stream(t, np.zeros((len(t), 3)))},
    )


STAGE = Stage(probe(), DX)


def rolled(values):
    return STAGE.rolled(STAGE.world(Material(LAW, dict(values), 1000.0)))


@pytest.fixture(scope="module")
def plain():
    return rolled(TRUTH)


def noisy(made, seed=0):
    rng = np.random.default_rng(seed)
    force, size = made.forces["plate"], 0.005 * np.abs(made.forces["plate"].value).max()
    value = force.value + size * rng.standard_normal(force.value.shape)
    return replace(
        made,
        p_WQ=made.p_WQ + NOISE * rng.standard_normal(made.p_WQ.shape),
        noise=NOISE,
        forces={"plate": Stream(force.time, value, noise=size)},
    )


def scored(data):
    """Scores about a twin that has been brought near to the data from a wrong start."""
    shape = body(data)
    fields = BoxFields.of(shape, frozenset(data.forces), spans=(1, 1, 3), clear=DX)
    fit = fit_tracks(data, shape, symmetric=False)
    read = prepared(data, "probe", [fields], even(0.0, 0.4, 0.12, 0.05), shape, fit)
    problem = Problem.of([read], Unknowns.of(LAW, {}, "law"), "borne")
    match = matched(problem, Scenes.of((data,), DX), Model(LAW, START))
    return scores(match, EFFECTS), match


def test_nothing_stands_out_where_nothing_is_hidden(plain):
    found, match = scored(noisy(plain))
    assert max(s.score for s in found) < 12.0
    assert match.left @ match.left < 1.3 * len(match.left)
    for k, true in TRUTH.items():
        assert match.model.values[k] == pytest.approx(true, rel=0.03)


HIDDEN = {
    "anisotropy": (4e3, {"azimuth": np.radians(45.0), "elevation": np.radians(30.0)}),
    "force-delay": (4e-3, {}),
    "eigenstrain": (5e-3, {}),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_the_hidden_effect_stands_out(name, plain):
    effect, (size, shape) = CATALOGUE[name], HIDDEN[name]
    if effect.world is None:
        made = effect.sensor(plain, size, shape)
    else:
        made = STAGE.rolled(effect.world(STAGE.world(Material(LAW, TRUTH, 1000.0)), size, shape))
    found, _ = scored(noisy(made))
    assert found[0].effect is effect and found[0].score > 2.0 * found[1].score
    assert 0.5 < found[0].coefficient / size < 2.0  # to first order, about moduli that took a part
    assert found[0].limit < size
    assert np.allclose(np.diag(coherence(found)), 1.0)


def test_places_lie_inside_the_body():
    shape = body(probe())
    tried = shapes(CATALOGUE["inclusion"], shape)
    places = np.array([[one[k] for k in "xyz"] for one in tried])
    assert len(tried) == 125 and np.all((places > shape.low) & (places < shape.high))
    assert tried[0]["radius"] == pytest.approx(0.004)
    assert shapes(CATALOGUE["drag"], shape) == [{}]
