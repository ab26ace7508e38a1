"""What a soft body looks like: its skin, a page that plays a simulation, pictures of a station."""

import re

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread
from pydrake.geometry import Meshcat

from form_drake.motion.body import Face
from form_drake.mpm.bodies import block
from form_drake.skin import Patch, Skin, field_named, outermost_first, von_mises
from form_drake.systems.page import FEWEST, FRAME, LIMIT, POINT, budget, write_page
from form_drake.systems.probe import begin, prepare
from form_drake.systems.scenario import load_scenario
from form_drake.systems.snapshots import Camera, Studio, close_up, overview, write_snapshot
from form_drake.systems.viewer import View, arrow, cloud, strongest

SIZE = np.array([0.03, 0.02, 0.025])
BODY = block((0.5, 0.0, 0.06), SIZE, 0.0025, 1.0)
SPEED_UP = [  # a coarse press that begins at once
    "solver.dx=0.005",
    "solver.settle=0.02",
    "probe.waypoints=[{time: 0.0, p_WT: [0.5, 0.0, 0.0755]}, {time: 0.3, p_WT: [0.5, 0.0, 0.071]}]",
]


@pytest.fixture(scope="module")
def pressed():
    """A station after a short press, its viewer and its Context."""
    run = prepare(load_scenario("press_b", SPEED_UP), Meshcat())
    simulator = begin(run)
    simulator.AdvanceTo(0.3)
    viewer = run.station.diagram.GetSubsystemByName("particle_viewer")
    return run.station, viewer, simulator


def test_a_skin_is_closed_and_moves_with_the_particles():
    skin = Skin.of(BODY.x)
    F = np.array([[1.0, 0.3, 0.0], [0.0, 0.8, -0.1], [0.1, 0.0, 1.2]])
    for map_ in (np.eye(3), F):
        points = skin.points(BODY.x @ map_.T)
        surface = trimesh.Trimesh(points, skin.faces)
        surface.merge_vertices()
        assert surface.is_watertight
        assert surface.volume == pytest.approx(np.prod(SIZE) * np.linalg.det(map_), rel=1e-5)
    points = skin.points(BODY.x)
    assert np.ptp(points, axis=0) == pytest.approx(SIZE, rel=1e-5)
    side = np.argmax(np.abs(skin.normals(points)), axis=1)
    centre, rows = np.array([0.5, 0.0, 0.06]), np.arange(len(points))
    assert np.abs((points - centre)[rows, side]) == pytest.approx(SIZE[side] / 2, rel=1e-5)
    with pytest.raises(ValueError, match="lattice"):
        Skin.of(np.random.default_rng(0).uniform(size=(50, 3)))


def test_particles_at_the_surface_come_first():
    order, outer = outermost_first(BODY.x)
    assert sorted(order) == list(range(len(BODY.x)))
    inside = np.all(np.abs(BODY.x - [0.5, 0.0, 0.06]) < SIZE / 2 - 0.0025, axis=1)
    assert outer == np.sum(~inside)
    assert not inside[order[:outer]].any()


def test_fields():
    tau = np.diag([-3e3, 0.0, 0.0])[None]
    assert von_mises(tau) == pytest.approx([3e3])
    with pytest.raises(ValueError, match="displacement, speed, stress, pressure"):
        field_named("colour")


@pytest.mark.parametrize("frames, points", [(84, 2808), (84, 11520), (600, 3000), (10_000, 90_000)])
def test_budget_fits_and_gives_up_no_more_than_it_must(frames, points):
    room = 10e6
    kept, shown = budget(frames, points, room)
    used = kept * (FRAME + POINT * shown)
    assert used <= room
    assert kept == frames or shown <= FEWEST or used > 0.9 * room
    assert (kept, shown) == (frames, points) or used > 0.9 * room
    assert budget(3, 100, room) == (3, 100)
    with pytest.raises(ValueError, match="no room"):
        budget(frames, points, 100.0)


def shown_frames(page: str) -> int:
    return int(re.search(r"(\d+) frames", page).group(1))


def test_a_page_holds_every_frame_and_says_what_it_shows(pressed, tmp_path):
    _, viewer, _ = pressed
    path = tmp_path / "page.html"
    frames, points = write_page(viewer, path, "press <b>")
    page = path.read_text()
    assert path.stat().st_size <= LIMIT
    assert (frames, points) == (10, 640)  # 0.3 s at 30 per second, particles at the surface
    assert shown_frames(page) == frames
    place = f"/material/frames/{viewer.pages}"
    assert [viewer.meshcat.HasPath(f"{place}/{k}") for k in (0, 9, 10)] == [True, True, False]
    assert "press &lt;b&gt;" in page and "640 of 1440 particles (at the surface)" in page
    assert "displacement [mm]" in page and "force on press_plate, at most" in page
    assert strongest(list(viewer.frames.values())) > 1.0


def test_a_small_page_shows_less_and_is_whole_or_not_there(pressed, tmp_path):
    _, viewer, _ = pressed
    path = tmp_path / "page.html"
    write_page(viewer, path)
    whole = path.stat().st_size
    limit = whole - 150_000
    frames, points = write_page(viewer, path, limit=limit)
    assert path.stat().st_size <= limit and frames * points < 6_400
    assert shown_frames(path.read_text()) == frames
    path.unlink()
    with pytest.raises(ValueError, match="no room"):
        write_page(viewer, path, limit=100_000)
    assert list(tmp_path.iterdir()) == []


