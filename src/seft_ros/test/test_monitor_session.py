"""What the nodes say of a test, as it is shown."""

import json
from types import SimpleNamespace

import pytest
from seft_msgs_py.wire.experiment_state import ExperimentState
from seft_msgs_py.wire.messages import OK, Status
from seft_msgs_py.wire.outcome import State
from seft_ros.monitor.session import EVENTS, SILENCE_PERIOD, Session


@pytest.fixture
def clock():
    found = SimpleNamespace(now=0.0)
    found.time = lambda: found.now
    return found


@pytest.fixture
def session(clock):
    return Session(wall=lambda: 1e9 + clock.now, awake=clock)


def state(name, detail="", **values):
    return ExperimentState(State(name), detail, **values)


def rig(steps, **values):
    return Status("rig", OK, "running", values={"phase": "running", "steps": str(steps), **values})


def what(session):
    return [event["what"] for event in session.events]


def test_before_anything_is_heard_nothing_is_reported(session):
    summary = session.summary()
    assert not summary["heard"]
    assert json.loads(json.dumps(summary)) == summary


def test_a_repeated_state_is_no_event_and_begins_no_test(session):
    for _ in range(2):
        assert not session.on_state(state("running"))
    session.on_state(state("tripped", "force is beyond", step=7, time_s=0.014))
    assert what(session) == ["running", "tripped"]
    summary = session.summary()
    assert (summary["state"], summary["step"], summary["time_s"]) == ("tripped", 7, 0.014)
    assert summary["detail"] == "force is beyond"
    assert summary["ended"]


@pytest.mark.parametrize("last", ["done", "tripped", "running", "ramping_down"])
@pytest.mark.parametrize("new", ["idle", "ready", "running"])
def test_what_came_before_is_of_another_test_once_it_can_be(session, last, new):
    session.on_state(state("ready"))
    assert not session.on_state(state("ramping_down"))
    session.on_state(state(last))
    assert session.on_state(state(new)) == (last != new)
    if new != "running":
        assert not session.on_state(state("running"))


def test_what_a_rig_still_tells_of_the_last_test_is_not_the_next_one_s(session):
    session.on_state(state("done"))
    session.on_diagnostics([rig(500, missed="3", **{"margin force": "0.25"})], 0.002)
    assert session.summary()["missed"] == 3
    assert session.on_state(state("idle"))
    session.begin()
    session.on_diagnostics([rig(500, missed="3", **{"margin force": "0.25"})], 0.002)
    summary = session.summary()
    assert (summary["missed"], summary["margins"], session.round_trips) == (None, {}, [])


def test_states_are_numbered_and_what_waits_is_none(session):
    numbers = []
    for name, detail in (("idle", "a"), ("idle", "b"), ("ready", ""), ("ready", ""), ("idle", "")):
        session.on_state(state(name, detail))
        numbers.append(session.summary()["number"])
    assert numbers == [1, 1, 2, 2, 3]


def test_a_test_has_a_name(session):
    assert session.summary()["name"] == ""
    session.on_description("ground_motion", {"file": "records/kobe.txt"})
    session.on_description(
        "reference_force", {"mass_ratio": 1.5, "compensation.method": "target_motion"}
    )
    assert session.summary()["name"] == "kobe.txt, mass ratio 1.5, target_motion"
    session.on_description("ground_motion", {"file": ""})
    session.on_description("recorder", {"name": "third"})
    assert session.summary()["name"].startswith("synthetic motion, ")
    assert session.summary()["name"].endswith(", bag third")


def test_a_node_that_leaves_after_its_test_has_ended_and_one_before_is_silent(session, clock):
    session.on_state(state("running"))
    force = Status("reference_force", OK, "running", values={})
    session.on_diagnostics([rig(1), force], 0.002)
    clock.now += 1.0
    session.poll()
    session.on_diagnostics([rig(500)], 0.002)
    session.on_state(state("tripped"))
    clock.now += 2 * SILENCE_PERIOD
    session.poll()
    assert {n["name"]: n["level"] for n in session.summary()["nodes"]} == {
        "reference_force": 3,
        "rig": 4,
    }


def test_a_supervisor_that_goes_and_comes_back_is_shown(session, clock):
    session.on_state(state("ready"))
    clock.now += SILENCE_PERIOD + 0.1
    session.poll()
    assert session.summary()["silent"]
    session.on_state(state("ready"))
    assert not session.summary()["silent"]
    assert what(session) == ["ready", "gone", "ready"]


def test_nodes_that_leave_after_a_test_are_no_fault(session, clock):
    session.on_state(state("done"))
    clock.now += SILENCE_PERIOD + 0.1
    session.poll()
    assert [(e["what"], e["level"]) for e in session.events] == [("done", OK), ("left", 4)]


def test_a_silent_node_is_marked(session, clock):
    session.on_diagnostics([rig(1), Status("stranger", OK, "hello")], 0.002)
    assert [node["level"] for node in session.summary()["nodes"]] == [OK]
    clock.now += SILENCE_PERIOD + 0.1
    session.poll()
    assert session.summary()["nodes"] == [
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
    summary = session.summary()
    assert summary["margins"] == {"force": 0.25}
    assert summary["round_trip"] == {"median (ms)": 0.5}
    assert (summary["missed"], summary["overruns"]) == (3, 1)
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
    assert session.summary()["missed"] == 2
    session.begin()
    assert session.summary()["missed"] is None


def test_events_are_bounded(session):
    for number in range(3 * EVENTS):
        session.on_state(state("idle", f"waiting for {number}"))
    assert len(session.events) == EVENTS
