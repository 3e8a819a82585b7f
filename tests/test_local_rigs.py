"""Tests of two rigs in virtual time."""

import json

import numpy as np
import pytest
from graph_tools import BRIDGE
from local_tools import LONG, RIGS_NODES, offline, perform
from seft_msgs_py.wire.topics import RIG_STATE, rigs_of

SHORT = ("ground_motion:synthetic.duration:=3.0", "ground_motion:tail:=0.5")


@pytest.mark.parametrize(("pace", "loop_delay"), [("realtime", 5), ("lockstep", 0)])
def test_two_rigs_give_the_bits_of_the_offline_loop(local_graph, pace, loop_delay):
    words = (*SHORT, f"rig:pace:={pace}", f"loop_delay:={loop_delay}")
    graph = local_graph(*words, config=BRIDGE, nodes=RIGS_NODES)
    perform(graph)
    record = offline(graph)
    states = record.series["rig/state"].values
    reported = [json.loads(graph.status(f"{rig}/rig")["simulated"]) for rig in ("west", "east")]
    assert {key: max(one[key] for one in reported) for key in reported[0]} == vars(record.simulated)
    for number, rig in enumerate(rigs_of(graph.experiment.axes)):
        steps, values = graph.samples(RIG_STATE, rig)
        assert steps == list(range(len(states)))
        np.testing.assert_array_equal(values[:, :, 0], states[:, :, number])
        assert graph.status(rig.node("rig"))["missed"] == "0"


def test_the_death_of_one_rig_ends_the_test_for_both(running):
    patient = (
        "reference_force:watchdog.rig_timeout:=1.0",
        "supervisor:watchdog.peer_timeout:=15.0",
        "rig:watchdog.command_timeout:=60.0",
    )
    graph = running(LONG, *patient, config=BRIDGE, nodes=RIGS_NODES)
    graph.kill("west/rig")
    graph.until("tripped", within=10.0)
    assert "no rig/state of west for 1 s" in graph.values["detail"]
    graph.until(lambda: graph.status("east/rig")["phase"] == "tripped", within=1.0)
    west, east = (graph.samples(RIG_STATE, rig)[0][-1] for rig in graph.experiment.rigs)
    assert west <= east <= west + 2  # it waited for the other's
