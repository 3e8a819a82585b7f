"""What the nodes say of a test, as it is shown."""

import json

import pytest
from seft_msgs_py.wire.messages import ERROR, OK, Status
from seft_ros.monitor.session import EVENTS, SILENCE, Session


class Clock:
    def __init__(self):
        self.now = 0.0

    def time(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    return Session(wall=lambda: 1e9 + clock.now, awake=clock)


def state(name, detail="", level=OK, **values):
    return Status("experiment", level, name, values={"detail": detail, **values})


def rig(steps, **values):
    return Status("rig", OK, "running", values={"phase": "running", "steps": str(steps), **values})


def what(session):
    return [event["what"] for event in session.events()]


def test_before_anything_is_heard_nothing_is_told(session):
    told = session.told()
    assert not told["heard"]
    assert json.loads(json.dumps(told)) == told


def test_a_repeated_state_is_no_event_and_begins_no_test(session):
    assert session.on_state(state("running"))
    assert not session.on_state(state("running"))
    session.on_state(state("tripped", "force is beyond", ERROR, step="7", time_s="0.014"))
    assert what(session) == ["running", "tripped"]
    told = session.told()
    assert (told["state"], told["step"], told["time_s"]) == ("tripped", 7, 0.014)
    assert told["detail"] == "force is beyond"
    assert told["ended"]


def test_a_supervisor_that_goes_and_comes_back_is_shown(session, clock):
    session.on_state(state("ready"))
    clock.now += SILENCE + 0.1
    session.look()
    assert session.told()["silent"]
    session.on_state(state("ready"))
    assert not session.told()["silent"]
    assert what(session) == ["ready", "gone", "ready"]


def test_a_silent_node_is_marked(session, clock):
    session.on_diagnostics([rig(1), Status("stranger", OK, "hello")], 0.002)
    assert [node["level"] for node in session.told()["nodes"]] == [OK]
    clock.now += SILENCE + 0.1
    session.look()
    assert session.told()["nodes"] == [
        {"name": "rig", "level": 3, "text": "running", "refused": None}
    ]


def test_margins_round_trips_and_misses_are_the_rig_s(session):
    values = {
        "margin force": "0.25",
        "margin velocity rate": "what",
        "round trip median (ms)": "0.5",
        "round trip largest (ms)": "inf",
        "missed": "3",
        "overruns": "1",
    }
    session.on_diagnostics([rig(500, **values)], 0.002)
    told = session.told()
    assert told["margins"] == {"force": 0.25}
    assert told["round_trip"] == {"median (ms)": 0.5}
    assert (told["missed"], told["overruns"]) == (3, 1)
    assert session.round_trips == [(1.0, 0.5, None, 3)]


def test_round_trips_are_of_one_test_and_bounded(session):
    for steps in range(1, 10 * EVENTS):
        session.on_diagnostics([rig(steps)], 1.0)
    assert len(session.round_trips) <= 2 * EVENTS
    assert session.round_trips[0][0] == 1.0
    session.on_diagnostics([rig(5)], 1.0)
    assert session.round_trips == [(5.0, None, None, 0)]


def test_a_rig_at_rest_keeps_the_last_test_s_numbers(session):
    session.on_diagnostics([rig(5, missed="2")], 1.0)
    session.on_diagnostics([Status("rig", OK, "idle", values={"phase": "idle"})], 1.0)
    assert session.told()["missed"] == 2
    session.begin()
    assert session.told()["missed"] is None


def test_events_are_bounded(session):
    for number in range(3 * EVENTS):
        session.on_state(state("idle", f"waiting for {number}"))
    assert len(session.events()) == EVENTS


def test_parameters_that_tell_the_test_are_text(session):
    session.on_description("reference_force", {"mass_ratio": float("nan"), "method": "seft"})
    session.on_description("rig", {"pace": "<b>lockstep</b>"})
    assert session.told()["parameters"] == {
        "reference_force: method": "seft",
        "reference_force: mass_ratio": "nan",
        "rig: pace": "<b>lockstep</b>",
    }
