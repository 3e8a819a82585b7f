"""The six nodes over DDS, started once as `ros2 run` does: operator, parameters, strangers, end."""

import asyncio
import signal
import subprocess
import sys
import threading
from collections import defaultdict
from types import SimpleNamespace

import pytest
from graph_tools import (
    GENTLE,
    JHU,
    MISSES_ALLOWED,
    PATIENCE,
    STALLS_ALLOWED,
    hear_hang_ups,
    wait_for,
)
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from ros_domain import reserved_domain
from seft_msgs_py.node.rclpy_interface import message_class, qos_profile
from seft_msgs_py.wire.topics import DIAGNOSTICS, VALVE_COMMAND
from seft_ros.bags.recording_bag import read_bag
from seft_ros.monitor import graph as monitor
from seft_ros.nodes.supervisor_node import STOOD_STILL
from seft_ros.test_run.processes import MODULES

LONG = "ground_motion:synthetic.duration:=400.0"
OVERRIDES = (*(*STALLS_ALLOWED, *MISSES_ALLOWED, *GENTLE)[1::2], LONG)
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(scope="module")
def domain():
    """A ROS domain that the tests of this module share."""
    with reserved_domain() as number:
        yield number


@pytest.fixture(scope="module")
def nodes(domain, tmp_path_factory):
    """Folder and logs of the nodes' processes, each of which a signal ends without a fault."""
    folder = tmp_path_factory.mktemp("nodes")
    words = ["--ros-args", "--params-file", str(JHU)]
    for override in (*OVERRIDES, f"recorder:directory:={folder}"):
        words += ["-p", override]
    logs = {node: folder / f"{node}.log" for node in reversed(MODULES)}
    processes = {}
    try:
        for node, log in logs.items():
            with log.open("w") as out:
                command = [sys.executable, "-m", MODULES[node], *words]
                processes[node] = subprocess.Popen(
                    command, cwd=folder, stdout=out, stderr=out, preexec_fn=hear_hang_ups
                )
        yield SimpleNamespace(folder=folder, logs=logs, processes=processes)
        said = {node: len(log.read_text()) for node, log in logs.items()}
        for number, process in enumerate(processes.values()):
            process.send_signal(ENDINGS[number % len(ENDINGS)])
        for node, process in processes.items():
            status, last = process.wait(PATIENCE), logs[node].read_text()[said[node] :]
            assert (status, "Traceback" in last) == (0, False), last
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


class Graph:
    """The nodes, seen by an observer.

    Attributes
    ----------
    reported : dict of str to dict
        Node -> the values of its last status.
    """

    def __init__(self, nodes, observer):
        self.observer, self.folder, self.logs = observer, nodes.folder, nodes.logs
        self.processes = nodes.processes
        self.reported = defaultdict(dict)
        observer._node.create_subscription(
            message_class(DIAGNOSTICS), DIAGNOSTICS.name, self._listen, qos_profile(DIAGNOSTICS)
        )

    def _listen(self, message):
        for status in message.status:
            self.reported[status.name] = {item.key: item.value for item in status.values}

    def until(self, condition, what):
        """Handle messages until a condition holds, or the test is in a state."""
        if isinstance(condition, str):
            state, condition = condition, lambda: self.observer.state == state
        return wait_for(lambda: (self.observer.spin(0.02), condition())[1], what)

    def begin(self):
        """Start a test, and wait until it is under way."""
        self.observer.time_ns = 0
        assert self.observer.call("start") == (True, "the test is running")
        self.until(lambda: self.observer.time_ns > 3e8, "a part of the test")

    def recording(self):
        """Read the bag of the test that has just ended."""
        self.until(lambda: self.observer.recorder_phase == "saved", "the bag")
        return read_bag(self.folder / self.observer.recorder_bag)


@pytest.fixture
def graph(nodes, observer):
    """The nodes, ready for a test."""
    found = Graph(nodes, observer)
    found.until(lambda: observer.state, "the supervisor")
    if observer.state in ("done", "tripped"):
        wait_for(lambda: observer.call("reset")[0], "the rig at rest")
    found.until("ready", "ready")
    return found


