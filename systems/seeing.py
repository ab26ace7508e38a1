"""Two cameras beside a station, and who follows points in their pictures."""

from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder

from form_drake.records import Recording
from form_drake.systems.behind import steps_between
from form_drake.systems.cameras import SpeckleCameras
from form_drake.systems.pictures import Photographer, rig_of, without_points
from form_drake.systems.recorder import Source
from form_drake.systems.scenario import Scenario
from form_drake.systems.station import Station
from form_drake.systems.tracker import SightViewer, Tracker


def add_cameras(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: Station,
    header: Recording,
    duration: float,
    meshcat: Meshcat | None = None,
) -> Source:
    """Add the scenario's cameras, that see the particles, and a tracker.

    Args:
        builder: that holds the station's diagram.
        scenario: of the station.
        station: whose specimen is seen.
        header: what is known before the probe.
        duration: of the probe [s].
        meshcat: that shows the points.

    Raises:
        ValueError: the scenario says of no face that it is seen.
    """
    solver = scenario.solver
    every = steps_between(scenario.stereo.rate, solver.period)
    rig = rig_of(scenario, 1.0 / (every * solver.period))
    frames = 1 + int((duration - solver.settle) * rig.rate + 1e-6)
    rest = station.material.scene.rest
    photographer = Photographer(scenario, rig, rest, frames, solver.device)
    cameras = SpeckleCameras(rig, photographer, solver.settle)
    tracker = Tracker(rig, period=solver.period, begin=solver.settle, device=solver.device)
    builder.AddNamedSystem("cameras", cameras)
    builder.AddNamedSystem("tracks", tracker)
    particles = station.diagram.GetOutputPort("material.particles")
    builder.Connect(particles, cameras.get_input_port())
    for name in rig.cameras:
        for port in (f"{name}.color_image", f"{name}.image_time"):
            builder.Connect(cameras.GetOutputPort(port), tracker.GetInputPort(port))
    if meshcat is not None:
        viewer = builder.AddNamedSystem("sight_viewer", SightViewer(meshcat, rig.face.normal))
        builder.Connect(tracker.get_output_port(), viewer.get_input_port())
    symmetry = scenario.stereo.symmetry
    return Source(tracker, without_points(header, symmetry), scenario.stereo.rate, rig)
