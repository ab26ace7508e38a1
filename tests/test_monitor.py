"""A monitor in a diagram: silent while all goes as predicted, an alarm where it does not."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from form_drake.diagnose import Cause, Model, Scenes
from form_drake.diagnose.motions import Block, noisy
from form_drake.diagnose.watch import Watch
from form_drake.effects import CATALOGUE
from form_drake.laws import LAWS
from form_drake.records import Stream
from form_drake.systems.monitor import Monitor

BLOCK = Block(size=(0.02, 0.02, 0.02), points=60)
MODEL = Model(LAWS[BLOCK.law], {"C10": 8e3, "kappa": 40e3})
PLAN, DX = BLOCK.press("bonded", 0.6), 0.004


class Camera(LeafSystem):
    """Tells of a recording what was measured until now."""

    def __init__(self, whole):
        super().__init__()
        self._whole = whole
        self.DeclareAbstractOutputPort("recording", lambda: Value[object](None), self._tell)

    def _tell(self, context, out):
        now = context.get_time() + 1e-9
        count = int(np.sum(self._whole.time <= now))
        forces = {}
        for tool, stream in self._whole.forces.items():
            own = stream.time <= now
            forces[tool] = Stream(stream.time[own], stream.value[own], noise=stream.noise)
        seen = replace(self._whole, time=self._whole.time[:count], p_WQ=self._whole.p_WQ[:count])
        out.set_value(replace(seen, forces=forces) if count > 3 else None)


@pytest.fixture(scope="module")
def watch():
    return Watch.of(PLAN, MODEL, DX)


def watched(watch, *causes, model=MODEL):
    """The alarm, when it came, and the last excess, of a probe of a body with effects."""
    (made,) = Scenes.of((PLAN,), DX / 1.5).rolled(replace(model, causes=causes))
    builder, told = DiagramBuilder(), []
    camera = builder.AddSystem(Camera(noisy(made, np.random.default_rng(1))))
    monitor = builder.AddSystem(Monitor(watch, told=told.append))
    builder.Connect(camera.get_output_port(), monitor.get_input_port())
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.6)
    own = monitor.GetMyContextFromRoot(simulator.get_context())
    alarm = monitor.GetOutputPort("alarm").Eval(own)
    assert told == ([alarm] if alarm else [])
    return alarm, monitor.GetOutputPort("excess").Eval(own)


def test_a_monitor_is_silent_while_all_goes_as_predicted(watch):
    alarm, excess = watched(watch)
    assert alarm is None and excess.shape == (2,) and np.all(excess < 1.0)


def test_a_force_that_is_not_as_predicted_raises_an_alarm_of_its_own(watch):
    alarm, excess = watched(watch, Cause(CATALOGUE["force-gain"], 0.2, {}))
    assert alarm.channel == "force of plate" and alarm.where == ()
    assert 0.1 <= alarm.time < 0.5  # there is no force before the plate has moved
    assert excess[0] < 1.0 < excess[1]
    assert "force of plate not as predicted" in str(alarm)


@pytest.mark.parametrize("frame", [6, 7])
def test_one_bad_frame_raises_no_alarm(watch, frame):
    """Also one on the end of a window: it is in one of them."""
    made = noisy(watch.predicted, np.random.default_rng(7))
    made.p_WQ[frame] += 2e-3
    own = watch.excess(made)["tracks"][1]
    assert watch.alarm(made) is None and np.sum(own > 1.0) == 1


def test_tracks_that_are_not_as_predicted_tell_where_and_when(watch):
    high = watch.predicted.reference[:, 2] > 0.014
    late = watch.predicted.time > 0.3
    p_WQ = watch.predicted.p_WQ + 1e-3 * (late[:, None] & high)[:, :, None] * np.array(
        [1.0, 0.0, 0.0]
    )
    made = noisy(replace(watch.predicted, p_WQ=p_WQ), np.random.default_rng(2))
    alarm = watch.alarm(made)
    assert alarm.channel == "tracks" and alarm.time == pytest.approx(0.3)
    assert alarm.where[2] > 0.014 and "mm not as predicted" in str(alarm)
    excess = {name: sizes for name, (_, sizes) in watch.excess(made).items()}
    assert np.all(excess["tracks"][:3] < 1.0) and np.all(excess["tracks"][3:] > 1.0)
    assert np.all(excess["force of plate"] < 1.0)


def test_a_force_whose_noise_cannot_be_told_yet_raises_no_alarm(watch):
    """Eleven samples leave no jitter to measure: a noise of none would make all of it a deviation."""
    made = noisy(watch.predicted, np.random.default_rng(6))
    for count, off in ((11, 0.0), (24, 0.0), (24, 0.5)):
        felt = {}
        for tool, seen in made.forces.items():
            stamps = np.linspace(0.0, 0.25, count)
            value = np.stack([np.interp(stamps, seen.time, v) for v in seen.value.T], axis=1)
            felt[tool] = Stream(stamps, value + off)
        alarm = watch.alarm(replace(made, forces=felt))
        assert (alarm is not None) == (off > 0.0)


def test_points_that_are_lost_raise_no_alarm(watch):
    made = noisy(watch.predicted, np.random.default_rng(3))
    valid = np.random.default_rng(4).random(made.p_WQ.shape[:2]) > 0.1
    lost = replace(made, p_WQ=np.where(valid[..., None], made.p_WQ, 0.0), valid=valid)
    assert watch.alarm(lost) is None
    valid = np.arange(made.frames)[:, None] % 4 > 0  # of its noise nothing can be told
    seldom = replace(made, valid=np.broadcast_to(valid, made.p_WQ.shape[:2]), noise=None)
    assert np.isnan(watch.excess(seldom)["tracks"][1]).all()


def test_tracks_that_state_no_reference_are_held_against_the_plans(watch):
    """Not against the first frame, in which the body has sunk under its weight."""
    made = noisy(watch.predicted, np.random.default_rng(5))
    assert watch.alarm(replace(made, p_reference=None)) is None
    first = np.ones(made.p_WQ.shape[:2], bool)
    first[0, :9] = False  # and what is lost in the first frame alone is compared
    told = watch.excess(replace(made, p_reference=None, valid=first))["tracks"][1]
    assert told == pytest.approx(watch.excess(replace(made, valid=first))["tracks"][1])


def test_nothing_is_as_predicted_where_nothing_is_compared(watch):
    """Neither beyond the end of the plan, nor on another clock, nor before the first whole window."""
    made = noisy(watch.predicted, np.random.default_rng(8))
    time, (force,) = made.time, made.forces.values()

    def later(by):
        own = replace(force, time=force.time + by)
        return replace(made, time=time + by, forces=dict.fromkeys(made.forces, own))

    with pytest.raises(ValueError, match=r"begins at 1[.]5 s, the prediction ends at 0[.]6 s"):
        watch.look(later(1.5))
    seen = watch.excess(later(0.35))
    for ends, excess in seen.values():
        assert np.isfinite(excess).tolist() == (ends < 0.7).tolist() and np.isnan(excess).any()
    builder = DiagramBuilder()
    monitor = builder.AddSystem(Monitor(watch))
    camera = builder.AddSystem(Camera(made))
    builder.Connect(camera.get_output_port(), monitor.get_input_port())
    context = builder.Build().CreateDefaultContext()
    own = monitor.GetMyContextFromRoot(context)
    assert np.isnan(monitor.GetOutputPort("excess").Eval(own)).all()


def test_other_points_than_the_predicted_ones_are_refused(watch):
    few = replace(
        watch.predicted,
        p_WQ=watch.predicted.p_WQ[:, :9],
        p_reference=watch.predicted.reference[:9],
    )
    with pytest.raises(ValueError, match="9 points are tracked, 60 are predicted"):
        watch.excess(few)
    with pytest.raises(ValueError, match="no force of plate is measured"):
        watch.excess(replace(watch.predicted, forces={}))
