"""What the report of a diagnosis shows beside its verdict; probes are read, nothing is simulated."""

import json
import re
import shlex
import warnings
from dataclasses import replace
from html import escape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.__main__ import _parse
from form_drake.commands.diagnose import Diagnose
from form_drake.diagnose import Cause, Diagnosis, Model, Nulls
from form_drake.diagnose.advice import Advice
from form_drake.diagnose.channel import Channel
from form_drake.diagnose.doubts import doubts, needless
from form_drake.diagnose.figures import overlay, places
from form_drake.diagnose.ledger import BOOKS, CELLS, _apart, ledgers
from form_drake.diagnose.page import _ledger_rows, diagnosis_page
from form_drake.diagnose.placebo import Removed
from form_drake.diagnose.prepare import probe as read_probe
from form_drake.diagnose.rollout import _astray
from form_drake.diagnose.thresholds import FACTOR
from form_drake.diagnose.verdict import Naming
from form_drake.diagnosis_folder import _advise, write_diagnosis
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.records import Recording, Stream
from form_drake.systems.before_after import APART, Beside, write_before_after
from form_drake.systems.scenario import load_scenario
from form_drake.weak.solve import Weights
from helpers.advice import LIMITS, found

FRAMES, RATE = 91, 60.0
LOW, SIZE = np.array([-0.01, -0.01, 0.0]), np.full(3, 0.02)


def block(points=60):
    """A block under a bonded plate that presses it a little."""
    X = LOW + SIZE * np.random.default_rng(0).uniform(0.04, 0.96, (points, 3))
    t = np.arange(FRAMES) / RATE
    stretch = np.ones((len(t), 1, 3))
    stretch[:, 0, 2] -= 0.02 * np.sin(t) ** 2
    pose = np.tile(np.eye(4), (len(t), 1, 1))
    pose[:, 2, 3] = 0.02 * stretch[:, 0, 2]
    return Recording.from_arrays(
        t,
        X * stretch,
        p_reference=X,
        noise=1e-5,
        density=1000.0,
        gravity=np.array([0.0, 0.0, -9.81]),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.02"},
        contact={"z-": "bonded floor", "z+": "bonded plate", "other": "free"},
        poses={"plate": Stream(t, pose)},
        forces={"plate": Stream(t, np.zeros((len(t), 3)), noise=0.01)},
    )


PROBE = read_probe(block(), "probe 1", 0.0025)
FIELDS = sum(len(f.names) for f in PROBE.fields)


def covariance(rows):
    """Of rows that have much in common with their neighbours."""
    n = np.arange(rows)
    size = 1.0 + 0.5 * np.sin(n)
    return np.exp(-np.abs(n[:, None] - n) / 3.0) * np.outer(size, size)


ROWS = int(PROBE.keep.sum())
BY = Weights((np.linalg.cholesky(covariance(ROWS)),), 0.0)


def left(more=0.0, seed=0):
    """A match of one probe whose rows hold noise, and more of it (standard deviations)."""
    noise = np.random.default_rng(seed).standard_normal(ROWS)
    more = more * np.sqrt(np.diag(covariance(ROWS)))
    return SimpleNamespace(
        left=noise + BY.white(more),
        by=BY,
        twin=SimpleNamespace(probes=(PROBE,)),
        bent=(),
        grid=None,
    )


BULGE = 1e-3  # [m]


def bulging(size, noise=0.0, seed=0):
    """The probe of a block whose upper corner goes aside steadily, by ``size`` [m] in the end, and its noise."""
    fit, time = PROBE.fit, PROBE.fit.time
    steady = [time.knots[n + 1 : n + 1 + time.degree].mean() for n in range(time.size)]
    more = noise * fit.draw(np.random.default_rng(seed))
    more[-1, 0] += size * np.array(steady) / time.breaks[-1]
    return replace(PROBE, fit=replace(fit, c=fit.c + more))


