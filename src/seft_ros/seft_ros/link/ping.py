"""Messages sent over a link and back, at the rate of a test."""

import os
import time
import uuid
from collections.abc import Callable

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from seft_msgs_py.errors import ExperimentError, InputError, WireError
from seft_msgs_py.node.exit_watchdog import leave_graph
from seft_msgs_py.node.ros_types import message_class, qos_profile
from seft_msgs_py.node.wait_set import WaitSet, raw_subscription, sender, take
from seft_msgs_py.wire.messages import decode_string, encode_string
from seft_msgs_py.wire.rigs import RigAxes
from seft_msgs_py.wire.topics import LINK_PING, LINK_PONG

from seft_ros.link.round_trips import RoundTrips

PATIENCE = 15.0  # s, until the other side is found
LOOK = 0.05  # s
SETTLING = 0.5  # s without being counted: first messages are the slowest
LAST = 1.0  # s in which the last one may come back


def measure(
    rate: float,
    duration: float,
    size: int,
    progress: Callable[[str, int], None],
    rig: RigAxes | None = None,
) -> RoundTrips:
    """Measure the link to whoever echoes on this ROS domain.

    Parameters
    ----------
    rate : float
        Messages a second.
    duration : float
        For which they are sent, s.
    size : int
        Bytes of each.
    progress : callable
        Told what goes on, and the messages sent.
    rig : RigAxes, optional
        Whose force controller is to echo, of several rigs.

    Raises
    ------
    InputError
        If nobody echoes, or several do.
    ExperimentError
        If nothing comes back.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node("seft_link", start_parameter_services=False)
    try:
        return _Pinger(node, rig).measure(rate, duration, size, progress)
    finally:
        leave_graph(node)


class _Pinger:
    def __init__(self, node: Node, rig: RigAxes | None) -> None:
        self._node = node
        ping, self._pong = LINK_PING, LINK_PONG
        if rig is not None:
            ping, self._pong = ping.of(rig), self._pong.of(rig)
        self._publisher = node.create_publisher(message_class(ping), ping.name, qos_profile(ping))
        self._subscription = raw_subscription(node, self._pong, reliable=False)
        self._wait_set = WaitSet(node.context, [self._subscription])
        self._name = uuid.uuid4().hex
        self._sent: dict[int, float] = {}
        self._back: list[tuple[int, float]] = []

    def measure(
        self, rate: float, duration: float, size: int, progress: Callable[[str, int], None]
    ) -> RoundTrips:
        """See `measure`."""
        progress("looking for the other side", 0)
        self._find_echo()
        send = sender(self._publisher)
        first = -max(1, round(SETTLING * rate))
        count = max(2, round(duration * rate))
        padding = "." * size
        start = time.monotonic() - first / rate
        for number in range(first, count):
            text = f"{self._name} {number} {padding}"[:size]
            raw = encode_string(text)
            self._listen_until(start + number / rate)
            self._sent[number] = time.monotonic()
            send(raw)
            progress("measuring the link", max(number, 0))
        deadline = time.monotonic() + LAST
        while len(self._back) < len(self._sent) and time.monotonic() < deadline:
            self._listen_until(min(deadline, time.monotonic() + LOOK))
        progress("measured", count)
        counted = [(number, at) for number, at in self._back if number >= 0]
        if not counted:
            raise ExperimentError(
                f"none of {count} messages came back over the link; is a firewall between?"
            )
        numbers = np.array([number for number, _ in counted])
        times = np.array([at - self._sent[number] for number, at in counted])
        return RoundTrips(rate, count, times, numbers)

    def _find_echo(self) -> None:
        deadline = time.monotonic() + PATIENCE
        while True:
            echoes = self._node.get_publishers_info_by_topic(self._pong.name)
            if len(echoes) > 1:
                names = ", ".join(sorted(echo.node_name for echo in echoes))
                raise InputError(f"several nodes echo on this ROS domain: {names}; let one do so")
            connected = self._publisher.get_subscription_count()
            if connected and self._subscription.get_publisher_count():
                return
            if time.monotonic() > deadline:
                domain = os.environ.get("ROS_DOMAIN_ID", "0")
                raise InputError(
                    f"nobody echoes on ROS domain {domain} within {PATIENCE:g} s; on the other "
                    "host start seft link --echo, or its force_controller with a loop_delay "
                    "(docs/hosts.md has what two hosts need to find each other)"
                )
            time.sleep(LOOK)

    def _listen_until(self, deadline: float) -> None:
        while (left := deadline - time.monotonic()) > 0:
            if not self._wait_set.wait(left):
                continue
            now = time.monotonic()
            while (taken := take(self._subscription)) is not None:
                self._take(taken[0], now)

    def _take(self, raw: bytes, now: float) -> None:
        try:
            name, number, *_ = decode_string(raw).split(" ")
            if name == self._name:
                self._back.append((int(number), now))
        except (WireError, ValueError):
            return  # of someone else
