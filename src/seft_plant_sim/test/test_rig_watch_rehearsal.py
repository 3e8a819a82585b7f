"""The rig's side of a rehearsal, with a loop that answers as it is told to."""

from types import SimpleNamespace

import numpy as np
import pytest
from seft_msgs_py.wire.topics import (
    LOOP_TOPICS,
    RIG_STATE,
    VALVE_COMMAND,
    RigAxes,
    Timebase,
    rehearsed,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.rig_watch import Rehearsal

TIMEBASE = Timebase.from_rate(100.0)


class Loop:
    """Stands for the shell and the other nodes: answers each step after a delay, or never."""

    def __init__(self, delay_of):
        self.rig, self._now = RigAxes.whole(["x"]), 100.0
        self.clock = SimpleNamespace(monotonic=lambda: self._now)
        self.states, self.published = [], []
        self._delay_of, self._due = delay_of, []
        self._codecs = [TrajectoryCodec(t, ("x",), TIMEBASE) for t in (RIG_STATE, VALVE_COMMAND)]

    def publisher(self, topic):
        self.published.append(topic.name)
        return self._hear

    def subscribe(self, topic, receive, reliable=True):
        assert topic == rehearsed(VALVE_COMMAND)
        self._receive = receive

    def _hear(self, raw):
        step, values = self._codecs[0].decode(raw)
        self.states.append(values[0])
        delay = self._delay_of(step)
        if delay is not None:
            raw = self._codecs[1].encode(step, np.array([0.5]))
            self._due.append((self._now + delay, raw))

    def spin_once(self, timeout):
        """Let time go by until an answer comes, or to the end of the timeout."""
        end = self._now + max(timeout, 1e-9)
        if not self._due or self._due[0][0] > end:
            self._now = end
            return False
        at, raw = self._due.pop(0)
        self._now = max(self._now, at)
        self._receive(raw, 0)
        return True


def rehearse(delay_of, stop=lambda: False, sample=lambda step: np.zeros((4, 1))):
    loop = Loop(delay_of)
    return loop, Rehearsal(loop, TIMEBASE, VALVE_COMMAND, 10.0).run(0.4, sample, stop)


def test_a_quick_loop_misses_nothing_and_its_round_trip_is_told():
    loop, found = rehearse(lambda step: 0.001)
    assert (found["rate_hz"], found["steps"]) == (100.0, 30)  # the others are not at the rate
    assert len(loop.states) == 40
    assert (found["missed"], found["overruns"]) == (0, 0)
    assert found["round_trip_s"]["largest"] == pytest.approx(0.001)


def test_a_loop_that_is_slower_than_a_period_misses_its_steps():
    _, found = rehearse(lambda step: 0.015)
    assert (found["missed"], found["overruns"]) == (30, 0)
    assert found["round_trip_s"]["largest"] == pytest.approx(0.015)


def test_a_loop_that_does_not_answer_misses_all_steps():
    _, found = rehearse(lambda step: None)
    assert (found["missed"], found["round_trip_s"], found["round_trip_alone_s"]) == (39, {}, {})


def test_answers_that_queue_do_not_hide_how_fast_the_loop_can_be():
    busy = [0.0]

    def queued(step):  # each answer takes 25 ms, one after the other
        now, busy[0] = loop._now, max(busy[0], loop._now) + 0.025
        return busy[0] - now

    loop = Loop(queued)
    found = Rehearsal(loop, TIMEBASE, VALVE_COMMAND, 10.0).run(
        2.0, lambda step: np.zeros((4, 1)), lambda: False
    )
    assert found["missed"] == found["steps"] == 150
    assert found["round_trip_s"]["largest"] > 0.5
    assert found["round_trip_alone_s"]["p99"] == pytest.approx(0.025, rel=0.06)  # a bin


def test_commands_are_not_obeyed_and_samples_are_those_of_the_rig_at_rest():
    asked = []

    def sample(step):
        asked.append(step)
        return np.full((4, 1), float(step))

    loop, _ = rehearse(lambda step: 0.0, sample=sample)
    assert asked == list(range(40))
    assert [state[0, 0] for state in loop.states] == asked


def test_it_ends_early_where_it_is_told_to():
    calls = iter([False] * 20 + [True] * 1000)
    loop, found = rehearse(lambda step: 0.0, stop=lambda: next(calls))
    assert len(loop.states) < 25
    assert found["steps"] == max(len(loop.states) - 10, 0)


@pytest.mark.parametrize("topic", LOOP_TOPICS)
def test_a_rehearsal_has_topics_that_no_bag_holds_and_no_test_has(topic):
    own = rehearsed(topic)
    assert own.name == f"rehearsal/{topic.name}"
    assert not own.recorded
    assert own != topic and own.quantities == topic.quantities


def test_the_rig_publishes_on_the_rehearsals_topic_alone():
    loop, _ = rehearse(lambda step: 0.0, stop=lambda: True)
    assert loop.published == ["rehearsal/rig/state"]
