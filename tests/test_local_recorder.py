"""The recorder in virtual time: its bag holds the test."""

import numpy as np
from local_tools import LONG, NODES, SIX, at_rest, offline, perform
from seft_msgs_py.wire.topics import REFERENCE_FORCE
from seft_ros.bags.record_bag import read_bag

RECORDED = (*NODES, "recorder")


def test_a_bag_holds_the_samples_of_the_offline_loop(local_graph, tmp_path):
    words = (f"recorder:directory:={tmp_path}", "recorder:name:=bag")
    graph = local_graph(SIX, *words, nodes=RECORDED)
    perform(graph)
    graph.until(lambda: graph.status("recorder")["phase"] == "saved")
    found, expected = read_bag(tmp_path / "bag"), offline(graph)
    assert (found.complete, found.missed, found.trip) == (True, 0, None)
    assert {*expected.series} <= {*found.series}
    for topic, series in expected.series.items():
        np.testing.assert_array_equal(found.series[topic].steps, series.steps)
        np.testing.assert_array_equal(found.series[topic].values, series.values)


def test_the_death_of_the_recorder_brings_the_test_down_softly(running, tmp_path):
    graph = running(LONG, f"recorder:directory:={tmp_path}", nodes=RECORDED)
    graph.kill("recorder")
    graph.until("tripped")
    assert "node recorder has been silent since" in graph.values["detail"]
    assert graph.samples(REFERENCE_FORCE)[1][-1, 0, 0] == 0.0
    assert at_rest(graph)
