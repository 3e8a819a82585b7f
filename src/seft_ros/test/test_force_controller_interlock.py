import math

import numpy as np
import pytest
from experiments_at_hand import load
from interlocks_at_hand import (
    AXES,
    DT,
    LIMIT,
    NO_LIMITS,
    Scripted,
    left,
    of_rig,
    sample_of,
    stepped,
    target_of,
    tracking,
    watched,
)
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.judge.judge_step import LONG_AGO
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.interlock import Interlock, interlock_of
from seft_ros.protection.protected_force import extrapolated


def interlock(gain=1.0, longest_saturation=0.5, has_valve=True, limits=NO_LIMITS):
    controller = ForceController([([gain], [1.0])] * len(AXES), LIMIT, DT)
    ends = longest_saturation, 0.0, limits, tracking(has_valve=has_valve)
    return Interlock(controller, AXES, *ends, DT)


def state(east=0.0, north=0.0):
    found = np.zeros((4, 2))
    found[3] = east, north
    return found


def force(east, north):
    return np.array([[[east, north]]])


def test_it_is_the_controller_itself_while_all_is_well():
    guarded, bare = interlock(), ForceController([([1.0], [1.0])] * 2, LIMIT, DT)
    rng = np.random.default_rng(1)
    for step in range(200):
        asked, measured = force(*rng.uniform(-900, 900, 2)), state(*rng.uniform(-900, 900, 2))
        expected = bare.step(asked, measured)
        np.testing.assert_array_equal(stepped(guarded, step * 1000, asked, measured), expected)
    assert guarded.reason == ""
    assert guarded.step_index == -1
    assert guarded.kind == interlock().kind is not None


def test_a_controller_of_forces_follows_the_force_of_a_target():
    guarded, bare = interlock(), ForceController([([1.0], [1.0])] * 2, LIMIT, DT)
    for step, asked in enumerate(np.random.default_rng(1).normal(0.0, 300.0, (50, 1, 1, 2))):
        target = np.concatenate([np.full((1, 2, 2), 1e-3), asked], axis=1)
        expected = bare.step(asked, state())
        np.testing.assert_array_equal(stepped(guarded, step * 1000, target, state()), expected)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_never_gets_into_the_recursion(value):
    guarded = interlock()
    np.testing.assert_array_equal(stepped(guarded, 7, force(1.0, value), state()), [0.0, 0.0])
    assert guarded.reason == f"reference force is {value} N on axis north"
    assert guarded.step_index == 7
    np.testing.assert_array_equal(stepped(guarded, 8, force(1.0, 1.0), state()), [0.0, 0.0])
    guarded.reset()
    np.testing.assert_array_equal(stepped(guarded, 0, force(1.0, 1.0), state()), [1.0, 1.0])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_a_judged_sample_beyond_a_limit_trips(row, axis):
    limits, unit = (0.25, 0.5, 20.0, 5000.0), ("m", "m/s", "m/s^2", "N")[row]
    guarded = Interlock(Scripted(1, 1), AXES, 0.5, 0.0, limits, tracking(), DT)
    raw = np.zeros((4, 2))
    raw[row, axis] = limits[row]
    assert np.any(stepped(guarded, 0, force(0.0, 0.0), raw))
    assert guarded.reason == ""
    raw[row, axis] = -1.25 * limits[row]
    assert not np.any(stepped(guarded, 7, force(0.0, 0.0), raw))
    assert guarded.step_index == 7
    assert guarded.reason == (
        f"{CHANNELS[row]} {raw[row, axis]:g} {unit} on axis {AXES[axis]} is beyond the limit of "
        f"{limits[row]:g} {unit}"
    )


def test_forces_may_be_as_large_as_floats_can_be_without_being_called_no_number():
    guarded = interlock(limits=(np.inf,) * 4)
    with np.errstate(over="ignore"):
        stepped(guarded, 0, force(999.0, 0.0), state(east=1e307, north=-1e307))
    assert guarded.reason == ""


def test_a_reference_force_beyond_the_limit_is_nonsense():
    guarded = interlock()
    stepped(guarded, 0, force(1000.0, -1000.0), state())
    assert guarded.reason == ""
    np.testing.assert_array_equal(stepped(guarded, 1, force(1000.0, -1000.1), state()), [0, 0])
    assert guarded.reason == "reference force -1000.1 N on axis north is beyond the limit of 1000 N"


