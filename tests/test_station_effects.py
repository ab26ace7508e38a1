"""Effects in the station: what acts in the specimen or its sensors, and is nowhere in the recording."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.framework import DiagramBuilder

from form_drake.__main__ import main
from form_drake.bench import station
from form_drake.effects import CATALOGUE, Effect
from form_drake.laws import LAWS
from form_drake.material import Acting, Material, read_material
from form_drake.records import Recording, Stream, read
from form_drake.systems.probe import prepare, record, truth
from form_drake.systems.replay import replay
from form_drake.systems.scenario import Waypoint, holding, load_scenario, scenario_text
from form_drake.systems.soft import AddMaterial
from form_drake.systems.station import make_station

COARSE = ("solver.dx=0.006", "solver.mass_scale=20", "measure.points=40", "measure.noise=0")
QUIET = (*COARSE, "measure.sensor.noise=[0.0]", "measure.place=0", "solver.settle=0.05")
FORCES = ("press_plate", "press_plate:joint-torque")
BALL = "{x: 0.5, y: 0.0, z: 0.0625, radius: 0.01}"


def acting(*effects, changes=()):
    """A short press of a coarse elastic block in which effects act."""
    own = f"specimen.effects=[{', '.join(effects)}]"
    scenario = load_scenario("press_elastic", (*QUIET, own, *changes))
    p = np.array([0.5, 0.0, 0.076])  # a millimetre above
    times, depths = (0.0, 0.06, 0.2, 0.3), (0.0, 0.0, 0.0025, 0.0015)
    way = [Waypoint(t, list(p - [0.0, 0.0, d])) for t, d in zip(times, depths, strict=True)]
    scenario.probe.waypoints = way
    return scenario


@pytest.fixture(scope="module")
def plain():
    return record(prepare(acting()))


def scene(*effects):
    return make_station(acting(*effects)).material.scene


def test_a_scenario_tells_which_effects_act_and_its_files_do_not():
    drag = "{id: drag, coefficient: 5.0}"
    scenario = acting(drag)
    assert truth(scenario)["effects"] == [{"id": "drag", "coefficient": 5.0, "shape": {}}]
    assert "effects" not in truth(acting())
    change = (f"specimen.effects=[{drag}]",)
    assert "drag" in scenario_text("press_elastic", change)
    assert "drag" not in scenario_text("press_elastic", change, hidden=True)


def test_what_a_world_changes_is_in_the_scene():
    body = scene().simulation.body
    heavy = scene("{id: density, coefficient: 0.1}", "{id: drag, coefficient: 7.0}")
    assert heavy.simulation.body.mass.sum() == pytest.approx(1.1 * body.mass.sum())
    assert heavy.drag == 7.0 / 20.0  # of the mass that moves, which is scaled
    loaded = scene(f"{{id: added-mass, coefficient: 2.0e-3, shape: {BALL}}}")
    assert loaded.simulation.body.mass.sum() - body.mass.sum() == pytest.approx(20.0 * 2e-3)
    tilted = scene("{id: gravity-tilt, coefficient: 0.1, shape: {azimuth: 0.0}}")
    g = np.array(tilted.simulation.solver.gravity) * 20.0
    assert np.linalg.norm(g) == pytest.approx(9.81) and abs(g[0]) == pytest.approx(0.98, rel=0.01)
    relaxing = scene("{id: relaxation, coefficient: 0.3, shape: {time: 0.2}}")
    assert [m.share for m in relaxing.simulation.memories] == [0.3]
    stiff = scene(f"{{id: inclusion, coefficient: 1.0, shape: {BALL}}}")
    assert len(stiff.simulation.bodies) > 1 and len(stiff.rest) == len(body.x)
    swollen = scene("{id: eigenstrain, coefficient: 0.02}").start().state.F
    np.testing.assert_allclose(swollen, np.broadcast_to(np.eye(3) / 1.02, swollen.shape))
    rough = scene("{id: tool-friction, coefficient: 0.2}")
    assert {t.name: t.contact for t in rough.tools}.items() >= {("press_plate::contact", 0.2)}
    damped = scene("{id: damping, coefficient: 3.0}")
    assert damped.simulation.laws[0].name == "fixed-corotated+damping"


def test_sensors_tell_what_their_effects_make_of_the_same_motion(plain):
    told = record(
        prepare(
            acting("{id: force-gain, coefficient: 0.1}", "{id: camera-scale, coefficient: 0.01}")
        )
    )
    gain = {"press_plate": 1.1, "press_plate:joint-torque": 1.0}  # the joints are no force sensor
    for source, force in plain.forces.items():
        np.testing.assert_allclose(
            told.forces[source].value, gain[source] * force.value, atol=1e-12
        )
    np.testing.assert_allclose(told.p_WQ, 1.01 * plain.p_WQ, atol=1e-12)
    np.testing.assert_array_equal(told.reference, plain.reference)


def test_a_tool_is_said_to_be_elsewhere_by_an_error_that_stays_and_is_stated(plain):
    told = record(prepare(acting(changes=("measure.place=1.0e-4",))))
    own, other = (r.poses["press_plate"] for r in (plain, told))
    assert own.noise is None and other.noise == 1e-4
    off = other.value - own.value
    assert np.ptp(off, axis=0) == pytest.approx(0.0, abs=1e-12)
    assert 1e-5 < np.linalg.norm(off[0, :3, 3]) < 5e-4
    np.testing.assert_array_equal(told.p_WQ, plain.p_WQ)


def test_what_resists_motion_takes_its_impulse(plain):
    """Of a rod that may widen the Trouton viscosity is two to three times that of shear, by volume."""
    damped = record(prepare(acting("{id: damping, coefficient: 30.0}")))
    (tool,) = plain.poses
    own, other = (r.forces[tool] for r in (plain, damped))
    pressing = (own.time > 0.06) & (own.time < 0.2)
    more = np.sum(other.value[pressing, 2] - own.value[pressing, 2]) * 1e-3
    area, strain = 0.03**2, (0.0025 - 0.001) / 0.025  # the first millimetre is air
    assert 2.0 < more / (30.0 * area * strain) < 3.0


def test_a_replay_of_the_same_material_is_the_probe_itself(plain):
    effects = "{id: tool-friction, coefficient: 0.3}", "{id: force-gain, coefficient: -0.2}"
    scenario = acting(*effects)
    hidden = record(prepare(scenario))
    again = replay(scenario, scenario.specimen.made(), hidden)
    without = replay(scenario, acting().specimen.made(), hidden)
    assert again.force_rms < 0.2 * without.force_rms
    assert again.shape_rms < 0.2 * without.shape_rms


def test_a_force_that_a_sensor_has_changed_drives_nothing(plain):
    scenario = acting("{id: force-gain, coefficient: 0.1}", "{id: drag, coefficient: 1.0}")
    with pytest.raises(ValueError, match="drive force: with force-gain the recorded force is not"):
        replay(scenario, scenario.specimen.made(), plain, drive="force")
    seen = acting("{id: camera-scale, coefficient: 0.01}")  # which changes no force
    assert abs(replay(seen, seen.specimen.made(), plain, drive="force").peak_error) < 0.02


OWN = """
from form_drake.effects import CATALOGUE, Effect
BIAS = CATALOGUE["force-bias"]
PULLED = Effect("pulled", "it is pulled", "N", (0.1, 9.0), BIAS.column, sensor=lambda r, size, shape:
    BIAS.sensor(r, size, {"azimuth": 0.0, "elevation": 0.0}))
