"""One node: its checked parameters, its raw topics, its status."""

import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_file import split_ros_arguments
from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.node import realtime
from seft_msgs_py.node.intra_process_bus import Receive
from seft_msgs_py.node.node_process import NodeProcess, drain
from seft_msgs_py.node.ros_types import declare_parameters, message_class, qos_profile
from seft_msgs_py.node.single_instance import claim
from seft_msgs_py.node.wait_set import raw_subscription, sender
from seft_msgs_py.wire.messages import Status, encode_diagnostics, encode_string, restamp
from seft_msgs_py.wire.rigs import RIG_NODES, RigAxes
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS, LoopTopic, Topic

IDLE_WAIT = 0.05  # s; a signal is noticed within this time
STATUS_PERIOD = 0.2  # s: a sign of life
LOOP_PAUSE = 1.0  # s without a message of the loop: the node is idle
WARN_PERIOD = 1.0  # s
WARM_UP_STEPS = 200
"""Steps a node of the loop tries on itself, so that its first real ones are not its slowest."""
Handler = Callable[[bytes, int], None]
"""Takes a message's bytes and the wall-clock time in ns at which it came in."""


class NodeShell:
    """A node with its checked parameters.

    Parameters
    ----------
    process : NodeProcess
        Where it lives.
    table : Table
        The node's own parameters.
    tables : iterable of Table
        All tables that are known here, for parameters that are taken from other nodes.
    argv : sequence of str
        Command line, with ``--ros-args``.

    Attributes
    ----------
    name : str
        The node's name, with its rig's where the test has several.
    experiment : Experiment
        This node's section of what the command line and its parameter files say.
    rig : RigAxes
        The rig that the node belongs to; all axes, where it serves all rigs.
    node : rclpy.node.Node
        The node itself.
    refused : int
        Messages that were not acted upon.
    """

    def __init__(
        self, process: NodeProcess, table: Table, tables: Iterable[Table], argv: Sequence[str]
    ) -> None:
        files, overrides = split_ros_arguments(argv)
        self.experiment = Experiment.load(tables, files, overrides, nodes=[table.node])
        self.refused = 0
        self._warning = ""  # the first reason since the last warning
        self._warned_at = -WARN_PERIOD
        self._process = process
        self._section = section = self.experiment[table.node]
        self.node = Node(
            table.node,
            parameter_overrides=[RosParameter(name, value=v) for name, v in section.items()],
        )
        self.rig, self._test_namespace = _rig_of(self.node, self.experiment)
        self.name = self.rig.node(table.node)
        process.add_node(self.node)
        self._claim = claim(self.node.context.get_domain_id(), self.node.get_fully_qualified_name())
        self._facts: dict[str, Any] | None = None  # none before it has described itself
        declare_parameters(self.node, table, section, self._describe)
        self._publishers: dict[str, Publisher] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._readers: dict[str, Callable[[], bool | None]] = {}
        self._inside: dict[str, str] = {}  # topics that come from this process, and full names
        self._loop_names: set[str] = set()  # of the topics of the loop that it listens to
        self._handled_at = 0.0  # s, monotonic: the last message of the loop
        self._looked_at = 0.0
        self._status = Status(self.name, 0, "starting", values={})
        self._status_sent: tuple[float, Status | None] = (0.0, None)
        self._status_message = bytearray()
        self._diagnostics = self.publisher(DIAGNOSTICS)
        self._description = self.publisher(DESCRIPTION)

    @property
    def stopping(self) -> bool:
        """Whether the process was told to end."""
        return self._process.stopping

    def publisher(self, topic: Topic) -> Callable[[bytes], None]:
        """Make the publisher of a topic; give the function that publishes message bytes."""
        full_name = self._full_name(topic)
        publisher = self.node.create_publisher(message_class(topic), full_name, qos_profile(topic))
        self._publishers[topic.name] = publisher
        if not isinstance(topic, LoopTopic):
            return sender(publisher)
        return self._process.mailbox.sender(publisher.topic_name, sender(publisher))

    def subscribe(
        self,
        topic: Topic,
        handler: Handler,
        depth: int | None = None,
        wake: bool = True,
        reliable: bool = True,
    ) -> Callable[[], bool | None]:
        """Hand every message of a topic to ``handler`` as bytes, in the main thread.

        Parameters
        ----------
        topic : Topic
            What to listen to.
        handler : callable
            A `WireError` it raises is counted and warned of.
        depth : int, optional
            Messages kept while the node is busy; default the topic's.
        wake : bool
            Whether a message ends the waiting; else it is handled when no other has ended it,
            or when it is asked for.
        reliable : bool
            Whether a lost message is sent again. To the loop it would come too late, and the
            acknowledging costs a tenth of a step.

        Returns
        -------
        callable
            Handles one message and tells whether it was acted upon; None if there is none.
        """
        if isinstance(topic, LoopTopic):
            self._loop_names.add(topic.name)
        if self._process.mailbox.serves(topic):
            full_name = self.node.resolve_topic_name(self._full_name(topic))
            receive = self._guarded(handler, topic, None)
            self._process.mailbox.subscribe(full_name, self.name, receive)
            self._inside[topic.name] = full_name
            self._readers[topic.name] = lambda: None  # whatever was sent has been handed over
            return self._readers[topic.name]
        here = replace(topic, name=self._full_name(topic))
        subscription = raw_subscription(self.node, here, depth, reliable)
        self._subscriptions[topic.name] = subscription
        receive = self._guarded(handler, topic, subscription)
        read_one = self._process.add_subscription(subscription, receive, wake)
        self._readers[topic.name] = read_one
        return read_one

    def catch_up(self, topic: Topic) -> None:
        """Handle what has come on a topic."""
        drain(self._readers[topic.name])

    def start(self, facts: dict[str, Any] | None = None) -> None:
        """Describe the node to the test and begin to tell its status.

        Parameters
        ----------
        facts : dict, optional
            What else others must know of this node, JSON values.
        """
        parameters = self._section
        self._facts = dict(facts or {})
        if "thread_priority" in parameters:
            for denied in realtime.apply(parameters):
                self.node.get_logger().warning(denied)
            self._facts["realtime"] = realtime.granted()
        self._describe()
        self._process.now_and_then(self._look_after_status)

    def spin_once(self, timeout: float = IDLE_WAIT) -> bool:
        """Let the process wait for messages and handle them, see `NodeProcess.spin_once`."""
        return self._process.spin_once(timeout)

    def spin(
        self,
        poll: Callable[[], None] | None = None,
        period: Callable[[], float] | float = IDLE_WAIT,
    ) -> None:
        """Handle messages until told to stop, calling ``poll`` at least every ``period`` s."""
        while not self.stopping:
            self.spin_once(period() if callable(period) else period)
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
        values = {**status.values, **self._own_values()}
        self._status = replace(status, name=self.name, values=values)
        self._publish_status()

    def note(self, status: Status) -> None:
        """Make this the node's status, to be published when the next one is due."""
        values = {**self._status.values, **status.values}
        self._status = replace(status, name=self.name, values=values)

    def matched(self) -> dict[str, str]:
        """Who is connected: names of the nodes that listen to each topic, number of its senders.

        Names are separated by blanks.
        """
        found = {}
        for name, full_name in self._inside.items():
            found[f"senders {name}"] = str(self.node.count_publishers(full_name))
        for name, subscription in self._subscriptions.items():
            found[f"senders {name}"] = str(subscription.get_publisher_count())
        for name, publisher in self._publishers.items():
            infos = self.node.get_subscriptions_info_by_topic(publisher.topic_name)
            listeners = {self._seen_from_the_test(i.node_namespace, i.node_name) for i in infos}
            if len(listeners) > publisher.get_subscription_count():
                listeners = set()  # some are known but not connected yet
            listeners.update(self._process.mailbox.listeners(publisher.topic_name))
            found[f"matched {name}"] = " ".join(sorted(listeners))
        return found

    def several_senders(self) -> str:
        """Say which topic of the loop more than one node publishes; empty if none.

        One of them is not of this test, and whose messages count would be chance.
        """
        counts = {name: s.get_publisher_count() for name, s in self._subscriptions.items()}
        counts |= {name: self.node.count_publishers(full) for name, full in self._inside.items()}
        for name, count in counts.items():
            if name in self._loop_names and count > 1:
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

    def _full_name(self, topic: Topic) -> str:
        """Name of a topic for this node, which may be a level below the test."""
        if not self.rig.name or topic.name.startswith("/"):
            return topic.name
        return f"{self._test_namespace}/{topic.name}"

    def _seen_from_the_test(self, namespace: str, node: str) -> str:
        """Name of a node below the test's namespace; elsewhere its full name."""
        full = f"{namespace.rstrip('/')}/{node}"
        return full.removeprefix(f"{self._test_namespace}/")

    def _guarded(
        self, handler: Handler, topic: Topic, subscription: Subscription | None
    ) -> Receive:
        """Refuse what is no message of the test; note when the loop was last seen to turn.

        The publisher of a topic that has a message in each step numbers them. One that joins
        later has sent fewer than were acted upon.
        """
        is_of_each_step = isinstance(topic, LoopTopic) and not topic.latched
        is_numbered = is_of_each_step and subscription is not None
        last = 0

        def receive(raw: bytes, received_ns: int, number: int) -> bool:
            nonlocal last
            if is_of_each_step:
                self._handled_at = time.monotonic()
            try:
                if is_numbered and 0 < number <= last and _several_publish(subscription):
                    raise WireError(f"{topic.name} of a second publisher")
                handler(raw, received_ns)
            except WireError as error:
                self.refuse(str(error))
                return False
            last = number
            return True

        return receive

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

    def _describe(self) -> None:
        """Tell the node's parameters, at its start and when one was set."""
        if self._facts is not None:
            told = {"node": self.name, "parameters": self._section, **self._facts}
            self._description(encode_string(json.dumps(told)))

    def _own_values(self) -> dict[str, str]:
        return {"refused": str(self.refused), "peak_memory_mb": str(_peak_memory_mb())}

    def _publish_status(self) -> None:
        now = time.time_ns()
        if self._status != self._status_sent[1]:
            self._status_message = bytearray(encode_diagnostics(now, [self._status]))
        self._status_sent = (time.monotonic(), self._status)
        restamp(self._status_message, now)
        self._diagnostics(bytes(self._status_message))


