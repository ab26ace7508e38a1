"""A speckled surface that moves as a rigid body, rendered and followed by two cameras."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from form_drake.perceive.optics import looking, projected
from form_drake.perceive.render import Light, Renderer, Surface
from form_drake.perceive.seen import APART, Sight
from form_drake.perceive.speckle import speckle
from form_drake.perceive.stereo import Stereo

FOCUS, FAR, BASELINE, SIZE = 4000.0, 0.3, 0.1, (400, 320)
HALF = np.array([0.016, 0.013])  # m, of the plate
TEXELS = 6 * FOCUS / FAR  # a metre: six to a pixel
FRAMES = 3
SHIFT, TURN = np.array([4e-4, -3e-4, 5e-4]), np.radians([1.0, -1.5, 2.0])


def camera(x):
    return looking(np.array([x, 0.0, -FAR]), np.zeros(3), FOCUS, SIZE, (0.05, 0.0, 0.0, 0.0, 0.0))


CAMERAS = [camera(-0.5 * BASELINE), camera(0.5 * BASELINE)]


def moved(p, share):
    return p @ Rotation.from_rotvec(share * TURN).as_matrix().T + share * SHIFT


@pytest.fixture(scope="module")
def pairs():
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HALF
    plate = np.column_stack([corners, np.zeros(4)])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    rows, columns = (int(2 * h * TEXELS) + 1 for h in HALF[::-1])
    texture = speckle((rows, columns), 1.65 * 6, np.random.default_rng(0))
    surface = Surface.of(plate, triangles, ((corners + HALF) * TEXELS)[triangles], texture)
    renderer, rng, light = Renderer(CAMERAS), np.random.default_rng(1), Light(noise=2.0)
    return [
        [light.seen(p, rng) for p in renderer.pictures(surface.moved(moved(plate, k / FRAMES)))]
        for k in range(FRAMES + 1)
    ]


def points():
    x, y = np.arange(-0.010, 0.0101, 1.6e-3), np.arange(-0.008, 0.0081, 1.6e-3)
    flat = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.column_stack([flat, np.zeros(len(flat))])


def test_a_rigid_body_moves_as_one(pairs):
    """Depth to 1.5 um and 0.3 um across, at 300 mm; no strain that is not there."""
    X = points()
    stereo = Stereo.of(CAMERAS, pairs[0], X, np.tile([0.0, 0.0, -1.0], (len(X), 1)))
    assert stereo.chosen.mean() > 0.95
    first, *_, last = stereo.follow(pairs)
    X = X[stereo.chosen]
    assert np.abs(first.p_WQ - X).max() < 2e-5
    held = np.isfinite(last.p_WQ[:, 0])
    assert held.mean() > 0.95
    off = (last.p_WQ - first.p_WQ - moved(X, 1.0) + X)[held]
    assert np.sqrt(np.mean(off[:, 2] ** 2)) < 1.5e-6
    assert np.sqrt(np.mean(off[:, :2] ** 2)) < 0.3e-6
    strain = np.linalg.lstsq(
        np.column_stack([X[held], np.ones(held.sum())])[:, [0, 1, 3]], off, None
    )[0]
    assert np.abs(strain[:2]).max() < 1e-4
    square = np.einsum("pi,pij,pj->p", off, np.linalg.inv(last.covariance[held]), off)
    assert 2.0 < np.mean(square) < 4.5  # three where covariances are right


def test_spots_that_show_nothing_cost_their_points_alone(pairs):
    """Bare in the left picture, white to the end of the sensor in the right one."""
    X, normal = points(), np.tile([0.0, 0.0, -1.0], (len(points()), 1))
    plain = Stereo.of(CAMERAS, pairs[0], X, normal)
    left, right = (picture.copy() for picture in pairs[0])
    left[120:180, 120:180], right[120:180, 230:290] = 90, 255
    stereo = Stereo.of(CAMERAS, [left, right], X, normal)
    at = [projected(camera, X) for camera in CAMERAS]
    spots = zip(at, ([149.5, 149.5], [259.5, 149.5]), strict=True)
    within, near = np.zeros((2, len(X)), bool)
    for pixel, middle in spots:
        off = np.abs(pixel - middle).max(axis=1)
        within, near = within | (off < 18.0), near | (off < 45.0)
    assert within.sum() > 5 and not stereo.chosen[within].any()
    assert np.array_equal(stereo.chosen[~near], plain.chosen[~near])


@pytest.mark.parametrize(("grey", "words"), [(90, "has no texture"), (255, "change the exposure")])
def test_where_hardly_a_point_is_left_it_is_said_why(pairs, grey, words):
    bare = pairs[0][0].copy()
    bare[:, 60:] = grey
    with pytest.raises(ValueError, match=rf"\d+ of \d+ points .*{words}"):
        Stereo.of(CAMERAS, [bare, pairs[0][1]], points(), np.tile([0.0, 0.0, -1.0], (143, 1)))


def test_swapped_cameras_are_told(pairs):
    X = points()
    with pytest.raises(ValueError, match="are left and right swapped"):
        Stereo.of(CAMERAS, pairs[0][::-1], X, np.tile([0.0, 0.0, -1.0], (len(X), 1)))


@pytest.mark.parametrize("axis", [0, 1])
def test_cameras_that_are_a_little_off_still_tell_how_points_move(pairs, axis):
    """A twentieth of a degree: places are off, displacements some micrometres, whatever way it is turned."""
    X = points()
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(np.radians(0.05) * np.eye(3)[axis]).as_matrix()
    wrong = [CAMERAS[0], replace(CAMERAS[1], X_WC=CAMERAS[1].X_WC @ turn)]
    stereo = Stereo.of(wrong, pairs[0], X, np.tile([0.0, 0.0, -1.0], (len(X), 1)))
    first, *_, last = stereo.follow(pairs)
    X = X[stereo.chosen]
    assert np.abs(first.p_WQ - X).max() > 1e-4
    off = last.p_WQ - first.p_WQ - moved(X, 1.0) + X
    assert np.sqrt(np.nanmean(off**2)) < 1.5e-5


def test_cameras_that_see_other_times_are_told_from_those_that_see_the_same(pairs):
    X = points()
    stereo = Stereo.of(CAMERAS, pairs[0], X, np.tile([0.0, 0.0, -1.0], (len(X), 1)))
    late = [pairs[0], *([now[0], before[1]] for before, now in pairwise(pairs))]
    begun = stereo.begun(pairs[0])
    assert Sight.of(0.0, begun).held.all()
    for pair, other in zip(pairs[1:], late[1:], strict=True):
        assert Sight.of(0.0, begun.next(pair)).held.mean() > 0.95
        sight = Sight.of(0.0, begun.next(other))
        assert not sight.held.any() and sight.apart > APART
