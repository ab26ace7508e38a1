"""What recordings must state before a diagnosis reads them, and what they declare."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from form_drake.__main__ import main
from form_drake.diagnose import Model, admitted, prepare
from form_drake.diagnose import diagnosed as diagnosis
from form_drake.diagnose.match import Match
from form_drake.diagnose.motions import Block
from form_drake.laws import LAWS, law_named
from form_drake.records import Stream, write_recording
from form_drake.weak.unknowns import Unknowns

DX = 0.004
LAW, TRUTH = LAWS["fixed-corotated"], {"mu": 20e3, "lam": 40e3}
BLOCK = Block(size=(0.02, 0.02, 0.02), points=120, rate=150.0, stamps=150.0, law=LAW.name)
PROBE = BLOCK.press("bonded", 0.4)


def _read(*arguments, **more):
    raise ValueError("it is read")


def test_a_diagnosis_reads_one_source_of_the_force(tmp_path, monkeypatch, capsys):
    """As a probe of the station is recorded, whose arm feels the force as well."""
    (stamps, still), felt = (PROBE.forces["plate"].time, PROBE.forces["plate"].value), {}
    both = {"plate": still, "plate:joint-torque": still + 2.0}
    both = {k: Stream(stamps, value, noise=0.01) for k, value in both.items()}
    path = str(tmp_path / "probe.h5")
    write_recording(replace(PROBE, forces=both, noise=2e-5), tmp_path / "probe.h5")

    def diagnosed(recordings, law, **how):
        felt.update({name: float(f.value.max()) for name, f in recordings[0].forces.items()})
        raise ValueError("far enough")

    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", diagnosed)
    out = str(tmp_path / "out")
    for source, largest in (("sensor", 0.0), ("joint-torque", 2.0)):
        assert main(["diagnose", path, "--out", out, "--force", source]) == 2
        assert felt == {"plate": largest} and "far enough" in capsys.readouterr().err
    assert main(["diagnose", path, "--out", out, "--force", "scales"]) == 2
    assert "no force comes from scales; the recording has" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("known", "values"),
    [
        ({"lam": 40e3}, {"mu": 24e3, "lam": 40e3}),
        ({"nu": 1.0 / 3.0}, {"mu": 24e3, "lam": 48e3}),
        ({"mu": 20e3, "lam": 40e3}, {"mu": 20e3, "lam": 40e3}),
    ],
)
def test_what_is_declared_as_known_stays_while_a_twin_is_fitted(known, values):
    unknowns = Unknowns.of(LAW, known, "law")
    model, twin = Model(LAW, TRUTH), SimpleNamespace(coordinates=lambda v: (np.zeros(0), theta))
    theta = np.array([TRUTH["mu"], TRUTH["lam"]])
    problem = SimpleNamespace(unknowns=unknowns, values=lambda eta: {})
    match = Match(problem, twin, None, None, model, None, ())
    assert match.valued(np.zeros(len(unknowns.keys))) == pytest.approx(TRUTH)
    phi = match._phi
    assert match.valued(0.2 * phi) == pytest.approx(values)
    assert np.allclose(match.within(9.0 * phi), phi)  # twice as large, at most


def test_a_diagnosis_begins_with_what_recordings_declare(monkeypatch):
    told = {}

    def reading(scenes, law, known):
        told.update(known)
        raise ValueError("far enough")

    monkeypatch.setattr("form_drake.diagnose.diagnosis.read", reading)
    seen, more = replace(PROBE, known={"lam": 40e3}, noise=2e-5), {"effects": [], "thresholds": {}}
    for start in (None, Model(LAW, TRUTH)):
        told.clear()
        with pytest.raises(ValueError, match="far enough"):
            diagnosis([seen], LAW, start=start, dx=DX, **more)
        assert told == {"lam": 40e3}
    with pytest.raises(
        ValueError, match="the material has lam 42000, the recordings declare 40000"
    ):
        diagnosis([seen], LAW, start=Model(LAW, TRUTH | {"lam": 42e3}), dx=DX, **more)


def test_constants_that_nothing_finds_are_asked_for_where_they_can_be_stated():
    with pytest.raises(ValueError, match="needs given values for n: state them in a --material"):
        prepare.read(None, law_named(f"{LAW.name}+rate-dependence"), {})


BAD = {  # what recordings lack, and what is said
    "no poses": (lambda r: {"poses": {}}, "add its poses"),
    "no faces": (lambda r: {"contact": {"z-": "bonded floor", "z+": "bonded plate"}}, "is unknown"),
    "short poses": (
        lambda r: {"poses": {"plate": Stream(r.time[:20], r.poses["plate"].value[:20])}},
        "must cover the frames",
    ),
    "late force": (
        lambda r: {"forces": {"plate": Stream(r.time + 0.3, r.forces["plate"].value)}},
        "the clocks must overlap",
    ),
    "few frames": (lambda r: {"time": r.time[:4], "p_WQ": r.p_WQ[:4]}, "state noise"),
    "no box": (lambda r: {"geometry": {}}, "geometry: shape None"),
    "no density": (lambda r: {"density": None}, "needs the recording's density"),
    "no sensor": (lambda r: {"forces": {"plate:scales": r.forces["plate"]}}, "comes from sensor"),
    "gravity alone": (
        lambda r: {"body_force": np.zeros(r.p_WQ.shape)},
        "states body_force",
    ),
    "no positions free of stress": (
        lambda r: {"p_reference": None},
        "p_reference [m] is not stated: the first frame is as noisy as the others",
    ),
    "no gravity": (lambda r: {"gravity": None}, "where there is none, state 0 0 0"),
    "no names of tools": (
        lambda r: {"contact": {"z-": "bonded", "z+": "bonded", "other": "free"}, "poses": {}},
        'no face names plate in contact; name the one that it holds, such as {"z+": "frictionless pl',
    ),
    "few samples of the force": (
        lambda r: {
            "forces": {"plate": Stream(np.linspace(0.0, r.time[-1], 11), np.zeros((11, 3)))}
        },
        "11 samples of the force of plate lie among the frames, from 12 on their noise can be told",
    ),
}


@pytest.mark.parametrize("lacks", BAD)
def test_every_recording_is_looked_at_before_anything_is_simulated(
    tmp_path, monkeypatch, capsys, lacks
):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", None)
    paths = [tmp_path / "press.h5", tmp_path / "other.h5"]
    write_recording(replace(PROBE, noise=2e-5), paths[0])
    change, told = BAD[lacks]
    other = replace(PROBE, p_WQ=PROBE.p_WQ + 1e-6)
    write_recording(replace(other, **change(other)), paths[1])
    words = ["diagnose", str(paths[0]), "--holdout", str(paths[1]), "--out", str(tmp_path / "o")]
    assert main(words) == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0 and f"{paths[1]}: " in said and told in said


def test_points_of_faces_alone_are_not_read(tmp_path, monkeypatch, capsys):
    """What is inside would be made up by the fit, and a stiffer part found in it."""
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", None)
    seen = replace(PROBE, face=np.arange(PROBE.points) % 6, noise=2e-5)
    write_recording(seen, tmp_path / "seen.h5")
    assert main(["diagnose", str(tmp_path / "seen.h5"), "--out", str(tmp_path / "o")]) == 2
    assert "seen.h5: all points are stated to lie on faces" in capsys.readouterr().err
    with pytest.raises(ValueError, match="needs points throughout the body"):
        prepare.probe(seen, "probe", DX)
    admitted.require_stated(seen, DX, held_back=True)  # compared, not read


@pytest.mark.parametrize("faces", [2, 6])
def test_points_that_lie_on_faces_are_known_as_such_unstated(tmp_path, monkeypatch, capsys, faces):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    X, low, high = (
        PROBE.reference.copy(),
        np.array([-0.01, -0.01, 0.0]),
        np.array([0.01, 0.01, 0.02]),
    )
    face = np.arange(len(X)) % faces
    for n in range(faces):
        X[face == n, n % 3] = (low, high)[n // 3][n % 3]
    seen = replace(PROBE, p_reference=X, p_WQ=np.tile(X, (PROBE.frames, 1, 1)), noise=2e-5)
    for deep, told in ((0, "0 of 120"), (5, "5 of 120"), (6, "it is read")):
        X[:deep] = 0.5 * (low + high) + 1e-4 * np.arange(deep)[:, None]
        write_recording(replace(seen, p_reference=X), tmp_path / "seen.h5")
        assert main(["diagnose", str(tmp_path / "seen.h5"), "--out", str(tmp_path / "o")]) == 2
        assert told in capsys.readouterr().err


def test_a_recording_that_is_too_short_is_told_of_by_its_name(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    forces = {"plate": replace(PROBE.forces["plate"], noise=0.1)}
    for frames, told in ((7, "short.h5: 7 frames: 8 or more"), (8, "it is read")):
        time, p_WQ = PROBE.time[:frames], PROBE.p_WQ[:frames]
        short = replace(PROBE, time=time, p_WQ=p_WQ, noise=2e-5, forces=forces)
        write_recording(short, tmp_path / "short.h5")
        assert main(["diagnose", str(tmp_path / "short.h5"), "--out", str(tmp_path / "o")]) == 2
        assert told in capsys.readouterr().err


def test_a_part_of_what_is_read_verifies_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    noise = 2e-5 * np.random.default_rng(0).standard_normal((2, *PROBE.p_WQ.shape))
    whole = replace(PROBE, p_WQ=PROBE.p_WQ + noise[0], noise=2e-5)
    paths, frames = [str(tmp_path / name) for name in ("press.h5", "part.h5")], PROBE.frames // 2
    write_recording(whole, tmp_path / "press.h5")
    for p_WQ, told in (
        (whole.p_WQ[frames:], "part.h5: the same motion as"),
        (PROBE.p_WQ[frames:] + noise[1, frames:], "it is read"),
    ):
        part = replace(whole, time=whole.time[frames:], p_WQ=p_WQ)
        write_recording(part, tmp_path / "part.h5")
        words = ["diagnose", paths[0], "--holdout", paths[1], "--out", str(tmp_path / "o")]
        assert main(words) == 2
        assert told in capsys.readouterr().err


def test_exact_tracks_need_a_noise_that_they_stand_for(tmp_path, monkeypatch, capsys):
    """Else what the grid has wrong would be taken for something missing."""
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    pressed, path = PROBE.p_WQ.copy(), tmp_path / "exact.h5"
    pressed[..., 2] *= PROBE.poses["plate"].value[:, 2, 3, None] / 0.02
    made = replace(PROBE, p_WQ=pressed)
    for noise, told in ((None, "seem exact"), (0.0, "seem exact"), (2e-5, "it is read")):
        write_recording(replace(made, noise=noise), path)
        assert main(["diagnose", str(path), "--out", str(tmp_path / "o")]) == 2
        assert told in capsys.readouterr().err


@pytest.mark.parametrize(("noise", "told"), [(None, "exact"), (0.0, "exact"), (1e-6, "is read")])
def test_exact_forces_need_a_noise_that_they_stand_for(noise, told, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    path, (tool,) = tmp_path / "exact.h5", PROBE.forces
    time = PROBE.forces[tool].time
    smooth = np.outer(np.sin(np.pi * time / time[-1]) ** 2, [0.0, 0.0, -1.0])
    felt = {tool: Stream(time, smooth, noise=noise)}
    write_recording(replace(PROBE, noise=2e-5, forces=felt), path)
    assert main(["diagnose", str(path), "--out", str(tmp_path / "o")]) == 2
    assert told in capsys.readouterr().err


def test_recordings_of_other_laws_are_no_probes_of_one_specimen(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", None)
    paths = [tmp_path / "press.h5", tmp_path / "other.h5"]
    laws = zip(paths, ("fixed-corotated", "yeoh"), (0.0, 1e-6), strict=True)
    for path, law, shift in laws:
        write_recording(replace(PROBE, law=law, p_WQ=PROBE.p_WQ + shift), path)
    assert main(["diagnose", *map(str, paths), "--out", str(tmp_path / "o")]) == 2
    assert "the recordings declare fixed-corotated and yeoh" in capsys.readouterr().err


def test_a_grid_as_coarse_as_the_body_is_a_mistake(tmp_path, monkeypatch, capsys):
    """As millimetres are, given for metres."""
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    write_recording(replace(PROBE, noise=2e-5), tmp_path / "press.h5")
    words = ["diagnose", str(tmp_path / "press.h5"), "--out", str(tmp_path / "o"), "--dx"]
    for dx, told in (("2.5", "dx 2.5 m: up to 0.005 m is wanted, a quarter"), ("0.005", "is read")):
        assert main([*words, dx]) == 2
        assert told in capsys.readouterr().err


def test_any_of_the_recordings_names_the_law(tmp_path, monkeypatch, capsys):
    def diagnosed(recordings, law, **how):
        raise ValueError(f"it is {law.name}")

    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", diagnosed)
    paths = [str(tmp_path / name) for name in ("one.h5", "other.h5")]
    for law, told in ((PROBE.law, f"it is {PROBE.law}"), (None, "no law is declared: name one")):
        for path, own, shift in zip(paths, (None, law), (0.0, 1e-6), strict=True):
            write_recording(replace(PROBE, law=own, p_WQ=PROBE.p_WQ + shift, noise=2e-5), path)
        assert main(["diagnose", *paths, "--out", str(tmp_path / "o")]) == 2
        assert told in capsys.readouterr().err


def test_recordings_to_be_read_state_as_much_in_python():
    seen = replace(PROBE, noise=2e-5, p_reference=None)
    with pytest.raises(ValueError, match="p_reference"):
        diagnosis([seen], LAW, effects=[], thresholds={}, dx=DX)


def test_a_box_in_millimetres_is_seen_as_such(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("form_drake.commands.diagnose.diagnosed", _read)
    box = {"shape": "box", "low": "-10 -10 0", "high": "10 10 20"}
    X, path = 1e3 * PROBE.reference, tmp_path / "press.h5"
    seen = replace(PROBE, geometry=box, p_WQ=1e3 * PROBE.p_WQ, p_reference=X, noise=0.02)
    write_recording(seen, path)
    assert main(["diagnose", str(path), "--out", str(tmp_path / "o")]) == 2
    assert "edges of 20, 20, 20 m: lengths are in metres; are these mill" in capsys.readouterr().err
