"""What a foreign node sends into a running test is refused, counted, and never acted upon."""

import os
import signal
import subprocess
import time
from collections import defaultdict

from graph_tools import JHU, MISSES_ALLOWED, PATIENCE, STALLS_ALLOWED, THOROUGH, children, wait_for
from seft_msgs_py.node.rclpy_interface import message_class, qos_profile
from seft_msgs_py.wire.messages import Status, decode_diagnostics, encode_status
from seft_msgs_py.wire.topics import (
    DIAGNOSTICS,
    EXPERIMENT_STATE,
    LOOP_TOPICS,
    REFERENCE_FORCE,
    RIG_STATE,
    VALVE_COMMAND,
)
from seft_ros.bags.record_bag import read_bag, read_messages
from seft_ros.test_run.processes import MODULES

LONG = ("-p", "ground_motion:synthetic.duration:=60.0")
SHORT = "ground_motion:synthetic.duration:=3.0"
GENTLE = ("-p", "ground_motion:peak_force:=20.0")
"""Lets a rig stay far from its limits though it holds old commands for long."""
LOCKSTEP = ("-p", "rig:pace:=lockstep")
READERS = ("rig", "force_controller", "reference_force")
ROUNDS = 5


def attack(hostile, process):
    """Send every bad kind again and again into a run that is under way.

    One by one: what no software helps against is a flood, for which queues are too short.
    """
    hostile.join()
    wait_for(lambda: hostile.is_heard() or process.poll() is not None, "listeners")
    for _ in range(ROUNDS):
        for topic in LOOP_TOPICS:
            for raw in hostile.bad_messages(topic).values():
                hostile.send(topic, raw)
                time.sleep(0.003)
        for topic, raw in hostile.slow_messages():
            hostile.send(topic, raw)
    assert process.poll() is None, "the test was over before the attack was"


def start_run(start, tmp_path, *words):
    """Start a `seft run`; return it when its test is under way."""
    process = start("seft_ros.cli.main", "run", JHU, *LONG, *words, "--out", "bag", "--no-figure")

    def is_under_way():
        assert process.poll() is None, process.communicate()
        return sum(file.stat().st_size for file in (tmp_path / "bag").glob("*.*")) > 50_000

    wait_for(is_under_way, "some data in the bag")
    return process


def ending(process: subprocess.Popen) -> str:
    _, errors = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in errors
    return errors


def refusals(bag):
    """Node -> refused messages, as its last diagnostics in a bag count them."""
    found = {}
    for _, _, raw in read_messages(bag, [DIAGNOSTICS]):
        try:
            for status in decode_diagnostics(raw)[1]:
                found[status.name] = int(status.values.get("refused", "0"))
        except ValueError:
            continue
        except Exception as error:
            assert "can't be read" in str(error) or "no CDR" in str(error)
    return found


def statuses(observer):
    """Node -> the values of its last status, as they come in while the observer spins."""
    told = defaultdict(dict)

    def listen(message):
        for status in message.status:
            told[status.name] = {item.key: item.value for item in status.values}

    observer._node.create_subscription(
        message_class(DIAGNOSTICS), DIAGNOSTICS.name, listen, qos_profile(DIAGNOSTICS)
    )
    return told


def test_a_hostile_node_changes_no_bit_of_a_test_in_lockstep(seft_json, start, hostile, tmp_path):
    simulated = seft_json("simulate", JHU, *LONG, "--out", "simulated")
    process = start_run(start, tmp_path, *LOCKSTEP, *STALLS_ALLOWED)
    attack(hostile, process)
    errors = ending(process)
    assert process.returncode == 0, errors
    compared = seft_json("compare", "simulated", "bag")
    assert compared["identical"] is True
    for topic in LOOP_TOPICS:
        samples = compared["topics"][topic.name]
        assert samples["samples_a"] == samples["samples_b"] == simulated["steps"]
    refused = refusals(tmp_path / "bag")
    for node in READERS:
        assert refused[node] > ROUNDS, refused