@pytest.fixture
def hostile(observer):
    """A node that is none of the test's, beside the observer, whose context it uses."""
    context = observer._node.context
    found = Node("hostile", context=context, start_parameter_services=False)
    yield found
    found.destroy_node()


def test_commands_operate_nodes_that_were_started_by_hand(graph, seft, seft_json):
    assert seft("start", status=0).stdout == "the test is running\n"
    assert seft_json("status")["state"] == "running"
    assert seft("stop", status=0).stdout.startswith("the test is ramping down")
    graph.until("done", "the soft end")
    recording = graph.recording()
    assert (recording.stopped, recording.trip) == (True, None)
    assert recording.series["reference_force"].values[-1, 0, 0] == 0.0
    assert seft("reset", status=0).stdout == "idle\n"
    assert seft("stop", "--at-once", status=0).stdout.startswith("aborted by the operator")
    assert seft("status", status=1).stdout == "tripped: aborted by the operator\n"
    log = graph.logs["supervisor"].read_text()
    wanted = ("idle: waiting for node ", "ready: start with ", "running", "ramping down", "done: ")
    places = [log.find(text) for text in (*wanted, "tripped: aborted by the operator")]
    assert -1 not in places and places == sorted(places), log
    assert all("[INFO]" in each.read_text() for each in graph.logs.values())


def test_the_monitor_tells_what_the_supervisor_answers(graph):
    watching = monitor.Graph()
    try:
        wait_for(lambda: asyncio.run(watching.call("start")) == (True, "the test is running"), "it")
        assert asyncio.run(watching.call("stop"))[1].startswith("the test is ramping down")
    finally:
        watching.close()
    graph.until("done", "the soft end")


def test_who_waits_for_a_supervisor_that_stands_still_starts_a_test(graph):
    """Others' requests have expired, see test_local_faults.py."""
    supervisor = graph.processes["supervisor"]
    supervisor.send_signal(signal.SIGSTOP)
    going_on = threading.Timer(1.5 * STOOD_STILL, supervisor.send_signal, [signal.SIGCONT])
    going_on.start()
    graph.begin()
    going_on.join()
    assert graph.observer.call("estop")[0]
    graph.until("tripped", "the end")


def test_parameters_of_a_node_are_read_and_set_while_a_test_runs(graph):
    """Which may be set, and to what, see test_local_course.py."""
    graph.begin()

    def answer(node, kind, service, fields):
        client = graph.observer._node.create_client(kind, f"{node}/{service}")
        wait_for(client.service_is_ready, f"{service} of {node}")
        asked = client.call_async(kind.Request(**fields))
        graph.until(asked.done, f"an answer of {node}")
        return asked.result()

    for node in MODULES:
        found = answer(node, GetParameters, "get_parameters", {"names": ["rate"]})
        assert found.values[0].double_value == 500.0
    for node, name, text in (("rig", "pace", "realtime"), ("recorder", "on_loss", "stop")):
        value = ParameterValue(type=4, string_value=text)
        fields = {"parameters": [Parameter(name=name, value=value)]}
        (result,) = answer(node, SetParameters, "set_parameters", fields).results
        assert result.successful == (node == "recorder")
    assert graph.observer.state == "running", graph.observer.reported
    assert graph.observer.call("estop")[0]
    graph.until("tripped", "the end")


def test_what_a_stranger_sends_is_not_obeyed_and_reported_with_its_name(graph, hostile):
    """That it changes no bit, what else it may send, and what is logged: test_local_messages.py."""
    observer = graph.observer
    graph.begin()
    quality = qos_profile(VALVE_COMMAND, depth=64)
    commands = hostile.create_publisher(message_class(VALVE_COMMAND), VALVE_COMMAND.name, quality)
    graph.until(lambda: commands.get_subscription_count() >= 2, "listeners")
    for _ in range(3000):  # more than the test's own has sent
        commands.publish(b"\0" * 8)
    strangers = lambda: graph.reported["rig"].get("unexpected_publishers", "")  # noqa: E731
    graph.until(lambda: "/hostile on valve_command: " in strangers(), "the stranger's name")
    assert observer.state == "running", observer.values
    assert observer.call("estop")[0]
    graph.until("tripped", "the end")
