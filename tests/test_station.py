"""Scenarios and the station: typed files, ports, a short probe, what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from form_drake.__main__ import main
from form_drake.control import smooth
from form_drake.diagnose.recorded import motions
from form_drake.effects import CATALOGUE
from form_drake.identify import identify
from form_drake.laws import LAWS
from form_drake.material import Material
from form_drake.records import Recording, Stream, read, write_recording
from form_drake.systems.advised import MOTIONS, PUSHES, SHAKES, advised
from form_drake.systems.arm import Arm
from form_drake.systems.behind import steps_between
from form_drake.systems.layers import named
from form_drake.systems.probe import begin, begun, planned, prepare, record, tracked, truth
from form_drake.systems.replay import replay
from form_drake.systems.scenario import (
    Waypoint,
    declaring,
    held_out,
    holding,
    load_scenario,
    scenario_text,
)
from form_drake.systems.station import directives, make_station, specimen_corners

COARSE = ("solver.dx=0.005", "solver.mass_scale=40", "measure.points=60")
HUGE = "1" + "0" * 400
PORTS = {
    "panda.position_measured",
    "panda.velocity_measured",
    "panda.torque_external",
    "tool.X_WT",
    "tool.force",
    "tool.force_from_torque",
}


def short(name="press_b", *changes):
    """A coarse probe that only touches: until 5 % of the press."""
    scenario = load_scenario(name, (*COARSE, *changes))
    first, _, *_ = scenario.probe.waypoints
    p = np.array(first.p_WT)
    way = [Waypoint(0.0, list(p)), Waypoint(0.1, list(p)), Waypoint(0.5, list(p - [0, 0, 0.003]))]
    scenario.probe.waypoints = way
    scenario.solver.settle = 0.05
    return scenario


@pytest.fixture(scope="module")
def pressed():
    run = prepare(short())
    return run, record(run)


def test_named_scenarios_load_and_say_their_truth():
    assert named() == [
        *("bend_a", "bend_arm_a", "bend_arm_b", "bend_b"),
        *("press_a", "press_b", "press_elastic", "shake_elastic"),
    ]
    values = {name: truth(load_scenario(name))["values"] for name in named()}
    assert values["press_a"]["tau_y"] == 1e3 and values["press_b"]["tau_y"] == 1e4
    for name, v in values.items():
        nu = 0.45 if name.startswith("bend") else 0.3
        E = 240e3 if name.startswith("bend") and name.endswith("_b") else 80e3
        E = 30e3 if name.endswith("elastic") else E
        assert v["mu"] * 2.0 * (1.0 + nu) == pytest.approx(E)


def test_changes_and_inheritance():
    scenario = load_scenario("press_a", ("specimen.material.E=63e3", "measure.points=7"))
    assert scenario.specimen.material["E"] == 63e3
    assert scenario.specimen.material["tau_y"] == 1e3
    assert scenario.specimen.material["nu"] == 0.3  # from press
    assert scenario.measure.points == 7
    assert load_scenario("shake_elastic").specimen.contact == {"press_plate": "bonded"}  # null


def test_the_text_of_a_scenario_is_a_scenario(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(scenario_text("bend_a", ("specimen.material.E=90e3",)))
    again = load_scenario(path)
    assert again == load_scenario("bend_a", ("specimen.material.E=90e3",))


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("press_c", (), "choose from bend_a, bend_arm_a, bend_arm_b, bend_b, press_a, press_b"),
        ("press_a", ("specimen.E=1",), "no specimen.E; allowed there are size, p_WM"),
        ("press_a", ("solver.dx=fine",), "solver.dx: a number is wanted, got 'fine'"),
        ("press_a", ("solver.dx",), "NAME.NAME=VALUE"),
        ("press_a", ("measure.rate=0",), "measure.rate: a positive number"),
        ("press_a", ("measure.points=-1",), "measure.points: must not be negative"),
        ("press_a", ("measure.seed=-1",), "measure.seed: must not be negative"),
        ("press_a", ("measure.torque.seed=-1",), "measure.torque.seed: must not be negative"),
        ("press_a", (f"measure={{noise: {HUGE}}}",), "measure.noise: a finite number is wanted"),
        ("press_a", (f"solver={{per_cell: [{HUGE}]}}",), r"per_cell\[0\]: a finite number"),
        ("press_a", (f"probe={{until_force: {HUGE}}}",), "probe.until_force: a finite number"),
        ("press_a", ("specimen.faces.top=free",), "specimen.faces: no face 'top'; allowed are x-"),
        ("press_a", ("specimen.faces={z+: foo}",), "faces.z.: 'foo'; allowed are free, unknown"),
        ("press_a", ("specimen.faces={z+: bonded a b}",), "faces.z.: 'bonded a b'; allowed"),
        ("press_a", ("specimen.faces={z+: free, z+: free}",), r"z\+ is given twice"),
        ("press_a", ("specimen.known=[foo]",), "known: von-mises has no parameter 'foo': choose"),
        ("press_a", ("specimen.law=rubber",), "unknown law 'rubber'"),
        ("press_a", ("cameras.a=5",), "cameras.a holds entries, got 5"),
        ("press_a", ("cameras.a={X_PB: 5}",), "cameras.a.X_PB holds entries, got 5"),
        ("press_a", ("cameras.a={size: 5}",), "no cameras.a.size; allowed there are width"),
        ("press_a", ("specimen.size=[0.03, 0.03]",), "specimen.size: three numbers"),
        ("press_a", ("specimen.size.x=1",), "holds no entries"),
        ("press_a", ("probe.waypoints=[{t: 0}]",), r"no probe.waypoints\[0\].t"),
        ("press_a", ("panda.stiffness=[1, 2]",), "panda: stiffness .* give 7 positive values"),
        ("press_a", ("panda.fingers=0.5",), "panda: the fingers are at 0.5 m: give 0 to 0.04"),
        ("press_a", ("panda.control_mode=torque",), "panda: control_mode 'torque' .* position"),
        ("press_a", ("measure.sensor.noise=[-0.005]",), "measure.sensor: .* must not be negative"),
        (
            "press_a",
            ("measure.rate=2000",),
            "measure.rate: 2000 Hz is more often than the material",
        ),
        ("press_a", ("measure.torque.period=0",), "measure.torque: .* the period positive"),
        (
            "press_a",
            ("measure.sensor.period=0.002",),
            "sensor.period: 0.002 s is longer than solver",
        ),
        ("press_a", ("stereo.size=[640]",), "stereo: size: 2 numbers are wanted"),
        ("press_a", ("stereo.focus=-1",), "stereo: focus: a positive number is wanted"),
        ("press_a", ("cameras={front: {rgb: false, depth: false}}",), "cameras.front: neither rgb"),
        ("press_a", ("specimen.effects=[{id: a",), "what follows = is no YAML"),
        ("press_a", ("measure.sensor.noise=[]",), "measure.sensor: sensor noise .., bandwidth"),
        ("press_a", ("solver.damping=-5",), "solver.damping: must not be negative, got -5"),
        ("press_a", ("solver.settle=-1",), "solver.settle: must not be negative"),
        ("press_a", ("solver.room=[0.01, -1, 0.01]",), "solver.room: must not be negative"),
        ("press_a", ("specimen.clamped.z+=-0.01",), r"specimen.clamped.z\+: must not be negative"),
        ("press_a", ("specimen.size=[0.03, 0, 0.02]",), "specimen.size: a positive number"),
        ("press_a", ("name=.",), "name: that of a folder in runs is wanted, got '.'"),
        ("press_a", ("name=..",), "name: that of a folder in runs"),
        ("press_a", ("name=../elsewhere",), "name: that of a folder in runs"),
    ],
)
def test_bad_scenarios_are_one_line(name, change, said):
    with pytest.raises(ValueError, match=said) as caught:
        load_scenario(name, change)
    assert "\n" not in str(caught.value)


def test_of_what_is_known_a_material_keeps_its_own():
    values = {"C1": 1e4, "C2": 1.0, "C3": 1.0, "kappa": 1e5}
    yeoh = Material(LAWS["yeoh"], values, 1000.0)
    changes = (*holding(yeoh), declaring(["nu", "C3", "density"], yeoh.law))
    assert load_scenario("press_a", changes).specimen.known == ["C3", "density"]
    with pytest.raises(ValueError, match="known: yeoh has no parameter 'nu'"):
        load_scenario("press_a", holding(yeoh))


def test_what_is_known_is_told_as_stated_or_as_it_follows():
    lame = {"mu": 1e4, "lam": 4e4, "tau_y": 1e3}
    changes = holding(Material(LAWS["von-mises"], lame, 1000.0))
    told = load_scenario("press_a", changes).specimen.told()
    assert told == {"nu": pytest.approx(0.4)}
    assert load_scenario("press_a").specimen.told()["nu"] == 0.3
    assert load_scenario("press_a", ("specimen.known=[mu]",)).specimen.told()["mu"] > 0.0


def test_null_takes_an_entry_out_wherever_it_stands(tmp_path):
    for told in ("specimen.contact.press_plate=null", "specimen.contact={press_plate: null}"):
        assert "press_plate" not in load_scenario("press_a", (told,)).specimen.contact
    path = tmp_path / "mine.yaml"
    path.write_text("inherits: press_a\nspecimen: {clamped: {z+: null}}\n")
    assert load_scenario(path).specimen.clamped == {}


def test_a_station_leaves_its_scenario_as_it_was():
    scenario = load_scenario("press_a")
    make_station(scenario)
    assert scenario == load_scenario("press_a") and scenario.panda.compensated == []


def test_nothing_comes_more_often_than_steps():
    assert [steps_between(rate, 1e-3) for rate in (1000.0, 999.0, 600.0, 30.0)] == [1, 1, 1, 33]
    with pytest.raises(
        ValueError, match=r"5000 Hz, every 0[.]0002 s, is more often than the material"
    ):
        steps_between(5000.0, 1e-3)


def test_inheritance_without_end(tmp_path):
    path = tmp_path / "loop.yaml"
    path.write_text(f"inherits: {path}\n")
    with pytest.raises(ValueError, match="inherits from itself"):
        load_scenario(path)


@pytest.mark.parametrize(("settle", "rate"), [(0.45, 10), (0.25, 3)])
def test_a_probe_of_hardly_a_frame_is_refused_before_it_runs(settle, rate):
    scenario = short("press_b", f"measure.rate={rate}")
    scenario.solver.settle = settle
    with pytest.raises(ValueError, match=r"the probe ends at 0.5 s, .* two frames at least"):
        prepare(scenario)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("specimen.material.G=1e3",), "no parameter 'G'"),
        (("specimen.material.density=0",), "density: must be positive, got 0"),
        (("cameras.a={width: -5}",), "cameras.a: .* Width .-5. should be positive"),
        (("cameras.a={X_PB: {base_frame: nope}}",), "cameras.a: .* no Frame named 'nope'"),
        (("specimen.size=[0.3, 0.3, 0.3]",), "1.4e.07 of them"),
        (("specimen.contact={anvil: 0.0}",), "no body anvil"),
        (("specimen.contact={specimen_stand: 0.1}",), "press_plate is not among"),
        (("specimen.clamped={top: 0.01}",), "no face 'top'"),
        (("cell=package://form_drake/nowhere.yaml",), "nowhere.yaml"),
        (("cell=nowhere.yaml",), "nowhere.yaml"),
        (("probe.tool=press_plate::tip",), "no frame 'tip'"),
    ],
)
def test_what_does_not_fit_together_is_one_line(changes, said):
    with pytest.raises(ValueError, match=said):
        make_station(load_scenario("press_a", changes))


def test_hardware_is_said_to_be_missing():
    with pytest.raises(ValueError, match="no driver"):
        make_station(load_scenario("press_a"), hardware=True)


def test_a_cell_is_a_file_and_cameras_have_ports(tmp_path, monkeypatch):
    """Named from where one is; pictures go to ports, and nowhere else."""
    cell = load_scenario("press_b").cell
    (tmp_path / "cell.dmd.yaml").write_text(f"directives: [add_directives: {{file: '{cell}'}}]\n")
    monkeypatch.chdir(tmp_path)
    changes = ("cell=cell.dmd.yaml", "cameras={front: {rgb: true, width: 32, height: 24}}")
    diagram = make_station(short("press_b", *changes)).diagram
    for port in ("color_image", "depth_image_32f", "image_time"):
        assert diagram.HasOutputPort(f"front.{port}")
    assert not [s for s in diagram.GetSystems() if "Lcm" in s.get_name()]


def test_files_are_named_from_the_scenario_that_names_them(tmp_path):
    """Wherever one is, from a scenario that inherits it, and from the one that a run leaves."""
    cell = load_scenario("press_b").cell
    (tmp_path / "own").mkdir()
    (tmp_path / "own/cell.dmd.yaml").write_text(
        f"directives: [add_directives: {{file: '{cell}'}}]\n"
    )
    own = {"inherits": "press_b", "cell": "cell.dmd.yaml", "packages": {"parts": "."}}
    (tmp_path / "own/press.yaml").write_text(yaml.safe_dump(own))
    (tmp_path / "heir.yaml").write_text("inherits: own/press.yaml\n")
    left = tmp_path / "own/left.yaml"
    left.write_text(scenario_text(tmp_path / "heir.yaml", hidden=True))
    for path in (tmp_path / "heir.yaml", left):
        scenario = load_scenario(path)
        assert scenario.cell == str(tmp_path / "own/cell.dmd.yaml")
        assert scenario.packages == {"parts": str(tmp_path / "own")}
        assert planned(scenario).rows() == 7


def test_powers_of_ten_are_numbers_in_files_as_in_changes(tmp_path):
    path = tmp_path / "press.yaml"
    path.write_text(
        "inherits: press_a\nspecimen: {material: {E: 63e3}, size: [3e-2, .03E0, 25e-3]}\n"
    )
    specimen = load_scenario(path, ("specimen.p_WM=[5e-1, 0, 6.25e-2]",)).specimen
    assert specimen.material["E"] == 63e3
    assert specimen.size + specimen.p_WM == [0.03, 0.03, 0.025, 0.5, 0.0, 0.0625]


def test_ports():
    diagram = make_station(short()).diagram
    names = {diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())}
    assert names >= PORTS
    assert diagram.HasInputPort("panda.position")


def test_overlap_at_the_start():
    scenario = short()
    for way in scenario.probe.waypoints:
        way.p_WT = [0.5, 0.0, 0.0735]
    with pytest.raises(ValueError, match="overlaps at the start: press_plate::contact by"):
        record(prepare(scenario))


def test_unreachable_tool():
    scenario = short()
    scenario.probe.waypoints[-1].p_WT = [1.5, 0.0, 0.1]
    with pytest.raises(ValueError, match=r"at time 0\.25 s: the tool reaches"):
        planned(scenario)


def test_waypoints_are_met_at_rest():
    stamps, places = [0.0, 1.0, 3.0], [[0, 0, 0], [0, 0, 1.0], [2.0, 0, 1.0]]
    for time, place in zip(stamps, places, strict=True):
        assert smooth(stamps, places, time) == pytest.approx(place)
        ends = (smooth(stamps, places, time + h) for h in (1e-6, -1e-6))
        assert next(ends) - next(ends) == pytest.approx(0.0, abs=2e-11)
    assert smooth(stamps, places, 2.0) == pytest.approx([1.0, 0.0, 1.0])
    assert smooth(stamps, places, 9.0) == pytest.approx(places[-1])


def test_unseen_paths_stand_in_the_scenarios():
    for name in ("press_a", "press_b", "bend_a", "bend_b"):
        scenario = load_scenario(name)
        assert planned(held_out(scenario)).end_time() == scenario.probe.unseen[-1].time
    with pytest.raises(ValueError, match="has no probe"):
        held_out(load_scenario("bend_arm_a"))


def test_recording_of_a_press(pressed, tmp_path):
    run, recording = pressed
    tool = recording.forces["press_plate"]
    assert tool.value[-1, 2] > 0.3  # pushes the plate up
    moved = recording.p_WQ - recording.reference
    top = recording.reference[:, 2] > 0.07
    assert moved[-1, top, 2].max() < -2e-4
    X_WT = recording.poses["press_plate"].value
    assert X_WT[-1, :3, 3] == pytest.approx([0.5, 0.0, 0.073], abs=2e-4)
    assert recording.contact == dict(run.scenario.specimen.faces)
    write_recording(recording, tmp_path / "r.h5")
    again = read(tmp_path / "r.h5")
    assert np.array_equal(again.p_WQ, recording.p_WQ)


def test_a_recording_holds_nothing_of_the_truth(pressed):
    """Other hidden values of the same motion would leave the very same file."""
    _, recording = pressed
    told = {**recording.known, "density": recording.density}
    assert set(told) == {"nu", "density"}
    assert recording.solver is None and recording.states is None and recording.volume is None


def test_joint_torques_feel_what_the_sensor_feels(pressed):
    """At rest at the end, within the little that the arm still moves."""
    _, recording = pressed
    sensor, torque = (
        recording.forces[n].value[-1] for n in ("press_plate", "press_plate:joint-torque")
    )
    assert torque == pytest.approx(sensor, abs=0.01 * np.abs(sensor).max())


def test_momentum_over_the_station():
    """Material, plate and stand exchange momentum with an arm in the loop, to round-off."""
    run = prepare(short("press_b", "solver.precision=float64"))
    simulator, material = begin(run), run.station.material
    mass = material.scene.simulation.body.mass
    g = np.array(material.scene.simulation.solver.gravity)
    given, period = np.zeros(3), run.scenario.solver.period
    for k in range(1, 401):
        simulator.AdvanceTo(k * period)
        if k < 50:
            continue
        context = material.GetMyContextFromRoot(simulator.get_context())
        momentum = (mass[:, None] * material.snapshot(context).state.v).sum(axis=0)
        if k == 50:
            start = momentum
            continue
        for name in ("press_plate", "specimen_stand"):
            given += period * material.GetOutputPort(f"{name}.wrench").Eval(context)[3:]
    weight = (400 - 50) * period * mass.sum() * g
    assert momentum - start + given == pytest.approx(weight, abs=1e-9 * np.abs(given).max())
    assert np.abs(given[2]) > 0.01


def test_tracked_points_are_free_of_the_clamp():
    scenario = load_scenario("bend_a", ("solver.dx=0.004",))
    run = prepare(scenario)
    corners = specimen_corners(scenario)
    assert corners[1, 2] == pytest.approx(0.2375)
    X = run.station.material.scene.rest[tracked(scenario, run.station)]
    assert len(X) == 400 and X[:, 2].max() < 0.2375


def test_replay_of_the_same_material(pressed):
    """Driven by pose the truth is found again to what the arm's sampling leaves; softer, it is not."""
    run, recording = pressed
    recording = recording.measured_by("sensor")
    material = run.scenario.specimen.made()
    same = replay(run.scenario, material, recording)
    (stamps,) = (stream.time for stream in same.recording.poses.values())
    assert stamps[-1] == pytest.approx(same.recording.time[-1])  # so that it can be simulated
    assert same.shape_rms < 1e-6
    assert abs(same.peak_error) < 1e-3 and same.force_rms < 1e-3
    softer = replay(run.scenario, material.changed({"E": 60e3, "nu": 0.3}), recording)
    assert softer.peak_error == pytest.approx(-0.25, abs=0.05)


