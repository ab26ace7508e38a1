"""Which effect is added: what simulations say of those that columns point at."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from form_drake.diagnose import race, search, verdict
from form_drake.diagnose.columns import Columns
from form_drake.diagnose.match import Match
from form_drake.diagnose.model import Cause, Model, firm
from form_drake.diagnose.score import Score, shapes
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.weak.unknowns import Unknowns


def test_shapes_that_are_sizes_stay_positive_in_differences():
    cause = Cause(CATALOGUE["hardening"], 0.5, {"growth": 0.02, "strain": 0.02})
    keys = list(cause.effect.shapes)
    ends = dict(zip(keys, cause.ends.tolist(), strict=True))
    assert ends["growth"] == pytest.approx([0.01, 0.03])
    assert 0.0 < ends["strain"][0] < 0.02 < ends["strain"][1]
    (turned,) = Cause(CATALOGUE["gravity-tilt"], 0.1, {"azimuth": 0.0}).ends
    assert turned == pytest.approx([-np.radians(9.0), np.radians(9.0)])  # an angle may pass zero
    stuck = Cause(CATALOGUE["floor-slip"], 1e-8, {"slippery": 0.0})  # no less than that
    ((low, high),) = stuck.ends
    assert low == 0.0 < high and stuck.beside == [{"slippery": s} for s in (0.0, low, high)]


def test_a_size_is_no_surer_than_its_simulation():
    shape = {"x": 0.0, "y": 0.0, "z": 0.0, "radius": 1e-3}
    spread = {"x": 1e-4, "radius": 1.5e-5}
    cause = Cause(CATALOGUE["inclusion"], 2.0, shape).known(0.03, spread)
    assert cause.told == pytest.approx(0.05) and cause.least == 0.03  # and 2 % of 2
    assert cause.spread == {"x": 1e-4, "radius": pytest.approx(2.5e-5)}
    assert Cause(CATALOGUE["inclusion"], 2.0, shape).known(np.inf, {}).told is None


def test_more_of_a_cause_is_one_cause_where_its_shape_is_the_same():
    plain = Model(LAWS["neo-hookean"], {"C10": 1.0, "kappa": 2.0})
    slip = CATALOGUE["floor-slip"]
    twice = plain.more(slip, 1e-8, {"slippery": 0.0}).more(slip, 2e-8, {"slippery": 0.0})
    assert [c.coefficient for c in twice.causes] == [pytest.approx(3e-8)]
    at = {"x": 0.0, "y": 0.0, "z": 0.0, "radius": 1e-3}
    mass = CATALOGUE["added-mass"]
    both = plain.more(mass, 1e-3, at).more(mass, 2e-3, {**at, "x": 1e-3})
    assert [c.coefficient for c in both.causes] == [1e-3, 2e-3]


def test_a_law_is_kept_firm():
    law = LAWS["neo-hookean"]  # bulk modulus kappa, shear modulus 2 C10
    assert firm(law, {"C10": 6.0, "kappa": 1.0}) == {"C10": 6.0, "kappa": pytest.approx(8.0)}
    assert firm(law, {"C10": 6.0, "kappa": 9.0}) == {"C10": 6.0, "kappa": 9.0}
    assert firm(law, {"C10": 6.0, "kappa": 1.0}, known=["kappa"])["kappa"] == 1.0
    found = firm(LAWS["fixed-corotated"], {"mu": 3.0, "lam": -1.0})
    assert found == {"mu": 3.0, "lam": pytest.approx(0.0)}


def test_what_no_row_sees_is_neither_projected_off_nor_told():
    """The radius of a point mass: its column is zero."""
    shape = {"x": 0.0, "y": 0.0, "z": 0.0, "radius": 1e-3}
    cause = Cause(CATALOGUE["added-mass"], 1e-3, shape)
    match = object.__new__(Match)
    values = {"C10": 1.0, "kappa": 2.0}
    object.__setattr__(match, "model", Model(LAWS["neo-hookean"], values, (cause,)))
    match.__dict__["explained"] = np.hstack([2.0 * np.eye(8)[:, :6], np.zeros((8, 1))])
    valued = lambda d: {"C10": 1.0 + d[0] + 2.0 * d[1], "kappa": 2.0 * np.exp(d[1])}  # noqa: E731
    object.__setattr__(match, "valued", valued)
    assert match.off(np.eye(8)) == pytest.approx(np.diag([0.0] * 6 + [1.0] * 2))
    (told,) = match.told.causes
    assert told.least == 0.5 and told.spread == {key: 0.5 for key in "xyz"}
    assert match.told.keys == ("C10", "kappa")
    wanted = [[5.0 / 4.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0 / 4.0]]  # unknowns have 1/4
    assert match.told.covariance == pytest.approx(np.array(wanted), abs=1e-6)
    (kept,) = match.told.material(1000.0).effects
    assert kept.std == told.told


def test_a_written_law_tells_how_well_its_values_are_known():
    law, values = LAWS["neo-hookean"], {"C10": 8e3, "kappa": 4e4}
    causes = tuple(
        Cause(CATALOGUE[name], size, shape).known(std, {})
        for name, size, shape, std in (
            ("drag", 20.0, {}, 2.0),
            ("damping", 50.0, {}, 3.0),
            ("rate-dependence", 9.0, {"n": 0.5}, np.inf),
        )
    )
    covariance = np.diag([1e4, 4e4, 4.0, 9.0, 0.0])
    covariance[0, 3] = covariance[3, 0] = 150.0
    model = Model(law, values, causes, ("C10", "kappa"), covariance)
    made = model.material(1000.0)
    assert made.keys == ("C10", "kappa", "eta")  # of the power nothing is told
    wanted = [[1e4, 0.0, 150.0], [0.0, 4e4, 0.0], [150.0, 0.0, 10.0]]  # 9, and (2 % of 50)^2
    assert made.covariance == pytest.approx(np.array(wanted))
    assert made.parameters()["eta"].std == pytest.approx(causes[1].told)
    assert model.without(causes[0]).material(1000.0).keys == ()  # another model's


def test_what_no_row_sees_is_left_where_it_is():
    """As the strength of what holds a plate that never lets go."""
    columns = np.array([[2.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    wanted = search._least(columns, np.array([4.0, 1.0, 3.0]))
    assert wanted == pytest.approx([11.0 / 5.0, 0.0], abs=1e-12) and wanted[1] == 0.0


def test_where_a_bound_cuts_one_unknown_the_others_are_sought_beside_it():
    """Two columns that are much alike, and a share that is all of the stress already: it is 1 at most."""
    share = Cause(CATALOGUE["yield"], 0.9, {"strain": 0.02})
    match = SimpleNamespace(within=lambda d: np.clip(d, -9.0, 9.0), parts=[1])
    match.model = SimpleNamespace(causes=(share,))
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((40, 2)) @ [[1.0, 0.9], [0.0, 0.3]]
    columns = np.hstack([columns, np.zeros((40, 1))])  # of the strain
    match.gap = columns @ [2.0, 0.5, 0.0] + 0.1 * rng.standard_normal(40)
    change = race.Search(match, np.zeros((40, 3)))._change(0.0, columns)
    best = lsq_linear(columns[:, :2], match.gap, ([-9.0, -9.0], [9.0, 0.1]))
    assert change[:2] == pytest.approx(best.x) and change[1] == pytest.approx(0.1)
    match.within = lambda d: np.clip(d, -9.0, 1.5)  # and the other way round
    match.gap = columns @ [2.0, -0.123, 0.0] + 0.1 * rng.standard_normal(40)
    other = lsq_linear(columns[:, :2], match.gap, ([-9.0, -9.0], [1.5, 0.1]))
    found = race.Search(match, np.zeros((40, 3)))._change(0.0, columns)
    assert found[:2] == pytest.approx(other.x) and found[0] == pytest.approx(1.5)
    match.gap = columns @ [2.0, 0.5, 0.0] + 0.1 * rng.standard_normal(40)
    alone = np.linalg.lstsq(columns[:, :2], match.gap, rcond=None)[0]
    assert (
        abs(alone[0] - best.x[0]) > 0.1
    )  # cut alone, it would leave the other where it is not best


def test_a_floor_that_slides_already_takes_another_friction_as_a_whole():
    slip = Cause(CATALOGUE["floor-slip"], 2e-7, {"slippery": 3.0})
    columns = object.__new__(Columns)
    object.__setattr__(
        columns, "model", Model(LAWS["neo-hookean"], {"C10": 1.0, "kappa": 2.0}, (slip,))
    )
    size, model = columns._more(slip.effect, {"slippery": 4.0})
    assert size == 2e-7
    (other,) = model.causes
    assert other.coefficient == 2e-7 and other.shape == {"slippery": 4.0}


def test_a_change_of_unknowns_is_told_by_the_model_that_it_gives():
    law, values = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 1e3}
    cause = Cause(CATALOGUE["relaxation"], 0.8, {"time": 0.1})
    unknowns, match = Unknowns.of(law, {}, "law"), object.__new__(Match)
    theta = lambda v: (np.zeros(0), np.array([v["mu"], v["lam"]]))  # noqa: E731
    object.__setattr__(match, "model", Model(law, values, (cause,)))
    object.__setattr__(match, "twin", SimpleNamespace(coordinates=theta))
    object.__setattr__(match, "problem", SimpleNamespace(unknowns=unknowns, values=lambda eta: {}))
    match.__dict__["explained"] = np.eye(4)
    asked = np.array([1e3, 2e3, 0.1, 0.02])
    model = race.Search(match, np.zeros((4, 4))).model(asked)
    assert match.towards(model) == pytest.approx(asked)
    model = race.Search(match, np.zeros((4, 4))).model(np.array([1e3, -2e3, 0.5, 0.0]))
    assert match.towards(model) == pytest.approx([1e3, -1e3, 0.2, 0.0])  # it is kept firm and whole


def test_a_modulus_that_may_be_negative_passes_zero():
    law = LAWS["mooney-rivlin"]
    match, unknowns = object.__new__(Match), Unknowns.of(law, {}, "law")
    values = dict.fromkeys(law.keys, 4e3) | {"C01": 100.0}
    theta = np.array([values[t.key] for t in law.terms])
    object.__setattr__(match, "model", Model(law, values))
    object.__setattr__(match, "twin", SimpleNamespace(coordinates=lambda v: (np.zeros(0), theta)))
    object.__setattr__(match, "problem", SimpleNamespace(unknowns=unknowns))
    found = dict(zip(unknowns.keys, match.within(np.full(len(theta), -9e3)), strict=True))
    assert found["C01"] == pytest.approx(-400.0)  # a tenth of the largest
    assert found["C10"] == pytest.approx(-2e3)  # which stays positive, is halved at most


def test_no_size_goes_far_at_once():
    adhesion = CATALOGUE["adhesion"]  # likely up to 1e5 Pa
    assert adhesion.bounded(1e85, 300.0) == 1e6 and adhesion.bounded(1e85, 1e6) == 1e7
    assert adhesion.bounded(-5.0, 300.0) == 150.0
    assert CATALOGUE["force-gain"].bounded(-0.4) == -0.4


def test_floors_slide_by_a_friction_that_there_can_be():
    slip = Cause(CATALOGUE["floor-slip"], 1e-8, {"slippery": 2.0})
    assert slip.within(np.array([0.0, -9.0]))[1] == -2.0
    assert slip.within(np.array([0.0, -1.0]))[1] == -1.0
    with pytest.raises(ValueError, match=r"slippery must be 0 or more, got -2[.]5"):
        slip.effect.check(1e-8, {"slippery": -2.5})


def score(name, size, **shape):
    column = np.zeros(4)
    column[len(name) % 4] = 1.0
    return Score(CATALOGUE[name], shape, 1.0, size, 0.5, column)


class Fake:
    """A search whose gap's square goes down along a list; None: the simulation breaks down.

    ``left`` is what a last step would leave of it; None: all.
    """

    def __init__(self, squares, left=None):
        self.squares, self.left = squares, left
        gap, left = np.array([np.sqrt(squares[0])]), squares[0] if left is None else left
        self.match = SimpleNamespace(gap=gap, excess=squares[0], excess_left=left)
        self.settled = len(squares) == 1
        self.lighter = self

    def stepped(self):
        if self.squares[1] is None:
            raise ValueError("it broke down")
        return Fake(self.squares[1:], self.left)


@pytest.fixture
def course(monkeypatch):
    """Searches by what is tried."""
    ways = {}

    def near(tried):
        if ways[tried] is None:
            raise ValueError("it broke down")
        return ways[tried]

    monkeypatch.setattr(race.Search, "of", staticmethod(Fake))
    more = SimpleNamespace(more=lambda effect, size, shape: (effect.id, *shape.values()))
    match = SimpleNamespace(model=more, near=near)
    match.on = lambda coarser: match
    return match, ways


def test_the_nearest_simulation_wins_whatever_the_scores_say(course):
    match, ways = course
    ways |= {("drag",): [900.0, 800.0, 790.0], ("damping",): [950.0, 400.0, 100.0, 20.0]}
    seen = [score("drag", 500.0), score("damping", 400.0), score("density", 20.0)]
    (only,) = race.raced(match, seen)  # density explains too little to be tried
    assert only.score.effect.id == "damping" and only.apart == pytest.approx(20.0)
    ways |= {("drag",): [900.0, 28.0], ("damping",): [950.0, 30.0, 25.0, 20.0]}
    near, other = race.raced(match, seen)  # what is as near stays
    assert [r.score.effect.id for r in (near, other)] == ["damping", "drag"]


def test_what_promises_most_runs_on_where_a_first_step_goes_too_far(course, monkeypatch):
    match, ways = course
    ways |= {
        ("drag",): Fake([900.0, 400.0, 300.0]),
        ("damping",): Fake([900.0, 950.0, 100.0, 20.0], left=10.0),
        ("density",): Fake([900.0, 500.0, 490.0]),
    }
    monkeypatch.setattr(race.Search, "of", staticmethod(lambda search: search))
    found = race.raced(
        match, [score("drag", 500.0), score("damping", 490.0), score("density", 480.0)]
    )
    assert found[0].score.effect.id == "damping" and found[0].apart == pytest.approx(20.0)
    assert "density" not in [runner.score.effect.id for runner in found]


def test_what_lets_go_of_a_face_is_tried_wherever_it_is_seen(course):
    match, ways = course
    ways |= {("density",): [900.0, 800.0, 790.0], ("adhesion",): [950.0, 20.0]}
    seen = [score("density", 500.0), score("damping", 60.0), score("adhesion", 30.0)]
    (only,) = race.raced(match, seen)  # damping, as faint, is linear: it is not tried
    assert only.score.effect.id == "adhesion" and only.apart == pytest.approx(20.0)


def test_one_of_each_class_is_tried(course):
    match, ways = course
    ways |= {("drag",): [900.0, 30.0]}
    twin = replace(score("damping", 490.0), column=score("drag", 1.0).column)
    (only,) = race.raced(match, [score("drag", 500.0), twin])
    assert only.score.effect.id == "drag"


@pytest.mark.parametrize(("less", "tried"), [(3.9, "damping"), (4.1, "rate-dependence")])
def test_of_effects_that_are_alike_the_plainer_is_tried_unless_it_scores_less(less, tried):
    """A power of the rate that is near one is damping."""
    power = replace(score("rate-dependence", 1000.0, n=0.9), column=np.eye(4)[0])
    plain = replace(score("damping", 1000.0 - less), column=np.eye(4)[0])
    other = replace(score("drag", 900.0), column=np.eye(4)[1])
    assert [s.effect.id for s in race.field([power, plain, other])] == [tried, "drag"]


def test_a_further_effect_explains_more_than_simulations_have_wrong():
    found = verdict.Found(SimpleNamespace(), (), doubt=verdict.WRONG**2 * 1e5)
    drag = CATALOGUE["drag"]
    assert found.wanted(drag, {}) == pytest.approx(640.0)
    assert found.wanted(drag, {"drag": 700.0}) == 700.0
    assert replace(found, doubt=0.0).wanted(drag, {}) == verdict.LEAST


def seen_at(monkeypatch, peaks):
    """Inclusions in a body of 40 mm, whose scores fall away from places: x [mm], size, highest score."""

    def ranked(match, effect, tried):
        every = []
        for shape in tried:
            place = 1e3 * np.array([shape[k] for k in "xyz"])
            values = [
                (highest * np.exp(-np.sum((place - [x, 0.0, 0.0]) ** 2) / 50.0), size)
                for x, size, highest in peaks
            ]
            value, size = max(values)
            every.append(replace(score("inclusion", value, **shape), coefficient=size))
        return sorted(every, key=lambda s: -s.score)

    monkeypatch.setattr(race, "ranked", ranked)
    edge = np.array([0.02, 0.02, 0.02])
    bodies = [SimpleNamespace(low=-edge, high=edge)]
    every = ranked(None, CATALOGUE["inclusion"], shapes(CATALOGUE["inclusion"], bodies[0]))
    return bodies, every[0]


@pytest.mark.parametrize(("other", "tried"), [(-1.0, True), (1.0, False)])
def test_a_place_is_sought_closer_for_either_sign(course, monkeypatch, other, tried):
    """What is stiffer in one place is like what is softer in another, where it may score more.

    Between the places of a grid the right one scores too little to be tried.
    """
    match, _ = course
    match.bodies, best = seen_at(monkeypatch, [(-8.0, 1.0, 1000.0), (4.0, other, 700.0)])
    ways, starts = {-8.0: [900.0, 800.0, 790.0], 4.0: [950.0, 100.0]}, []

    def near(told):
        starts.append(1e3 * told[1])
        return ways[min(ways, key=lambda x: abs(x - starts[-1]))]

    match.near = near
    (only,) = race.raced(match, [best], nearly=0.65)
    assert len(starts) == 1 + tried and only.apart == (100.0 if tried else 790.0)
    assert starts[-1] == pytest.approx(4.0 if tried else -8.0, abs=1.0)


def test_a_place_that_is_sought_closer_keeps_off_faces_and_scores_as_those_of_the_grid(
    course, monkeypatch
):
    """For chance as much is taken off as where all places of the grid are tried."""
    match, _ = course
    match.bodies, best = seen_at(monkeypatch, [(20.0, 1.0, 1000.0)])
    match.near = lambda told: [100.0]
    (only,) = race.raced(match, [best])
    assert 1e3 * only.score.shape["x"] == pytest.approx(16.0)
    between = [(6.0, 1.0, 1000.0)]  # a quarter of the spacing from a place of the grid
    match.bodies, best = seen_at(monkeypatch, between)
    (only,) = race.raced(match, [best])
    assert 1e3 * only.score.shape["x"] == pytest.approx(6.0)
    assert only.score.score == pytest.approx(1000.0 - 2.0 * np.log(125.0 / 27.0))


def test_a_column_that_fails_closer_by_leaves_the_place_of_the_grid(course, monkeypatch):
    match, _ = course
    match.bodies, best = seen_at(monkeypatch, [(6.0, 1.0, 1000.0)])
    whole = race.ranked

    def ranked(match, effect, tried):
        if len(tried) < 125:
            raise ValueError("effect own: its column is not finite")
        return whole(match, effect, tried)

    monkeypatch.setattr(race, "ranked", ranked)
    match.near = lambda told: [100.0]
    (only,) = race.raced(match, [best])
    assert only.score is best


def test_a_place_is_sought_from_several(course, monkeypatch):
    """But not beside one that is tried, nor where too little is explained."""
    match, _ = course
    peaks = [(-16.0, 1.0, 1000.0), (-8.0, 1.0, 900.0), (0.0, 1.0, 100.0), (16.0, 1.0, 800.0)]
    match.bodies, best = seen_at(monkeypatch, peaks)
    starts = []

    def near(told):
        starts.append(1e3 * told[1])
        return [900.0, None] if told[1] < 0.0 else [950.0, 100.0]

    match.near = near
    (only,) = race.raced(match, [best])
    assert starts == pytest.approx([-16.0, 16.0]) and only.apart == pytest.approx(100.0)


def test_what_cannot_be_simulated_is_passed_over_or_told(course):
    match, ways = course
    ways |= {("drag",): None, ("damping",): [950.0, 30.0]}
    (only,) = race.raced(match, [score("drag", 500.0), score("damping", 400.0)])
    assert only.score.effect.id == "damping"
    with pytest.raises(ValueError, match="drag: it broke down"):
        race.raced(match, [score("drag", 500.0)])


def runner(name, apart, left, worth=100.0):
    """After a race; its search then reaches ``left``."""
    reached = SimpleNamespace(excess_left=left, worth=lambda: worth)
    return SimpleNamespace(score=score(name, 50.0), apart=apart, left=left, matched=lambda: reached)


def added(monkeypatch, runners, left=100.0):
    seen = tuple(r.score for r in runners)
    match = SimpleNamespace(excess_left=left)
    monkeypatch.setattr(verdict, "raced", lambda *a: runners)
    return verdict._added(verdict.Found(match, seen, seen), {}, lambda text: None, last=False)


def test_what_explains_too_little_when_it_is_simulated_is_not_named(monkeypatch):
    """A column that fits by chance: least thresholds are 16."""
    by_chance = runner("floor-slip", 95.0, 85.0)
    by_chance.score = score("floor-slip", 17.0)
    found, after = added(monkeypatch, [by_chance])
    assert (found.best, found.refused, after) == (None, ("floor-slip",), None)
    runners = [runner("floor-slip", 95.0, 85.0), runner("drag", 90.0, 20.0)]
    found, after = added(monkeypatch, runners)
    assert found.best.effect.id == "drag" and found.refused == ("floor-slip",)
    assert after.excess_left == 20.0 and found.rivals == ()


def test_what_is_worth_too_little_when_all_is_refitted_is_not_named(monkeypatch):
    """The gap that it closes by the weights before may be one that the grid's error, known better, fills."""
    found, after = added(monkeypatch, [runner("floor-slip", 85.0, 80.0, worth=9.0)])
    assert (found.refused, after) == (("floor-slip",), None)
    assert added(monkeypatch, [runner("floor-slip", 85.0, 80.0, worth=17.0)])[1] is not None


