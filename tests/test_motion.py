"""Motion between tracks: fields with symmetries, noise, and integrals over a part of the body."""

import importlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.identify import WeakOptions, identify
from form_drake.identify.problem import Problem, _borne
from form_drake.identify.search import searched
from form_drake.laws import law_named
from form_drake.motion import body, fit_tracks
from form_drake.motion.fit import by_root
from form_drake.motion.knots import chosen_space
from form_drake.motion.modes import white_noise
from form_drake.motion.pace import LOUD, chosen_time, moments
from form_drake.motion.smoothing import smoothing_of
from form_drake.motion.space import Space, Symmetry
from form_drake.motion.splines import Splines, Tensor
from form_drake.records import Recording, Stream
from form_drake.weak.errors import noise as noise_of
from form_drake.weak.families import axial
from form_drake.weak.solve import Weights
from form_drake.weak.system import Row

ready = importlib.import_module("form_drake.weak.ready")
smoothing_module = importlib.import_module("form_drake.motion.smoothing")
LOW, HIGH = np.array([-0.01, -0.01, 0.0]), np.array([0.01, 0.01, 0.03])
SQUARE = Symmetry((0, 1), (0, 1))


def pressed(X, t):
    """A block that is squeezed along z and bulges, alike along x and y [m]."""
    a = 2e-3 * np.sin(2.0 * t)[:, None] * (X[:, 2] / 0.03)
    bulge = a * (1.0 + 40.0 * X[:, 2] - 2e3 * (X[:, 0] ** 2 + X[:, 1] ** 2))
    return np.stack([20.0 * bulge * X[:, 0], 20.0 * bulge * X[:, 1], -a], axis=-1)


def made(extra=0.0, noise=0.0, seed=0):
    """Tracks of ``pressed`` under a plate, with a share of shear and with noise [m]."""
    rng = np.random.default_rng(seed)
    X = np.random.default_rng(1).uniform(LOW, HIGH, (300, 3))
    t = np.linspace(0.0, 0.8, 60)
    u = pressed(X, t)
    u[:, :, 0] += extra * 2e-3 * np.sin(2.0 * t)[:, None] * X[:, 2] / 0.03
    pose = np.tile(np.eye(4), (60, 1, 1))
    pose[:, 2, 3] = 0.03 - 2e-3 * np.sin(2.0 * t)
    return Recording.from_arrays(
        t,
        X + u + noise * rng.standard_normal(u.shape),
        p_reference=X,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.03"},
        contact={"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        poses={"plate": Stream(t, pose)},
        forces={"plate": Stream(t, np.tile([0.0, 0.0, 1.0], (60, 1)))},
        law="neo-hookean",
    )


def tensor(x=4, y=4, z=3):
    a, b, c = (
        Splines.uniform(lo, hi, 2, d) for lo, hi, d in zip(LOW, HIGH, (x, y, z), strict=True)
    )
    return Tensor((a, b, c))


@pytest.mark.parametrize("symmetry", [Symmetry((1,)), Symmetry((0, 2)), SQUARE])
def test_no_operation_changes_a_symmetric_field(symmetry):
    space = Space(tensor(), symmetry)
    X = np.random.default_rng(0).uniform(LOW, HIGH, (40, 3))
    c = space.tied(np.random.default_rng(1).standard_normal((space.size, 1)))[:, :, 0]

    def field(X):
        return space.scalar.matrix(X) @ c

    middle = 0.5 * (LOW + HIGH)
    operations = [np.diag(np.where(np.arange(3) == a, -1.0, 1.0)) for a in symmetry.mirrors]
    if symmetry.exchange:
        operations.append(np.eye(3)[[1, 0, 2]])
    for Q in operations:
        np.testing.assert_allclose(
            field(middle + (X - middle) @ Q.T), field(X) @ Q.T, atol=1e-12 * np.abs(c).max()
        )
    assert np.abs(field(X)).min() > 0.0


@pytest.mark.parametrize("symmetry", [Symmetry(), Symmetry((1,)), SQUARE])
def test_functions_are_as_many_as_symmetric_fields(symmetry):
    space = Space(tensor(), symmetry)
    images, signs = symmetry.images(space.scalar)
    projector = np.mean(
        [s[:, None] * np.eye(len(s))[n] for n, s in zip(images, signs, strict=True)], axis=0
    )
    np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)
    assert space.size == round(np.trace(projector))


