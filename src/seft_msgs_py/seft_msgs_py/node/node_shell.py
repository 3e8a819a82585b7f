"""A node: its shell (checked parameters, topics, status, time), its body, and its executable."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import fill
from typing import Any

from seft_msgs_py.config.experiment import Experiment, split_ros_arguments
from seft_msgs_py.config.parameter_table import Section, Table
from seft_msgs_py.errors import SeftError
from seft_msgs_py.node.transport import Endpoint, MakeTransport
from seft_msgs_py.node.turns import NodeProcess
from seft_msgs_py.node.wiring import Wiring
from seft_msgs_py.printing import unbroken
from seft_msgs_py.wire.messages import OK, Status, encode_diagnostics, encode_string, restamp
from seft_msgs_py.wire.outcome import STOOD_STILL_KEY, tripped_status
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS

STATUS_PERIOD = 0.2  # s between two heartbeats
NOTED_PAUSE = 0.01
"""s; a node that stood still for longer says so at once, unless its last status told of a longer
time: an overloaded host is not loaded with a status after each of its pauses."""
LOOP_PAUSE = 1.0  # s without a message of the loop: the node is idle


class Heartbeat:
    """Status and description of a node with its parameters (``section``)."""

    def __init__(
        self, process: NodeProcess, endpoint: Endpoint, wiring: Wiring, section: Section
    ) -> None:
        self._process, self._endpoint, self._wiring = process, endpoint, wiring
        self._section, self._clock = section, process.clock
        self._facts: dict[str, Any] | None = None  # none before the node has described itself
        self._polled_at = 0.0
        self._status = Status(wiring.name, 0, "starting", values={})
        self._status_sent: tuple[float, Status | None] = (0.0, None)
        self._stood_still = self._told = 0.0  # longest time since the last status, and in it, s
        self._logged = ""  # the phase that the log has
        self._status_message = bytearray()
        self._diagnostics = wiring.publisher(DIAGNOSTICS)
        self._description = wiring.publisher(DESCRIPTION)

    def add_facts(self, facts: dict[str, Any]) -> None:
        """Add facts about the node (JSON values) to its description, and publish it."""
        self._facts = {**(self._facts or {}), **facts}
        self.describe()

    def describe(self) -> None:
        """Publish the node's parameters and facts, if it has any yet."""
        if self._facts is not None:
            described = {"node": self._wiring.name, "parameters": self._section, **self._facts}
            self._description(encode_string(json.dumps(described)))

    def report(self, status: Status) -> None:
        """Make this the node's status, and publish it at once."""
        values = {**status.values, **self._own_values()}
        self._status = replace(status, name=self._wiring.name, values=values)
        self._publish_status()

    def note(self, status: Status) -> None:
        """Make this the node's status, which is published when the next one is due."""
        values = {**self._status.values, **status.values}
        self._status = replace(status, name=self._wiring.name, values=values)

    def renew(self) -> None:
        """Send the status when it is due, with its changes; a chore.

        Reading the graph takes a millisecond, too long for a node of a running loop: then the
        listeners are not looked up.
        """
        now = self._clock.monotonic()
        sent_at, sent = self._status_sent
        self._stood_still = max(self._stood_still, self._process.stood_still)
        is_news = self._stood_still > max(NOTED_PAUSE, self._told)
        is_due = now - sent_at >= STATUS_PERIOD or is_news
        if now - self._wiring.handled_at < LOOP_PAUSE:
            if is_due:
                self._update(self._counted())
                self._publish_status()
        elif is_due or now - self._polled_at >= STATUS_PERIOD:
            self._polled_at = now
            self._update({**self._wiring.matched(), **self._own_values()})
            self._log_phase()
            if self._status != sent or is_due:
                self._publish_status()

    def _log_phase(self) -> None:
        """Log the phase of an idle node if it is new: a line takes a millisecond."""
        phase, text = self._status.values.get("phase", ""), self._status.message
        if phase != self._logged:
            self._logged = phase
            bag = f" {self._status.values['bag']}" if "bag" in self._status.values else ""
            self._endpoint.log("info", (text if phase in text else f"{phase}: {text}") + bag)

    def _own_values(self) -> dict[str, str]:
        peak = round(self._process.transport.host.memory_kb("VmHWM") / 1024)
        return {**self._counted(), "peak_memory_mb": str(peak)}

    def _counted(self) -> dict[str, str]:
        stood_still = max(self._stood_still, self._process.stood_still)
        return {
            STOOD_STILL_KEY: f"{stood_still:.3g}" if stood_still > NOTED_PAUSE else "0",
            "refused": str(self._wiring.refused),
            "faults": str(self._process.faults),
            "unexpected_publishers": self._wiring.senders.unexpected_publishers(),
        }

    def _update(self, values: dict[str, str]) -> None:
        """Add values to the status; an equal status stays the same object."""
        if values.items() - self._status.values.items():
            self._status = replace(self._status, values={**self._status.values, **values})

    def _publish_status(self) -> None:
        now = self._clock.time_ns()
        if self._status != self._status_sent[1]:
            self._status_message = bytearray(encode_diagnostics(now, [self._status]))
        self._status_sent = (self._clock.monotonic(), self._status)
        self._told = max(self._stood_still, self._process.stood_still)
        self._stood_still = 0.0
        restamp(self._status_message, now)
        self._diagnostics(bytes(self._status_message))


