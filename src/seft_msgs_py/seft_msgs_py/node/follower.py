"""The state of a test and what its nodes tell of themselves, for a reader that is no node of it."""

from collections.abc import Collection, Mapping

from seft_msgs_py.errors import WireError
from seft_msgs_py.node.clock import MACHINE, Clock
from seft_msgs_py.node.senders import Authors, Message, Senders
from seft_msgs_py.node.transport import Endpoint, Subscription
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.outcome import MOVING
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, Topic

_POLL_PERIOD = 0.2  # s between two looks for the names of publishers


class Follower:
    """Follows a test by the supervisor that it began with, and by its own nodes.

    Parameters
    ----------
    endpoint : Endpoint
        The node that reads.
    depths : mapping of Topic to int
        Messages that wait at most, of each topic that all nodes publish, and of the state.
    nodes : collection of str, optional
        See `Authors`.
    clock : Clock
        For the time between two looks at the graph.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        depths: Mapping[Topic, int],
        nodes: Collection[str] | None = None,
        clock: Clock = MACHINE,
    ) -> None:
        self._clock, self._depths = clock, dict(depths)
        self._polled_at = dict.fromkeys(depths, clock.monotonic())
        self._senders = Senders(endpoint)
        self._subscriptions: dict[Topic, Subscription] = {}
        self._authors: dict[Topic, Authors] = {}
        for topic, depth in depths.items():
            subscription = self._subscriptions[topic] = endpoint.subscribe(topic, depth)
            name = subscription.topic_name
            if topic == EXPERIMENT_STATE:
                self._senders.add(topic, name, subscription)
            else:
                self._authors[topic] = Authors(endpoint, topic, name, endpoint.namespace, nodes)

    def take(self, topic: Topic) -> list[Message]:
        """Take the messages that count and have arrived, the oldest first."""
        waiting = self._now_named(topic)
        for _ in range(self._depths[topic]):
            if (taken := self._subscriptions[topic].take()) is None:
                break
            waiting.append(Message(*taken))
        return [message for message in waiting if self._counts(topic, message)]

    def _counts(self, topic: Topic, message: Message) -> bool:
        try:
            if topic != EXPERIMENT_STATE:
                return bool(self._authors[topic].check(message))
            if self._senders.is_unexpected(topic.name, message.gid):
                return False
            state = decode_state(message.raw).state
        except WireError:
            return False
        self._senders.follow(state)
        for authors in self._authors.values():
            authors.bound = state in MOVING
        return True

    def _now_named(self, topic: Topic) -> list[Message]:
        """Look at the graph if it is time; give messages whose publishers' names are known now."""
        now = self._clock.monotonic()
        if now - self._polled_at[topic] < _POLL_PERIOD:
            return []
        self._polled_at[topic] = now
        if topic != EXPERIMENT_STATE:
            return self._authors[topic].poll()
        self._senders.poll()
        return []
