"""``form-drake track``: pictures in files, in any order and with gaps, become a recording."""

import json
import shutil
import struct
import subprocess
import sys
import zlib
from dataclasses import replace

import numpy as np
import pytest
import yaml

from form_drake import read
from form_drake.commands.track import Track
from form_drake.motion.body import Face
from form_drake.perceive.optics import looking
from form_drake.perceive.pictures import Pictures
from form_drake.perceive.render import Light, Renderer, Surface
from form_drake.perceive.rig import Rig
from form_drake.perceive.seen import tracked
from form_drake.perceive.speckle import speckle
from form_drake.records import write_recording
from form_drake.records.recording import Recording, Stream
from form_drake.seen_report import rests, write_seen_report

LOW, HIGH = np.array([-0.010, -0.008, 0.0]), np.array([0.010, 0.008, 0.005])
FOCUS, FAR, SIZE, FRAMES, GAP = 3000.0, 0.3, (320, 240), 6, 3
SHIFT = np.array([2e-4, -1e-4, 1e-4])  # from one frame to the next


cv2 = pytest.importorskip("cv2")


def cameras(turned=0.0):
    return {
        name: looking(np.array([x, 0.0, 0.305]), np.array([turned, 0.0, 0.005]), FOCUS, SIZE)
        for name, x in (("left", 0.04), ("right", -0.04))
    }


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A folder with pictures of a block's upper face, which is shifted, and its rig; one is missing."""
    folder = tmp_path_factory.mktemp("seen")
    rig = Rig(cameras(), 50.0, LOW, HIGH, Face.named("z+"))
    rig.write(folder / "rig.yaml")
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HIGH[:2]
    plate = np.column_stack([corners, np.full(4, HIGH[2])])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    texels = 6.0 * FOCUS / FAR
    rows, columns = (int(2 * h * texels) + 1 for h in HIGH[1::-1])
    texture = speckle((rows, columns), 1.65 * 6, np.random.default_rng(0))
    surface = Surface.of(plate, triangles, ((corners + HIGH[:2]) * texels)[triangles], texture)
    renderer, rng = Renderer(list(rig.cameras.values())), np.random.default_rng(1)
    pictures = folder / "pictures"
    pictures.mkdir()
    for n in range(FRAMES):
        for name, picture in zip(
            rig.cameras, renderer.pictures(surface.moved(plate + n * SHIFT)), strict=True
        ):
            if (n, name) != (GAP, "right"):
                cv2.imwrite(str(pictures / f"{name}_{n:04d}.png"), Light().seen(picture, rng))
    return folder


def run(*words):
    command = [sys.executable, "-m", "form_drake", "track", *map(str, words)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)


def test_pictures_become_a_recording(seen, tmp_path):
    force = Stream(np.linspace(2.0, 3.0, 30), np.zeros((30, 3)))
    probe = Recording.from_arrays(
        np.array([2.0, 2.1]),
        np.zeros((2, 1, 3)),
        density=900.0,
        law="fixed-corotated",
        forces={"plate": force},
        contact={"z-": "bonded plate", "other": "free"},
    )
    write_recording(probe, tmp_path / "probe.h5")
    out = tmp_path / "tracks.h5"
    done = run(
        seen / "pictures",
        "--calibration",
        seen / "rig.yaml",
        "--probe",
        tmp_path / "probe.h5",
        "--out",
        out,
        "--report",
        tmp_path / "seen.html",
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "seen.html").read_text()
    assert (
        page.count("<img") == 4 and f"without: {GAP}" in page and f"{FRAMES - 1} at 50 Hz" in page
    )
    assert f"frame {GAP}: no picture of right, left out" in done.stderr
    made = read(out)
    assert made.frames == FRAMES - 1 and made.density == 900.0 and set(made.forces) == {"plate"}
    frames = np.array([n for n in range(FRAMES) if n != GAP])
    assert np.allclose(made.time, 2.0 + frames / 50.0)
    rig = Rig.read(seen / "rig.yaml")
    assert made.face is not None and np.all(made.face == 5)
    assert made.points == len(rig.points()) == 88
    assert made.valid is not None and made.valid.mean() > 0.95
    held = made.valid.all(axis=0)
    moved = made.p_WQ[:, held] - made.p_WQ[:1, held]
    off = moved - (frames[:, None] * SHIFT)[:, None]
    assert np.sqrt(np.mean(off[1:] ** 2)) < 4e-6
    assert np.sqrt(np.mean(off[1:] ** 2)) < 3.0 * made.noise < 1e-5


def test_pictures_of_other_times_are_told_and_place_no_point(seen, tmp_path, capsys):
    for n, right in enumerate((0, 1, 0)):  # the last is late
        for name, k in (("left", n), ("right", right)):
            shutil.copy(seen / "pictures" / f"{name}_000{k}.png", tmp_path / f"{name}_{n}.png")
    Track((tmp_path,), seen / "rig.yaml", tmp_path / "tracks.h5", json=True).run()
    told = capsys.readouterr()
    assert "frame 2: the cameras show other times" in told.err
    assert list(json.loads(told.out.splitlines()[-1])["apart_frames"]) == ["2"]
    valid = read(tmp_path / "tracks.h5").valid
    assert valid[1].all() and not valid[2].any()


