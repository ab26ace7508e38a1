"""The inside of bodies of which one face is seen: closed forms, and motions of finite elements."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from form_drake import Recording, Stream, identify
from form_drake.bench.oracles import recorded, run
from form_drake.files import read_mapping
from form_drake.identify.options import WeakOptions
from form_drake.identify.posed import posed
from form_drake.interior import Path, Resistance, Seen, friction_of
from form_drake.interior.faces import carried
from form_drake.interior.path import FRICTIONS, _least
from form_drake.interior.resistance import Past
from form_drake.interior.rub import Rub, Rubbed
from form_drake.interior.statics import Statics
from form_drake.interior.tilt import SOFT, Odd
from form_drake.laws import law_named
from form_drake.material import Material
from form_drake.motion import Sampling, body
from form_drake.motion.body import FACES
from form_drake.motion.space import Symmetry
from form_drake.weak.choice import told_apart, while_pressed

LOW, HIGH = np.array([-0.015, -0.015, 0.0]), np.array([0.015, 0.015, 0.025])
POISSON, NOISE = 0.3, 1e-6


def on_face(axis, side, count=120, seed=0):
    """Points of one face of the block, drawn evenly."""
    X = np.random.default_rng(seed).uniform(LOW, HIGH, (count, 3))
    X[:, axis] = (LOW, HIGH)[side][axis]
    return X


def block(u, X, *, face, contact, seed=0, **more):
    """A recording of points of the block's surface with displacements u [frames, points, 3]."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(u.shape)
    return Recording.from_arrays(
        np.linspace(0.0, 1.0, len(u)),
        X + u + noise,
        face=np.full(len(X), face),
        noise=NOISE,
        density=1000.0,
        geometry={
            "shape": "box",
            "low": " ".join(map(str, LOW)),
            "high": " ".join(map(str, HIGH)),
            "symmetry": "x y xy",
        },
        contact=contact,
        **more,
    )


def stretched(X, lam):
    """Uniaxial stress of Hencky's elasticity along z from the bottom: lateral stretch lam^-nu."""
    return X * np.array([lam**-POISSON, lam**-POISSON, lam]) - X


