"""A node's shell: its checked parameters, topics, status, time; and what its body must have."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from seft_msgs_py.config.experiment import Experiment, split_ros_arguments
from seft_msgs_py.config.parameter_table import Table
from seft_msgs_py.node.heartbeat import Heartbeat
from seft_msgs_py.node.transport import Answer, Level, Send
from seft_msgs_py.node.turns import NodeProcess, ReadOne
from seft_msgs_py.node.wiring import Handler, Wiring
from seft_msgs_py.wire.messages import OK, Status
from seft_msgs_py.wire.outcome import tripped_status
from seft_msgs_py.wire.topics import Topic

IDLE_WAIT = 0.05  # s; a signal is noticed within this time
WARM_UP_STEPS = 200
"""Steps that a node of the loop runs before the test, so that the test's first steps are fast."""


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
    clock : Clock
        The only clock that the node may read and wait by.
    """

    def __init__(
        self, process: NodeProcess, table: Table, tables: Iterable[Table], argv: Sequence[str]
    ) -> None:
        files, overrides, _ = split_ros_arguments(argv)
        self.experiment = Experiment.load(tables, files, overrides, nodes=[table.node])
        self._process, self.clock = process, process.clock
        self._section = section = self.experiment[table.node]
        self._endpoint = process.transport.join(table.node, section)
        self._wiring = Wiring(process, self._endpoint, self.experiment)
        self.rig, self.name = self._wiring.rig, self._wiring.name
        self._heartbeat = Heartbeat(process, self._endpoint, self._wiring, section)
        self._endpoint.parameters(table, section, self._heartbeat.describe)

    @property
    def stopping(self) -> bool:
        """Whether the process should end."""
        return self._process.stopping

    @property
    def refused(self) -> int:
        """Messages that were not acted upon."""
        return self._wiring.refused

    def start(self, facts: dict[str, Any] | None = None) -> None:
        """Describe the node, with facts about it (JSON values); begin to send its status."""
        facts, host = dict(facts or {}), self._process.transport.host
        if "thread_priority" in self._section:
            for denied in host.apply(self._section):
                self.log("warning", denied)
            facts["realtime"] = host.granted()
        self.add_facts(facts)
        self.log("info", "started; the supervisor starts and ends tests")
        self._process.chores += [self._wiring.warn, self._heartbeat.renew]

    def publisher(self, topic: Topic) -> Send:
        """Make the publisher of a topic; return the function that publishes message bytes."""
        return self._wiring.publisher(topic)

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
        return self._wiring.subscribe(topic, handler, depth, wake, reliable)

    def catch_up(self, topic: Topic) -> None:
        """Handle all messages of a topic that have arrived."""
        self._wiring.catch_up(topic)

    def serve(self, service: str, answer: Answer) -> None:
        """Answer requests (std_srvs/Trigger), perhaps in another thread."""
        self._endpoint.serve(service, answer)

    def log(self, level: Level, text: str) -> None:
        """Log a line; it takes a millisecond."""
        self._endpoint.log(level, text)

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
        """Count a message that was not acted upon; a warning follows, at most once a second."""
        self._wiring.refuse(reason)

    def add_facts(self, facts: dict[str, Any]) -> None:
        """Add facts about the node (JSON values) to its description."""
        self._heartbeat.add_facts(facts)

    def report(self, status: Status) -> None:
        """Make this the node's status, and publish it at once."""
        self._heartbeat.report(status)

    def note(self, status: Status) -> None:
        """Make this the node's status, which is published when the next one is due."""
        self._heartbeat.note(status)

    def matched(self) -> dict[str, str]:
        """Names of the listeners of each topic, separated by blanks; number of publishers."""
        return self._wiring.matched()

    def follow(self, state: str) -> None:
        """Choose the publishers of a test when it begins; for the node that makes its state."""
        self._wiring.follow(state)

    def several_senders(self) -> str:
        """Say which topic of the test more than one node publishes, see `Senders.conflict`.

        Or which node there is more than once, by the topics that all nodes publish.
        """
        return self._wiring.several_senders()

    def name_unexpected_publishers(self, refused_before: int) -> str:
        """Name unexpected nodes that may be the cause of missing messages, to append to a reason.

        ``refused_before`` is the value of `refused` when the last message arrived.
        """
        return self._wiring.name_unexpected_publishers(refused_before)


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
