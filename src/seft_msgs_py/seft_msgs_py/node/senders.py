"""Who sends what a node reads, and which of several senders is the test's."""

from dataclasses import dataclass

from rclpy.node import Node
from rclpy.subscription import Subscription

from seft_msgs_py.wire.topics import EXPERIMENT_STATE, LoopTopic, Topic, bare

UNNAMED, NAMELESS = "a node whose name is not known", "_NODE_NAME_UNKNOWN_"
"""As it is told, and as the middleware says it until the node has announced itself."""


@dataclass
class _Reader:
    """One topic that is read: its full name, its subscription, and the sender it is taken from."""

    topic: Topic
    full_name: str
    subscription: Subscription | None  # none, where it comes from this process
    true: bytes = b""  # identifier of the test's sender; empty: not chosen

    def count(self, node: Node) -> int:
        """How many publish the topic."""
        if self.subscription is None:
            return int(node.count_publishers(self.full_name))
        return int(self.subscription.get_publisher_count())


class Senders:
    """Senders of the topics that a node reads, as the middleware tells them apart.

    While a test runs, the loop's topics and the state of the test are taken from the one sender
    of each that was there at its begin. Whoever else sends on them is a stranger: counted, named,
    and not heard.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._readers: dict[str, _Reader] = {}
        self._bound = False
        self._refused: dict[tuple[str, bytes], int] = {}  # messages of each stranger
        self._names: dict[tuple[str, bytes], str] = {}

    def add(self, topic: Topic, full_name: str, subscription: Subscription | None = None) -> None:
        """Look after a topic; without a subscription it comes from this process."""
        self._readers[topic.name] = _Reader(topic, full_name, subscription)

    def counts(self) -> dict[str, int]:
        """How many publish each topic."""
        return {name: reader.count(self._node) for name, reader in self._readers.items()}

    def follow(self, moving: bool) -> None:
        """Take in whether a test runs: at its begin the senders are chosen."""
        if moving == self._bound:
            return
        self._bound = moving
        for reader in self._readers.values():
            reader.true = b""
        if not moving:
            return
        self._refused.clear()
        self._names.clear()
        for reader in self._of_the_test():
            if reader.subscription is None or reader.count(self._node) > 1:
                continue  # none is heard from outside; or who is right can't be told
            found = self._known(reader)
            if len(found) > 1:  # one of them is known and has not arrived
                own = bare(reader.topic.publisher)
                found = {gid: name for gid, name in found.items() if bare(name) == own}
            if len(found) == 1:
                (reader.true,) = found

    def is_stranger(self, name: str, gid: bytes) -> bool:
        """Tell whether a message's sender is not the test's, and count it if so."""
        true = self._readers[name].true
        if not true or gid == true:
            return False
        self._refused[name, gid] = self._refused.get((name, gid), 0) + 1
        return True

    def conflict(self) -> str:
        """Say which topic of the test more than one node publishes; empty if none.

        One of them is not of this test, and whose messages count would be chance.
        """
        for reader in self._of_the_test():
            if (count := reader.count(self._node)) > 1:
                names = ", ".join(sorted(self._known(reader).values()))
                return f"{count} nodes publish {reader.topic.name} ({names})"
        return ""

    def look(self) -> list[str]:
        """Look for strangers in a test that runs; tell of the new ones."""
        news = []
        for reader in self._of_the_test():
            name, true = reader.topic.name, reader.true
            if not true:
                continue
            unnamed = any(key not in self._names for key in self._refused if key[0] == name)
            if not unnamed and reader.count(self._node) < 2 + self._strangers_on(name):
                continue
            for gid, node in self._known(reader).items():
                if gid != true and (name, gid) not in self._names and NAMELESS not in node:
                    self._names[name, gid] = node
                    self._refused.setdefault((name, gid), 0)
                    news.append(f"{node} publishes {name}, too: it is not heard in this test")
        return news

    def strangers(self) -> str:
        """Tell who else has published in this test, on what, and how many messages were refused."""
        told = [
            f"{self._names.get((name, gid), UNNAMED)} on {name}: {count}"
            for (name, gid), count in self._refused.items()
        ]
        return "; ".join(told)

    def _strangers_on(self, name: str) -> int:
        return sum(key[0] == name for key in self._names)

    def _of_the_test(self) -> list[_Reader]:
        return [
            reader
            for reader in self._readers.values()
            if isinstance(reader.topic, LoopTopic) or reader.topic == EXPERIMENT_STATE
        ]

    def _known(self, reader: _Reader) -> dict[bytes, str]:
        """Give identifier and full name of each node that publishes a topic, as far as is known."""
        infos = self._node.get_publishers_info_by_topic(reader.full_name)
        return {
            bytes(info.endpoint_gid): f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in infos
        }
