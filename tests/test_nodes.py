"""Nodes started one by one, in any order, as `ros2 run` does."""

import contextlib
import os
import random
import signal

import numpy as np
import pytest
from graph_tools import JHU, MISSES_ALLOWED, PATIENCE, STALLS_ALLOWED, hold, thorough, wait_for
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from seft_msgs_py.wire.topics import NODES
from seft_ros.bags.record_bag import read_bag
from seft_ros.protection.protection_step import RampDown
from seft_ros.test_run.processes import MODULES
from std_srvs.srv import Trigger

SHORT = ("ground_motion:synthetic.duration:=3.0", "ground_motion:tail:=0.2")


def is_in_state(observer, state):
    def look():
        observer.spin(0.05)
        return observer.state == state

    return look


def has_run_for_a_second(observer):
    def look():
        observer.spin(0.05)
        assert observer.state != "tripped", observer.values
        return observer.time_ns > 10**9

    return look


@pytest.mark.parametrize("seed", [1, thorough(2)])
def test_nodes_start_in_any_order_and_run_two_tests_in_a_row(start_node, observer, tmp_path, seed):
    order = random.Random(seed).sample(sorted(MODULES), len(MODULES))
    overrides = (*SHORT, "rig:pace:=lockstep")
    nodes = {node: start_node(node, *overrides) for node in order}
    for test in (1, 2):
        wait_for(is_in_state(observer, "ready"), "ready")
        accepted, answer = observer.call("stop")
        assert not accepted
        assert answer == "can't stop: the test is ready (all nodes are ready)"
        accepted, answer = observer.call("start")
        assert accepted, answer
        wait_for(is_in_state(observer, "done"), "done")
        assert observer.call("start")[0] is False
        assert observer.call("reset")[0] is True
        wait_for(is_in_state(observer, "ready"), "the bag")
        bags = sorted((tmp_path / "bags").iterdir())
        assert len(bags) == test
        record = read_bag(bags[-1])
        assert record.complete
        assert len(record.series["rig/state"].steps) == 851
    end(nodes)


def test_tests_that_follow_one_another_at_once_have_a_whole_bag_each(
    start_node, observer, tmp_path
):
    nodes = {node: start_node(node, *SHORT, "rig:pace:=lockstep") for node in MODULES}
    for _ in range(3):
        wait_for(is_in_state(observer, "ready"), "ready")
        assert observer.call("start") == (True, "the test is running")
        wait_for(is_in_state(observer, "done"), "done")
        assert observer.call("reset")[0]
        wait_for(is_in_state(observer, "ready"), "ready")
        assert observer.call("start")[0]
        assert observer.call("estop")[0]  # it takes a while until all is known about it
        wait_for(is_in_state(observer, "tripped"), "the trip")
        wait_for(lambda: observer.call("reset")[0], "the rig at rest")
    wait_for(is_in_state(observer, "ready"), "the last bag")
    records = [read_bag(bag) for bag in sorted((tmp_path / "bags").iterdir())]
    assert len(records) == 6
    assert all(record.complete for record in records)
    assert {record.trip.reason for record in records[1::2]} == {"aborted by the operator"}
    first, *others = records[::2]
    assert len(first.series["rig/state"].steps) == 851
    for other in others:
        for topic, series in first.series.items():
            np.testing.assert_array_equal(other.series[topic].steps, series.steps)
            np.testing.assert_array_equal(other.series[topic].values, series.values)
    end(nodes)


def end(nodes):
    """End nodes as Ctrl-C does."""
    for node in nodes.values():
        node.send_signal(signal.SIGINT)
    for name, node in nodes.items():
        _, errors = node.communicate(timeout=PATIENCE)
        assert (node.returncode, "Traceback" in errors) == (0, False), (name, errors)