def test_a_gap_that_closes_by_what_is_worth_nothing_is_not_noise(monkeypatch):
    found, after = added(monkeypatch, [runner("floor-slip", 25.0, 20.0, worth=9.0)])
    assert found.best.effect.id == "floor-slip" and after is None


def test_what_no_simulation_explains_and_no_chance_does_is_not_in_the_catalogue(monkeypatch):
    """By chance a column may take what it does, beyond what is simulated, up to the threshold of 16."""
    runners = [runner("floor-slip", 90.0, 90.0), runner("drag", 95.0, 88.0)]
    found, after = added(monkeypatch, runners, left=100.0)
    assert found.best is runners[0].score and after is None
    near = [runner("floor-slip", 90.0, 85.5)]  # by its score 30, of which 14.5 are simulated
    near[0].score = score("floor-slip", 30.0)
    assert added(monkeypatch, near)[0].best is None


def test_simulations_that_come_as_near_are_rivals_unless_they_are_alike(monkeypatch):
    runners = [
        runner("drag", 20.0, 20.0),
        runner("damping", 25.0, 25.0),
        runner("density", 60.0, 60.0),
    ]
    found, _ = added(monkeypatch, runners)
    assert found.best.effect.id == "drag" and found.rivals == ("damping",)
    same = runner("relaxation", 22.0, 22.0)
    same.score = Score(CATALOGUE["relaxation"], {}, 1.0, 40.0, 0.5, runners[0].score.column)
    found, _ = added(monkeypatch, [runners[0], same])
    assert (found.alike, found.rivals) == (("relaxation",), ())


