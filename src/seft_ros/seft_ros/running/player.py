"""A node of the `seft` command that plays the parts of other nodes of a test."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from seft_msgs_py.errors import ExperimentError, WireError
from seft_msgs_py.node.exit_watchdog import leave_graph
from seft_msgs_py.node.ros_types import message_class, qos_profile
from seft_msgs_py.node.wait_set import WaitSet, raw_subscription, sender, take_timed
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
    on_status : callable
        Called with each status that comes, and when.
    """

    def __init__(self, name: str, sends: Sequence[Topic], hears: Mapping[Topic, Receive]) -> None:
        self.status: dict[str, Status] = {}
        self.on_status: Callable[[Status, float], None] = lambda status, at: None
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

        Parameters
        ----------
        state : str
            As `seft_ros.experiment.state_machine.State`.
        steps : int, optional
            Steps of the test.
        **values
            What else comes with it.

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
            listeners = self.node.get_subscriptions_info_by_topic(topic.name)
            if node not in {info.node_name for info in listeners}:
                return False
            if not self._publishers[topic].get_subscription_count():
                return False
            if told.get(f"senders {topic.name}", "1") == "0":
                return False
        for topic in hears:
            publishers = self.node.get_publishers_info_by_topic(topic.name)
            if node not in {info.node_name for info in publishers}:
                return False
            if not self._topics[topic].get_publisher_count():
                return False
            key = f"matched {topic.name}"  # which a lab's own driver need not tell
            if key in told and self.node.get_name() not in told[key].split():
                return False
        return True

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self.node)

    def _repeat(self) -> None:
        self._said_at = time.monotonic()
        if self._state is not None:
            self.send(EXPERIMENT_STATE, self._state)

    def _on_diagnostics(self, raw: bytes, at: float, sent: float) -> None:
        del sent
        try:
            statuses = decode_diagnostics(raw)[1]
        except WireError:
            return
        for status in statuses:
            self.status[status.name] = status
            self.on_status(status, at)
