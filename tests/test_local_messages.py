"""Messages that are late, lost, bad, or of somebody else, in virtual time."""

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from bad_messages import bad_messages
from local_tools import (
    LOCKSTEP,
    LONG,
    SHORT,
    TARGET_MOTION,
    THREE_SECONDS,
    UNREHEARSED,
    assert_same,
    at_rest,
    begin,
    offline,
    perform,
)
from seft_msgs_py.node.node_shell import NodeKind
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import (
    EXPERIMENT_STATE,
    LOOP_TOPICS,
    MEASURED,
    REFERENCE_FORCE,
    RIG_STATE,
    TARGET,
    VALVE_COMMAND,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.rig_node import RigNode
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_ros.nodes.loop_node import NODE_KINDS


@pytest.mark.parametrize("topic", [VALVE_COMMAND, REFERENCE_FORCE, RIG_STATE])
def test_one_lost_message_is_one_missed_command(local_graph, topic):
    graph = local_graph(THREE_SECONDS, UNREHEARSED)
    graph.drop(topic, {500})
    perform(graph)
    reported = graph.status("rig")
    assert (reported["missed"], reported["missed_steps"]) == ("1", "500")
    assert_same(graph, offline(graph), steps=501 if topic == VALVE_COMMAND else 500)


class Ahead(RigNode):
    """A rig of one's own: it stamps each sample with the next step, and obeys what answers that."""

    def _publish(self, step, sample, begun):
        own = self._state_codec
        self._state_codec = SimpleNamespace(encode=lambda k, values: own.encode(k + 1, values))
        super()._publish(step, sample, begun)
        self._state_codec = own
        for command in (self._valve, self._drive, self._fallback_stop):
            command.current = step + 1


def test_a_rig_whose_first_sample_is_not_of_step_0_trips_before_its_valve_moves(local_graph):
    kinds = NODE_KINDS | {"rig": NodeKind(RIG_TABLE, [RIG_TABLE], Ahead)}
    graph = local_graph(THREE_SECONDS, UNREHEARSED, *TARGET_MOTION, kinds=kinds)
    perform(graph, "tripped")
    assert "rig/state begins with step 1, not 0" in graph.values["detail"]
    assert not any(values.any() for values in graph.samples(VALVE_COMMAND)[1])


def test_a_rig_that_misses_commands_continues_along_its_fallback_stop(local_graph):
    graph = local_graph(THREE_SECONDS, UNREHEARSED, *TARGET_MOTION)
    graph.drop(VALVE_COMMAND, range(800, 809))  # the last that the watchdog allows, in fast motion
    perform(graph)
    displacement = graph.samples(RIG_STATE)[1][:, 0, 0]
    meant = offline(graph).series[RIG_STATE.name].values[:, 0, 0]
    assert graph.status("rig")["missed"] == "9"
    assert abs(displacement - meant).max() < 0.02 * abs(meant).max()  # a held valve: 0.19


def test_the_detectors_know_what_a_rig_applies_while_answers_queue(local_graph):
    often = "supervisor:watchdog.missed_share:=1.0"
    graph = local_graph(THREE_SECONDS, UNREHEARSED, *TARGET_MOTION, often)
    for step in (700, 800, 900, 1000):
        for place in range(12):
            graph.delay(TARGET, 0.014 - 0.001 * place, {step + place})
    perform(graph)
    assert graph.status("rig")["missed"] == "48"
    assert not graph.status("rig")["nearest detector"].startswith("oil_balance")


def test_a_late_command_is_missed_and_a_very_late_one_trips(local_graph):
    graph = local_graph(THREE_SECONDS, UNREHEARSED)
    graph.delay(VALVE_COMMAND, 0.003, {500})
    perform(graph)
    assert (graph.status("rig")["missed"], graph.status("rig")["missed_steps"]) == ("1", "500")
    graph.delay(VALVE_COMMAND, 0.5, range(700, 2000))
    graph.call("reset")
    perform(graph, "tripped")
    assert graph.values["detail"].startswith(
        "no new valve_command for 0.02 s (the last is of step 699)"
    )
    assert at_rest(graph)


def test_a_command_just_in_time_is_not_missed(local_graph):
    graph = local_graph(THREE_SECONDS, UNREHEARSED)
    graph.delay(VALVE_COMMAND, 0.0016)
    perform(graph)
    assert graph.status("rig")["missed"] == "0"
    assert float(graph.status("rig")["round trip median (ms)"]) == pytest.approx(1.9, rel=0.07)
    assert_same(graph, offline(graph))


@pytest.mark.parametrize("lost", [RIG_STATE, TARGET])
def test_what_is_lost_on_a_link_costs_little(local_graph, lost):
    """Four of forty states, or targets; what is lost of either is bridged."""
    words = (*TARGET_MOTION, "loop_delay:=7")
    graph = local_graph(THREE_SECONDS, UNREHEARSED, *words)
    reader = "reference_force" if lost is RIG_STATE else None
    graph.drop(lost, {step for step in range(2000) if step % 40 > 35}, reader)
    perform(graph)
    displacement = graph.samples(RIG_STATE)[1][:, 0, 0]
    meant = offline(graph).series[RIG_STATE.name].values[:, 0, 0]
    assert abs(displacement - meant).max() < 0.01 * abs(meant).max()  # not bridged: 0.6
    assert graph.status("rig")["missed"] == "0"


@pytest.mark.parametrize(
    ("pace", "seconds", "as_stranger"), [("realtime", 3.0, True), ("lockstep", 14.0, False)]
)
def test_bad_messages_change_no_bit_of_a_test(local_graph, pace, seconds, as_stranger):
    motion = f"ground_motion:synthetic.duration:={seconds}"
    graph = local_graph(motion, UNREHEARSED, f"rig:pace:={pace}")
    begin(graph)
    graph.run(0.1)
    injected = set()
    for _ in range(5):
        for topic in LOOP_TOPICS:
            for raw in bad_messages(topic, graph.experiment).values():
                graph.inject(topic, raw, "stranger" if as_stranger else topic.publisher)
                injected.add(raw)
                graph.run(0.003)
    assert graph.state == "running"
    graph.until("done")
    for node in ("rig", "force_controller", "reference_force"):
        assert int(graph.status(node)["refused"]) > 5
    graph.graph.sent[:] = [sent for sent in graph.graph.sent if sent.raw not in injected]
    assert_same(graph, offline(graph))
    assert not any(line.level == "error" for line in graph.graph.lines)


def test_a_stranger_s_valve_commands_are_named_and_not_obeyed(running):
    graph = running(THREE_SECONDS)
    graph.join(VALVE_COMMAND)
    codec = TrajectoryCodec(VALVE_COMMAND, graph.experiment.axes, graph.experiment.timebase)
    for _ in range(1000):
        last = next(raw for _, n, t, raw in reversed(graph.graph.sent) if t == "rig/state")
        seconds, nanoseconds = struct.unpack_from("<iI", last, 4)
        step = (seconds * 10**9 + nanoseconds) // 2_000_000
        graph.inject(VALVE_COMMAND, codec.encode(step, np.full(1, 5.0)))
        graph.run(0.002)
    for state in (State.IDLE, State.DONE, State.TRIPPED):
        graph.inject(EXPERIMENT_STATE, encode_state(ExperimentState(state)))
    graph.until("done")
    assert_same(graph, offline(graph))
    assert "/stranger on valve_command: 1000" in graph.status("rig")["unexpected_publishers"]
    for node in ("rig", "force_controller", "reference_force", "ground_motion"):
        assert "/stranger on experiment/state: 3" in graph.status(node)["unexpected_publishers"]
    logged = [text for _, node, _, text in graph.graph.lines if node == "rig"]
    ignored = "/stranger publishes valve_command, too: this test ignores its messages"
    assert logged.count(ignored) == 1


@pytest.mark.parametrize("topic", [topic for topic in LOOP_TOPICS if topic is not MEASURED])
def test_two_publishers_of_a_topic_end_the_test_before_anything_moves(local_graph, topic):
    graph = local_graph(*SHORT, UNREHEARSED)
    graph.until("ready")
    graph.join(topic)
    assert graph.call("start")[0]
    graph.until("tripped", within=0.1)
    assert f"2 nodes publish {topic.name}" in graph.values["detail"]
    obeyed = len(graph.samples(RIG_STATE)[0]) - 1
    assert obeyed == 0 or not graph.samples(VALVE_COMMAND)[1].any()


def test_true_messages_come_through_a_flood(local_graph):
    graph = local_graph(THREE_SECONDS, UNREHEARSED, LOCKSTEP)
    begin(graph)
    graph.run(0.1)
    for _ in range(5):
        for topic in (VALVE_COMMAND, RIG_STATE, REFERENCE_FORCE):
            bad = list(bad_messages(topic, graph.experiment).values())
            for index in range(2000):
                graph.inject(topic, bad[index % len(bad)])
        graph.run(0.05)
    graph.until("done")
    assert_same(graph, offline(graph))


PATIENT = "supervisor:watchdog.peer_timeout:=6.0"


def test_a_trip_for_want_of_commands_tells_what_was_refused_meanwhile(running):
    graph = running(LONG, LOCKSTEP, "rig:lockstep_timeout:=1.0", PATIENT, latency=5e-4)
    graph.join(VALVE_COMMAND)
    graph.freeze("force_controller")
    bad = bad_messages(VALVE_COMMAND, graph.experiment)
    for _ in range(10):
        for raw in bad.values():
            graph.inject(VALVE_COMMAND, raw)
        graph.run(0.02)
    graph.until("tripped", within=2.0)
    detail = graph.values["detail"]
    assert detail.startswith("no valve_command for step ")
    assert f"; {10 * len(bad)} messages were refused meanwhile; 2 nodes publish" in detail
    assert "valve_command (/force_controller, /stranger)" in detail
