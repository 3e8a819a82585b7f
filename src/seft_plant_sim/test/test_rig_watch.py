"""What a rig node watches: its time, its commands, and how a test goes."""

import statistics
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status
from seft_msgs_py.wire.outcome import ROUND_TRIPS
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.rig_watch import HURRY, CommandWatch, RoundTrip, SampleClock, with_health

PERIOD, TIMEOUT = 0.002, 0.02
ALLOWED = 10  # steps


@pytest.fixture
def watch():
    found = CommandWatch(VALVE_COMMAND, PERIOD, TIMEOUT)
    found.begin(100.0)
    return found


def look(watch, step, answered, late=0.0):
    """Look at the end of a step's period, or later."""
    return watch.fault(100.0 + (step + 1) * PERIOD + late, step, answered)


def test_a_rig_that_is_answered_in_time_goes_on(watch):
    assert not any(look(watch, step, step) for step in range(1000))


def test_a_rig_whose_answers_are_always_a_step_late_goes_on(watch):
    assert not any(look(watch, step, step - 1) for step in range(1000))


def test_commands_that_settle_coming_steps_may_be_lost_as_long_as_they_are_settled(watch):
    assert not any(look(watch, step, 30) for step in range(31 + ALLOWED))
    assert look(watch, 31 + ALLOWED, 30).startswith("no new valve_command for 0.02 s (the last is")


@pytest.mark.parametrize("missing", [1, ALLOWED, ALLOWED + 1])
def test_commands_may_fail_to_come_for_the_timeout_and_no_longer(watch, missing):
    assert not any(look(watch, step, step) for step in range(50))
    faults = [look(watch, 50 + lost, 49) for lost in range(missing)]
    assert not any(faults[:ALLOWED])
    assert bool(faults[-1]) == (missing > ALLOWED)
    if missing <= ALLOWED:
        assert not look(watch, 50 + missing, 50 + missing)


@pytest.mark.parametrize("answered", [9, 8])
@pytest.mark.parametrize("stood_still", [0.0215, 0.3, 1.0, 3600.0])
def test_a_rig_that_stood_still_obeys_nothing_though_its_commands_are_there(
    watch, answered, stood_still
):
    assert not any(look(watch, step, step) for step in range(9))
    fault = look(watch, 9, answered, stood_still)
    assert fault.startswith("the rig stood still for")


def test_a_rig_that_was_held_up_for_less_than_the_timeout_goes_on(watch):
    assert not any(look(watch, step, step, late=0.018) for step in (0, 1, 2))


def test_a_period_beyond_the_timeout_is_what_counts():
    watch = CommandWatch(VALVE_COMMAND, 0.1, 0.02)
    watch.begin(0.0)
    assert not watch.fault(0.1, 0, 0)
    assert not watch.fault(0.2, 1, 0)
    assert watch.fault(0.3, 2, 0)


def test_a_rig_that_has_waited_in_vain_says_so_at_once(watch):
    assert watch.fault(100.0, 0, -1, in_vain=True).startswith("no new valve_command")


def test_deadlines_are_a_period_apart_and_do_not_drift_by_small_delays():
    clock = SampleClock(0.002, 10.0, makes_up=False)
    for step in range(5):
        assert clock.deadline(step) == pytest.approx(10.0 + 0.002 * step)
        clock.awake(0.0009)
    assert clock.overruns == 0


@pytest.mark.parametrize("makes_up", [False, True])
def test_who_was_held_up_goes_on_from_there(makes_up):
    clock = SampleClock(0.002, 10.0, makes_up=makes_up)
    clock.awake(0.0065)
    assert clock.overruns == 1
    assert clock.deadline(1) == pytest.approx(10.0085, abs=0.002 * HURRY + 1e-9)
    for _ in range(200):
        clock.awake(0.0)
    assert clock.deadline(1) == pytest.approx(10.002 if makes_up else 10.0085)


def test_all_that_is_to_come_is_put_off():
    clock = SampleClock(0.002, 10.0, makes_up=False)
    clock.fall_back(0.001)
    assert clock.deadline(3) == pytest.approx(10.007)
    assert clock.overruns == 0


NONE = float("nan")


def of(*times):
    round_trip = RoundTrip()
    for each in times:
        round_trip.add(each)
    return round_trip


@given(st.lists(st.floats(1e-5, 10.0), min_size=1, max_size=200))
def test_last_and_largest_are_exact_and_the_median_is_near(times):
    round_trip = of(*times)
    assert round_trip.last == times[-1]
    assert round_trip.largest == max(times)
    assert round_trip.quantile(0.5) == pytest.approx(statistics.median_low(times), rel=0.06)
    numbers = round_trip.numbers()
    assert list(numbers) == list(ROUND_TRIPS)
    assert sorted(numbers.values()) == list(numbers.values())
    assert round_trip.quantile(1.0) == pytest.approx(max(times), rel=0.06)


@pytest.mark.parametrize("time", [0.0, -1.0, 1e-9, 1e9])
def test_any_time_has_its_bin(time):
    assert of(time).count == 1
    assert of(time).quantile(0.5) <= time


def test_margins_age_and_round_trip_are_told_by_name():
    status = Status("rig", OK, "running", values={"phase": "running"})
    told = with_health(status, {"force_rate": 0.5}, time.monotonic() - 0.01, 0.003)
    assert told.level == OK
    assert told.message == "running"
    assert told.values["phase"] == "running"
    assert told.values["margin force rate"] == "0.500"
    assert float(told.values["command age (ms)"]) >= 10.0
    assert told.values["round trip last (ms)"] == "3.000"


def test_what_was_not_is_left_out():
    assert of().numbers() == {}
    told = with_health(Status("rig", OK, "running"), {}, 0.0, of().last)
    assert told.values == {}


@pytest.mark.parametrize("left", [0.09, 0.0, -3.0, float("nan")])
def test_a_narrow_margin_is_warned_of(left):
    told = with_health(Status("rig", OK, "running"), {"force": left, "velocity": 0.1}, 0.0, NONE)
    assert told.level == WARN
    assert told.message == "running; less than 10% left to the limit of force"
    tripped = with_health(Status("rig", ERROR, "tripped"), {"force": left}, 0.0, NONE)
    assert (tripped.level, tripped.message) == (ERROR, "tripped")
