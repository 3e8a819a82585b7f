"""What every node of a test is made of: parameters, raw topics, status, a clean end.

The main thread waits for the loop's messages and handles them, and in the pause after that
tells the node's status. Services (of parameters, of the supervisor) are served by a second
thread, which sleeps while nobody calls.
"""

import gc
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from seft_msgs_py.claim import claim
from seft_msgs_py.ending import ending_within
from seft_msgs_py.errors import InputError, SeftError, WireError
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.messages import Status, encode_diagnostics, encode_string, restamp
from seft_msgs_py.parameter_file import split_ros_arguments
from seft_msgs_py.parameters import Table
from seft_msgs_py.ros_types import message_class, parameter_descriptor, qos_profile
from seft_msgs_py.topics import DESCRIPTION, DIAGNOSTICS, LOOP_TOPICS, LoopTopic, Topic
from seft_msgs_py.wait_set import LoopCallbackGroup, WaitSet, sender, take

IDLE_WAIT = 0.05  # s; a signal is noticed within this time
STATUS_PERIOD = 0.2  # s: a sign of life
LOOP_PAUSE = 1.0  # s without a message of the loop: the node is idle
WARN_PERIOD = 1.0  # s
CLOSE_PATIENCE = 5.0  # s
MOST_AT_ONCE = 4096  # messages of a topic, as many as the longest queue holds
MOST_REFUSED = 200  # a few ms of nonsense
WARM_UP_STEPS = 200
"""Steps a node of the loop tries on itself, so that its first real ones are not its slowest."""
_LOOP_NAMES = {topic.name for topic in LOOP_TOPICS}

Handler = Callable[[bytes, int], None]


