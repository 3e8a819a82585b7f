"""The graph in memory and in virtual time, with what nodes notice of DDS.

Raw bytes, keep-last queues that drop the oldest, latched topics, best-effort readers that lose
messages, publishers' identifiers, discovery that takes time, nodes that leave at once or when their
lease expires. Not modelled: fragments, acknowledgements, and a service thread beside the node's
main one (a request is answered in the caller's turn).
"""

import struct
from collections import defaultdict, deque
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple

from seft_msgs_py.config.parameter_table import Section, Table, Value
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.transport import Answer, Clock, Host, Level, Send, Take, check_live
from seft_msgs_py.virtual.scheduler import Scheduler, Task, VirtualClock, ns
from seft_msgs_py.wire.topics import NANOSECONDS_PER_SECOND, Timebase, Topic

LEASE = 20.0  # s after which others miss a node that was killed
STAMP_END = 12
"""Bytes of a message until the end of its stamp, if it begins with one."""


class Sent(NamedTuple):
    """A message that was sent: when (ns), by which node, on which topic, its bytes."""

    at_ns: int
    node: str
    topic: str
    raw: bytes


class Line(NamedTuple):
    """A line of a node's log."""

    at_ns: int
    node: str
    level: Level
    text: str


@dataclass(frozen=True)
class Rule:
    """What happens to some messages on their way.

    Attributes
    ----------
    topic : str
        Without the first slash.
    steps : container of int or None
        Steps that their stamps have; None: all.
    delay : float or None
        Additional time, s; None: they are lost on their way to readers without resending.
    reader : str or None
        Node to which they go; None: all.
    """

    topic: str
    steps: Container[int] | None
    delay: float | None
    reader: str | None = None

    def concerns(self, topic: str, step: int, reader: str) -> bool:
        """Say whether it concerns a message."""
        is_of_step = self.steps is None or step in self.steps
        return topic == self.topic and is_of_step and self.reader in (None, reader)


class MemoryGraph:
    """All endpoints of a test, and all that was sent and logged.

    Attributes
    ----------
    sent : list of Sent
        Every message.
    lines : list of Line
        Every line of the nodes' logs.
    rules : list of Rule
        What happens to messages from now on.
    """

    def __init__(
        self, scheduler: Scheduler, timebase: Timebase, latency: float, discovery: float
    ) -> None:
        self.scheduler, self.clock = scheduler, VirtualClock(scheduler)
        self._timebase, self._latency_ns = timebase, round(latency * 1e9)
        self._discovery_ns = round(discovery * 1e9)
        self.publishers: dict[str, list[MemoryPublisher]] = defaultdict(list)
        self.subscriptions: dict[str, list[MemorySubscription]] = defaultdict(list)
        self.services: dict[str, tuple[MemoryEndpoint, Answer]] = {}
        self.sent: list[Sent] = []
        self.lines: list[Line] = []
        self.rules: list[Rule] = []
        self._endpoints = 0

    def identifier(self) -> bytes:
        """Make the identifier of a publisher."""
        self._endpoints += 1
        return self._endpoints.to_bytes(16, "big")

    def add_publisher(self, publisher: "MemoryPublisher") -> None:
        """Make a publisher known."""
        self.publishers[publisher.topic_name].append(publisher)
        for reader in self.subscriptions[publisher.topic_name]:
            self._discover(publisher, reader)

    def add_subscription(self, reader: "MemorySubscription") -> None:
        """Make a subscription known."""
        self.subscriptions[reader.topic_name].append(reader)
        for publisher in self.publishers[reader.topic_name]:
            self._discover(publisher, reader)

    def send(self, publisher: "MemoryPublisher", raw: bytes) -> None:
        """Send a message to all readers that are connected."""
        if publisher.endpoint.is_dead:
            return
        raw, topic = bytes(raw), publisher.topic_name.lstrip("/")
        self.sent.append(Sent(self.scheduler.now, publisher.endpoint.path, topic, raw))
        publisher.history.append(raw)
        for reader in publisher.readers:
            if (delay_ns := self._delay_ns(topic, raw, reader)) is not None:
                self.scheduler.after(delay_ns, partial(reader.deliver, raw, publisher.identifier))

    def remove(self, endpoint: "MemoryEndpoint") -> None:
        """Take a node off the graph."""
        for publishers in self.publishers.values():
            publishers[:] = [each for each in publishers if each.endpoint is not endpoint]
            for publisher in publishers:
                publisher.readers = [r for r in publisher.readers if r.endpoint is not endpoint]
        for readers in self.subscriptions.values():
            readers[:] = [each for each in readers if each.endpoint is not endpoint]
        for service in [name for name, (node, _) in self.services.items() if node is endpoint]:
            del self.services[service]

    def _discover(self, publisher: "MemoryPublisher", reader: "MemorySubscription") -> None:
        def connect() -> None:
            if reader.endpoint.is_gone or publisher.endpoint.is_gone:
                return
            publisher.readers.append(reader)
            for raw in publisher.history:
                reader.deliver(raw, publisher.identifier)

        self.scheduler.after(self._discovery_ns, connect)

    def _delay_ns(self, topic: str, raw: bytes, reader: "MemorySubscription") -> int | None:
        delay_ns = self._latency_ns
        if self.rules and len(raw) >= STAMP_END:
            seconds, nanoseconds = struct.unpack_from("<iI", raw, STAMP_END - 8)
            step, _ = self._timebase.nearest(seconds * NANOSECONDS_PER_SECOND + nanoseconds)
            for rule in self.rules:
                if rule.concerns(topic, step, reader.endpoint.path):
                    if rule.delay is not None:
                        delay_ns += ns(rule.delay)
                    elif not reader.reliable:
                        return None
        return delay_ns