def test_what_no_recording_tells_apart_is_of_one_class():
    """Whatever noise makes of their columns, and whether the other is seen or not."""
    best, other = runner("density", 20.0, 20.0), score("force-gain", 3.0)
    for seen in ((best.score,), (best.score, replace(other, score=50.0))):
        found = verdict.Found(SimpleNamespace(excess_left=100.0), (*seen, other)[:2], seen)
        judged = verdict._judged(found, best, [])
        assert (judged.alike, judged.rivals) == (("force-gain",), ())
    alone = verdict.Found(SimpleNamespace(excess_left=100.0), (best.score,), (best.score,))
    assert verdict._judged(alone, best, []).alike == ()  # of a catalogue without it
    for effect in CATALOGUE.values():
        assert all(effect.id in CATALOGUE[name].same for name in effect.same)


def test_what_scores_as_much_below_its_threshold_is_a_rival_too():
    """Next to the threshold chance decides which of two is above it."""
    best = runner("drag", 84.0, 83.0)
    best.score = score("drag", 17.0)
    near, far = score("damping", 15.0), score("density", 6.0)
    like = replace(score("relaxation", 15.5), column=best.score.column)
    match = SimpleNamespace(excess_left=100.0)
    ranked = (best.score, like, near, far)
    found = verdict.Found(match, ranked, (best.score,))
    judged = verdict._judged(found, best, [])
    assert (judged.alike, judged.rivals) == (("relaxation",), ("damping",))
    strong = replace(found, match=SimpleNamespace(excess_left=400.0))  # simulated, it takes 317
    assert verdict._judged(strong, best, []).rivals == ()