def _rig_of(node: Node, experiment: Experiment) -> tuple[RigAxes, str]:
    """Find the rig that a node belongs to, and the namespace of the test, without a last slash.

    Raises
    ------
    InputError
        If the node is in the namespace of no rig, or of one that it does not belong to.
    """
    namespace, name = node.get_namespace().rstrip("/"), node.get_name()
    above, _, last = namespace.rpartition("/")
    rigs = {rig.name: rig for rig in experiment.rigs}
    whole = RigAxes.whole(experiment.axes)
    if "" in rigs or (name not in RIG_NODES and last not in rigs):
        return whole, namespace
    known = " or ".join(f"-r __ns:={above if last in rigs else namespace}/{rig}" for rig in rigs)
    if name not in RIG_NODES:
        raise InputError(
            f"{name} serves all rigs and can't be in {namespace}, which is one rig's namespace"
        )
    if last not in rigs:
        raise InputError(
            f"{name} is in namespace {namespace or '/'}, but the axes {list(experiment.axes)} are "
            f"of several rigs; say which one's it is: --ros-args {known}"
        )
    return rigs[last], above


def _several_publish(subscription: Subscription | None) -> bool:
    return subscription is not None and subscription.get_publisher_count() > 1


def _peak_memory_mb() -> int:
    """Largest resident memory of this process so far; -1 where the system does not tell."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return -1
    kilobytes = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return round(int(kilobytes[0]) / 1024) if kilobytes else -1