def test_the_data_choose_the_symmetry():
    for extra, noise, wanted in (
        (0.0, 1e-6, SQUARE),
        (0.2, 1e-6, Symmetry((1,))),
        (0.0, 20e-6, SQUARE),
        (0.006, 20e-6, Symmetry((1,))),
    ):
        recording = made(extra, noise=noise)
        shape = body(recording)
        X, u = recording.reference, recording.p_WQ - recording.reference
        space = chosen_space(X, u, np.ones(u.shape[:2], dtype=bool), shape, noise)
        assert space.symmetry == wanted


@pytest.mark.parametrize("seed", range(3))
def test_where_noise_hides_what_a_basis_misses_no_axis_runs_ahead(seed):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, (400, 3))
    waves = np.sin(1.2 * X[:, [1, 2, 0]] + 0.3) * np.cos(0.9 * X[:, [2, 0, 1]])
    size = 1e-3 * np.sin(np.linspace(0.1, 2.0, 60))[:, None, None]
    noise = 1e-4
    recording = Recording.from_arrays(
        np.linspace(0.0, 1.0, 60),
        X + size * waves + noise * rng.standard_normal((60, *X.shape)),
        p_reference=X,
        density=1000.0,
        geometry={"shape": "box", "low": "-1 -1 -1", "high": "1 1 1"},
        contact={"other": "unknown"},
        law="neo-hookean",
    )
    u = recording.p_WQ - recording.reference
    space = chosen_space(X, u, np.ones(u.shape[:2], dtype=bool), body(recording), noise)
    sizes = [s.size for s in space.scalar.axes]
    assert max(sizes) - min(sizes) <= 2
    # and the field is followed far below the noise of one track in one frame
    exact = space.scalar.matrix(X)
    missed = waves - exact @ np.linalg.lstsq(exact, waves, rcond=None)[0]
    assert np.sqrt(np.mean(missed**2)) * 1e-3 < 0.05 * noise


def test_an_axis_along_which_nothing_varies_is_not_refined():
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (400, 3))
    waves = np.zeros_like(X)
    waves[:, 0] = np.sin(3.0 * X[:, 1])
    size, noise = 1e-3 * np.sin(np.linspace(0.1, 2.0, 60))[:, None, None], 2e-4
    u = size * waves + noise * rng.standard_normal((60, *X.shape))
    recording = Recording.from_arrays(
        np.linspace(0.0, 1.0, 60),
        X + u,
        p_reference=X,
        density=1000.0,
        geometry={"shape": "box", "low": "-1 -1 -1", "high": "1 1 1"},
        contact={"other": "unknown"},
        law="newtonian",
    )
    space = chosen_space(X, u, np.ones(u.shape[:2], dtype=bool), body(recording), noise)
    x, y, z = (s.size for s in space.scalar.axes)
    assert x == z == 2 and y >= 8


def test_unlike_faces_admit_no_mirror():
    shape = body(made())
    assert {s.mirrors for s in Symmetry.wider(shape, Symmetry())} == {(0,), (1,)}
    assert SQUARE in Symmetry.wider(shape, Symmetry((0, 1)))


def test_noise_stands_apart_from_fast_motion():
    rng = np.random.default_rng(0)
    t, X = np.arange(120), rng.standard_normal((200, 3))
    fast = np.cos(2.4 * t)[:, None, None] * X + np.sin(1.1 * t)[:, None, None] * X[:, [1, 2, 0]]
    noise = 1e-3 * rng.standard_normal(fast.shape)
    assert white_noise(fast + noise) == pytest.approx(1e-3, rel=0.02)
    assert white_noise(fast + 0.01 * noise) == pytest.approx(1e-5, rel=0.02)


