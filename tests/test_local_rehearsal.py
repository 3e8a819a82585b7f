"""The rehearsal of a loop, in virtual time."""

import pytest
from graph_tools import DEMO, JHU
from local_tools import THREE_SECONDS, assert_same, offline, perform
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND, rehearsed


@pytest.mark.parametrize(("config", "duration"), [(JHU, None), (DEMO, 2.5)])
def test_a_test_after_a_rehearsal_has_the_bits_of_the_offline_loop(local_graph, config, duration):
    asked = [f"supervisor:rehearsal.duration:={duration}"] if duration else []
    graph = local_graph(THREE_SECONDS, *asked, config=config)
    perform(graph)
    steps, states = graph.samples(rehearsed(RIG_STATE))
    assert steps == list(range(1250 if duration else 1000))
    assert abs(states[:, 0]).max() < 1e-4  # m: it does not obey
    assert graph.samples(rehearsed(VALVE_COMMAND))[0] == steps
    assert_same(graph, offline(graph))
    assert graph.values["detail"] == "1851 steps done"
    assert graph.status("rig")["missed"] == "0"


@pytest.mark.parametrize(
    ("topic", "late", "trip"),
    [
        (VALVE_COMMAND, 0.0022, "2.4"),
        (REFERENCE_FORCE, 0.0022, "2.4"),  # the next state overtakes it
        (REFERENCE_FORCE, 0.0061, "6.4"),
        (RIG_STATE, 0.0022, "2.4"),
    ],
)
def test_a_loop_that_answers_late_is_refused_with_a_rate_that_fits(local_graph, topic, late, trip):
    graph = local_graph(THREE_SECONDS)
    graph.delay(rehearsed(topic), late)
    graph.until(lambda: "does not fit" in graph.values.get("detail", ""))
    detail = graph.values["detail"]
    assert f"500 Hz does not fit here: round trip p99 {trip} ms, " in detail
    assert f"; {250 if late < 0.003 else 100} Hz does; " in detail
    assert graph.call("start")[0] is False


def test_a_loop_that_does_not_answer_is_refused_and_its_rehearsal_ends_with_its_node(local_graph):
    graph = local_graph(THREE_SECONDS)
    graph.drop(rehearsed(VALVE_COMMAND), range(1000))
    graph.until(lambda: "no answer came" in graph.values.get("detail", ""))
    graph.call("reset")
    graph.until(lambda: len(graph.samples(rehearsed(RIG_STATE))[0]) > 1100)
    graph.terminate("rig")
    graph.until(lambda: graph.endings == {"rig": 0}, within=0.5)


def test_a_loop_that_did_not_keep_its_rate_is_rehearsed_again_when_reset(local_graph):
    graph = local_graph(THREE_SECONDS)
    graph.delay(rehearsed(REFERENCE_FORCE), 0.0022)
    for again in (False, True):
        graph.until(lambda: "does not fit" in graph.values.get("detail", ""))
        if again:  # as late as before, then in time
            graph.graph.rules.clear()
        assert graph.call("reset") == (True, "the loop is rehearsed again")
        graph.until(lambda: "does not fit" not in graph.values["detail"], within=1.0)
    perform(graph)
    assert_same(graph, offline(graph))
    assert graph.samples(rehearsed(VALVE_COMMAND))[0][-1000:] == list(range(1000))
