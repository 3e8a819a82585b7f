"""Messages over a link and back at the rate of a test, and the side that echoes them."""

import os
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
from seft_msgs_py.errors import ExperimentError, InputError, WireError
from seft_msgs_py.node.process import leave_graph
from seft_msgs_py.node.rclpy_interface import (
    WaitSet,
    command_node,
    raw_publisher,
    raw_subscription,
    sender,
    taker,
)
from seft_msgs_py.wire.messages import decode_string, encode_string
from seft_msgs_py.wire.topics import LINK_PING, LINK_PONG, RigAxes, Topic

from seft_ros.test_run.link_judgement import RoundTrips

PATIENCE = 15.0  # s, until the other side is found
POLL_PERIOD = 0.05  # s
SETTLING = 0.5  # s that do not count: the first messages are the slowest
FIRST, LAST = 5.0, 1.0  # s in which the first and the last message may come back
ECHO_PERIOD = 0.2  # s


class _LinkNode:
    """A node that publishes one topic and subscribes to another."""

    def __init__(self, name: str, sends: Topic, hears: Topic) -> None:
        self.node = command_node(name)
        self.publisher = raw_publisher(self.node, sends)
        self.send = sender(self.publisher)
        self.subscription = raw_subscription(self.node, hears, reliable=False)
        self._take = taker(self.subscription)
        self._wait_set = WaitSet(self.node.context, [self.subscription])

    def listen(self, timeout: float) -> Iterator[bytes]:
        """Wait at most ``timeout`` s for messages, and give all that have come."""
        self._wait_set.wait(timeout)
        while (taken := self._take()) is not None:
            yield taken[0]

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self.node)


def echo(progress: Callable[[int], None]) -> None:
    """Send back each message as it is, until interrupted.

    Parameters
    ----------
    progress : callable
        Called with the number of messages sent back, several times a second; may raise to end.
    """
    with closing(_LinkNode("seft_link_echo", LINK_PONG, LINK_PING)) as link:
        count = 0
        while True:
            for raw in link.listen(ECHO_PERIOD):
                link.send(raw)
                count += 1
            progress(count)


def measure(
    rate: float,
    duration: float,
    size: int,
    progress: Callable[[str, int], None],
    rig: RigAxes | None = None,
) -> RoundTrips:
    """Measure the link to the node that echoes on this ROS domain.

    Parameters
    ----------
    rate : float
        Messages a second.
    duration : float
        Time for which they are sent, s.
    size : int
        Bytes of each.
    progress : callable
        Called with the present stage and the number of messages sent.
    rig : RigAxes, optional
        Of several rigs, the one whose force controller echoes.

    Raises
    ------
    InputError
        If nobody echoes, or several do.
    ExperimentError
        If nothing comes back.
    """
    ping, pong = (LINK_PING, LINK_PONG) if rig is None else (LINK_PING.of(rig), LINK_PONG.of(rig))
    first, count = -max(1, round(SETTLING * rate)), max(2, round(duration * rate))
    own = uuid.uuid4().hex
    sent: dict[int, float] = {}
    back: list[tuple[int, float]] = []

    def listen_until(deadline: float) -> None:
        while (left := deadline - time.monotonic()) > 0:
            for raw in link.listen(left):
                now = time.monotonic()
                try:
                    name, number, *_ = decode_string(raw).split(" ")
                    if name == own:
                        back.append((int(number), now - sent[int(number)]))
                except (WireError, ValueError):
                    continue  # of someone else

    def send(number: int) -> None:
        raw = encode_string(f"{own} {number} {'.' * size}"[:size])
        sent[number] = time.monotonic()
        link.send(raw)

    with closing(_LinkNode("seft_link", ping, pong)) as link:
        progress("looking for the other side", 0)
        _find_echo(link, pong)
        deadline = time.monotonic() + FIRST
        while not back and time.monotonic() < deadline:  # it may not have found this side yet
            send(first - 1)
            listen_until(time.monotonic() + POLL_PERIOD)
        start = time.monotonic() - first / rate
        for number in range(first, count):
            listen_until(start + number / rate)
            send(number)
            progress("measuring the link", max(number, 0))
        deadline = time.monotonic() + LAST
        while len({number for number, _ in back}) < len(sent) and time.monotonic() < deadline:
            listen_until(min(deadline, time.monotonic() + POLL_PERIOD))
    progress("measured", count)
    counted = [(number, took) for number, took in back if number >= 0]
    if not counted:
        raise ExperimentError(
            f"none of {count} messages came back over the link; is a firewall between?"
        )
    numbers, times = zip(*counted, strict=True)
    return RoundTrips(rate, count, np.array(times), np.array(numbers))


def _find_echo(link: _LinkNode, pong: Topic) -> None:
    """Wait for the one node that echoes."""
    deadline = time.monotonic() + PATIENCE
    while True:
        echoes = link.node.get_publishers_info_by_topic(pong.name)
        if len(echoes) > 1:
            names = ", ".join(sorted(echo.node_name for echo in echoes))
            raise InputError(f"several nodes echo on this ROS domain: {names}; let one do so")
        if link.publisher.get_subscription_count() and link.subscription.get_publisher_count():
            return
        if time.monotonic() > deadline:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise InputError(
                f"nobody echoes on ROS domain {domain} within {PATIENCE:g} s; on the other "
                "host start seft link --echo, or its force_controller with a loop_delay "
                "(docs/hosts.md has what two hosts need to find each other)"
            )
        time.sleep(POLL_PERIOD)
