import itertools

import pytest
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.experiment_state import ExperimentState
from seft_msgs_py.wire.outcome import ENDED, State
from seft_msgs_py.wire.topics import Timebase
from seft_ros.test_run.state_machine import SampleOrder, StateMachine

RUNNING = (("peers", ""), ("start",))
WAYS = {
    State.IDLE: (),
    State.READY: (("peers", ""),),
    State.RUNNING: RUNNING,
    State.RAMPING_DOWN: (*RUNNING, ("soft_trip", "node recorder is silent", 5)),
    State.DONE: (*RUNNING, ("finish", "9 steps done")),
    State.TRIPPED: (*RUNNING, ("hard_trip", "force", 7)),
}
EVENTS = {
    "complete": ("peers", ""),
    "incomplete": ("peers", "node rig"),
    "start": ("start",),
    "finish": ("finish", "8 steps done"),
    "soft_trip": ("soft_trip", "reference force is nan", 6),
    "hard_trip": ("hard_trip", "velocity", 8),
    "at_rest": ("at_rest",),
    "note": ("note", "node recorder is silent"),
    "stop": ("stop",),
    "estop": ("estop",),
    "reset": ("reset",),
    "reset_while_moving": ("reset", True),
}
LEADS_TO = {
    (State.IDLE, "complete"): State.READY,
    (State.READY, "incomplete"): State.IDLE,
    (State.READY, "start"): State.RUNNING,
    (State.RUNNING, "finish"): State.DONE,
    (State.RUNNING, "soft_trip"): State.RAMPING_DOWN,
    (State.RUNNING, "hard_trip"): State.TRIPPED,
    (State.RUNNING, "stop"): State.RAMPING_DOWN,
    (State.RAMPING_DOWN, "finish"): State.TRIPPED,  # it came down for a fault
    (State.RAMPING_DOWN, "at_rest"): State.TRIPPED,
    (State.RAMPING_DOWN, "hard_trip"): State.TRIPPED,
    **{(state, "estop"): State.TRIPPED for state in State},
    (State.DONE, "reset"): State.IDLE,
    (State.TRIPPED, "reset"): State.IDLE,
}
"""Every way there is; all else leaves the state as it is."""
REQUESTS = {
    "start": {State.READY},
    "stop": {State.RUNNING, State.RAMPING_DOWN},
    "estop": set(State),
    "reset": {State.DONE, State.TRIPPED},
}
"""States in which an operator's request is done."""


def machine_in(state):
    return machine_after(*WAYS[state], state=state)


def machine_after(*events, state=None):
    machine = StateMachine()
    for name, *arguments in events:
        getattr(machine, name)(*arguments)
    assert state is None or machine.state is state
    return machine


def send(machine, event):
    name, *arguments = EVENTS[event]
    return getattr(machine, name)(*arguments)


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, EVENTS)))
def test_every_event_in_every_state(state, event):
    machine, after = machine_in(state), LEADS_TO.get((state, event), state)
    reason = machine.detail, machine.step
    send(machine, event)
    assert machine.state is after
    if state is after and state in ENDED and event != "note":
        assert (machine.detail, machine.step) == reason
    if after in (State.IDLE, State.RUNNING):
        assert machine.step is None


@pytest.mark.parametrize(("state", "request_"), list(itertools.product(State, REQUESTS)))
def test_every_request_is_done_or_refused_with_the_reason(state, request_):
    machine = machine_in(state)
    detail, step = machine.detail, machine.step
    answer = send(machine, request_)
    assert answer.accepted == (state in REQUESTS[request_])
    if not answer.accepted:
        assert answer.text == f"can't {request_}: the test is {state} ({detail})"
        assert (machine.detail, machine.step) == (detail, step)


@pytest.mark.parametrize("state", ENDED)
def test_a_rig_that_moves_is_not_reset(state):
    machine = machine_in(state)
    answer = machine.reset(moving=True)
    assert not answer.accepted
    assert answer.text == f"can't reset: the rig is not at rest ({state})"
    assert machine.state is state


def test_an_idle_test_says_what_it_waits_for():
    machine = machine_in(State.READY)
    machine.peers("node rig")
    assert machine.detail == "waiting for node rig"
    assert "waiting for node rig" in machine.start().text


@pytest.mark.parametrize("end", ["at_rest", "finish"])
def test_a_stop_is_an_end_not_a_trip(end):
    machine = machine_after(*RUNNING, ("stop",), state=State.RAMPING_DOWN)
    send(machine, end)
    assert machine.state is State.DONE
    assert (machine.detail, machine.step) == ("stopped by the operator", None)


