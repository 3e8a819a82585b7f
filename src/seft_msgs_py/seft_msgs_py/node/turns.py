"""What the nodes of one process do between waits: messages, polls, chores, faults.

The main thread waits for the loop's messages and handles them. A second thread serves requests (for
parameters, and to the supervisor) and sleeps otherwise. Usually a process has one node; several
in one process pass their messages to each other directly (`IntraProcessBus`).
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from traceback import format_exception
from typing import Any

import numpy as np

from seft_msgs_py.errors import SeftError, WireError
from seft_msgs_py.node.transport import MACHINE, Clock, MakeTransport, Send, Subscription, WaitSet
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


OUTSIDE_PERIOD = 0.002  # s between polls for outside messages while there are messages inside
CHORE_PERIOD = 0.01  # s between chores, after messages were handled
IDLE_CHORE_PERIOD = 0.05  # s, without messages: a wait may have ended because a sample is due
MAX_AT_ONCE = 4096  # messages of a topic, as many as the longest queue holds
MAX_IN_A_TURN = 512  # of a topic that does not end waiting: a late node still sends its status
MAX_REFUSED = 200  # a few ms of invalid messages
LOG_PERIOD = 1.0  # s between two logged faults; all are counted

ReadOne = Callable[[], bool | None]
"""Handles one message and returns whether it was acted upon; None if there is none."""


class NodeProcess:
    """Waits for the messages of the named nodes, made with a command line (``--ros-args``).

    Attributes
    ----------
    bus : IntraProcessBus
        Messages between its nodes.
    stopping : bool
        Set by SIGINT, SIGTERM and SIGHUP.
    faults : int
        Unexpected exceptions of the nodes' program.
    fault_listeners : list of callable
        Called, in the main thread, with the reason of each fault.
    polls : list of callable
        Called after each turn, when all due messages have been answered.
    chores : list of callable
        Called after some turns; nothing may wait for them.
    stood_still : float
        Longest time beyond its waits that the process was away between turns, since the last
        chores, s: it, or its host, was stopped or overloaded, or its program takes long.

    Raises
    ------
    InputError
        If ROS arguments are not understood.
    """

    def __init__(
        self, argv: Sequence[str], nodes: Collection[str], make_transport: MakeTransport
    ) -> None:
        self.stopping = False
        self.faults = 0
        self._new_faults: deque[str] = deque()
        self._fault_logged_at = -LOG_PERIOD
        self.fault_listeners: list[Callable[[str], None]] = []
        self.transport = make_transport(argv, self.stop)
        self.clock = self.transport.clock
        self.bus = IntraProcessBus(nodes, self.clock)
        self._waking: dict[Subscription, ReadOne] = {}
        self._quiet: list[ReadOne] = []
        self.polls: list[Callable[[], None]] = []
        self.chores: list[Callable[[], None]] = []
        self._wait_set: WaitSet | None = None
        self._polled_outside_at = self._chores_at = self.stood_still = 0.0
        self._turned_at = self.clock.elapsed()

    def stop(self, *_: object) -> None:
        """End soon."""
        self.stopping = True

    def add_subscription(self, subscription: Subscription, receive: Receive, wake: bool) -> ReadOne:
        """Give the messages of a subscription to ``receive``.

        With ``wake`` a message ends the waiting; otherwise it is handled when no other has ended
        it.
        """
        take = subscription.take

        def read_one() -> bool | None:
            taken = take()
            return None if taken is None else receive(*taken)

        if wake:
            self._waking[subscription] = read_one
            self._wait_set = self.transport.wait_set(list(self._waking))
        else:
            self._quiet.append(read_one)
        return read_one

    def attempt(self, what: str, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function; an unexpected exception is a fault, after which the process continues.

        If the process ended, a test would lose its node; without the supervisor the operator could
        not abort the test. A `SeftError`, which is for the user, is raised.
        """
        try:
            return call(*arguments)
        except Exception as error:
            if isinstance(error, SeftError) and not isinstance(error, WireError):
                raise
            self.fault(what, error)
            return None

    def fault(self, what: str, error: Exception) -> str:
        """Count and log a fault; listeners are called in this turn or the next. Give its reason.

        May be called from any thread.
        """
        reason = f"a fault of the program in {what}: {type(error).__name__}: {error}"
        reason = " ".join(reason.splitlines())
        self.faults += 1
        self._new_faults.append(reason)
        self._log(reason, error)
        return reason

    def _log(self, reason: str, error: Exception) -> None:
        if (now := self.clock.monotonic()) - self._fault_logged_at >= LOG_PERIOD:
            self._fault_logged_at = now
            trace = "".join(format_exception(error))
            self.transport.log(f"{reason} ({self.faults} so far)\n{trace}")

    def start(self) -> None:
        """Begin to serve: all slow preparations are done."""
        np.seterr(over="ignore", invalid="ignore")  # the limits find values that are not finite
        self.transport.start(self._service_failed)

    def spin_once(self, timeout: float) -> bool:
        """Wait at most ``timeout`` seconds for messages, and handle them.

        From topics that end the waiting it takes one message, and the refused ones before it; the
        next call takes the remainder. Returns whether such a message was handled.
        """
        handled = bool(self.attempt("the turn", self._take_turn, timeout))
        before, self._turned_at = self._turned_at, self.clock.elapsed()
        self.stood_still = max(self.stood_still, self._turned_at - before - timeout)
        for poll in self.polls:
            self.attempt("a poll", poll)
        pause = CHORE_PERIOD if handled else IDLE_CHORE_PERIOD
        if (now := self.clock.monotonic()) - self._chores_at >= pause:
            self._chores_at = now
            for chore in self.chores:
                self.attempt("a chore", chore)
            self.stood_still = 0.0
        while self._new_faults:
            reason = self._new_faults.popleft()
            for listener in self.fault_listeners:
                try:
                    listener(reason)
                except Exception as error:  # a listener's own fault is not reported to listeners
                    self.faults += 1
                    self._log(f"{reason}; it could not be reported", error)
        return handled

    def _take_turn(self, timeout: float) -> bool:
        handled = self.bus.deliver()
        if not handled or self.clock.monotonic() - self._polled_outside_at > OUTSIDE_PERIOD:
            handled |= self._poll_outside(0.0 if handled else timeout)
        if not handled:
            for read_one in self._quiet:
                drain(read_one, MAX_IN_A_TURN)
            self.bus.deliver()
        return handled

    def _poll_outside(self, timeout: float) -> bool:
        if self._wait_set is None:
            self.clock.sleep(timeout)
            return False
        handled = False
        # a wait of no time takes longer than a poll of all
        ready: Iterable[Subscription] = self._waking
        if timeout > 0.0:
            ready = self._wait_set.wait(timeout)
        for subscription in ready:
            read_one = self._waking[subscription]
            for _ in range(MAX_REFUSED):  # a flood must not delay the valid messages
                acted = read_one()
                handled |= acted is not None
                if acted is not False:
                    break
        handled |= self.bus.deliver()
        self._polled_outside_at = self.clock.monotonic()
        return handled

    def close(self, status: int = 0) -> None:
        """Take the nodes off the graph."""
        self.stopping = True
        self.bus.send_outside()
        self.transport.close(status)

    def _service_failed(self, error: Exception) -> None:
        if isinstance(error, WireError):
            self._log(str(error), error)
        else:
            self.fault("a service", error)


def drain(read_one: ReadOne, most: int = MAX_AT_ONCE) -> None:
    """Handle the messages that have arrived, at most ``most``; the default is the longest queue."""
    for _ in range(most):
        if read_one() is None:
            return
