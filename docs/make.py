"""Make what in the documentation follows from the code.

``python docs/make.py`` writes the marked parts of theory.md and recording.md, and api.md;
``python docs/make.py --benchmarks FILE ...`` puts the tables of the JSON files that
``form-drake bench ... --out FILE`` writes into benchmarks.md.
"""

import argparse
import ast
import inspect
import json
import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, replace
from importlib import import_module
from pathlib import Path
from textwrap import dedent
from typing import Any

import h5py
import numpy as np

from form_drake.bench import blind_score, blind_table
from form_drake.effects import CATALOGUE
from form_drake.laws import ADDITIONS, LAWS
from form_drake.laws.law import Term
from form_drake.material import derived
from form_drake.records import Camera, Recording, Solver, States, Stream, Wall, write_recording

DOCS = Path(__file__).parent
BENCHES = (
    "table2",
    "table2-weak",
    "positions",
    "speed",
    "rubber",
    "weak-form",
    "probes",
    "perception",
    "deformable",
    "effects",
    "nulls",
    "station",
)
TABLES: dict[str, Callable[[dict[str, Any]], str]] = {
    name: import_module(f"form_drake.bench.{name.replace('-', '_')}").table for name in BENCHES
}
TABLES |= {"speed-cuda": TABLES["speed"], "probes-dx": TABLES["probes"]}
SEALED = {
    "first": "blind.json",
    "second": "second/blind.json",
    "third": "third/blind.json",
}
SIZES = {"frames": 11, "points": 13, "states": 17, "intervals": 19, "samples": 23, "joints": 29}
NOISE, POSES = (
    "standard deviation of one component; absent: unknown.",
    "standard deviation of how far the place is off, which stays so; absent: not at all.",
)
STREAM_UNITS = {"poses": "", "forces": "N", "joints": "rad"}
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
        "form_drake.diagnose.diagnosed",
        "form_drake.diagnose.Diagnosis",
        "form_drake.diagnose.Model",
        "form_drake.diagnose.Cause",
        "form_drake.diagnose.Scenes",
        "form_drake.diagnose.prepare.read",
        "form_drake.diagnose.search.matched",
        "form_drake.diagnose.match.Match",
        "form_drake.diagnose.sight.Sight",
        "form_drake.diagnose.verdict.named",
        "form_drake.diagnose.motions.Block",
        "form_drake.diagnose.hidden.Hidden",
        "form_drake.diagnose.watch.Watch",
        "form_drake.diagnose.watch.Alarm",
        "form_drake.diagnose.verify.Check",
        "form_drake.diagnose.verify.Channel",
        "form_drake.diagnose.placebo.Placebo",
        "form_drake.diagnose.score.scores",
        "form_drake.diagnose.score.coherence",
        "form_drake.diagnose.score.Score",
        "form_drake.diagnose.ledger.ledgers",
        "form_drake.diagnose.ledger.Ledger",
        "form_drake.diagnose.advice.Advice",
        "form_drake.diagnose.advice.Limit",
        "form_drake.diagnose.advice.Apart",
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


def marked(text: str, name: str, content: str) -> str:
    """``text`` with the part between the marks of ``name`` replaced."""
    start, end = f"<!-- docs/make.py: {name} -->", "<!-- docs/make.py: end -->"
    before, found, rest = text.partition(start)
    _old, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"the marks of {name!r} are missing")
    return f"{before}{start}\n{content}{end}{after}"


def markdown_table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    escaped = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    lines = [head, ["---"] * len(head), *escaped]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def laws_table() -> str:
    """Every law: its keys with units, what is derived, its Kirchhoff stress."""
    rows = []
    for law in (LAWS | ADDITIONS).values():
        keys = []
        for p in law.parameters:
            told = p.given if isinstance(p, Term) else p.role == "given"
            unit = "" if p.unit == "-" else f" [{p.unit}]"
            keys.append(f"`{p.key}`{unit}{' given' if told else ''}")
        more = ", ".join(f"`{k}`" for k in derived(law) if not law.adds_to)
        name = f"... `+{law.name}`" if law.adds_to else f"`{law.name}`"
        rows.append((name, ", ".join(keys), more, f"`{law.equation}`"))
    return markdown_table(("law", "parameters", "derived", "Kirchhoff stress"), rows)


def effects_table() -> str:
    """Every effect: its sentence, coefficient and shape, and what shows it."""
    rows = []
    for effect in CATALOGUE.values():
        unit = "" if effect.unit == "-" else f" [{effect.unit}]"
        sign = "either sign" if effect.signed else "positive"
        shapes = ", ".join(f"`{name}`" for name in effect.shapes)
        side = "the world" if effect.world else "a sensor"
        head = (f"`{effect.id}`", effect.sentence, f"{sign}{unit}", shapes)
        rows.append((*head, side, "; ".join(effect.shown)))
    return markdown_table(("effect", "what it is", "coefficient", "shape", "of", "shown by"), rows)


