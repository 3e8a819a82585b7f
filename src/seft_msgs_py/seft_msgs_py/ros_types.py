"""Rows of this package's tables as rclpy wants them: message classes, QoS, descriptors."""

from importlib import import_module
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from seft_msgs_py.parameters import Parameter
from seft_msgs_py.topics import Topic


def message_class(topic: Topic) -> Any:
    """Message class of a topic."""
    package, _, name = topic.type.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def qos_profile(topic: Topic, depth: int | None = None, reliable: bool = True) -> QoSProfile:
    """Quality of service of a topic; a reader may keep another depth, or go without resending."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=durability,
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth if depth is None else depth,
    )


def parameter_descriptor(row: Parameter) -> ParameterDescriptor:
    """ROS description of a parameter; most are read when a node starts, and then fixed."""
    unit = f" [{row.unit}]" if row.unit else ""
    descriptor = ParameterDescriptor(description=row.description + unit, read_only=not row.live)
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
