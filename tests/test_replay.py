"""A recorded test is computed once more, bit for bit."""

import pytest
from graph_tools import DEMO, JHU
from local_tools import LOCKSTEP, LONG, NODES, UNREHEARSED, begin, saved

SHORT = ("-p", "ground_motion:synthetic.duration:=2.0", "-p", "ground_motion:tail:=0.2")


def test_of_a_simulated_test_who_needs_the_coming_motion_is_left_out(seft):
    seft("simulate", DEMO, *SHORT, "--out", "bag", status=0)
    done = seft("replay", "bag", status=0)
    assert "force_controller is left out: force_controller needs the future motion" in done.stderr
    assert "rig: 601 answers, a as recorded, b replayed" in done.stdout
    assert done.stdout.count("identical, bit for bit") == 2


@pytest.mark.parametrize("config", [JHU, DEMO])  # which looks ahead and identifies on line
def test_every_node_answers_a_stopped_test_bit_for_bit(local_graph, seft_json, tmp_path, config):
    words = (LONG, LOCKSTEP, UNREHEARSED)
    words += (f"recorder:directory:={tmp_path}", "recorder:name:=bag")
    nodes = (*NODES, "recorder")
    graph = local_graph(*words, config=config, nodes=nodes, latency=5e-4)
    begin(graph)
    graph.run(1.5)
    assert graph.call("stop")[0]
    saved(graph)
    result = seft_json("replay", "bag")
    assert result["identical"] is True
    for one in result["replays"]:
        assert (one["identical"], one["notes"]) == (True, [])
    nodes = [one["node"] for one in result["replays"]]
    assert nodes == ["reference_force", "force_controller", "rig"]
    if config == DEMO:
        assert result["replays"][0]["topics"]["reference_force/estimates"]["max_abs"] == 0.0
