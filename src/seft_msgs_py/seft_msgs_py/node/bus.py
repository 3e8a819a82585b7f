"""Messages of the loop between the nodes of one process."""

from collections import deque
from collections.abc import Callable, Collection

from seft_msgs_py.node.clock import MACHINE, Clock
from seft_msgs_py.node.transport import Send
from seft_msgs_py.wire.topics import LoopTopic, Topic, bare

Receive = Callable[[bytes, int, bytes], bool]
"""Takes a message's bytes, the wall-clock time in ns of its arrival, and the identifier of its
publisher (empty: a node of this process); returns whether it was acted upon."""


class IntraProcessBus:
    """Messages of the loop between the named nodes of one process, in the order of sending.

    Messages go to other processes after all messages inside, and their answers, are delivered:
    sending takes longer than a node's answer, and is faster if several are sent in a row.
    """

    def __init__(self, nodes: Collection[str], clock: Clock = MACHINE) -> None:
        self._nodes, self._clock = frozenset(nodes), clock
        self._listeners: dict[str, list[tuple[str, Receive]]] = {}
        self._posted: deque[tuple[str, bytes]] = deque()
        self._outward: deque[tuple[Send, bytes]] = deque()

    def serves(self, topic: Topic) -> bool:
        """Whether the topic's messages come from a node of this process."""
        # with several rigs, a process holds nodes of one of them
        return isinstance(topic, LoopTopic) and bare(topic.publisher) in self._nodes

    def subscribe(self, name: str, node: str, receive: Receive) -> None:
        """Deliver every message of the topic of this full name to ``receive``."""
        self._listeners.setdefault(name, []).append((node, receive))

    def listeners(self, name: str) -> list[str]:
        """Nodes of this process that listen to a topic, by its full name."""
        return [node for node, _ in self._listeners.get(name, [])]

    def sender(self, name: str, send: Send) -> Send:
        """Make the function that sends to the listeners here, and to others by ``send``."""
        post, put_out = self._posted.append, self._outward.append

        def send_to_all(raw: bytes) -> None:
            if name in self._listeners:
                post((name, raw))
                put_out((send, raw))
            else:
                send(raw)

        return send_to_all

    def deliver(self) -> bool:
        """Deliver all messages, also those sent meanwhile; return whether there was any."""
        posted = self._posted
        if not posted:
            return False
        try:
            while posted:
                name, raw = posted.popleft()
                for _, receive in self._listeners[name]:
                    receive(raw, self._clock.time_ns(), b"")
        finally:
            self.send_outside()
        return True

    def send_outside(self) -> None:
        """Send the waiting messages to other processes."""
        while self._outward:
            send, raw = self._outward.popleft()
            send(raw)
