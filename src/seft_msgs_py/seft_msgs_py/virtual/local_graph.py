"""A test of the real nodes in one process and in virtual time, with faults at exact moments."""

from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.config.parameter_table import Table, Value
from seft_msgs_py.node.node_shell import NodeKind, run_nodes
from seft_msgs_py.virtual.memory import MemoryEndpoint, MemoryGraph, MemoryTransport, Rule
from seft_msgs_py.virtual.scheduler import NEVER, Scheduler, Task, ns
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import decode_diagnostics
from seft_msgs_py.wire.topics import LoopTopic, RigAxes, Topic, bare, rig_name
from seft_msgs_py.wire.trajectory import TrajectoryCodec

_LOOP = ("ground_motion", "reference_force", "force_controller", "rig", "supervisor")
STRANGER = "stranger"
_LOOK = 0.005  # s between two looks of `LocalGraph.until`


class LocalGraph:
    """The nodes of a test, started; time stands still until `run`, `until` or `call`.

    They are the nodes that run as processes of ROS 2, with a virtual clock and a graph in memory:
    the same test gives the same messages at the same times, whatever the machine does meanwhile.
    So a laboratory tries its own hardware beside the nodes of `seft_ros`::

        from seft_msgs_py.virtual import LocalGraph
        from seft_msgs_py.wire.topics import VALVE_COMMAND
        from seft_ros.nodes.loop_node import NODE_KINDS

        with LocalGraph(NODE_KINDS, ["laboratory.yaml"]) as graph:
            graph.until("ready")
            graph.call("start")
            graph.drop(VALVE_COMMAND, range(500, 2000))
            graph.until("tripped")
            assert "no new valve_command" in graph.values["detail"]

    Parameters
    ----------
    kinds : mapping of str to NodeKind
        The nodes' kinds, by their names without a rig's.
    files : sequence of path
        Parameter files of the experiment.
    overrides : str
        Parameters, as ``node:parameter:=value``.
    nodes : sequence of str, or of tuples of str
        Names of the nodes to start, with their rig's if there are several; a tuple shares a
        process. The supervisor waits for these, unless an override names other peers.
    own_files : mapping of str to sequence of path
        Node -> its parameter files, if they are not the experiment's.
    latency : float
        Time from sending a message to its arrival, s. At 0 a test in lockstep takes no time.
    discovery : float
        Time until a new publisher or subscription is connected to the others, s.

    Attributes
    ----------
    experiment : Experiment
        All parameters.
    graph : MemoryGraph
        The graph, with all that was sent and logged.
    scheduler : Scheduler
        The virtual time.
    endings : dict of str to int
        Node -> exit status.

    Raises
    ------
    InputError
        If the parameters are wrong.
    """

    def __init__(
        self,
        kinds: Mapping[str, NodeKind],
        files: Sequence[Path | str],
        *overrides: str,
        nodes: Sequence[str | tuple[str, ...]] = _LOOP,
        own_files: Mapping[str, Sequence[Path | str]] | None = None,
        latency: float = 1e-4,
        discovery: float = 0.0,
    ) -> None:
        self._kinds = kinds
        groups = [(node,) if isinstance(node, str) else node for node in nodes]
        names = dict.fromkeys(bare(node) for group in groups for node in group)
        self._files, self._own_files = files, own_files or {}
        if "supervisor" in names:
            peers = ", ".join(name for name in names if name != "supervisor")
            overrides = (f"supervisor:peers:=[{peers}]", *overrides)
        self._overrides = overrides
        parsed = [parse_override(word) for word in overrides]
        self.experiment = Experiment.load(self._tables(), files, parsed)
        self.scheduler = Scheduler()
        self.graph = MemoryGraph(self.scheduler, self.experiment.timebase, latency, discovery)
        self.endings: dict[str, int] = {}
        self._tasks: dict[str, Task] = {}
        self._started: list[Task] = []
        self._transports: dict[str, MemoryTransport] = {}
        self._strangers: dict[str, MemoryEndpoint] = {}
        for group in groups:
            self.start(*group)

    def start(self, *nodes: str, overrides: Sequence[str] = ()) -> None:
        """Start nodes that share a process, with parameters besides those of the graph."""
        kinds = [self._kinds[bare(node)] for node in nodes]
        files, rig = self._own_files.get(nodes[0], self._files), rig_name(nodes[0])
        options = [("--params-file", str(file)) for file in files]
        options += [("-p", override) for override in (*self._overrides, *overrides)]
        argv = ["", "--ros-args", *(word for option in options for word in option)]

        def make_transport(_: Sequence[str], stop: Callable[..., None]) -> MemoryTransport:
            transport = MemoryTransport(self.graph, stop, f"/{rig}" if rig else "")
            self._transports.update(dict.fromkeys(nodes, transport))
            return transport

        def run() -> None:
            status = run_nodes(*kinds, argv=argv, transport=make_transport)
            self.endings.update(dict.fromkeys(nodes, status))

        task = self.scheduler.start(" ".join(nodes), run)
        self._started.append(task)
        self._tasks.update(dict.fromkeys(nodes, task))

    def run(self, seconds: float) -> None:
        """Let time go by; an exception that ended a node is raised here."""
        self.graph.clock.sleep(seconds)
        for task in (self.scheduler.current, *self._started):
            if task.error is not None:
                raise task.error

    def until(self, condition: str | Callable[[], Any], within: float = 120.0) -> Any:
        """Let time go by until the test is in a state, or a condition holds; give what holds.

        Raises
        ------
        TimeoutError
            If that is not the case within so many seconds.
        """
        end = self.scheduler.now + ns(within)
        while True:
            found = self.state == condition if isinstance(condition, str) else condition()
            if found:
                return found
            if self.scheduler.now >= end:
                what = condition if isinstance(condition, str) else "the condition"
                now = f"{self.state}, {self.values}, ended: {self.endings}"
                raise TimeoutError(f"{what} not within {within:g} s: {now}")
            self.run(_LOOK)

    def call(self, service: str) -> tuple[bool, str]:
        """Call a service of the supervisor, which answers when it is not frozen.

        Returns
        -------
        tuple of bool and str
            Whether the request was accepted, and the answer.

        Raises
        ------
        TimeoutError
            If no node that is alive serves it.
        """
        endpoint, answer = self.graph.services.get(f"/{service}", (None, None))
        if endpoint is None or answer is None or endpoint.is_dead:
            raise TimeoutError(f"nobody answers {service}")
        task = self._tasks[endpoint.path]
        while task.frozen_until > self.scheduler.now:
            self.scheduler.block(task.frozen_until)
        return answer()

    def set_parameter(self, node: str, name: str, value: Value) -> None:
        """Set a live parameter of a node, as ``ros2 param set`` does; InputError if it refuses."""
        self._endpoint(node).set_parameter(name, value)

    def freeze(self, node: str, seconds: float = 1e9) -> None:
        """Stop a node's process, as SIGSTOP does, at a moment when it waits."""
        self._tasks[node].frozen_until = self.scheduler.now + ns(seconds)

    def thaw(self, node: str) -> None:
        """Let a frozen process continue."""
        self._tasks[node].frozen_until = 0

    def terminate(self, node: str) -> None:
        """Ask a node's process to end, as SIGTERM does, and wait for that."""
        self._transports[node].stop()
        self.until(lambda: node in self.endings)

    def kill(self, node: str) -> None:
        """End a node's process, as SIGKILL does: nothing of its program runs any more."""
        self._transports[node].kill()
        self._tasks[node].frozen_until = NEVER

    def break_next(self, node: str) -> None:
        """Let a fault of a node's program come to light by the next message that it takes."""
        self._endpoint(node).breaks_next = True

    def drop(self, topic: Topic, steps: Container[int], reader: str | None = None) -> None:
        """Lose messages of these steps on their way to readers without resending."""
        self.graph.rules.append(Rule(topic.name, steps, None, reader))

    def delay(
        self,
        topic: Topic,
        seconds: float,
        steps: Container[int] | None = None,
        reader: str | None = None,
    ) -> None:
        """Let messages of these steps, by default all, take so much longer."""
        self.graph.rules.append(Rule(topic.name, steps, seconds, reader))

    def join(self, topic: Topic, name: str = STRANGER) -> Callable[[bytes], None]:
        """Let a stranger publish a topic from now on; return the function that sends.

        It may have any name, also that of a node of the test.
        """
        stranger = self._strangers.setdefault(name, MemoryEndpoint(self.graph, name))
        for publisher in self.graph.publishers[stranger.full_name(topic.name)]:
            if publisher.endpoint is stranger:
                return publisher.send
        return stranger.publish(topic).send

    def inject(self, topic: Topic, raw: bytes, sender: str = STRANGER) -> None:
        """Send bytes as a stranger, or as if they came from a node of the test."""
        if sender not in self._transports:
            self.join(topic, sender)(raw)
            return
        publishers = self.graph.publishers[self._endpoint(sender).full_name(topic.name)]
        own = self._endpoint(sender)
        next(each for each in publishers if each.endpoint is own).send(raw)

    @property
    def state(self) -> str:
        """State of the test as the supervisor published it last; empty before."""
        return str(self.values.get("state", ""))

    @property
    def values(self) -> dict[str, Any]:
        """Fields of that state, see `ExperimentState`; empty before."""
        for sent in reversed(self.graph.sent):
            if sent.topic == topics.EXPERIMENT_STATE.name and sent.node != STRANGER:
                return dict(vars(decode_state(sent.raw)))
        return {}

    def status(self, node: str) -> dict[str, str]:
        """Values of the last status that a node published; empty before."""
        for sent in reversed(self.graph.sent):
            if sent.topic == topics.DIAGNOSTICS.name and sent.node == node:
                return dict(decode_diagnostics(sent.raw)[1][0].values)
        return {}

    def samples(self, topic: LoopTopic, rig: RigAxes | None = None) -> tuple[list[int], Floats]:
        """Give steps and values of all messages of a topic that the test's own nodes sent.

        Returns
        -------
        steps : list of int
            Of the N samples: the first point of each message, or each point, see `LoopTopic`.
        values : ndarray
            The samples at these steps, shape (N, quantities, axes).
        """
        topic, axes = (topic.of(rig), rig.axes) if rig else (topic, self.experiment.axes)
        codec = TrajectoryCodec(topic, axes, self.experiment.timebase)
        own = (one for one in self.graph.sent if one.topic == topic.name and one.node != STRANGER)
        found = [
            (step + ahead, value)
            for step, values in (codec.decode(sent.raw) for sent in own)
            for ahead, value in enumerate(values if topic.every_point else values[:1])
        ]
        return [step for step, _ in found], np.array([value for _, value in found])

    def close(self) -> None:
        """End all nodes where they are."""
        for task in self._started:
            if self.scheduler.is_alive(task):
                self.scheduler.unwind(task)
        while any(map(self.scheduler.is_alive, self._started)):
            self.graph.clock.sleep(1e-6)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _tables(self) -> list[Table]:
        """Tables of the experiment: all that are known to the nodes that read its files."""
        kinds = [kind for name, kind in self._kinds.items() if name not in self._own_files]
        known = {table.node: table for kind in kinds for table in kind.tables}
        return list((known | {kind.table.node: kind.table for kind in kinds}).values())

    def _endpoint(self, node: str) -> MemoryEndpoint:
        return next(each for each in self._transports[node].endpoints if each.path == node)
