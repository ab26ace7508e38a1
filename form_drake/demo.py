"""The demo: a probe in the station, identification of the hidden material, prediction, report.

The truth is drawn from a seed, written to ``truth.json`` and opened again only for the last table,
after the answer is on disk.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from form_drake.files import read_mapping, write_json, write_text
from form_drake.identify import Identification, identify
from form_drake.material import Material, read_material
from form_drake.motion import body
from form_drake.records import Recording, read, write_recording
from form_drake.report import Report

SCENARIO = "press_b"
STIFFNESS = (30e3, 120e3)  # E [Pa], log-uniform
STRENGTH = (0.03, 0.12)  # tau_y / E, log-uniform
GUESS = (60e3, 0.06)  # E [Pa] and tau_y / E before the probe: the middles of both
NOISE = 20e-6  # of tracked points [m]
FORCE_NOISE = 0.05  # of the force sensor [N]


@dataclass(frozen=True)
class Outcome:
    """What the demo found.

    Attributes:
        answer: identification.
        before: errors of the unseen motion's prediction with the first guess.
        after: the same with the identified material.
    """

    answer: Identification
    before: dict[str, float]
    after: dict[str, float]


def hidden_changes(rng: np.random.Generator) -> list[str]:
    """Changes of the scenario that make the specimen a soft dough that nobody knows."""

    def drawn(ends: tuple[float, float]) -> float:
        return float(np.exp(rng.uniform(*np.log(ends))))

    E = drawn(STIFFNESS)
    return [f"specimen.material.E={E}", f"specimen.material.tau_y={E * drawn(STRENGTH)}"]


def run_demo(
    folder: Path, seed: int, say: Callable[[str], None], changes: Sequence[str] = ()
) -> Outcome:
    """The whole demo into a folder: recordings, material, prediction, pages.

    Args:
        folder: to write into.
        seed: of the hidden material and of the noise.
        say: told what happens.
        changes: of the scenario, PATH=VALUE.
    """
    from form_drake.systems.probe import prepare, record, shown, truth
    from form_drake.systems.scenario import held_out, load_scenario, scenario_text
    from form_drake.systems.viewer import View

    hidden = hidden_changes(np.random.default_rng(seed))
    own = [f"measure.noise={NOISE}", f"measure.sensor.noise=[{FORCE_NOISE}]"]
    own += [f"measure.seed={seed}", f"measure.sensor.seed={seed}"]
    drawn = {one.split("=")[0] for one in (*own, *hidden)}
    if taken := [one for one in changes if one.split("=")[0].strip() in drawn]:
        raise ValueError(
            f"--set {taken[0]}: the demo sets it by itself; form-drake simulate takes it"
        )
    changes = [*changes, *own]
    scenario = load_scenario(SCENARIO, (*changes, *hidden))
    unseen = held_out(scenario)
    if "nu" not in scenario.specimen.told():
        raise ValueError("--set specimen.known: nu is wanted among it, which the first guess takes")
    say("1/4 the arm presses a soft block of hidden material (compiling kernels the first time)")
    run = prepare(scenario, shown(), View(field="stress"))
    write_recording(record(run), folder / "recording.h5")
    run.write_page(folder / "station.html")
    _pictures(run, folder)
    say("2/4 and a second, fresh block deeper and faster, for the test of the prediction")
    write_recording(record(prepare(unseen)), folder / "unseen.h5")
    write_text(folder / "scenario.yaml", scenario_text(SCENARIO, changes, hidden=True))
    write_json(folder / "truth.json", truth(scenario))
    del scenario, run, hidden
    say("3/4 the law is identified from tracked points and measured force")
    answer = identify(read(folder / "recording.h5").measured_by("sensor"))
    answer.material.write(folder / "material.yaml")
    write_json(folder / "identification.json", answer.to_json())
    say("4/4 the second press is predicted, with a first guess and with the identified material")
    return _predicted(folder, answer, seed)


def _pictures(run: Any, folder: Path) -> None:
    from form_drake.systems.probe import begin
    from form_drake.systems.snapshots import Studio, close_up, overview, write_snapshot

    simulator = begin(run)
    studio = Studio(run.station)
    for name, camera in (("station", overview(run.station)), ("specimen", close_up(run.station))):
        picture = studio.picture(simulator.get_context(), camera)
        write_snapshot(folder / f"{name}.png", picture)


def _predicted(folder: Path, answer: Identification, seed: int) -> Outcome:
    from form_drake.systems.replay import Replay, replay
    from form_drake.systems.scenario import load_scenario

    scenario = load_scenario(folder / "scenario.yaml")
    unseen = read(folder / "unseen.h5").measured_by("sensor")
    E, share = GUESS
    guess = {"E": E, "nu": unseen.known["nu"], "tau_y": share * E}
    found: dict[str, Replay] = {}
    for name, material in (
        ("before", answer.material.changed(guess)),
        ("after", read_material(folder / "material.yaml")),
    ):
        found[name] = replay(scenario, material, unseen)
    write_recording(found["after"].recording, folder / "prediction.h5")
    errors = {
        name: {"shape_rms": r.shape_rms, "force_rms": r.force_rms, "peak_error": r.peak_error}
        for name, r in found.items()
    }
    outcome = Outcome(answer, errors["before"], errors["after"])
    _report(outcome, unseen, {n: r.recording for n, r in found.items()}, seed, folder)
    return outcome


def parameter_rows(answer: Identification, truth: dict[str, float]) -> list[list[str]]:
    """Rows of the last table: identified, 95 % half-width, truth, error."""
    true = Material(answer.material.law, truth).parameters()
    rows = []
    for key, p in answer.material.parameters().items():
        t = true[key].value
        half = f"{1.96 * p.std:.2g}" if p.std is not None else "-"
        error = f"{100 * (p.value / t - 1):+.3f} %"
        rows.append([key, p.unit, f"{p.value:.6g}", half, f"{t:.6g}", error])
    return rows


def _report(
    outcome: Outcome, unseen: Recording, predicted: dict[str, Recording], seed: int, folder: Path
) -> None:
    from form_drake.figures import error_over_time, force_over_time

    answer = outcome.answer
    page = Report("form_drake demo: press once, predict an unseen press")
    shape = body(unseen)
    edges = " x ".join(f"{1e3 * edge:.3g}" for edge in shape.high - shape.low)
    page.paragraph(
        f"Seed {seed}. A Panda presses a block of {edges} mm with a flat plate. Known are shape,"
        f" density, Poisson's ratio and the kind of law ({answer.material.law.name}); stiffness and"
        f" yield stress are not. Measured are {unseen.points} points with {1e6 * NOISE:.0f} um of noise and the"
        f" force on the plate with {FORCE_NOISE} N. The whole probe plays in station.html."
    )
    page.image(folder / "station.png", "The station.")
    page.image(folder / "specimen.png", "The specimen before the probe.")
    page.heading("Prediction of a press that was not used, deeper and faster")
    tool = next(iter(unseen.poses))
    curves = {"measured": unseen, "first guess": predicted["before"]}
    curves["identified"] = predicted["after"]
    forces = {k: (r.forces[tool].time, r.forces[tool].value) for k, r in curves.items()}
    page.figure(force_over_time(forces), "Force on the plate, measured and predicted.")
    apart = {k: distance_mm(r, unseen) for k, r in predicted.items()}
    page.figure(error_over_time(unseen.time, apart), "Distance of predicted to measured points.")
    errors = {"first guess": outcome.before, "identified": outcome.after}
    rows = [
        [
            name,
            f"{1e3 * e['shape_rms']:.3f} mm",
            f"{100 * e['force_rms']:.2f} %",
            f"{100 * e['peak_error']:+.2f} %",
        ]
        for name, e in errors.items()
    ]
    page.table(["material", "shape, rms", "force, rms of the peak", "peak force"], rows)
    page.heading("The identified law, and the truth that was hidden")
    truth = read_mapping(folder / "truth.json")["values"]
    head = ["parameter", "unit", "identified", "± 95 %", "truth", "error"]
    page.table(head, parameter_rows(answer, truth))
    page.paragraph(
        f"{answer.rows} equations, condition {answer.condition:.1f}, {answer.seconds:.1f} s."
    )
    page.heading("Not verified here")
    page.paragraph(
        "Probe and prediction come from the same solver, so this shows the workflow and the error"
        " bars, not agreement with an independent simulation or a real material; for finite elements"
        " and measured rubber see: form-drake bench weak-form and bench rubber."
    )
    page.write(folder / "report.html")


def distance_mm(prediction: Recording, unseen: Recording) -> np.ndarray:
    """Root mean square distance of predicted and measured points [mm], shape [frames]."""
    error = prediction.p_WQ - unseen.p_WQ
    found: np.ndarray = 1e3 * np.sqrt((error**2).sum(axis=2).mean(axis=1))
    return found