def test_a_valve_at_its_limit_for_too_long_within_a_second_trips():
    guarded = interlock(longest_saturation=0.1)
    for step in range(1600):  # a tenth of each second, and no more
        at_limit = step % 500 < 50
        stepped(guarded, step, force(0.0, -900.0 if at_limit else 5.0), state())
    assert guarded.reason == ""
    guarded.reset()
    drives = [stepped(guarded, step, force(50.0, 0.0), state()) for step in range(52)]
    np.testing.assert_array_equal(drives[49], [10.0, 0.0])
    np.testing.assert_array_equal(drives[50], [0.0, 0.0])
    assert guarded.step_index == 50
    assert guarded.reason.startswith("the valve command is at its limit for more than 0.1 s")


def test_a_rig_that_obeys_forces_has_no_valve_to_stay_at_its_limit():
    guarded = interlock(longest_saturation=0.1, has_valve=False)
    for step in range(600):
        stepped(guarded, step, force(900.0, 0.0), state(), drive=900.0)
    assert guarded.reason == ""
    assert guarded.state.tracking.limited_at == LONG_AGO  # tracking is watched on


def test_a_suspect_sample_is_replaced_by_what_was_planned_before_it():
    for count in (4, 2, 1):
        controller = Scripted(count)
        guarded = watched(controller)
        for step in range(70, 80):
            stepped(guarded, step, target_of(step, count), sample_of(step), 75 <= step < 78)
        assert guarded.reason == ""
        for place, step in enumerate(range(70, 80)):
            plan, sample = controller.seen[place]
            if 75 <= step < 78:
                planned = target_of(74, count)
                for _ in range(step - 74):
                    planned = extrapolated(planned, 1, count, DT)
                velocities = planned[: min(count, 3), 1]
                line = np.polyfit(DT * np.arange(len(velocities)), velocities, len(velocities) - 1)
                acceleration = line[-2] if count > 1 else np.zeros(2)
                np.testing.assert_array_equal(plan, planned)
                np.testing.assert_array_equal(sample[[0, 1, 3]], planned[0])
                np.testing.assert_allclose(sample[2], acceleration, rtol=1e-9, atol=1e-12)
            else:
                np.testing.assert_array_equal(plan, target_of(step, count))
                np.testing.assert_array_equal(sample, sample_of(step))


def test_while_a_sample_is_suspect_a_controller_of_forces_holds_its_last_command():
    controller = Scripted(1, 1)
    guarded = watched(controller)
    for step in range(10):
        command = stepped(guarded, step, force(0.0, 0.0), sample_of(step), 5 <= step < 8)
        answered = min(step + 1, 5) if step < 8 else step - 2
        np.testing.assert_array_equal(command, [answered, 2.0 * answered])
    assert len(controller.seen) == 7


@pytest.mark.parametrize("axis", [0, 1])
def test_a_trip_closes_the_valve_from_the_last_fault_free_command_and_its_cause_stays(axis):
    controller = Scripted(1)
    guarded = watched(controller)

    def step(index):
        off = 5e-3 * (index >= 5)  # of at most 1.8 mm of motion
        return stepped(guarded, index, target_of(index, 1), sample_of(index, off, axis))

    assert [step(index)[0] for index in range(14)] == list(range(1, 15))  # it may last for 0.02 s
    for taken in range(1, 11):
        np.testing.assert_allclose(step(13 + taken), left(taken) * np.array([14.0, 28.0]))
    assert (guarded.step_index, len(controller.seen)) == (14, 14)
    text = f"measured displacement on axis {AXES[axis]} is 0.005 m away from its target (0.00"
    assert guarded.reason.startswith(text)
    assert guarded.reason.endswith(" m allowed): tracking")
    reason = guarded.reason
    assert not np.any(stepped(guarded, 25, force(0.0, math.nan), state(math.nan)))
    guarded.trip(26, "another")
    assert (guarded.reason, guarded.step_index) == (reason, 14)
    guarded.reset()
    assert (guarded.reason, guarded.step_index, guarded.off_target) == ("", -1, 0.0)
    assert controller.seen == []
    np.testing.assert_array_equal(stepped(guarded, 0, force(math.nan, 0.0), state()), [0.0, 0.0])


