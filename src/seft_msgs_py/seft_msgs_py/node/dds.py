"""The graph as DDS, through rclpy: the `Transport` of a node that is a process of ROS 2."""

import gc
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from traceback import extract_tb
from typing import Any

from seft_msgs_py.config.experiment import split_ros_arguments
from seft_msgs_py.config.parameter_table import Section, Table
from seft_msgs_py.errors import WireError
from seft_msgs_py.node import host as this_host
from seft_msgs_py.node import process
from seft_msgs_py.node.transport import MACHINE, Answer, Clock, Host, Level
from seft_msgs_py.printing import escaped
from seft_msgs_py.wire.topics import Topic

process.check_environment()  # before rclpy is imported
process.check_shared_memory()

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from seft_msgs_py.node import rclpy_interface

_CLOSE_TIMEOUT_S = 5.0  # s
REQUESTS = "rclpy/parameter_service.py"
"""File in which rclpy reads requests for parameters, which may be invalid."""


class DdsPublisher:
    """See `seft_msgs_py.node.transport.Publisher`."""

    def __init__(self, node: Node, topic: Topic) -> None:
        kind, qos = rclpy_interface.message_class(topic), rclpy_interface.qos_profile(topic)
        self._publisher = node.create_publisher(kind, topic.name, qos)
        self.topic_name: str = self._publisher.topic_name
        self.send = self._publisher.handle.publish_raw  # without rclpy's checks

    def listener_count(self) -> int:
        """Count the subscriptions that are connected."""
        return int(self._publisher.get_subscription_count())


class DdsSubscription:
    """See `seft_msgs_py.node.transport.Subscription`."""

    def __init__(self, node: Node, topic: Topic, depth: int | None, reliable: bool) -> None:
        self._subscription = rclpy_interface.raw_subscription(node, topic, depth, reliable)
        self.topic_name: str = self._subscription.topic_name
        self.handle = self._subscription.handle
        self.take = rclpy_interface.taker(self._subscription)

    def publisher_count(self) -> int:
        """Count the publishers that are connected."""
        return int(self._subscription.get_publisher_count())


