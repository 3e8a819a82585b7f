"""Publishers of the topics that a node reads, and the one of the test; readers of its topics."""

from dataclasses import dataclass

from seft_msgs_py.node.transport import Endpoint, Publisher, Subscription
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, LoopTopic, Topic, bare

UNNAMED, NAMELESS = "a node whose name is not known", "_NODE_NAME_UNKNOWN_"
"""Our name and the middleware's for a node that has not announced itself yet."""


@dataclass
class _Reader:
    """A topic that is read: its full name, its subscription, and the accepted publisher."""

    topic: Topic
    full_name: str
    subscription: Subscription | None  # none, if the publisher is in this process
    accepted: bytes = b""  # identifier of the test's publisher; empty: not chosen

    def count(self, endpoint: Endpoint) -> int:
        """Count the publishers of the topic."""
        if self.subscription is None:
            return endpoint.publisher_count(self.full_name)
        return self.subscription.publisher_count()


class Senders:
    """Publishers of the topics that a node reads, by the middleware's identifiers.

    While a test runs, the loop's topics and the state of the test are accepted only from the
    publisher that each had when the test began. Any other publisher is unexpected: its messages are
    counted, reported with its name, and ignored.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._readers: dict[str, _Reader] = {}
        self._bound = False
        self._refused: dict[tuple[str, bytes], int] = {}  # messages of each unexpected publisher
        self._names: dict[tuple[str, bytes], str] = {}

    def add(self, topic: Topic, full_name: str, subscription: Subscription | None = None) -> None:
        """Watch a topic; without a subscription its publisher is in this process."""
        self._readers[topic.name] = _Reader(topic, full_name, subscription)

    def counts(self) -> dict[str, int]:
        """Count the publishers of each topic."""
        return {name: reader.count(self._endpoint) for name, reader in self._readers.items()}

    def follow(self, moving: bool) -> None:
        """Choose the publishers when a test begins; ``moving``: whether one runs."""
        if moving == self._bound:
            return
        self._bound = moving
        for reader in self._readers.values():
            reader.accepted = b""
        if not moving:
            return
        self._refused.clear()
        self._names.clear()
        for reader in self._of_the_test():
            if reader.subscription is None or reader.count(self._endpoint) > 1:
                continue  # no publisher outside; or the right one is not known
            found = self._known(reader)
            if len(found) > 1:  # one of them is known but not connected yet
                own = bare(reader.topic.publisher)
                found = {gid: name for gid, name in found.items() if bare(name) == own}
            if len(found) == 1:
                (reader.accepted,) = found

    def is_unexpected(self, name: str, gid: bytes) -> bool:
        """Say whether a message comes from an unexpected publisher; if so, count it."""
        accepted = self._readers[name].accepted
        if not accepted or gid == accepted:
            return False
        self._refused[name, gid] = self._refused.get((name, gid), 0) + 1
        return True

    def conflict(self) -> str:
        """Say which topic of the test more than one node publishes; empty if none.

        One of them does not belong to this test, and the messages of either could be used.
        """
        for reader in self._of_the_test():
            if (count := reader.count(self._endpoint)) > 1:
                names = ", ".join(sorted(self._known(reader).values()))
                return f"{count} nodes publish {reader.topic.name} ({names})"
        return ""

    def poll(self) -> list[str]:
        """Look for unexpected publishers in a running test; report the new ones."""
        news = []
        for reader in self._of_the_test():
            name, accepted = reader.topic.name, reader.accepted
            if not accepted:
                continue
            unnamed = any(key not in self._names for key in self._refused if key[0] == name)
            named = sum(key[0] == name for key in self._names)
            if not unnamed and reader.count(self._endpoint) < 2 + named:
                continue
            for gid, node in self._known(reader).items():
                if gid != accepted and (name, gid) not in self._names and NAMELESS not in node:
                    self._names[name, gid] = node
                    self._refused.setdefault((name, gid), 0)
                    news.append(f"{node} publishes {name}, too: this test ignores its messages")
        return news

    def unexpected_publishers(self) -> str:
        """List the unexpected publishers of this test, their topics and refused messages."""
        return "; ".join(
            f"{self._names.get(key, UNNAMED)} on {key[0]}: {count}"
            for key, count in self._refused.items()
        )

    def _of_the_test(self) -> list[_Reader]:
        return [
            reader
            for reader in self._readers.values()
            if isinstance(reader.topic, LoopTopic) or reader.topic == EXPERIMENT_STATE
        ]

    def _known(self, reader: _Reader) -> dict[bytes, str]:
        """Give identifier and full name of each node that publishes a topic, as far as known."""
        return self._endpoint.publishers(reader.full_name)


def connected_listeners(endpoint: Endpoint, publisher: Publisher, namespace: str) -> set[str]:
    """Names of the nodes that read a topic, without the test's namespace.

    Empty while some are known but not connected yet.
    """
    full = endpoint.listeners(publisher.topic_name)
    names = {name.removeprefix(f"{namespace}/") for name in full}
    return names if len(names) <= publisher.listener_count() else set()