def test_what_is_just_like_one_that_ran_and_lost_is_no_rival():
    """Of what no simulation would tell apart one runs for all."""
    best, lost = runner("drag", 20.0, 20.0), score("damping", 98.0)
    best.score = score("drag", 100.0)
    like = replace(score("rate-dependence", 97.0), column=lost.column)
    match, every = SimpleNamespace(excess_left=100.0), (best.score, lost, like)
    found = verdict.Found(match, every, every)
    assert verdict._judged(found, best, []).rivals == ()
    level = SimpleNamespace(score=lost)  # did as well
    assert verdict._judged(found, best, [level]).rivals == ("damping", "rate-dependence")


@pytest.mark.parametrize(("missing", "told"), [(0, "none"), (2, "named"), (3, "unnamed")])
def test_what_takes_three_effects_is_not_in_the_catalogue(monkeypatch, missing, told):
    seen = [score(name, 50.0) for name in ("drag", "damping", "density")[:missing]]

    def twin(count):
        causes = tuple(Cause(s.effect, 1.0, {}) for s in seen[:count])
        model = Model(LAWS["neo-hookean"], {}, causes)
        left = 100.0 * (missing - count)
        found = SimpleNamespace(model=model, told=model, excess_left=left, chance=100.0)
        found.lighter, found.worth = found, lambda n=-1: 100.0
        return found

    def judged(match, *rest):
        left = tuple(seen[len(match.model.causes) :])
        return verdict.Found(match, left, left)

    def raced(match, left, progress):
        count = len(match.model.causes) + 1
        first = runner(left[0].effect.id, 100.0 * (missing - count), 100.0 * (missing - count))
        first.score, first.matched = left[0], lambda: twin(count)
        return [first]

    monkeypatch.setattr(verdict, "judged", judged)
    monkeypatch.setattr(verdict, "raced", raced)
    monkeypatch.setattr(verdict, "matched", lambda match, **options: match)
    monkeypatch.setattr(verdict.Match, "of", lambda *of: twin(0))
    found = verdict.named(None, None, Model(LAWS["neo-hookean"], {}), [], {})
    assert found.verdict == told
    assert [c.effect.id for c in found.added] == [s.effect.id for s in seen[: verdict.MOST]]


