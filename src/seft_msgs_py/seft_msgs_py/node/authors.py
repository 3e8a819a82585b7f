"""Who wrote a message on a topic that every node publishes: a node speaks for itself alone."""

from collections import Counter
from collections.abc import Collection
from typing import NamedTuple

from seft_msgs_py.node.transport import Endpoint
from seft_msgs_py.wire.messages import nodes_named
from seft_msgs_py.wire.topics import NODES, Topic, bare

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
