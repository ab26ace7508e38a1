"""Sums of laws, and laws from files: stresses that add up, names, and what is refused."""

from dataclasses import replace
from functools import reduce
from itertools import permutations, product
from operator import add
from pathlib import Path

import numpy as np
import pytest

from form_drake.commands.inspect import List
from form_drake.identify.columns import Columns
from form_drake.laws import KAPPA, LAWS, Constant, law_named, load
from form_drake.laws.elastic import GENT, MOONEY_RIVLIN, YEOH, first_invariant, linear_volume
from form_drake.laws.flow import BINGHAM, granular_pressure, viscous
from form_drake.laws.values import checked_values
from form_drake.material import Material, derived, read_material
from form_drake.mpm.simulation import Body, Simulation
from helpers.laws import (
    EYE,
    derivative,
    ended,
    gradients_of,
    invariants,
    oracle_solver,
    relative,
    stored,
    stored_state,
    volumetric,
)

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "gent_thomas.py"
ADDABLE = [
    (a, b)
    for a, b in permutations(LAWS, 2)
    if LAWS[a].flow == LAWS[b].flow and LAWS[a].flow in ("elastic", "fluid")
]
SHARED = {first_invariant, linear_volume, viscous}  # responses that more than one law declares


def single_values(law, seed=0):
    """Positive values of the size that keeps Gent's stress finite."""
    rng = np.random.default_rng([seed, *law.name.encode()])
    return {k: rng.uniform(0.5, 2.0) + 20.0 * k.endswith("J_m") for k in law.keys}


def values_of_sum(laws, each):
    """Values of the sum at given values of its summands; where terms coincide they add up."""
    values, columns = {}, {}
    for law, own in zip(laws, each, strict=True):
        taken = set(values)
        for p in law.parameters:
            response = getattr(p, "response", None)
            if response in columns:
                values[columns[response]] += own[p.key]
                continue
            key = f"{law.name}.{p.key}" if p.key in taken else p.key
            values[key] = own[p.key]
            if response in SHARED:
                columns[response] = key
    return values


def assert_sum(laws):
    law, each = reduce(add, laws), [single_values(one) for one in laws]
    values = values_of_sum(laws, each)
    assert law.keys == tuple(values)
    F, L = gradients_of(law.name)
    tau = ended(law, values, F, L)[1]
    summed = sum(ended(one, own, F, L)[1] for one, own in zip(laws, each, strict=True))
    assert relative(tau, summed) < 1e-12
    moduli = [one.moduli(own) for one, own in zip(laws, each, strict=True)]
    assert law.moduli(values) == pytest.approx(np.sum(moduli, axis=0), rel=1e-14)


@pytest.mark.parametrize("names", ADDABLE, ids="+".join)
def test_the_stress_of_a_sum_is_the_sum_of_stresses(names):
    assert_sum([LAWS[name] for name in names])


def test_three_laws_are_added_in_any_order_of_brackets():
    laws = [YEOH, GENT, MOONEY_RIVLIN]
    assert_sum(laws)
    law = law_named("yeoh+gent+mooney-rivlin")
    assert law is (YEOH + GENT) + MOONEY_RIVLIN is YEOH + (GENT + MOONEY_RIVLIN)
    assert law is law_named(" yeoh + gent + mooney-rivlin ") and law.summands == tuple(laws)
    assert law.wave_speed(values_of_sum(laws, map(single_values, laws)), 1000.0) > 0


@pytest.mark.parametrize(
    "name, keys, sought",
    [
        ("yeoh+gent", "C1 C2 C3 kappa mu J_m", "C1 C2 C3 kappa mu J_m"),
        ("neo-hookean+yeoh", "C10 kappa C2 C3", "C10 kappa C2 C3"),
        ("yeoh+neo-hookean", "C1 C2 C3 kappa", "C1 C2 C3 kappa"),
        ("fixed-corotated+gent", "mu lam gent.mu J_m", "mu lam gent.mu J_m"),
        ("newtonian+bingham", "eta kappa tau_y epsilon", "eta tau_y epsilon"),
        ("newtonian+weakly-compressible", "eta kappa", "eta kappa"),
    ],
)
def test_names_in_a_sum(name, keys, sought):
    law = law_named(name)
    assert " ".join(law.keys) == keys and " ".join(law.sought) == sought
    assert all(law.parameter(k).excited for k in law.keys)