@pytest.mark.parametrize(("others", "told"), [(1, "named"), (2, "ambiguous")])
def test_what_is_added_later_is_no_rival_of_what_came_first(monkeypatch, others, told):
    """Of two that both act one comes first, and the other as near; a third may do as well."""
    seen = [score(name, 50.0) for name in ("drag", "damping")]
    rivals = ("damping", "density")[:others]

    def twin(count):
        causes = tuple(Cause(s.effect, 1.0, {}) for s in seen[:count])
        model = Model(LAWS["neo-hookean"], {}, causes)
        found = SimpleNamespace(model=model, told=model, excess_left=0.0, chance=100.0)
        found.lighter, found.worth = found, lambda n=-1: 100.0
        return found

    def added(found, *rest, last):
        count = len(found.match.model.causes)
        if count == len(seen):
            return found, None
        return replace(found, best=seen[count], rivals=() if count else rivals), twin(count + 1)

    monkeypatch.setattr(verdict, "judged", lambda match, *rest: verdict.Found(match, ()))
    monkeypatch.setattr(verdict, "_added", added)
    monkeypatch.setattr(verdict, "matched", lambda match, **options: match)
    monkeypatch.setattr(verdict.Match, "of", lambda *of: twin(0))
    found = verdict.named(None, None, Model(LAWS["neo-hookean"], {}), [], {})
    assert (found.verdict, found.passes[0].rivals) == (told, rivals[1:])


