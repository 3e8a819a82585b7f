"""What strangers tell of a test's nodes, in virtual time."""

import json

import pytest
from local_tools import LONG, NODES, UNREHEARSED, saved
from seft_msgs_py.node.senders import Follower
from seft_msgs_py.virtual.memory import MemoryEndpoint
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state, encode_state
from seft_msgs_py.wire.messages import encode_diagnostics, encode_string
from seft_msgs_py.wire.outcome import State, tripped_status
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS, EXPERIMENT_STATE

LIE = encode_diagnostics(0, [tripped_status("reference_force", "a lie", 7)])
FALSE = encode_string(json.dumps({"node": "reference_force", "parameters": {"rate": "x"}}))
FOREIGN = encode_state(ExperimentState(State.TRIPPED, "a lie", step=7))


@pytest.mark.parametrize("name", ["stranger", "reference_force"])
def test_a_lie_neither_ends_a_test_nor_gets_into_its_bag(running, tmp_path, name):
    """Also of a node that has joined under the name of one of the test's."""
    graph = running(LONG, f"recorder:directory:={tmp_path}", nodes=(*NODES, "recorder"))
    endpoint = MemoryEndpoint(graph.graph, "monitor")
    followed = dict.fromkeys((EXPERIMENT_STATE, DIAGNOSTICS, DESCRIPTION), 64)
    monitor = Follower(endpoint, followed, clock=graph.graph.clock)
    heard = []

    def watch():
        """What a monitor, and `seft run`, make of the test."""
        for topic in (DIAGNOSTICS, DESCRIPTION):
            heard.extend(each.raw for each in monitor.take(topic))
        heard.extend(states := [each.raw for each in monitor.take(EXPERIMENT_STATE)])
        return decode_state(states[-1]).detail

    graph.run(0.5)
    assert watch() == "running"
    for topic, raw in ((DIAGNOSTICS, LIE), (DESCRIPTION, FALSE)):
        send = graph.join(topic, name)
        for _ in range(5):
            send(raw)
            graph.run(0.3)
    assert graph.state == "running"
    assert watch() == "running"
    assert f"/{name} on diagnostics: 5" in graph.status("supervisor")["unexpected_publishers"]
    graph.call("estop")
    graph.run(0.05)
    for _ in range(5):
        graph.inject(EXPERIMENT_STATE, FOREIGN)
        graph.run(0.3)
    assert watch() == "aborted by the operator"
    assert not {LIE, FALSE, FOREIGN} & {*heard}
    assert len(heard) > 50
    recording = saved(graph)
    assert recording.trip.reason == "aborted by the operator"
    assert not any("a lie" in event.text for event in recording.events)


def test_a_test_does_not_start_with_a_second_node_of_a_name(local_graph):
    graph = local_graph(UNREHEARSED)
    graph.until("ready")
    graph.join(DIAGNOSTICS, "rig")
    graph.until("idle", within=0.5)
    assert "2 nodes rig publish diagnostics" in graph.values["detail"]
