"""Whole tests of the real nodes in virtual time: the way through, and the operator."""

import numpy as np
import pytest
from local_tools import (
    LOCKSTEP,
    NODES,
    SHORT,
    THREE_SECONDS,
    UNREHEARSED,
    assert_same,
    at_rest,
    offline,
    perform,
)
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.messages import decode_description
from seft_msgs_py.wire.topics import DESCRIPTION, REFERENCE_FORCE, RIG_STATE


def test_twice_the_same_messages_at_the_same_times(local_graph):
    one, other = (local_graph(*SHORT) for _ in range(2))
    perform(one)
    perform(other)
    assert len(one.graph.sent) > 3000
    assert one.graph.sent == other.graph.sent


@pytest.mark.parametrize(
    "order",
    [
        ("rig", "supervisor", "force_controller", "ground_motion", "reference_force"),
        ("supervisor", "reference_force", "rig", "ground_motion", "force_controller"),
    ],
)
def test_nodes_start_in_any_order_and_run_two_tests_in_a_row(local_graph, order):
    graph = local_graph(*SHORT, LOCKSTEP, nodes=order)
    for _ in (1, 2):
        graph.until("ready")
        assert graph.call("stop") == (False, "can't stop: the test is ready (all nodes are ready)")
        before = len(graph.samples(RIG_STATE)[0])
        assert graph.call("start")[0]
        graph.until("done")
        assert graph.call("start")[0] is False
        assert graph.call("reset")[0] is True
        assert len(graph.samples(RIG_STATE)[0]) - before == 851


def test_a_test_is_stopped_by_the_operator(running):
    graph = running()
    assert graph.call("stop") == (True, "the test is ramping down")
    accepted, answer = graph.call("stop")
    assert accepted and "stopped by the operator" in answer
    graph.until("done")
    force = graph.samples(REFERENCE_FORCE)[1][:, 0, 0]
    last = int(np.flatnonzero(force)[-1])
    motion = offline(graph).series["ground_motion"].values[last - 249 : last + 1, 0, 0]
    factors = 0.5 + 0.5 * np.cos(np.pi * np.arange(250) / 250)
    np.testing.assert_allclose(force[last - 249 : last + 1], -52.7 * motion * factors)


def test_estop_ends_the_test_at_once_and_a_reset_makes_the_next_possible(running):
    graph = running()
    assert graph.call("estop")[0]
    began = graph.scheduler.now
    graph.until(lambda: graph.status("rig")["phase"] == "tripped")
    assert graph.scheduler.now - began <= 10_000_000  # ns: within one look of this test
    assert graph.values["detail"] == "aborted by the operator"
    assert at_rest(graph)
    assert graph.call("reset")[0]
    graph.until("ready")
    assert graph.call("start")[0]


def test_live_parameters_may_be_set_and_others_not(local_graph):
    graph = local_graph(nodes=(*NODES, "recorder"))
    graph.until(lambda: graph.status("recorder").get("phase"))
    graph.set_parameter("recorder", "name", "next")
    with pytest.raises(InputError, match="read-only"):
        graph.set_parameter("recorder", "rate", 250.0)
    with pytest.raises(InputError, match="can't be set"):
        graph.set_parameter("recorder", "use_sim_time", True)
    with pytest.raises(InputError, match="name"):
        graph.set_parameter("recorder", "name", "a/b")
    wanted = ("recorder", DESCRIPTION.name)
    raws = [sent.raw for sent in graph.graph.sent if (sent.node, sent.topic) == wanted]
    assert [decode_description(raw)[1]["parameters"]["name"] for raw in raws] == ["", "next"]


def test_nodes_that_find_each_other_late_wait_until_all_are_connected(local_graph):
    graph = local_graph(THREE_SECONDS, UNREHEARSED, discovery=3.0)
    graph.run(2.9)
    accepted, answer = graph.call("start")
    assert not accepted
    assert "waiting for node ground_motion, reference_force, force_controller, rig" in answer
    perform(graph)
    assert_same(graph, offline(graph))


def test_nodes_in_one_process_give_the_bits_of_the_offline_loop(local_graph):
    loop = ("rig", "reference_force", "force_controller")
    graph = local_graph(THREE_SECONDS, nodes=("ground_motion", loop, "supervisor"))
    perform(graph)
    assert_same(graph, offline(graph))