def test_what_stands_behind_a_face_is_a_stretch_where_nothing_holds_its_sides():
    X, lam = on_face(0, 1), np.linspace(1.0, 0.8, 12)
    u = np.stack([stretched(X, f) for f in lam])
    made = block(
        u,
        X,
        face=1,
        contact={"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        p_reference=X,
        forces={
            "plate": Stream(np.linspace(0.0, 1.0, 50), np.linspace([0, 0, 0.0], [0, 0, 1], 50))
        },
    )
    law = law_named("von-mises")
    mu, lame = 1.0 / (2.0 * (1.0 + POISSON)), POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    material = Material(law, {"mu": 1e4 * mu, "lam": 1e4 * lame, "tau_y": 1e9})
    resistance = Resistance.of(material)
    looked = Seen.of(made, body(made))
    fit = Path.of(looked, resistance).fit()
    inside = np.random.default_rng(1).uniform(LOW, HIGH, (200, 3))
    motion = Sampling.of(fit, np.linspace(0.0, 1.0, 12), inside, np.ones(200), 1.0).motion(fit.c)
    wanted = np.stack([inside + stretched(inside, f) for f in lam])
    assert np.sqrt(np.mean((motion.x - wanted) ** 2)) < 2.0 * NOISE
    off = motion.F[-1] - np.diag([0.8**-POISSON, 0.8**-POISSON, 0.8])
    assert np.sqrt(np.mean(off**2)) < 6e-4
    # the plate pushes as it must: points that weigh next to nothing need not hold the block down
    fit = Path.of(replace(looked, sd=100.0 * NOISE), resistance).fit()
    motion = Sampling.of(fit, np.linspace(0.0, 1.0, 12), inside, np.ones(200), 1.0).motion(fit.c)
    assert np.sqrt(np.mean((motion.x - wanted) ** 2)) < 2.0 * NOISE


def test_points_that_are_hidden_for_long_tell_nothing_and_spoil_nothing():
    X, share = on_face(0, 1), np.linspace(0.0, 1.0, 16)
    u = np.stack([stretched(X, 1.0 - 0.1 * s**2) for s in share])
    contact = {"z-": "frictionless floor", "other": "free"}
    made = block(u, X, face=1, contact=contact, p_reference=X)
    corner = (X / HIGH).sum(axis=1) < np.quantile((X / HIGH).sum(axis=1), 0.2)
    valid = ~np.outer((share > 0.2) & (share < 0.6), corner)
    some, whole = (Seen.of(r, body(made)) for r in (replace(made, valid=valid), made))
    # what fills them are lines from where they were to where they are
    assert np.abs(some.u - u)[~valid].max() > 50.0 * NOISE
    assert some.sd < 1.2 * whole.sd and some.space.size == whole.space.size


@pytest.mark.parametrize(
    "course",
    [np.linspace(0.0, 1.0, 12), [0.0, 0.25, 0.5, 0.75, 1.0, 0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 1.0]],
    ids=["once", "twice"],
)
def test_a_plate_that_tilts_is_not_taken_for_one_that_presses_harder(course):
    """Uniaxial stress and bending along z: smooth plates keep their planes, of which one turns about y."""
    X, time, high = on_face(0, 1), np.linspace(0.0, 1.0, 12), HIGH[2]

    def bent(X, press, turn):
        x, y, z = X.T
        k = turn / high
        across = POISSON * press * X * np.array([1.0, 1.0, 0.0])
        u = [k * (z**2 + POISSON * (x**2 - y**2)) / 2, k * POISSON * x * y, -k * x * z]
        return across - press * X * np.array([0.0, 0.0, 1.0]) + np.stack(u, axis=1)

    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(
        np.outer(1e-3 * np.array(course), [0, 1, 0])
    ).as_matrix()
    made = block(
        np.stack([bent(X, 5e-3 * t, 1e-3 * t) for t in course]),
        X,
        face=1,
        contact={"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        p_reference=X,
        forces={"plate": Stream(time, np.outer(course, [0.0, 0.0, 1.0]))},
        poses={"plate": Stream(time, poses)},
    )
    looked, plain = Seen.of(made, body(made)), Resistance.plain(POISSON)
    held = Path.of(looked, plain)
    levelled = Path.of(looked, plain, held.friction, held)
    inside = np.random.default_rng(1).uniform(LOW, HIGH, (200, 3))
    wanted = np.stack([bent(inside, 5e-3 * t, 0.0) for t in course])
    rms = []
    for path in (held, levelled):  # frame by frame: splines in time follow no jump
        u = path.statics.values(inside) @ np.transpose([frame.y for frame in path.frames])
        rms.append(np.sqrt(np.mean((u.transpose(2, 0, 1) - wanted) ** 2)))
    assert rms[0] > 2e-6 and rms[1] < 0.5e-6


def test_points_that_go_where_no_body_can_are_refused_before_all_frames_are_tried():
    X, down = on_face(0, 1, 30), np.where(np.arange(20) % 2, 1.0, 0.0)
    to_the_floor = np.outer(down, X[:, 2])[..., None] * np.array([0.0, 0.0, -1.0])
    made = block(
        to_the_floor, X, face=1, contact={"z-": "bonded floor", "other": "free"}, p_reference=X
    )
    with pytest.raises(
        ValueError, match=r"in 3 of [4-9] frames no motion .* are the faces held as"
    ):
        Path.of(Seen.of(made, body(made)), Resistance.plain(POISSON), friction=np.inf)


def test_points_that_lie_off_their_face_together_are_moved_onto_it():
    """Cameras that have turned since they were calibrated see a body nearer or farther away."""
    X, lam = on_face(0, 1), np.linspace(1.0, 0.8, 12)
    u = np.stack([stretched(X, f) for f in lam])
    contact = {"z-": "frictionless floor", "other": "free"}
    made = block(u, X, face=1, contact=contact, p_reference=X)

    def moved(by):
        away = by * np.array([1.0, 0.0, 0.0])
        return replace(made, p_WQ=made.p_WQ + away, p_reference=X + away)

    one, other = (Seen.of(r, body(r)) for r in (made, moved(2e-3)))
    np.testing.assert_allclose(other.X, one.X, atol=1e-9)
    np.testing.assert_allclose(other.u, one.u, atol=1e-9)
    with pytest.raises(ValueError, match=r"face x\+ lie 4 mm off .* 3 mm are allowed: is the box"):
        Seen.of(moved(4e-3), body(made))
    with pytest.raises(ValueError, match="millimetres"):
        Seen.of(replace(made, p_WQ=1e3 * made.p_WQ, p_reference=1e3 * X), body(made))


def test_what_a_turn_adds_finds_resistance_where_a_body_flows():
    """Forces of a block that is pressed beyond its yield by a quarter fall where it gives way."""
    X, law = on_face(0, 1), law_named("von-mises")
    made = block(
        np.zeros((8, len(X), 3)),
        X,
        face=1,
        contact={"z-": "bonded floor", "z+": "frictionless plate", "other": "free"},
        p_reference=X,
    )
    seen, values = Seen.of(made, body(made)), {"mu": 3e4, "lam": 4.5e4, "tau_y": 900.0}
    statics = Statics(seen.space, seen.body, Resistance.of(Material(law, values)), seen.force)
    odd = Odd(statics, 0, seen.holds, 0.1)
    inside = np.random.default_rng(0).uniform(LOW, HIGH, (400, 3))
    D, frames = statics.values(inside).reshape(-1, statics.space.size), [statics.rest]
    for press in np.linspace(0.02, 0.25, 12):
        pressed = inside * (
            np.array([(1.0 - press) ** -0.5, (1.0 - press) ** -0.5, 1.0 - press]) - 1
        )
        y, last = np.linalg.lstsq(D, pressed.ravel(), rcond=None)[0], frames[-1]
        frames.append(replace(last, y=y, past=statics.forces(y, [], last).past))
    rest, flows = odd._rest @ odd._rest.T, odd.stiffness(frames[-1], frames[-2])
    slope = odd._slope(frames[-1], frames[-2])
    assert eigh(slope, rest, eigvals_only=True)[0] < 0.0
    share, ways = eigh(flows, rest)
    assert share[0] == pytest.approx(SOFT, rel=1e-6)
    stiff = ways[:, share > 1.1 * SOFT]  # elsewhere it is as the law has it
    np.testing.assert_allclose(
        flows @ stiff, slope @ stiff, atol=1e-6 * np.abs(slope @ stiff).max()
    )


@pytest.mark.parametrize(
    ("nu", "waves"), [(POISSON, 0.0), (POISSON, 3e-6), (0.45, 0.0)], ids=["noise", "waves", "law"]
)
def test_how_far_off_the_inside_may_be_is_told(nu, waves):
    """Noise, errors of points that come and go as they move, as of a tracker, and a law that is not theirs."""
    X, lam, rng = on_face(0, 1), np.linspace(1.0, 0.8, 24), np.random.default_rng(0)
    u = np.stack([stretched(X, f) for f in lam])
    phase = rng.uniform(0.0, 2.0 * np.pi, X.shape)
    made = block(
        u + waves * (np.sin(2.0 * np.pi * u / 2e-4 + phase) - np.sin(phase)),
        X,
        face=1,
        contact={"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        p_reference=X,
        forces={
            "plate": Stream(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
        },
    )
    fit = Path.of(Seen.of(made, body(made)), Resistance.plain(nu)).fit()
    inside, time = rng.uniform(LOW, HIGH, (200, 3)), np.linspace(0.0, 1.0, 24)
    motion = Sampling.of(fit, time, inside, np.ones(200), 1.0).motion(fit.c)
    off = motion.x - np.stack([inside + stretched(inside, f) for f in lam])
    told = np.stack([fit.deviation(t, inside) for t in time])
    assert 0.4 < np.sqrt(np.mean(off**2) / np.mean(told**2)) < 2.5


def test_windows_in_which_a_body_stands_still_count_once():
    X = on_face(0, 1)
    share = np.interp(np.arange(48), [0, 16, 32, 47], [0.0, 0.0, 1.0, 1.0])
    lam = 1.0 - 0.05 * (1.0 - np.cos(np.pi * share))
    made = block(
        np.stack([stretched(X, f) for f in lam]),
        X,
        face=1,
        contact={"z-": "frictionless floor", "other": "free"},
        p_reference=X,
    )
    fit = Path.of(Seen.of(made, body(made)), Resistance.plain(POISSON)).fit()
    begin = np.arange(0.0, 0.9, 0.05)
    ends = np.stack([begin, begin + 0.1], axis=1)
    middle = told_apart(ends, made, fit).mean(axis=1)
    assert 16 / 47 < middle[0] <= 0.45  # after it has begun to move
    assert middle[-1] <= 32 / 47 + 0.05  # and one after it has stopped
    assert np.allclose(np.diff(middle), 0.05)


def let_go(u, X, noise=0.0, **more):
    """A plate presses from .3 to .62 s; what is left of its force, and noise, is no pressing."""
    time = np.linspace(0.0, 1.0, 400)
    push = np.outer(np.where((time > 0.3) & (time < 0.62), 1.0, 0.005), [0.0, 0.0, 1.0])
    push += noise * np.random.default_rng(0).standard_normal(push.shape)
    return block(
        u,
        X,
        face=1,
        contact={"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        forces={"plate": Stream(time, push, noise=noise)},
        **more,
    )


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_windows_count_until_the_tool_lets_go(noise):
    X = on_face(0, 1)
    made = let_go(np.zeros((48, *X.shape)), X, noise)
    begin = np.arange(0.0, 0.9, 0.05)
    ends = np.stack([begin, begin + 0.1], axis=1)
    kept = while_pressed(ends, made, body(made))
    assert kept[0, 1] == pytest.approx(0.35) and kept[-1, 1] == pytest.approx(0.6)
    assert np.array_equal(
        while_pressed(ends[-3:], made, body(made)), ends[-3:]
    )  # nothing presses in any
    assert np.array_equal(while_pressed(ends, replace(made, forces={}), body(made)), ends)


@pytest.mark.parametrize("most", [2000, 12])
def test_windows_that_are_fewer_are_still_those_that_tell(most, monkeypatch):
    monkeypatch.setattr("form_drake.weak.choice.MOST_ROWS", most)
    X, time = on_face(0, 1), np.linspace(0.0, 1.0, 96)
    lam = np.interp(time, [0.3, 0.6, 0.62, 0.7], [1.0, 0.9, 0.9, 0.97])
    made = let_go(np.stack([stretched(X, f) for f in lam]), X, p_reference=X)
    shape = body(made)
    fit = Path.of(Seen.of(made, shape), Resistance.plain(POISSON)).fit()
    law, options = law_named("von-mises"), WeakOptions(window=0.1)
    problem = posed([made], law, {"nu": POISSON}, [options], lambda *_: (shape, fit))
    (probe,) = problem.probes
    ends = probe.windows.ends
    assert len(ends) == {2000: 6, 12: 4}[most] and np.allclose(np.diff(ends), 0.1)
    assert ends[0, 1] > 0.3 and ends[-1, 1] < 0.63


def test_a_weight_across_a_mirror_moves_nothing():
    X = on_face(0, 1)
    made = block(
        np.zeros((8, *X.shape)),
        X,
        face=1,
        contact={"z-": "frictionless floor", "other": "free"},
        p_reference=X,
        gravity=(5.0, 0.0, 0.0),
    )
    material = Material(
        law_named("von-mises"), {"mu": 4e3, "lam": 6e3, "tau_y": 1e9}, density=1000.0
    )
    path = Path.of(Seen.of(made, body(made)), Resistance.of(material))
    inside = np.random.default_rng(1).uniform(LOW, HIGH, (200, 3))
    assert np.abs(path.statics.values(inside) @ path.frames[-1].y).max() < 2.0 * NOISE


def test_axes_of_unlike_sides_do_not_change_places():
    X = on_face(0, 1)
    made = block(np.zeros((8, *X.shape)), X, face=1, contact={"other": "free"}, p_reference=X)
    long = replace(made, geometry={**made.geometry, "low": "-0.015 -0.0148 0"})
    with pytest.raises(ValueError, match=r"symmetry xy: the box is 0\.03 m along x and 0\.0298 m"):
        Seen.of(long, body(long))


def test_a_point_sticks_until_it_is_rubbed_as_hard_as_it_can_be_and_slides_then():
    along, inward = np.eye(2)[None], np.array([[1.0, 0.0]])
    rub = Rub(face=0, along=along, inward=inward, friction=0.3)
    before = Rubbed(np.array([[5.0, 0.0]]), np.array([10.0]))
    left, _, force = rub.answer(np.array([0.0, -1e-9]), before)
    assert np.allclose(force, [[5.0, 1.0]]) and np.allclose(left, -force[0])
    step = np.array([-3e-8, -4e-8])
    left, slope, force = rub.answer(step, before)
    assert np.linalg.norm(force) == pytest.approx(10.0)  # the way it is pushed, no harder
    assert force[0, 1] / force[0, 0] == pytest.approx(40.0 / 35.0)
    ends = [rub.answer(step + d, before)[0] for d in 1e-12 * np.eye(2)]
    assert np.allclose(slope, (np.array(ends) - left).T / 1e-12, rtol=1e-3, atol=1e3)
    assert rub.after(force, np.array([20.0, 0.0])).most == pytest.approx([6.0])
    assert rub.after(force, np.array([-20.0, 0.0])).most == pytest.approx([0.0])


def test_a_tool_is_where_it_was_between_the_stamps_of_a_log_of_its_own():
    X, time = on_face(0, 1), np.linspace(2.0, 3.0, 25)
    clock = np.arange(1.5, 3.2, 0.04)  # begun before the first frame, and at other times

    def placed(t):
        angle = 0.02 * np.sin(2.0 * np.pi * t)
        X_WT = np.tile(np.eye(4), (len(t), 1, 1))
        X_WT[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * np.eye(3)[1]).as_matrix()
        X_WT[:, 0, 3] = 3e-3 * np.sin(2.0 * np.pi * t + 1.0)
        return X_WT

    made = replace(
        block(np.zeros((25, *X.shape)), X, face=1, contact={"z-": "bonded base"}, p_reference=X),
        time=time,
        poses={"base": Stream(clock, placed(clock))},
    )
    X_WT = placed(time)
    p_TX = (X - X_WT[0, :3, 3]) @ X_WT[0, :3, :3]
    wanted = p_TX @ X_WT[:, :3, :3].swapaxes(1, 2) + X_WT[:, None, :3, 3] - X
    assert np.abs(carried(made, "base", X) - wanted).max() < 2e-7
    still = replace(made, poses={"base": Stream(clock[:1], placed(clock[:1]))})
    assert np.abs(carried(still, "base", X)).max() < 1e-15


def test_friction_is_bounded_by_the_pressure_that_there_is_however_long_a_step():
    def base(steps):
        """How far a floor lets the bottom of a block slide that a plate has pressed, in some steps."""
        X, time = on_face(0, 1, 60), np.linspace(0.0, 1.0, 9)
        pose = np.tile(np.eye(4), (9, 1, 1))
        pose[:, 2, 3] = -5e-4 * np.minimum(1.0, np.arange(9) / steps)
        made = block(
            np.zeros((9, *X.shape)),
            X,
            face=1,
            contact={"z-": "bonded floor", "z+": "bonded plate", "other": "free"},
            p_reference=X,
            poses={"plate": Stream(time, pose)},
        )
        free = replace(Seen.of(made, body(made)), sd=1.0)  # nothing but balance tells
        path = Path.of(free, Resistance.plain(POISSON), 0.2)
        corner = path.statics.values(HIGH * np.array([[1.0, 1.0, 0.0]]))[0]
        return (corner @ path.frames[-1].y)[0]

    assert base(1) == pytest.approx(base(8), rel=0.03)
    assert base(1) < 0.8 * 5e-4 * POISSON * HIGH[0] / HIGH[2]  # as it slides without friction


def test_nothing_is_concluded_from_what_a_drift_could_have_made():
    X = on_face(0, 1)
    u = np.stack([stretched(X, f) for f in np.linspace(1.0, 0.9, 8)])
    made = block(u, X, face=1, contact={"z-": "frictionless floor"}, p_reference=X)
    looked, rng = Seen.of(made, body(made)), np.random.default_rng(0)
    valid = rng.uniform(size=len(X)) < 0.7
    white = rng.standard_normal((int(valid.sum()), 3, 2))
    drift = looked.whitening[valid] @ np.array([[1.0], [2.0], [0.0]])
    left = looked.undrifted(white, valid)
    assert np.allclose(looked.undrifted(white + drift, valid), left)
    assert np.allclose(looked.undrifted(drift, valid), 0.0)
    assert np.allclose(left[:, 2], white[:, 2])  # along z nothing is mirrored


def test_a_body_that_sags_is_found_free_of_stress():
    E, X = 3e3, on_face(0, 1)
    weigh = 1000.0 * 9.81 / E
    sag = np.zeros_like(X)  # under its own weight on a smooth floor, to first order in strain
    sag[:, 2] = -weigh * (HIGH[2] * X[:, 2] - 0.5 * X[:, 2] ** 2)
    sag[:, 2] -= 0.5 * POISSON * weigh * np.sum(X[:, :2] ** 2, axis=1)
    sag[:, :2] = POISSON * weigh * (HIGH[2] - X[:, 2:]) * X[:, :2]
    first = X + sag
    still = np.repeat(np.zeros_like(X)[None], 12, axis=0)
    made = block(
        still,
        first,
        face=1,
        contact={"z-": "frictionless floor", "other": "free"},
        gravity=[0.0, 0.0, -9.81],
    )
    values = {"mu": E / 2.6, "lam": E * 0.3 / (1.3 * 0.4)}
    resistance = Resistance.of(Material(law_named("fixed-corotated"), values))
    fit = Path.of(Seen.of(made, body(made)), resistance).fit()
    motion = Sampling.of(fit, np.array([0.5]), X, np.ones(len(X)), 1.0).motion(fit.c)
    size = np.abs(sag).max()
    off = motion.x[0] - first  # no frame shows it
    assert np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)) < 0.05 * size


def test_the_slope_of_a_stress_is_its_derivative_and_turning_stresses_nothing():
    rng = np.random.default_rng(0)
    law = law_named("von-mises")
    resistance = Resistance.of(Material(law, {"mu": 2e4, "lam": 3e4, "tau_y": 400.0}))
    first = np.eye(3) + 0.03 * rng.standard_normal((5, 3, 3))
    past = Past(first, resistance.answer(first, Past.none(5))[1])
    F = first + 1e-3 * rng.standard_normal((5, 3, 3))
    push = 1e-6 * rng.standard_normal((5, 3, 3))
    elastic, slope = resistance.answer(F, past)[1], resistance.slope(F, past)
    ends = [resistance.answer(F + s * push, past)[0] for s in (1.0, -1.0)]
    still = resistance.answer(past.F, past)[1]
    assert not np.allclose(elastic @ np.linalg.inv(F), still @ np.linalg.inv(past.F), atol=1e-5)
    found = np.einsum("pij,pj->pi", slope, push.reshape(5, 9))
    assert np.allclose(found, 0.5 * (ends[0] - ends[1]).reshape(5, 9), rtol=1e-3, atol=1e-9)
    assert not np.allclose(elastic, F, atol=1e-3)  # it has yielded
    Q = np.linalg.qr(rng.standard_normal((5, 3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))[:, None, None]
    assert np.abs(Resistance.plain(0.4).answer(Q, Past.none(5))[0]).max() < 1e-9


@pytest.mark.parametrize("words", ["w", "xy", "x y xyz", "x y z xy yz", "xx"])
def test_symmetries_are_stated_in_words_that_make_sense(words):
    with pytest.raises(ValueError, match="symmetry"):
        Symmetry.stated(words)


def seen(folder, case, face, box, symmetry, contact, stride, noise=3e-6):
    """A face of a finite element motion, seen with noise, and the truth."""
    hangs = case.startswith("bend")  # at rest at first, under its weight, which no frame shows
    words = ["--mesh", "coarse", "--face", FACES[face], *["--gravity"] * hangs]
    run("finite_elements.py", case, *words, "--out", folder)
    every, truth = recorded(folder / case), read_mapping(folder / f"{case}.truth.json")
    own = every.p_reference[:, 2] < box[1][2]
    p_WQ = every.p_WQ[::stride][:, own]
    low, high = (" ".join(map(str, corner)) for corner in box)
    made = replace(
        every,
        time=every.time[::stride],
        p_WQ=p_WQ + noise * np.random.default_rng(0).standard_normal(p_WQ.shape),
        p_reference=None if hangs else every.p_reference[own],
        face=np.full(int(own.sum()), face),
        noise=noise,
        geometry={"shape": "box", "low": low, "high": high, "symmetry": symmetry},
        contact={**contact, "other": "free"},
        poses={k: v for k, v in every.poses.items() if k in every.forces},
        known={"nu": truth["nu"]},
    )
    return made, truth


def test_one_face_of_a_bent_strip_gives_its_stiffness(tmp_path):
    box = [(-0.006, -0.002, 0.0), (0.006, 0.002, 0.085)]
    contact = {"z+": "bonded clamp", "x+": "touched pusher"}
    made, truth = seen(tmp_path, "bend-touching-a", 2, box, "y", contact, 4)
    answer = identify(made)
    E = answer.material.parameters()["E"]
    assert E.value == pytest.approx(truth["E"], rel=7e-3)
    assert abs(E.value - truth["E"]) < 3.0 * E.std
    assert answer.details["passes_inside"] > 1
    with pytest.raises(ValueError, match="twin"):
        identify(made, method="weak", twin=lambda values: made)
    with pytest.raises(ValueError, match=r"y- is seen and y\+ is not"):
        identify(replace(made, geometry={**made.geometry, "symmetry": ""}))
    with pytest.raises(ValueError, match="points/face"):
        identify(replace(made, face=None))
    with pytest.raises(ValueError, match="newtonian does not resist shear at rest"):
        identify(replace(made, known={}), "newtonian")


def test_a_face_that_is_stated_bonded_and_slides_freely_has_no_friction():
    X = on_face(0, 1, 60)
    u = np.stack([stretched(X, f) for f in np.linspace(1.0, 0.9, 8)])
    made = block(u, X, face=1, contact={"z-": "bonded floor", "other": "free"}, p_reference=X)
    assert friction_of(Seen.of(made, body(made)), Resistance.plain(POISSON)) < 0.02


@pytest.mark.parametrize("true", [0.0, 0.03, 0.1, 0.25, 0.37, 0.6, 2.0])
def test_the_least_is_found_wherever_it_lies(true):
    tried = []

    def off(friction):
        tried.append(friction)
        return np.log(0.01 + (friction - true) ** 2)  # as the logarithm of a misfit beside noise

    value, least = _least(off, FRICTIONS)
    assert value == min([off(f) for f in list(tried)])
    assert least == pytest.approx(min(true, FRICTIONS[-1]), rel=0.1, abs=0.02)
    assert len(set(tried)) <= 6 and (true > 0.2 or max(tried) <= 0.4)


@pytest.mark.parametrize("true", [0.09, 0.098, 0.105, 0.11])
def test_a_sharp_least_pulls_no_parabola_aside(true):
    """As where friction tells much: the misfit between two places that were tried is a cusp."""
    least = _least(lambda friction: float(np.log(1e-5 + (friction - true) ** 2)), FRICTIONS)[1]
    assert least == pytest.approx(true, abs=0.012)


def test_one_face_of_a_pressed_block_gives_stiffness_and_yield(tmp_path):
    contact = {"z-": "frictionless floor", "z+": "frictionless plate"}
    made, truth = seen(tmp_path, "press-a", 1, [LOW, HIGH], "x y xy", contact, 4, 1e-5)
    answer = identify(made)
    found = answer.material.parameters()
    first = answer.details["before_law_inside"]
    for key in ("E", "tau_y"):
        assert found[key].value == pytest.approx(truth[key], rel=1e-2)
    # any elasticity inside would not do: the law's own must take its place
    assert max(abs(first[key] / truth[key] - 1.0) for key in ("E", "tau_y")) > 1e-2
