"""Contact under plates that do not hold what they press: a closed form, and forces where none is due."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from form_drake.diagnose import Model
from form_drake.diagnose.prepare import probe
from form_drake.diagnose.reading import ProbeReading
from form_drake.identify.problem import Problem
from form_drake.laws import LAWS
from form_drake.mpm.stage import Stage
from form_drake.records import Recording, Stream
from form_drake.weak.contact import OpenFields
from form_drake.weak.errors import noise as noise_of
from form_drake.weak.unknowns import Unknowns

LAW, TRUTH = LAWS["neo-hookean"], {"C10": 5e3, "kappa": 20e3}
EDGE, SECONDS, RATE = 0.02, 0.35, 120.0


def press(stroke):
    """A cube between smooth plates, of which one goes down by a stroke [m], rests, and goes off the cube."""
    rng = np.random.default_rng(0)
    X = np.array([-0.5, -0.5, 0.0]) * EDGE + EDGE * rng.uniform(0.04, 0.96, (150, 3))
    s = np.linspace(0.0, 1.0, round(RATE * SECONDS) + 1)
    pose = np.tile(np.eye(4), (len(s), 1, 1))
    down = np.sin(0.5 * np.pi * np.minimum(s / 0.5, 1.0)) ** 2
    up = 2.0 * np.clip((s - 0.7) / 0.2, 0.0, 1.0)
    pose[:, 2, 3] = EDGE - stroke * (down - up)
    time, p_WQ = SECONDS * s, np.tile(X, (len(s), 1, 1))
    p_WQ[:, :, 2] *= np.minimum(pose[:, 2, 3] / EDGE, 1.0)[:, None]
    p_WQ += 1e-6 * rng.standard_normal(p_WQ.shape)
    return Recording.from_arrays(
        time,
        p_WQ,
        p_reference=X,
        density=1000.0,
        gravity=np.zeros(3),
        geometry={"shape": "box", "low": "-0.01 -0.01 0", "high": "0.01 0.01 0.02"},
        contact={"z-": "frictionless floor", "z+": "frictionless plate", "other": "free"},
        poses={"plate": Stream(time, pose)},
        forces={"plate": Stream(time, np.zeros((len(s), 3)), noise=1e-3)},
        noise=1e-6,
        law=LAW.name,
    )


def uniaxial(stretch):
    """Force [N] on the cube and its stretch across, W = C10 (J^(-2/3) tr b - 3) + kappa (J - 1)^2 / 2."""

    def cauchy(own, across):
        J = stretch * across**2
        mean = (stretch**2 + 2.0 * across**2) / 3.0
        return 2.0 * TRUTH["C10"] * J ** (-5.0 / 3.0) * (own**2 - mean) + TRUTH["kappa"] * (J - 1.0)

    across = brentq(lambda a: cauchy(a, a), 0.9, 1.2)
    return cauchy(stretch, across) * (across * EDGE) ** 2, across


def test_a_block_between_smooth_plates_is_pressed_evenly():
    """By a tenth of its height, on which layers near the plates cross rows of nodes."""
    stage = Stage(press(0.1 * EDGE), EDGE / 5.0)
    made, motion = stage.moving(stage.world(Model(LAW, TRUTH).material(1000.0)))
    rests = (motion.time > 0.6 * SECONDS) & (motion.time < 0.68 * SECONDS)
    force, across = uniaxial(0.9)
    found = made.forces["plate"].value[rests, 2].mean()
    assert found == pytest.approx(-force, rel=2e-3)
    F = motion.F[rests]
    assert F[:, :, 2, 2].mean() == pytest.approx(0.9, abs=1e-3)
    assert F[:, :, 0, 0].mean() == pytest.approx(across, abs=1e-3)
    assert np.abs(F[:, :, 2, 2] - 0.9).max() < 5e-4
    assert np.abs(made.forces["plate"].value[-3:]).max() < 0.01 * abs(force)  # it has let go


def test_a_force_on_a_plate_that_is_off_is_seen_when_it_is():
    """However the windows' own times lie between the frames."""
    lifted = press(0.1 * EDGE)
    read = probe(lifted, "press", 0.004)
    (open_,) = (f for f in read.fields if isinstance(f, OpenFields))
    assert len(read.windows.time) != len(lifted.time)
    assert open_.names == ("across plate x", "across plate y", "off plate")
    kept = read.keep.reshape(len(read.windows), -1)[:, -1]
    first = SECONDS * 0.8  # the plate is back where it began
    assert np.array_equal(kept, read.windows.ends[:, 1] > first) and 0 < kept.sum() < len(kept)


