"""The API page: what docstrings say of the names that users meet."""

import ast
import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from textwrap import dedent
from typing import Any

from make_markdown import single

API = {
    "From a recording to a material": (
        "form_drake.read",
        "form_drake.Recording",
        "form_drake.write_recording",
        "form_drake.identify.identify",
        "form_drake.Identification",
        "form_drake.Unidentifiable",
        "form_drake.Material",
        "form_drake.read_material",
        "form_drake.mpm.prediction.predict",
        "form_drake.mpm.prediction.Prediction",
    ),
    "What a recording may hold": (
        "form_drake.Solver",
        "form_drake.Wall",
        "form_drake.records.States",
        "form_drake.records.Stream",
        "form_drake.records.Camera",
    ),
    "Laws": (
        "form_drake.laws.Law",
        "form_drake.laws.Term",
        "form_drake.laws.Constant",
        "form_drake.laws.law_named",
        "form_drake.laws.values.lame",
        "form_drake.laws.memory.Memory",
    ),
    "The solver": (
        "form_drake.mpm.simulation.Simulation",
        "form_drake.mpm.simulation.Body",
        "form_drake.mpm.simulation.State",
        "form_drake.mpm.simulation.BlowUp",
        "form_drake.mpm.simulation.stable_dt",
        "form_drake.mpm.bodies.block",
        "form_drake.mpm.bodies.rigid_velocity",
        "form_drake.mpm.solids.Solid",
        "form_drake.mpm.tools.Tool",
        "form_drake.mpm.tools.Grip",
        "form_drake.mpm.exchange.Scene",
        "form_drake.mpm.exchange.Snapshot",
    ),
    "Perception": (
        "form_drake.perceive.seen.tracked",
        "form_drake.perceive.seen.Sight",
        "form_drake.perceive.seen.Count",
        "form_drake.perceive.seen.followed",
        "form_drake.perceive.seen.gathered",
        "form_drake.seen_report.write_seen_report",
        "form_drake.perceive.pictures.Pictures",
        "form_drake.perceive.rig.Rig",
        "form_drake.perceive.speckle.speckle",
        "form_drake.perceive.track.Tracker",
        "form_drake.perceive.track.Points",
        "form_drake.perceive.correlate.Parts",
        "form_drake.perceive.correlate.Matches",
        "form_drake.perceive.correlate.matched",
        "form_drake.perceive.warps.warped",
        "form_drake.perceive.optics.looking",
        "form_drake.perceive.optics.projected",
        "form_drake.perceive.optics.rays",
        "form_drake.perceive.optics.triangulated",
        "form_drake.perceive.optics.Places",
        "form_drake.perceive.stereo.Stereo",
        "form_drake.perceive.stereo.Followed",
        "form_drake.perceive.render.Surface",
        "form_drake.perceive.render.Light",
        "form_drake.perceive.render.Renderer",
    ),
    "The inside behind a surface": (
        "form_drake.interior.inside",
        "form_drake.interior.Inside",
        "form_drake.interior.Seen",
        "form_drake.interior.Path",
        "form_drake.interior.friction_of",
        "form_drake.interior.Resistance",
    ),
    "Effects": (
        "form_drake.effects.Effect",
        "form_drake.effects.Reading",
        "form_drake.effects.World",
        "form_drake.effects.Ball",
        "form_drake.effects.Inclusion",
        "form_drake.effects.AddedMass",
        "form_drake.mpm.stage.Stage",
        "form_drake.diagnose.ProbeReading",
        "form_drake.effects.load",
        "form_drake.effects.catalogue",
        "form_drake.diagnose.diagnosed",
        "form_drake.diagnose.Diagnosis",
        "form_drake.diagnose.Nulls",
        "form_drake.diagnose.thresholds.thresholds",
        "form_drake.diagnose.Model",
        "form_drake.diagnose.Cause",
        "form_drake.diagnose.Scenes",
        "form_drake.diagnose.prepare.read",
        "form_drake.diagnose.search.matched",
        "form_drake.diagnose.match.Match",
        "form_drake.diagnose.sight.Sight",
        "form_drake.diagnose.sight.guessed",
        "form_drake.diagnose.verdict.named",
        "form_drake.diagnose.verdict.Naming",
        "form_drake.diagnose.verdict.Found",
        "form_drake.diagnose.race.raced",
        "form_drake.diagnose.race.Runner",
        "form_drake.diagnose.motions.Block",
        "form_drake.diagnose.hidden.Hidden",
        "form_drake.diagnose.watch.Watch",
        "form_drake.diagnose.watch.Alarm",
        "form_drake.diagnose.verify.Check",
        "form_drake.diagnose.verify.Predicted",
        "form_drake.diagnose.verify.Channel",
        "form_drake.diagnose.placebo.Placebo",
        "form_drake.diagnose.placebo.Removed",
        "form_drake.diagnose.score.scores",
        "form_drake.diagnose.score.coherence",
        "form_drake.diagnose.score.Score",
        "form_drake.diagnose.ledger.ledgers",
        "form_drake.diagnose.ledger.Ledger",
        "form_drake.diagnose.rollout.Astray",
        "form_drake.diagnose.advice.Advice",
        "form_drake.diagnose.advice.Limit",
        "form_drake.diagnose.advice.Apart",
        "form_drake.diagnose.figures.ranking",
        "form_drake.diagnose.figures.places",
        "form_drake.diagnose.figures.moments",
        "form_drake.diagnose.figures.gaps",
        "form_drake.diagnose.figures.overlay",
        "form_drake.systems.before_after.write_before_after",
    ),
    "The station": (
        "form_drake.systems.scenario.load_scenario",
        "form_drake.systems.scenario.Scenario",
        "form_drake.systems.station.make_station",
        "form_drake.systems.probe.prepare",
        "form_drake.systems.probe.record",
        "form_drake.systems.replay.replay",
        "form_drake.systems.replay.twin",
        "form_drake.systems.soft.AddMaterial",
        "form_drake.systems.material.MaterialSystem",
        "form_drake.systems.identifier.Identifier",
        "form_drake.systems.recorder.Recorder",
        "form_drake.systems.monitor.Monitor",
        "form_drake.systems.behind.Behind",
        "form_drake.systems.behind.Result",
        "form_drake.systems.cameras.SpeckleCameras",
        "form_drake.systems.cameras.PictureFiles",
        "form_drake.systems.pictures.Photographer",
        "form_drake.systems.tracker.Tracker",
        "form_drake.systems.tracker.SightViewer",
        "form_drake.systems.reconstructor.Reconstructor",
        "form_drake.systems.reconstructor.Reconstruction",
        "form_drake.systems.deformable.deformable_config",
        "form_drake.systems.kinematics.inverse_kinematics",
        "form_drake.systems.motion.tool_path",
        "form_drake.systems.motion.timed_path",
        "form_drake.systems.free_motion.free_move",
        "form_drake.systems.snapshots.snapshot",
    ),
}


