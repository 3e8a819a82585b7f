"""Who publishes what a node reads, who of these belongs to the test, and who reads its topics."""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from seft_msgs_py.errors import WireError
from seft_msgs_py.node.transport import MACHINE, Clock, Endpoint, Publisher, Subscription
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import nodes_named
from seft_msgs_py.wire.outcome import ENDED, MOVING
from seft_msgs_py.wire.topics import EXPERIMENT_STATE, NODES, LoopTopic, Topic, bare

UNNAMED, NAMELESS = "a node whose name is not known", "_NODE_NAME_UNKNOWN_"
"""Our name and the middleware's for a node that has not announced itself yet."""
_MOST_UNKNOWN, _MOST_OF_EACH, _MOST_BYTES = 64, 4, 1 << 25
"""Publishers without a known name of which messages are kept; messages of each; bytes of all."""
_MOST_NAMES = 1000  # of publishers, also of those that have left
_MOST_POLLS = 150
"""Polls, 30 s, for which they are kept."""


class Message(NamedTuple):
    """A message: its bytes, a time of it, ns, and the identifier of its publisher."""

    raw: bytes
    at_ns: int
    gid: bytes


class Authors:
    """The nodes of a test as publishers of one topic that all of them share.

    A message counts if all nodes that it tells of are the node that sent it, by the name that the
    middleware knows of its publisher. While a test runs, each node's messages count only from the
    publisher that they came from when it began.

    Parameters
    ----------
    endpoint : Endpoint
        The node that reads.
    topic : Topic
        Diagnostics or description.
    full_name : str
        Full name of the topic.
    namespace : str
        Of the test, without a slash at its end.
    nodes : collection of str, optional
        The test's nodes, with their rigs' names; default all that have a name of such nodes.

    Attributes
    ----------
    bound : bool
        Whether a test runs.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        topic: Topic,
        full_name: str,
        namespace: str,
        nodes: Collection[str] | None = None,
    ) -> None:
        self._endpoint, self._topic, self._full_name = endpoint, topic, full_name
        self._namespace, self._nodes = namespace, nodes
        self.bound = False
        self._names: dict[bytes, str] = {}  # full names of publishers
        self._chosen: dict[str, bytes] = {}  # node -> its publisher
        self._kept: dict[bytes, list[Message]] = {}  # of publishers without a known name
        self._polls: dict[bytes, int] = {}  # for which they have none

    def check(self, message: Message) -> bool | None:
        """Say whether a message counts; None: it is kept until its publisher's name is known.

        Raises
        ------
        WireError
            If it can't be read.
        """
        name = self._names.get(message.gid)
        if name is None:
            self._keep(message)
            return None
        node = name.removeprefix(f"{self._namespace}/")
        if not self._is_of_the_test(node) or nodes_named(self._topic, message.raw) != {node}:
            return False
        if self.bound:
            return self._chosen.setdefault(node, message.gid) == message.gid
        self._chosen[node] = message.gid
        return True

    def name_of(self, gid: bytes) -> str:
        """Full name of a node, by the identifier of its publisher."""
        return self._names.get(gid, UNNAMED)

    def poll(self) -> list[Message]:
        """Give the kept messages whose publishers' names are known now, to be checked."""
        if not self._kept:
            return []
        found = self._endpoint.publishers(self._full_name)
        before = self._names if len(self._names) < _MOST_NAMES else {}
        self._names = before | {gid: name for gid, name in found.items() if NAMELESS not in name}
        known = []
        for gid in list(self._kept):
            self._polls[gid] += 1
            if gid in self._names or self._polls[gid] > _MOST_POLLS:
                messages = self._kept.pop(gid)
                del self._polls[gid]
                known += messages if gid in self._names else []
        return known

    def twins(self) -> str:
        """Say which node of the test there is more than once; empty if none."""
        counts = Counter(self._endpoint.publishers(self._full_name).values())
        for name, count in counts.items():
            node = name.removeprefix(f"{self._namespace}/")
            if count > 1 and self._is_of_the_test(node):
                return f"{count} nodes {node} publish {self._topic.name}"
        return ""

    def _is_of_the_test(self, node: str) -> bool:
        return node in self._nodes if self._nodes is not None else bare(node) in NODES

    def _keep(self, message: Message) -> None:
        size = sum(len(each.raw) for messages in self._kept.values() for each in messages)
        is_new = message.gid not in self._kept
        if size > _MOST_BYTES or (is_new and len(self._kept) >= _MOST_UNKNOWN):
            return
        kept = self._kept.setdefault(message.gid, [])
        self._polls.setdefault(message.gid, 0)
        kept.append(message)
        del kept[:-_MOST_OF_EACH]


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

    Attributes
    ----------
    authors : list of Authors
        Those of the topics that all nodes publish.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._readers: dict[str, _Reader] = {}
        self._state = ""  # of the test
        self._unheard = 0  # polls since its last message
        self._asked = 0  # of the readers, in turns
        self._refused: dict[tuple[str, bytes], int] = {}  # messages of each unexpected publisher
        self._names: dict[tuple[str, bytes], str] = {}
        self.authors: list[Authors] = []

    def add(self, topic: Topic, full_name: str, subscription: Subscription | None = None) -> None:
        """Watch a topic; without a subscription its publisher is in this process."""
        self._readers[topic.name] = _Reader(topic, full_name, subscription)

    def counts(self) -> dict[str, int]:
        """Count the publishers of each topic."""
        return {name: reader.count(self._endpoint) for name, reader in self._readers.items()}

    def follow(self, state: str) -> None:
        """Choose the publishers when a test begins, by its state."""
        before, self._state, self._unheard = self._state, state, 0
        for authors in self.authors:
            authors.bound = state in MOVING
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
            found = self._endpoint.publishers(reader.full_name)
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

        One of them does not belong to this test, and the messages of either could be used. Or which
        node there is more than once, by the topics that all nodes publish.
        """
        for reader in self._of_the_test():
            if (count := reader.count(self._endpoint)) > 1:
                names = _listed(sorted(self._endpoint.publishers(reader.full_name).values()), ", ")
                return f"{count} nodes publish {reader.topic.name} ({names})"
        return next(filter(None, (authors.twins() for authors in self.authors)), "")

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
        name, known, news = reader.topic.name, self._endpoint.publishers(reader.full_name), []
        if self._has_lost(reader) and reader.accepted not in known:
            reader.accepted = b""  # the supervisor has left; it may have been started again
            self._state = ""
            return ""
        for gid, node in known.items():
            if gid != reader.accepted and (name, gid) not in self._names and NAMELESS not in node:
                self._names[name, gid] = node
                self._refused.setdefault((name, gid), 0)
                news.append(node)
        if not news:
            return ""
        publish, their = ("publishes", "its") if len(news) == 1 else ("publish", "their")
        who = _listed(sorted(news), ", ")
        return f"{who} {publish} {name}, too: this test ignores {their} messages"

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
        self._senders.authors = list(self._authors.values())

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
