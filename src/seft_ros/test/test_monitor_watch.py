"""What a monitor takes in from a graph, look by look."""

import json
from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.messages import encode_string
from seft_msgs_py.wire.topics import DESCRIPTION, RIG_STATE
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.experiment.tables import TABLES
from seft_ros.monitor.watch import Watch

CONFIG = Path(__file__).parents[3] / "config" / "jhu.yaml"
EXPERIMENT = Experiment.load(TABLES, [CONFIG])


class Graph:
    """Messages that wait until they are taken."""

    domain = 7

    def __init__(self):
        self.waiting = {}

    def send(self, topic, raw):
        self.waiting.setdefault(topic.name, []).append((raw, 0))

    def take(self, topic):
        return self.waiting.pop(topic.name, [])


def test_samples_wait_for_the_description_that_they_are_read_with():
    graph = Graph()
    watch = Watch(graph)
    codec = TrajectoryCodec(RIG_STATE, EXPERIMENT.axes, EXPERIMENT.timebase)
    for step in range(30):
        graph.send(RIG_STATE, codec.encode(step, np.zeros((4, 1))))
        if step < 20:
            watch.look()
    assert watch.intake is None
    described = {"node": "rig", "parameters": EXPERIMENT.sections["rig"]}
    graph.send(DESCRIPTION, encode_string(json.dumps(described)))
    watch.look()
    assert watch.intake.number == 1
    assert (watch.intake.history.recent().first, watch.intake.history.head) == (0, 30)
