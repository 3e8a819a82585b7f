"""Of several nodes that send on a topic of a running test, the one that was there before counts."""

from types import SimpleNamespace

import pytest
from seft_msgs_py.node.senders import NAMELESS, UNNAMED, Senders, connected_listeners
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, RIG_STATE

TRUE, FALSE = bytes([1] * 16), bytes([2] * 16)


class Graph:
    """Who publishes one topic: identifiers and names; as many are connected."""

    def __init__(self, **nodes):
        self.nodes = nodes or {"/rig": TRUE}
        self.connected, self.asked = None, []

    def publishers(self, topic_name):
        self.asked.append(topic_name)
        return {identifier: node for node, identifier in self.nodes.items()}

    def publisher_count(self, *topic_name):
        if topic_name:
            return 10 + len(self.nodes)
        return len(self.nodes) if self.connected is None else self.connected


@pytest.fixture(params=[RIG_STATE, EXPERIMENT_STATE])
def topic(request):
    return request.param


def senders_of(graph, topic):
    found = Senders(graph)
    found.add(topic, f"/{topic.name}", graph)
    return found


def test_before_a_test_nobody_is_a_stranger(topic):
    senders = senders_of(Graph(), topic)
    assert not senders.is_unexpected(topic.name, FALSE)


def test_who_joins_a_test_is_a_stranger_until_it_ends(topic):
    graph = Graph()
    senders = senders_of(graph, topic)
    senders.follow("running")
    assert senders.poll() == ""
    graph.nodes["/other"] = FALSE
    senders.follow("running")  # running, then ramping down: one test
    assert not senders.is_unexpected(topic.name, TRUE)
    assert senders.is_unexpected(topic.name, FALSE)
    assert senders.unexpected_publishers() == f"{UNNAMED} on {topic.name}: 1"
    assert senders.poll() == f"/other publishes {topic.name}, too: this test ignores its messages"
    assert senders.poll() == ""
    assert senders.is_unexpected(topic.name, FALSE)
    assert senders.unexpected_publishers() == f"/other on {topic.name}: 2"
    senders.follow("tripped")
    assert senders.is_unexpected(topic.name, FALSE) == (topic == EXPERIMENT_STATE)
    senders.follow("idle")
    assert not senders.is_unexpected(topic.name, FALSE)
    del graph.nodes["/other"]
    senders.follow("running")
    assert senders.unexpected_publishers() == ""
    assert senders.is_unexpected(topic.name, FALSE)
    assert (
        senders.unexpected_publishers() == f"{UNNAMED} on {topic.name}: 1"
    )  # what it was before, is past
    senders.follow("idle")
    assert not senders.is_unexpected(topic.name, FALSE)


def test_a_stranger_that_says_nothing_is_named_too_once_its_name_is_known():
    graph = Graph()
    senders = senders_of(graph, RIG_STATE)
    senders.follow("running")
    graph.nodes[f"/{NAMELESS}"] = FALSE
    assert senders.poll() == ""
    graph.nodes = {"/rig": TRUE, "/other": FALSE}
    assert senders.poll().startswith("/other publishes rig/state")
    assert senders.unexpected_publishers() == "/other on rig/state: 0"


def test_the_graph_is_asked_only_where_there_may_be_a_stranger_without_a_name():
    graph, other = Graph(), Graph()
    senders = senders_of(graph, RIG_STATE)
    senders.add(EXPERIMENT_STATE, "/experiment/state", other)
    senders.follow("running")

    def polled():
        """Whether something is new, and on which topics the graph was asked for it."""
        graph.asked.clear()
        return bool(senders.poll()), graph.asked

    mine, its = ["/rig/state"], ["/experiment/state"]
    assert polled() == (0, [])
    senders.is_unexpected(RIG_STATE.name, FALSE)
    assert polled() == (0, mine)  # it sends, and is not known yet
    graph.nodes["/other"] = FALSE
    assert polled() == (1, mine)
    assert polled() == (0, [])
    other.connected = 2
    assert polled() == (1, its)
    assert polled() == (0, [])
    graph.nodes["/third"] = bytes([3] * 16)
    assert polled() == (1, mine)
    assert polled() == (0, [])


def test_however_many_join_the_graph_is_asked_once_and_one_line_is_logged():
    """Each takes a millisecond, and a rig at rest for 20 ms ends the test."""
    graph, other = Graph(), Graph()
    senders = senders_of(graph, RIG_STATE)
    senders.add(EXPERIMENT_STATE, "/experiment/state", other)
    senders.follow("running")
    for each in (graph, other):
        each.nodes |= {f"/n{k:02}": bytes([9 + k] * 16) for k in range(20)}
    for k in range(20):
        senders.is_unexpected(RIG_STATE.name, bytes([9 + k] * 16))
    for _ in range(2):
        graph.asked.clear()
        other.asked.clear()
        assert "/n07, 12 more publish" in senders.poll()
        assert len(graph.asked + other.asked) == 1
    assert len(senders.unexpected_publishers()) < 300


def test_a_supervisor_that_was_started_again_is_accepted_when_the_first_one_is_known_to_be_gone():
    graph = Graph(**{"/supervisor": TRUE})
    senders = senders_of(graph, EXPERIMENT_STATE)
    senders.follow("running")

    def is_refused():
        senders.poll()
        return senders.is_unexpected(EXPERIMENT_STATE.name, FALSE)

    assert all(is_refused() for _ in range(50))  # the first one may have stalled
    graph.nodes = {"/supervisor": FALSE}
    assert not is_refused()
    senders.follow("running")
    graph.nodes = {"/other": bytes([3] * 16)}
    assert all(senders.is_unexpected(EXPERIMENT_STATE.name, TRUE) for _ in range(3))


def test_publishers_are_counted_by_topic():
    senders = senders_of(Graph(), RIG_STATE)
    senders.add(EXPERIMENT_STATE, "/experiment/state")  # comes from this process
    assert senders.counts() == {RIG_STATE.name: 1, EXPERIMENT_STATE.name: 11}
    senders.add(EXPERIMENT_STATE, "/experiment/state", Graph())
    assert senders.conflict() == ""


@pytest.mark.parametrize(("connected", "heard"), [(1, set()), (2, {"rig", "/far/rig"}), (3, 2)])
def test_listeners_are_named_once_all_who_are_known_are_connected(connected, heard):
    endpoint = SimpleNamespace(listeners={"/a": ["/test/rig", "/far/rig"]}.__getitem__)
    publisher = SimpleNamespace(topic_name="/a", listener_count=lambda: connected)
    found = connected_listeners(endpoint, publisher, "/test")
    assert found == heard or len(found) == heard


def test_of_two_who_are_there_at_the_begin_both_are_named_and_none_is_chosen():
    senders = senders_of(Graph(**{"/rig": TRUE, "/other": FALSE}), RIG_STATE)
    assert senders.conflict() == "2 nodes publish rig/state (/other, /rig)"
    senders.follow("running")
    assert not senders.is_unexpected(RIG_STATE.name, FALSE)
    assert senders.poll() == ""


def test_who_is_known_and_not_connected_yet_is_distinguished_by_its_name():
    graph = Graph(**{"/rig": TRUE, "/other": FALSE})
    graph.connected = 1
    senders = senders_of(graph, RIG_STATE)
    senders.follow("running")
    assert senders.is_unexpected(RIG_STATE.name, FALSE)
