import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_ros.experiment.state_machine import State, StateMachine

WAYS = {
    State.IDLE: (),
    State.READY: (("peers", ""),),
    State.RUNNING: (("peers", ""), ("start",)),
    State.DONE: (("peers", ""), ("start",), ("finish", "9 steps done")),
    State.TRIPPED: (("peers", ""), ("start",), ("trip", "force", 7)),
}
EVENTS = {
    "complete": ("peers", ""),
    "incomplete": ("peers", "node rig"),
    "start": ("start",),
    "finish": ("finish", "9 steps done"),
    "trip": ("trip", "force", 7),
    "stop": ("stop",),
    "estop": ("estop",),
    "reset": ("reset",),
}
LEADS_TO = {
    (State.IDLE, "complete"): State.READY,
    (State.READY, "incomplete"): State.IDLE,
    (State.READY, "start"): State.RUNNING,
    (State.RUNNING, "finish"): State.DONE,
    (State.RUNNING, "trip"): State.TRIPPED,
    (State.RUNNING, "stop"): State.DONE,
    **{(state, "estop"): State.TRIPPED for state in State},
    (State.DONE, "reset"): State.IDLE,
    (State.TRIPPED, "reset"): State.IDLE,
}
"""Every way there is; all else leaves the state as it is."""
REQUESTS = {
    "start": {State.READY},
    "stop": {State.RUNNING},
    "estop": set(State),
    "reset": {State.DONE, State.TRIPPED},
}
"""States in which an operator's request is done."""


def machine_in(state):
    machine = StateMachine()
    for name, *arguments in WAYS[state]:
        getattr(machine, name)(*arguments)
    assert machine.state is state
    return machine


def send(machine, event):
    name, *arguments = EVENTS[event]
    return getattr(machine, name)(*arguments)


def test_a_test_begins_idle():
    machine = StateMachine()
    assert (machine.state, machine.detail, machine.step) == (State.IDLE, "starting", None)


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, EVENTS)))
def test_every_event_in_every_state(state, event):
    machine = machine_in(state)
    send(machine, event)
    assert machine.state is LEADS_TO.get((state, event), state)


@pytest.mark.parametrize(("state", "request_"), list(itertools.product(State, REQUESTS)))
def test_every_request_is_done_or_refused_with_the_reason(state, request_):
    machine = machine_in(state)
    detail, step = machine.detail, machine.step
    answer = send(machine, request_)
    assert answer.accepted == (state in REQUESTS[request_])
    if not answer.accepted:
        assert answer.text == f"can't {request_}: the test is {state} ({detail})"
        assert (machine.detail, machine.step) == (detail, step)


def test_an_idle_test_says_what_it_waits_for():
    machine = machine_in(State.READY)
    machine.peers("node rig")
    assert machine.detail == "waiting for node rig"
    assert "waiting for node rig" in machine.start().text


def test_the_end_of_a_test_keeps_its_reason_whatever_comes_after():
    for state, detail, step in (
        (State.DONE, "9 steps done", None),
        (State.TRIPPED, "force", 7),
    ):
        machine = machine_in(state)
        machine.peers("")
        machine.finish("again")
        machine.trip("later", 99)
        machine.start()
        machine.stop()
        assert (machine.state, machine.detail, machine.step) == (state, detail, step)


def test_stop_is_an_end_not_a_trip():
    machine = machine_in(State.RUNNING)
    machine.stop()
    assert (machine.detail, machine.step) == ("stopped by the operator", None)


def test_an_emergency_stop_after_a_trip_forgets_the_step_of_that():
    machine = machine_in(State.TRIPPED)
    machine.estop()
    assert (machine.detail, machine.step) == ("emergency stop", None)


def test_the_next_test_does_not_inherit_the_step_of_a_trip():
    machine = machine_in(State.TRIPPED)
    machine.reset()
    assert machine.step is None
    machine.peers("")
    machine.start()
    assert (machine.state, machine.step) == (State.RUNNING, None)


@given(st.lists(st.sampled_from(sorted(EVENTS))))
def test_no_test_runs_without_complete_peers_and_a_start(events):
    machine, previous = StateMachine(), State.IDLE
    for event in events:
        send(machine, event)
        if machine.state is State.RUNNING and previous is not State.RUNNING:
            assert (previous, event) == (State.READY, "start")
        if machine.state is State.READY and previous is not State.READY:
            assert event == "complete"
        previous = machine.state


def test_states_are_the_words_on_the_topic():
    assert [str(state) for state in State] == ["idle", "ready", "running", "done", "tripped"]
