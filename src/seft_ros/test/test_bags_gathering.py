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


def test_a_test_that_ran_to_its_end_has_no_trip():
    assert trip_of_messages(rig(), supervisor("done", "10 steps done"), TIMEBASE) is None
    assert trip_of_messages(None, None, TIMEBASE) is None


def test_the_supervisor_knows_why_a_rig_was_stopped_and_when():
    ending = supervisor("tripped", "node recorder has been silent since 0.01 s", step=4)
    assert trip_of_messages(rig(STOPPED), ending, TIMEBASE) == Trip(ending.detail, 4, 0.008)


@pytest.mark.parametrize("reason", [STOPPED, None])  # the second, where the record ended first
def test_an_operators_stop_is_no_trip(reason):
    ending = supervisor("done", "stopped by the operator")
    assert trip_of_messages(rig(reason), ending, TIMEBASE) is None
    reports = ReportGatherer(TIMEBASE)
    reports.take_state(encode_state(ending), 0)
    assert reports.stopped()


def test_a_rig_that_trips_when_a_stop_has_ended_has_tripped():
    ending = supervisor("done", "stopped by the operator")
    assert trip_of_messages(rig("force"), ending, TIMEBASE).reason == "force"


def test_without_a_supervisor_the_rigs_word_counts():
    assert trip_of_messages(rig("force"), None, TIMEBASE) == Trip("force", 9, 0.018)


def test_the_supervisor_adds_to_what_the_rig_said():
    ending = supervisor("tripped", "force; node rig has been silent since 0.02 s", step=9)
    assert trip_of_messages(rig("force"), ending, TIMEBASE).reason == ending.detail


def test_a_recording_that_ended_while_the_test_was_brought_down_keeps_the_cause():
    ending = supervisor("tripped", "reference force is nan N on axis x", step=7)
    assert trip_of_messages(rig(), ending, TIMEBASE) == Trip(ending.detail, 7, 0.014)


def test_a_dead_rig_leaves_the_supervisors_word():
    ending = supervisor("tripped", "aborted by the operator")
    assert trip_of_messages(None, ending, TIMEBASE) == Trip("aborted by the operator", 0, 0.0)
