"""The demo: a soft body of unknown stiffness is thrown, identified from noisy positions, predicted.

The truth is drawn from a seed, written to ``truth.json`` and opened again only for the last table,
after the answer is on disk.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from form_drake.files import read_mapping, write_json
from form_drake.identify import Identification, identify
from form_drake.laws import LAWS
from form_drake.laws.values import lame
from form_drake.material import Material, read_material
from form_drake.mpm.bodies import block, rigid_velocity
from form_drake.mpm.prediction import Prediction, predict
from form_drake.mpm.simulation import Simulation
from form_drake.records import Recording, Solver, Wall, read, write_recording
from form_drake.report import Report

LAW = "fixed-corotated"
CELLS = 24
DX = 0.01
DT = 2.5e-4
FRAME_STEPS = 40
FRAMES = 36
EDGE = 0.06
DENSITY = 1000.0
NOISE = 2e-4


@dataclass(frozen=True)
class Outcome:
    """What the demo found: answer, prediction of the unseen motion, and that of the start."""

    answer: Identification
    unseen: Recording
    after: Prediction
    before: Prediction


def solver() -> Solver:
    """A closed box of 0.24 m whose walls let go."""
    ends = ((-1, 2 * DX), (1, (CELLS - 2) * DX))
    walls = tuple(Wall(axis, side, at) for axis in range(3) for side, at in ends)
    return Solver(dx=DX, nodes=(CELLS,) * 3, dt=DT, walls=walls)


def thrown(material: Material, rng: np.random.Generator, noise: float) -> Recording:
    """Positions at 100 Hz of a soft cube thrown to the floor with a random spin."""
    body = block((0.12, 0.12, 0.12), (EDGE,) * 3, DX / 2, DENSITY)
    v = np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-2.5, -1.5)])
    v_0 = rigid_velocity(body.x, v, rng.uniform(-12.0, 12.0, 3))
    simulation = Simulation(solver(), material.law, body)
    simulation.set_material(material.values)
    simulation.reset(body.x, v_0)
    step = np.arange(FRAMES) * FRAME_STEPS
    p_WQ = simulation.run(step.tolist())
    return Recording(
        time=step * DT,
        p_WQ=p_WQ + rng.normal(0.0, noise, p_WQ.shape),
        p_reference=body.x,
        v_0=v_0,
        volume=body.volume,
        density=DENSITY,
        gravity=np.array(solver().gravity),
        step=step,
        solver=solver(),
        law=LAW,
        geometry={"shape": "box", "size": f"{EDGE} {EDGE} {EDGE} m"},
        source="form-drake demo",
    )


def hidden_material(rng: np.random.Generator) -> Material:
    """A soft material: E from 8 to 80 kPa, nu from 0.2 to 0.4."""
    E, nu = float(np.exp(rng.uniform(np.log(8e3), np.log(8e4)))), float(rng.uniform(0.2, 0.4))
    mu, lam = lame(E, nu)
    return Material(LAWS[LAW], {"mu": mu, "lam": lam}, DENSITY)


def run_demo(folder: Path, seed: int, say: Callable[[str], None]) -> Outcome:
    """The whole demo into a folder: recordings, material, prediction, report."""
    rng = np.random.default_rng(seed)
    truth = hidden_material(rng)
    say("1/5 a soft cube of hidden stiffness is thrown (compiling kernels the first time)")
    write_recording(replace(thrown(truth, rng, NOISE), v_0=None), folder / "recording.h5")
    write_recording(thrown(truth, rng, 0.0), folder / "unseen.h5")
    write_json(folder / "truth.json", {"law": LAW, "values": truth.values})
    del truth
    say("2/5 its law is identified from noisy positions at 100 Hz")
    answer = identify(read(folder / "recording.h5"))
    answer.material.write(folder / "material.yaml")
    write_json(folder / "identification.json", answer.to_json())
    say("3/5 a motion that it has not seen is predicted")
    unseen = read(folder / "unseen.h5")
    start = replace(answer.material, values=dict(answer.details["start"]), keys=())
    before = predict(unseen, start)
    after = predict(unseen, read_material(folder / "material.yaml"))
    write_recording(after.recording, folder / "prediction.h5")
    outcome = Outcome(answer, unseen, after, before)
    say("4/5 the report is written")
    _report(outcome, seed, folder)
    return outcome


def error_mm(prediction: Prediction, unseen: Recording) -> np.ndarray:
    """Root mean square distance of predicted and true points [mm], shape [frames]."""
    error = prediction.recording.p_WQ - unseen.p_WQ
    return 1e3 * np.sqrt((error**2).sum(axis=2).mean(axis=1))


def parameter_rows(answer: Identification, truth: dict[str, float]) -> list[list[str]]:
    """Rows of the last table: identified, 95 % half-width, truth, error."""
    true = Material(answer.material.law, truth, DENSITY).parameters()
    rows = []
    for key, p in answer.material.parameters().items():
        t = true[key].value
        half = f"{1.96 * p.std:.2g}" if p.std is not None else "-"
        error = f"{100 * (p.value / t - 1):+.3f} %"
        rows.append([key, p.unit, f"{p.value:.6g}", half, f"{t:.6g}", error])
    return rows


def _report(outcome: Outcome, seed: int, folder: Path) -> None:
    from form_drake.figures import before_and_after, error_over_time, motion_strip

    answer = outcome.answer
    page = Report("form_drake demo: identify once, predict an unseen motion")
    page.paragraph(
        f"Seed {seed}. A cube of {1e3 * EDGE:.0f} mm is thrown into a box; its points are recorded"
        f" at {1 / (FRAME_STEPS * DT):.0f} Hz with {1e3 * NOISE} mm of noise. Known are shape,"
        f" density, walls, the pose at the start and the kind of law ({LAW}); stiffness and initial"
        " motion are not."
    )
    page.figure(motion_strip(read(folder / "recording.h5")), "The recorded motion.")
    page.heading("Prediction of a motion that was not used")
    caption = (
        "Unseen throw where it is deformed most: true points and prediction, before (the best of"
    )
    caption += " a scan over decades of stiffness) and after identification. Colour: distance to the truth."
    page.figure(before_and_after(outcome.unseen, outcome.before, outcome.after), caption)
    curves = {"before": error_mm(outcome.before, outcome.unseen)}
    curves["after"] = error_mm(outcome.after, outcome.unseen)
    page.figure(error_over_time(outcome.unseen.time, curves), "Distance to the truth over time.")
    page.paragraph(
        f"Loss (mean square of a coordinate's error) {outcome.before.loss:.2e} m² before,"
        f" {outcome.after.loss:.2e} m² after."
    )
    page.heading("The identified law, and the truth that was hidden")
    truth = read_mapping(folder / "truth.json")["values"]
    head = ["parameter", "unit", "identified", "± 95 %", "truth", "error"]
    page.table(head, parameter_rows(answer, truth))
    page.paragraph(
        f"{answer.rows} equations, residual {1e3 * answer.residual:.3f} mm, condition"
        f" {answer.condition:.1f}, {answer.details['rollouts']} rollouts in {answer.seconds:.1f} s."
    )
    page.heading("Not verified here")
    page.paragraph(
        "Recording and prediction come from the same solver, so this shows the workflow and the error"
        " bars, not agreement with an independent simulation or a real material; for data that"
        " another program made see: form-drake bench table2."
    )
    page.write(folder / "report.html")
