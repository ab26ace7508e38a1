"""Tracking errors that last: what a period of rest tells of them."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.motion import body, fit_tracks
from form_drake.motion.lasting import lasting
from form_drake.records import Recording

FRAMES, RATE, REST = 121, 60.0, 0.6
WHITE, SHIFT, FADES = 2e-5, 4e-5, 0.1  # [m], [m], [s]
TIME = np.arange(FRAMES) / RATE
LOW, SIZE = np.array([-0.01, -0.01, 0.0]), np.full(3, 0.02)
X = LOW + SIZE * np.random.default_rng(0).uniform(0.04, 0.96, (80, 3))
LOOKED = np.array([[0.0, 0.0, 0.01], [0.005, 0.005, 0.015]]), 1.4  # [m], [s]


def fading(rng, series, fades=FADES):
    """Errors of unit variance that fade from frame to frame, shape [frames, series]."""
    kept = np.exp(-1.0 / RATE / fades)
    found = rng.standard_normal((FRAMES, series))
    for n in range(1, FRAMES):
        found[n] = kept * found[n - 1] + np.sqrt(1.0 - kept**2) * found[n]
    return found


def stretch(time):
    """Of a block that rests, and is then pressed, along every axis, shape [..., 3]."""
    way = 0.05 * np.sin(2.0 * np.clip(time - REST, 0.0, None)) ** 2
    return np.stack([1.0 + 0.4 * way, 1.0 + 0.4 * way, 1.0 - way], axis=-1)


def shaky(seed, shift):
    """Its tracks, as cameras see them that sway together."""
    rng = np.random.default_rng(seed)
    x = X * stretch(TIME)[:, None] + WHITE * rng.standard_normal((FRAMES, len(X), 3))
    return Recording.from_arrays(
        TIME,
        x + shift * fading(rng, 3)[:, None],
        p_reference=X,
        noise=WHITE,
        density=1000.0,
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.02"},
        contact={"z-": "bonded floor", "z+": "bonded plate", "other": "free"},
        rest=np.array([[0.0, REST]]),
    )


def told_and_true(shift):
    """Standard deviations that fits tell with the rest and without, and their errors [m]."""
    places, time = LOOKED
    with_it, without, errors = [], [], []
    for seed in range(5):
        recording = shaky(seed, shift)
        fit = fit_tracks(recording, body(recording), symmetric=False)
        plain = fit_tracks(replace(recording, rest=None), body(recording), symmetric=False)
        values, basis = fit.space.scalar.matrix(places), fit.time.matrix(np.array([time]))[0]
        u = np.einsum("pa,ait,t->pi", values, fit.c, basis)
        errors.append(u - places * (stretch(time) - 1.0))
        with_it.append(fit.deviation(time, places))
        without.append(plain.deviation(time, places))
    return (float(np.sqrt(np.mean(np.square(one)))) for one in (with_it, without, errors))


def test_a_rest_tells_errors_that_follow_each_other_and_stated_noise_does_not():
    told, stated, error = told_and_true(SHIFT)
    assert stated < 0.2 * error and 0.7 * error < told < 2.0 * error


def test_errors_that_are_white_cost_nothing():
    told, stated, error = told_and_true(0.0)
    assert told == stated < 1.5 * error


def test_what_lasts_is_found_in_the_functions_that_hold_it():
    sizes, kept = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        white = rng.standard_normal((FRAMES, 100))
        white[:, :6] += 3.0 * fading(rng, 6)
        found = lasting(white, TIME, np.array([[0.0, 0.99], [1.0, 2.0]]))
        variance = found.scale[:, 0] ** 2
        sizes.append(variance.sum() / (6 * 9.0))
        assert variance[:6].sum() > 0.85 * variance.sum()
        kept.append((found.time_root @ found.time_root.T)[0, 1])
    assert np.mean(kept) == pytest.approx(np.exp(-1.0 / RATE / FADES), abs=0.03)
    assert 1.0 < np.mean(sizes) < 1.8  # a standard deviation more than it is


def test_short_rests_show_less_than_there_is():
    """An error that keeps nine tenths from frame to frame, three quarters of all."""
    told = {}
    for frames in (8, 20):
        sizes = []
        for seed in range(40):
            rng = np.random.default_rng(seed)
            white = 0.5 * rng.standard_normal((FRAMES, 120))
            white += np.sqrt(0.75) * fading(rng, 120, 1.0 / RATE / np.log(1.0 / 0.9))
            found = lasting(white, TIME, np.array([[0.0, (frames - 0.5) / RATE]]))
            sizes.append(0.0 if found is None else np.mean(found.scale**2) / 0.75)
        told[frames] = np.median(sizes)
    assert 0.35 < told[8] < 0.65 and 0.8 < told[20] < 1.1


@pytest.mark.parametrize("rest", [None, [[0.0, 0.1]], [[0.0, 0.5]]])
def test_white_noise_does_not_last_nor_does_a_glance_tell(rest):
    rest = None if rest is None else np.array(rest)
    for seed in range(50):
        white = np.random.default_rng(seed).standard_normal((FRAMES, 150))
        assert lasting(white, TIME, rest) is None


@pytest.mark.parametrize("kind", ["means", "sway", "brief", "everywhere"])
def test_whatever_lasts_is_never_far_more_than_there_is(kind):
    """Means of two frames, a sway of eight frames, what fades in a frame, and a little in all functions."""
    sizes = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        white, few = rng.standard_normal((FRAMES, 100)), rng.standard_normal((FRAMES + 1, 6))
        phase = 2.0 * np.pi * (7.5 * TIME[:, None] + rng.random(6))
        errors = {
            "means": 3.0 * (few[1:] + few[:-1]) / np.sqrt(2.0),
            "sway": 3.0 * np.sqrt(2.0) * np.sin(phase),
            "brief": 3.0 * fading(rng, 6, 1.0 / RATE),
            "everywhere": 0.7 * fading(rng, 100, FADES),
        }[kind]
        white[:, : errors.shape[1]] += errors
        found = lasting(white, TIME, np.array([[0.0, REST]]))
        size = 0.0 if found is None else np.sum(found.scale**2)
        sizes.append(size / np.sum(errors.var(axis=0)))
    assert np.median(sizes) > 0.5 and max(sizes) < 5.0