class MemoryPublisher:
    """See `seft_msgs_py.node.transport.Publisher`."""

    def __init__(self, endpoint: "MemoryEndpoint", topic: Topic) -> None:
        self.endpoint, self.topic_name = endpoint, endpoint.full_name(topic.name)
        self.identifier = endpoint.graph.identifier()
        self.history: deque[bytes] = deque(maxlen=topic.depth if topic.latched else 0)
        self.readers: list[MemorySubscription] = []
        self.send: Send = partial(endpoint.graph.send, self)
        endpoint.graph.add_publisher(self)

    def listener_count(self) -> int:
        """Count the subscriptions that are connected."""
        return len(self.readers)


class MemorySubscription:
    """See `seft_msgs_py.node.transport.Subscription`."""

    def __init__(
        self, endpoint: "MemoryEndpoint", topic: Topic, depth: int | None, reliable: bool
    ) -> None:
        self.endpoint, self.topic_name = endpoint, endpoint.full_name(topic.name)
        self.reliable = reliable
        self.queue: deque[tuple[bytes, int, bytes]] = deque(maxlen=depth or topic.depth)
        self.waiting: Task | None = None
        self.take: Take = self._take
        endpoint.graph.add_subscription(self)

    def deliver(self, raw: bytes, identifier: bytes) -> None:
        """Put a message into the queue, and wake the task that waits for it."""
        if self.endpoint.is_dead:
            return
        graph = self.endpoint.graph
        self.queue.append((raw, graph.clock.time_ns(), identifier))
        if self.waiting is not None:
            graph.scheduler.wake(self.waiting)

    def publisher_count(self) -> int:
        """Count the publishers that are connected."""
        publishers = self.endpoint.graph.publishers[self.topic_name]
        return sum(self in publisher.readers for publisher in publishers)

    def _take(self) -> tuple[bytes, int, bytes] | None:
        if not self.queue:
            return None
        taken = self.queue.popleft()
        if self.endpoint.breaks_next:
            self.endpoint.breaks_next = False
            raise KeyError(self.topic_name)
        return taken