def test_covariance_of_a_symmetric_fit_is_that_of_its_errors():
    noise, shape = 20e-6, body(made())
    first = fit_tracks(made(noise=noise), shape)
    assert first.space.symmetry == SQUARE
    true = fit_tracks(made(), shape, like=first).c
    X = np.random.default_rng(3).uniform(LOW, HIGH, (30, 3))
    Phi, B = first.space.scalar.matrix(X), first.time.matrix(np.linspace(0.1, 0.7, 9))

    def size(change):
        return np.sqrt(np.mean(np.einsum("pa,ait,st->pis", Phi, change, B) ** 2))

    fits = [fit_tracks(made(noise=noise, seed=s), shape, like=first) for s in range(12)]
    errors = np.mean([size(f.c - true) for f in fits])
    claimed = np.mean([size(f.draw(np.random.default_rng(n))) for n, f in enumerate(fits)])
    assert claimed == pytest.approx(errors, rel=0.25)
    assert errors < 0.2 * noise


def test_what_the_fields_do_not_follow_is_in_the_covariance():
    """Waves shorter than the distance of the tracks: independent from point to point, not in time."""
    shape, plain = body(made()), made(noise=1e-7)
    first = fit_tracks(plain, shape)
    X = np.random.default_rng(3).uniform(LOW, HIGH, (30, 3))
    Phi, B = first.space.scalar.matrix(X), first.time.matrix(np.linspace(0.1, 0.7, 9))

    def size(change):
        return np.sqrt(np.mean(np.einsum("pa,ait,st->pis", Phi, change, B) ** 2))

    def fitted(seed):
        wave = 5e-6 * np.random.default_rng(seed).standard_normal(plain.p_WQ.shape[1:])
        wave = wave * (1.5 * np.sin(2.0 * plain.time))[:, None, None]
        return fit_tracks(replace(plain, p_WQ=plain.p_WQ + wave), shape, like=first)

    fits = [fitted(seed) for seed in range(12)]
    errors = np.mean([size(f.c - first.c) for f in fits])
    claimed = np.mean([size(f.draw(np.random.default_rng(n))) for n, f in enumerate(fits)])
    assert claimed == pytest.approx(errors, rel=0.25)
    assert size(first.draw(np.random.default_rng(0))) < 0.1 * errors


def test_a_body_that_drifts_is_symmetric_about_its_centre():
    still = made()
    shape, first = body(still), fit_tracks(made(), body(made()))
    drift = np.outer(np.sin(3.0 * still.time), [1e-3, -2e-4, 0.0])[:, None]
    X = still.reference
    uneven = X[:, 0] > -0.3 * X[:, 1]  # tracks that lie unevenly must not turn drift into strain
    moved = replace(still, p_WQ=(still.p_WQ + drift)[:, uneven], p_reference=X[uneven])
    found = fit_tracks(moved, shape)
    assert first.space.symmetry == found.space.symmetry == SQUARE
    again = fit_tracks(moved, shape, like=first)
    assert np.abs(again.c - first.c).max() < 1e-3 * 1e-3