def test_a_second_soft_cause_is_added_once_and_does_not_begin_the_ramp_anew():
    machine = machine_in(State.RAMPING_DOWN)
    for _ in range(3):
        machine.soft_trip("reference force is nan", 6)
    assert machine.state is State.RAMPING_DOWN
    assert machine.detail == "node recorder is silent; reference force is nan"
    assert machine.step == 5


def test_a_fault_makes_a_trip_of_a_stop():
    machine = machine_after(*RUNNING, ("stop",), ("soft_trip", "force", 6), ("at_rest",))
    assert machine.state is State.TRIPPED
    assert (machine.detail, machine.step) == ("stopped by the operator; force", 6)


@pytest.mark.parametrize("how", ["hard_trip", "estop"])
def test_a_hard_end_of_the_ramp_names_both_causes(how):
    machine = machine_in(State.RAMPING_DOWN)
    send(machine, how)
    reason = {"hard_trip": "velocity", "estop": "aborted by the operator"}[how]
    assert machine.state is State.TRIPPED
    assert machine.detail == f"{reason} (while ramping down: node recorder is silent)"


def test_of_two_reasons_in_one_step_the_rigs_own_stands_whichever_is_told_first():
    for told in (("limit", False), ("judge", True)), (("judge", True), ("limit", False)):
        machine = machine_in(State.RUNNING)
        for reason, by_rig in (*told, ("other rig", True)):
            machine.hard_trip(reason, 7, by_rig=by_rig)
        assert (machine.detail, machine.step) == ("judge", 7)
    machine.hard_trip("later", 8, by_rig=True)
    assert machine.detail == "judge"


def test_an_abort_after_a_trip_keeps_the_reason_of_that_and_names_it():
    machine = machine_in(State.TRIPPED)
    answer = machine.estop()
    assert answer.accepted
    assert "(force)" in answer.text
    assert (machine.detail, machine.step) == ("force", 7)


def test_what_is_found_out_after_a_trip_is_added_to_it_once():
    machine = machine_in(State.TRIPPED)
    machine.note("node rig has been silent since 1.00 s")
    machine.note("node rig has been silent since 1.00 s")
    assert machine.detail == "force; node rig has been silent since 1.00 s"


TIMEBASE = Timebase.from_rate(500.0)


def order(last=-1):
    found = SampleOrder(TIMEBASE)
    found.last = last
    return found


def state(name, **values):
    return ExperimentState(State(name), **values)


@pytest.mark.parametrize("step", [8, 9, 17, 8 + 4999])
def test_what_may_come_next(step):
    order(last=7).check("rig/state", step)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (7, "was answered"),
        (0, "was answered"),
        (10**9, "rig/state of step 1000000000 after step 7: far in the future"),
        (7 + 5001, "far in the future"),
    ],
)
def test_what_is_stale_or_from_far_in_the_future_is_refused(step, words):
    with pytest.raises(WireError, match=words):
        order(last=7).check("rig/state", step)


def test_in_lockstep_steps_come_one_by_one():
    found = order(last=7)
    found.follow(state("running", pace="lockstep"))
    found.check("rig/state", 8)
    with pytest.raises(WireError, match="far in the future"):
        found.check("rig/state", 9)
    found.follow(state("done"))
    found.follow(state("running", pace="realtime"))
    found.check("rig/state", 9)


def test_a_test_begins_once_each_time_that_one_has_ended():
    found = order()
    found.follow(state("running", steps=100))
    assert found.steps == 100
    assert found.begins(0)
    found.last = 50
    assert not found.begins(0)
    assert found.last == 50
    found.follow(state("ramping_down"))
    assert not found.begins(0)
    assert found.steps == 100
    found.follow(state("done", steps=100))
    assert found.steps == 0
    assert not found.begins(1)
    assert found.begins(0)
    assert found.last == -1


def test_a_sign_of_life_that_comes_late_does_not_begin_a_test_anew():
    found = order()
    found.follow(state("ready"))
    assert found.begins(0)
    found.follow(state("ready"))
    found.follow(state("running", steps=100))
    assert not found.begins(0)


def test_without_a_supervisor_each_first_sample_begins_a_test():
    found = order()
    assert found.begins(0)
    found.last = 0
    assert not found.begins(0)
    found.last = 10
    assert found.begins(0)
