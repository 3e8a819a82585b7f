"""One node: its checked parameters, raw topics and status; the body of an executable."""

import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import fill
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher

from seft_msgs_py.config.experiment import Experiment, split_ros_arguments
from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.errors import SeftError, WireError
from seft_msgs_py.node import rclpy_interface, realtime
from seft_msgs_py.node.node_process import NodeProcess, ReadOne, Receive, drain
from seft_msgs_py.node.process import exit_watchdog, single_instance
from seft_msgs_py.node.senders import Senders, connected_listeners
from seft_msgs_py.wire.messages import (
    OK,
    Status,
    decode_status,
    encode_diagnostics,
    encode_string,
    restamp,
)
from seft_msgs_py.wire.outcome import MOVING, tripped_status
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS, EXPERIMENT_STATE, LoopTopic, Topic

IDLE_WAIT = 0.05  # s; a signal is noticed within this time
STATUS_PERIOD = 0.2  # s between two heartbeats
LOOP_PAUSE = 1.0  # s without a message of the loop: the node is idle
WARN_PERIOD = 1.0  # s
WARM_UP_STEPS = 200
"""Steps that a node of the loop runs before the test, so that the test's first steps are fast."""
Handler = Callable[[bytes, int], None]
"""Takes a message's bytes and the wall-clock time in ns of its arrival."""