def test_covariance_of_the_rows_is_that_of_their_errors(monkeypatch):
    # with smoothing the claim holds what that takes away too, of which such plain motion has little
    monkeypatch.setattr(
        smoothing_module, "_share", lambda power, roughness, noise: np.ones(len(roughness))
    )
    noise, shape = 20e-6, body(made())
    first = made(noise=noise)
    fit = fit_tracks(first, shape)
    ends = np.array([[0.1, 0.4], [0.3, 0.6]])
    law, theta = law_named("neo-hookean"), np.array([1e4, 1e5])
    whole = np.ones(len(law.terms), dtype=bool)
    probe = ready.prepared(first, "", axial(first, shape, fit), ends, shape, fit)
    errors = []
    for seed in range(24):
        again = replace(probe, fit=fit_tracks(made(noise=noise, seed=seed), shape, like=fit))
        along = again.along(again.motion)
        errors.append(again.rest(along, {}) - again.columns(along, law, {}, whole) @ theta)
    size, directions = np.linalg.eigh(noise_of(probe, law, {}, theta))
    white = (np.array(errors) - np.mean(errors, axis=0)) @ directions / np.sqrt(size)
    assert np.mean(white[:, size > 0.1 * size[-1]] ** 2) == pytest.approx(1.0, rel=0.35)


def test_the_error_of_a_mode_is_that_of_its_field_and_of_its_series():
    """Noise along the mode's field at all times, and along its series in all functions."""
    rng = np.random.default_rng(0)
    series, field = (a / np.linalg.norm(a) for a in (rng.standard_normal(n) for n in (30, 50)))
    roughness = np.geomspace(1.0, 1e4, 50)
    true = 300.0 * np.outer(series, field / np.sqrt(roughness) / 0.1)
    field = true[0] / np.linalg.norm(true[0])

    def smoothed(z):
        smoothing, spread = smoothing_of(z, roughness, np.ones(50), 1.0, np.zeros(30))
        return smoothing(z), spread

    made = [smoothed(true + rng.standard_normal(true.shape)) for _ in range(200)]
    errors = np.array([z for z, _ in made]) - np.mean([z for z, _ in made], axis=0)
    others = np.eye(30) - np.outer(series, series)
    drawn = []
    for _ in range(200):
        total = np.zeros((50, 30))
        for part in made[0][1]:
            white = part.scale * rng.standard_normal((len(part.scale), part.time_root.shape[1]))
            total += (white if part.mix is None else part.mix @ white) @ part.time_root.T
        drawn.append(total.T)
    for project in (lambda e: others @ e @ field, lambda e: series @ e):
        measured, claimed = (np.mean([project(e) ** 2 for e in some]) for some in (errors, drawn))
        assert claimed == pytest.approx(measured, rel=0.35)


def test_slow_motion_below_the_noise_is_kept_and_its_loss_is_claimed():
    """Of what stands out in no mode, each octave is smoothed by its own size."""
    rng = np.random.default_rng(1)
    roughness, octaves = np.geomspace(1.0, 1e4, 80), np.repeat([0, 1, 2, 3], (10, 10, 20, 40))
    slow = octaves == 0
    strong = 300.0 * np.outer(np.eye(80)[0], 1.0 / np.sqrt(roughness))

    def drawn(octaves):
        true = strong + slow[:, None] * rng.standard_normal((80, 80)) / np.sqrt(roughness / 3.0)
        z = true + rng.standard_normal(true.shape)
        smoothing, spread = smoothing_of(z, roughness, np.ones(80), 1.0, octaves)
        size = sum(
            part.scale**2 @ part.time_root.T**2
            if part.mix is None
            else part.mix**2
            @ np.broadcast_to(part.scale**2, (len(part.scale), 80))
            @ part.time_root.T**2
            for part in spread
        )
        return (smoothing(z) - true)[slow] ** 2, size.T[slow]

    for given, least, most in ((octaves, 0.7, 1.4), (np.zeros(80), 2.0, np.inf)):
        error, claimed = np.mean([drawn(given) for _ in range(20)], axis=(0, 2, 3))
        assert least < error / claimed < most


def test_moments_are_ordered_by_their_frequency():
    time = np.linspace(0.0, 2.0, 101)
    splines = Splines(np.linspace(0.0, 2.0, 41), 4)
    series, back, octaves = moments(splines, time)
    np.testing.assert_allclose(series.T @ series, np.eye(splines.size), atol=1e-10)
    np.testing.assert_allclose(splines.matrix(time) @ back, series, atol=1e-10)
    assert np.all(np.diff(octaves) >= 0)
    for half_waves, octave in ((1, 0), (3, 0), (5, 1), (10, 2), (20, 3)):
        wave = np.cos(np.pi * half_waves * time / 2.0)
        share = np.array([np.sum((series[:, octaves == n].T @ wave) ** 2) for n in range(6)])
        assert np.argmax(share) == octave


