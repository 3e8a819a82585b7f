"""A node's shell: its checked parameters, topics, status, time; and what its body must have."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from seft_msgs_py.config.experiment import Experiment, split_ros_arguments
from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.node.heartbeat import Heartbeat
from seft_msgs_py.node.turns import NodeProcess
from seft_msgs_py.node.wiring import Wiring
from seft_msgs_py.wire.messages import OK, Status
from seft_msgs_py.wire.outcome import tripped_status

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
        self.serve, self.log = endpoint.serve, endpoint.log
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

    def spin_once(self, timeout: float = IDLE_WAIT) -> bool:
        """Wait for messages and handle them, see `NodeProcess.spin_once`."""
        return self._process.spin_once(timeout)

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
