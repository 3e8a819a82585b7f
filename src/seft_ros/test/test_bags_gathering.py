"""What rig and supervisor say of a test's end, put together."""

import pytest
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.outcome import STOPPED, Outcome, State, Trip
from seft_msgs_py.wire.topics import Timebase
from seft_ros.bags.gathering import ReportGatherer, trip_of_messages

TIMEBASE = Timebase.from_rate(500)


def rig(reason=None):
    trip = Trip(reason, 9, 0.018) if reason else None
    return Outcome("tripped" if trip else "finished", 10, 0, [], 1.0, trip)


def supervisor(state, detail, **values):
    return ExperimentState(State(state), detail, **values)


STOP = supervisor("done", "stopped by the operator")
FORCE = Trip("force", 9, 0.018)
ENDS = {
    "a test that ran to its end has no trip": (rig(), supervisor("done", "10 steps done"), None),
    "nobody has said anything": (None, None, None),
    "an operator's stop is no trip": (rig(STOPPED), STOP, None),
    "nor where the record ended first": (rig(), STOP, None),
    "a rig that trips when a stop has ended has tripped": (rig("force"), STOP, FORCE),
    "without a supervisor the rig's word counts": (rig("force"), None, FORCE),
    "the supervisor knows why a rig was stopped and when": (rig(STOPPED), "silent", 4),
    "the supervisor adds to what the rig said": (rig("force"), "force; silent", 9),
    "a record that ended while it was brought down keeps the cause": (rig(), "force is nan", 7),
    "a dead rig leaves the supervisor's word": (None, "aborted by the operator", 0),
}


@pytest.mark.parametrize(("of_rig", "ending", "trip"), ENDS.values(), ids=ENDS)
def test_a_trip_is_put_together(of_rig, ending, trip):
    if isinstance(ending, str):  # that of the supervisor counts, with its step
        trip = Trip(ending, trip, trip / 500)
        ending = supervisor("tripped", ending, step=trip.step or None)
    assert trip_of_messages(of_rig, ending, TIMEBASE) == trip


def test_an_operators_stop_is_known():
    reports = ReportGatherer(TIMEBASE)
    reports.take_state(encode_state(STOP), 0)
    assert reports.stopped()