def test_half_of_a_mirrored_body_is_enough(monkeypatch):
    recording = made()
    shape = body(recording)
    fit = fit_tracks(recording, shape)
    fields = axial(recording, shape, fit)
    assert fields[0].lateral.shape == (1, 3)  # alike along x and y
    ends = np.array([[0.1, 0.4], [0.3, 0.6]])
    monkeypatch.setattr(ready, "GAUSS", 6)
    quarter = ready.prepared(recording, "", fields, ends, shape, fit)
    monkeypatch.setattr(ready, "_mirrors", lambda *_: [])
    whole = ready.prepared(recording, "", fields, ends, shape, fit)
    assert np.all(quarter.motion.X[:, :2] < 0.0) and whole.motion.X.max(axis=0)[0] > 0.0
    law, values = law_named("neo-hookean"), {}
    for one, other in zip(
        *(
            (
                p.columns(p.along(p.motion), law, values, np.ones(len(law.terms), dtype=bool)),
                p.rest(p.along(p.motion), {}),
                noise_of(p, law, values, np.array([1e4, 1e5])),
            )
            for p in (quarter, whole)
        ),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, atol=1e-6 * np.abs(other).max())


def test_what_a_body_has_borne_stays():
    labels = [Row((0.1 * n, 0.1 * n + 0.2), f) for n in range(3) for f in ("a", "b")]
    scale = np.array([1.0, 5.0, 3.0, 1.0, 2.0, 7.0])
    np.testing.assert_array_equal(_borne(scale, labels), [1.0, 5.0, 3.0, 5.0, 3.0, 7.0])


def test_stated_absence_of_noise_is_read():
    fit = fit_tracks(replace(made(), noise=0.0), body(made()))
    assert fit.noise == 0.0
    answer = identify(replace(made(), noise=0.0), method="weak", known={"kappa": 1e5})
    assert np.isfinite(answer.material.values["C10"])


def test_knots_gather_where_samples_are_dense():
    rng = np.random.default_rng(0)
    time = np.sort(np.concatenate([rng.uniform(0.0, 0.5, 100), rng.uniform(0.5, 1.0, 11)]))
    wave = np.sin(60.0 * time) * np.exp(-10.0 * np.abs(time - 0.25))
    y = np.stack([wave, np.cos(3.0 * time)], axis=-1)
    splines = chosen_time(time, y + 1e-3 * rng.standard_normal(y.shape), 1e-3)
    B = splines.matrix(time)
    rest = (y - B @ np.linalg.lstsq(B, y, rcond=None)[0])[time < 0.5]
    assert np.sqrt(np.mean(rest**2)) < 2e-3


def test_what_is_between_frames_is_told_where_some_are_missing():
    """A vibration that frames hardly follow asks for all the splines there can be."""
    time = np.delete(np.arange(80) / 60.0, [20, 21, 50, 77, 78])
    y = np.outer(np.cos(27.0 * np.pi * time), np.random.default_rng(0).standard_normal(6))
    splines = chosen_time(time, y, 1e-3)
    R = np.linalg.qr(splines.matrix(time))[1]
    between = splines.matrix(0.5 * (time[1:] + time[:-1])) @ np.linalg.inv(R)
    assert len(splines.breaks) > 60
    assert np.linalg.norm(between, axis=1).max() <= LOUD


