import rclpy
from rclpy.context import Context
from rclpy.node import Node
from seft_msgs_py.leaving import leave_graph


def test_a_node_leaves_and_its_context_ends():
    here, beside = Context(), Context()
    for context in (here, beside):
        rclpy.init(args=[], context=context)
    node, other = Node("here", context=here), Node("beside", context=beside)
    leave_graph(node)
    assert not here.ok()
    assert beside.ok()
    leave_graph(other)


def test_what_used_the_default_context_can_come_back():
    for _ in range(2):
        rclpy.init(args=[])
        leave_graph(Node("here"))
