"""A node of the `seft` command that stands in for other nodes of a test."""

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from seft_msgs_py.errors import ExperimentError, WireError
from seft_msgs_py.node.process import leave_graph
from seft_msgs_py.node.rclpy_interface import (
    Publisher,
    Subscription,
    WaitSet,
    command_node,
    is_acknowledged,
    raw_publisher,
    raw_subscription,
    sender,
    take_timed,
)
from seft_msgs_py.wire.messages import Status, decode_diagnostics, encode_status
from seft_msgs_py.wire.topics import DIAGNOSTICS, EXPERIMENT_STATE, Topic

HEARTBEAT = 0.2  # s between two repeats of the test's state
HEARD = 2.0  # s for a reader to acknowledge the test's state
Receive = Callable[[bytes, float, float], None]
"""Takes a message, and the times of its reception and sending, s, monotonic."""


class Player:
    """Publishes and receives messages as other nodes of a test would, such as the supervisor.

    Parameters
    ----------
    name : str
        Of the node.
    sends : sequence of Topic
        Topics it publishes besides experiment/state.
    hears : mapping of Topic to callable
        Topics it subscribes to, with the functions that take their messages.

    Attributes
    ----------
    status : dict of str to Status
        Node -> the last status of its diagnostics.
    """

    def __init__(self, name: str, sends: Sequence[Topic], hears: Mapping[Topic, Receive]) -> None:
        self.status: dict[str, Status] = {}
        self.node = command_node(name)
        self._publishers: dict[Topic, Publisher] = {}
        self._senders: dict[Topic, Callable[[bytes], None]] = {}
        for topic in (EXPERIMENT_STATE, *sends):
            self.publish_on(topic)
        takers = {**hears, DIAGNOSTICS: self._on_diagnostics}
        self._takers: dict[Subscription, Receive] = {}
        self._topics: dict[Topic, Subscription] = {}
        for topic, taker in takers.items():
            subscription = raw_subscription(self.node, topic)
            self._takers[subscription], self._topics[topic] = taker, subscription
        self._wait_set = WaitSet(self.node.context, list(self._takers))
        self._state: bytes | None = None
        self._said_at = 0.0

    def publish_on(self, topic: Topic) -> None:
        """Begin to publish a topic."""
        publisher = raw_publisher(self.node, topic)
        self._publishers[topic], self._senders[topic] = publisher, sender(publisher)

    def send(self, topic: Topic, raw: bytes) -> None:
        """Publish a message."""
        self._senders[topic](raw)

    def say(self, state: str, steps: int | None = None, **values: str) -> None:
        """Publish the test's state as the supervisor would; return when all readers have it.

        The state is a `State`; the test's steps and other values come with it.

        Raises
        ------
        ExperimentError
            If it is not acknowledged.
        """
        shown = {**values, **({} if steps is None else {"steps": str(steps)})}
        self._state = encode_status(Status("experiment", 0, state, values=shown))
        self._repeat()
        if not is_acknowledged(self._publishers[EXPERIMENT_STATE], HEARD):
            raise ExperimentError(f"the state {state} of the test was not heard within {HEARD:g} s")

    def be_silent(self) -> None:
        """Stop repeating the state, as a supervisor that has died."""
        self._state = None

    def listen(self, timeout: float) -> bool:
        """Wait at most ``timeout`` s for messages, handle them, and repeat the state if due."""
        if self._state is not None and time.monotonic() - self._said_at >= HEARTBEAT:
            self._repeat()
        ready = self._wait_set.wait(timeout)
        now, offset = time.monotonic(), time.monotonic() - time.time()
        for subscription in ready:
            while (taken := take_timed(subscription)) is not None:
                raw, sent_ns = taken
                with contextlib.suppress(WireError):
                    self._takers[subscription](raw, now, sent_ns / 1e9 + offset)
        return bool(ready)

    def listen_for(self, duration: float) -> None:
        """Handle all messages for ``duration`` s."""
        deadline = time.monotonic() + duration
        while (left := deadline - time.monotonic()) > 0:
            self.listen(min(left, HEARTBEAT / 2))

    def is_matched(self, node: str, sends: Iterable[Topic], hears: Iterable[Topic]) -> bool:
        """Tell whether a node has this one's state and these topics, also by its own status."""
        reported = self.status[node].values if node in self.status else {}
        for topic in (EXPERIMENT_STATE, *sends):
            there = self.node.get_subscriptions_info_by_topic(topic.name)
            found = self._publishers[topic].get_subscription_count()
            hears_us = reported.get(f"senders {topic.name}") != "0"
            if not (found and hears_us and node in {info.node_name for info in there}):
                return False
        for topic in hears:
            there = self.node.get_publishers_info_by_topic(topic.name)
            found, own = self._topics[topic].get_publisher_count(), self.node.get_name()
            matched = reported.get(f"matched {topic.name}", own)  # a driver need not report it
            if not (found and own in matched.split() and node in {i.node_name for i in there}):
                return False
        return True

    def on_status(self, status: Status, at: float) -> None:
        """Take a status; for subclasses."""

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self.node)

    def _repeat(self) -> None:
        self._said_at = time.monotonic()
        if self._state is not None:
            self.send(EXPERIMENT_STATE, self._state)

    def _on_diagnostics(self, raw: bytes, at: float, sent: float) -> None:
        for status in decode_diagnostics(raw)[1]:
            self.status[status.name] = status
            self.on_status(status, at)
