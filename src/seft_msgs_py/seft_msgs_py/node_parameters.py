"""A node's parameters as ROS sees them: declared from its table, most of them fixed."""

from collections.abc import Callable, Sequence

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from seft_msgs_py.errors import InputError
from seft_msgs_py.parameters import Section, Table
from seft_msgs_py.ros_types import parameter_descriptor


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
            values = {
                p.name: table.rows[p.name].check(p.value, node.get_name()) for p in parameters
            }
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        section.update(values)
        changed()
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(take)