def sealed() -> dict[str, str]:
    """What verdicts on sealed sets are worth, by set, and all sets beside each other."""
    results = {}
    for name, place in SEALED.items():
        verdicts = DOCS / "blind" / place
        files = (verdicts, *(verdicts.parent / f for f in ("key.json", "key.sha256")))
        results[name] = blind_score.score(*files)
    told = {name: f"\n```text\n{blind_table.table(one)}\n```\n\n" for name, one in results.items()}
    return told | {"compared": compared(results)}


def compared(results: dict[str, dict[str, Any]]) -> str:
    """What sealed sets are judged by, a column for each; what misses its goal stands out."""
    sets = [{line.name: line for line in blind_table.lines(one)} for one in results.values()]
    goals = {k: line.goal for own in sets for k, line in own.items() if line.goal}
    rows = []
    for name, goal in goals.items():
        cells = [" ".join(own[name].told.split()) if name in own else "" for own in sets]
        off = [name in own and own[name].met is False for own in sets]
        told = [f"**{cell}**" if missed else cell for cell, missed in zip(cells, off, strict=True)]
        rows.append((name, goal, *told))
    return markdown_table(("", "goal", *results), rows)


# --- the layout of a recording, read off a file in which nothing is missing ---------------------
def stated(cls: type) -> dict[str, str]:
    """What the class's docstring says of each attribute."""
    section = inspect.getdoc(cls).partition("Attributes:\n")[2]
    found: dict[str, str] = {}
    for line in section.splitlines():
        entry = re.match(r" {4}(\w+): (.*)", line)
        if entry:
            key, found[entry[1]] = entry[1], entry[2]
        elif line.startswith(" " * 8):
            found[key] += " " + line.strip()
    return {k: single(t) for k, t in found.items()}


def attributes(cls: type) -> dict[str, str]:
    """``stated`` without shapes and units, and with a file in mind."""
    said = {k: t.replace("None:", "absent:") for k, t in stated(cls).items()}
    return {k: re.sub(r",? shape \[[^\]]*\]| \[[^\]]*\]", "", t) for k, t in said.items()}


def single(text: str) -> str:
    """``text`` with the double backticks of docstrings made single."""
    return re.sub(r"(?<!`)``(?!`)", "`", text)


def unit_of(text: str) -> str:
    """The first bracket that holds a unit."""
    found = re.search(r"\[([a-zA-Z/^0-9 ]*[a-zA-Z][a-zA-Z/^0-9 ]*)\]", text)
    return found[1] if found else ""


def _arrays(cls: type) -> dict[str, np.ndarray]:
    made = {}
    for f in fields(cls):
        if "dims" in f.metadata:
            shape = [int(d) if d.isdigit() else SIZES[d] for d in f.metadata["dims"]]
            value = 1 + np.arange(np.prod(shape)).reshape(shape)
            made[f.name] = value.astype({"i": int, "b": bool}.get(f.metadata["kind"], float))
    return made


def full_recording() -> Recording:
    """A recording in which no field is missing."""

    def stream(*shape: int) -> Stream:
        return Stream(np.arange(SIZES["samples"]) * 1.0, np.ones((SIZES["samples"], *shape)))

    alike = np.tile(np.eye(3), (SIZES["points"], 1, 1))
    recording = Recording(
        **{**_arrays(Recording), "covariance": alike, "face": np.zeros(SIZES["points"], int)},
        noise=1.0,
        density=1.0,
        mass_scale=2.0,
        solver=Solver(
            dx=1.0, nodes=(9, 9, 9), dt=1.0, walls=(Wall(2, -1, 3.0),), gravity=(1.0, 2.0, 3.0)
        ),
        states=States(**_arrays(States)),
        law="neo-hookean",
        known={"kappa": 1.0},
        poses={
            "NAME": replace(
                stream(4, 4), value=np.tile(np.eye(4), (SIZES["samples"], 1, 1)), noise=1.0
            )
        },
        forces={"NAME": replace(stream(3), noise=1.0)},
        joints=stream(SIZES["joints"]),
        cameras={"NAME": Camera(np.eye(3), np.eye(4), np.zeros(5), (640, 480))},
        geometry={"shape": "box"},
        contact={"z-": "frictionless floor"},
        source="somewhere",
    )
    held = vars(recording)
    missing = [k for k, v in held.items() if v is None or (isinstance(v, dict | str) and not v)]
    if missing:
        raise ValueError(f"full_recording leaves out {', '.join(missing)}")
    return recording