def test_what_is_lost_is_told_of_all_points(seen, tmp_path, capsys):
    """Half of the face is hidden after the first picture; frames are counted from 1."""
    for n in range(2):
        for name in cameras():
            picture = cv2.imread(
                str(seen / "pictures" / f"{name}_000{n}.png"), cv2.IMREAD_GRAYSCALE
            )
            picture[:, : n * SIZE[0] // 2] = 90
            cv2.imwrite(str(tmp_path / f"{name}_{n + 1}.png"), picture)
    nothing, volume = np.zeros((2, 4, 3)), np.full(4, 1e-9)  # of its own points, which are others
    probe = Recording.from_arrays(
        np.array([2.0, 2.1]), nothing, volume=volume, body_force=nothing, v_0=nothing[0]
    )
    write_recording(probe, tmp_path / "probe.h5")
    out = tmp_path / "tracks.h5"
    Track((tmp_path,), seen / "rig.yaml", out, tmp_path / "probe.h5", json=True).run()
    told = capsys.readouterr()
    assert "the first picture is frame 1: 0.02 s after" in told.err
    result, made = json.loads(told.out.splitlines()[-1]), read(out)
    assert result["asked"] == result["found_first"] == 88 and 30 < result["points"] < 58
    assert result["points"] == made.points and result["held"] == made.points / 88
    assert np.allclose(made.time, [2.02, 2.04]) and made.volume is None and made.v_0 is None


def test_a_report_stands_frames_in_which_nothing_is_seen(seen, tmp_path):
    rig = Rig.read(seen / "rig.yaml")
    pictures, sights = Pictures.found([seen / "pictures"], rig.cameras), []
    tracked(rig, pictures, progress=lambda _, sight: sights.append(sight))
    left = rests(rig, sights[1], sights[0])[sights[1].held]
    assert np.isfinite(left).all() and 0.0 < np.sqrt(np.mean(left**2)) < 1e-5
    dark = sights[1]
    none = np.full_like(dark.p_WQ, np.nan)
    sights[1] = replace(dark, p_WQ=none, pixel=np.full_like(dark.pixel, np.nan))
    write_seen_report(tmp_path / "seen.html", rig, pictures, sights)
    assert (tmp_path / "seen.html").read_text().count("<img") == 4


def test_a_rig_comes_back_as_it_was_written(seen):
    rig = Rig.read(seen / "rig.yaml")
    for name, camera in cameras().items():
        assert np.array_equal(rig.cameras[name].K, camera.K)
        assert np.allclose(rig.cameras[name].X_WC, camera.X_WC, atol=1e-15)
    assert rig.face.name == "z+" and rig.rate == 50.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("form_drake_rig: 1", "no entry cameras"),
        ("left: 1", "unknown entry left"),
        ("rate: 0", "frames a second"),
        ("rate: .nan", "finite number"),
        ("face: front", "no face .front.; allowed are x-"),
        ("high: [0, 0]", "3 finite numbers"),
        ("cameras: [1, 2]", "a mapping of names"),
        ("half: 1", "3 to 100 pixels"),
        ("half: 8.5", "half: a whole number"),
    ],
)
def test_bad_rigs_are_one_line(seen, tmp_path, text, words):
    path, lines = tmp_path / "rig.yaml", (seen / "rig.yaml").read_text()
    key = text.split(":")[0]
    if key == "form_drake_rig":
        path.write_text(text)
    else:
        path.write_text(yaml.safe_dump({**yaml.safe_load(lines), **yaml.safe_load(text)}))
    with pytest.raises(ValueError, match=words) as told:
        Rig.read(path)
    assert "\n" not in str(told.value)


