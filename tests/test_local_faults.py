"""Nodes that stand still, die, or are missing, in virtual time."""

import re

import numpy as np
import pytest
from local_tools import LOCKSTEP, LONG, NO_COMMAND_WATCH, NODES, UNREHEARSED, at_rest, perform
from seft_msgs_py.wire.messages import Status, encode_diagnostics
from seft_msgs_py.wire.outcome import tripped_status
from seft_msgs_py.wire.topics import DIAGNOSTICS, REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND
from seft_ros.bags.recording_bag import read_bag

SLOW = 5e-4  # s, latency with which a test in lockstep takes fewer steps


@pytest.mark.parametrize(
    ("node", "seconds", "symptom"),
    [
        ("rig", 0.8, "force_controller: no rig/state for 0.02 s"),
        ("rig", 2.5, "node rig has been silent since 0."),
        ("force_controller", 0.3, "no new valve_command for 0.02 s"),
        ("reference_force", 0.3, "no new valve_command for 0.02 s"),
    ],
)
def test_who_stood_still_comes_first_in_a_trip_s_reason(running, tmp_path, node, seconds, symptom):
    graph = running(LONG, f"recorder:directory:={tmp_path}", nodes=(*NODES, "recorder"))
    graph.freeze(node, seconds)
    graph.until("tripped", within=0.1)  # which does not wait for the cause
    step = graph.values["step"]
    cause = f"the {node} stood still for "
    graph.until(lambda: graph.values["detail"].startswith(cause), within=seconds)
    told, first = graph.values["detail"].removeprefix(cause).split(" s; ", 1)
    assert seconds - 0.06 <= float(told) <= seconds
    assert first.startswith(symptom)
    graph.until(lambda: graph.status("recorder")["phase"] == "saved")
    trip = read_bag(graph.status("recorder")["bag"]).trip
    known = graph.values["detail"] if seconds < 1.0 else first  # nobody waits for a silent node
    assert (trip.reason, trip.step) == (known, step)
    logged = [text for _, name, _, text in graph.graph.lines if name == "supervisor"]
    assert any(text.startswith(f"tripped: {cause}") for text in logged)


def test_of_nodes_that_stood_still_the_one_that_did_so_for_longest_comes_first(running):
    graph = running(LONG)
    graph.freeze("force_controller", 0.2)
    graph.freeze("reference_force", 0.4)
    graph.until("tripped", within=0.1)
    graph.run(0.6)
    stood = r"stood still for \S+ s"
    said = f"the reference_force {stood}; the force_controller {stood}; no new valve_command"
    assert re.match(said, graph.values["detail"])


def test_a_pause_of_who_is_not_waited_for_is_no_cause(running, tmp_path):
    graph = running(LONG, f"recorder:directory:={tmp_path}", nodes=(*NODES, "recorder"))
    graph.freeze("recorder", 0.3)
    graph.drop(VALVE_COMMAND, range(10**6), "rig")
    graph.until("tripped", within=0.1)
    graph.run(1.0)
    assert graph.values["detail"].startswith("no new valve_command for 0.02 s")


def test_a_trip_that_is_told_later_than_the_silence_that_followed_comes_first(running):
    graph = running(LONG)
    graph.kill("reference_force")
    graph.until("tripped", within=0.1)
    step, silence = int(graph.values["step"]), graph.values["detail"]
    assert silence.startswith("no new valve_command for")
    for later, reason in ((1, "what followed"), (-5, "computed.model took 0.1 s for a step")):
        told = encode_diagnostics(0, [tripped_status("force_controller", reason, step + later)])
        graph.inject(DIAGNOSTICS, told, "force_controller")
    graph.run(0.01)
    assert graph.values["detail"] == f"force_controller: {reason}; {silence}"
    graph.until(lambda: graph.values.get("silent") == ("reference_force",))
    assert at_rest(graph)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"phase": "tripped", "reason": "stopped", "step": "600"}, "stopped at step 600, and"),
        ({"phase": "idle"}, "has left the test"),
        ({"phase": "finished", "steps": "600"}, "finished after 600 of 101001 steps"),
    ],
)
def test_a_rig_that_ends_a_test_by_itself_trips_it(running, values, reason):
    graph = running(LONG)
    ended = encode_diagnostics(0, [Status("rig", 0, "", values=values)])
    graph.inject(DIAGNOSTICS, ended, "rig")
    graph.until("tripped", within=0.05)
    assert graph.values["detail"].startswith(f"node rig {reason}")


def test_a_rig_that_stood_still_for_some_periods_counts_that_and_does_not_hurry(running):
    graph = running(LONG)
    count = len(graph.samples(RIG_STATE)[0])
    while len(graph.samples(RIG_STATE)[0]) == count:
        graph.run(1e-4)
    graph.freeze("rig", 0.011)  # before the command for this sample has come
    graph.until(lambda: graph.status("rig")["overruns"] == "1", within=2.0)
    sent = [each.at_ns for each in graph.graph.sent if each.topic == RIG_STATE.name]
    *periods, longest = sorted(np.diff(sent[count:]))
    assert longest > 0.01e9
    np.testing.assert_allclose(periods, 0.002e9, rtol=1e-6)
    assert graph.status("rig")["missed"] == "0"