"""


def test_a_scenario_names_effects_of_ones_own_and_the_command_their_file(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    way = yaml.safe_dump([{"time": t, "p_WT": [0.5, 0.0, 0.076]} for t in (0.0, 0.1)])
    own = "specimen.effects=[{id: pulled, coefficient: 0.5}]"
    told = ["simulate", "press_elastic", "--no-page"]
    told += [w for c in (*QUIET, own, f"probe.waypoints={way}") for w in ("--set", c)]
    assert main(told) == 2
    assert "effect 'pulled': choose from damping" in capsys.readouterr().err
    assert main([*told, "--effects", "own.py"]) == 0
    force = read(tmp_path / "runs/press_elastic/recording.h5").forces["press_plate"].value
    np.testing.assert_allclose(force, np.broadcast_to([0.5, 0.0, 0.0], force.shape), atol=1e-3)


def test_a_material_file_is_simulated_as_it_is(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    law = LAWS["fixed-corotated"]
    bias = Acting("force-bias", 0.5, {"azimuth": 0.0, "elevation": 0.0})
    soft = Material(law, {"mu": 1e4, "lam": 1.5e4}, 1100.0, effects=(bias,))
    soft.write(tmp_path / "soft.yaml")
    changes = holding(read_material(tmp_path / "soft.yaml"))
    made = load_scenario("press_elastic", changes).specimen.made()
    assert made.law is law and dict(made.values) == dict(soft.values)
    assert (made.density, made.effects) == (1100.0, soft.effects)
    own = yaml.safe_dump([{"time": t, "p_WT": [0.5, 0.0, 0.076]} for t in (0.0, 0.1)])
    told = ["--set", f"probe.waypoints={own}", *(w for c in QUIET for w in ("--set", c))]
    assert main(["simulate", "press_elastic", "--material", "soft.yaml", "--no-page", *told]) == 0
    capsys.readouterr()
    folder = tmp_path / "runs" / "press_elastic"
    force = read(folder / "recording.h5").forces["press_plate"].value
    np.testing.assert_allclose(force, np.broadcast_to([0.5, 0.0, 0.0], force.shape), atol=1e-3)
    assert "force-bias" in (folder / "truth.json").read_text()
    assert "effects" not in (folder / "scenario.yaml").read_text()


def test_effects_of_ones_own_may_act():
    thick = Effect(
        id="thick-air",
        sentence="the air is thick",
        unit="1/s",
        prior=(1.0, 10.0),
        column=lambda reading, shape: reading.X[:, 0],
        world=lambda world, size, shape: replace(world, drag=size),
    )
    material = replace(acting().specimen.made(), effects=(Acting("thick-air", 3.0),))
    made = make_station(acting(), material=material, effects=CATALOGUE | {"thick-air": thick})
    assert made.material.scene.drag == 3.0 / 20.0


@pytest.mark.parametrize(
    ("effects", "told"),
    [
        ("{id: sag, coefficient: 1.0}", "effect 'sag': choose from"),
        ("{id: adhesion, coefficient: 100.0}", "state the contact of the tools"),
        ("{id: relaxation, coefficient: 0.1}", "shape .* is given, .*time.* is wanted"),
        ("{id: drag, coefficient: -5.0}", "effects: effect drag: coefficient -5 is given"),
        (
            "{id: inclusion, coefficient: 1.0, shape: {x: 0.5, y: 0.0, z: 1.0, radius: 0.01}}",
            "effects: effect inclusion: a ball of 0.01 m .* lies outside of the body",
        ),
        ("{id: drag, size: 1.0}", r"no specimen.effects\[0\].size; allowed there are id, coeff"),
        ("{id: drag, coefficient: .nan}", r"coefficient: a finite number is wanted, got 'nan'"),
        ("{id: drag}", "an entry has no coefficient: .*such as {id: drag, coefficient: 0.03}"),
        ("{coefficient: 2.0}", "an entry has no id: id and coefficient are wanted"),
        ("{id: drag, coefficient: much}", r"coefficient: a number is wanted, got 'much'"),
    ],
)
def test_effects_that_a_station_cannot_show_are_refused_in_one_line(effects, told):
    with pytest.raises(ValueError, match=told) as caught:
        make_station(acting(effects))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("specimen.effects={id: drag}", "specimen.effects: a list is wanted, got {'id': 'drag'}"),
        ("specimen.size=3", "specimen.size: a list is wanted, got 3"),
        ("specimen.material=soft", "specimen.material: entries are wanted, got 'soft'"),
        ("specimen.material.E=.inf", "specimen.material.E: a finite number is wanted, got 'inf'"),
    ],
)
def test_what_is_of_another_kind_is_refused_in_one_line(change, told):
    with pytest.raises(ValueError) as caught:
        load_scenario("press_elastic", (change,))
    assert str(caught.value) == f"scenario press_elastic: {told}"


def test_a_tool_that_may_rub_cannot_rub_secretly():
    friction = "{id: tool-friction, coefficient: 0.2}"
    rough = acting(friction, changes=("specimen.contact.press_plate=0.1",))
    with pytest.raises(ValueError, match="none of press_plate, specimen_stand is stated to be"):
        make_station(rough)


def test_effects_act_on_one_body_alone():
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=1e-3, use_sampled_output_ports=False)
    plant, scene_graph = AddMultibodyPlant(config, builder)
    plant.Finalize()
    material = replace(acting().specimen.made(), effects=(Acting("drag", 1.0),))
    shapes = [Box(0.02, 0.02, 0.02)] * 2
    poses = [RigidTransform([0.0, 0.0, z]) for z in (0.0, 0.1)]
    with pytest.raises(ValueError, match="one body alone, here are 2"):
        AddMaterial(builder, plant, scene_graph, [material] * 2, shapes, poses)


def test_a_body_that_gives_way_is_not_simulated():
    values = {"mu": 1e4, "lam": -1e4}
    soft = replace(acting().specimen.made(), values=values)
    with pytest.raises(ValueError, match=r"bulk modulus -3333.33 Pa: must be positive"):
        make_station(acting(), material=soft)
    with pytest.raises(ValueError, match=r"bulk modulus -3333.33 Pa: must be positive"):
        acting(
            changes=(f"specimen.material={yaml.safe_dump({**values, 'density': 1e3})}",)
        ).specimen.made()


def test_what_the_station_hides_is_sought_in_what_it_records(tmp_path, monkeypatch):
    """Another draw of noise for every probe, and motions that are held back."""
    seen = []

    def diagnosed(read, law, *, effects, thresholds, holdout):
        every = (*read, *holdout)
        seen.append([(len(r.time), float(np.std(r.p_WQ))) for r in every])
        assert all(set(r.forces) == {"press_plate"} and r.law == law.name for r in every)
        cause = {"name": "drag", "coefficient": 12.3, "std": 0.2, "unit": "1/s"}
        gap = [{"closure": 0.97}, {"closure": None}]
        told = {"verdict": "named", "sentence": "", "doubts": [], "unverified": None, "gap": gap}
        return SimpleNamespace(to_json=lambda: {**told, "effects": [cause]})

    def recorded(run):
        asked.append((run.scenario, truth(run.scenario).get("effects", [])))
        moved = plate + 1e-6 * len(asked)
        return Recording.from_arrays(
            np.linspace(0.0, 0.1, 5),
            moved,
            law=run.scenario.specimen.law,
            forces={name: Stream(np.zeros(1), np.zeros((1, 3))) for name in FORCES},
        )

    plate, asked = np.arange(15.0).reshape(5, 1, 3), []
    monkeypatch.setattr("form_drake.systems.probe.prepare", lambda s: SimpleNamespace(scenario=s))
    monkeypatch.setattr("form_drake.systems.probe.record", recorded)
    monkeypatch.setattr(station, "diagnosed", diagnosed)
    result = station.run_station(store=tmp_path, only=("drag", "nothing", "friction"))
    hidden, none = (result["cases"][k] for k in ("drag", "nothing"))
    acting = [len(one) for _, one in asked]  # a plate that is glued on rubs nowhere
    assert acting == [0, 0, 0, 0, 1, 1, 1, 1, 1, 0, 1, 0]
    assert hidden["true"] == asked[4][1][0]["coefficient"] and none["true"] == 0.0
    assert len({s.measure.seed for s, _ in asked}) == len(asked) and len(seen) == 3
    assert all(s.solver.dx < 0.0016 and s.measure.place == 2e-5 for s, _ in asked)
    ways = [s.probe.waypoints for s, _ in asked[:4]]
    assert ways[0] != ways[2] and ways[1] != ways[3]
    told = station.table(result).splitlines()
    assert told[1].split() == "nothing - named 97 % drag 12.3 ± 0.2 1/s".split()
    assert told[2].split()[:3] == ["drag", "12.0", "named"]
