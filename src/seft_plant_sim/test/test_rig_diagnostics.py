import statistics
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status
from seft_msgs_py.wire.outcome import ROUND_TRIPS
from seft_plant_sim.rig_diagnostics import RoundTrip, with_health

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