@THOROUGH
def test_a_hostile_node_is_not_acted_upon_in_realtime(seft_json, start, hostile, tmp_path):
    words = (*STALLS_ALLOWED, *MISSES_ALLOWED, *GENTLE)
    seft_json("simulate", JHU, *LONG, *GENTLE, "--out", "simulated")
    process = start_run(start, tmp_path, *words)
    attack(hostile, process)
    assert ending(process).count("refused") == 0  # the nodes' logs tell
    assert process.returncode == 0
    compared = seft_json("compare", "simulated", "bag", status=None)
    record = read_bag(tmp_path / "bag")
    assert len(record.series["rig/state"].steps) == record.series["rig/state"].steps[-1] + 1
    if compared["first_difference"] is not None:
        assert compared["first_difference"]["step"] > record.missed_steps[0]
    refused = refusals(tmp_path / "bag")
    for node in READERS:
        assert refused[node] > ROUNDS, refused
    for log in (tmp_path / "bag" / "logs").iterdir():
        assert "Traceback" not in log.read_text()


def test_true_messages_come_through_a_flood(seft_json, start, hostile, observer, tmp_path):
    seft_json("simulate", JHU, *LONG, "--out", "simulated")
    told = statuses(observer)
    process = start_run(start, tmp_path, *LOCKSTEP, *STALLS_ALLOWED)
    hostile.join()
    wait_for(lambda: hostile.is_heard() or process.poll() is not None, "listeners")

    def have_refused_many():
        """Flood; of what comes while a node waits for a core it reads only what its queue holds."""
        for topic in (VALVE_COMMAND, RIG_STATE, REFERENCE_FORCE):
            hostile.flood(topic, 2000)
        observer.spin(0.05)
        assert process.poll() is None, "the test was over before the flood was"
        return all(int(told[node].get("refused", 0)) > 500 for node in READERS)

    wait_for(have_refused_many, "500 refused messages at each node")
    assert "Traceback" not in ending(process)
    assert process.returncode == 0
    compared = seft_json("compare", "simulated", "bag", status=None)
    assert compared["topics"]["rig/state"]["max_abs"] == 0.0


def test_a_trip_for_want_of_commands_tells_what_was_refused_meanwhile(start, hostile, tmp_path):
    words = ("-p", "rig:lockstep_timeout:=2.0", "-p", "supervisor:watchdog.peer_timeout:=6.0")
    process = start_run(start, tmp_path, *LOCKSTEP, *words)
    hostile.join(VALVE_COMMAND)
    wait_for(lambda: hostile.listeners(VALVE_COMMAND) == 2, "rig and recorder")
    os.kill(children(process.pid)["force_controller"], signal.SIGSTOP)
    while process.poll() is None:  # the rig may learn of who sends later than that of the rig
        hostile.flood(VALVE_COMMAND, 50)
        time.sleep(0.05)
    ending(process)
    assert process.returncode == 1
    reason = read_bag(tmp_path / "bag").trip.reason
    assert reason.startswith("no valve_command for step ")
    assert " messages were refused meanwhile; 2 nodes publish valve_command" in reason


