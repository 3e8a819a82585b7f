"""What the `seft` command sees of a test on the graph, and the services it calls."""

import time
from collections.abc import Iterable, Sequence
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.node.awake_clock import AwakeClock
from seft_msgs_py.node.exit_watchdog import leave_graph
from seft_msgs_py.node.ros_types import message_class, qos_profile
from seft_msgs_py.node.single_instance import is_claimed
from seft_msgs_py.wire.outcome import RIG
from seft_msgs_py.wire.rigs import bare
from seft_msgs_py.wire.topics import CLOCK_TOPIC, DIAGNOSTICS, EXPERIMENT_STATE, NODES, Topic
from std_srvs.srv import Trigger

SERVICE_TIMEOUT = 10.0  # s


class Observer:
    """Follows experiment/state, /clock and the recorder's status.

    Parameters
    ----------
    nodes : sequence of str
        Names that the nodes of a test have.

    Attributes
    ----------
    state : str
        The test's state; empty until it is heard.
    values : dict
        What the state comes with: ``detail``, ``steps``, ``step``.
    time_ns : int
        Experiment time, nanoseconds.
    recorder_phase : str
        ``idle``, ``recording``, ``saved``.
    is_moving : bool
        Whether a rig says that it runs.
    since : float
        When it came up, monotonic, s.
    """

    def __init__(self, nodes: Sequence[str] = NODES) -> None:
        self._nodes = tuple(nodes)
        self.state = ""
        self.values: dict[str, str] = {}
        self.time_ns = 0
        self.recorder_phase = ""
        self._running: set[str] = set()  # rigs
        self._awake = AwakeClock()
        self._heard_at = self._awake.time()
        self.since = time.monotonic()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("seft", start_parameter_services=False)
        for topic, receive in (
            (EXPERIMENT_STATE, self._on_state),
            (CLOCK_TOPIC, self._on_clock),
            (DIAGNOSTICS, self._on_diagnostics),
        ):
            self._node.create_subscription(
                message_class(topic), topic.name, receive, qos_profile(topic)
            )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)

    def spin(self, timeout: float) -> None:
        """Take in what comes within ``timeout`` seconds, at least one look."""
        deadline = time.monotonic() + timeout
        while True:
            self._executor.spin_once(timeout_sec=max(0.0, deadline - time.monotonic()))
            self._awake.time()
            if time.monotonic() >= deadline:
                return

    def silence(self) -> float:
        """Time since the supervisor was last heard, s."""
        return self._awake.time() - self._heard_at

    def call(self, service: str, patience: float = SERVICE_TIMEOUT) -> tuple[bool, str]:
        """Call a service of the supervisor; return whether it was accepted, and its answer.

        Raises
        ------
        ExperimentError
            If it does not answer within ``patience`` seconds.
        """
        client = self._node.create_client(Trigger, service)
        try:
            if not client.wait_for_service(patience):
                raise ExperimentError(f"service {service} is not there; is supervisor running?")
            future = client.call_async(Trigger.Request())
            self._executor.spin_until_future_complete(future, patience)
            response = future.result()
            if response is None:
                raise ExperimentError(f"supervisor did not answer {service}")
            return response.success, response.message
        finally:
            self._node.destroy_client(client)

    def present(self) -> list[str]:
        """Names of a test's nodes that are on the graph, or on this host and not yet found."""
        found, domain = self._found(), self._node.context.get_domain_id()
        ours = [node for node in self._nodes if node in found or is_claimed(domain, f"/{node}")]
        return ours + self._of_other_namespaces(found)

    def twins(self) -> list[str]:
        """Names of a test's nodes that are on the graph more than once."""
        found = self._found()
        twice = [node for node in self._nodes if found.count(node) > 1]
        return twice + self._of_other_namespaces(found)

    def conflict(self, topics: Iterable[Topic]) -> str:
        """Say which of some topics more than one node publishes; empty if none."""
        for topic in topics:
            if (count := self._node.count_publishers(topic.name)) > 1:
                return f"{count} nodes publish {topic.name}"
        return ""

    @property
    def is_moving(self) -> bool:
        """See the attributes."""
        return bool(self._running)

    def _of_other_namespaces(self, found: Sequence[str]) -> list[str]:
        """Nodes of another test, which shares /clock with this one."""
        others = set(found) - set(self._nodes)
        return sorted(node for node in others if bare(node) in NODES)

    def _found(self) -> list[str]:
        """Names of all nodes on the graph, with their namespaces, without the first slash."""
        pairs = self._node.get_node_names_and_namespaces()
        return [f"{namespace.rstrip('/')}/{name}"[1:] for name, namespace in pairs]

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        leave_graph(self._node)

    def _on_state(self, message: Any) -> None:
        self._heard_at = self._awake.time()
        self.state = message.message
        self.values = {item.key: item.value for item in message.values}

    def _on_clock(self, message: Any) -> None:
        self.time_ns = message.clock.sec * 1_000_000_000 + message.clock.nanosec

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            phase = values.get("phase", "")
            if status.name == "recorder":
                self.recorder_phase = phase
            elif bare(status.name) == RIG:
                (self._running.add if phase == "running" else self._running.discard)(status.name)