@pytest.mark.parametrize(("how", "pace"), [("kill", "realtime"), ("freeze", "lockstep")])
@pytest.mark.parametrize(
    "node", ["force_controller", "reference_force", "rig", "ground_motion", "supervisor"]
)
def test_a_node_that_dies_or_stands_still_ends_the_test_and_is_named(running, node, how, pace):
    graph = running(LONG, NO_COMMAND_WATCH, f"rig:pace:={pace}", latency=SLOW)
    getattr(graph, how)(node)
    if node == "supervisor":
        graph.until(lambda: graph.status("rig")["phase"] == "tripped", within=2.0)
        assert graph.status("rig")["reason"] == "node supervisor has been silent for 1 s"
        return
    graph.until("tripped", within=5.0)
    graph.until(lambda: "silent" in graph.values)
    assert f"node {node} has been silent since " in graph.values["detail"]
    if node == "ground_motion":
        assert graph.samples(REFERENCE_FORCE)[1][-1, 0, 0] == 0.0


@pytest.mark.parametrize(
    "node", ["force_controller", "reference_force", "rig", "ground_motion", "supervisor"]
)
def test_a_node_that_fails_while_the_force_comes_down_ends_the_test(running, node):
    graph = running(LONG, LOCKSTEP, "reference_force:ramp_down_time:=60.0", latency=SLOW)
    graph.call("stop")
    graph.run(0.5)
    graph.kill(node)
    if node == "supervisor":
        graph.until(lambda: graph.status("rig")["phase"] == "tripped", within=2.0)
    elif node == "ground_motion":
        graph.run(5.0)
        assert graph.state == "ramping_down"
        graph.call("estop")
        assert "stopped by the operator" in graph.values["detail"]
    else:
        graph.until("tripped", within=5.0)
        assert "stopped by the operator" in graph.values["detail"]
        assert f"node {node} has been silent since" in graph.values["detail"]


def test_a_start_that_waited_while_the_supervisor_stood_still_is_refused(local_graph):
    graph = local_graph(UNREHEARSED, nodes=("supervisor", "ground_motion", "rig"))
    graph.until("ready")
    graph.freeze("supervisor", 1.5)
    accepted, answer = graph.call("start")
    assert not accepted
    assert "has stalled" in answer


def test_nodes_that_are_terminated_end_cleanly_and_the_others_miss_them(running):
    graph = running(LONG, LOCKSTEP, latency=SLOW)
    graph.terminate("force_controller")
    graph.until("tripped")
    assert "node force_controller has been silent since" in graph.values["detail"]
    graph.until(lambda: graph.call("reset")[0])
    gone = ["force_controller"]
    for node in ("rig", "ground_motion", "reference_force"):
        graph.terminate(node)
        gone.append(node)
        known = ("ground_motion", "reference_force", "force_controller", "rig")
        missed = "waiting for node " + ", ".join(n for n in known if n in gone)
        graph.until(lambda missed=missed: graph.values["detail"] == missed)
        assert graph.call("start") == (False, f"can't start: the test is idle ({missed})")
    graph.terminate("supervisor")
    assert graph.endings == dict.fromkeys((*gone, "supervisor"), 0)


def test_a_link_that_is_cut_brings_the_force_down_before_the_rig_closes_its_valve(running):
    """As the hosts of rig and force controller see it: all others stand still."""
    graph = running(LONG, NO_COMMAND_WATCH, "loop_delay:=9")
    graph.run(3.0)
    peak = abs(graph.samples(RIG_STATE)[1][-500:, 3]).max()
    for node in ("ground_motion", "reference_force", "supervisor"):
        graph.freeze(node)
    graph.until(lambda: graph.status("rig")["phase"] == "tripped", within=2.0)
    assert graph.status("rig")["reason"] == "node supervisor has been silent for 1 s"
    assert abs(graph.samples(RIG_STATE)[1][-1, 3]) < 0.1 * peak
    assert peak > 100.0


def test_a_rig_that_comes_back_in_the_middle_of_a_test_stays_at_rest(running):
    allowed = (
        "rig:watchdog.command_timeout",
        "supervisor:watchdog.peer_timeout",
        "rig:watchdog.supervisor_timeout",
        "force_controller:watchdog.reference_timeout",
    )
    graph = running(LONG, *(f"{word}:=60.0" for word in allowed))
    graph.kill("rig")
    before = len(graph.samples(RIG_STATE)[0])
    graph.start("rig")
    graph.run(3.0)
    assert graph.state == "running"
    logged = [text for _, node, _, text in graph.graph.lines if node == "rig"]
    assert any("before this rig was ready" in text for text in logged)
    assert len(graph.samples(RIG_STATE)[0]) == before


def test_a_missing_peer_in_lockstep_ends_the_test_with_its_name(local_graph):
    nodes = ("ground_motion", "reference_force", "rig", "supervisor")
    graph = local_graph(LOCKSTEP, "rig:lockstep_timeout:=1.0", nodes=nodes)
    perform(graph, "tripped")
    assert graph.values["detail"].startswith("no valve_command for step 0 within 1 s")
    assert "is force_controller running?" in graph.values["detail"]
    assert len(graph.samples(RIG_STATE)[0]) == 1


def test_what_a_silent_node_has_done_meanwhile_is_added_when_its_link_is_back(running):
    graph = running(LONG, LOCKSTEP, latency=SLOW)
    graph.freeze("force_controller")
    graph.until("tripped")
    detail = graph.values["detail"]
    assert detail.startswith("node force_controller has been silent since")
    cut = "no reference_force for 50 steps; is the link to the reference_force node cut?"
    for _ in range(3):  # it says so again and again
        for node, reason in (("force_controller", cut), ("reference_force", "what follows")):
            lost = encode_diagnostics(0, [tripped_status(node, reason, 100, 0.1)])
            graph.inject(DIAGNOSTICS, lost, node)
        graph.run(0.2)
    assert graph.values["detail"] == f"{detail}; force_controller: {cut}"