def test_a_merged_parameter_is_signed_if_one_is():
    assert law_named("yeoh+fixed-corotated").parameter("kappa").signed
    assert law_named("fixed-corotated+yeoh").parameter("lam").signed
    assert not law_named("yeoh+gent").parameter("kappa").signed


def test_the_equation_of_a_sum_counts_nothing_twice():
    law = law_named("fixed-corotated+gent")
    shear = "gent.mu / (1 - (I1 - 3) / J_m) dev b"
    assert law.equation == f"2 mu (F - R) F^T + lam J (J - 1) I + {shear}"
    assert law_named("neo-hookean+mooney-rivlin").equation.endswith(
        " + 2 dev[0 b + C01 (I1 b - b b)]"
    )


@pytest.mark.parametrize("law", [GENT, BINGHAM], ids=lambda law: law.name)
def test_every_summand_reads_its_own_constants(law):
    laws = [law] + [replace(law, name=f"{law.name}-{n}") for n in (2, 3, 4)]
    assert_sum(laws)
    with pytest.raises(ValueError, match=r"has 5 constants .*: a law or a sum of laws may have 4"):
        reduce(add, [*laws, replace(law, name="fifth")])


@pytest.mark.parametrize("names", sorted(set(product(LAWS, LAWS)) - set(ADDABLE)), ids="+".join)
def test_impossible_sums_are_refused(names):
    first, second = names
    reason = "added to itself" if first == second else "only elastic laws may be added"
    with pytest.raises(ValueError, match=reason) as caught:
        law_named("+".join(names))
    assert "\n" not in str(caught.value) and first in str(caught.value)


def test_other_sums_are_refused():
    with pytest.raises(ValueError, match="unknown law 'rubber': choose one of neo-hookean"):
        law_named("yeoh+rubber")
    with pytest.raises(ValueError, match="read no pressure"):
        BINGHAM + replace(LAWS["newtonian"], name="dry", pressure=granular_pressure)
    with pytest.raises(TypeError):
        YEOH + 1


def test_columns_of_a_sum_are_those_that_the_solver_obeys():
    laws = [YEOH, GENT, replace(GENT, name="second")]
    law, data = reduce(add, laws), stored("neo-hookean")[0]
    # a tenth of the stiffness for which the oracle's time step was chosen
    scaled = [{k: v * 1e3 for k, v in single_values(one).items()} for one in laws]
    values = values_of_sum(laws, scaled) | {"J_m": 20.0, "second.J_m": 5.0}
    solver = oracle_solver("neo-hookean")
    sim = Simulation(solver, law, Body(data["x0"], data["volume"], float(data["density"])))
    sim.set_material(values)
    start = stored_state("neo-hookean", 0)
    sim.reset(start.x, start.v, C=start.C, L=start.L, F=start.F)
    one = sim.state()
    sim.step()
    columns = Columns(solver, law, float(data["density"]) * data["volume"], data["volume"])
    A, b, free = columns.rows(one.x, one.v, one.C, one.L, one.F, sim.state().v, values)
    assert free.sum() > 100
    assert relative((A @ law.theta(values))[free], b[free]) < 1e-10


def test_material_of_a_sum(tmp_path):
    law = law_named("fixed-corotated+gent")
    values = {"mu": 1e4, "lam": 2e4, "gent.mu": 3e4, "J_m": 7.0}
    keys, covariance = ("mu", "gent.mu"), np.array([[4.0, 1.0], [1.0, 9.0]])
    Material(law, values, 900.0, keys, covariance).write(tmp_path / "m.yaml")
    assert "law: fixed-corotated+gent" in (tmp_path / "m.yaml").read_text()
    back = read_material(tmp_path / "m.yaml")
    assert back.law is law and back.values == values and back.keys == keys
    assert np.array_equal(back.covariance, covariance)
    shown = back.parameters()
    assert shown["gent.mu"].std == pytest.approx(3.0)
    assert shown["K"].value == pytest.approx(2e4 + 2e4 / 3)
    assert shown["E"].value == pytest.approx(9 * 8e4 / 3 * 4e4 / (8e4 + 4e4))
    assert back.changed({"gent.mu": "5e4"}).values["gent.mu"] == 5e4


