"""Nodes of the `seft` command: one that observes a test, and one that plays other nodes."""

import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.node import rclpy_interface
from seft_msgs_py.node.dds import DdsEndpoint
from seft_msgs_py.node.process import is_running
from seft_msgs_py.node.rclpy_interface import command_node, leave_graph, message_class, qos_profile
from seft_msgs_py.node.senders import Follower
from seft_msgs_py.node.transport import AwakeClock
from seft_msgs_py.wire import outcome
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state
from seft_msgs_py.wire.messages import Status, decode_diagnostics
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import CLOCK_TOPIC, DIAGNOSTICS, EXPERIMENT_STATE, NODES, Topic, bare
from std_srvs.srv import Trigger

SERVICE_TIMEOUT = 10.0  # s
DISCOVERY = 0.5  # s; nodes that take longer are found by the second check, before the start
ANNOUNCEMENT = 3.2  # s; participants announce themselves every 3 s
_ASKED_AGAIN = 0.1  # s between requests that are refused
_STATES = 16  # that may come between two polls: a test may be stopped and reset at once


class Observer:
    """Follows experiment/state, /clock and the recorder's status.

    Parameters
    ----------
    nodes : sequence of str
        Names that the nodes of a test have.

    Attributes
    ----------
    state : str
        The test's state; empty before the first message.
    reported : ExperimentState
        What the supervisor last said of it.
    ended : ExperimentState or None
        How the last test ended, also if it was reset since; None while one moves, or none has.
    time_ns : int
        Experiment time, nanoseconds.
    recorder_phase : str
        ``idle``, ``recording``, ``saved``.
    recorder_bag : str
        Folder of the saved bag.
    running : set of str
        Rigs that report that they run, or that their stop goes on.
    not_at_rest : dict of str to str
        Rigs that did not come to rest after their stop, and its time.
    domain : int
        ROS domain of the test.
    """

    def __init__(self, nodes: Sequence[str] = NODES) -> None:
        self._nodes = tuple(nodes)
        self.state = self.recorder_phase = self.recorder_bag = ""
        self.reported = ExperimentState(State.IDLE, "waiting for supervisor")
        self.ended: ExperimentState | None = None
        self.time_ns = 0
        self.running: set[str] = set()
        self.not_at_rest: dict[str, str] = {}
        self._awake = AwakeClock()
        self._received_at = self._awake.time()
        self._since = time.monotonic()
        self._node = command_node("seft")
        self.domain: int = self._node.context.get_domain_id()
        depths = {EXPERIMENT_STATE: _STATES, DIAGNOSTICS: DIAGNOSTICS.depth}
        self._test = Follower(DdsEndpoint(self._node), depths, self._nodes)
        self._node.create_subscription(
            message_class(CLOCK_TOPIC), CLOCK_TOPIC.name, self._on_clock, qos_profile(CLOCK_TOPIC)
        )
        self._executor = rclpy_interface.SingleThreadedExecutor(context=self._node.context)
        self._executor.add_node(self._node)

    def spin(self, timeout: float) -> None:
        """Handle all messages that come within ``timeout`` seconds; poll at least once."""
        deadline = time.monotonic() + timeout
        while True:
            self._executor.spin_once(timeout_sec=max(0.0, deadline - time.monotonic()))
            self._awake.time()
            self._receive()
            if time.monotonic() >= deadline:
                return

    def silence(self) -> float:
        """Time since the supervisor was last heard, s."""
        return self._awake.time() - self._received_at

    def call(self, service: str, patience: float = SERVICE_TIMEOUT) -> tuple[bool, str]:
        """Call a service of the supervisor; return whether it was accepted, and its answer.

        A supervisor that has stalled refuses what may have waited: it is asked again.

        Raises
        ------
        ExperimentError
            If it does not answer within ``patience`` seconds.
        """
        client = self._node.create_client(Trigger, service)
        try:
            if not client.wait_for_service(patience):
                raise ExperimentError(f"service {service} is not there; is supervisor running?")
            deadline = time.monotonic() + patience
            while True:
                future = client.call_async(Trigger.Request())
                self._executor.spin_until_future_complete(future, patience)
                self._receive()
                response = future.result()
                if response is None:
                    raise ExperimentError(f"supervisor did not answer {service}")
                if not response.message.endswith(outcome.STALLED) or time.monotonic() > deadline:
                    return response.success, response.message
                self.spin(_ASKED_AGAIN)
        finally:
            self._node.destroy_client(client)

    def present(self) -> list[str]:
        """Names of a test's nodes that are on the graph, or on this host and not yet found."""
        found, at = self._found(), self.domain
        ours = [node for node in self._nodes if node in found or is_running(at, f"/{node}")]
        return ours + self._of_other_namespaces(found)

    def refuse_other_tests(self, external: Collection[str] = ()) -> None:
        """Check that no other test is on the graph: two would command each other's rig.

        Raises
        ------
        InputError
            If there is one, of other nodes than those that are external.
        """
        self.spin(DISCOVERY)
        self._refuse([node for node in self.present() if node not in external])

    def refuse_twins(self, topics: Iterable[Topic]) -> None:
        """Check again that there is no other test, and no other publisher of this test's topics.

        Discovery may find a node that runs already only at its next announcement.

        Raises
        ------
        InputError
            If there is one.
        """
        self.spin(max(0.0, self._since + ANNOUNCEMENT - time.monotonic()))
        found = self._found()
        twice = [node for node in self._nodes if found.count(node) > 1]
        self._refuse(twice + self._of_other_namespaces(found))
        for topic in topics:
            infos = self._node.get_publishers_info_by_topic(topic.name)
            if len(infos) > 1:
                names = ", ".join(sorted(i.node_name for i in infos))
                where = f"in ROS domain {self.domain} ({names})"
                why = "and only one is this test's: end the other"
                raise InputError(f"{len(infos)} nodes publish {topic.name} {where}, {why}")

    def _refuse(self, nodes: Sequence[str]) -> None:
        if nodes:
            other = f"already has a node {', '.join(nodes)}: of another test"
            mend = "end it, set another ROS_DOMAIN_ID, or use it with --external"
            raise InputError(f"ROS domain {self.domain} {other}; {mend}")

    def _of_other_namespaces(self, found: Sequence[str]) -> list[str]:
        """List nodes of another test, which shares /clock with this one."""
        others = set(found) - set(self._nodes)
        return sorted(node for node in others if bare(node) in NODES)

    def _found(self) -> list[str]:
        """List all nodes on the graph, with their namespaces, without the first slash."""
        pairs = self._node.get_node_names_and_namespaces()
        return [f"{namespace.rstrip('/')}/{name}"[1:] for name, namespace in pairs]

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        leave_graph(self._node)

    def _receive(self) -> None:
        """Take the states and statuses that have arrived."""
        for state in self._test.take(EXPERIMENT_STATE):
            self.reported = decode_state(state.raw)
            self._received_at = self._awake.time()
            before, self.state = self.state, self.reported.state
            if self.state in outcome.MOVING:
                self.ended = None
            elif self.state in outcome.ENDED:
                self.ended = self.reported
            elif before in outcome.MOVING:  # its end was not heard; what it was stands in the bag
                self.ended = replace(self.reported, state=State.DONE)
        for report in self._test.take(DIAGNOSTICS):
            for status in decode_diagnostics(report.raw)[1]:
                self._on_status(status)

    def _on_clock(self, message: Any) -> None:
        self.time_ns = message.clock.sec * 1_000_000_000 + message.clock.nanosec

    def _on_status(self, status: Status) -> None:
        phase = status.values.get("phase", "")
        if status.name == "recorder":
            self.recorder_phase, self.recorder_bag = phase, status.values.get("bag", "")
        elif bare(status.name) == outcome.RIG:
            moves = phase == "running" or outcome.STOPPING in status.values
            (self.running.add if moves else self.running.discard)(status.name)
            if text := status.values.get(outcome.NOT_AT_REST):
                self.not_at_rest[status.name] = text
