"""Publishers of the topics that a node reads, and the one of the test; readers of its topics."""

from dataclasses import dataclass

from seft_msgs_py.node.authors import NAMELESS, UNNAMED
from seft_msgs_py.node.transport import Endpoint, Publisher, Subscription
from seft_msgs_py.wire.outcome import ENDED, MOVING
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, LoopTopic, Topic, bare

_LISTED = 8
"""Unexpected publishers that a status or a line of the log names; all are counted."""
_COUNTED = 1000  # of them at most
_GIVEN_UP = 25
"""Polls, 5 s, without the test's supervisor after which another one is accepted."""


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
    publisher that each had when the test began, and the state until that one leaves `ENDED`. Any
    other publisher is unexpected: its messages are counted, reported with its name, and ignored.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._readers: dict[str, _Reader] = {}
        self._state = ""  # of the test
        self._unheard = 0  # polls since its last message
        self._asked = 0  # of the readers, in turns
        self._refused: dict[tuple[str, bytes], int] = {}  # messages of each unexpected publisher
        self._names: dict[tuple[str, bytes], str] = {}

    def add(self, topic: Topic, full_name: str, subscription: Subscription | None = None) -> None:
        """Watch a topic; without a subscription its publisher is in this process."""
        self._readers[topic.name] = _Reader(topic, full_name, subscription)

    def counts(self) -> dict[str, int]:
        """Count the publishers of each topic."""
        return {name: reader.count(self._endpoint) for name, reader in self._readers.items()}

    def follow(self, state: str) -> None:
        """Choose the publishers when a test begins, by its state."""
        before, self._state, self._unheard = self._state, state, 0
        if (state in MOVING) == (before in MOVING) and (state in ENDED) == (before in ENDED):
            return
        for reader in self._of_the_test():
            if state not in ENDED or reader.topic != EXPERIMENT_STATE:
                reader.accepted = b""
        if state not in MOVING:
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
        self.refuse(name, gid)
        return True

    def refuse(self, name: str, gid: bytes, node: str = "") -> None:
        """Count a message on a topic of an unexpected publisher, whose name may be known."""
        if len(self._refused) >= _COUNTED and (name, gid) not in self._refused:
            return
        self._refused[name, gid] = self._refused.get((name, gid), 0) + 1
        if node:
            self._names[name, gid] = node

    def conflict(self) -> str:
        """Say which topic of the test more than one node publishes; empty if none.

        One of them does not belong to this test, and the messages of either could be used.
        """
        for reader in self._of_the_test():
            if (count := reader.count(self._endpoint)) > 1:
                names = _listed(sorted(self._known(reader).values()), ", ")
                return f"{count} nodes publish {reader.topic.name} ({names})"
        return ""

    def poll(self) -> str:
        """Look for unexpected publishers in a running test; report new ones of one topic.

        To be called five times a second. Reading the graph and logging take a millisecond, so each
        poll does that for one topic at most, however many publishers join.
        """
        self._unheard += 1
        readers = [reader for reader in self._of_the_test() if self._may_be_news(reader)]
        if not readers:
            return ""
        self._asked += 1
        reader = readers[self._asked % len(readers)]
        name, known, news = reader.topic.name, self._known(reader), []
        if self._has_lost(reader) and reader.accepted not in known:
            reader.accepted = b""  # the supervisor has left; it may have been started again
            self._state = ""
            return ""
        for gid, node in known.items():
            if gid != reader.accepted and (name, gid) not in self._names and NAMELESS not in node:
                self._names[name, gid] = node
                self._refused.setdefault((name, gid), 0)
                news.append(node)
        if len(news) < 2:
            return "".join(
                f"{node} publishes {name}, too: this test ignores its messages" for node in news
            )
        return (
            f"{_listed(sorted(news), ', ')} publish {name}, too: this test ignores their messages"
        )

    def unexpected_publishers(self) -> str:
        """List the unexpected publishers of this test, their topics and refused messages."""
        found = [
            f"{self._names.get(key, UNNAMED)} on {key[0]}: {count}"
            for key, count in self._refused.items()
        ]
        return _listed(found, "; ")

    def _may_be_news(self, reader: _Reader) -> bool:
        """Say whether somebody publishes a topic who is not known yet, or its publisher has left.

        Nobody else's publishers are a sign of that: then the graph is read.
        """
        if not reader.accepted:
            return False
        keys = [key for key in self._refused if key[0] == reader.topic.name]
        if keys and self._has_lost(reader):
            return True
        named = sum(key[0] == reader.topic.name for key in self._names)
        unnamed = any(key not in self._names for key in keys)
        return unnamed or reader.count(self._endpoint) >= 2 + named

    def _has_lost(self, reader: _Reader) -> bool:
        """Say whether the supervisor is silent for so long that it may be another one."""
        patience = _GIVEN_UP if self._state in MOVING else 1
        return reader.topic == EXPERIMENT_STATE and self._unheard > patience

    def _of_the_test(self) -> list[_Reader]:
        return [
            reader
            for reader in self._readers.values()
            if isinstance(reader.topic, LoopTopic) or reader.topic == EXPERIMENT_STATE
        ]

    def _known(self, reader: _Reader) -> dict[bytes, str]:
        """Give identifier and full name of each node that publishes a topic, as far as known."""
        return self._endpoint.publishers(reader.full_name)


def _listed(words: list[str], between: str) -> str:
    """Join words; of many the first ones, and how many more there are."""
    more = len(words) - _LISTED
    return between.join(words[:_LISTED] + ([f"{more} more"] if more > 0 else []))


def connected_listeners(endpoint: Endpoint, publisher: Publisher, namespace: str) -> set[str]:
    """Names of the nodes that read a topic, without the test's namespace.

    Empty while some are known but not connected yet.
    """
    full = endpoint.listeners(publisher.topic_name)
    names = {name.removeprefix(f"{namespace}/") for name in full}
    return names if len(names) <= publisher.listener_count() else set()