def test_commands_operate_nodes_that_were_started_by_hand_and_logs_say_what_happens(
    start_node, seft, seft_json
):
    assert "no supervisor is in ROS domain" in seft("start", status=1).stderr
    nodes = {"supervisor": start_node("supervisor", "rig:pace:=lockstep")}
    assert seft("status", status=0).stdout.startswith("idle: waiting for node ground_motion, ")
    assert "can't start: the test is idle (waiting for" in seft("start", status=1).stderr
    overrides = (*SHORT, "rig:pace:=lockstep")
    nodes |= {node: start_node(node, *overrides) for node in MODULES if node != "supervisor"}
    wait_for(lambda: seft_json("status")["state"] == "ready", "ready")
    assert seft("start", status=0).stdout == "the test is running\n"
    wait_for(lambda: seft_json("status")["state"] == "done", "done")
    found = seft_json("status")
    assert (found["detail"], found["steps"]) == ("851 steps done", 851)
    assert seft("reset", status=0).stdout == "idle\n"
    assert seft("stop", "--at-once", status=0).stdout.startswith("aborted by the operator")
    assert seft("status", status=1).stdout == "tripped: aborted by the operator\n"
    for node in nodes.values():
        node.send_signal(signal.SIGINT)
    logs = {name: node.communicate(timeout=PATIENCE)[1] for name, node in nodes.items()}
    wanted = ("idle: waiting for node ", "ready: start with ", "running", "done: 851 steps done")
    wanted += ("tripped: aborted by the operator",)
    places = [logs["supervisor"].find(text) for text in wanted]
    assert -1 not in places and places == sorted(places), logs["supervisor"]
    assert "finished: 851 steps, 0 missed" in logs["rig"]
    assert "saved bags/seft_" in logs["recorder"] or "saved /" in logs["recorder"]
    assert all("[INFO]" in log and "started; " in log for log in logs.values()), logs


@pytest.mark.parametrize("node", sorted(MODULES))
def test_a_node_explains_itself_within_80_columns(start, node):
    words, _ = start(MODULES[node], "--help").communicate(timeout=PATIENCE)
    assert f"{node} --ros-args --params-file config/demo.yaml" in words
    assert "ros2 run seft_" in words and "\n  rate: 500.0 Hz\n" in words
    assert max(map(len, words.splitlines())) <= 80


def test_a_start_that_waited_while_the_supervisor_stood_still_is_refused(start_node, observer):
    peers = "supervisor:peers:=[ground_motion, rig]"
    nodes = {node: start_node(node, peers) for node in ("supervisor", "ground_motion", "rig")}
    wait_for(is_in_state(observer, "ready"), "ready")
    client = observer._node.create_client(Trigger, "start")
    wait_for(client.service_is_ready, "the service")
    hold(nodes["supervisor"].pid)
    asked = client.call_async(Trigger.Request())
    observer.spin(1.5)
    assert not asked.done()
    os.kill(nodes["supervisor"].pid, signal.SIGCONT)
    wait_for(lambda: (observer.spin(0.05), asked.done())[1], "the answer")
    assert not asked.result().success
    assert "has stalled" in asked.result().message


def test_nodes_of_different_rates_do_not_start(start_node, observer):
    peers = "supervisor:peers:=[ground_motion, rig]"
    for node in ("supervisor", "ground_motion", "rig"):
        start_node(node, peers, *(["rate:=250.0"] if node == "rig" else []))
    wait_for(
        lambda: (observer.spin(0.05), "one rate" in observer.values.get("detail", ""))[1],
        "the supervisor's words",
    )
    assert "rig has 250" in observer.values["detail"]