def test_a_further_effect_competes_with_what_simulations_have_wrong_not_with_what_sensors_make():
    left = [SimpleNamespace(excess_left=square) for square in (1.03e5, 3e3, 1e3)]
    for (one, other), changed in (
        (("force-bias", "drag"), 1.02e5),
        (("drag", "force-bias"), 1.02e5),
        (("drag", "damping"), 1.02e5),
        (("force-bias", "camera-scale"), 0.0),
    ):
        passes = [
            verdict.Found(match, (), best=score(name, 50.0))
            for match, name in zip(left, (one, other), strict=False)
        ]
        assert verdict.simulated(passes, left[2]) == pytest.approx(changed)
    assert verdict.simulated([], left[0]) == 0.0


@pytest.mark.parametrize(("first", "doubt"), [("force-bias", 0.0), ("drag", 1e5)])
def test_after_what_acts_in_the_world_more_must_be_explained(monkeypatch, first, doubt):
    def twin(left, *causes):
        model = Model(LAWS["neo-hookean"], {}, causes)
        found = SimpleNamespace(model=model, told=model, excess_left=left, chance=100.0)
        found.lighter, found.worth = found, lambda n=-1: 1e5
        return found

    asked, seen = [], score(first, 50.0)
    bare, after = twin(1e5 + 30.0), twin(30.0, Cause(CATALOGUE[first], 1.0, {}))

    def judged(match, effects, thresholds, doubt):
        asked.append(doubt)
        return verdict.Found(match, (seen,), (seen,) if match is bare else (), doubt=doubt)

    def added(found, *rest, last):
        return (replace(found, best=seen), after) if found.seen else (found, None)

    monkeypatch.setattr(verdict, "judged", judged)
    monkeypatch.setattr(verdict, "_added", added)
    monkeypatch.setattr(verdict, "matched", lambda match, **options: match)
    monkeypatch.setattr(verdict.Match, "of", lambda *of: bare)
    verdict.named(None, None, Model(LAWS["neo-hookean"], {}), [], {})
    assert asked == [0.0, pytest.approx(verdict.WRONG**2 * doubt)]