def resolved(name: str) -> Any:
    """The object of a dotted name."""
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)


def signature(node: ast.FunctionDef, name: str) -> str:
    """A function's call, without the type annotations that its docstring explains."""
    arguments = node.args
    for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        a.annotation = None
    for extra in (arguments.vararg, arguments.kwarg):
        if extra is not None:
            extra.annotation = None
    arguments.args = [a for a in arguments.args if a.arg not in ("self", "cls")]
    return f"{name}({ast.unparse(arguments)})"


def prose(text: str) -> str:
    """A Google docstring as Markdown: sections become lists, double backticks single ones."""
    lines: list[str] = []
    section = ""
    for line in dedent(text).splitlines():
        if re.fullmatch(r"(Args|Attributes|Returns|Raises|Example):", line):
            section = line
            lines += [f"*{line[:-1]}*", "", *(["```pycon"] if section == "Example:" else [])]
        elif section == "Example:" or not section:
            lines.append(line[4:] if section else line)
        else:
            entry = re.match(r" {4}(\w+): (.*)", line)
            titled = section != "Returns:" and entry is not None
            lines.append(f"- `{entry[1]}`: {entry[2]}" if titled else f"  {line.strip()}".rstrip())
    if section == "Example:":
        lines = [*"\n".join(lines).rstrip().splitlines(), "```"]
    return single("\n".join(lines))


def described(name: str) -> Iterator[str]:
    """The entry of one class or function."""
    thing, short = resolved(name), name.rpartition(".")[2]
    tree = ast.parse(dedent(inspect.getsource(thing))).body[0]
    at_top = getattr(import_module("form_drake"), short, None) is thing
    public = f"form_drake.{short}" if at_top else name
    call = None
    if isinstance(tree, ast.FunctionDef):
        call = signature(tree, short)
    methods = [n for n in getattr(tree, "body", []) if isinstance(n, ast.FunctionDef)]
    for n in methods if isinstance(tree, ast.ClassDef) else []:
        if n.name == "__init__":
            call = signature(n, short)
    shown = f"```python\n{call}\n```\n\n" if call else ""
    yield f"### {short}\n\n`{public}`\n\n{shown}{prose(inspect.getdoc(thing))}\n"
    for n in methods if isinstance(tree, ast.ClassDef) else []:
        text = ast.get_docstring(n)
        if not n.name.startswith("_") and text:
            kinds = {d.id for d in n.decorator_list if isinstance(d, ast.Name)}
            shown = n.name if kinds & {"property", "cached_property"} else signature(n, n.name)
            yield f"#### {short}.{shown}\n\n{prose(text)}\n"


def api_page() -> str:
    """The whole API page."""
    parts = [
        "# API\n\nMade from the docstrings by `python docs/make.py`. SI units throughout; arrays state"
        " unit and shape.\n"
    ]
    for title, names in API.items():
        parts.append(f"## {title}\n")
        for name in names:
            parts += described(name)
    return "\n".join(parts)