def test_a_controller_of_forces_has_no_target_to_be_away_from():
    guarded, measured = watched(Scripted(1, 1)), sample_of(0)
    measured[0] = 5e-3  # from the target of the others
    for step in range(50):
        stepped(guarded, step, np.zeros((1, 3, 2)), measured)
    assert (guarded.reason, guarded.off_target) == ("", 0.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_drive_that_is_no_number_is_not_sent(bad):
    controller = Scripted(1, 1)
    guarded = watched(controller)
    fault_free = stepped(guarded, 0, force(0.0, 0.0), state())
    controller.drive = np.array([3.0, bad])
    for index in range(1, 7):
        drive = stepped(guarded, index, force(0.0, 0.0), state())
        np.testing.assert_allclose(drive, left(index) * fault_free, rtol=1e-14)
    assert guarded.reason == f"valve command on axis north is {bad}"
    assert (guarded.step_index, len(controller.seen)) == (1, 2)


def test_a_valve_that_trips_at_its_limit_closes_from_the_command_before():
    controller = Scripted(1, 1)
    guarded = watched(controller)  # 0.02 s: ten samples
    controller.limited = True
    drives = [stepped(guarded, index, force(0.0, 0.0), state()) for index in range(13)]
    np.testing.assert_array_equal([drive[0] for drive in drives[:10]], np.arange(1.0, 11.0))
    np.testing.assert_allclose([d[0] for d in drives[10:]], [10 * left(k) for k in (1, 2, 3)])
    assert guarded.step_index == 10


@pytest.mark.parametrize("axes", [("a",), ("a", "b", "c", "d")])
def test_a_controller_gets_as_many_points_as_it_asks_for(axes):
    n, controller = len(axes), Scripted(4, 3)
    for count, rows in ((2, 3), (6, 3), (1, 1), (4, 3)):
        guarded = watched(controller, axes)
        points = np.arange(1.0, 1 + count * rows * n).reshape(count, rows, n)
        points[:, 0], measured = points[0, 0], np.ones((4, n))
        measured[0] = points[0, 0]
        stepped(guarded, 0, points, measured)
        plan, sample = controller.seen[-1]
        expected = [np.broadcast_to(points[min(k, count - 1)], (3, n)) for k in range(4)]
        np.testing.assert_array_equal(plan, expected)
        np.testing.assert_array_equal(sample, measured)


def test_an_interlock_is_made_of_its_section():
    words = ("/**:limits.force:=900.0", "rig:safe.close_time:=0.03")
    words += ("force_controller:watchdog.saturation_time:=0.1",)
    experiment = of_rigs(*words)
    section, axes = experiment["force_controller"], experiment.axes
    for rig in (None, *experiment.rigs):
        made = Interlock.from_parameters(section, axes, experiment.timebase, rig)
        assert (made.parameters.limits[3], made.parameters.window) == (900.0, 500)
        assert made.parameters.closing == pytest.approx(15.0)
        assert len(made.state.saturated) == 51
        own = axes if rig is None else rig.axes
        n = len(own)
        made.step(0, np.array([[[0.0] * (n - 1) + [-901.0]]]), np.zeros((6, n)))
        assert f"-901 N on axis {own[-1]} is beyond the limit of 900 N" in made.reason


# ---- The interlocks of a test with several rigs, each on its own axes


def of_rigs(*words):
    return load(*words, config="two_pier_bridge")


def test_each_rig_has_an_interlock_that_sees_its_own_axes():
    both = interlock_of(of_rigs())
    alone = [interlock_of(of_rigs()) for _ in range(2)]
    rng = np.random.default_rng(3)
    for step in range(50):
        points = 1e-5 * rng.normal(size=(26, 3, 2))
        state = np.array([[5e-6], [1e-3], [0.05], [3.0]]) * rng.normal(size=(4, 2))
        state = of_rig(state, drive=rng.normal(size=2))
        drive = both.step(step, points, state)
        for axis, one in enumerate(alone):  # what the other axis does is of no effect
            other = points.copy(), state.copy()
            for values in other:
                values[..., 1 - axis] = 0.0
            assert one.step(step, *other)[axis] == drive[axis] != 0.0
    assert both.reason == ""


def test_the_first_rig_that_trips_gives_the_reason_and_a_reset_is_for_all():
    both = interlock_of(of_rigs("rig:safe.close_time:=0.0"))
    points, rest = np.zeros((26, 3, 2)), np.zeros((6, 2))
    points[0, 2] = 0.0, 1e6
    assert np.array_equal(both.step(0, points, rest), [0.0, 0.0])
    assert both.reason.startswith("reference force 1e+06 N on axis east/pier is beyond")
    points[0, 2] = -1e6, 1e6
    both.step(1, points, rest)
    assert both.reason.startswith("reference force -1e+06 N on axis west/pier is beyond")
    both.reset()
    assert both.reason == ""
    points[0, 2] = 0.0
    both.step(0, points, rest)
    assert both.reason == ""
