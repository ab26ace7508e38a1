"""Parts of a picture, found again: against warps that are known in closed form."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from form_drake.perceive.correlate import Parts, matched
from form_drake.perceive.speckle import speckle
from form_drake.perceive.splines import seen_in
from form_drake.perceive.track import Tracker
from form_drake.perceive.warps import SIZE, affine, warped

WIDTH, HEIGHT, TEXELS, RIM = 320, 240, 6, 50  # pixels; texels to a pixel; pixels beyond the picture
MIDDLE = np.array([WIDTH, HEIGHT]) / 2.0
NOISE = 2.0  # grey values
HALF = 15

DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))
STEEP = 0.25  # largest strain of the barrel


def stretch(share):
    """40 % shorter, 18 % wider."""
    return np.array([1.0 + 0.18 * share, 1.0 - 0.4 * share])


def barrel(at, share):
    """How much wider a row is."""
    high = (at[..., 1] - MIDDLE[1]) / (0.5 * HEIGHT)
    return np.stack([1.0 + STEEP * share * (1.0 - high**2), np.ones(high.shape)], axis=-1)


WARPS = {  # forward, and backward from a picture to the first one
    "shift": (lambda X, s: X + 0.25 * s, lambda x, s: x - 0.25 * s),
    "compress": (
        lambda X, s: MIDDLE + (X - MIDDLE) * stretch(s),
        lambda x, s: MIDDLE + (x - MIDDLE) / stretch(s),
    ),
    "barrel": (
        lambda X, s: MIDDLE + (X - MIDDLE) * barrel(X, s),
        lambda x, s: MIDDLE + (x - MIDDLE) / barrel(x, s),
    ),
}


@pytest.fixture(scope="module")
def photograph():
    """From a way back to the speckle, a seed and what light does to a picture."""
    shape = ((HEIGHT + 2 * RIM) * TEXELS, (WIDTH + 2 * RIM) * TEXELS)
    texture = speckle(shape, 1.65 * TEXELS, np.random.default_rng(0))
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    within = (np.arange(4) + 0.5) / 4.0 - 0.5

    def taken(back=lambda x: x, seed=0, gain=1.0, offset=0.0):
        seen = np.zeros((HEIGHT, WIDTH))
        for a in within:
            for b in within:
                at = TEXELS * (back(np.stack([x + a, y + b], axis=-1)) + RIM)
                seen += map_coordinates(texture, [at[..., 1], at[..., 0]], order=1, mode="nearest")
        noise = np.random.default_rng(seed).normal(0.0, NOISE, seen.shape)
        return np.clip(np.round(offset + gain * seen / 16.0 + noise), 0, 255)

    return taken


def points(step=24, rim=50):
    x, y = np.arange(rim, WIDTH - rim, step), np.arange(rim, HEIGHT - rim, step)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(float)


@pytest.mark.parametrize(
    ("warp", "frames", "goal"), [("shift", 1, 0.004), ("compress", 8, 0.006), ("barrel", 8, 0.008)]
)
def test_points_are_followed_to_thousandths_of_a_pixel(photograph, warp, frames, goal):
    there, back = WARPS[warp]
    pictures = [photograph(lambda x, k=k: back(x, k / frames), k) for k in range(frames + 1)]
    tracker = Tracker.of(pictures[0], points(), HALF)
    *_, last = tracker.follow(pictures)
    off = (last.pixel - there(points(), 1.0))[last.held]
    assert last.held.mean() > 0.95 and np.sqrt(np.mean(off**2)) < goal
    spread = np.sqrt(np.mean(np.trace(last.covariance[last.held], axis1=1, axis2=2)) / 2.0)
    assert 0.6 < np.sqrt(np.mean(off**2)) / spread < 1.5
    second = np.abs(last.warps[:, [3, 4, 5, 9, 10, 11]]).max(axis=1) > 0.0
    assert second.mean() > 0.5 if warp == "barrel" else second.mean() < 0.1


def test_light_and_focus_do_not_move_points(photograph):
    still = Tracker.of(photograph(), points(), HALF)
    for gain, offset, blur in ((0.8, 0.0, 0.0), (1.0, 30.0, 0.0), (1.0, 0.0, 1.0)):
        other = photograph(seed=1, gain=gain, offset=offset)
        pictures = [photograph(), gaussian_filter(other, blur) if blur else other]
        *_, last = still.follow(pictures)
        most = 0.01 if blur else 0.004
        assert last.held.all() and np.sqrt(np.mean((last.pixel - points()) ** 2)) < most


def test_what_is_lost_is_said_and_found_again(photograph):
    """A hand before a corner for one picture; the points behind it are none, and there again after it."""
    seen = [photograph(lambda x, s=s: x - s, 10 + int(s)) for s in (0.0, 1.0, 2.0, 3.0)]
    covered = points().max(axis=1) < 110.0
    seen[2][:130, :130] = 128.0
    before, during, after = list(Tracker.of(seen[0], points(), HALF).follow(seen))[1:]
    assert covered.sum() > 5 and before.held.all() and after.held.all()
    assert not during.held[covered].any() and during.held[points().max(axis=1) > 150.0].all()
    assert after.pixel == pytest.approx(points() + 3.0, abs=0.02)


def test_a_picture_that_shows_nothing_costs_that_picture_alone(photograph):
    """Points have gone far from where they began, and went on meanwhile."""
    seen = [photograph(lambda x, s=s: x - s, 20 + int(s)) for s in (0.0, 6.0, 12.0, 18.0, 24.0)]
    seen[3] = np.full_like(seen[3], 250.0)
    *_, before, during, after = Tracker.of(seen[0], points(), HALF).follow(seen)
    assert before.held.all() and not during.held.any() and after.held.all()
    assert after.pixel == pytest.approx(points() + 24.0, abs=0.02)


def test_what_hides_some_points_makes_others_no_less_sure(photograph):
    """A hand leaves large and smooth rests, which tell nothing of the noise beside it."""
    still, moved = photograph(), photograph(lambda x: x - 0.25, 1)
    tracker = Tracker.of(still, points(), HALF)
    before = tracker.next((still, tracker.first), moved)
    hidden = moved.copy()
    hidden[:, :160] = np.linspace(40.0, 220.0, 160)
    during = tracker.next((still, tracker.first), hidden)
    free = points()[:, 0] > 190.0
    assert before.held[free].all() and during.held[free].all() and not during.held.all()
    size = [np.trace(p.covariance[free], axis1=1, axis2=2).mean() for p in (before, during)]
    assert size[1] == pytest.approx(size[0], rel=0.15)


@pytest.mark.parametrize("device", DEVICES)
def test_steps_undo_warps_of_second_order(photograph, device):
    """A warp as it is found is the one that made the picture, slopes and curvatures too."""
    warp = np.array([0.4, 0.05, -0.03, 8e-4, -4e-4, 6e-4, -0.3, 0.02, -0.06, 5e-4, 7e-4, -8e-4])

    def back(x):
        X = x.copy()
        for _ in range(20):
            X = X + x - MIDDLE - warped(warp, X - MIDDLE)
        return X

    parts = Parts.of(seen_in(photograph()), MIDDLE[None], HALF, device=device)
    (found,) = matched(parts, seen_in(photograph(back, 1)), np.zeros((1, SIZE))).warps
    std = np.linalg.norm(parts.steps[0], axis=1) * NOISE * np.sqrt(2.0)  # of both pictures
    assert np.all(np.abs(found - warp) < 5.0 * std)
    assert np.all(np.abs(warp[[3, 9]]) > 5.0 * std[[3, 9]])  # they are seen


def test_neighbours_tell_where_to_begin():
    slope = np.array([[0.1, 0.02], [-0.03, -0.2]])
    start = affine(np.array([1.0, 2.0]), slope)
    assert warped(start, np.array([3.0, -4.0])) == pytest.approx([4.0 + 0.22, -2.0 + 0.71])


def test_bad_pictures_are_one_line(photograph):
    picture = photograph()
    with pytest.raises(ValueError, match=r"leaves the picture of 320 x 240 px"):
        Tracker.of(picture, np.array([[5.0, 5.0], [100.0, 100.0], [50.0, 60.0]]), HALF)
    with pytest.raises(ValueError, match="has no texture"):
        Tracker.of(np.full((HEIGHT, WIDTH), 80.0), points(), HALF)
    with pytest.raises(ValueError, match="three are wanted"):
        Tracker.of(picture, points()[:2], HALF)
    tracker = Tracker.of(picture, points(), HALF)
    with pytest.raises(ValueError, match="a picture of 100 x 240 px after one of 320 x 240 px"):
        list(tracker.follow([picture, picture[:, :100]]))
    with pytest.raises(ValueError, match="one is wanted"):
        speckle((10, 10), 0.5, np.random.default_rng(0))
