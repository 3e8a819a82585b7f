"""Our interface to rclpy: rows of our tables as ROS parameters, and raw messages.

Raw messages are waited for and taken in the calling thread, through rclpy's private interface,
which only this module uses: rclpy's executors deserialise every message and give it to tasks,
which takes longer than a whole step of the loop. rclpy's own ``wait_for_message`` does the same:
it takes bytes from a wait set over some subscriptions.
"""

import ctypes
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from seft_msgs_py.config.parameter_table import Parameter, Section, Table
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.process import check_environment, check_shared_memory, exit_watchdog
from seft_msgs_py.node.transport import MACHINE, Take, check_live
from seft_msgs_py.wire.topics import Topic

check_environment()  # before rclpy is imported
check_shared_memory()

import rclpy
from rcl_interfaces import msg
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

__all__ = ["Node", "SingleThreadedExecutor", "Subscription"]


def command_node(name: str, namespace: str | None = None) -> Node:
    """Start rclpy and make the node of a command: without parameters, in a context of its own."""
    context = Context()
    with starting_ros():
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        return Node(name, context=context, namespace=namespace, start_parameter_services=False)


@contextmanager
def starting_ros() -> Iterator[None]:
    """Say in one line why ROS does not start, and which variables may be the cause."""
    try:
        yield
    except Exception as error:  # rclpy has several kinds, most of them private
        named = ", ".join(sorted(name for name in os.environ if name.startswith(_OF_ROS)))
        causes = f"its arguments, and {named}" if named else "its arguments"
        why = str(error).splitlines()[0]
        raise InputError(f"ROS does not start: {why}; check {causes}") from None


_OF_ROS = ("ROS_", "RMW_", "RCUTILS_", "RCL_", "FASTRTPS_", "FASTDDS_")  # variables
QUIET = 0.1  # s without a change
_QUIET_GRAPH_TIMEOUT_S = 2.0  # s for the graph to be quiet
_COMMAND_CLOSE_TIMEOUT_S = 10.0  # s
_STUCK = (
    "seft: the middleware does not let this process leave the graph (a fault of FastDDS); it is "
    "ended here, and what was recorded is complete"
)


def leave_graph(node: Node) -> None:
    """Take a node off the graph, when no other node leaves, and end its context.

    Of about a hundred processes that leave at the same time one hangs, see `exit_watchdog`.
    """
    _wait_for_quiet(node)
    with exit_watchdog(_COMMAND_CLOSE_TIMEOUT_S, 1, _STUCK):
        node.destroy_node()
        is_default = node.context is rclpy.get_default_context()
        rclpy.try_shutdown(context=None if is_default else node.context)  # it can start again


def _wait_for_quiet(node: Node) -> None:
    deadline, seen, since = MACHINE.monotonic() + _QUIET_GRAPH_TIMEOUT_S, None, 0.0
    while (now := MACHINE.monotonic()) < deadline:
        names = sorted(node.get_node_names_and_namespaces())
        if names != seen:
            seen, since = names, now
        elif now - since > QUIET:
            return
        MACHINE.sleep(QUIET / 10)


