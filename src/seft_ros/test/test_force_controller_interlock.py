import math

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.interlock import Interlock
from seft_ros.nodes.force_controller_node import Silence
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate
from seft_ros.test_run.parameter_tables import TABLES
from warning_detectors import warning_detectors

AXES = ("east", "north")
DT = 0.002
JHU = "config/jhu.yaml"


def interlock(gain=1.0, longest_saturation=0.5):
    controller = ForceController([([gain], [1.0])] * len(AXES), 10.0, DT)
    return Interlock(controller, AXES, 1000.0, longest_saturation, 0.0, warning_detectors(2))


def state(east=0.0, north=0.0):
    found = np.zeros((4, 2))
    found[3] = east, north
    return found


def force(east, north):
    return np.array([[[east, north]]])


def test_it_is_the_controller_itself_while_all_is_well():
    guarded, bare = interlock(), ForceController([([1.0], [1.0])] * 2, 10.0, DT)
    rng = np.random.default_rng(1)
    for step in range(200):
        asked, measured = force(*rng.normal(0, 300, 2)), state(*rng.normal(0, 300, 2))
        expected = bare.step(asked, measured)
        np.testing.assert_array_equal(guarded.step(step * 1000, asked, measured), expected)
    assert guarded.reason == ""
    assert guarded.step_index == -1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_never_gets_into_the_recursion(value):
    for asked, measured, words in (
        ([1.0, value], state(), f"reference force on axis north is {value}"),
        ([1.0, 2.0], state(east=value), f"measured force on axis east is {value}"),
        ([0.0, 0.0], state(east=value), f"measured force on axis east is {value}"),
    ):
        guarded = interlock()
        with np.errstate(invalid="ignore"):
            drive = guarded.step(7, force(*asked), measured)
        np.testing.assert_array_equal(drive, [0.0, 0.0])
        if abs(value) == math.inf and "reference" in words:
            words = f"reference force {value:g} N on axis north is beyond the limit of 1000 N"
        assert guarded.reason == words
        assert guarded.step_index == 7
        np.testing.assert_array_equal(guarded.step(8, force(1.0, 1.0), state()), [0.0, 0.0])
        guarded.reset()
        np.testing.assert_array_equal(guarded.step(0, force(1.0, 1.0), state()), [1.0, 1.0])


def test_forces_may_be_as_large_as_floats_can_be_without_being_called_no_number():
    guarded = interlock()
    with np.errstate(over="ignore"):
        guarded.step(0, force(999.0, 0.0), state(east=1e307, north=-1e307))
    assert guarded.reason == ""


def test_a_reference_force_beyond_the_limit_is_nonsense():
    guarded = interlock()
    guarded.step(0, force(1000.0, -1000.0), state())
    assert guarded.reason == ""
    np.testing.assert_array_equal(guarded.step(1, force(0.0, -1000.1), state()), [0, 0])
    assert guarded.reason == "reference force -1000.1 N on axis north is beyond the limit of 1000 N"


def test_a_valve_at_its_limit_for_too_long_within_a_second_trips():
    guarded = interlock(longest_saturation=0.1)
    for step in range(5000):  # a tenth of each second, and no more
        at_limit = step % 500 < 50
        guarded.step(step, force(0.0, -900.0 if at_limit else 5.0), state())
    assert guarded.reason == ""
    guarded.reset()
    drives = [guarded.step(step, force(50.0, 0.0), state()) for step in range(52)]
    np.testing.assert_array_equal(drives[49], [10.0, 0.0])
    np.testing.assert_array_equal(drives[50], [0.0, 0.0])
    assert guarded.step_index == 50
    assert guarded.reason.startswith("the valve command is at its limit for more than 0.1 s")


def test_the_first_reason_counts():
    guarded = interlock()
    guarded.trip(3, "first")
    guarded.trip(4, "second")
    assert (guarded.reason, guarded.step_index) == ("first", 3)


def test_the_offline_loop_trips_with_it():
    words = (
        "force_controller:voltage_limit:=1.0",
        "force_controller:watchdog.saturation_time:=0.05",
        "ground_motion:synthetic.duration:=10.0",
    )
    experiment = Experiment.load(TABLES, [JHU], [parse_override(word) for word in words])
    record = simulate(experiment, build_blocks(experiment))
    assert record.trip.reason.startswith("the valve command is at its limit for more than 0.05 s")
    commands = record.series["valve_command"].values[:, 0, 0]
    assert record.trip.step == len(commands) - 1
    assert abs(commands[-1]) == pytest.approx(0.9755, abs=1e-4)  # it closes in ten steps
    assert np.count_nonzero(np.abs(commands) == 1.0) == 25


def test_silence_is_too_long_after_its_time():
    silence = Silence(0.02)
    assert not silence.is_too_long(5.0)
    assert not silence.is_watching
    silence.heard(10.0)
    assert silence.is_watching
    looks = [10.0 + 0.002 * n for n in range(1, 12)]
    assert [silence.is_too_long(at) for at in looks] == [False] * 10 + [True]
    silence.heard(11.0)
    assert not silence.is_too_long(11.01)
    silence.end()
    assert not silence.is_too_long(99.0)


def test_a_listener_that_was_held_up_itself_blames_nobody():
    silence = Silence(0.02)
    silence.heard(10.0)
    assert not silence.is_too_long(70.0)
    assert not silence.is_too_long(70.002)


@pytest.mark.parametrize(
    ("row", "quantity"), [(0, "displacement"), (1, "velocity"), (2, "acceleration"), (3, "force")]
)
def test_a_target_is_not_held_against_what_is_no_number(row, quantity):
    measured = np.zeros((4, 2))
    measured[row, 1] = math.nan
    if row < 3:
        guarded = interlock()
        guarded.step(0, force(1.0, 2.0), measured)
        assert guarded.reason == ""  # a controller of the force alone does not look at it
    guarded = interlock()
    np.testing.assert_array_equal(guarded.step(7, np.ones((5, 3, 2)), measured), [0.0, 0.0])
    assert guarded.reason == f"measured {quantity} on axis north is nan"