def hidden(first, corner):
    """Rows from a window on whose fields are largest in one corner, shape [rows]."""
    (ledger,) = ledgers(left())
    cells = ledger.share.reshape(FIELDS, *3 * (2, CELLS // 2)).sum(axis=(2, 4, 6))
    near = cells[(slice(None), *corner)] > 0.6
    assert 0 < near.sum() < FIELDS / 4
    return (ledger.window >= first) & near[ledger.field]


def test_noise_alone_is_nowhere_and_never():
    (ledger,) = ledgers(left())
    assert ledger.onset is None
    assert ledger.square.mean() == pytest.approx(1.0, abs=0.15)
    own = ledger.window == 5  # chi-square by its own covariance
    rest = (BY.factors[0] @ left().left)[own]
    spent = rest @ np.linalg.solve(covariance(ROWS)[np.ix_(own, own)], rest)
    assert ledger.spent[5] == pytest.approx(spent)
    assert np.all(np.abs(ledger.heat) < 0.6)
    assert sum(ledgers(left(seed=n))[0].onset is not None for n in range(8)) == 0


@pytest.mark.parametrize(("first", "corner"), [(0, (0, 0, 0)), (4, (1, 0, 1))])
def test_what_is_left_has_its_moment_and_its_place(first, corner):
    (ledger,) = ledgers(left(4.0 * hidden(first, corner)))
    assert ledger.onset == pytest.approx(ledger.time[first])
    hottest = np.unravel_index(np.argmax(ledger.heat), ledger.heat.shape)
    assert tuple(n // (CELLS // 2) for n in hottest) == corner
    far = ledger.heat[tuple(slice(0, 2) if c else slice(-2, None) for c in corner)]
    assert np.all(far < 0.2 * ledger.heat.max())


def test_fields_weigh_where_they_are():
    (ledger,) = ledgers(left())
    for axis in range(3):
        share = ledger.share.sum(axis=tuple(1 + a for a in range(3) if a != axis))
        middle = share @ (np.arange(CELLS) + 0.5) / CELLS
        names = PROBE.fields[0].names
        for name, at in zip(names, middle[: len(names)], strict=True):
            if " at " in name:
                n, last = map(int, name.split()[2 + axis].split("/"))
                assert at == pytest.approx(n / last, abs=0.17)
    assert ledger.share.sum(axis=(1, 2, 3)) == pytest.approx(1.0)


def test_one_window_alone_is_no_onset():
    (ledger,) = ledgers(left())
    assert ledgers(left(6.0 * (ledger.window == 3)))[0].onset is None


def test_rows_that_carry_the_force_are_the_tools():
    (ledger,) = ledgers(left())
    names = np.concatenate([f.names for f in PROBE.fields])
    told = {book: set(names[ledger.field[ledger.book == book]]) for book in BOOKS}
    assert told["tool"] == {f"{a} with plate" for a in "xyz"}
    assert told["kinematics"] == set(PROBE.fields[1].names)
    (ledger,) = ledgers(left(5.0 * (ledger.book == "tool")))
    assert ledger.mean("tool") > 5.0 and ledger.mean("interior") < 3.0
    assert replace(ledger, book=np.full(ROWS, "interior")).mean("tool") is None


def test_every_ledger_has_an_onset_of_its_own():
    base = ledgers(left())[0]
    late = (base.book == "tool") & (base.window >= 4)
    after, before = (ledgers(left(size * late))[0] for size in (0.0, 8.0))
    rows = {row[0].partition(", ")[2]: row for row in _ledger_rows(before, after)}
    assert rows["force on tools"][-2:] == [f"{base.time[4]:.2f}", "never"]
    assert rows["interior"][-2:] == ["never", "never"]


def test_whitened_rows_keep_their_places():
    C = covariance(12)
    scale = np.sqrt(np.diag(C))
    size, axes = np.linalg.eigh(C / np.outer(scale, scale))
    root = scale[:, None] * ((axes * np.sqrt(size)) @ axes.T)  # nearest to the rows themselves
    assert np.stack([_apart(C, column) for column in root.T]) == pytest.approx(np.eye(12))


BALL = {"x": 5e-3, "y": -5e-3, "z": 15e-3, "radius": 4e-3}


@pytest.fixture(scope="module")
def diagnosis():
    """An inclusion that was found, and that left more than noise from the fifth window on."""
    inclusion = CATALOGUE["inclusion"]
    limits = LIMITS | {"inclusion": 0.3}
    passes = []
    for best, rows in (("inclusion", 4.0 * hidden(4, (1, 0, 1))), (None, 0.0)):
        ranked = {k: v for k, v in limits.items() if best or k != "inclusion"}
        one = found(best, ranked, rivals=("density",) if best else ())
        own = SimpleNamespace(probes=(bulging(BULGE if best else 0.0),))
        scenes = SimpleNamespace(recordings=(block(),))
        match = SimpleNamespace(**vars(left(rows)), problem=own, scenes=scenes)
        passes.append(replace(one, match=match))
    law, values = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
    model = Model(law, values, (Cause(inclusion, 2.0, BALL, 0.1),))
    added = Naming(tuple(passes), SimpleNamespace(told=model), model.causes, "ambiguous")
    return Diagnosis(added, Model(law, values), 1000.0)


def test_the_onset_of_an_effect_is_that_of_its_pass(diagnosis):
    told = json.loads(json.dumps(diagnosis.to_json()))
    start = pytest.approx(float(PROBE.windows.ends[4].mean()))
    assert told["effects"][0]["onset"] == {"probe 1": start}
    first, last = (one["ledgers"][0] for one in told["passes"])
    assert first["onset"] == start and first["interior"] > 1.2
    assert len(first["time"]) == len(first["windows"]) and max(first["windows"]) > 2.0
    assert np.shape(first["cells"]) == (CELLS,) * 3
    assert last["onset"] is None and last["interior"] == pytest.approx(1.0, abs=0.15)
    assert told["advice"]["apart"][0]["other"] == "density"


def test_how_far_a_simulation_is_off_is_told_by_place_and_moment(diagnosis):
    (before,), (after,) = diagnosis.astray
    aside, volume = before["rollout"], before["volume"]
    assert aside.whole == pytest.approx(BULGE / 9.0, rel=0.02)  # root of the mean of (t x y z)^2
    assert volume.whole == pytest.approx(BULGE / 0.02 / 27.0**0.5, rel=0.02)  # of (t y z)^2
    assert np.all(np.diff(aside.windows) > 0.0) and aside.windows[0] < 0.2 * aside.windows[-1]
    assert np.unravel_index(np.argmax(aside.heat), aside.heat.shape) == (CELLS - 1,) * 3
    assert after["rollout"].whole == after["volume"].whole == 0.0
    told = diagnosis.to_json()["passes"][0]["ledgers"][0]["rollout"]
    assert told["grid"] is None and aside.grid is None  # no finer grid was simulated
    assert _astray(PROBE, PROBE, 0.0)["rollout"].grid == 0.0  # it has nothing wrong
    assert told["whole"] == aside.whole and np.shape(told["cells"]) == aside.heat.shape


def test_noise_of_the_tracks_is_taken_off_how_far_a_simulation_is_off():
    def off(times):
        own = [
            _astray(bulging(0.0, times, seed), PROBE, None)["rollout"].whole ** 2
            for seed in range(8)
        ]
        return np.sqrt(np.mean(own))

    noise = _astray(PROBE, PROBE, None)["rollout"].noise
    assert noise < 1e-5 / 2.0  # less than that of a track
    assert off(1.0) < 0.5 * noise
    assert off(4.0) == pytest.approx(noise * 15.0**0.5, rel=0.2)


def test_what_a_grid_has_wrong_is_taken_off_how_far_a_simulation_is_off():
    bent = bulging(BULGE).fit.c - PROBE.fit.c
    found = _astray(bulging(BULGE), PROBE, bent)["rollout"]
    assert found.whole == 0.0 and found.grid == pytest.approx(BULGE / 9.0, rel=0.01)


def test_both_maps_have_one_scale_and_show_the_place(diagnosis):
    figure = places(*diagnosis.ledgers, diagnosis.naming.model.causes)
    shown = [axes for axes in figure.axes if axes.images]
    assert len(shown) == 6
    assert len({axes.images[0].get_clim() for axes in shown}) == 1
    centres = [axes.patches[0].center for axes in shown]
    assert np.allclose(centres[:3], [(-5.0, 15.0), (5.0, 15.0), (5.0, -5.0)])  # along x, y, z
    corner = [(0, 1), (1, 1), (1, 0)]  # across and up: where the ball is
    for before, after, wanted in zip(shown[:3], shown[3:], corner, strict=True):
        first, last = (axes.images[0].get_array() for axes in (before, after))
        up, across = np.unravel_index(np.argmax(first), first.shape)
        assert (across // (CELLS // 2), up // (CELLS // 2)) == wanted
        assert last.max() < 0.3 * first.max()


def test_cells_that_no_row_sees_stay_blank(diagnosis):
    share = diagnosis.ledgers[0][0].share.copy()
    share[..., 0] = 0.0  # fields that keep clear of the floor
    own = [replace(one, share=share) for (one,) in diagnosis.ledgers]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = places(own[:1], own[1:])
    values = figure.axes[0].images[0].get_array()
    assert np.ma.getmaskarray(np.ma.masked_invalid(values)).sum(axis=1).tolist() == [
        CELLS,
        *5 * [0],
    ]
    assert not figure.axes[0].patches


def test_the_page_says_where_when_and_what_next(diagnosis, tmp_path):
    command = "form-drake diagnose a.h5 NEXT.h5 --out 'my runs'"
    diagnosis_page(diagnosis, Nulls({"damping": 100.0 / FACTOR}), command=command).write(
        tmp_path / "r.html"
    )
    page = re.sub(r'src="data:[^"]*"', "", (tmp_path / "r.html").read_text())
    assert re.search("displacement .mm.</td>.*<td>not known</td>", page)
    assert "Where and when" in page and "circles: what was found there." in page
    assert f"<td>{PROBE.windows.ends[4].mean():.2f}</td><td>never</td>" in page
    assert "To tell inclusion from density" in page and escape(command) in page
    assert "<td>damping</td><td>10</td><td>20</td><td>1 to 1000</td>" in page  # ten deviations
    assert "<td>drag</td><td>over 100</td>" in page
    assert "before_after.html" not in page


def test_held_out_motion_that_is_not_predicted_is_said_everywhere(diagnosis, tmp_path):
    unsure = replace(diagnosis, unverified="it broke down")
    assert str(unsure).endswith("held-out motion verifies nothing: it broke down")
    assert (unsure.verdict, unsure.to_json()["unverified"]) == ("ambiguous", "it broke down")
    diagnosis_page(unsure, Nulls({})).write(tmp_path / "r.html")
    assert "verifies nothing: it broke down." in (tmp_path / "r.html").read_text()


def test_what_is_refused_is_not_in_the_material(diagnosis):
    assert [e.id for e in diagnosis.material.effects] == ["inclusion"]
    refused = replace(diagnosis, naming=replace(diagnosis.naming, verdict="unnamed"))
    assert refused.material.effects == () and dict(refused.material.values) == {
        "mu": 20e3,
        "lam": 40e3,
    }


def test_what_recordings_leave_open_is_said_everywhere(diagnosis, tmp_path):
    seen, law = block(), LAWS["fixed-corotated"]
    start, found = (Model(law, {"mu": mu, "lam": 40e3}) for mu in (20e3, 31e3))
    assert doubts([seen], None, found) == doubts([seen], start, start) == ()
    jitter, other = doubts([seen, replace(seen, noise=None)], start, found)
    assert "recording 2" in jitter and "of 20 frames" in jitter
    assert "2e+04 Pa, these recordings show 3.1e+04 Pa" in other
    unsure = replace(diagnosis, doubts=(jitter,))
    assert jitter in str(unsure) and unsure.to_json()["doubts"] == [jitter]
    diagnosis_page(unsure, Nulls({})).write(tmp_path / "r.html")
    assert escape(jitter) in (tmp_path / "r.html").read_text()


def test_nothing_is_named_without_reserve_where_there_is_a_doubt(diagnosis):
    sure = replace(diagnosis, naming=replace(diagnosis.naming, verdict="named"))
    assert sure.verdict == "named" and sure.sentence().startswith("Missing: ")
    unsure = replace(sure, doubts=("The tracks told their own noise.",))
    assert unsure.verdict == "ambiguous" and "but there is a doubt" not in diagnosis.sentence()
    assert unsure.material.effects  # it is still what explains most
    refused = replace(unsure, naming=replace(sure.naming, verdict="unnamed"))
    assert refused.verdict == "unnamed"


def test_an_effect_that_makes_held_out_motion_worse_is_a_doubt(diagnosis):
    effect = diagnosis.naming.added[0].effect
    helps, harms, silent = (
        Removed(effect, (Channel("tracks 1", "m", before, after, 1e-6, 1e4, 1e-6),))
        for before, after in ((1e-3, 1e-5), (1e-5, 1e-3), (1e-5, 1.01e-5))
    )
    assert needless([helps, silent]) == ()
    assert needless([helps, harms]) == (
        f"Held-out motion is predicted worse with {effect.id} than without it.",
    )


def test_a_size_that_is_not_told_is_said_everywhere(diagnosis, tmp_path):
    causes = tuple(replace(c, std=np.inf) for c in diagnosis.naming.added)
    model = replace(diagnosis.naming.model, causes=causes)
    naming = replace(diagnosis.naming, match=SimpleNamespace(told=model), added=causes)
    unsure = replace(diagnosis, naming=naming)
    assert "(inclusion 2 -, or another size: these recordings do not tell" in unsure.sentence()
    told = json.loads(json.dumps(unsure.to_json(), allow_nan=False))
    assert told["effects"][0]["std"] is None and unsure.material.effects[0].std is None
    assert "inclusion" not in [one["effect"] for one in told["advice"]["limits"]]
    diagnosis_page(unsure, Nulls({})).write(tmp_path / "r.html")
    assert "<td>2</td><td>not told</td>" in (tmp_path / "r.html").read_text()


def test_the_next_command_is_the_same_with_one_recording_more():
    own = Diagnose(
        recording=(Path("my press.h5"), Path("shake.h5")),
        law="yeoh",
        holdout=(Path("a.h5"), Path("b.h5")),
        placebo=3,
        effects=Path("own.py"),
        dx=0.002,
        force="joint-torque",
    )
    first, *words = shlex.split(own._again(Path("runs/x")))
    more = replace(own, recording=(*own.recording, Path("NEXT.h5")), out=Path("runs/x-next"))
    assert first == "form-drake" and _parse(words) == more


def shaken(size=1e-3, points=40):
    """A measured motion, one predicted far off and one near; a point is lost for some frames."""
    still = block(points)
    sway = np.sin(2.0 * np.pi * still.time)[:, None, None] * [size, 0.0, 0.0]
    swayed = still.p_WQ + sway
    valid = np.ones(swayed.shape[:2], dtype=bool)
    valid[10:20, 3] = False
    valid[0] = False  # nothing is seen in the first frame
    seen = np.where(valid[..., None], swayed, np.nan)
    made = (seen, swayed + np.array([0.0, 5e-4, 0.0]), swayed + np.array([0.0, 0.0, 1e-4]))
    return [replace(still, p_WQ=p, p_reference=still.reference, valid=valid) for p in made]


@pytest.mark.filterwarnings("error")
def test_errors_of_held_out_tracks_are_drawn_where_they_are_measured():
    seen, before, after = shaken()
    lost = replace(seen, p_WQ=np.nan_to_num(seen.p_WQ))
    for one in (seen, lost):
        *_, axes = overlay(one, before, after).axes
        for line, size in zip(axes.lines, (0.5, 0.1), strict=True):
            assert line.get_ydata() == pytest.approx([np.nan] + [size] * (FRAMES - 1), nan_ok=True)


def test_a_force_is_drawn_along_the_axis_on_which_it_changes():
    runs, size = shaken(), {"time": block(40).time}
    felt = np.sin(size["time"])[:, None] * [3.0, 0.0, 0.1] + [0.0, 0.0, 20.0]
    runs = [replace(one, forces={"plate": Stream(size["time"], felt)}) for one in runs]
    axes, _ = overlay(*runs).axes
    assert axes.get_ylabel() == "force on plate along x [N]"
    assert axes.lines[0].get_ydata() == pytest.approx(felt[:, 0])


def test_bodies_that_are_seen_on_one_face_alone_stand_beside_each_other():
    runs = shaken()
    X = runs[0].reference * [0.0, 1.0, 1.0]
    flat = [replace(r, p_WQ=X + r.p_WQ - r.reference, p_reference=X) for r in runs]
    shown = Beside.of(*flat)
    apart = np.diff(np.nanmean(shown.p_WQ[:, :, :, 0], axis=(0, 2)))
    assert np.all(apart > 0.25 * np.ptp(X, axis=0).max())


def test_a_page_that_cannot_play_costs_no_answer(diagnosis, tmp_path, monkeypatch):
    def fails(*arguments):
        raise RuntimeError("no port is free")

    monkeypatch.setattr("form_drake.systems.before_after.write_before_after", fails)
    monkeypatch.setattr("form_drake.diagnosis_folder._again", lambda *a: [])
    runs = SimpleNamespace(recordings=(None,))
    check = SimpleNamespace(measured=(None,), before=runs, channels=lambda after: [], unread="")
    check.stands, check.scenes = (lambda after: True), SimpleNamespace(dx=(1e-3,))
    told = replace(diagnosis, check=check, after=runs)
    found = write_diagnosis(told, Nulls.common(), tmp_path)
    assert found["verdict"] == json.loads((tmp_path / "discrepancy.json").read_text())["verdict"]
    assert (
        "Held-out motion is not played: no port is free." in (tmp_path / "report.html").read_text()
    )


def test_an_interrupted_check_of_what_is_written_costs_no_answer(diagnosis, tmp_path, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("form_drake.diagnosis_folder.subprocess.run", interrupted)
    monkeypatch.setattr("form_drake.diagnosis_folder._play", lambda *a: ("", ""))
    seen = shaken()[:1]
    scenes = SimpleNamespace(recordings=seen, dx=(1e-3,), device="cpu")
    runs = SimpleNamespace(recordings=seen)
    check = SimpleNamespace(before=runs, scenes=scenes, channels=lambda after: [], unread="")
    check.stands = lambda after: True
    told = write_diagnosis(replace(diagnosis, check=check, after=runs), Nulls.common(), tmp_path)
    assert told["written"] == [{"failed": "interrupted", "tracks": None, "forces": {}}]
    assert "material.yaml fails: interrupted" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "discrepancy.json").is_file()


def test_three_bodies_stand_beside_each_other():
    seen, before, after = shaken()
    shown = Beside.of(seen, before, after)
    width = np.ptp(seen.reference[:, 0])
    assert np.diff(np.nanmean(shown.p_WQ[:, :, :, 0], axis=(0, 2))) == pytest.approx(
        2 * [APART * width]
    )
    assert shown.p_WQ[:, 1, 0] == pytest.approx(seen.p_WQ[:, 0], nan_ok=True)
    assert np.isnan(shown.p_WQ[15, :, 3]).all() and np.isnan(shown.apart[15, :, 3]).all()
    assert np.isnan(shown.rms[0]).all()
    assert shown.rms[1:] == pytest.approx(np.tile([0.5, 0.1], (FRAMES - 1, 1)))
    marked = replace(seen, p_WQ=before.p_WQ)  # a place is given, and told not to be measured
    assert np.isnan(Beside.of(marked, before, after).p_WQ[15, :, 3]).all()
    assert shown.noise == pytest.approx(1e-2 * np.sqrt(3.0))  # of all three coordinates
    less = shown.chosen(4, 10)
    assert less.p_WQ.shape == (4, 3, 10, 3) and less.time[[0, -1]] == pytest.approx([0.0, 1.5])
    with pytest.raises(ValueError, match="must be the same"):
        Beside.of(seen, before, block(30))


def test_the_page_is_whole_and_as_small_as_it_must_be(tmp_path):
    path = tmp_path / "page.html"
    assert write_before_after(*shaken(), path, "a <b>") == (FRAMES, 40)
    page = path.read_text()
    assert "a &lt;b&gt;" in page and "noise alone makes 0.017 mm" in page
    assert "rms 0.5 mm before (grey), 0.1 mm after (green)" in page
    assert page.count("nothing measured") == 1
    assert re.findall(r">(\w+)</span>", page)[-3:] == ["before", "measured", "after"]
    whole = path.stat().st_size
    limit = whole - 150_000
    frames, points = write_before_after(*shaken(), path, "a", limit=limit)
    assert path.stat().st_size <= limit and frames * points < 40 * FRAMES
    path.unlink()
    with pytest.raises(ValueError, match="no room"):
        write_before_after(*shaken(), path, "a", limit=100_000)
    assert not path.exists()


@pytest.mark.browser
def test_a_browser_plays_what_was_measured_and_predicted(tmp_path, played):
    write_before_after(*shaken(), tmp_path / "page.html", "held out")
    found, picture = played(tmp_path / "page.html", 0.51, FRAMES, "['frames']")
    assert found["errors"] == []
    assert found["seen"] == [30]  # the one of 0.5 s
    assert found["now"].startswith("t = 0.50 s, rms 0.5 mm before")
    assert picture[150:500].std() > 0.05  # something stands before the background


@pytest.mark.parametrize("change", [{"gravity": None}, {"gravity": np.array([0.0, 9.81, 0.0])}])
def test_no_scenario_is_advised_where_the_station_has_another_scene(
    diagnosis, tmp_path, monkeypatch, change
):
    monkeypatch.setattr(Advice, "motions", ("presses of two depths",))

    model = diagnosis.model
    damped = replace(model, causes=(Cause(CATALOGUE["damping"], 2.0, {}, 0.1), *model.causes))

    def wanted(recording):
        scenes = SimpleNamespace(recordings=(recording,))
        match = SimpleNamespace(**{**vars(diagnosis.naming.passes[0].match), "scenes": scenes})
        first = replace(diagnosis.naming.passes[0], match=match)
        told = SimpleNamespace(told=damped)
        naming = replace(diagnosis.naming, passes=(first, *diagnosis.naming.passes[1:]), match=told)
        return _advise(replace(diagnosis, naming=naming), tmp_path)

    assert wanted(replace(block(), **change)) == [] and not list(tmp_path.iterdir())
    assert wanted(block()) == ["next.yaml"]
    made = load_scenario(tmp_path / "next.yaml").specimen.made()  # of the law alone
    assert (made.law, made.effects) == (model.law, ())
