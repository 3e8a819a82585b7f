"""What nodes need of the graph and of their host, whoever provides it: `dds`, or `virtual`.

A node joins the graph and has an `Endpoint` there, with raw publishers and subscriptions: messages
are bytes. All nodes of a process share a `Transport`.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

from seft_msgs_py.config.parameter_table import Section, Table
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Topic

LONGEST_GAP = 0.25  # s


class Clock(Protocol):
    """Time as a node sees it."""

    def monotonic(self) -> float:
        """Time since some moment, s."""

    def elapsed(self) -> float:
        """Time that also runs while the process is stopped or its machine sleeps, s."""

    def time_ns(self) -> int:
        """Wall-clock time in ns, for labels, and for the common start of several hosts."""

    def sleep(self, seconds: float) -> None:
        """Wait."""


class MachineClock:
    """The `Clock` of this machine."""

    monotonic = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)
    sleep = staticmethod(time.sleep)

    @staticmethod
    def elapsed() -> float:
        """Time that also runs while the process is stopped or its machine sleeps, s."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)


MACHINE = MachineClock()


class AwakeClock:
    """Monotonic time in which a gap between two polls counts as at most ``longest_gap`` seconds.

    A process that stalls, usually with its whole machine, reads the messages of that time only
    later: it must not mistake its own stall for the silence of others. Poll the clock often.
    """

    def __init__(
        self, monotonic: Callable[[], float] = MACHINE.monotonic, longest_gap: float = LONGEST_GAP
    ) -> None:
        self._monotonic, self._longest_gap = monotonic, longest_gap
        self._polled_at = monotonic()
        self._now = 0.0

    def time(self) -> float:
        """Time awake since the clock was made, s."""
        now = self._monotonic()
        self._now += min(now - self._polled_at, self._longest_gap)
        self._polled_at = now
        return self._now


Level = Literal["info", "warning", "error"]
Send = Callable[[bytes], None]
Take = Callable[[], tuple[bytes, int, bytes] | None]
"""Takes the oldest message: its bytes, the wall-clock time in ns of its arrival, and the identifier
of its publisher; None if there is none."""
Answer = Callable[[], tuple[bool, str]]
"""Acts on a request; returns whether it was accepted, and a text."""


class Publisher(Protocol):
    """Sends the messages of one topic."""

    topic_name: str
    """Full name."""
    send: Send
    """A function and no method: the loop calls it for each sample."""

    def listener_count(self) -> int:
        """Count the subscriptions that are connected."""


class Subscription(Protocol):
    """Keeps the messages of one topic until they are taken."""

    topic_name: str
    """Full name."""
    take: Take

    def publisher_count(self) -> int:
        """Count the publishers that are connected."""


class WaitSet(Protocol):
    """Waits for the messages of some subscriptions."""

    def wait(self, timeout: float) -> Sequence[Subscription]:
        """Wait at most ``timeout`` seconds; return the subscriptions that have messages."""


class Endpoint(Protocol):
    """One node on the graph.

    Attributes
    ----------
    name : str
        Of the node, without its namespace.
    namespace : str
        Without a slash at its end; empty: none.
    """

    name: str
    namespace: str

    def full_name(self, topic_name: str) -> str:
        """Full name of a topic of this node."""

    def publish(self, topic: Topic) -> Publisher:
        """Begin to publish a topic."""

    def subscribe(
        self, topic: Topic, depth: int | None = None, reliable: bool = True
    ) -> Subscription:
        """Subscribe to a topic; with another depth than its own, or without resending."""

    def serve(self, service: str, answer: Answer) -> None:
        """Answer requests (std_srvs/Trigger), perhaps in another thread."""

    def parameters(self, table: Table, section: Section, changed: Callable[[], None]) -> None:
        """Let others read the parameters of a section, and set the live ones.

        The section is changed when one is set, and ``changed`` is called then.
        """

    def log(self, level: Level, text: str) -> None:
        """Log a line."""

    def publishers(self, topic_name: str) -> dict[bytes, str]:
        """Give identifier and full name of each node known to publish a topic, by its full name."""

    def publisher_count(self, topic_name: str) -> int:
        """Count the publishers of a topic, by its full name."""

    def listeners(self, topic_name: str) -> list[str]:
        """Full names of the nodes known to read a topic, by its full name."""


class Host(Protocol):
    """The machine as far as a process may ask it for priority; see `seft_msgs_py.node.host`."""

    def apply(self, section: Mapping[str, Any]) -> list[str]:
        """Apply the realtime parameters of a node's section; return what was denied."""

    def granted(self) -> dict[str, Any]:
        """Give what this process has; JSON values."""

    def memory_kb(self, kind: str) -> int:
        """Memory of this process, kB."""


class Transport(Protocol):
    """The graph, the clock and the host of the nodes of one process."""

    clock: Clock
    host: Host

    def join(self, name: str, section: Section) -> Endpoint:
        """Put a node with its parameters on the graph.

        Raises
        ------
        InputError
            If another process of this host has its name.
        """

    def wait_set(self, subscriptions: Sequence[Any]) -> WaitSet:
        """Make what waits for some subscriptions of this transport."""

    def log(self, text: str) -> None:
        """Log an error of the process."""

    def start(self, failed: Callable[[Exception], None]) -> None:
        """Begin to serve requests; ``failed`` gets their exceptions."""

    def close(self, status: int) -> None:
        """Take the nodes off the graph; if that hangs, end the process with this exit status."""


MakeTransport = Callable[[Sequence[str], Callable[..., None]], Transport]
"""Makes a transport by a command line, and what is called when the process must end."""


def check_live(node: str, table: Table, wanted: Section) -> Section:
    """Check values that somebody sets while a node runs; give them in their parameters' types.

    Raises
    ------
    InputError
        If a name is not the node's, or a value is invalid.
    """
    for name in wanted:
        if name not in table.rows:  # rclpy's own, such as use_sim_time
            raise InputError(f"{node}: {name!r} can't be set")
    return {name: table.rows[name].check(value, node) for name, value in wanted.items()}
