"""A test that `seft run` watches ends, whatever others ask of the supervisor meanwhile."""

from types import SimpleNamespace

import pytest
from experiments_at_hand import load
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import EXPERIMENT_STATE
from seft_ros.test_run.observer import Observer
from seft_ros.test_run.run import RunMonitor

READY = ExperimentState(State.READY, "all nodes are ready")
RUNNING = ExperimentState(State.RUNNING, "running", steps=9)
TRIPPED = ExperimentState(State.TRIPPED, "the operator aborted", step=5, silent=())
DONE = ExperimentState(State.DONE, "9 steps done", steps=9)
RESET = ExperimentState(State.IDLE, "reset")


class Hears(Observer):
    """Hears some states at each poll; none after the last: who polls on waits for ever."""

    def __init__(self, *polls):
        self._polls, self._node, self.asked = iter(polls), None, []
        self.state, self.ended, self.time_ns = "", None, 0
        self.running, self.recorder_phase = set(), "saved"
        self._awake = SimpleNamespace(time=lambda: 0.0)
        self._test = SimpleNamespace(take=self._take)

    def _take(self, topic):
        states = next(self._polls) if topic == EXPERIMENT_STATE else ()
        return [SimpleNamespace(raw=encode_state(state)) for state in states]

    def spin(self, timeout):
        self._receive()

    def call(self, service, patience=0.0):
        self.asked.append(service)
        self._receive()
        return True, ""


def monitor(*polls):
    processes = SimpleNamespace(ended=dict, stopped=tuple, settle=lambda lockstep: None)
    observer = Hears(*polls)
    return RunMonitor(observer, processes, lambda *_: None, load()), observer


@pytest.mark.parametrize(
    ("polls", "fault"),
    [
        (([RUNNING], [TRIPPED, RESET]), ""),
        (([RUNNING], [TRIPPED], [RESET]), ""),
        (([RUNNING, TRIPPED, RESET],), ""),
        (([RUNNING], [RESET]), ""),  # what came between was not heard
        (([READY], [RUNNING], [DONE, RESET, READY]), ""),
        (([RUNNING], [ExperimentState(State.TRIPPED, "a fault", silent=())], [RESET]), "a fault"),
    ],
)
def test_a_test_that_is_reset_at_once_has_ended(polls, fault):
    watch, observer = monitor(*polls)
    assert watch.to_the_end().startswith(fault)
    assert observer.ended.state in (State.TRIPPED, State.DONE)
    watch.wait_until_saved()  # polls no more


def test_an_interruption_ends_a_test_that_was_reset_without_another_request():
    watch, observer = monitor([RUNNING], [TRIPPED, RESET])
    observer.spin(0.0)
    assert watch.bring_down() is False
    assert observer.asked == ["stop"]


def test_the_end_of_an_earlier_test_is_not_that_of_the_next_one():
    watch, observer = monitor([RUNNING], [DONE, RESET, READY], [READY], [RUNNING], [DONE])
    observer.spin(0.0)
    observer.refuse_twins = lambda topics: observer.spin(0.0)
    watch._wait_until_ready = lambda deadline: None
    watch.start()
    assert observer.ended is None
    watch.to_the_end()
    assert observer.ended.state is State.DONE