def test_colours_follow_the_field_and_arrows_the_force(pressed):
    _, viewer, _ = pressed
    first, last = viewer.frames[0], viewer.frames[9]
    ends = viewer.limits(np.concatenate([first.value, last.value]))
    assert ends[0] == 0.0 and 3.0 < ends[1] < 6.0  # mm; the plate goes 4 mm into the block
    before, after = (cloud(f.p_WQ, f.value, ends).rgbs() for f in (first, last))
    assert (
        before.std(axis=1).max() < 1.0 and after[1].max() > before[1].max() + 100
    )  # viridis: to green
    X_WA, scale = arrow(last, 0, strongest([last]))
    assert X_WA.rotation().matrix()[:, 2] == pytest.approx([0.0, 0.0, 1.0], abs=0.1)
    assert scale == pytest.approx([1.0, 1.0, 1.0])
    assert View(range=(0.0, 2.0)).range == (0.0, 2.0)


def test_a_picture_shows_the_specimen_where_it_is(pressed, tmp_path):
    station, _, simulator = pressed
    context, studio = simulator.get_context(), Studio(station)
    camera = close_up(station, width=480, height=360)
    with_, without = (studio.picture(context, camera, specimen=s) for s in (True, False))
    changed = np.any(np.abs(with_.astype(int) - without) > 20, axis=2)
    v, u = np.nonzero(changed)
    own = station.diagram.GetMyContextFromRoot(context)
    p_WQ = station.diagram.GetOutputPort("material.particles").Eval(own).p_WQ
    low, high = pixels(camera, p_WQ)
    body = (u > low[0] - 8) & (u < high[0] + 8) & (v > low[1] - 8) & (v < high[1] + 8)
    assert body.mean() > 0.9  # the rest is shadow
    assert np.sum(body) > 0.4 * np.prod(high - low)  # the plate hides its upper part
    coloured = studio.picture(context, camera, field="stress")
    assert np.abs(coloured.astype(int) - with_)[changed].mean() > 20
    whole = studio.picture(context, overview(station, width=320, height=240))
    assert whole.std() > 20
    write_snapshot(tmp_path / "close.png", with_)
    assert np.array_equal(np.round(255 * imread(tmp_path / "close.png")[:, :, :3]), with_)


def pixels(camera: Camera, p_W: np.ndarray) -> np.ndarray:
    """Lower and upper corner of the points' picture [pixels], shape [2, 2]."""
    p_C = camera.X_WC.inverse().multiply(p_W.T).T
    K = camera.info().intrinsic_matrix()
    uv = (p_C @ K.T)[:, :2] / p_C[:, 2:]
    return np.stack([uv.min(axis=0), uv.max(axis=0)])


@pytest.mark.browser
def test_a_browser_plays_the_page(pressed, tmp_path, played):
    _, viewer, _ = pressed
    write_page(viewer, tmp_path / "page.html", "press")
    tree = f"['material', 'frames', '{viewer.pages}']"
    found, picture = played(tmp_path / "page.html", 0.21, 10, tree)
    assert found["errors"] == []
    assert found["seen"] == [6]  # the one of 0.2 s
    assert found["now"].startswith("t = 0.20 s, force ")
    assert picture[150:].std() > 0.05  # something stands before the background


@pytest.mark.parametrize("face", ["x-", "x+", "y-", "y+", "z-", "z+"])
def test_a_patch_moves_with_its_particles_and_looks_outwards(face):
    low, high = np.zeros(3), np.array([0.010, 0.008, 0.006])
    axes = [np.arange(0.0005, h, 0.001) for h in high]
    rest = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    patch = Patch.of(rest, low, high, Face.named(face), 3e-4)
    axis, side = "xyz".index(face[0]), face[1] == "+"
    assert np.all(patch.X[:, axis] == (low, high)[side][axis])
    a, b, c = (patch.X[patch.triangles[:, k]] for k in range(3))
    outward = np.cross(b - a, c - a)[:, axis] * (1.0 if side else -1.0)
    assert outward.min() > 0.0 and 0.5 * outward.sum() == pytest.approx(
        np.prod(np.delete(high, axis))
    )
    rng = np.random.default_rng(0)
    F, t = np.eye(3) + 0.2 * rng.standard_normal((3, 3)), rng.standard_normal(3)
    # the ridge of moving least squares is what is left
    assert np.abs(patch.points(rest @ F.T + t, rest) - patch.X @ F.T - t).max() < 1e-8
    # a barrel does not flatten: motions of second order are carried too
    barrel = rest + 20.0 * (rest - rest.mean(axis=0)) ** 2
    there = patch.X + 20.0 * (patch.X - rest.mean(axis=0)) ** 2
    assert np.abs(patch.points(barrel, rest) - there).max() < 1e-8
    # a bend leaves no steps from one quad to the next
    bent = rest + np.eye(3)[axis] * np.sin(200.0 * rest[:, [axis]])
    off = patch.points(bent, rest)[:, axis]
    assert np.abs(off[patch.triangles[:, 0]] - off[patch.triangles[:, 1]]).max() < 1e-5
