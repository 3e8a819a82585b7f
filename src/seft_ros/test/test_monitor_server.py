"""What a monitor takes in from a graph, look by look."""

import json

import numpy as np
from experiments_at_hand import load
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import DESCRIPTION, EXPERIMENT_STATE, RIG_STATE
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.monitor.server import Watch

EXPERIMENT = load()
CODEC = TrajectoryCodec(RIG_STATE, EXPERIMENT.axes, EXPERIMENT.timebase)
DESCRIBED = json.dumps({"node": "rig", "parameters": EXPERIMENT.sections["rig"]})


class Graph:
    """Messages that wait until they are taken."""

    domain = 7

    def __init__(self):
        self.waiting = {}

    def send(self, topic, raw):
        self.waiting.setdefault(topic.name, []).append((raw, 0))

    def take(self, topic):
        return self.waiting.pop(topic.name, [])


def test_each_look_tells_the_time_and_what_was_asked_for_too_long_ago_is_refused():
    now, graph = 100.0, Graph()
    watch = Watch(graph, lambda: now)
    summary = watch.poll()
    assert json.loads(summary[-1]) == {"kind": "time", "at": 100_000}
    assert [json.loads(text)["kind"] for text in watch.poll()] == ["time"]
    graph.send(EXPERIMENT_STATE, encode_state(ExperimentState(State.READY)))
    watch.poll()
    assert watch.lateness(1, 100_000.0) == ""
    assert "the test is now ready" in watch.lateness(0, 100_000.0)
    now += 1.1
    assert "1.1 s late" in watch.lateness(1, 100_000.0)
    assert "late" in watch.lateness(1, 200_000.0)  # no time of ours
    assert "late" in watch.lateness(1, float("nan"))


def test_a_page_that_is_open_hears_that_another_test_begins():
    graph = Graph()
    watch = Watch(graph)
    graph.send(DESCRIPTION, encode_string(DESCRIBED))
    for step in range(30):
        graph.send(RIG_STATE, CODEC.encode(step, np.zeros((6, 1))))
    watch.poll()
    numbers = []
    for state in ("done", "done", "idle", "ready", "running"):
        graph.send(EXPERIMENT_STATE, encode_state(ExperimentState(State(state))))
        watch.poll()
        (test,) = (json.loads(t) for t in watch.everything() if t[:16] == '{"kind":"test","')
        numbers.append((test["test"], watch.intake.history.head))
    assert numbers == [(1, 30), (1, 30), (2, 0), (2, 0), (2, 0)]


def test_samples_wait_for_the_description_that_they_are_read_with():
    graph = Graph()
    watch = Watch(graph)
    for step in range(30):
        graph.send(RIG_STATE, CODEC.encode(step, np.zeros((6, 1))))
        if step < 20:
            watch.poll()
    assert watch.intake is None
    graph.send(DESCRIPTION, encode_string(DESCRIBED))
    watch.poll()
    assert watch.intake.number == 1
    assert (watch.intake.history.recent().first, watch.intake.history.head) == (0, 30)
