"""Cameras: against OpenCV's own projection, and points that are known."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake.perceive.optics import looking, projected, rays, triangulated

FOCUS, BASELINE, FAR = 4000.0, 0.1, 0.3  # px, m, m
LENS = np.array([0.08, -0.03, 1e-3, -2e-3, 0.01])


def camera(x):
    return looking(np.array([x, 0.0, -FAR]), np.zeros(3), FOCUS, (640, 480), LENS)


PAIR = [camera(-0.5 * BASELINE), camera(0.5 * BASELINE)]
POINTS = np.random.default_rng(0).uniform(-0.015, 0.015, (300, 3))


def test_a_camera_sees_what_it_looks_at_in_the_middle():
    one = looking(np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.1, -0.1]), 500.0, (641, 481))
    assert projected(one, np.array([0.0, 0.1, -0.1])) == pytest.approx([320.0, 240.0])
    assert one.X_WC[:3, :3].T @ one.X_WC[:3, :3] == pytest.approx(np.eye(3))
    assert np.linalg.det(one.X_WC[:3, :3]) == pytest.approx(1.0) and one.X_WC[1, 1] > 0.0
    with pytest.raises(ValueError, match="not along \\[0"):
        looking(np.zeros(3), np.array([0.0, 1.0, 0.0]), 500.0, (641, 481))


def test_pixels_are_those_of_opencv():
    import cv2

    one = PAIR[0]
    X_CW = np.linalg.inv(one.X_WC)
    turn = cv2.Rodrigues(X_CW[:3, :3])[0]
    wanted = cv2.projectPoints(POINTS, turn, X_CW[:3, 3], one.K, LENS)[0][:, 0]
    assert projected(one, POINTS) == pytest.approx(wanted, abs=1e-8)
    assert np.isnan(projected(one, np.array([[0.0, 0.0, -1.0]]))).all()  # behind it


def test_rays_go_through_the_points_that_are_seen():
    one = PAIR[1]
    d = rays(one, projected(one, POINTS))
    along = POINTS - one.X_WC[:3, 3]
    assert np.linalg.norm(np.cross(d, along), axis=1) == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("radial", [0.3, -0.3])
def test_rays_are_those_of_a_strong_lens_or_none(radial):
    """A wide picture: at its corners repeated substitution would miss by up to hundreds of pixels."""
    one = looking(np.zeros(3), np.array([0, 0, 1.0]), 600.0, (1280, 960), (radial, 0.1, 1e-3, 0, 0))
    x, y = np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 959, 25))
    pixel = np.stack([x, y], axis=-1).reshape(-1, 2)
    d = rays(one, pixel)
    told = np.isfinite(d).all(axis=1)
    assert told.mean() > 0.9
    assert projected(one, d[told]) == pytest.approx(pixel[told], abs=1e-6)


def test_noise_of_pixels_is_noise_of_points_as_stated():
    """At 300 mm .006 px are 1.5 um in depth and .5 um across, as stereo geometry says."""
    sigma = 0.006
    rng = np.random.default_rng(1)
    seen = np.stack([projected(c, POINTS) for c in PAIR])
    exact = triangulated(PAIR, seen, np.tile(np.eye(2), (2, len(POINTS), 1, 1)))
    assert exact.p_WQ == pytest.approx(POINTS, abs=1e-12) and exact.off.max() < 1e-6
    covariance = np.tile(sigma**2 * np.eye(2), (2, len(POINTS), 1, 1))
    found = triangulated(PAIR, seen + sigma * rng.standard_normal(seen.shape), covariance)
    off = found.p_WQ - POINTS
    depth = sigma * FAR / FOCUS / np.sqrt(2.0) * 2.0 * FAR / BASELINE
    assert np.std(off[:, 2]) == pytest.approx(depth, rel=0.15)
    square = np.einsum("pi,pij,pj->p", off, np.linalg.inv(found.covariance), off)
    assert np.mean(square) == pytest.approx(3.0, rel=0.15)
    assert np.sqrt(np.mean(found.off**2)) == pytest.approx(1.0, rel=0.1)


def test_what_one_camera_sees_is_no_point():
    seen = np.stack([projected(c, POINTS) for c in PAIR])
    seen[1, :10], seen[:, 10] = np.nan, np.nan
    found = triangulated(PAIR, seen, np.tile(np.eye(2), (2, len(POINTS), 1, 1)))
    assert np.isnan(found.p_WQ[:11]).all() and np.isnan(found.off[:11]).all()
    assert found.p_WQ[11:] == pytest.approx(POINTS[11:], abs=1e-12)


def test_a_wrong_calibration_shows():
    """The right camera a twentieth of a degree off, and a third camera that is not."""
    third = camera(0.0)
    third.X_WC[1, 3] += 0.05
    angle = np.radians(0.05)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    wrong = replace(PAIR[1], X_WC=PAIR[1].X_WC @ turn)
    seen = np.stack([projected(c, POINTS) for c in PAIR])
    covariance = np.tile(0.006**2 * np.eye(2), (2, len(POINTS), 1, 1))
    assert triangulated([PAIR[0], wrong], seen, covariance).off.min() > 50.0
    more = np.concatenate([seen, projected(third, POINTS)[None]])
    three = np.tile(covariance[:1], (3, 1, 1, 1))
    assert triangulated([*PAIR, third], more, three).p_WQ == pytest.approx(POINTS, abs=1e-12)


def test_one_camera_is_refused():
    with pytest.raises(ValueError, match="1 cameras and pixels of 1: two are wanted"):
        triangulated(PAIR[:1], np.zeros((1, 5, 2)), np.zeros((1, 5, 2, 2)))
