"""Pictures of a specimen whose motion is known, tracked by a process that sees nothing else."""

import os
import signal
import time
from dataclasses import replace
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from form_drake import Recording, Stream, identify, read
from form_drake.commands import simulate
from form_drake.commands.output import run_in
from form_drake.perceive.optics import projected
from form_drake.perceive.pictures import Pictures
from form_drake.perceive.rig import RIM
from form_drake.perceive.seen import completed, tracked
from form_drake.records import write_recording
from form_drake.systems import probe
from form_drake.systems.pictures import (
    beside_pictures,
    frames_a_second,
    rig_of,
    seen_by_cameras,
    write_pictures,
)
from form_drake.systems.probe import prepare, record
from form_drake.systems.scenario import load_scenario
from form_drake.systems.station import specimen_corners

STRETCH = np.array([1.03, 1.03, 0.93])
FRAMES = 4
SMALL = ("stereo.size=[320, 240]", "stereo.focus=2000", "specimen.material.tau_y=1e3")


@pytest.fixture(scope="module")
def scenario():
    return seen_by_cameras(load_scenario("press", SMALL))


def particles(scenario):
    """Particles of a block that is stretched about its middle, as a simulation would record them."""
    low, high = specimen_corners(scenario)
    axes = [np.arange(a + 6e-4, z, 1.2e-3) for a, z in zip(low, high, strict=True)]
    rest = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    middle = 0.5 * (low + high)
    share = np.linspace(0.0, 1.0, FRAMES)[:, None, None]
    pose = np.tile(np.eye(4), (50, 1, 1))
    clock = np.linspace(1.0, 1.1, 50)
    return Recording.from_arrays(
        1.0 + np.arange(FRAMES) / 30.0,
        rest + share * (rest - middle) * (STRETCH - 1.0),
        p_reference=rest,
        density=1000.0,
        law="von-mises",
        geometry={"shape": "box", "low": "0 0 0", "high": "1 1 1"},
        poses={"press_plate": Stream(clock, pose)},
        forces={"press_plate": Stream(clock, np.zeros((50, 3)))},
        contact={"z+": "frictionless press_plate", "other": "free"},
    )


def test_parts_keep_clear_of_edges_in_both_pictures(scenario):
    rig = rig_of(scenario, 30.0)
    X = rig.points()
    aside = [a for a in range(3) if a != rig.face.axis]
    for camera in rig.cameras.values():
        for axis in aside:
            for end in (rig.low, rig.high):
                edge = X.copy()
                edge[:, axis] = end[axis]
                room = np.linalg.norm(projected(camera, edge) - projected(camera, X), axis=1)
                assert room.min() > rig.half + RIM - 0.1


def test_pictures_alone_give_the_motion(scenario, tmp_path):
    made = particles(scenario)
    rig = rig_of(scenario, 30.0)
    (tmp_path / "pictures").mkdir()
    rig.write(tmp_path / "rig.yaml")
    beside = beside_pictures(made, scenario.stereo.symmetry)
    assert beside.points == 1 and beside.p_reference is None
    write_recording(beside, tmp_path / "probe.h5")
    write_pictures(tmp_path / "pictures", scenario, rig, made)
    words = ("pictures", "--calibration", "rig.yaml", "--probe", "probe.h5", "--out", "tracks.h5")
    run_in(tmp_path, "track", *words)
    found = read(tmp_path / "tracks.h5")
    assert found.points == len(rig.points())
    assert found.on_surface and found.valid is not None and found.valid.mean() > 0.98
    assert found.geometry["symmetry"] == "x y xy" and found.covariance is not None
    assert np.allclose(found.time, made.time)
    low, high = specimen_corners(scenario)
    middle, first = 0.5 * (low + high), found.p_WQ[0]
    wanted = first + (first - middle) * (STRETCH - 1.0)
    off = (found.p_WQ[-1] - wanted)[found.valid[-1]]
    assert np.abs(first[:, 0] - high[0]).max() < 5e-5
    across, depth = np.sqrt(np.mean(off[:, 1:] ** 2)), np.sqrt(np.mean(off[:, 0] ** 2))
    assert across < 2e-6 and depth < 1e-5  # twice as far a pixel as with the scenario's own cameras
    # on average, what the covariance says
    spread = np.sqrt(np.mean(np.diagonal(found.covariance, axis1=1, axis2=2), axis=0))
    assert spread[0] > 2.0 * spread[1] and 0.3 * depth < spread[0] < 3.0 * depth
    with pytest.raises(ValueError, match="4 frames"):
        identify(found)