def test_cameras_that_are_none_are_refused(seen):
    rig = Rig.read(seen / "rig.yaml")
    left = rig.cameras["left"]
    bent = replace(left, X_WC=left.X_WC * [[1.1], [1], [1], [1]])
    rig_of = replace(rig, cameras={**rig.cameras, "left": bent})
    path = seen / "bent.yaml"
    rig_of.write(path)
    with pytest.raises(ValueError, match="camera left: X_WC is no pose"):
        Rig.read(path)
    with pytest.raises(ValueError, match="left and right see the face from one direction"):
        replace(rig, cameras={**rig.cameras, "right": left})
    with pytest.raises(ValueError, match="two are wanted"):
        replace(rig, cameras={"left": left})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("swapped", "swapped"),
        ("plain", "has no texture"),
        ("bright", "change the exposure"),
        ("size", "calibrated are 320 x 240"),
        ("text", "not a picture"),
        ("huge", "not a picture"),
        ("cut", "not a picture"),
        ("name", "CAMERA_NUMBER"),
        ("stops", "seen by all cameras"),
    ],
)
def test_bad_pictures_are_one_line(seen, tmp_path, change, words):
    rig = Rig.read(seen / "rig.yaml")
    for path in sorted((seen / "pictures").iterdir()):
        picture, name = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), path.name
        if change == "swapped":
            name = name.replace("left", "l").replace("right", "left").replace("l_", "right_")
        picture = {
            "plain": np.full_like(picture, 90),
            "bright": np.full_like(picture, 255),
            "size": picture[::2],
        }.get(change, picture)
        if change == "name":
            name = name.replace("left", "middle")
        if change == "stops" and name.startswith("right") and not name.endswith("0000.png"):
            continue
        cv2.imwrite(str(tmp_path / name), picture)
    if change == "text":
        (tmp_path / "left_0000.png").write_text("no picture")
    if change == "huge":  # of a size that no header may state, its checksum right
        path = tmp_path / "left_0000.png"
        whole = path.read_bytes()
        head = b"IHDR" + struct.pack(">II", 200_000, 200_000) + whole[24:29]
        path.write_bytes(whole[:12] + head + struct.pack(">I", zlib.crc32(head)) + whole[33:])
    if change == "cut":
        path = tmp_path / "left_0000.jpg"
        cv2.imwrite(str(path), cv2.imread(str(tmp_path / "left_0000.png"), cv2.IMREAD_GRAYSCALE))
        path.write_bytes(path.read_bytes()[:-2000])
        (tmp_path / "left_0000.png").unlink()
    rig.write(tmp_path / "rig.yaml")
    out = tmp_path / "tracks.h5"
    with pytest.raises(ValueError, match=words) as told:
        Track((tmp_path,), tmp_path / "rig.yaml", out).run()
    assert "\n" not in str(told.value)
    assert not out.exists()


def test_frames_are_brought_together_in_any_order(seen):
    names = cameras()
    files = sorted((seen / "pictures").iterdir(), reverse=True)
    found = Pictures.found(files, names)
    assert found.frames == tuple(n for n in range(FRAMES) if n != GAP)
    assert found.missing == {GAP: ("right",)}
    with pytest.raises(ValueError, match="both frame"):
        Pictures.found([*files, files[0]], names)


def test_a_picture_that_shows_nothing_is_left_out(seen, tmp_path):
    for path in (seen / "pictures").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    flash, torn = tmp_path / "left_0001.png", tmp_path / "right_0004.png"
    cv2.imwrite(str(flash), np.full(SIZE[::-1], 255, np.uint8))
    torn.write_bytes(torn.read_bytes()[:-2000])
    found = Pictures.found([tmp_path], cameras())
    assert found.frames == (0, 2, 5) and len(list(found.read())) == 3
    assert list(found.left_out) == [1, GAP, 4] and found.left_out[GAP] == "no picture of right"
    assert "change the exposure" in found.unusable[1] and "not a picture" in found.unusable[4]


def test_a_specimen_before_a_black_ground_is_no_wrong_exposure(seen, tmp_path):
    for path in (seen / "pictures").iterdir():
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        picture[:, :200] = 0
        cv2.imwrite(str(tmp_path / path.name), picture)
    assert len(Pictures.found([tmp_path], cameras()).frames) == FRAMES - 1


@pytest.mark.parametrize("bits", [12, 16])
def test_sixteen_bits_are_as_much_finer_than_eight(seen, tmp_path, bits):
    finer, top = 0.3, 2.0**bits - 1.0
    for path in (seen / "pictures").iterdir():
        grey = np.minimum(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) + finer, 255.0)
        grey[0, 0] = 255.0  # by which a picture tells how many bits there are
        cv2.imwrite(str(tmp_path / path.name), np.round(grey * top / 255.0).astype(np.uint16))
    coarse, fine = (Pictures.found([p], cameras()) for p in (seen / "pictures", tmp_path))
    for a, b in zip(coarse.pair(1), fine.pair(1), strict=True):
        assert np.abs(b - np.minimum(a + finer, 255.0))[1:].max() < 128.0 / top


def test_pictures_are_read_as_the_sensor_lies(seen, tmp_path):
    image = pytest.importorskip("PIL.Image")
    upside_down = image.Exif()
    upside_down[0x0112] = 3
    for path in (seen / "pictures").iterdir():
        picture = image.open(path)
        picture.save(tmp_path / f"{path.stem}.jpg", quality=98, exif=upside_down)
    plain, told = (Pictures.found([p], cameras()).pair(0)[0] for p in (seen / "pictures", tmp_path))
    assert np.abs(plain.astype(float) - told).mean() < 2.0


def test_other_depths_and_stamps_are_refused_in_a_line(tmp_path):
    for n in range(3):
        for name in ("left", "right"):
            cv2.imwrite(str(tmp_path / f"{name}_{n}.tif"), np.ones(SIZE[::-1], np.float32))
    with pytest.raises(ValueError, match="grey values of float32; 8 and 16 bits are read"):
        Pictures.found([tmp_path], cameras())
    for path in list(tmp_path.iterdir()):
        name, n = path.stem.split("_")
        path.rename(tmp_path / f"{name}_{10**18 + int(n) * 33333333}.tif")
    with pytest.raises(ValueError, match=r"counts frames .* no stamp"):
        Pictures.found([tmp_path], cameras())