class MemoryEndpoint:
    """A node in memory; see `seft_msgs_py.node.transport.Endpoint`.

    Attributes
    ----------
    path : str
        Full name without the first slash.
    is_dead : bool
        It neither sends nor receives.
    is_gone : bool
        The others know that.
    breaks_next : bool
        The next message that it takes meets a fault of the program.
    """

    def __init__(self, graph: MemoryGraph, name: str, namespace: str = "") -> None:
        self.graph, self.name, self.namespace = graph, name, namespace
        self.path = f"{namespace}/{name}"[1:]
        self.is_dead = self.is_gone = self.breaks_next = False
        self._parameters: tuple[Table, Section, Callable[[], None]] | None = None

    def full_name(self, topic_name: str) -> str:
        """Full name of a topic of this node."""
        return topic_name if topic_name.startswith("/") else f"{self.namespace}/{topic_name}"

    def publish(self, topic: Topic) -> MemoryPublisher:
        """Begin to publish a topic."""
        return MemoryPublisher(self, topic)

    def subscribe(
        self, topic: Topic, depth: int | None = None, reliable: bool = True
    ) -> MemorySubscription:
        """Subscribe to a topic; with another depth than its own, or without resending."""
        return MemorySubscription(self, topic, depth, reliable)

    def serve(self, service: str, answer: Answer) -> None:
        """Answer requests, in the caller's turn."""
        self.graph.services[self.full_name(service)] = self, answer

    def parameters(self, table: Table, section: Section, changed: Callable[[], None]) -> None:
        """Let others read the parameters of a section, and set the live ones."""
        self._parameters = table, section, changed

    def set_parameter(self, name: str, value: Value) -> None:
        """Set a live parameter, as ``ros2 param set`` does.

        Raises
        ------
        InputError
            If the node refuses.
        """
        assert self._parameters is not None
        table, section, changed = self._parameters
        checked = check_live(self.name, table, {name: value})
        if not table.rows[name].live:
            raise InputError(f"{self.name}: {name} is read-only while the node runs")
        section.update(checked)
        changed()

    def log(self, level: Level, text: str) -> None:
        """Log a line."""
        self.graph.lines.append(Line(self.graph.scheduler.now, self.path, level, text))

    def publishers(self, topic_name: str) -> dict[bytes, str]:
        """Give identifier and full name of each node known to publish a topic, by its full name."""
        found = self.graph.publishers[topic_name]
        return {each.identifier: f"/{each.endpoint.path}" for each in found}

    def publisher_count(self, topic_name: str) -> int:
        """Count the publishers of a topic, by its full name."""
        return len(self.graph.publishers[topic_name])

    def listeners(self, topic_name: str) -> list[str]:
        """Full names of the nodes known to read a topic, by its full name."""
        return [f"/{each.endpoint.path}" for each in self.graph.subscriptions[topic_name]]


class MemoryWaitSet:
    """See `seft_msgs_py.node.transport.WaitSet`."""

    def __init__(self, clock: VirtualClock, subscriptions: Sequence[MemorySubscription]) -> None:
        self._clock, self._subscriptions = clock, subscriptions

    def wait(self, timeout: float) -> list[MemorySubscription]:
        """Wait at most ``timeout`` seconds; return the subscriptions that have messages."""
        if timeout > 0.0 and not any(each.queue for each in self._subscriptions):
            self._clock.wait(timeout)
        return [each for each in self._subscriptions if each.queue]


class MemoryTransport:
    """The nodes of one task; see `seft_msgs_py.node.transport.Transport`."""

    def __init__(self, graph: MemoryGraph, stop: Callable[..., None], namespace: str = "") -> None:
        self.clock: Clock = graph.clock
        # a host that grants nothing, and denies nothing
        self.host: Host = SimpleNamespace(apply=lambda _: [], granted=dict, memory_kb=lambda _: 0)
        self.stop = stop
        self.endpoints: list[MemoryEndpoint] = []
        self._graph, self._namespace = graph, namespace

    def join(self, name: str, section: Section) -> MemoryEndpoint:
        """Put a node on the graph."""
        del section
        self.endpoints.append(MemoryEndpoint(self._graph, name, self._namespace))
        return self.endpoints[-1]

    def wait_set(self, subscriptions: Sequence[MemorySubscription]) -> MemoryWaitSet:
        """Make what waits for some subscriptions, in the current task."""
        for each in subscriptions:
            each.waiting = self._graph.scheduler.current
        return MemoryWaitSet(self._graph.clock, subscriptions)

    def log(self, text: str) -> None:
        """Log an error of the process."""
        self.endpoints[0].log("error", text)

    def start(self, failed: Callable[[Exception], None]) -> None:
        """Begin to serve: requests are answered in the caller's turn, who gets the exceptions."""

    def close(self, status: int = 0) -> None:
        """Take the nodes off the graph."""
        del status
        for endpoint in self.endpoints:
            endpoint.is_dead = True
            self._leave(endpoint)

    def kill(self) -> None:
        """Fall silent; others see the nodes until their lease expires."""
        for endpoint in self.endpoints:
            endpoint.is_dead = True
            self._graph.scheduler.after(ns(LEASE), partial(self._leave, endpoint))

    def _leave(self, endpoint: MemoryEndpoint) -> None:
        endpoint.is_gone = True
        self._graph.remove(endpoint)
