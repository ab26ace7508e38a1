"""Cameras, tracker and reconstructor as parts of a diagram."""

import io
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("cv2")

from pydrake.common import MemoryFile
from pydrake.common.value import Value
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    GeometryInstance,
    InMemoryMesh,
    MakeRenderEngineVtk,
    Mesh,
    Meshcat,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from form_drake.motion import Sampling, body, fit_tracks
from form_drake.perceive.pictures import Pictures
from form_drake.perceive.seen import tracked
from form_drake.perceive.speckle import speckle
from form_drake.records import Recording
from form_drake.systems import identifier as identifier_module
from form_drake.systems import tracker as tracker_module
from form_drake.systems.cameras import PictureFiles, SpeckleCameras
from form_drake.systems.identifier import Identifier
from form_drake.systems.pictures import Photographer, rig_of, write_pictures
from form_drake.systems.reconstructor import Reconstructor
from form_drake.systems.scenario import load_scenario
from form_drake.systems.station import specimen_corners
from form_drake.systems.tracker import SightViewer, Tracker

RATE, FRAMES, PERIOD = 20.0, 4, 0.001
STRETCH = np.array([1.03, 1.03, 0.93])


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("press", ("stereo.size=[320, 240]", "stereo.focus=2000"))


@pytest.fixture(scope="module")
def rig(scenario):
    return rig_of(scenario, RATE)


def stretched(scenario, share):
    low, high = specimen_corners(scenario)
    axes = [np.arange(a + 6e-4, z, 1.2e-3) for a, z in zip(low, high, strict=True)]
    rest = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return rest, rest + share * (rest - 0.5 * (low + high)) * (STRETCH - 1.0)


class Stretching(LeafSystem):
    """Particles as a simulation would give them."""

    def __init__(self, scenario):
        super().__init__()
        self._scenario = scenario
        self.DeclareAbstractOutputPort("particles", lambda: Value[object](None), self._calc)

    def _calc(self, context, output):
        share = context.get_time() * RATE / (FRAMES - 1)
        output.set_value(SimpleNamespace(p_WQ=stretched(self._scenario, share)[1]))


def connected(cameras, tracker, rig, *before):
    builder = DiagramBuilder()
    for system in (*before, cameras, tracker):
        builder.AddSystem(system)
    for system in before:
        builder.Connect(system.get_output_port(), cameras.get_input_port())
    for name in rig.cameras:
        for port in (f"{name}.color_image", f"{name}.image_time"):
            builder.Connect(cameras.GetOutputPort(port), tracker.GetInputPort(port))
    return builder.Build()


def diagram(scenario, rig, **options):
    rest = stretched(scenario, 0.0)[0]
    photographer = Photographer(scenario, rig, rest, FRAMES)
    cameras = SpeckleCameras(rig, photographer, 0.0)
    tracker = Tracker(rig, period=PERIOD, **options)
    return connected(cameras, tracker, rig, Stretching(scenario)), tracker


def sights(diagram, tracker, frames=FRAMES):
    """Results at every frame, and the Simulator."""
    simulator = Simulator(diagram)
    simulator.Initialize()
    found = []
    for n in range(frames):
        simulator.AdvanceTo(n / RATE)
        own = tracker.GetMyContextFromRoot(simulator.get_context())
        found.append(tracker.get_output_port().Eval(own))
    return found, simulator


@pytest.fixture(scope="module")
def files(scenario, rig, tmp_path_factory):
    """Pictures of the same motion, and what is tracked in them."""
    folder = tmp_path_factory.mktemp("pictures")
    moved = np.stack([stretched(scenario, n / (FRAMES - 1))[1] for n in range(FRAMES)])
    particles = Recording.from_arrays(
        np.arange(FRAMES) / RATE, moved, p_reference=stretched(scenario, 0.0)[0]
    )
    write_pictures(folder, scenario, rig, particles)
    return folder, tracked(rig, Pictures.found([folder], rig.cameras))


def same(results, recording):
    p_WQ = np.array([result.value.p_WQ for result in results])
    held = np.isfinite(p_WQ).all(axis=2)[1:].any(axis=0)
    return np.array_equal(np.nan_to_num(p_WQ[:, held]), recording.p_WQ)


