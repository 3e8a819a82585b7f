"""Rows of this package's tables as rclpy wants them: message classes, QoS, descriptors."""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from seft_msgs_py.config.parameter_table import Parameter, Section, Table
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Topic


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


def declare_parameters(
    node: Node, table: Table, section: Section, changed: Callable[[], None]
) -> None:
    """Declare all parameters of a node with their values; let those be set that may be.

    Parameters
    ----------
    node : Node
        Made with these values as overrides.
    table : Table
        Its parameters.
    section : dict
        Their values, checked. Takes up what is set.
    changed : callable
        Called when something was set.
    """
    for row in table.rows.values():
        node.declare_parameter(row.name, section[row.name], parameter_descriptor(row))

    def take(parameters: Sequence[RosParameter]) -> SetParametersResult:
        try:
            for p in parameters:
                if p.name not in table.rows:  # rclpy's own, such as use_sim_time
                    raise InputError(f"{node.get_name()}: {p.name!r} can't be set")
            values = {
                p.name: table.rows[p.name].check(p.value, node.get_name()) for p in parameters
            }
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        section.update(values)
        changed()
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(take)