def test_a_probe_seen_in_the_diagram_is_that_seen_afterwards(tmp_path):
    way = "[{time: 0.0, p_WT: [0.5, 0.0, 0.0752]}, {time: 0.4, p_WT: [0.5, 0.0, 0.0745]}]"
    small = ("stereo.size=[320, 240]", "stereo.focus=2000", "stereo.rate=20", "solver.dx=3e-3")
    scenario = load_scenario("press_a", (*small, f"probe.waypoints={way}"))
    meshcat = Meshcat()
    within = record(prepare(scenario, meshcat, seen=True))
    assert all(meshcat.HasPath(f"/sight/{n}") for n in range(4)) and not meshcat.HasPath("/sight/4")
    scenario = seen_by_cameras(scenario)
    made = record(prepare(scenario))
    rig = rig_of(scenario, frames_a_second(made))
    write_pictures(tmp_path, scenario, rig, made)
    pictures = Pictures.found([tmp_path], rig.cameras)
    found = completed(tracked(rig, pictures, float(made.time[0])), beside_pictures(made, "x y xy"))
    assert within.frames == found.frames == 4 and within.p_reference is None
    assert np.array_equal(within.p_WQ, found.p_WQ) and within.geometry == found.geometry
    assert np.array_equal(within.covariance, found.covariance) and within.noise == found.noise
    force, other = within.forces["press_plate"], found.forces["press_plate"]
    assert np.array_equal(force.value, other.value) and np.abs(force.value).max() > 0.1


def test_a_scenario_that_no_camera_sees_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"stereo\.face"):
        simulate.Simulate(
            "press_a", ("stereo.face=top",), perception="stereo", out=tmp_path / "o"
        ).run()
    assert not (tmp_path / "o").exists()


def test_a_process_that_fails_says_why_in_a_line(tmp_path):
    with pytest.raises(ValueError, match=r"rig\.yaml: no such file") as told:
        run_in(tmp_path, "track", "pictures", "--calibration", "rig.yaml", "--out", "tracks.h5")
    assert "\n" not in str(told.value)


def test_a_process_that_is_interrupted_hears_it_once_and_tidies_up(tmp_path, monkeypatch):
    child = tmp_path / "child"
    child.write_text(
        "#!/bin/sh\ntrap 'echo heard >> told; exit 130' INT\ntouch begun\nwhile :; do sleep .05; done\n"
    )
    child.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(child))

    def interrupt():
        while not (tmp_path / "begun").exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        run_in(tmp_path, "track")
    assert (tmp_path / "told").read_text() == "heard\n"


@pytest.mark.parametrize("problem", [ValueError("track: lost"), KeyboardInterrupt()], ids=type)
def test_what_was_simulated_is_kept_where_tracking_fails(
    problem, scenario, tmp_path, monkeypatch, capsys
):
    def fails(folder, *words):
        raise problem

    made = particles(scenario)
    monkeypatch.setattr(probe, "prepare", lambda *_, **__: SimpleNamespace(duration=0.1))
    monkeypatch.setattr(probe, "record", lambda *_: made)
    monkeypatch.setattr(simulate, "run_in", fails)
    out = tmp_path / "o"
    with pytest.raises(type(problem)) as raised:
        simulate.Simulate("press", SMALL, perception="stereo", out=out, page=False).run()
    told = str(raised.value) or capsys.readouterr().err.strip()
    assert "rig and probe are kept in" in told and "\n" not in told
    assert read(out / "seen" / "probe.h5").points == 1
    assert len(list((out / "seen" / "pictures").iterdir())) == 2 * FRAMES
    assert (out / "truth.json").is_file() and not (out / "recording.h5").exists()


def test_what_is_tracked_later_is_of_the_run(scenario, tmp_path, monkeypatch):
    """So that the next run takes its place."""
    made, out = particles(scenario), tmp_path / "o"

    def tracks(folder, *words):
        write_recording(made, out / "recording.h5")
        (out / "seen.html").touch()

    monkeypatch.setattr(probe, "prepare", lambda *_, **__: SimpleNamespace(duration=0.1))
    monkeypatch.setattr(probe, "record", lambda *_: made)
    monkeypatch.setattr(simulate, "run_in", tracks)
    run = simulate.Simulate("press", SMALL, perception="stereo", out=out, page=False)
    run.run()
    run.run()
    (out / "notes.txt").touch()
    with pytest.raises(ValueError, match=r"no earlier run has made \(notes[.]txt\)"):
        run.run()


def test_the_right_camera_may_be_turned_from_its_calibration(scenario, tmp_path):
    turned = replace(scenario, stereo=replace(scenario.stereo, turned_deg=[0.0, 0.5, 0.0]))
    made = replace(particles(scenario))
    rig = rig_of(turned, 30.0)
    plain, other = tmp_path / "a", tmp_path / "b"
    for folder, own in ((plain, scenario), (other, turned)):
        folder.mkdir()
        write_pictures(folder, own, rig, replace(made, time=made.time[:1], p_WQ=made.p_WQ[:1]))
    same, moved = (
        (plain / n).read_bytes() == (other / n).read_bytes()
        for n in ("left_00000.png", "right_00000.png")
    )
    assert same and not moved