def test_points_in_the_diagram_are_those_of_the_files(scenario, rig, files):
    folder, recording = files
    found, _ = sights(*diagram(scenario, rig))
    assert [result.time for result in found] == pytest.approx(np.arange(FRAMES) / RATE)
    assert all(result.age == 0.0 and not result.skipped for result in found)
    assert same(found, recording)
    cameras, tracker = PictureFiles(rig, [folder]), Tracker(rig, period=PERIOD)
    assert cameras.end == (FRAMES - 1) / RATE
    found, _ = sights(connected(cameras, tracker, rig), tracker, FRAMES + 2)
    assert same(found[:FRAMES], recording)
    assert found[-1].age == pytest.approx(2.0 / RATE)  # the files have ended


def test_a_context_may_be_cloned_and_goes_on_alike(scenario, rig):
    made, tracker = diagram(scenario, rig)
    _, simulator = sights(made, tracker, 2)
    clone = simulator.get_context().Clone()
    ends = []
    for context in (simulator.get_mutable_context(), clone):
        other = Simulator(made, context)
        other.AdvanceTo((FRAMES - 1) / RATE)
        own = tracker.GetMyContextFromRoot(other.get_context())
        ends.append(tracker.get_output_port().Eval(own).value.p_WQ)
    assert np.array_equal(*ends, equal_nan=True)


def test_who_does_not_wait_gets_what_is_done_and_is_told_of_what_was_left_out(
    rig, files, monkeypatch
):
    real, begun, gate = tracker_module.followed, threading.Event(), threading.Event()

    def slow(*given):
        begun.set()
        assert gate.wait(60.0)
        return real(*given)

    monkeypatch.setattr(tracker_module, "followed", slow)
    tracker = Tracker(rig, period=PERIOD, wait=False)
    simulator = Simulator(connected(PictureFiles(rig, [files[0]]), tracker, rig))

    def at(frame):
        simulator.AdvanceTo(frame / RATE)
        simulator.AdvancePendingEvents()
        own = tracker.GetMyContextFromRoot(simulator.get_context())
        return tracker.get_output_port().Eval(own)

    assert at(0).value is None and begun.wait(60.0)
    found = [at(n) for n in range(1, FRAMES)]
    assert all(result.value is None and np.isnan(result.time) for result in found)
    # while the first is worked on, each takes the place of the one before
    assert found[-1].skipped == pytest.approx([1 / RATE, 2 / RATE])
    gate.set()
    done, frame = {}, FRAMES
    while (FRAMES - 1) / RATE not in done:  # the files have ended: nothing more is handed over
        result = at(frame)
        done[result.time] = result
        frame += 1
        time.sleep(0.02)
        assert frame < 3000
    last = done[(FRAMES - 1) / RATE]
    assert last.skipped == found[-1].skipped and last.age == pytest.approx((frame - FRAMES) / RATE)
    off = last.value.p_WQ - files[1].p_WQ[-1]
    assert (
        np.sqrt(np.mean(off[last.value.held] ** 2)) < 1e-7
    )  # from where it began, it goes no other way


class Late(LeafSystem):
    """Passes pictures on; the right camera stops after a while."""

    def __init__(self, rig, source, stops):
        super().__init__()
        for name in rig.cameras:
            port = source.GetOutputPort(f"{name}.color_image")
            own = self.DeclareAbstractInputPort(f"{name}.in", port.Allocate())
            self.DeclareVectorInputPort(f"{name}.time_in", 1)
            self.DeclareAbstractOutputPort(
                f"{name}.color_image",
                port.Allocate,
                lambda context, out, own=own: out.set_value(own.Eval(context)),
            )

            def stamp(context, out, name=name):
                now = self.GetInputPort(f"{name}.time_in").Eval(context)[0]
                out.SetAtIndex(0, min(now, stops) if name == "right" else now)

            self.DeclareVectorOutputPort(f"{name}.image_time", 1, stamp)