IDLE_WAIT = 0.05  # s; a signal is noticed within this time
WARM_UP_STEPS = 200
"""Steps that a node of the loop runs before the test, so that the test's first steps are fast."""


class NodeShell(Wiring):
    """A node with its checked parameters, read from a command line (``--ros-args``).

    ``table`` contains its own parameters; ``tables`` are all known ones, because parameters may
    take their values from other nodes.

    Attributes
    ----------
    experiment : Experiment
        This node's section of the command line and its parameter files.
    clock : Clock
        The only clock that the node may read and wait by.
    serve : callable
        Answers requests (std_srvs/Trigger), perhaps in another thread, see `Endpoint.serve`.
    log : callable
        Logs a line, see `Endpoint.log`; it takes a millisecond.
    spin_once : callable
        Waits for messages and handles them, see `NodeProcess.spin_once`.
    report, note, add_facts : callable
        See `Heartbeat`.
    """

    def __init__(
        self, process: NodeProcess, table: Table, tables: Iterable[Table], argv: Sequence[str]
    ) -> None:
        files, overrides, _ = split_ros_arguments(argv)
        self.experiment = Experiment.load(tables, files, overrides, nodes=[table.node])
        self.clock = process.clock
        self._section = section = self.experiment[table.node]
        endpoint = process.transport.join(table.node, section)
        super().__init__(process, endpoint, self.experiment)
        self.serve, self.log, self.spin_once = endpoint.serve, endpoint.log, process.spin_once
        self._heartbeat = heartbeat = Heartbeat(process, endpoint, self, section)
        self.report, self.note = heartbeat.report, heartbeat.note
        self.add_facts = heartbeat.add_facts
        endpoint.parameters(table, section, heartbeat.describe)

    @property
    def stopping(self) -> bool:
        """Whether the process should end."""
        return self._process.stopping

    def start(self, facts: dict[str, Any] | None = None) -> None:
        """Describe the node, with facts about it (JSON values); begin to send its status."""
        facts, host = dict(facts or {}), self._process.transport.host
        if "thread_priority" in self._section:
            for denied in host.apply(self._section):
                self.log("warning", denied)
            facts["realtime"] = host.granted()
        self.add_facts(facts)
        self.log("info", "started; the supervisor starts and ends tests")
        self._process.chores += [self.warn, self._heartbeat.renew]

    def attempt(self, what: str, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function of this node, see `NodeProcess.attempt`."""
        return self._process.attempt(f"{self.name}, {what}", call, *arguments)

    def fault(self, what: str, error: Exception) -> str:
        """Count and log a fault of this node's program, see `NodeProcess.fault`."""
        return self._process.fault(f"{self.name}, {what}", error)


class NodeBody:
    """The behaviour of a node in its shell; subclasses override what they need.

    Attributes
    ----------
    facts : dict
        Facts about this node that others need besides its parameters; JSON values.
    """

    def __init__(self, shell: NodeShell) -> None:
        self._shell, self._clock = shell, shell.clock
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
        return unbroken(self.table.node, self._main)

    def _main(self) -> int:
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


def run_nodes(
    *kinds: NodeKind, argv: Sequence[str] | None = None, transport: MakeTransport | None = None
) -> int:
    """Run nodes in this process, which share its main thread and its command line.

    The first one spins; the others answer their messages, and poll after each turn. A user's error
    is printed in one line on stderr.

    Parameters
    ----------
    kinds : NodeKind
        The nodes.
    argv : sequence of str, optional
        Command line; default that of this process.
    transport : callable, optional
        Makes the graph that they join; default DDS.

    Returns
    -------
    int
        Exit status.
    """
    name, status = kinds[0].table.node, 1
    argv = sys.argv if argv is None else argv
    try:
        if transport is None:
            from seft_msgs_py.node.dds import DdsTransport  # a virtual graph needs no ROS

            transport = DdsTransport
        process = NodeProcess(argv, [kind.table.node for kind in kinds], transport)
    except SeftError as error:
        return _tell(name, error)
    try:
        shells = []
        for kind in kinds:
            name = kind.table.node
            shells.append(NodeShell(process, kind.table, kind.tables, argv))
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
        process.close(status)
    return status


def _tell(node: str, error: SeftError) -> int:
    """Print a user's error in one line; return its exit status."""
    text = str(error)
    print(text if text.startswith(f"{node}: ") else f"{node}: {text}", file=sys.stderr, flush=True)
    return error.exit_status
