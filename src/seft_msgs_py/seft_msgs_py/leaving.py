"""Leaving the graph, from a process that is no node of a test."""

import time

import rclpy
from rclpy.node import Node

from seft_msgs_py.ending import ending_within

QUIET = 0.1  # s without a change
PATIENCE = 2.0  # s for the graph to be quiet
CLOSE_PATIENCE = 10.0  # s
_TOLD = (
    "seft: the middleware does not let this process leave the graph (a fault of FastDDS); it is "
    "ended here, and what was recorded is complete"
)


def leave_graph(node: Node) -> None:
    """Take a node off the graph, when nobody else leaves, and end its context.

    See `ending_within` for why: of some hundred processes that leave together one hangs.
    """
    _wait_for_quiet(node)
    with ending_within(CLOSE_PATIENCE, 1, _TOLD):
        node.destroy_node()
        is_default = node.context is rclpy.get_default_context()
        rclpy.try_shutdown(context=None if is_default else node.context)  # it can begin anew


def _wait_for_quiet(node: Node) -> None:
    deadline, seen, since = time.monotonic() + PATIENCE, None, 0.0
    while (now := time.monotonic()) < deadline:
        names = sorted(node.get_node_names_and_namespaces())
        if names != seen:
            seen, since = names, now
        elif now - since > QUIET:
            return
        time.sleep(QUIET / 10)