def test_a_camera_that_stops_leaves_a_gap(scenario, rig, files):
    cameras, tracker = PictureFiles(rig, [files[0]]), Tracker(rig, period=PERIOD)
    builder, late = DiagramBuilder(), Late(rig, cameras, 1.0 / RATE)
    for system in (cameras, late, tracker):
        builder.AddSystem(system)
    for name in rig.cameras:
        for port, into in (("color_image", "in"), ("image_time", "time_in")):
            builder.Connect(
                cameras.GetOutputPort(f"{name}.{port}"), late.GetInputPort(f"{name}.{into}")
            )
            builder.Connect(
                late.GetOutputPort(f"{name}.{port}"), tracker.GetInputPort(f"{name}.{port}")
            )
    found, _ = sights(builder.Build(), tracker)
    assert [result.time for result in found] == pytest.approx([0.0, 1 / RATE, 1 / RATE, 1 / RATE])
    assert found[-1].skipped == pytest.approx([2 / RATE, 3 / RATE])


def plate(rig):
    """The face of a rig with speckle on it, as Drake draws it."""
    from matplotlib.image import imsave

    low, high = np.array(rig.low), np.array(rig.high)
    axis = rig.face.axis
    b, c = (a for a in range(3) if a != axis)
    corners = np.tile(rig.face.middle(low, high), (4, 1))
    corners[:, b] = np.array([low, high, high, low])[:, b]
    corners[:, c] = np.array([low, low, high, high])[:, c]
    picture = speckle((1024, 1024), 14.0, np.random.default_rng(0)).astype(np.uint8)
    stream = io.BytesIO()
    imsave(stream, np.repeat(picture[..., None], 3, axis=2), format="png")
    rows = [f"v {x} {y} {z}" for x, y, z in corners.tolist()]
    rows += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", f"vn {' '.join(map(str, rig.face.normal))}"]
    rows += ["f 1/1/1 2/2/1 3/3/1", "f 1/1/1 3/3/1 4/4/1"]
    return Mesh(
        InMemoryMesh(
            mesh_file=MemoryFile(
                "\n".join(["mtllib p.mtl", "usemtl p", *rows]) + "\n", ".obj", "p.obj"
            ),
            supporting_files={
                "p.mtl": MemoryFile("newmtl p\nKd 1 1 1\nmap_Kd p.png\n", ".mtl", "p.mtl"),
                "p.png": MemoryFile(stream.getvalue(), ".png", "p.png"),
            },
        )
    )


def test_pictures_of_an_rgbd_sensor_do(rig):
    """A plate that stands still, drawn by Drake: its points are found where they are, and stay there."""
    builder = DiagramBuilder()
    scene = builder.AddSystem(SceneGraph())
    scene.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams(cast_shadows=False)))
    source = scene.RegisterSource("plate")
    shown = GeometryInstance(RigidTransform(), plate(rig), "plate")
    properties = PerceptionProperties()
    properties.AddProperty("label", "id", RenderLabel.kDontCare)
    shown.set_perception_properties(properties)
    scene.RegisterAnchoredGeometry(source, shown)
    tracker = builder.AddSystem(Tracker(rig, period=PERIOD))
    for name, camera in rig.cameras.items():
        K = camera.K
        info = CameraInfo(*camera.size, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        core = RenderCameraCore("vtk", info, ClippingRange(0.05, 2.0), RigidTransform())
        sensor = builder.AddSystem(
            RgbdSensor(
                scene.world_frame_id(),
                RigidTransform(camera.X_WC),
                ColorRenderCamera(core, False),
                DepthRenderCamera(core, DepthRange(0.06, 1.9)),
            )
        )
        builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())
        for port in ("color_image", "image_time"):
            builder.Connect(sensor.GetOutputPort(port), tracker.GetInputPort(f"{name}.{port}"))
    found, _ = sights(builder.Build(), tracker, 2)
    held = found[-1].value.held
    assert found[0].time == 0.0 and found[1].time == 1.0 / RATE and held.mean() > 0.9
    off = (found[-1].value.p_WQ - rig.points()[: len(held)])[held]
    assert np.abs(off).max() < 1e-4  # a tenth of what a part shows
    still = (found[-1].value.p_WQ - found[0].value.p_WQ)[held]
    assert np.sqrt(np.mean(still**2)) < 2e-6  # of 150 um that a pixel shows


class Given(LeafSystem):
    """A recording that is there from the beginning."""

    def __init__(self, recording):
        super().__init__()
        self.DeclareAbstractOutputPort(
            "recording", lambda: Value[object](None), lambda context, out: out.set_value(recording)
        )