def test_who_joins_a_test_with_what_is_valid_is_named_and_not_obeyed(
    seft_json, start, hostile, observer, tmp_path
):
    """Not even who has sent more messages than the test's own node, as a counterfeit would."""
    seft_json("simulate", JHU, *LONG, "--out", "simulated")
    told = statuses(observer)
    process = start_run(start, tmp_path, *LOCKSTEP, *STALLS_ALLOWED)
    hostile.join(VALVE_COMMAND, EXPERIMENT_STATE)
    hostile.send(VALVE_COMMAND, b"\0" * 8, 3000)  # more than the test's own has sent
    wait_for(lambda: hostile.listeners(VALVE_COMMAND) == 2, "rig and recorder")
    wait_for(lambda: hostile.listeners(EXPERIMENT_STATE) == 7, "all but the supervisor")
    for state in ("idle", "done", "tripped"):
        hostile.send(EXPERIMENT_STATE, encode_status(Status("experiment", 0, state, values={})))

    def is_named():
        """Whether each node tells of the stranger what it has refused of it."""
        observer.spin(0.0)
        told_by = lambda node, text: text in told[node].get("unexpected_publishers", "")  # noqa: E731
        return told_by("rig", "/hostile on valve_command: ") and all(
            told_by(node, "/hostile on experiment/state: 3")
            for node in (*READERS, "ground_motion", "recorder")
        )

    assert hostile.answer(5.0, lambda: is_named() or process.poll() is not None) > 0
    assert is_named(), told
    errors = ending(process)
    assert process.returncode == 0, errors
    compared = seft_json("compare", "simulated", "bag")
    assert compared["identical"] is True
    log = (tmp_path / "bag" / "logs" / "rig.log").read_text()
    assert log.count("/hostile publishes valve_command, too: this test ignores its messages") == 1


def test_two_publishers_of_a_topic_of_the_loop_end_the_test_before_anything_moves(
    start_node, hostile, observer, tmp_path
):
    nodes = {node: start_node(node, "rig:pace:=lockstep", SHORT) for node in MODULES}
    told = statuses(observer)

    def is_in(state):
        return lambda: (observer.spin(0.05), observer.state == state)[1]

    def have_met(topic):
        """Whether all who read a topic know of both who publish it, not only these of them."""
        observer.spin(0.05)
        return all(told[n].get(f"senders {topic.name}") == "2" for n in topic.subscribers)

    def start():
        wait_for(is_in("ready"), "ready")
        assert observer.call("start")[0]

    for topic in LOOP_TOPICS:
        wait_for(is_in("ready"), "ready")
        hostile.join(topic)
        wait_for(lambda topic=topic: have_met(topic), "listeners")
        start()
        wait_for(is_in("tripped"), "the trip")
        assert f"2 nodes publish {topic.name}" in observer.values["detail"]
        hostile.leave(topic)
        wait_for(lambda: observer.call("reset")[0], "the rig at rest")
    wait_for(is_in("ready"), "the last bag")
    for bag in (tmp_path / "bags").iterdir():
        series = read_bag(bag).series
        obeyed = len(series["rig/state"].steps) - 1  # 0 V may answer until the supervisor says stop
        assert obeyed == 0 or not series["valve_command"].values.any()
    start()
    wait_for(is_in("done"), "a test when all have left")
    for node in nodes.values():
        node.send_signal(signal.SIGINT)
    for name, node in nodes.items():
        _, errors = node.communicate(timeout=PATIENCE)
        assert (node.returncode, "Traceback" in errors) == (0, False), (name, errors)


def test_the_force_controller_trips_by_itself_when_the_rig_dies(start_node, observer):
    overrides = (*STALLS_ALLOWED[1::2], MISSES_ALLOWED[1], GENTLE[1])
    # this alone stays sharp; the machine may stand still before the rig is killed
    sharp = ("force_controller:watchdog.state_timeout:=3.0",)
    told = statuses(observer)
    nodes = {node: start_node(node, *overrides, *sharp) for node in MODULES}

    def is_in(state):
        return lambda: (observer.spin(0.05), observer.state == state)[1]

    wait_for(is_in("ready"), "ready")
    assert observer.call("start")[0]
    wait_for(lambda: (observer.spin(0.05), observer.time_ns > 5 * 10**8)[1], "half a second")
    nodes["rig"].kill()

    def has_tripped():
        observer.spin(0.05)
        values = told["force_controller"]
        return values if values.get("phase") == "tripped" else None

    values = wait_for(has_tripped, "the force controller's trip")
    assert values["reason"].startswith("no rig/state for 3 s (the last is of step ")
    assert int(values["step"]) > 0
