"""What a diagnosis advises to record next, and which motions recordings hold already."""

import json
from dataclasses import replace

import numpy as np
import pytest

from form_drake.diagnose import Cause
from form_drake.diagnose.advice import Advice
from form_drake.diagnose.recorded import motions
from form_drake.diagnose.verdict import Naming
from form_drake.effects import CATALOGUE
from form_drake.records import Stream, framed
from helpers.advice import BLOCK, LIMITS, found


def naming(first, verdict="named"):
    cause = Cause(CATALOGUE["force-gain"], 0.05, {}, 0.001)
    last = found(None, {k: v for k, v in LIMITS.items() if k != "force-gain"})
    return Naming((first, last), None, (cause,), verdict)


def test_limits_stand_beside_what_is_likely():
    advice = Advice.of(naming(found("force-gain", LIMITS)), "named")
    sizes = {one.effect.id: one.size for one in advice.limits}
    assert sizes == LIMITS | {
        "force-gain": pytest.approx(0.005)
    }  # five deviations of what was found
    missed = {one.effect.id: one.missed for one in advice.limits}
    assert list(missed.values()) == sorted(missed.values())
    assert missed["eigenstrain"] == 0.0 and missed["drag"] == 1.0
    assert missed["damping"] == pytest.approx(1 / 3)  # from 1 to 1000 Pa s
    assert [one.effect.id for one in advice.blind] == ["drag"]
    assert advice.sentences() == (
        "drag of any likely size would not be seen; shown by: shake, stronger or longer.",
    )


def test_what_no_row_sees_is_missed_as_a_whole():
    """And what went again, or is not sought beside what was found, keeps the limit that it had."""
    last = found(None, {"density": 0.03}, unseen=("adhesion",))
    first = found("force-gain", LIMITS | {"adhesion": 50.0})
    cause = Cause(CATALOGUE["force-gain"], 0.05, {}, 0.001)
    advice = Advice.of(Naming((first, last), None, (cause,), "named"), "named")
    told = {one["effect"]: one for one in json.loads(json.dumps(advice.to_json()))["limits"]}
    assert told["adhesion"]["limit"] is None and told["adhesion"]["missed"] == 1.0
    assert [told[k]["limit"] for k in ("density", "drag")] == [0.03, LIMITS["drag"]]
    assert "press and lift off" in advice.motions
    unknown = replace(cause, std=np.inf)  # of a size that recordings do not tell
    told = Advice.of(Naming((first, last), None, (unknown,), "named"), "named").limits
    assert "force-gain" not in {one.effect.id for one in told}


def test_what_is_not_told_apart_is_shown_by_what_is_not_there_yet():
    first = found("force-gain", LIMITS, alike=("density",), rivals=("eigenstrain",))
    advice = Advice.of(naming(first), "ambiguous")
    density, swelling = advice.apart
    assert density.sentence() == (  # a shake is there already
        "To tell force-gain from density: a known weight (shows force-gain); a balance (shows"
        " density)."
    )
    assert swelling.other.id == "eigenstrain"
    told = advice.to_json()
    assert told["apart"][0]["other"] == "density" and told["next"][0] == density.sentence()
    press = (BLOCK.press("bonded"),)
    first = found("force-gain", LIMITS, alike=("density",), recordings=press)
    (pair,) = Advice.of(naming(first), "named").apart
    assert ("shake", ("density",)) in pair.shown
    assert pair.shown[-1][0] != "press"


def test_what_shows_both_comes_last():
    ranked = {"eigenstrain": 1e-4, "camera-scale": 1e-4}
    advice = Advice.of(naming(found("eigenstrain", ranked, alike=("camera-scale",))), "named")
    assert advice.apart[0].shown == (
        ("a ruler", ("camera-scale",)),
        ("a look at the bonded edge", ("eigenstrain", "camera-scale")),
    )


def test_what_no_effect_explains_asks_for_one():
    advice = Advice.of(naming(found("force-gain", LIMITS)), "unnamed")
    assert "--effects" in advice.sentences()[0]


def pressing(*knots, noise=0.02, contact="bonded"):
    """A plate goes to depths (time [s], share of the height), and feels them where they are positive."""
    one = BLOCK.press(contact, seconds=max(time for time, _ in knots))
    stamps = one.poses["plate"].time
    depth = np.interp(stamps, *np.array(knots).T)
    X_WT, value = np.tile(np.eye(4), (len(stamps), 1, 1)), np.zeros((len(stamps), 3))
    X_WT[:, 2, 3], value[:, 2] = BLOCK.size[2] * (1.0 - depth), 50.0 * np.maximum(depth, 0.0)
    return replace(
        one,
        poses={"plate": Stream(stamps, X_WT)},
        forces={"plate": Stream(stamps, value, noise=noise)},
    )