class NodeShell:
    """A node with its checked parameters, read from a command line (``--ros-args``).

    ``table`` contains its own parameters; ``tables`` are all known ones, because parameters may
    take their values from other nodes.

    Attributes
    ----------
    name : str
        The node's name, with its rig's name if the test has several.
    experiment : Experiment
        This node's section of the command line and its parameter files.
    rig : RigAxes
        The rig that the node belongs to; all axes, if it serves all rigs.
    node : rclpy.node.Node
        The node itself.
    refused : int
        Messages that were not acted upon.
    """

    def __init__(
        self, process: NodeProcess, table: Table, tables: Iterable[Table], argv: Sequence[str]
    ) -> None:
        files, overrides, _ = split_ros_arguments(argv)
        self.experiment = Experiment.load(tables, files, overrides, nodes=[table.node])
        self.refused = 0
        self._warning, self._warned_at = "", -WARN_PERIOD  # first reason since the last warning
        self._process = process
        self._section = section = self.experiment[table.node]
        self.node = Node(
            table.node,
            parameter_overrides=[RosParameter(name, value=v) for name, v in section.items()],
        )
        self.rig, self._test_namespace = rclpy_interface.rig_of_node(self.node, self.experiment)
        self.name = self.rig.node(table.node)
        process.add_node(self.node)
        domain, full_name = self.node.context.get_domain_id(), self.node.get_fully_qualified_name()
        self._single_instance = single_instance(domain, full_name)
        self._facts: dict[str, Any] | None = None  # none before it has described itself
        rclpy_interface.declare_parameters(self.node, table, section, self._describe)
        self._publishers: dict[str, Publisher] = {}
        self._readers: dict[str, ReadOne] = {}
        self._senders = Senders(self.node)
        self._handled_at = 0.0  # s, monotonic: the last message of the loop
        self._polled_at = self._polled_senders_at = 0.0
        self._status = Status(self.name, 0, "starting", values={})
        self._status_sent: tuple[float, Status | None] = (0.0, None)
        self._logged = ""  # the phase that the log has
        self._status_message = bytearray()
        self._diagnostics = self.publisher(DIAGNOSTICS)
        self._description = self.publisher(DESCRIPTION)

    @property
    def stopping(self) -> bool:
        """Whether the process should end."""
        return self._process.stopping

    def publisher(self, topic: Topic) -> Callable[[bytes], None]:
        """Make the publisher of a topic; return the function that publishes message bytes."""
        here = replace(topic, name=self._full_name(topic))
        publisher = rclpy_interface.raw_publisher(self.node, here)
        self._publishers[topic.name] = publisher
        send = rclpy_interface.sender(publisher)
        if not isinstance(topic, LoopTopic):
            return send
        return self._process.bus.sender(publisher.topic_name, send)

    def subscribe(
        self,
        topic: Topic,
        handler: Handler,
        depth: int | None = None,
        wake: bool = True,
        reliable: bool = True,
    ) -> ReadOne:
        """Give every message of a topic to ``handler`` as bytes, in the main thread.

        Parameters
        ----------
        handler : callable
            A `WireError` it raises is counted and logged as a warning.
        depth : int, optional
            Messages kept while the node is busy; default the topic's.
        wake : bool
            Whether a message ends the waiting; otherwise it is handled when no other has ended it,
            or on request.
        reliable : bool
            Whether a lost message is sent again. For the loop that would be too late, and
            acknowledging takes a tenth of a step.

        Returns
        -------
        callable
            Handles one message, on request.
        """
        here, receive = replace(topic, name=self._full_name(topic)), self._guarded(handler, topic)
        if self._process.bus.serves(topic):
            full_name = self.node.resolve_topic_name(here.name)
            self._senders.add(topic, full_name)
            self._process.bus.subscribe(full_name, self.name, receive)
            read_one = _nothing
        else:
            subscription = rclpy_interface.raw_subscription(self.node, here, depth, reliable)
            self._senders.add(topic, subscription.topic_name, subscription)
            read_one = self._process.add_subscription(subscription, receive, wake)
        self._readers[topic.name] = read_one
        return read_one

    def catch_up(self, topic: Topic) -> None:
        """Handle all messages of a topic that have arrived."""
        drain(self._readers[topic.name])

    def start(self, facts: dict[str, Any] | None = None) -> None:
        """Describe the node, with facts about it (JSON values); begin to send its status."""
        self._facts = dict(facts or {})
        if "thread_priority" in self._section:
            for denied in realtime.apply(self._section):
                self.node.get_logger().warning(denied)
            self._facts["realtime"] = realtime.granted()
        self._describe()
        self.node.get_logger().info("started; the supervisor starts and ends tests")
        self._process.chores.append(self._renew_status)

    def add_facts(self, facts: dict[str, Any]) -> None:
        """Add facts about the node (JSON values) to its description."""
        self._facts = {**(self._facts or {}), **facts}
        self._describe()

    def spin_once(self, timeout: float = IDLE_WAIT) -> bool:
        """Wait for messages and handle them, see `NodeProcess.spin_once`."""
        return self._process.spin_once(timeout)

    def attempt(self, what: str, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of this node, see `NodeProcess.attempt`."""
        return self._process.attempt(f"{self.name}, {what}", call, *arguments)

    def fault(self, what: str, error: Exception) -> str:
        """Count and log a fault of this node's program, see `NodeProcess.fault`."""
        return self._process.fault(f"{self.name}, {what}", error)

    def refuse(self, reason: str) -> None:
        """Count a message that was not acted upon; a warning follows, at most once a second.

        A call of the logger takes a millisecond, even if its own throttle suppresses the message.
        """
        self.refused += 1
        self._warning = self._warning or reason

    def report(self, status: Status) -> None:
        """Make this the node's status, and publish it at once."""
        values = {**status.values, **self._own_values()}
        self._status = replace(status, name=self.name, values=values)
        self._publish_status()

    def note(self, status: Status) -> None:
        """Make this the node's status, which is published when the next one is due."""
        values = {**self._status.values, **status.values}
        self._status = replace(status, name=self.name, values=values)

    def matched(self) -> dict[str, str]:
        """Names of the listeners of each topic, separated by blanks; number of publishers."""
        found = {f"senders {name}": str(n) for name, n in self._senders.counts().items()}
        for name, publisher in self._publishers.items():
            outside = connected_listeners(self.node, publisher, self._test_namespace)
            inside = self._process.bus.listeners(publisher.topic_name)
            found[f"matched {name}"] = " ".join(sorted({*outside, *inside}))
        return found

    def several_senders(self) -> str:
        """Say which topic of the test more than one node publishes, see `Senders.conflict`."""
        return self._senders.conflict()

    def foreign_publishers(self, refused_before: int) -> str:
        """Name the foreign nodes that may be the cause of missing messages, to append to a reason.

        ``refused_before`` is the value of `refused` when the last message arrived.
        """
        refused, conflict = self.refused - refused_before, self.several_senders()
        text = f"; {refused} messages were refused meanwhile" if refused else ""
        return f"{text}; {conflict}" if conflict else text

    def _full_name(self, topic: Topic) -> str:
        """Name of a topic for this node, whose namespace may be a level below the test's."""
        if not self.rig.name or topic.name.startswith("/"):
            return topic.name
        return f"{self._test_namespace}/{topic.name}"

    def _guarded(self, handler: Handler, topic: Topic) -> Receive:
        """Wrap a handler: refuse invalid messages, and note the time of the last sample."""
        is_of_each_step = isinstance(topic, LoopTopic) and not topic.latched
        name, senders = topic.name, self._senders

        def receive(raw: bytes, received_ns: int, gid: bytes) -> bool:
            if is_of_each_step:
                self._handled_at = time.monotonic()
            if senders.is_foreign(name, gid):
                self.refused += 1
                return False
            try:
                handler(raw, received_ns)
            except WireError as error:
                self.refuse(str(error))
                return False
            except SeftError:
                raise  # the reason for the user why the node can't continue
            except Exception as error:
                self.fault(name, error)
                return False
            if topic == EXPERIMENT_STATE:
                senders.follow(decode_status(raw).message in MOVING)
            return True

        return receive

    def _renew_status(self) -> None:
        """Send the status when it is due, with its changes.

        Reading the graph takes a millisecond, too long for a node of a running loop: then the
        listeners are not looked up.
        """
        now = time.monotonic()
        if self._warning and now - self._warned_at >= WARN_PERIOD:
            self.node.get_logger().warning(f"refused ({self.refused} so far): {self._warning}")
            self._warning, self._warned_at = "", now
        if now - self._polled_senders_at >= STATUS_PERIOD:
            self._polled_senders_at = now
            for news in self._senders.poll():
                self.node.get_logger().warning(news)
        sent_at, sent = self._status_sent
        is_due = now - sent_at >= STATUS_PERIOD
        if now - self._handled_at < LOOP_PAUSE:
            if is_due:
                self._update(self._counted())
                self._publish_status()
        elif now - self._polled_at >= STATUS_PERIOD:
            self._polled_at = now
            self._update({**self.matched(), **self._own_values()})
            self._log_phase()
            if self._status != sent or is_due:
                self._publish_status()

    def _log_phase(self) -> None:
        """Log the phase of an idle node if it is new: a line takes a millisecond."""
        phase, text = self._status.values.get("phase", ""), self._status.message
        if phase != self._logged:
            self._logged = phase
            bag = f" {self._status.values['bag']}" if "bag" in self._status.values else ""
            self.node.get_logger().info((text if phase in text else f"{phase}: {text}") + bag)

    def _describe(self) -> None:
        """Publish the node's parameters, at its start and after a change."""
        if self._facts is not None:
            described = {"node": self.name, "parameters": self._section, **self._facts}
            self._description(encode_string(json.dumps(described)))

    def _own_values(self) -> dict[str, str]:
        peak = round(realtime.memory_kb("VmHWM") / 1024)
        return {**self._counted(), "peak_memory_mb": str(peak)}

    def _counted(self) -> dict[str, str]:
        counted = {"refused": str(self.refused), "faults": str(self._process.faults)}
        return {**counted, "strangers": self._senders.strangers()}

    def _update(self, values: dict[str, str]) -> None:
        """Add values to the status; an equal status stays the same object."""
        if values.items() - self._status.values.items():
            self._status = replace(self._status, values={**self._status.values, **values})

    def _publish_status(self) -> None:
        now = time.time_ns()
        if self._status != self._status_sent[1]:
            self._status_message = bytearray(encode_diagnostics(now, [self._status]))
        self._status_sent = (time.monotonic(), self._status)
        restamp(self._status_message, now)
        self._diagnostics(bytes(self._status_message))


def _nothing() -> bool | None:
    """Read nothing: the messages of this process have been delivered already."""
    return None


CLOSE_PATIENCE = 5.0  # s


class NodeBody:
    """The behaviour of a node in its shell; subclasses override what they need.

    Attributes
    ----------
    facts : dict
        Facts about this node that others need besides its parameters; JSON values.
    """

    def __init__(self, shell: NodeShell) -> None:
        self._shell = shell
        self.facts: dict[str, Any] = {}

    def report(
        self, phase: str, values: Mapping[str, str] | None = None, level: int = OK, text: str = ""
    ) -> None:
        """Publish the node's phase as its status."""
        values = {"phase": phase, **(values or {})}
        self._shell.report(Status(self._shell.name, level, text or phase, values=values))

    def begin(self) -> None:
        """Report the first status, after the node's description."""

    def run(self) -> None:
        """Work until the process ends, spinning the shell."""
        while not self._shell.stopping:
            self._shell.spin_once(self.period())
            self._shell.attempt("a poll", self.poll)

    def fault(self, reason: str) -> None:
        """End the test because of a fault of the program, in any node of this process."""
        self._shell.report(tripped_status(self._shell.name, reason, 0))

    def poll(self) -> None:
        """Do the work that is due by time; called after each turn, whichever node spins."""

    def period(self) -> float:
        """Longest time between two polls, s."""
        return IDLE_WAIT


@dataclass(frozen=True)
class NodeKind:
    """How a node is made.

    Attributes
    ----------
    table : Table
        Its parameters.
    tables : tuple of Table
        All known tables, because parameters may take their values from other nodes.
    make : callable
        Makes the node in its shell.
    """

    table: Table
    tables: Iterable[Table]
    make: Callable[[NodeShell], NodeBody]

    def main(self) -> int:
        """Run this node in this process, or print its help; return the exit status."""
        if {"-h", "--help"} & {*sys.argv[1:]}:
            print(self.help())
            return 0
        return run_nodes(self)

    def help(self) -> str:
        """Say what the node does, how it is started, and what parameters it has; 80 columns."""
        node, module = self.table.node, sys.modules[self.make.__module__]
        package = (module.__spec__.name if module.__spec__ else module.__name__).split(".")[0]
        text = (module.__doc__ or "").strip().replace("``", "")
        usage = "[--ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/RIG]]"
        lines = [
            "\n\n".join(fill(paragraph, 80) for paragraph in text.split("\n\n")),
            fill(f"usage: {node} {usage}", 80, subsequent_indent="    "),
            f"example:\n  ros2 run {package} {node} --ros-args --params-file config/demo.yaml",
            "parameters, with their defaults and units:",
        ]
        for row in self.table.rows.values():
            default = "required" if row.default is None else f"{row.default!r} {row.unit}".strip()
            for part, margin in ((f"{row.name}: {default}", 2 * " "), (row.description, 6 * " ")):
                lines.append(fill(part, 80, initial_indent=margin, subsequent_indent=6 * " "))
        return "\n\n".join(lines[:4]) + "\n\n" + "\n".join(lines[4:])


def run_nodes(*kinds: NodeKind) -> int:
    """Run nodes in this process, which share its main thread and its command line.

    The first one spins; the others answer their messages, and poll after each turn. A user's error
    is printed in one line on stderr. Returns the exit status.
    """
    name, status = kinds[0].table.node, 1
    try:
        process = NodeProcess(sys.argv, [kind.table.node for kind in kinds])
    except SeftError as error:
        return _tell(name, error)
    try:
        shells = []
        for kind in kinds:
            name = kind.table.node
            shells.append(NodeShell(process, kind.table, kind.tables, sys.argv))
        nodes = []
        for kind, shell in zip(kinds, shells, strict=True):
            name = kind.table.node
            node = kind.make(shell)
            shell.start(node.facts)
            node.begin()
            process.fault_listeners.append(node.fault)
            nodes.append(node)
        process.polls += [node.poll for node in nodes[1:]]
        process.start()
        name = kinds[0].table.node
        nodes[0].run()
        status = 0
    except SeftError as error:
        status = _tell(name, error)
    finally:
        with exit_watchdog(CLOSE_PATIENCE, status):
            process.close()
    return status


def _tell(node: str, error: SeftError) -> int:
    """Print a user's error in one line; return its exit status."""
    text = str(error)
    print(text if text.startswith(f"{node}: ") else f"{node}: {text}", file=sys.stderr, flush=True)
    return error.exit_status
