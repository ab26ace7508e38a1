"""Make what in the documentation follows from the code.

``python docs/make.py`` writes the marked parts of theory.md and recording.md, and api.md;
``python docs/make.py --benchmarks FILE ...`` puts the tables of the JSON files that
``form-drake bench ... --out FILE`` writes into benchmarks.md.
"""

import argparse
import json
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from form_drake.bench import blind_score, blind_table
from form_drake.effects import CATALOGUE
from form_drake.laws import ADDITIONS, LAWS
from form_drake.laws.law import Term
from form_drake.material import derived
from form_drake.records import Solver, Wall
from make_api import api_page
from make_markdown import markdown_table, marked
from make_recording import layout_table, settings_table

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
    "fifth": "fifth/blind.json",
    "sixth": "sixth/blind.json",
}
READ = {  # the last of these: all points, and less
    "sixth": "sixth/blind.json",
    "sixth-press": "sixth/press.json",
    "sixth-faces": "sixth/faces.json",
}


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
    """What verdicts on sealed sets are worth, by set and by what is read, and beside each other."""
    results = {name: worth(DOCS / "blind" / place) for name, place in (SEALED | READ).items()}
    told = {name: f"\n```text\n{blind_table.table(one)}\n```\n\n" for name, one in results.items()}
    beside = {"compared": SEALED, "compared-less": READ}
    return told | {k: compared({n: results[n] for n in names}) for k, names in beside.items()}


def worth(verdicts: Path) -> dict[str, Any]:
    """What verdicts are worth by the key that lies beside them."""
    return blind_score.score(verdicts, *(verdicts.parent / f for f in ("key.json", "key.sha256")))


def compared(results: dict[str, dict[str, Any]]) -> str:
    """What sealed sets are judged by, a column for each; what misses its goal stands out."""
    sets = [{line.name: line for line in blind_table.lines(one)} for one in results.values()]
    goals = {k: line.goal for own in reversed(sets) for k, line in own.items() if line.goal}
    names = dict.fromkeys(name for own in sets for name in own if name in goals)
    rows = [
        (name, goals[name], *(_cell(own.get(name), goals[name]) for own in sets)) for name in names
    ]
    return markdown_table(("", "goal", *results), rows)


def _cell(line: blind_table.Line | None, goal: str) -> str:
    """What was reached, beside its own goal where that is another."""
    if line is None:
        return ""
    told = " ".join(line.told.split()) + (f" ({line.goal})" if line.goal not in ("", goal) else "")
    return f"**{told}**" if line.met is False else told


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
