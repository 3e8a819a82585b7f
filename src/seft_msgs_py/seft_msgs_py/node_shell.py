"""What every node of a test is made of: parameters, raw topics, status, a clean end.

The loop's messages are waited for and handled in the main thread. All else (parameter
services, the status timer, services of the supervisor) runs in a second thread, so that it
does not stand in the loop's way.
"""

import gc
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from seft_msgs_py.errors import SeftError, WireError
from seft_msgs_py.experiment import Experiment, split_ros_arguments
from seft_msgs_py.messages import Status, encode_diagnostics, encode_string
from seft_msgs_py.parameters import Parameter, Table
from seft_msgs_py.topics import DESCRIPTION, DIAGNOSTICS, Topic
from seft_msgs_py.wait_set import LoopCallbackGroup, WaitSet, take_all

IDLE_WAIT = 0.05  # s; a signal is noticed within this time
STATUS_PERIOD = 1.0  # s
STATUS_CHECK = 0.2  # s
WARN_PERIOD = 1.0  # s
WARM_UP_STEPS = 200
"""Steps a node of the loop tries on itself, so that its first real ones are not its slowest."""

Handler = Callable[[bytes, int], None]


class NodeShell:
    """A node with its checked parameters.

    Parameters
    ----------
    table : Table
        The node's own parameters.
    tables : iterable of Table
        All tables that are known here, for parameters that are taken from other nodes.
    argv : sequence of str
        Command line, with ``--ros-args``.

    Attributes
    ----------
    experiment : Experiment
        What the command line and its parameter files say, of all nodes in ``tables``.
    node : rclpy.node.Node
        The node itself.
    stopping : bool
        Set by SIGINT, SIGTERM or `stop`.
    """

    def __init__(self, table: Table, tables: Iterable[Table], argv: Sequence[str]) -> None:
        files, overrides = split_ros_arguments(argv)
        self.name = table.node
        self.experiment = Experiment.load(tables, files, overrides)
        self.stopping = False
        self.refused = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        rclpy.init(args=_without_parameters(argv), signal_handler_options=SignalHandlerOptions.NO)
        section = self.experiment[self.name]
        self.node = Node(
            self.name,
            parameter_overrides=[RosParameter(name, value=v) for name, v in section.items()],
        )
        for row in table.rows.values():
            self.node.declare_parameter(row.name, section[row.name], _descriptor(row))
        self._group = LoopCallbackGroup()
        self._handlers: dict[Subscription, Handler] = {}
        self._quiet: list[tuple[Subscription, Handler]] = []
        self._publishers: dict[str, Publisher] = {}
        self._wait_set: WaitSet | None = None
        self._lock = threading.RLock()
        self._status = Status(self.name, 0, "starting", values={})
        self._status_sent: tuple[float, Status | None] = (0.0, None)
        self._diagnostics = self.publisher(DIAGNOSTICS)
        self._description = self.publisher(DESCRIPTION)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin_executor, daemon=True)

    def publisher(self, topic: Topic) -> Publisher:
        """Make the publisher of a topic; it takes message bytes."""
        publisher = self.node.create_publisher(message_class(topic), topic.name, qos_profile(topic))
        self._publishers[topic.name] = publisher
        return publisher

    def subscribe(
        self, topic: Topic, handler: Handler, depth: int | None = None, wake: bool = True
    ) -> None:
        """Hand every message of a topic to ``handler`` as bytes, in the main thread.

        Parameters
        ----------
        topic : Topic
            What to listen to.
        handler : callable
            Takes the message's bytes and the wall-clock time in ns at which it came in. A
            `WireError` it raises is counted and warned of.
        depth : int, optional
            Messages kept while the node is busy; default the topic's.
        wake : bool
            Whether a message ends the waiting; else it is handled when the node is up.
        """
        subscription = self.node.create_subscription(
            message_class(topic),
            topic.name,
            lambda _: None,
            qos_profile(topic, depth),
            callback_group=self._group,
            raw=True,
        )
        if wake:
            self._handlers[subscription] = handler
            self._wait_set = WaitSet(self.node, list(self._handlers))
        else:
            self._quiet.append((subscription, handler))

    def start(self, facts: dict[str, Any] | None = None) -> None:
        """Describe the node to the test and begin to serve parameters and status.

        Parameters
        ----------
        facts : dict, optional
            What else others must know of this node, JSON values.
        """
        parameters = self.experiment[self.name]
        description = {"node": self.name, "parameters": parameters, **(facts or {})}
        self._description.publish(encode_string(json.dumps(description)))
        self.node.create_timer(STATUS_CHECK, self._publish_status_if_due)
        sys.setswitchinterval(2e-4)  # the second thread gives way to the loop at once
        gc.collect()
        gc.freeze()
        self._thread.start()

    def spin_once(self, timeout: float = IDLE_WAIT) -> None:
        """Wait for messages, at most ``timeout`` seconds, and handle those that have come."""
        if self._wait_set is None:
            time.sleep(timeout)
        else:
            for subscription in self._wait_set.wait(timeout):
                self._handle(subscription, self._handlers[subscription])
        self.poll()

    def poll(self) -> None:
        """Handle what has come on the topics that do not end the waiting."""
        for subscription, handler in self._quiet:
            self._handle(subscription, handler)

    def _handle(self, subscription: Subscription, handler: Handler) -> None:
        for raw, received_ns in take_all(subscription):
            try:
                handler(raw, received_ns)
            except WireError as error:
                self.refuse(str(error))

    def spin(self, poll: Callable[[], None] | None = None, period: float = IDLE_WAIT) -> None:
        """Handle messages until told to stop, calling ``poll`` at least every ``period`` s."""
        while not self.stopping:
            self.spin_once(period)
            if poll is not None:
                poll()

    def refuse(self, reason: str) -> None:
        """Count a message that was not acted upon, and warn, at most once a second."""
        self.refused += 1
        self.node.get_logger().warning(
            f"refused ({self.refused} so far): {reason}",
            throttle_duration_sec=WARN_PERIOD,
        )

    def report(self, status: Status) -> None:
        """Make this the node's status, and publish it at once."""
        with self._lock:
            self._status = status
            self._publish_status()

    def stop(self) -> None:
        """End `spin` soon."""
        self.stopping = True

    def close(self) -> None:
        """Take the node off the graph."""
        if self._thread.is_alive():
            self._executor.shutdown(timeout_sec=1.0)
            rclpy.try_shutdown()
            self._thread.join(timeout=2.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def matched(self) -> dict[str, str]:
        """Names of the nodes that listen to each topic of this one, separated by blanks."""
        found = {}
        for name, publisher in self._publishers.items():
            listeners = {info.node_name for info in self.node.get_subscriptions_info_by_topic(name)}
            if len(listeners) > publisher.get_subscription_count():
                listeners = set()  # some are known but not connected yet
            found[f"matched {name}"] = " ".join(sorted(listeners))
        return found

    def _publish_status_if_due(self) -> None:
        sent_at, sent = self._status_sent
        with self._lock:
            self._status = Status(
                self._status.name,
                self._status.level,
                self._status.message,
                self._status.hardware_id,
                {
                    **self._status.values,
                    **self.matched(),
                    "refused": str(self.refused),
                    "peak_memory_mb": str(_peak_memory_mb()),
                },
            )
            if self._status != sent or time.monotonic() - sent_at >= STATUS_PERIOD:
                self._publish_status()

    def _publish_status(self) -> None:
        self._status_sent = (time.monotonic(), self._status)
        self._diagnostics.publish(encode_diagnostics(time.time_ns(), [self._status]))

    def _spin_executor(self) -> None:
        try:
            while not self.stopping and rclpy.ok():
                self._executor.spin_once(timeout_sec=0.5)
        except (ExternalShutdownException, rclpy.executors.ShutdownException):
            return

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.stopping = True


def run_node(main: Callable[[Sequence[str]], None], name: str) -> int:
    """Run a node's main function; tell a user's errors in one line and return exit status."""
    try:
        main(sys.argv)
    except SeftError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        return error.exit_status
    except KeyboardInterrupt:
        return 0
    return 0


def _peak_memory_mb() -> int:
    """Largest resident memory of this process so far; -1 where the system does not tell."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return -1
    kilobytes = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return round(int(kilobytes[0]) / 1024) if kilobytes else -1


def message_class(topic: Topic) -> Any:
    """Message class of a topic."""
    package, _, name = topic.type.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def qos_profile(topic: Topic, depth: int | None = None) -> QoSProfile:
    """Quality of service of a topic, for both ends; a reader may keep another depth."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth if depth is None else depth,
    )


def _descriptor(row: Parameter) -> ParameterDescriptor:
    """ROS description of a parameter; all are read when a node starts, and then fixed."""
    unit = f" [{row.unit}]" if row.unit else ""
    descriptor = ParameterDescriptor(description=row.description + unit, read_only=True)
    if row.choices:
        descriptor.additional_constraints = "one of: " + ", ".join(row.choices)
    if row.kind == "float" and (row.minimum is not None or row.maximum is not None):
        low = float("-inf") if row.minimum is None else float(row.minimum)
        high = float("inf") if row.maximum is None else float(row.maximum)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    if row.kind == "int" and row.minimum is not None:
        high_int = 2**63 - 1 if row.maximum is None else int(row.maximum)
        descriptor.integer_range = [
            IntegerRange(from_value=int(row.minimum), to_value=high_int, step=0)
        ]
    return descriptor


def _without_parameters(argv: Sequence[str]) -> list[str]:
    """Command line without what `Experiment.load` has read of it already."""
    kept: list[str] = []
    words = iter(argv)
    for word in words:
        if word in ("--params-file", "-p", "--param"):
            next(words, None)
        else:
            kept.append(word)
    return kept