def test_young_modulus_is_no_input_of_a_sum():
    known = {"E": 1e4, "nu": 0.3}
    assert set(checked_values(LAWS["fixed-corotated"], known)) == {"mu", "lam"}
    with pytest.raises(ValueError, match="has no parameter 'E'"):
        checked_values(law_named("fixed-corotated+gent"), known)
    assert checked_values(law_named("yeoh+gent"), {"kappa": "3"}) == {"kappa": 3.0}


def test_list_laws_says_that_they_may_be_added(capsys):
    List("laws").run()
    assert "yeoh+gent" in capsys.readouterr().err
    List("laws", json=True).run()
    assert capsys.readouterr().err == ""


def test_a_law_from_a_file():
    (law,) = load(EXAMPLE)
    assert law is law_named("gent-thomas") and len(EXAMPLE.read_text().splitlines()) <= 25
    values = {"C2": 3e4, "kappa": 2e5}
    F, L = gradients_of("gent-thomas")

    def energy(F):
        return values["C2"] * np.log(invariants(F)[1] / 3) + volumetric(F, values["kappa"])

    tau = derivative(energy, F, 1e-5) @ F.transpose(0, 2, 1)
    assert relative(ended(law, values, F, L)[1], tau) < 1e-8
    K, G = law.moduli(values)
    h = 1e-6
    small = EYE + h * np.array([np.eye(3), [[0, 1, 0], [0, 0, 0], [0, 0, 0]]])
    strained = ended(law, values, small, np.zeros_like(small))[1]
    assert np.trace(strained[0]) / 3 == pytest.approx(3 * K * h, rel=1e-4)
    assert strained[1][0, 1] == pytest.approx(G * h, rel=1e-4)


def test_a_law_from_a_file_can_be_added():
    (law,) = load(EXAMPLE)
    assert law_named("yeoh+gent-thomas").keys == ("C1", "C2", "C3", "kappa", "gent-thomas.C2")
    assert_sum([LAWS["neo-hookean"], law])
    (again,) = load(EXAMPLE)
    assert again is not law and law_named("gent-thomas") is again
    assert_sum([again, GENT])


HEAD = """from form_drake.laws import KAPPA, LAWS, Constant, Law, Term
def made(name="own", parameters=(KAPPA,), moduli=lambda v: (v["kappa"], 0.0), **more):
    return Law(name=name, parameters=parameters, moduli=moduli, equation="", **more)
"""
RESPONSE = """from typing import Any
import warp as wp
@wp.func
def own_response({}):
    return {}
law = made(parameters=(Term("A", "Pa", own_response), KAPPA))
"""
WRONG_FILES = {
    "syntax": ("law = (", r"own.py, line 4: '\(' was never closed"),
    "failing": ("1 / 0", "own.py, line 4: ZeroDivisionError: division by zero"),
    "inside": ("law = made(needs=frozenset({'speed'}))", "line 3: ValueError: own: needs may hold"),
    "no law": ("LAWS['yeoh'] + LAWS['gent']", "declares no law"),
    "only known laws": ("law = LAWS['yeoh']", "declares no law"),
    "taken": ("law = made('gent')", "law 'gent': the name is taken by a law of this package"),
    "twice": ("a, b = made(), made()", "two laws of this name"),
    "plus": ("law = made('my+law')", "lower-case words joined by hyphens"),
    "upper case": ("law = made('Own')", "lower-case words joined by hyphens"),
    "key": ("law = made(parameters=(KAPPA, Constant('a.b', '-', 'shape')))", "parameter 'a.b'"),
    "keys": ("law = made(parameters=(KAPPA, KAPPA))", "two parameters have one name"),
    "stressless": ("law = made(parameters=())", "it has no Term"),
    "function": ("law = made(parameters=(Term('a', 'Pa', made),))", "put @wp.func before it"),
    "flow": ("law = made(flow='gas')", "flow 'gas': choose elastic"),
    "plastic": ("law = made(flow='plastic')", "a plastic law needs radius"),
    "moduli": ("law = made(moduli=lambda v: (v['K'], 0.0))", "moduli fails .*: KeyError: 'K'"),
    "nan": ("law = made(moduli=lambda v: (float('nan'), 0.0))", "moduli gives nan and 0.0"),
    "viscosity": (
        "law = made(parameters=(KAPPA, LAWS['newtonian'].parameter('eta')))",
        "a law with a viscosity must state it",
    ),
    "binary": ("\0", "own.py"),
    "rotation": (
        RESPONSE.format("q: Any, s: Any", "q.R"),
        r"read q.R: state needs=frozenset\(\['rotation'",
    ),
    "strain": (
        RESPONSE.format("q: Any, s: Any", "q.e"),
        r"read q.e: state needs=frozenset\(\['strain'",
    ),
    "rate": (
        RESPONSE.format("q: Any, s: Any", "q.L"),
        r"read q.L: state needs=frozenset\(\['rate'",
    ),
    "pressure": (RESPONSE.format("q: Any, s: Any", "q.p * q.F"), "read q.p: state a pressure"),
    "scalar": (
        RESPONSE.format("q: Any, s: Any", "q.J"),
        "to a matrix of 3 by 3, cannot be built: .*types",
    ),
    "argument": (RESPONSE.format("q: Any", "q.F"), r"each from \(q, s\) to .*for 'own_response'"),
    "endless": (
        RESPONSE.format("q: Any, s: Any", "q.F / (q.J - type(q.J)(1.0))"),
        "not finite at rest",
    ),
}