def layout_table() -> str:
    """Every attribute and dataset of a recording's file."""
    says = attributes(Recording) | {
        "form_drake_recording": "Version of this layout.",
        "form_drake": "Version of the program that wrote the file.",
    }
    recording = full_recording()
    words = {n: d for d, n in SIZES.items()}
    places = {f.metadata["place"]: f.name for f in fields(Recording) if f.metadata}
    states = {f.metadata["place"]: attributes(States)[f.name] for f in fields(States)}
    camera = stated(Camera)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "full.h5"
        write_recording(recording, path)
        with h5py.File(path) as file:
            for name, value in sorted(file.attrs.items()):
                field = getattr(recording, name, 1)
                kind = "text" if isinstance(field, str) else "number"
                is_json = isinstance(value, str) and value.startswith("{")
                rows.append((f"attribute `{name}`", "JSON" if is_json else kind, "", says[name]))

            def visit(place: str, item: Any) -> None:
                if not isinstance(item, h5py.Dataset):
                    if "noise" in item.attrs:
                        of_poses = place.startswith("poses")
                        unit, says_of = ("m", POSES) if of_poses else ("as its values", NOISE)
                        rows.append((f"attribute `noise` of `{place}`", "number", unit, says_of))
                    return
                shape = ", ".join(words.get(n, str(n)) for n in item.shape)
                if "dims" in item.attrs:
                    shape = str(item.attrs["dims"]).replace(" ", ", ")
                top, last = place.split("/")[0], place.rsplit("/", 1)[-1]
                unit = str(item.attrs.get("unit", ""))
                if place in places or place in states:
                    meaning = states.get(place) or says[places[place]]
                elif top == "cameras":
                    meaning, unit = attributes(Camera)[last], unit_of(camera[last])
                elif last == "time":
                    meaning, unit = attributes(Stream)["time"], unit_of(stated(Stream)["time"])
                else:
                    meaning, unit = says[top], STREAM_UNITS[top]
                rows.append((f"`{place}`", f"[{shape}]", unit.replace("-", ""), meaning))

            file.visititems(visit)
    return markdown_table(("place", "shape or kind", "unit", "meaning"), rows)


def settings_table(cls: type) -> str:
    """Every setting of a dataclass: default and meaning."""
    rows = []
    for f in fields(cls):
        default = f.default if f.default is not MISSING else f.default_factory
        shown = "required" if default is MISSING else f"`{default}`"
        meaning = stated(cls)[f.name]
        rows.append((f"`{f.name}`", shown, meaning))
    return markdown_table(("setting", "default", "meaning"), rows)


# --- the API page -------------------------------------------------------------------------------
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
    public = f"form_drake.{short}" if hasattr(import_module("form_drake"), short) else name
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
            shown = n.name if "property" in kinds else signature(n, n.name)
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


# --- pages --------------------------------------------------------------------------------------
def pages() -> dict[Path, str]:
    """Every page that the code determines, as it must be."""
    theory, recording = DOCS / "theory.md", DOCS / "recording.md"
    effects, sets = DOCS / "effects.md", DOCS / "sealed.md"
    judged = sets.read_text()
    for name, content in sealed().items():
        judged = marked(judged, name, content)
    layout = marked(recording.read_text(), "layout", layout_table())
    layout = marked(layout, "solver", settings_table(Solver))
    return {
        theory: marked(theory.read_text(), "laws", laws_table()),
        effects: marked(effects.read_text(), "effects", effects_table()),
        sets: judged,
        recording: marked(layout, "walls", settings_table(Wall)),
        DOCS / "api.md": api_page(),
    }


def with_benchmarks(text: str, results: list[dict[str, Any]]) -> str:
    """benchmarks.md with the tables of some results in their places."""
    for result in results:
        name = result.get("bench", "speed" if "job" in result else None)
        if name == "speed" and result["clock"] != "CPU time":
            name = "speed-cuda"
        if name == "probes" and not any(case.startswith("exact/") for case in result["cases"]):
            name = "probes-dx"
        if result.get("method") == "weak":
            name = f"{name}-weak"
        if name not in TABLES:
            raise ValueError(f"bench {name!r}: known are {', '.join(TABLES)}")
        text = marked(text, name, f"\n```text\n{TABLES[name](result)}\n```\n\n")
    return text


def main() -> None:
    """Write the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--benchmarks", nargs="+", type=Path, metavar="FILE", default=[])
    files = parser.parse_args().benchmarks
    written = pages()
    if files:
        page = DOCS / "benchmarks.md"
        results = [json.loads(f.read_text()) for f in files]
        written[page] = with_benchmarks(page.read_text(), results)
    for path, text in written.items():
        path.write_text(text)
        print(f"written: {path}")


if __name__ == "__main__":
    main()