class NodeShell:
    """A node with its checked parameters.

    Parameters
    ----------
    table : Table
        The node's own parameters.
    tables : iterable of Table
        All tables that are known here, for parameters that are taken from other nodes.
    argv : sequence of str
        Command line, with ``--ros-args``.

    Attributes
    ----------
    experiment : Experiment
        This node's section of what the command line and its parameter files say.
    node : rclpy.node.Node
        The node itself.
    stopping : bool
        Set by SIGINT and SIGTERM.
    """

    def __init__(self, table: Table, tables: Iterable[Table], argv: Sequence[str]) -> None:
        files, overrides = split_ros_arguments(argv)
        self.name = table.node
        self.experiment = Experiment.load(tables, files, overrides, nodes=[self.name])
        self.stopping = False
        self.refused = 0
        self._warning = ""  # the first reason since the last warning
        self._warned_at = -WARN_PERIOD
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        try:
            rclpy.init(
                args=_without_parameters(argv), signal_handler_options=SignalHandlerOptions.NO
            )
        except Exception as error:  # rclpy has several kinds, most of them private
            raise InputError(
                f"ROS arguments not understood: {str(error).splitlines()[0]}"
            ) from None
        section = self.experiment[self.name]
        self.node = Node(
            self.name,
            parameter_overrides=[RosParameter(name, value=v) for name, v in section.items()],
        )
        self._claim = claim(self.node.context.get_domain_id(), self.node.get_fully_qualified_name())
        for row in table.rows.values():
            self.node.declare_parameter(row.name, section[row.name], parameter_descriptor(row))
        self._group = LoopCallbackGroup()
        self._handlers: dict[Subscription, Handler] = {}
        self._quiet: dict[Subscription, Handler] = {}
        self._publishers: dict[str, Publisher] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._numbers: dict[Subscription, int] = {}
        """How many messages the publisher of a topic that has one in each step had sent with the
        last that was acted upon. One that joins later has sent fewer."""
        self._wait_set: WaitSet | None = None
        self._handled_at = 0.0  # s, monotonic: the last message of the loop
        self._looked_at = 0.0
        self._status = Status(self.name, 0, "starting", values={})
        self._status_sent: tuple[float, Status | None] = (0.0, None)
        self._status_message = bytearray()
        self._diagnostics = self.publisher(DIAGNOSTICS)
        self._description = self.publisher(DESCRIPTION)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin_executor, daemon=True)

    def publisher(self, topic: Topic) -> Callable[[bytes], None]:
        """Make the publisher of a topic; give the function that publishes message bytes."""
        publisher = self.node.create_publisher(message_class(topic), topic.name, qos_profile(topic))
        self._publishers[topic.name] = publisher
        return sender(publisher)

    def subscribe(
        self,
        topic: Topic,
        handler: Handler,
        depth: int | None = None,
        wake: bool = True,
        reliable: bool = True,
    ) -> None:
        """Hand every message of a topic to ``handler`` as bytes, in the main thread.

        Parameters
        ----------
        topic : Topic
            What to listen to.
        handler : callable
            Takes the message's bytes and the wall-clock time in ns at which it came in. A
            `WireError` it raises is counted and warned of.
        depth : int, optional
            Messages kept while the node is busy; default the topic's.
        wake : bool
            Whether a message ends the waiting; else it is handled when the node is up.
        reliable : bool
            Whether a lost message is sent again. To the loop it would come too late, and the
            acknowledging costs a tenth of a step.
        """
        subscription = self.node.create_subscription(
            message_class(topic),
            topic.name,
            lambda _: None,
            qos_profile(topic, depth, reliable),
            callback_group=self._group,
            raw=True,
        )
        self._subscriptions[topic.name] = subscription
        if isinstance(topic, LoopTopic) and not topic.latched:
            self._numbers[subscription] = 0
        if wake and isinstance(topic, LoopTopic):
            handler = self._noting_the_time(handler)
        if wake:
            self._handlers[subscription] = handler
            self._wait_set = WaitSet(self.node, list(self._handlers))
        else:
            self._quiet[subscription] = handler

    def start(self, facts: dict[str, Any] | None = None) -> None:
        """Describe the node to the test and begin to serve parameters and status.

        Parameters
        ----------
        facts : dict, optional
            What else others must know of this node, JSON values.
        """
        parameters = self.experiment[self.name]
        description = {"node": self.name, "parameters": parameters, **(facts or {})}
        self._description(encode_string(json.dumps(description)))
        np.seterr(over="ignore", invalid="ignore")  # the limits see what is not finite
        sys.setswitchinterval(2e-4)  # the second thread gives way to the loop at once
        gc.collect()
        gc.freeze()
        self._thread.start()

    def spin_once(self, timeout: float = IDLE_WAIT) -> bool:
        """Wait for messages, at most ``timeout`` seconds, and handle those that have come.

        Of topics that end the waiting it takes one message, and what is refused before it; the
        next call finds the rest.

        Returns
        -------
        bool
            Whether such a message was handled.
        """
        handled = False
        if self._wait_set is None:
            time.sleep(timeout)
        else:
            for subscription in self._wait_set.wait(timeout):
                handler = self._handlers[subscription]
                for _ in range(MOST_REFUSED):  # a flood must not hold up what is true
                    if self._handle_one(subscription, handler) is not False:
                        break
                handled = True
        for subscription in self._quiet:
            self._drain(subscription)
        # what was due is answered: the best moment for what can wait
        if handled or time.monotonic() - self._handled_at > STATUS_PERIOD:
            self._look_after_status()
        return handled

    def catch_up(self, topic: Topic) -> None:
        """Handle what has come on a topic that does not end the waiting."""
        self._drain(self._subscriptions[topic.name])

    def _drain(self, subscription: Subscription) -> None:
        handler = self._quiet[subscription]
        for _ in range(MOST_AT_ONCE):
            if self._handle_one(subscription, handler) is None:
                return

    def _noting_the_time(self, handler: Handler) -> Handler:
        def handle(raw: bytes, received_ns: int) -> None:
            self._handled_at = time.monotonic()
            handler(raw, received_ns)

        return handle

    def _handle_one(self, subscription: Subscription, handler: Handler) -> bool | None:
        """Take a message, if there is one; say whether it was not refused."""
        taken = take(subscription)
        if taken is None:
            return None
        raw, received_ns, number = taken
        last = self._numbers.get(subscription, -1)
        try:
            if 0 < number <= last and subscription.get_publisher_count() > 1:
                raise WireError(f"{subscription.topic_name} of a second publisher")
            handler(raw, received_ns)
            if last >= 0:
                self._numbers[subscription] = number
        except WireError as error:
            self.refuse(str(error))
            return False
        return True

    def spin(self, poll: Callable[[], None] | None = None, period: float = IDLE_WAIT) -> None:
        """Handle messages until told to stop, calling ``poll`` at least every ``period`` s."""
        while not self.stopping:
            self.spin_once(period)
            if poll is not None:
                poll()

    def refuse(self, reason: str) -> None:
        """Count a message that was not acted upon; a warning follows, at most once a second.

        The logger takes a millisecond, also where its own throttle lets nothing pass.
        """
        self.refused += 1
        self._warning = self._warning or reason

    def report(self, status: Status) -> None:
        """Make this the node's status, and publish it at once."""
        self._status = replace(status, values={**status.values, **self._own_values()})
        self._publish_status()

    def close(self) -> None:
        """Take the node off the graph."""
        self.stopping = True
        if self._thread.is_alive():  # it must not wait on what is being taken down
            self._executor.wake()
            self._thread.join(timeout=2.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.try_shutdown()

    def matched(self) -> dict[str, str]:
        """Who is connected: names of the nodes that listen to each topic, number of its senders.

        Names are separated by blanks.
        """
        found = {}
        for name, subscription in self._subscriptions.items():
            found[f"senders {name}"] = str(subscription.get_publisher_count())
        for name, publisher in self._publishers.items():
            listeners = {info.node_name for info in self.node.get_subscriptions_info_by_topic(name)}
            if len(listeners) > publisher.get_subscription_count():
                listeners = set()  # some are known but not connected yet
            found[f"matched {name}"] = " ".join(sorted(listeners))
        return found

    def several_senders(self) -> str:
        """Say which topic of the loop more than one node publishes; empty if none.

        One of them is not of this test, and whose messages count would be chance.
        """
        for name, subscription in self._subscriptions.items():
            count = subscription.get_publisher_count()
            if name in _LOOP_NAMES and count > 1:
                return f"{count} nodes publish {name}"
        return ""

    def company(self, refused_before: int) -> str:
        """Say what foreign nodes may have to do with what failed to come, to be put after it.

        Parameters
        ----------
        refused_before : int
            `refused` when the last message came that was waited for.
        """
        refused = self.refused - refused_before
        told = f"; {refused} messages were refused meanwhile" if refused else ""
        conflict = self.several_senders()
        return f"{told}; {conflict}" if conflict else told

    def _look_after_status(self) -> None:
        """Look who listens and what has changed; while the loop turns, only send what is due.

        Asking for the graph takes a millisecond, which only an idle node has.
        """
        now = time.monotonic()
        if self._warning and now - self._warned_at >= WARN_PERIOD:
            self.node.get_logger().warning(f"refused ({self.refused} so far): {self._warning}")
            self._warning, self._warned_at = "", now
        sent_at, sent = self._status_sent
        if now - self._handled_at < LOOP_PAUSE:
            if now - sent_at >= STATUS_PERIOD:
                if self._status.values.get("refused") != str(self.refused):
                    values = {**self._status.values, "refused": str(self.refused)}
                    self._status = replace(self._status, values=values)
                self._publish_status()
            return
        if now - self._looked_at < STATUS_PERIOD:
            return
        self._looked_at = now
        values = {**self._status.values, **self.matched(), **self._own_values()}
        self._status = replace(self._status, values=values)
        if self._status != sent or now - sent_at >= STATUS_PERIOD:
            self._publish_status()

    def _own_values(self) -> dict[str, str]:
        return {"refused": str(self.refused), "peak_memory_mb": str(_peak_memory_mb())}

    def _publish_status(self) -> None:
        now = time.time_ns()
        if self._status != self._status_sent[1]:
            self._status_message = bytearray(encode_diagnostics(now, [self._status]))
        self._status_sent = (time.monotonic(), self._status)
        restamp(self._status_message, now)
        self._diagnostics(bytes(self._status_message))

    def _spin_executor(self) -> None:
        try:
            while not self.stopping and rclpy.ok():
                self._executor.spin_once(timeout_sec=0.5)
        except (ExternalShutdownException, rclpy.executors.ShutdownException):
            return

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.stopping = True


def run_node(table: Table, tables: Iterable[Table], serve: Callable[[NodeShell], None]) -> int:
    """Run a node in this process: the body of its executable.

    Parameters
    ----------
    table, tables : Table, iterable of Table
        As `NodeShell` takes them; the command line is the process's.
    serve : callable
        Makes the node's own object in the shell, starts it and returns when it stops.

    Returns
    -------
    int
        Exit status. A user's error is told in one line on stderr.
    """
    status = 1
    try:
        shell = NodeShell(table, tables, sys.argv)
    except SeftError as error:
        return _tell(table, error)
    try:
        serve(shell)
        status = 0
    except SeftError as error:
        status = _tell(table, error)
    finally:
        with ending_within(CLOSE_PATIENCE, status):
            shell.close()
    return status


def _tell(table: Table, error: SeftError) -> int:
    """Say a user's error in one line; return its exit status."""
    text = str(error)
    told = text if text.startswith(f"{table.node}: ") else f"{table.node}: {text}"
    print(told, file=sys.stderr, flush=True)
    return error.exit_status


def _peak_memory_mb() -> int:
    """Largest resident memory of this process so far; -1 where the system does not tell."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return -1
    kilobytes = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return round(int(kilobytes[0]) / 1024) if kilobytes else -1


def _without_parameters(argv: Sequence[str]) -> list[str]:
    """Command line without what `Experiment.load` has read of it already."""
    kept: list[str] = []
    words = iter(argv)
    for word in words:
        if word in ("--params-file", "-p", "--param"):
            next(words, None)
        else:
            kept.append(word)
    return kept