def test_the_inside_of_a_diagram_is_that_of_the_recording(scenario):
    """Points throughout a body that is stretched: the field is theirs, with true errors."""
    frames, noise = 30, 1e-6
    share = np.linspace(0.0, 1.0, frames)
    rest = stretched(scenario, 0.0)[0][::7]
    moved = np.stack([stretched(scenario, s)[1][::7] for s in share])
    rng = np.random.default_rng(0)
    low, high = specimen_corners(scenario)
    recording = Recording.from_arrays(
        share,
        moved + noise * rng.standard_normal(moved.shape),
        p_reference=rest,
        noise=noise,
        density=1000.0,
        geometry={
            "shape": "box",
            "low": " ".join(map(str, low)),
            "high": " ".join(map(str, high)),
        },
    )
    builder = DiagramBuilder()
    given = builder.AddSystem(Given(recording))
    system = builder.AddSystem(Reconstructor(every=0.1))
    builder.Connect(given.get_output_port(), system.GetInputPort("recording"))
    made = builder.Build()
    simulator = Simulator(made)
    simulator.AdvanceTo(0.05)
    own = system.GetMyContextFromRoot(simulator.get_context())
    assert system.get_output_port().Eval(own).value is None
    simulator.AdvanceTo(0.15)
    result = system.get_output_port().Eval(own)
    found = result.value.inside
    assert result.time == found.time == 1.0 and result.value.reason == ""
    wanted = found.X + (found.X - 0.5 * (low + high)) * (STRETCH - 1.0)
    assert np.abs(found.F - np.diag(STRETCH)).max() < 1e-3
    assert found.v_WQ == pytest.approx(wanted - found.X, abs=2e-4)
    square = np.mean(((found.p_WQ - wanted) / found.deviation) ** 2)
    assert 0.1 < square < 5.0 and found.deviation.max() < 3.0 * noise
    fit = fit_tracks(recording, body(recording))
    sampling = Sampling.of(fit, np.array([1.0]), found.X, np.ones(len(found.X)), 1.0)
    drawn = [sampling.motion(fit.draw(rng)).x[0] - found.X for _ in range(400)]
    assert np.std(drawn, axis=0) == pytest.approx(found.deviation, rel=0.25)


def test_an_answer_behind_the_diagram_reaches_who_looks_inside(monkeypatch):
    """The diagram goes on while a law is identified; then the inside is that of the law."""
    gate, told = threading.Event(), []

    def slow(recording, *, method, force):
        assert gate.wait(60.0) and (method, force) == ("weak", "sensor")
        return SimpleNamespace(material="found")

    monkeypatch.setattr(identifier_module, "identify", slow)
    recording = SimpleNamespace(time=np.array([0.0, 0.7]))
    builder = DiagramBuilder()
    given = builder.AddSystem(Given(recording))
    identifier = builder.AddSystem(Identifier(every=0.1, wait=False, told=told.append))
    inner = builder.AddSystem(Reconstructor(every=10.0))
    for system in (identifier, inner):
        builder.Connect(given.get_output_port(), system.GetInputPort("recording"))
    builder.Connect(identifier.get_output_port(), inner.GetInputPort("material"))
    simulator = Simulator(builder.Build())

    def materials():
        own = inner.GetMyContextFromRoot(simulator.get_context())
        return inner.newest(own, -np.inf)[1][1]

    simulator.AdvanceTo(0.35)
    assert materials() is None and not told
    gate.set()
    while materials() is None:
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.1)
        time.sleep(0.01)
        assert simulator.get_context().get_time() < 300.0
    assert materials() == "found" and [answer.time for answer in told] == [0.7]


def test_points_that_are_followed_are_drawn_anew_with_another_run():
    meshcat = Meshcat()
    viewer = SightViewer(meshcat, np.array([0.0, 0.0, 1.0]))
    context = viewer.CreateDefaultContext()
    for now, frames in ((0.1, 1), (0.1, 1), (0.2, 2), (0.1, 1)):
        seen = SimpleNamespace(
            time=now, held=np.ones(2, bool), p_WQ=np.eye(3)[:2], likeness=np.array([0.9, 1.0])
        )
        viewer.get_input_port().FixValue(context, Value[object](SimpleNamespace(value=seen)))
        viewer.ForcedPublish(context)
        assert [meshcat.HasPath(f"/sight/{n}") for n in range(3)] == [n < frames for n in range(3)]
