"""The recorder in virtual time: its bag holds the test."""

import numpy as np
from local_tools import LOCKSTEP, LONG, NODES, SIX, at_rest, offline, perform
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE
from seft_plant_sim.rig_watch import MAX_UNRECORDED_STEPS
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


def test_in_lockstep_the_rig_waits_for_a_recorder_that_stands_still(running, tmp_path):
    words = (f"recorder:directory:={tmp_path}", "recorder:name:=bag")
    words += (LOCKSTEP, "rig:lockstep_timeout:=60.0", "supervisor:watchdog.peer_timeout:=60.0")
    graph = running(LONG, *words, nodes=RECORDED, latency=5e-4)
    before = len(graph.samples(RIG_STATE)[0])
    graph.freeze("recorder")
    graph.run(10.0)
    steps = len(graph.samples(RIG_STATE)[0])
    assert steps - before <= MAX_UNRECORDED_STEPS  # fewer than the recorder's queue holds
    graph.thaw("recorder")
    graph.run(1.0)
    assert len(graph.samples(RIG_STATE)[0]) > steps + 100
    graph.call("stop")
    graph.until(lambda: graph.status("recorder")["phase"] == "saved")
    found = read_bag(tmp_path / "bag")
    assert found.series["rig/state"].steps.tolist() == graph.samples(RIG_STATE)[0]