def test_a_prediction_where_no_force_was_measured(pressed, tmp_path, monkeypatch, capsys):
    """Has no error of it, and says so."""
    run, recording = pressed
    monkeypatch.chdir(tmp_path)
    force = recording.forces["press_plate"]
    none = replace(force, value=np.zeros_like(force.value))
    write_recording(replace(recording, forces={"press_plate": none}), tmp_path / "recording.h5")
    (tmp_path / "scenario.yaml").write_text(
        scenario_text("press_b", (*COARSE, "solver.settle=0.05"))
    )
    run.scenario.specimen.made().write(tmp_path / "dough.yaml")
    told = ["predict", "dough.yaml", "recording.h5"]
    assert main([*told, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["shape_rms"] < 1e-6
    assert found["force_rms"] is None and found["peak_error"] is None
    assert main(told) == 0
    assert "rms, no force was measured, driven by pose" in capsys.readouterr().out


def test_replay_driven_by_force(pressed):
    """The tool goes where the recorded force pushes it."""
    run, recording = pressed
    found = replay(run.scenario, run.scenario.specimen.made(), recording, drive="force")
    assert found.peak_error == pytest.approx(0.0, abs=0.1)
    stroke, measured = (
        X.poses["press_plate"].value[-1, 2, 3] - 0.076 for X in (found.recording, recording)
    )
    assert stroke == pytest.approx(measured, rel=0.05)


def test_replay_of_another_scenario_is_refused(pressed):
    _, recording = pressed
    with pytest.raises(ValueError, match="bending_pusher"):
        replay(load_scenario("bend_a", COARSE), truthful("bend_a"), recording)
    with pytest.raises(ValueError, match="not of this scenario"):
        replay(load_scenario("press_a", ("solver.dx=0.004",)), truthful("press_a"), recording)


def truthful(name):
    return load_scenario(name).specimen.made()


def test_written_scenario_hides_the_material():
    content = yaml.safe_load(scenario_text("press_a", hidden=True))
    assert content["specimen"]["material"] == {"nu": 0.3, "density": 1000.0}


def test_answers_sharpen_and_the_last_is_the_batch_answer():
    """Streaming: refusals first, then answers whose intervals shrink; the last one is exact."""
    scenario = short(
        "press_b",
        "specimen.law=fixed-corotated",
        "specimen.material={E: 8.0e+4, nu: 0.3, density: 1000}",
        "measure.noise=1e-4",
    )
    run = prepare(scenario, answers=0.03)
    identifier = run.diagram.GetSubsystemByName("identifier")
    simulator = begin(run)
    found = []
    for time in (0.15, 0.36, 0.48):
        simulator.AdvanceTo(time)
        recording = run.recorder.recording(
            run.recorder.GetMyContextFromRoot(simulator.get_context())
        )
        simulator.AdvanceTo(time + 0.005)
        own = identifier.GetMyContextFromRoot(simulator.get_context())
        found.append(identifier.get_output_port().Eval(own).value)
    last, batch = found[-1].identification, identify(recording, method="weak")
    assert found[-1].time == recording.time[-1]
    assert last.material.values == pytest.approx(batch.material.values, rel=1e-12)
    assert last.material.values["mu"] == pytest.approx(80e3 / 2.6, rel=0.1)
    assert found[0].identification is None and found[0].reason  # only noise was seen
    deviations = [f.identification.material.parameters()["mu"].std for f in found[1:]]
    assert deviations[1] < 0.5 * deviations[0]
    simulator.AdvanceTo(run.duration)
    simulator.AdvancePendingEvents()
    context = simulator.get_mutable_context()
    whole = run.recorder.recording(run.recorder.GetMyContextFromRoot(context))
    own = identifier.GetMyMutableContextFromRoot(context)
    identifier.conclude(own)
    concluded = identifier.get_output_port().Eval(own)
    assert whole.time[-1] == concluded.time == concluded.value.time > recording.time[-1]


def test_a_press_stops_at_a_force():
    """The plate is held by the arm where the sensor reads 3 N, though the path goes on to 6 N."""
    scenario = short("press_b", "solver.mass_scale=20")
    scenario.probe.until_force = 3.0
    force = record(prepare(scenario)).forces["press_plate"].value[:, 2]
    assert 3.0 <= force.max() < 3.6
    assert force[-1] == pytest.approx(3.2, abs=0.4)


def test_a_thicker_strip_is_felt_by_the_joints():
    """The thick strip of the softer material pushes with 2 N, in the joints as at the sensor."""
    changes = ("solver.dx=0.0095", "solver.settle=0.1", "measure.points=60")
    scenario = load_scenario("bend_arm_a", changes)
    scenario.probe.waypoints = scenario.probe.waypoints[:3]
    recording = record(prepare(scenario))
    sensor, torque = (
        recording.measured_by(source).forces["bending_pusher"].value[-1]
        for source in ("sensor", "joint-torque")
    )
    assert np.linalg.norm(sensor) > 2.0
    assert torque == pytest.approx(sensor, abs=0.02 * np.linalg.norm(sensor))


def test_motions_that_a_diagnosis_advises_are_a_scenario(tmp_path):
    """Of a block of another size: every motion of the catalogue that is one of the plate."""
    shown = {motion for effect in CATALOGUE.values() for motion in effect.shown}
    assert set(MOTIONS) < shown
    soft = Material(LAWS["neo-hookean"], {"C10": 5e3, "kappa": 4e4}, 1100.0)
    box = np.array([-0.016, -0.02, 0.0]), np.array([0.016, 0.02, 0.03])
    assert set(SHAKES) | set(PUSHES) < shown
    made = advised(sorted(shown), *box, "frictionless", soft)
    assert set(made) == {"next.yaml", "next-shake.yaml"}  # what slides is not pushed
    text = made["next.yaml"]
    (tmp_path / "next.yaml").write_text(text)
    scenario = load_scenario(tmp_path / "next.yaml")
    made = scenario.specimen.made()
    assert (made.law, made.values, made.density) == (soft.law, soft.values, 1100.0)
    assert scenario.specimen.p_WM == pytest.approx([0.5, 0.0, 0.065])
    assert float(scenario.specimen.contact["specimen_stand"]) == 0.0
    heights = np.array([point.p_WT[2] for point in scenario.probe.waypoints])
    assert heights.max() == pytest.approx(0.081) and heights.min() == pytest.approx(0.074)
    assert heights[0] == heights[-1] == heights.max()  # it begins and ends without contact
    assert prepare(scenario).duration == scenario.probe.waypoints[-1].time  # the arm gets there
    assert advised(["a ruler", "a balance"], *box, "bonded", soft) == {}
    assert advised(["shake"], box[0], 3.0 * box[1], "bonded", soft) == {}  # too wide for the plate


@pytest.mark.parametrize("motion", [*MOTIONS, *SHAKES, *PUSHES])
def test_a_motion_that_is_advised_is_known_again(tmp_path, motion):
    """As its waypoints have the plate go, and feel what it presses: else it would be advised for ever."""
    soft = Material(LAWS["neo-hookean"], {"C10": 5e3, "kappa": 4e4}, 1100.0)
    box = np.array([-0.018, -0.017, 0.0]), np.array([0.018, 0.017, 0.03])
    ((name, text),) = advised([motion], *box, "bonded", soft).items()
    (tmp_path / name).write_text(text)
    scenario = load_scenario(tmp_path / name)
    points, body = scenario.probe.waypoints, scenario.specimen
    stamps = np.arange(0.05, points[-1].time, 1e-3)
    p_WT = [smooth([p.time for p in points], [p.p_WT for p in points], t) for t in stamps]
    X_WT, force = np.tile(np.eye(4), (len(stamps), 1, 1)), np.zeros((len(stamps), 3))
    X_WT[:, :3, 3] = p_WT
    low, high = (np.array(body.p_WM) + s * np.array(body.size) for s in (-0.5, 0.5))
    force[:, 2] = 1e3 * np.maximum(high[2] - X_WT[:, 2, 3], 0.0)
    recording = Recording.from_arrays(
        stamps[::16],
        np.tile(np.linspace(low, high, 9), (len(stamps[::16]), 1, 1)),
        density=1100.0,
        geometry={"shape": "box"}
        | {k: " ".join(map(str, v)) for k, v in (("low", low), ("high", high))},
        contact=body.faces,
        poses={"press_plate": Stream(stamps, X_WT)},
        forces={"press_plate": Stream(stamps, force, noise=0.02)},
    )
    assert motion in motions(recording)


def test_blocks_that_are_shaken_hang_from_the_plate_and_those_that_are_pushed_stand(tmp_path):
    soft = Material(LAWS["neo-hookean"], {"C10": 5e3, "kappa": 4e4}, 1100.0)
    box = np.array([-0.016, -0.02, 0.0]), np.array([0.016, 0.02, 0.03])
    wanted = ["shake", "shakes along two directions", "a push from the side"]
    made, told = advised(wanted, *box, "bonded", soft), {}
    for name, text in made.items():
        (tmp_path / name).write_text(text)
        changes = ("measure.points=30", "solver.dx=0.006", "measure.rate=100")
        scenario = load_scenario(tmp_path / name, changes)
        told[name] = recording = record(prepare(scenario))
        low, high = (np.array(recording.geometry[k].split(), float) for k in ("low", "high"))
        assert low == pytest.approx([0.484, -0.02, 0.05]) and high[2] == pytest.approx(0.08)
        assert recording.contact["z+"] == "bonded press_plate"
    shake, push = told["next-shake.yaml"], told["next-push.yaml"]
    assert motions(shake.measured_by("sensor")) == {"shake", "shakes along two directions"}
    assert shake.contact["z-"] == "free" and push.contact["z-"] == "bonded specimen_stand"
    weight = 9.81 * 1100.0 * 0.032 * 0.04 * 0.03
    hanging = shake.forces["press_plate"].value[:10, 2].mean()
    assert hanging == pytest.approx(-weight, rel=0.05)
    for one, least, most in ((shake, 3e-3, 6e-3), (push, 2e-3, 4e-3)):
        moved = one.p_WQ - one.p_WQ[0]
        top = one.reference[:, 2] > 0.07
        assert least < np.abs(moved[:, top, 0]).max() < most
    foot = push.reference[:, 2] < 0.055
    assert np.abs((push.p_WQ - push.p_WQ[0])[:, foot]).max() < 1e-3


def test_an_arm_that_holds_a_hanging_block_begins_where_springs_and_weight_balance():
    scenario = load_scenario("shake_elastic")
    motion, mass = (
        planned(scenario),
        np.prod([0.03, 0.03, 0.025]) * scenario.specimen.made().density,
    )
    arm = Arm.load(directives(scenario), tool="press_plate::tool", packages=scenario.packages)
    q, start = motion.value(0.0).ravel(), begun(scenario, motion)

    def energy(angles):  # of the joints' springs and of the block
        springs = np.array(scenario.panda.stiffness) @ (angles - q) ** 2 / 2.0
        return springs + mass * 9.81 * arm.pose(angles).translation()[2]

    def pull(angles, step=1e-6):
        return [
            (energy(angles + step * e) - energy(angles - step * e)) / (2.0 * step)
            for e in np.eye(7)
        ]

    assert np.abs(pull(start)).max() < 1e-3 * np.abs(pull(q)).max()
    standing = load_scenario("press_elastic")
    path = planned(standing)
    assert np.array_equal(begun(standing, path), path.value(0.0).ravel())