def test_a_test_is_stopped_by_the_operator(start_node, observer, tmp_path):
    for node in MODULES:
        start_node(node, *STALLS_ALLOWED[1::2], *MISSES_ALLOWED[1::2])
    wait_for(is_in_state(observer, "ready"), "ready")
    assert observer.call("start")[0]
    wait_for(has_run_for_a_second(observer), "a second of the test")
    assert observer.call("stop") == (True, "the test is ramping down")
    accepted, answer = observer.call("stop")
    assert (accepted, "stopped by the operator" in answer) == (True, True)
    wait_for(is_in_state(observer, "done"), "done")
    wait_for(lambda: (observer.spin(0.05), observer.recorder_phase == "saved")[1], "saved")
    (bag,) = (tmp_path / "bags").iterdir()
    record = read_bag(bag)
    assert 750 <= len(record.series["rig/state"].steps) < 8000
    assert record.trip.reason == "stopped by the operator"
    force = record.series["reference_force"].values[:, 0, 0]
    ramp = RampDown(250)
    ramp.begin()
    factors = [1.0, *(ramp.next() for _ in range(250))]
    motion = record.series["ground_motion"].values[:, 0, 0]  # at mass ratio 0 the force is -m a_g
    last = int(np.flatnonzero(force)[-1])
    first = last - 249  # the last step whose factor is 1
    np.testing.assert_allclose(force[first : last + 2], -52.7 * motion[first : last + 2] * factors)
    assert not force[last + 1 :].any()


@pytest.mark.parametrize("node", sorted(MODULES))
def test_a_node_tells_a_wrong_parameter_in_one_line(start_node, node):
    process = start_node(node, f"{node}:noise:=1")
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert len(errors.strip().splitlines()) == 1
    assert f"{node}: -p: {node}: there is no parameter noise" in errors


def test_a_silent_node_makes_a_ready_graph_incomplete_until_it_is_heard_again(start_node, observer):
    nodes = {node: start_node(node) for node in MODULES}
    wait_for(is_in_state(observer, "ready"), "ready")
    nodes["rig"].send_signal(signal.SIGSTOP)
    wait_for(is_in_state(observer, "idle"), "idle")
    assert observer.values["detail"] == "waiting for node rig"
    assert observer.call("start")[0] is False
    nodes["rig"].send_signal(signal.SIGCONT)
    wait_for(is_in_state(observer, "ready"), "ready again")
    nodes["supervisor"].kill()
    wait_for(lambda: (observer.spin(0.05), observer.silence() > 1.0)[1], "its silence")


def test_a_node_that_is_terminated_ends_cleanly_and_the_others_miss_it(start_node, observer):
    long = ("rig:pace:=lockstep", "ground_motion:synthetic.duration:=400.0")
    nodes = {node: start_node(node, *long) for node in MODULES}
    wait_for(is_in_state(observer, "ready"), "ready")
    assert observer.call("start")[0]
    wait_for(has_run_for_a_second(observer), "a second of the test")

    def terminate(node, number=signal.SIGTERM):
        nodes[node].send_signal(number)
        _, errors = nodes[node].communicate(timeout=PATIENCE)
        assert (nodes[node].returncode, "Traceback" in errors) == (0, False), (node, errors)

    terminate("force_controller")
    wait_for(is_in_state(observer, "tripped"), "the trip")
    assert "node force_controller has been silent since" in observer.values["detail"]
    wait_for(lambda: observer.call("reset")[0], "the rig at rest")
    gone = ["force_controller"]
    for node in ("rig", "recorder", "ground_motion", "reference_force"):
        terminate(node, signal.SIGHUP)  # as a closed terminal does
        gone.append(node)
        missed = "waiting for node " + ", ".join(sorted(gone, key=NODES.index))
        wait_for(
            lambda missed=missed: (observer.spin(0.05), observer.values["detail"] == missed)[1],
            missed,
        )
        assert observer.call("start") == (False, f"can't start: the test is idle ({missed})")
    terminate("supervisor")
    wait_for(lambda: (observer.spin(0.05), observer.silence() > 1.0)[1], "its silence")


