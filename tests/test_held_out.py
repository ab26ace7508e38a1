"""What held-out motion tells of a prediction: errors beyond noise and grid, and rows of the balance."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.diagnose import Cause, Scenes
from form_drake.diagnose import diagnosed as diagnosis
from form_drake.diagnose.channel import Channel
from form_drake.diagnose.motions import Block
from form_drake.diagnose.verdict import WRONG, Naming
from form_drake.diagnose.verify import Check, Predicted, there
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.records import Stream

DX, NOISE = 0.004, 5e-6
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
BLOCK = Block(size=(0.02, 0.02, 0.02), points=120, rate=150.0, stamps=150.0, law=LAW.name)
PROBE = BLOCK.press("bonded", 0.4)


def test_what_grids_may_have_wrong_makes_no_prediction_worse():
    channel = Channel("force", "N", before=0.8, after=1.1, noise=0.5, samples=1250, grid=0.0)
    assert channel.floor == pytest.approx(
        0.5 * 0.0032**0.25
    )  # of chance, and of a noise told to 2 %
    assert channel.worse and channel.closure == pytest.approx(-0.3 / (0.8 - channel.floor))
    assert not replace(channel, grid=0.4).worse  # two of these beside a twentieth of the error
    assert not replace(channel, after=0.85).worse
    assert not replace(channel, noise=3.0).worse  # noise would do as much


def test_errors_far_below_the_noise_of_a_sample_are_told_where_there_are_many():
    """Two thirds of it, and a thirtieth after: what noise adds to a mean square is taken off."""
    rng, shape, noise = np.random.default_rng(1), PROBE.p_WQ.shape, 1e-4
    before, after = (share * noise * rng.standard_normal(shape) for share in (2 / 3, 1 / 30))
    force = PROBE.forces["plate"]
    seen = replace(PROBE, p_WQ=PROBE.p_WQ + noise * rng.standard_normal(shape), noise=noise)
    pushed = 0.5 * rng.standard_normal(force.value.shape)  # half of what is stated, and no error
    seen = replace(seen, forces={"plate": replace(force, value=force.value + pushed, noise=1.0)})
    off = [replace(PROBE, p_WQ=PROBE.p_WQ + error) for error in (before, after)]
    check = Check(Scenes((seen,), (DX,)), None, Predicted((off[0],), (off[0],), None))
    tracks, still = check.channels(Predicted((off[1],), (off[1],), None))
    assert tracks.samples == np.prod(shape) and tracks.floor < 0.25 * noise
    assert tracks.before == pytest.approx(noise / 1.5, rel=0.1) and tracks.counts
    assert tracks.after < 2.0 * tracks.floor and tracks.closure > 0.5
    assert not replace(tracks, samples=20).counts  # chance would do as much
    assert still.before == 0.0 and not still.counts


@pytest.mark.parametrize("lost_as", [np.nan, 0.0])
def test_what_is_lost_counts_in_no_error_wherever_it_is_put(lost_as):
    """And what the grid changes is projected out of what is left: here it is all that is."""
    rng, shape = np.random.default_rng(0), PROBE.p_WQ.shape
    grid, more = (1e-4 * rng.standard_normal(shape) for _ in range(2))
    valid = rng.random(shape[:2]) > 0.4
    valid[0, 3] = False  # of a point whose reference is stated
    p_WQ = np.where(valid[..., None], PROBE.p_WQ + grid, lost_as)
    seen = replace(PROBE, p_WQ=p_WQ, valid=valid, noise=1e-6)
    coarse, after = (replace(PROBE, p_WQ=PROBE.p_WQ + one) for one in (grid, grid + more))
    check = Check(Scenes((seen,), (DX,)), None, Predicted((PROBE,), (coarse,), None))
    tracks, _ = check.channels(Predicted((after,), (coarse,), None))
    assert tracks.before == pytest.approx(0.0, abs=1e-12)
    assert tracks.grid == pytest.approx(np.sqrt(np.mean(grid[valid] ** 2)))
    assert tracks.after == pytest.approx(np.sqrt(np.mean(more[valid] ** 2)), rel=0.01)
    unstated = replace(seen, p_reference=None)
    assert not there(unstated)[:, 3].any() and np.array_equal(there(seen), valid)


def test_held_out_forces_count_among_the_frames_alone():
    time, force = PROBE.time[:30], PROBE.forces["plate"]
    short = replace(PROBE, time=time, p_WQ=PROBE.p_WQ[:30], noise=1e-6)
    scenes = Scenes.of((short,), DX)
    still = scenes.recordings[0]
    assert still.forces["plate"].time[-1] == time[-1] < force.time[-1]
    predicted = Predicted((still,), (still,), None)
    loud = np.where(force.time > time[-1] + 1e-9, 5.0, 0.0)[:, None] + force.value
    seen = replace(short, forces={"plate": Stream(force.time, loud, noise=1e-3)})
    _, force = Check(Scenes.of((seen,), DX), None, predicted).channels(predicted)
    assert force.before == 0.0 and not force.counts


def rows_of(before, after, chance=50.0):
    """Of held-out rows of unit variance, before and after: one that effects change, and another."""
    own = [np.array(rows) for rows in (before, after)]
    by = SimpleNamespace(white=lambda a: a)
    match = SimpleNamespace(gap=own[1], apart=own[1], by=by, chance_apart=chance)
    was = SimpleNamespace(match=SimpleNamespace(apart=own[0], explains=lambda m: own[0] - m.apart))
    return Check(SimpleNamespace(), None, was), Predicted((), (), match)


def borne_out(*told, **more):
    check, after = rows_of(*told, **more)
    return check.bears_out(after)


def test_held_out_rows_that_keep_more_than_noise_refuse_what_was_found():
    most = np.sqrt(50.0 + 4.0 * np.sqrt(125.0))
    assert borne_out((0.0, 0.99 * most), (0.0, 0.99 * most))
    assert not borne_out((0.0, 1.01 * most), (0.0, 1.01 * most))
    for share, fits in ((0.9, True), (1.1, False)):  # of what simulations of effects have wrong
        left = np.sqrt(most**2 + share * WRONG**2 * 900.0)
        assert borne_out((30.0, left), (0.0, left)) is fits


@pytest.mark.parametrize(
    ("predicted", "there", "fits"),
    [(3.9, 0.0, True), (4.1, 0.0, False), (4.1, 0.6, True), (20.0, 0.7, False), (20.0, 0.75, True)],
)
def test_held_out_rows_change_by_as_much_as_was_predicted(monkeypatch, predicted, there, fits):
    """In standard deviations; from four on they tell. The share that is there is known to 1/predicted."""
    gap = there * predicted
    assert borne_out((gap, 0.0), (gap - predicted, 0.0)) is fits
    check, after = rows_of((gap, 0.0), (gap - predicted, 0.0))
    check = replace(
        check, before=SimpleNamespace(match=check.before.match, recordings=(), coarse=())
    )
    check.scenes.recordings, own = (), SimpleNamespace(counts=False)
    monkeypatch.setattr(Check, "channels", lambda *a: [own])
    assert check.shows(after) is (predicted > 4.0)
    own.counts = True
    assert check.shows(after)
    if there:
        assert borne_out(((2.0 - there) * predicted, 0.0), (-gap + predicted, 0.0)) is fits


def channel(**more):
    told = {"before": 1.0, "after": 0.1, "noise": 0.1, "samples": 1000, "grid": 0.01}
    return Channel("force", "N", **told | more)


@pytest.mark.parametrize(
    ("channels", "fits"),
    [
        ([], True),
        ([channel()], True),
        ([channel(), channel(after=1.1)], False),  # one is worse
        ([channel(after=1.01)], False),  # none is better
        ([channel(before=0.01, after=0.02)], True),  # too small to count
    ],
)
def test_what_makes_a_channel_worse_or_helps_in_none_is_refused(monkeypatch, channels, fits):
    check, after = rows_of((0.0, 0.1), (0.0, 0.1))
    monkeypatch.setattr(Check, "channels", lambda *a: channels)
    assert check.stands(after) is fits
    check, after = rows_of((0.0, 12.0), (0.0, 12.0))
    assert not check.stands(after)


@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize(
    ("finer", "there"),
    [((0.0, 0.1), True), ((0.0, 12.0), True), (None, False), (ValueError("it broke"), False)],
)
def test_held_out_motion_on_a_finer_grid_has_this_one_as_its_coarser(
    monkeypatch, finer, there, named
):
    """Where it cannot be simulated, or less be read, this one stays."""
    fitted, without, asked = SimpleNamespace() if named else None, SimpleNamespace(), []

    def rows(told, *recordings):
        match = None if told is None else rows_of(told, told)[1].match
        return Predicted(recordings, (), match)

    def of(scenes, match, coarse):
        asked.append((scenes.dx[0], match is without, coarse))
        if isinstance(finer, ValueError):
            raise finer
        return replace(check, scenes=scenes, before=rows(finer))

    def predicted(self, match, coarse):
        asked.append((self.scenes.dx[0], match is without, coarse))
        return rows(finer)

    monkeypatch.setattr(Check, "of", of)
    monkeypatch.setattr(Check, "predicted", predicted)
    check = Check(Scenes.of((PROBE,), DX), None, rows((0.0, 12.0), "before"))
    here = rows((0.0, 12.0), "after") if named else check.before
    chosen, after = check.finer(without, fitted, here)
    small, simulated = pytest.approx(DX / 1.5), not isinstance(finer, ValueError)
    wanted = [(small, True, ("before",))] + [(small, False, ("after",))] * (named and simulated)
    assert asked == wanted
    assert (chosen.scenes.dx[0] < DX) is there is (after is not here)
    assert after.match is not None and (named or after is chosen.before)


def read_and_named(monkeypatch, verdict="named"):
    """What seems to be dragged, or nothing."""
    own = SimpleNamespace(values={})
    passes = (SimpleNamespace(match=SimpleNamespace(told=own), alike=()),)
    match = SimpleNamespace(told=own, on=lambda coarser: None)
    dragged = (Cause(CATALOGUE["drag"], 2.0, {}),) * (verdict != "none")
    found = Naming(passes, match, dragged, verdict)
    read_as = SimpleNamespace(probes=[SimpleNamespace(body=SimpleNamespace(density=1000.0))])
    for name, made in (("read", (read_as, own)), ("named", found)):
        monkeypatch.setattr(f"form_drake.diagnose.diagnosis.{name}", lambda *a, made=made: made)


@pytest.mark.parametrize(
    ("verdict", "stands", "decides"),
    [
        ("named", False, "finer"),
        ("none", False, "finer"),
        ("named", True, "here"),
        ("unnamed", False, "here"),
    ],
)
def test_before_held_out_motion_refuses_a_finer_grid_decides(monkeypatch, verdict, stands, decides):
    """And all that is told is of that one."""
    read_and_named(monkeypatch, verdict)
    seen = [replace(one, noise=NOISE) for one in (PROBE, replace(PROBE, p_WQ=PROBE.p_WQ + 1e-9))]

    def check(name, fits):
        own = SimpleNamespace(
            name=name,
            before=f"before {name}",
            scenes=SimpleNamespace(dx=()),
            bears_out=lambda a: fits,
        )
        own.predicted = lambda match: f"after {name}"
        own.stands, own.shows = lambda after: fits, lambda after: True
        own.channels = lambda after: [channel()] * (after == f"after {name}")
        return own

    here, finer = check("here", stands), check("finer", True)
    after = finer.before if verdict == "none" else "after finer"
    here.finer = lambda *given: (finer, after)
    monkeypatch.setattr(Check, "of", lambda *a: here)
    told = diagnosis(seen[:1], LAW, effects=[], thresholds={}, holdout=seen[1:], dx=DX)
    assert told.check.name == decides and told.verdict == verdict
    assert told.doubts == () and len(told.channels) == (verdict != "none")


def test_held_out_motion_verifies_nothing_if_it_fails_without_effects_and_refuses_if_with_them(
    monkeypatch,
):
    """What was named stays where its recording is what fails."""
    read_and_named(monkeypatch)

    def fails(*arguments):
        raise ValueError("it broke down")

    seen = replace(PROBE, noise=NOISE)
    unseen = replace(seen, p_WQ=PROBE.p_WQ + 1e-9)

    def told():
        return diagnosis([seen], LAW, effects=[], thresholds={}, holdout=[unseen], dx=DX)

    with pytest.raises(ValueError, match="the same motion as"):
        diagnosis([seen], LAW, effects=[], thresholds={}, holdout=[seen], dx=DX)
    wider = {**PROBE.geometry, "high": "0.04 0.04 0.04"}
    with pytest.raises(ValueError, match="recording 2: another specimen than recording 1"):
        other = replace(unseen, geometry=wider)
        diagnosis([seen], LAW, effects=[], thresholds={}, holdout=[other], dx=DX)
    with pytest.raises(ValueError, match="newtonian flows: diagnoses are of solids"):
        diagnosis([seen], LAWS["newtonian"], effects=[], thresholds={}, dx=DX)

    monkeypatch.setattr(Check, "of", fails)
    assert told().verdict == "named" and told().unverified == "it broke down"
    monkeypatch.setattr(Check, "of", lambda *a: SimpleNamespace(predicted=fails))
    assert told().verdict == "unnamed"
    assert told().sentence().endswith("fails, held-out motion as predicted: it broke down")


@pytest.mark.parametrize(
    ("part", "whose"),
    [("problem_of", "as measured"), ("_read", "as predicted without the effects")],
)
def test_held_out_motion_that_cannot_be_read_says_why(monkeypatch, part, whose):
    """As measured, or as predicted without the effects; tracks and forces are compared even so."""

    def fails(*arguments):
        raise ValueError("too few points")

    monkeypatch.setattr("form_drake.diagnose.verify._rolled", lambda *a: ((), ()))
    monkeypatch.setattr("form_drake.diagnose.verify.problem_of", lambda *a: None)
    monkeypatch.setattr(f"form_drake.diagnose.verify.{part}", fails)
    fitted = SimpleNamespace(problem=SimpleNamespace(unknowns=None), told=None)
    check = Check.of(Scenes.of((PROBE,), DX), fitted)
    assert check.unread == f"{whose}, too few points" and check.bears_out(check.before)
    after = SimpleNamespace(gap=np.full(50, 3.0), chance_apart=50.0)
    assert not check.bears_out(Predicted((), (), after))  # noise does not explain it
    assert check.predicted(fitted).match is None  # cannot be read either: that is no effect's fault
