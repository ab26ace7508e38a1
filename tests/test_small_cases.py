"""Two dozen small cases of an independent solver, half of them on a block that a bonded plate presses.

They share a specimen by plate, so its twin and its columns are made once, at its true moduli; which
effect stands out is told case by case.
"""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from form_drake.bench.blind_score import right
from form_drake.bench.oracles import recorded
from form_drake.diagnose import Model, Scenes
from form_drake.diagnose.columns import rest_of
from form_drake.diagnose.match import Match
from form_drake.diagnose.prepare import read
from form_drake.diagnose.race import FIELD
from form_drake.diagnose.verdict import judged
from form_drake.effects import CATALOGUE
from form_drake.identify import identify
from form_drake.identify.scene import twin_problem
from form_drake.laws import LAWS

DATA = Path(__file__).parent / "data" / "hidden"
LOST = {"loose": "hidden-wall", "bonded": "crack"}  # not in the catalogue
FAINT = {"loose": ("drag", "floor-slip"), "bonded": ()}  # for so short a shake
sys.path.insert(0, str(Path(__file__).parent / "oracles"))
small = importlib.import_module("hidden_effects_small")


def recordings(name, folder):
    """A case with its noise."""
    small.unpacked(DATA / f"{name}.npz", folder)
    return tuple(recorded(folder / probe) for probe in ("press", "shake"))


@pytest.mark.parametrize("plate", ["loose", "bonded"])
def test_what_is_hidden_stands_out_and_nothing_where_nothing_is(plate, tmp_path):
    body = small.drawn(plate, "null")["body"]
    E, nu = body["E"], body["nu"]
    model = Model(LAWS["neo-hookean"], {"C10": E / 4 / (1 + nu), "kappa": E / 3 / (1 - 2 * nu)})
    null = recordings(f"{plate}-null", tmp_path)
    scenes = Scenes.of(null)
    problem, _ = read(scenes, model.law, {})
    match = Match.of(problem, scenes, model).anchored()
    eta, theta = match.twin.coordinates(model.values)
    plain = rest_of(match.problem.rows(eta, theta), theta)
    scored = dict[str, list[str]]()
    for name in (name for state, name in small.CASES if state == plate):
        data = recordings(f"{plate}-{name}", tmp_path)
        other = twin_problem(match.problem, null, lambda _, own=data: list(own), dict(model.values))
        change = rest_of(other.rows(eta, theta), theta) - plain
        found = judged(match.seen_by(match.by, match.apart + change), list(CATALOGUE.values()), {})
        scored[name] = [s.effect.id for s in found.seen]
    assert not scored.pop("null")
    lost = scored.pop(LOST[plate])
    assert bool(lost) is (plate == "loose")  # the crack is not felt
    for name in FAINT[plate]:
        assert not scored.pop(name)
    for name, seen in scored.items():
        assert name in seen[:FIELD], f"{name}: {seen}"  # so that its simulation decides
    first = [name for name, seen in scored.items() if right(name, {"name": seen[0], "class": []})]
    assert len(first) >= len(scored) - 1, scored  # the other when it is simulated


@pytest.mark.parametrize(
    ("name", "by"), [("bonded-hardening", "read"), ("bonded-null", "fit"), ("loose-null", "fit")]
)
def test_forces_of_the_other_sign_are_refused(name, by, tmp_path):
    """Also where rows of the interior leave a stiffness that is no more than small."""
    press, _ = recordings(name, tmp_path)
    forces = {k: replace(f, value=-f.value) for k, f in press.forces.items()}
    turned = replace(press, forces=forces)
    with pytest.raises(ValueError, match="those of a body with the other sign"):
        if by == "read":
            read(Scenes.of((turned,)), LAWS["neo-hookean"], {})
        else:
            identify(turned)
