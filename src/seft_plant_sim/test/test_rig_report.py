import math
from types import SimpleNamespace

import pytest
from seft_msgs_py.wire.messages import ERROR, OK, WARN
from seft_msgs_py.wire.outcome import Outcome, Trip
from seft_plant_sim.hardware.safe_stop import Stopped
from seft_plant_sim.rig_watch import RoundTrip, rig_report


def times(*found):
    trips = RoundTrip()
    for time in found:
        trips.add(time)
    return trips


def report(margins=None, phase="running", trip=None, missed=0, last=(), age=math.nan, stopped=None):
    outcome = Outcome(phase, 100, missed, list(range(missed)), 1.0, trip)
    limits = SimpleNamespace(margins=lambda: margins or {})
    guard = SimpleNamespace(nearest=("oil", 0.5), limits=limits)
    rig = SimpleNamespace(hardware=SimpleNamespace(counts={"lost": 2}), guard=guard)
    return rig_report(outcome, rig, times(5e-5), times(*last), age, stopped)


def test_margins_age_and_round_trip_are_reported_by_name():
    health = report({"force_rate": 0.5}, last=[0.003], age=1e3)
    assert (health.level, health.message) == (OK, "running")
    shown = {
        "phase": "running",
        "margin force rate": "0.500",
        "round trip last (ms)": "3.000",
        "nearest detector": "oil: 0.50 of its threshold",
        "datagrams lost": "2",
        "command age (ms)": "1000000.00",
        "compute largest (ms)": "0.050",
    }
    assert shown.items() <= health.values.items()


def test_what_was_not_is_left_out():
    values = report().values
    assert not {"command age (ms)", "round trip last (ms)", "stop time (s)"} & values.keys()


@pytest.mark.parametrize("left", [0.09, 0.0, -3.0, float("nan")])
def test_a_narrow_margin_is_warned_of(left):
    narrow, text = {"force": left, "velocity": 0.1}, "; less than 10 % left to the limit of force"
    health = report(narrow, "finished")
    assert (health.level, health.message) == (WARN, f"finished: 100 steps, 0 missed{text}")
    slow = report(narrow, "finished", missed=2)
    assert (slow.level, slow.message) == (WARN, "finished: 100 steps, 2 missed")
    tripped = report(narrow, "tripped", Trip("a fault", 99, 0.2))
    assert (tripped.level, tripped.message) == (ERROR, "tripped at step 99 (0.2 s): a fault")


def test_a_rig_that_does_not_come_to_rest_is_an_error():
    stopped = report(phase="finished", stopped=Stopped(0.25, 310.0))
    assert (stopped.level, stopped.values["stop time (s)"]) == (OK, "0.25")
    goes_on = report(phase="finished", stopped=Stopped(3.0, 310.0, False, True))
    assert goes_on.level == ERROR
    assert goes_on.message.endswith("; not at rest after 3 s, the pressure was dumped")