SLOW, HOLD = ((0.0, 0.01), (1.0, 0.08)), ((0.0, 0.01), (1.0, 0.08), (1.5, 0.08))
PRESSES = [
    (SLOW, ()),
    (HOLD, ()),
    ((*HOLD, (2.5, 0.01)), ("press, hold and release",)),
    ((*HOLD, (2.5, 0.01), (3.0, 0.01)), ("press, hold and release", "press, release and wait")),
    (((0.0, 0.01), (0.2, 0.08)), ("fast press",)),
    (((0.0, 0.01), (0.2, 0.08), (0.4, 0.01)), ("fast press", "a fast reversal")),
    (((0.0, 0.01), (0.2, 0.08), (1.0, 0.01), (2.6, 0.08)), ("fast press",)),
    (
        ((0.0, 0.01), (0.1, 0.08), (1.0, 0.01), (2.6, 0.08)),
        ("fast press", "presses at speeds ten times apart"),
    ),
    (((*SLOW, (1.5, 0.05), (2.8, 0.14))), ("presses of two depths",)),
    (
        (*SLOW, (2.0, 0.01), (3.5, 0.14)),
        ("presses of two depths", "presses of two depths, each with release"),
    ),
    (((0.0, -0.02), (0.2, -0.01), (2.0, 0.08)), ("a moment without contact",)),
    (
        ((0.0, 0.01), (1.0, 0.08), (2.0, -0.005), (2.2, -0.02)),
        ("a moment without contact", "press and lift off"),
    ),
    (
        ((0.0, -0.02), (0.2, -0.01), (1.0, 0.08), (2.0, -0.005), (2.2, -0.02)),
        (
            "a moment without contact",
            "moments without contact before and after",
            "press and lift off",
        ),
    ),
]


@pytest.mark.parametrize(("knots", "told"), PRESSES)
def test_a_press_is_told_by_its_way_and_force(knots, told):
    assert motions(pressing(*knots)) == {"press", *told}


AIR = ((0.0, -0.7), (0.2, 0.0))
NO_HOLD = {"press", "press between plates that do not hold the body"}


@pytest.mark.parametrize(
    ("knots", "told"),
    [
        ((*AIR, (1.2, 0.033)), ()),  # fast in free air alone
        (((0.0, -0.1), (2.0, -0.07)), None),  # it never touches
        (
            ((0.0, 0.0), (1.0, 0.03), (1.5, -0.7), (2.0, 0.0), (3.5, 0.1)),
            ("presses of two depths", "presses of two depths, each with release"),
        ),
    ],
)
def test_what_a_tool_does_in_free_air_is_no_press(knots, told):
    found = motions(pressing(*knots, noise=1e9, contact="frictionless"))
    less = {"a moment without contact"}  # so much noise would hide any force
    assert found - less == (set() if told is None else NO_HOLD | {*told})


def test_what_a_tool_does_before_and_after_the_frames_is_not_recorded():
    one = pressing((0.0, 0.01), (0.1, 0.08), (0.5, 0.01), (2.0, 0.08))
    late = one.time >= 0.5
    seen = replace(one, time=one.time[late], p_WQ=one.p_WQ[late])
    assert "fast press" in motions(one) and "fast press" not in motions(framed(seen))


def test_what_no_tool_does_is_not_recorded():
    free = pressing(*SLOW, contact="frictionless")
    assert motions(free) == {"press", "press between plates that do not hold the body"}
    shake = BLOCK.shake()
    assert motions(shake) == {"shake", "shakes along two directions"}
    (still,) = shake.poses.values()
    for along, wanted in (
        (np.zeros(3), set()),
        (np.array([1e-3, 1e-3, 0.0]), set()),  # as a pose jitters
        (np.array([1.0, 0.05, 0.0]), {"shake"}),
    ):
        X_WT = np.tile(np.eye(4), (len(still.time), 1, 1))
        X_WT[:, :3, 3] = 1e-3 * np.sin(9.0 * still.time)[:, None] * along + [0.1, 0.0123, 0.03]
        assert motions(replace(shake, poses={"floor": Stream(still.time, X_WT)})) == wanted
    assert motions(replace(shake, poses={})) == set()


def test_what_is_recorded_is_not_advised_again():
    ranked = {"rate-dependence": 1e9, "relaxation": 1e9}
    knots = ((0.0, 0.01), (0.1, 0.08), (1.0, 0.01), (2.6, 0.08))
    for recordings, wanted in (
        ((pressing(*SLOW),), ("presses at speeds ten times apart", "press, hold and release")),
        ((pressing(*SLOW), pressing(*knots)), ("press, hold and release",)),
    ):
        first = found(None, ranked, recordings=recordings)
        advice = Advice.of(Naming((first,), None, (), "none"), "none")
        assert set(advice.motions) == set(wanted)
    assert any("ten times apart, stronger or longer" in told for told in advice.sentences())
