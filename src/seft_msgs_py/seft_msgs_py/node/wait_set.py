"""Waiting for raw messages in the calling thread: the only user of rclpy's private interface.

rclpy's executors deserialise every message and hand it to tasks, which costs more than a whole
step of the loop. rclpy's own ``wait_for_message`` shows the way taken here: a wait set over
some subscriptions, from which bytes are taken as they came.
"""

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from seft_msgs_py.node.ros_types import message_class, qos_profile
from seft_msgs_py.wire.topics import Topic


class LoopCallbackGroup(CallbackGroup):
    """Group of the subscriptions that executors must leave to a `WaitSet`."""

    def can_execute(self, entity: Any) -> bool:
        """No executor may wait for these."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """No executor may take from these."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


def raw_subscription(
    node: Node, topic: Topic, depth: int | None = None, reliable: bool = True
) -> Subscription:
    """Subscribe to a topic for a `WaitSet`; see `qos_profile` for depth and reliability."""
    return node.create_subscription(
        message_class(topic),
        topic.name,
        lambda _: None,
        qos_profile(topic, depth, reliable),
        callback_group=LoopCallbackGroup(),
        raw=True,
    )


class WaitSet:
    """Waits until one of some subscriptions has a message.

    Parameters
    ----------
    context : Context
        Of the nodes.
    subscriptions : sequence of Subscription
        As `raw_subscription` makes them.
    """

    def __init__(self, context: Context, subscriptions: Sequence[Subscription]) -> None:
        self._subscriptions = {each.handle.pointer: each for each in subscriptions}
        self._handles = [each.handle for each in subscriptions]
        if not self._handles:
            raise ValueError("a wait set needs something to wait for")
        self._wait_set = _rclpy.WaitSet(len(self._handles), 0, 0, 0, 0, 0, context.handle)

    def wait(self, timeout: float) -> list[Subscription]:
        """Wait for a message, at most ``timeout`` seconds; return where there are some."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        for handle in self._handles:
            wait_set.add_subscription(handle)
        wait_set.wait(max(0, int(timeout * 1e9)))
        known = self._subscriptions
        return [known[pointer] for pointer in wait_set.get_ready_entities("subscription")]


def take(subscription: Subscription) -> tuple[bytes, int, int] | None:
    """Take the oldest message that has arrived on a raw subscription.

    Returns
    -------
    (bytes, int, int) or None
        The message, the wall-clock time in ns at which it came in, and how many its publisher
        has sent with it, 0 where the middleware does not tell; None if there is none.
    """
    taken = subscription.handle.take_message(subscription.msg_type, True)
    if taken is None:
        return None
    raw, info = taken
    return raw, info["received_timestamp"], info["publication_sequence_number"] or 0


def take_timed(subscription: Subscription) -> tuple[bytes, int] | None:
    """Take the oldest message, and when its sender sent it, wall clock of its host, ns."""
    taken = subscription.handle.take_message(subscription.msg_type, True)
    return None if taken is None else (taken[0], taken[1]["source_timestamp"])


def take_all(subscription: Subscription, most: int) -> list[tuple[bytes, int]]:
    """Take what has arrived on a raw subscription, at most so many messages.

    Returns
    -------
    list of (bytes, int)
        The messages, oldest first, as `take_timed` gives each.
    """
    found: list[tuple[bytes, int]] = []
    while len(found) < most and (taken := take_timed(subscription)) is not None:
        found.append(taken)
    return found


def sender(publisher: Publisher) -> Callable[[bytes], None]:
    """Give what publishes message bytes, without the checks that rclpy makes on the way."""
    return publisher.handle.publish_raw