def test_an_implausible_force_brings_the_test_down_as_offline(seft_json):
    words = (JHU, "-p", "ground_motion:synthetic.duration:=5.0")
    words = (*words, "-p", "reference_force:limits.force:=500.0")
    simulated = seft_json("simulate", *words, "--out", "simulated", status=1)
    lockstep = seft_json("run", *words, "-p", "rig:pace:=lockstep", "--out", "run", status=1)
    assert simulated["trip"] == lockstep["trip"]
    assert "is beyond the limit of 500 N" in lockstep["trip"]["reason"]
    compared = seft_json("compare", "simulated", "run", status=None)
    for topic in ("rig/state", "reference_force", "valve_command"):
        # the rig goes on until it learns that it may end
        assert compared["topics"][topic]["max_abs"] == 0.0


def test_a_rig_that_comes_back_in_the_middle_of_a_test_stays_at_rest(start_node, observer):
    overrides = (*STALLS_ALLOWED, *MISSES_ALLOWED)[1::2]
    nodes = {node: start_node(node, *overrides) for node in MODULES}
    wait_for(is_in_state(observer, "ready"), "ready")
    assert observer.call("start")[0]
    wait_for(has_run_for_a_second(observer), "a second of the test")
    nodes["rig"].kill()
    nodes["rig"].wait()
    reached = observer.time_ns
    second = start_node("rig", *overrides)
    observer.time_ns = 0
    log = second.stderr.fileno()
    os.set_blocking(log, False)
    told = bytearray()

    def refuses():
        observer.spin(0.05)
        with contextlib.suppress(BlockingIOError):
            told.extend(os.read(log, 65536))
        assert second.poll() is None, told
        assert observer.state != "tripped", observer.values
        return b"before this rig was ready" in told

    wait_for(refuses, "the second rig to hear of the test and to stay out of it")
    for _ in range(20):
        observer.spin(0.05)
    assert reached > 10**9
    assert observer.time_ns == 0


@pytest.mark.parametrize("node", ["recorder", "supervisor", "force_controller", "ground_motion"])
def test_a_node_with_defaults_for_all_needs_no_file(start, observer, node):
    process = start(MODULES[node])
    wait_for(lambda: (observer.spin(0.05), observer.present() == [node])[1], "the node")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors


def test_what_the_next_bag_is_called_may_be_set_and_what_a_node_was_started_with_not(
    start_node, observer, tmp_path
):
    """A name that is taken is told before the start."""
    bag = tmp_path / "bags" / "taken"
    bag.mkdir(parents=True)
    words = (*SHORT, "rig:pace:=lockstep", "recorder:name:=taken")
    nodes = {node: start_node(node, *words) for node in MODULES}
    wait_for(
        lambda: (observer.spin(0.05), "taken" in observer.values.get("detail", ""))[1],
        "the supervisor's words",
    )
    assert observer.values["detail"] == (
        "waiting for the recorder, as bags/taken exists already; "
        "correct that, or set its parameter name or directory to another"
    )
    assert observer.call("start")[0] is False
    bag.rmdir()
    wait_for(is_in_state(observer, "ready"), "ready")

    def answer(node, name, value):
        client = AsyncParameterClient(observer._node, node)
        wait_for(client.services_are_ready, f"the parameters of {node}")
        future = client.set_parameters([Parameter(name, value=value)])
        wait_for(lambda: (observer.spin(0.05), future.done())[1], "an answer")
        (result,) = future.result().results
        return result.successful, result.reason

    assert answer("recorder", "name", "named") == (True, "")
    successful, reason = answer("recorder", "on_loss", "zip")
    assert not successful
    assert 'on_loss is "zip", but must be one of stop, go_on' in reason
    successful, reason = answer("rig", "specimen.mass", 3.0)
    assert not successful
    assert "read-only" in reason
    for node in MODULES:  # each goes on to serve
        for name in ("use_sim_time", "", "no_such"):
            successful, reason = answer(node, name, True)
            assert not successful, (node, name)
            assert reason
    assert observer.call("start")[0]
    wait_for(lambda: (observer.spin(0.05), observer.recorder_phase == "saved")[1], "saved")
    record = read_bag(tmp_path / "bags" / "named")
    assert record.complete
    end(nodes)
