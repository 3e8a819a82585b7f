"""The other side of a link that is measured: sends back what comes, as it comes."""

from collections.abc import Callable

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from seft_msgs_py.node.exit_watchdog import leave_graph
from seft_msgs_py.node.ros_types import message_class, qos_profile
from seft_msgs_py.node.wait_set import WaitSet, raw_subscription, sender, take
from seft_msgs_py.wire.topics import LINK_PING, LINK_PONG

LOOK = 0.2  # s


def echo(progress: Callable[[int], None]) -> None:
    """Echo until interrupted.

    Parameters
    ----------
    progress : callable
        Told the number of messages sent back, several times a second; may raise to end.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node("seft_link_echo", start_parameter_services=False)
    try:
        send = sender(
            node.create_publisher(message_class(LINK_PONG), LINK_PONG.name, qos_profile(LINK_PONG))
        )
        subscription = raw_subscription(node, LINK_PING, reliable=False)
        wait_set, count = WaitSet(node.context, [subscription]), 0
        while True:
            wait_set.wait(LOOK)
            while (taken := take(subscription)) is not None:
                send(taken[0])
                count += 1
            progress(count)
    finally:
        leave_graph(node)