def test_knots_gather_first_where_most_would_be_lost():
    """Quicker than the samples can tell everywhere: what is largest, at the end, is followed."""
    time = np.arange(103) / 60.0
    size = 1e-5 + 3e-3 * np.maximum(time - 1.2, 0.0)
    y = np.stack([size * np.sin(132.0 * time), size * np.cos(132.0 * time)], axis=-1)
    B = chosen_time(time, y, 1e-8).matrix(time)
    rest = y - B @ np.linalg.lstsq(B, y, rcond=None)[0]
    assert np.abs(rest).max() < 0.01 * np.abs(y).max()


def test_fields_that_are_images_of_each_other_are_not_used_twice():
    made_of = {"method": "weak", "known": {"kappa": 1e5}}
    box = identify(made(), **made_of, weak=WeakOptions(fields=("box",)))
    assert not box.weak.problem.probes[0].fit.space.symmetry
    assert identify(made(), **made_of).weak.problem.probes[0].fit.space.symmetry == SQUARE


class Powers(Problem):
    """b = sum of theta_k times (x^a_k - x^(-a_k / 2)) / x, as a stretched sheet of Ogden's law."""

    x = np.linspace(1.0, 2.2, 40)
    b = np.zeros(40)

    @property
    def coarser(self):
        return self

    def rows(self, eta, theta=None):
        a = np.exp(eta)
        return (self.x[:, None] ** a - self.x[:, None] ** (-0.5 * a)) / self.x[:, None], self.b


@pytest.mark.parametrize("true, theta", [((1.3, 5.0), (1.0, 0.01)), ((2.0, 8.0), (1.0, 0.001))])
def test_two_nonlinear_constants_are_found_together(true, theta):
    unknowns = SimpleNamespace(
        law=SimpleNamespace(terms=()),
        keys=("a", "b"),
        searched=("one", "two"),
        M=np.eye(2),
        offset=np.zeros(2),
        theta=lambda phi: phi,
    )
    probe = SimpleNamespace(keep=np.ones(40, dtype=bool))
    problem = Powers((probe,), unknowns, ((1.0 / 300.0, 300.0), (4.0 / 300.0, 1200.0)))
    problem.b[:] = problem.rows(np.log(true))[0] @ np.array(theta)
    eta = searched(problem, Weights((np.eye(40),), 0.0))
    np.testing.assert_allclose(np.sort(np.exp(eta)), true, rtol=1e-3)


def test_a_fit_like_another_is_linear_and_has_its_response():
    """What noise does to a fit whose smoothing is given is that smoothing of the noise."""
    made_without, drawn = made(), []
    shape = body(made_without)
    like = fit_tracks(made(noise=3e-5), shape, symmetric=False)
    plain = fit_tracks(made_without, shape, like=like)
    rng = np.random.default_rng(5)
    noise = 3e-5 * rng.standard_normal(made_without.p_WQ.shape)
    both, once, twice = (
        fit_tracks(replace(made_without, p_WQ=made_without.p_WQ + k * noise), shape, like=like).c
        for k in (0.0, 1.0, 2.0)
    )
    assert np.array_equal(both, plain.c)
    assert np.allclose(twice - both, 2.0 * (once - both), atol=1e-12)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        p_WQ = made_without.p_WQ + 3e-5 * rng.standard_normal(made_without.p_WQ.shape)
        drawn.append(fit_tracks(replace(made_without, p_WQ=p_WQ), shape, like=like).c - plain.c)
    claimed = [like.responding.draw(np.random.default_rng(n)) for n in range(30)]
    size = like.space.size
    root = like.space.tied(by_root(like.space, like.roots, np.eye(size))).reshape(-1, size)
    stated = sum(
        np.broadcast_to(p.scale, (size, p.time_root.shape[1])) ** 2 @ p.time_root.T**2
        for p in like.response
    )
    sure, back = stated > 1e-6 * stated.max(), np.linalg.pinv(root)
    for some in (drawn, claimed):
        white = np.array([back @ c.reshape(len(root), -1) for c in some])
        share = np.mean(white[:, sure] ** 2 / stated[sure])
        assert np.sqrt(share) == pytest.approx(1.0, rel=0.05)