def test_more_than_noise_and_what_simulations_have_wrong_is_not_enough():
    def left(square, doubt=0.0):
        match = SimpleNamespace(excess_left=square - 100.0, chance=100.0)
        return verdict.Found(match, (), doubt=doubt).enough

    most = 100.0 + 4.0 * np.sqrt(250.0)  # chi-square of 100 rows, and the mean of four draws of it
    assert left(0.99 * most) and not left(1.01 * most)
    assert left(most + 40.0, doubt=50.0) and not left(most + 60.0, doubt=50.0)


def test_a_finer_grid_tells_those_apart_that_have_come_as_near(monkeypatch):
    """The race's own grid is too coarse to tell a mass inside from a sensor's gain."""
    gain, mass = runner("force-gain", 21.0, 20.0), runner("added-mass", 25.0, 24.0)
    mass.matched = lambda: SimpleNamespace(excess_left=5.0, worth=lambda: 100.0)
    found, after = added(monkeypatch, [gain, mass])
    assert found.best.effect.id == "added-mass" and after.excess_left == 5.0
    assert found.rivals == () and found.refused == ()

    def breaks():
        raise ValueError("it broke down")

    mass.matched = breaks
    assert added(monkeypatch, [gain, mass])[0].best.effect.id == "force-gain"
    with pytest.raises(ValueError, match="it broke down"):
        added(monkeypatch, [mass])