@pytest.mark.parametrize("name", WRONG_FILES)
def test_wrong_files_of_laws_are_refused(tmp_path, name):
    text, message = WRONG_FILES[name]
    (tmp_path / "own.py").write_text(HEAD + text)
    with pytest.raises(ValueError, match=message) as caught:
        load(tmp_path / "own.py")
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["own.py"]
    with pytest.raises(ValueError, match="unknown law"):
        law_named("own")


def test_names_of_own_laws(tmp_path):
    for file in ("a.py", "b.py"):
        (tmp_path / file).write_text(HEAD + "law = made('mine')")
    with pytest.raises(ValueError, match="No such file"):
        load(tmp_path / "c.py")
    with pytest.raises(ValueError, match="Is a directory"):
        load(tmp_path)
    load(tmp_path / "a.py")
    assert law_named("mine").keys == ("kappa",) and "mine" not in LAWS
    with pytest.raises(ValueError, match=r"'mine': the name is taken by .*a\.py"):
        load(tmp_path / "b.py")
    (tmp_path / "a.py").write_text(HEAD + "law = made('other')")
    load(tmp_path / "a.py")
    assert law_named("other")
    with pytest.raises(ValueError, match="unknown law 'mine'"):
        law_named("mine")


def test_a_law_that_reads_pressure_reads_it_in_a_sum(tmp_path):
    text = """import warp as wp
from typing import Any
@wp.func
def friction(q: Any, s: Any):
    return q.p * wp.identity(n=3, dtype=q.F.dtype)
@wp.func
def squeeze(J: Any):
    return wp.max(type(J)(1.0) - J, type(J)(0.0))
law = made("dusty", parameters=(Term("m", "-", friction, guess=(0.1,)), KAPPA), pressure=squeeze)
"""
    (tmp_path / "own.py").write_text(HEAD + text)
    (law,) = load(tmp_path / "own.py")
    values, F = {"m": 5.0, "kappa": 1e4}, np.diag([0.9, 0.9, 0.9])[None]
    L = np.zeros_like(F)
    alone = ended(law, values, F, L)[1]
    (J,) = np.linalg.det(F)
    assert alone[0] == pytest.approx((5e4 * (1 - J) - 1e4 * J * (1 - J)) * np.eye(3))
    total = ended(law_named("damping+dusty"), values | {"eta": 3.0}, F, L)[1]
    assert total == pytest.approx(alone)


def test_names_of_own_parameters_mean_nothing_to_the_package():
    shape = Constant("alpha", "-", "shape", guess=(2.0,))
    own = replace(GENT, name="own", parameters=(GENT.parameter("mu"), shape, KAPPA))
    values = {"mu": 1e3, "alpha": 2.0, "kappa": 1e5}
    assert checked_values(own, values) == values
    assert list(derived(own)) == ["E", "nu"]
    sand = law_named("drucker-prager+damping")
    assert {"E", "nu", "K", "friction_angle"} == set(derived(sand))
    with pytest.raises(ValueError, match="alpha: must be below sqrt"):
        checked_values(sand, {"alpha": 0.9})