def message_class(topic: Topic) -> Any:
    """Message class of a topic."""
    package, _, name = topic.type.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def qos_profile(topic: Topic, depth: int | None = None, reliable: bool = True) -> QoSProfile:
    """Quality of service of a topic; a reader may have another depth, or no resending."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth if depth is None else depth,
    )


def parameter_descriptor(row: Parameter) -> msg.ParameterDescriptor:
    """ROS description of a parameter; most are read-only once the node runs."""
    unit = f" [{row.unit}]" if row.unit else ""
    descriptor = msg.ParameterDescriptor(description=row.description + unit, read_only=not row.live)
    if row.allowed:
        choices = (choice or '""' for choice in row.allowed)
        descriptor.additional_constraints = f"one of: {', '.join(choices)}"
    if row.kind == "float" and (row.minimum is not None or row.maximum is not None):
        low = float("-inf") if row.minimum is None else float(row.minimum)
        high = float("inf") if row.maximum is None else float(row.maximum)
        descriptor.floating_point_range = [msg.FloatingPointRange(from_value=low, to_value=high)]
    if row.kind == "int" and row.minimum is not None:
        high_int = 2**63 - 1 if row.maximum is None else int(row.maximum)
        descriptor.integer_range = [
            msg.IntegerRange(from_value=int(row.minimum), to_value=high_int, step=0)
        ]
    return descriptor


def declare_parameters(
    node: Node, table: Table, section: Section, changed: Callable[[], None]
) -> None:
    """Declare all parameters of a node with their values; ``live`` ones may be set.

    Parameters
    ----------
    node : Node
        Made with these values as overrides.
    table : Table
        Its parameters.
    section : dict
        Their checked values; changed when one is set.
    changed : callable
        Called when one was set.
    """
    for row in table.rows.values():
        node.declare_parameter(row.name, section[row.name], parameter_descriptor(row))

    def take(parameters: Sequence[RosParameter]) -> msg.SetParametersResult:
        try:
            values = check_live(node.get_name(), table, {p.name: p.value for p in parameters})
        except InputError as error:
            return msg.SetParametersResult(successful=False, reason=str(error))
        section.update(values)
        changed()
        return msg.SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(take)


class LoopCallbackGroup(ReentrantCallbackGroup):
    """Group of subscriptions that no executor handles, only a `RclWaitSet`."""

    def can_execute(self, entity: Any) -> bool:
        """No executor may wait for these."""
        return False


def raw_subscription(
    node: Node, topic: Topic, depth: int | None = None, reliable: bool = True
) -> Subscription:
    """Subscribe to a topic for a `RclWaitSet`; see `qos_profile` for depth and reliability."""
    return node.create_subscription(
        message_class(topic),
        topic.name,
        lambda _: None,
        qos_profile(topic, depth, reliable),
        callback_group=LoopCallbackGroup(),
        raw=True,
    )


class RclWaitSet:
    """Waits until one of some subscriptions, which have a handle of rclpy, has a message."""

    def __init__(self, context: Context, subscriptions: Sequence[Any]) -> None:
        self._subscriptions = {each.handle.pointer: each for each in subscriptions}
        self._handles = [each.handle for each in subscriptions]
        self._wait_set = _rclpy.WaitSet(len(self._handles), 0, 0, 0, 0, 0, context.handle)

    def wait(self, timeout: float) -> list[Any]:
        """Wait at most ``timeout`` seconds; return the subscriptions that have messages."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        for handle in self._handles:
            wait_set.add_subscription(handle)
        wait_set.wait(max(0, int(timeout * 1e9)))
        known = self._subscriptions
        return [known[pointer] for pointer in wait_set.get_ready_entities("subscription")]


class _Gid(ctypes.Structure):
    """``rmw_gid_t``: identifies a publisher."""

    _fields_ = (("implementation", ctypes.c_char_p), ("data", ctypes.c_uint8 * 16))


class _Info(ctypes.Structure):
    """``rmw_message_info_t``; rclpy does not provide its publisher."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("publisher_gid", _Gid),
        ("from_intra_process", ctypes.c_bool),
    )


class _Allocator(ctypes.Structure):
    """``rcutils_allocator_t``."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("new", "free", "grow", "zero", "state"))


class _Bytes(ctypes.Structure):
    """``rcutils_uint8_array_t``: grows with a message."""

    _fields_ = (
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    )


_OK, _NOTHING = 0, 401  # RCL_RET_OK, RCL_RET_SUBSCRIPTION_TAKE_FAILED


def taker(subscription: Subscription) -> Take:
    """Make the function that takes the oldest message of a raw subscription.

    It returns None if there is none; otherwise its bytes, the wall-clock time in ns of its arrival,
    and the identifier of its publisher, which is the ``endpoint_gid`` of the graph.
    """
    rcl, rcutils = ctypes.PyDLL("librcl.so"), ctypes.PyDLL("librcutils.so")
    rcutils.rcutils_get_default_allocator.restype = _Allocator
    allocator = rcutils.rcutils_get_default_allocator()
    message, info = _Bytes(), _Info()
    rcutils.rcutils_uint8_array_init.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
    if rcutils.rcutils_uint8_array_init(
        ctypes.addressof(message), 1024, ctypes.addressof(allocator)
    ):
        raise MemoryError("no memory for a message")
    rcl_take = rcl.rcl_take_serialized_message
    rcl_take.argtypes = (ctypes.c_void_p,) * 4
    here = ctypes.c_void_p(subscription.handle.pointer)  # valid as long as its node
    there = ctypes.c_void_p(ctypes.addressof(message))
    beside, gid = ctypes.c_void_p(ctypes.addressof(info)), ctypes.addressof(info.publisher_gid.data)
    string_at, size = ctypes.string_at, ctypes.sizeof(info.publisher_gid.data)

    def take() -> tuple[bytes, int, bytes] | None:
        result = rcl_take(here, there, beside, None)
        if result == _OK:
            raw = string_at(message.buffer, message.length)
            return raw, info.received_timestamp, string_at(gid, size)
        if result == _NOTHING:
            return None
        rcutils.rcutils_reset_error()
        raise RuntimeError(f"a message can't be taken: error {result} of rcl")

    return take


def take_all(subscription: Subscription, most: int) -> list[tuple[bytes, int]]:
    """Take at most so many messages, oldest first, each with its time by its sender's clock, ns."""
    found: list[tuple[bytes, int]] = []
    take, kind = subscription.handle.take_message, subscription.msg_type
    while len(found) < most and (taken := take(kind, True)) is not None:
        found.append((taken[0], taken[1]["source_timestamp"]))
    return found
