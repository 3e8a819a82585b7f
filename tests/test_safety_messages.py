"""What a foreign node sends into a running test is refused, counted, and never acted upon."""

import subprocess
import time

from graph_tools import JHU, PATIENCE, STALLS_ALLOWED, wait_for
from seft_msgs_py.messages import decode_diagnostics
from seft_msgs_py.ros_types import message_class, qos_profile
from seft_msgs_py.topics import DIAGNOSTICS, LOOP_TOPICS, VALVE_COMMAND
from seft_ros.recording.bag_files import open_bag
from seft_ros.running.observer import Observer
from seft_ros.running.processes import MODULES

LONG = ("-p", "ground_motion:synthetic.duration:=60.0")
LOCKSTEP = ("-p", "rig:pace:=lockstep")
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
    process = start("seft_ros.commands.main", "run", JHU, *LONG, *words, "--out", "bag")

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
    reader = open_bag(bag)
    connections = [c for c in reader.connections if c.topic == f"/{DIAGNOSTICS.name}"]
    for _, _, raw in reader.messages(connections):
        try:
            for status in decode_diagnostics(raw)[1]:
                found[status.name] = int(status.values.get("refused", "0"))
        except ValueError:
            continue
        except Exception as error:
            assert "can't be read" in str(error) or "no CDR" in str(error)
    reader.close()
    return found


def test_a_hostile_node_changes_no_bit_of_a_test_in_lockstep(seft_json, start, hostile, tmp_path):
    simulated = seft_json("simulate", JHU, *LONG, "--out", "simulated")
    process = start_run(start, tmp_path, *LOCKSTEP)
    attack(hostile, process)
    errors = ending(process)
    assert process.returncode == 0, errors
    compared = seft_json("compare", "simulated", "bag")
    assert compared["identical"] is True
    for topic in LOOP_TOPICS:
        samples = compared["topics"][topic.name]
        assert samples["samples_a"] == samples["samples_b"] == simulated["steps"]
    refused = refusals(tmp_path / "bag")
    for node in ("rig", "force_controller", "reference_force"):
        assert refused[node] > ROUNDS, refused


def test_a_command_that_two_nodes_publish_ends_the_test_before_anything_moves(seft, hostile):
    hostile.join(VALVE_COMMAND)
    done = seft("run", JHU, *LOCKSTEP, *LONG, "--out", "bag", status=None)
    assert done.returncode != 0
    assert "Traceback" not in done.stderr
    assert "2 nodes publish valve_command" in done.stderr


def test_the_force_controller_trips_by_itself_when_the_rig_dies(start_node, domain):
    overrides = ("supervisor:watchdog.peer_timeout:=60.0", STALLS_ALLOWED[1])
    # this alone stays sharp; the machine may stand still before the rig is killed
    sharp = ("force_controller:watchdog.state_timeout:=3.0",)
    observer = Observer()
    told = {}

    def listen(message):
        told.update({status.name: status for status in message.status})

    try:
        observer._node.create_subscription(
            message_class(DIAGNOSTICS), DIAGNOSTICS.name, listen, qos_profile(DIAGNOSTICS)
        )
        nodes = {node: start_node(node, *overrides, *sharp) for node in MODULES}

        def is_in(state):
            return lambda: (observer.spin(0.05), observer.state == state)[1]

        wait_for(is_in("ready"), "ready")
        assert observer.call("start")[0]
        wait_for(lambda: (observer.spin(0.05), observer.time_ns > 5 * 10**8)[1], "half a second")
        nodes["rig"].kill()

        def has_tripped():
            observer.spin(0.05)
            values = {item.key: item.value for item in told["force_controller"].values}
            return values if values.get("phase") == "tripped" else None

        values = wait_for(has_tripped, "the force controller's trip")
        assert values["reason"].startswith("no rig/state for 3 s (the last is of step ")
        assert int(values["step"]) > 0
    finally:
        observer.close()