def test_a_force_across_a_smooth_plate_is_one_that_it_should_not_feel():
    """Rows tell it along every axis, with noise of the force alone."""
    pressed = press(0.1 * EDGE)
    force = pressed.forces["plate"]
    pushed = replace(force, value=force.value + np.array([0.3, -0.2, 0.0]), noise=0.01)
    read = probe(replace(pressed, forces={"plate": pushed}), "press", 0.004)
    across = np.array(["across" in f for family in read.fields for f in family.names])
    rows = np.tile(across, len(read.windows))[read.keep]
    told = read.rest(read.along(read.motion), {})[rows].reshape(-1, 2)
    span = read.windows.chi.sum(axis=1)
    assert told == pytest.approx(np.outer(span, [-0.3, 0.2]), rel=1e-3)
    quiet = replace(read, forces={"plate": replace(read.forces["plate"], noise=0.0)})
    noise, none = (noise_of(p, LAW, TRUTH, LAW.theta(TRUTH)) for p in (read, quiet))
    assert np.diag(noise)[rows].min() > 0.0 and not none[np.ix_(rows, rows)].any()


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        (1e-5, r"they jitter by .* um, .* the noise of 10 um that is stated: state what there is"),
        (8e-3, "they are too few or too noisy"),
    ],
)
def test_tracks_that_fold_a_body_tell_of_noise_that_is_understated(stated, told):
    still = press(0.0)
    shaken = 8e-3 * np.random.default_rng(0).standard_normal(still.p_WQ.shape)
    made = replace(still, p_WQ=still.p_WQ + shaken, noise=stated)
    with pytest.raises(ValueError, match=f"folds the body: {told}"):
        probe(made, "press", 0.004)


def test_a_corner_that_folds_is_looked_at_and_no_more():
    """Of a bonded face displacements are told, and no stress: tracks inside tell least of its corners.

    Nor is there a stress for columns, which have a quadrature of their own.
    """
    still = press(0.0)
    x, y, z = (still.reference / EDGE + [0.5, 0.5, 0.0]).T
    turned = (
        0.43 * EDGE * x**5 * y**5 * (1.0 - z) ** 3
    )  # by -1.3 in the corner, and inside by less than -1
    p_WQ = still.p_WQ.copy()
    p_WQ[:, :, 2] += np.outer(np.linspace(0.0, 1.0, still.frames) ** 2, turned)
    contact = {"z-": "bonded floor", "z+": "bonded plate", "other": "free"}
    made = probe(replace(still, p_WQ=p_WQ, contact=contact, poses={}), "press", 0.004)
    corner = np.argmin(np.linalg.norm(made.motion.X - [0.01, 0.01, 0.0], axis=1))
    assert made.motion.x[-1, corner, 2] == pytest.approx(0.43 * EDGE, rel=0.05)
    inside = made.motion.volume > 0.0
    assert not inside[corner] and 0.0 < made.motion.J[-1, inside].min() < 0.4
    (reading,) = ProbeReading.of(Problem.of([made], Unknowns.of(LAW, {}, "law"), "row"), TRUTH)
    assert len(reading.X) > len(made.motion.X) and np.isfinite(reading.now()).all()