class DdsEndpoint:
    """A node of rclpy; see `seft_msgs_py.node.transport.Endpoint`."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.name: str = node.get_name()
        self.namespace: str = node.get_namespace().rstrip("/")
        log = node.get_logger()
        # rclpy allows one level for each line of the program
        self._log: dict[Level, Callable[[str], Any]] = {
            "info": lambda text: log.info(escaped(text)),
            "warning": lambda text: log.warning(escaped(text)),
            "error": lambda text: log.error(escaped(text)),
        }

    def full_name(self, topic_name: str) -> str:
        """Full name of a topic of this node."""
        return str(self._node.resolve_topic_name(topic_name))

    def publish(self, topic: Topic) -> DdsPublisher:
        """Begin to publish a topic."""
        return DdsPublisher(self._node, topic)

    def subscribe(
        self, topic: Topic, depth: int | None = None, reliable: bool = True
    ) -> DdsSubscription:
        """Subscribe to a topic; with another depth than its own, or without resending."""
        return DdsSubscription(self._node, topic, depth, reliable)

    def serve(self, service: str, answer: Answer) -> None:
        """Answer requests, in the thread for services."""

        def respond(_: Any, response: Any) -> Any:
            response.success, response.message = answer()
            return response

        self._node.create_service(Trigger, service, respond)

    def parameters(self, table: Table, section: Section, changed: Callable[[], None]) -> None:
        """Let others read the parameters of a section, and set the live ones."""
        rclpy_interface.declare_parameters(self._node, table, section, changed)

    def log(self, level: Level, text: str) -> None:
        """Log a line."""
        self._log[level](text)

    def publishers(self, topic_name: str) -> dict[bytes, str]:
        """Give identifier and full name of each node known to publish a topic, by its full name."""
        infos = self._node.get_publishers_info_by_topic(topic_name)
        return {bytes(info.endpoint_gid): _full_name(info) for info in infos}

    def publisher_count(self, topic_name: str) -> int:
        """Count the publishers of a topic, by its full name."""
        return int(self._node.count_publishers(topic_name))

    def listeners(self, topic_name: str) -> list[str]:
        """Full names of the nodes known to read a topic, by its full name."""
        return [_full_name(i) for i in self._node.get_subscriptions_info_by_topic(topic_name)]


def _full_name(info: Any) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


class DdsTransport:
    """rclpy's context, the signals of the process, and a thread for services.

    Raises
    ------
    InputError
        If ROS arguments are not understood.
    """

    clock: Clock = MACHINE
    host: Host = this_host

    def __init__(self, argv: Sequence[str], stop: Callable[..., None]) -> None:
        this_host.wake_on_time()
        process.prepare_middleware()
        process.on_ending(stop)
        _, _, arguments = split_ros_arguments(argv)  # parameters are read by `Experiment.load`
        with rclpy_interface.starting_ros():
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor()
        self._thread: threading.Thread | None = None
        self._held: list[Any] = []  # names on this host
        self._ends = False

    def join(self, name: str, section: Section) -> DdsEndpoint:
        """Put a node with its parameters on the graph."""
        values = [RosParameter(name, value=value) for name, value in section.items()]
        with rclpy_interface.starting_ros():
            node = Node(name, parameter_overrides=values)
        self._executor.add_node(node)
        domain, full_name = node.context.get_domain_id(), node.get_fully_qualified_name()
        self._held.append(process.single_instance(domain, full_name))
        return DdsEndpoint(node)

    def wait_set(self, subscriptions: Sequence[DdsSubscription]) -> rclpy_interface.RclWaitSet:
        """Make what waits for some subscriptions of this transport."""
        return rclpy_interface.RclWaitSet(rclpy.get_default_context(), subscriptions)

    def log(self, text: str) -> None:
        """Log an error of the process."""
        rclpy.logging.get_logger("seft").error(escaped(text))

    def start(self, failed: Callable[[Exception], None]) -> None:
        """Begin to serve requests; ``failed`` gets their exceptions."""
        sys.setswitchinterval(2e-4)  # the loop interrupts the second thread at once
        gc.collect()
        gc.freeze()
        self._thread = threading.Thread(target=self._serve, args=(failed,), daemon=True)
        self._thread.start()

    def close(self, status: int = 0) -> None:
        """Take the nodes off the graph; if that hangs, end the process with this exit status."""
        with process.exit_watchdog(_CLOSE_TIMEOUT_S, status):
            self._ends = True
            nodes = self._executor.get_nodes()
            if self._thread is not None:  # it must not wait for objects that are destroyed next
                self._executor.wake()
                self._thread.join(timeout=2.0)
            self._executor.shutdown(timeout_sec=1.0)
            for node in nodes:
                node.destroy_node()
            rclpy.try_shutdown()

    def _serve(self, failed: Callable[[Exception], None]) -> None:
        """Serve until the end: after a fault of one service, stop and estop must still work."""
        while not self._ends and rclpy.ok():
            try:
                self._executor.spin_once(timeout_sec=0.5)
            except (ExternalShutdownException, ShutdownException):
                return
            except Exception as error:
                failed(_refusal(error) or error)


def _refusal(error: Exception) -> WireError | None:
    """Give the refusal of a request for parameters that rclpy could not read; None: a fault.

    No node has received such a request.
    """
    files = [frame.filename for frame in extract_tb(error.__traceback__)]
    read = [number for number, file in enumerate(files) if file.endswith(REQUESTS)]
    here = str(Path(__file__).parent)
    if not read or any(file.startswith(here) for file in files[read[0] :]):
        return None
    refusal = WireError("refused an invalid request for parameters")
    refusal.__cause__ = error
    return refusal
