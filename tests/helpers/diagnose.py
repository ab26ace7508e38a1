"""Probes of a block under a bonded plate, simulated with causes and measured with noise."""

from dataclasses import replace

import numpy as np

from form_drake.diagnose import Model, Scenes
from form_drake.identify.problem import Problem
from form_drake.laws import LAWS
from form_drake.motion import body, fit_tracks
from form_drake.records import Recording, Stream
from form_drake.weak.fields import BoxFields
from form_drake.weak.ready import prepared
from form_drake.weak.unknowns import Unknowns
from form_drake.weak.windows import even

DX, NOISE = 0.004, 5e-6
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}


def probe(seconds, stroke, beat):
    """A block under a bonded plate that presses, and goes back."""
    low, size = np.array([-0.01, -0.01, 0.0]), np.full(3, 0.02)
    X = low + size * np.random.default_rng(0).uniform(0.04, 0.96, (120, 3))
    t = np.linspace(0.0, seconds, round(150 * seconds) + 1)
    down = stroke * np.sin(np.pi * t / seconds) ** 2 + 2e-4 * np.sin(beat * t)
    return planned(X, t, 0.02 - down)


def planned(X, t, height):
    """Points of a block of 20 mm at rest, and the way of the bonded plate that presses it [m]."""
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    pose[:, 2, 3] = height
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
        law=LAW.name,
    )


def noisy(made, seed):
    rng = np.random.default_rng(seed)
    force = made.forces["plate"]
    size = 0.005 * np.abs(force.value).max()
    value = force.value + size * rng.standard_normal(force.value.shape)
    return replace(
        made,
        p_WQ=made.p_WQ + NOISE * rng.standard_normal(made.p_WQ.shape),
        noise=NOISE,
        forces={"plate": Stream(force.time, value, noise=size)},
    )


PROBE = probe(0.4, 1.6e-3, 50.0)


def rolled(*causes):
    (made,) = Scenes.of((PROBE,), DX).rolled(Model(LAW, TRUTH, causes))
    return made


def problem_of(data):
    shape = body(data)
    fields = BoxFields.of(shape, frozenset(data.forces), spans=(1, 1, 3), clear=DX)
    fit = fit_tracks(data, shape, symmetric=False)
    seen = prepared(data, "probe", [fields], even(0.0, 0.4, 0.12, 0.05), shape, fit)
    return Problem.of([seen], Unknowns.of(LAW, {}, "law"), "borne")
