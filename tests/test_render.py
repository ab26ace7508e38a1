"""Rendered pictures: against projections of dots that are integrated by themselves."""

import numpy as np
import pytest

from form_drake.perceive.optics import looking, projected
from form_drake.perceive.render import GROUND, Light, Renderer, Surface

DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))
HALF, CELLS, TEXELS = 0.02, 20, 80e3  # m; cells and texels a metre: six to a pixel
DOT, GREY, LIGHT = 1.6e-4, 40.0, 170.0  # m; grey values of ground and dots


def camera(x):
    return looking(np.array([x, 0.0, -0.3]), np.zeros(3), 4e3, (480, 360))


@pytest.fixture(scope="module")
def dotted():
    """A plane turned by 20 degrees, and its dots, by their places along it."""
    along = np.array([[np.cos(np.radians(20.0)), 0.0, np.sin(np.radians(20.0))], [0.0, 1.0, 0.0]])
    edge = np.linspace(-HALF, HALF, CELLS + 1)
    plane = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(-1, 2)
    corner = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = (
        corner[i : CELLS + i, j : CELLS + j].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))
    )
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    count = int(2 * HALF * TEXELS) + 1
    texture = np.full((count, count), GREY)
    rng = np.random.default_rng(0)
    dots = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-3, 4)), axis=-1).reshape(-1, 2) * 3e-3
    dots = dots + rng.uniform(-2e-4, 2e-4, dots.shape)
    reach = int(6 * DOT * TEXELS)
    for u, v in (dots + HALF) * TEXELS:
        j, i = np.ogrid[int(v) - reach : int(v) + reach + 1, int(u) - reach : int(u) + reach + 1]
        square = ((i - u) ** 2 + (j - v) ** 2) / (DOT * TEXELS) ** 2
        texture[j, i] += LIGHT * np.exp(-0.5 * square)
    uv = (plane + HALF) * TEXELS
    return Surface.of(plane @ along, triangles, uv[triangles], texture), dots, along


def middle(camera, dot, along):
    """Centre of a dot's light in a picture [px], integrated over the plane."""
    span = np.linspace(-6.0 * DOT, 6.0 * DOT, 61)
    beside = np.stack(np.meshgrid(span, span), axis=-1).reshape(-1, 2)
    light = np.exp(-0.5 * np.sum(beside**2, axis=1) / DOT**2)
    points = (dot + beside) @ along
    depth = (points - camera.X_WC[:3, 3]) @ camera.X_WC[:3, 2]
    weight = light / depth**3  # a plane's area in a picture
    return weight @ projected(camera, points) / weight.sum()


@pytest.mark.parametrize("device", DEVICES)
def test_dots_are_seen_where_cameras_see_them(dotted, device):
    surface, dots, along = dotted
    cameras = [camera(-0.05), camera(0.05)]
    for one, picture in zip(cameras, Renderer(cameras, device).pictures(surface), strict=True):
        off = []
        for dot in dots:
            x, y = middle(one, dot, along)
            if min(x, y, 480 - x, 360 - y) < 20:
                continue
            j, i = np.mgrid[int(y) - 12 : int(y) + 14, int(x) - 12 : int(x) + 14]
            light = picture[j, i] - GREY
            off.append([np.sum(light * i) / light.sum() - x, np.sum(light * j) / light.sum() - y])
        assert len(off) > 40
        assert np.sqrt(np.mean(np.square(off))) < 3e-4 and np.abs(off).max() < 1.5e-3


def test_what_stands_before_the_surface_hides_it(dotted):
    surface, *_ = dotted
    near = np.array(
        [[-0.05, -0.05, -0.1], [0.0, -0.05, -0.1], [0.0, 0.05, -0.1], [-0.05, 0.05, -0.1]]
    )
    hidden = surface.beside(near, np.array([[0, 1, 2], [0, 2, 3]]), 99.0)
    one = camera(0.0)
    (picture,) = Renderer([one]).pictures(hidden)
    assert np.all(picture[:, :239] == 99.0) and picture[:, 242:].max() > 150.0
    (empty,) = Renderer([one]).pictures(surface.moved(surface.p_WV + np.array([1.0, 0.0, 0.0])))
    assert np.all(empty == GROUND)


def test_a_sensor_adds_noise_and_changes_light():
    grey = np.full((200, 200), 100.0)
    rng = np.random.default_rng(0)
    seen = Light(noise=2.0, gain=0.8, offset=10.0).seen(grey, rng)
    assert seen.dtype == np.uint8
    assert seen.mean() == pytest.approx(90.0, abs=0.1) and seen.std() == pytest.approx(
        2.0, rel=0.05
    )
    assert Light(noise=0.0, gain=9.0).seen(grey, rng).max() == 255
