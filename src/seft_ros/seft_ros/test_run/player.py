"""A node of the `seft` command that plays the parts of other nodes of a test."""

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from seft_msgs_py.errors import ExperimentError, WireError
from seft_msgs_py.node.rclpy_interface import (
    WaitSet,
    message_class,
    qos_profile,
    raw_subscription,
    sender,
    take_timed,
)
from seft_msgs_py.node.shutdown import leave_graph
from seft_msgs_py.wire.messages import Status, decode_diagnostics, encode_status
from seft_msgs_py.wire.topics import DIAGNOSTICS, EXPERIMENT_STATE, Topic

HEARTBEAT = 0.2  # s between two repeats of the test's state
HEARD = 2.0  # s for a reader to acknowledge the test's state
Receive = Callable[[bytes, float, float], None]
"""Takes a message, when it was found and when it was sent, s, monotonic."""


class Player:
    """Sends and hears the messages of a test as other nodes would, the supervisor among them.

    Parameters
    ----------
    name : str
        Of the node.
    sends : sequence of Topic
        Topics it publishes beside experiment/state.
    hears : mapping of Topic to callable
        What takes the messages of each topic that it listens to.

    Attributes
    ----------
    status : dict of str to Status
        Node -> the last status of its diagnostics.
    """

    def __init__(self, name: str, sends: Sequence[Topic], hears: Mapping[Topic, Receive]) -> None:
        self.status: dict[str, Status] = {}
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(name, start_parameter_services=False)
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
        """Be a publisher of a topic from now on."""
        publisher = self.node.create_publisher(message_class(topic), topic.name, qos_profile(topic))
        self._publishers[topic], self._senders[topic] = publisher, sender(publisher)

    def send(self, topic: Topic, raw: bytes) -> None:
        """Publish a message."""
        self._senders[topic](raw)

    def say(self, state: str, steps: int | None = None, **values: str) -> None:
        """Say as the supervisor where the test is; returns when who listens has it.

        The state is a `seft_ros.test_run.state_machine.State`; with it come the test's steps, and
        whatever else is given.

        Raises
        ------
        ExperimentError
            If it is not acknowledged.
        """
        told = {**values, **({} if steps is None else {"steps": str(steps)})}
        self._state = encode_status(Status("experiment", 0, state, values=told))
        self._repeat()
        if not self._publishers[EXPERIMENT_STATE].wait_for_all_acked(Duration(seconds=HEARD)):
            raise ExperimentError(f"the state {state} of the test was not heard within {HEARD:g} s")

    def be_silent(self) -> None:
        """Repeat the state no more, as a supervisor that has died."""
        self._state = None

    def listen(self, timeout: float) -> bool:
        """Hand over what comes within ``timeout`` s, and return when some has; repeat the state."""
        if self._state is not None and time.monotonic() - self._said_at >= HEARTBEAT:
            self._repeat()
        ready = self._wait_set.wait(timeout)
        now, offset = time.monotonic(), time.monotonic() - time.time()
        for subscription in ready:
            while (taken := take_timed(subscription)) is not None:
                raw, sent_ns = taken
                with contextlib.suppress(WireError):  # what can't be read
                    self._takers[subscription](raw, now, sent_ns / 1e9 + offset)
        return bool(ready)

    def listen_for(self, duration: float) -> None:
        """Hand over all that comes in ``duration`` s."""
        deadline = time.monotonic() + duration
        while (left := deadline - time.monotonic()) > 0:
            self.listen(min(left, HEARTBEAT / 2))

    def is_matched(self, node: str, sends: Iterable[Topic], hears: Iterable[Topic]) -> bool:
        """Tell whether a node hears, and is heard, on some topics; it must say so itself, too."""
        told = self.status[node].values if node in self.status else {}
        for topic in sends:
            there = self.node.get_subscriptions_info_by_topic(topic.name)
            found = self._publishers[topic].get_subscription_count()
            hears_us = told.get(f"senders {topic.name}") != "0"
            if not (found and hears_us and node in {info.node_name for info in there}):
                return False
        for topic in hears:
            there = self.node.get_publishers_info_by_topic(topic.name)
            found, own = self._topics[topic].get_publisher_count(), self.node.get_name()
            matched = told.get(f"matched {topic.name}", own)  # a lab's own driver need not tell
            if not (found and own in matched.split() and node in {i.node_name for i in there}):
                return False
        return True

    def on_status(self, status: Status, at: float) -> None:
        """Take a status that comes; for those who derive from this."""

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
