"""Node ``supervisor``: starts, watches and ends a test.

It has the state machine, publishes the state latched on experiment/state, and serves start, stop,
estop and reset.
"""

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from seft_msgs_py.node.node_shell import IDLE_WAIT, NodeBody, NodeKind, NodeShell
from seft_msgs_py.node.transport import AwakeClock, Level
from seft_msgs_py.wire import messages, outcome, topics
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.messages import ERROR, OK, WARN, Status
from seft_msgs_py.wire.outcome import State

from seft_ros.test_run.course import RUNNING, Course
from seft_ros.test_run.parameter_tables import SUPERVISOR_TABLE, TABLES
from seft_ros.test_run.peers import RUNS, UNFIT, Rehearsed, check_peers, with_biases
from seft_ros.test_run.state_machine import ServiceAnswer

_HEARTBEAT = 0.2  # s between two publications of the state
GRAPH_PERIOD = 0.2  # s between two polls of the graph
STOOD_STILL = 1.0  # s without a poll; requests to start or reset expire after that time
_MAX_AT_ONCE = 1000  # messages between two polls, in a flood
LOG_LEVELS: dict[int, Level] = {OK: "info", WARN: "warning", ERROR: "error"}
START_AHEAD_NS = 200_000_000  # in this time the start reaches all rigs
FAULTY = ServiceAnswer(
    False, "a fault of the program; the supervisor's log has it, and a test is ended"
)


class SupervisorNode(NodeBody):
    """Takes the operator's requests, follows the `Course` of the test, and publishes its state."""

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        self._section = shell.experiment["supervisor"]
        self._rigs = shell.experiment.rigs
        self._start_ns = 0  # at which several rigs begin together
        self._lock = threading.Lock()
        self._awake = AwakeClock(self._clock.monotonic)
        self._descriptions: dict[str, dict[str, Any]] = {}
        self._course = Course(shell.experiment, self._descriptions, self._awake.time())
        self._looked_at, self._woke_at = self._clock.monotonic(), -STOOD_STILL
        self._publish = shell.publisher(topics.EXPERIMENT_STATE)
        self._published: ExperimentState | None = None
        self._logged = self._warned = ""  # the last line of the log, and of a rehearsal
        self._rehearsed = Rehearsed()
        self._published_at = self._polled_graph_at = self._course.now - GRAPH_PERIOD
        shell.subscribe(topics.DIAGNOSTICS, self._on_diagnostics)
        shell.subscribe(topics.DESCRIPTION, self._on_description, depth=64)
        shell.subscribe(topics.CLOCK_TOPIC, self._on_clock, wake=False)
        machine = self._course.machine
        requests = {"start": machine.start, "stop": machine.stop, "estop": machine.estop}
        for name, request in {**requests, "reset": self._reset}.items():
            shell.serve(name, partial(self._serve, name, request))

    def begin(self) -> None:
        """Report that it watches."""
        self.report("watching")

    def run(self) -> None:
        """Supervise until the process ends."""
        while not self._shell.stopping:
            self._shell.spin_once(IDLE_WAIT)
            for _ in range(_MAX_AT_ONCE):
                if not self._shell.spin_once(0.0):
                    break  # a node is silent only if none of these messages is its own
            self._shell.attempt("a poll", self.poll)

    def fault(self, reason: str) -> None:
        """End a test at once; the services still answer."""
        with self._lock:
            self._course.machine.hard_trip(reason, self._course.step())
            self._publish_if_due()

    def poll(self) -> None:
        """Watch the peers, and publish the state if it has changed or is due."""
        with self._lock:
            before, self._looked_at = self._looked_at, self._clock.monotonic()
            if self._looked_at - before > STOOD_STILL:
                self._woke_at = self._looked_at
            self._course.now = self._awake.time()
            self._follow_state()
            if self._course.state in (State.IDLE, State.READY):
                self._poll_graph()
            else:
                self._course.look()
            self._publish_if_due()

    def _follow_state(self) -> None:
        """Tell the wiring of a state that begins, and the rigs when to begin together."""
        if self._course.follow_state():
            self._shell.senders.follow(self._course.state)
            if self._course.state is State.RUNNING:
                self._start_ns = self._clock.time_ns() + START_AHEAD_NS

    def _poll_graph(self) -> None:
        course = self._course
        if course.now - self._polled_graph_at < GRAPH_PERIOD:  # it takes a millisecond
            return
        self._polled_graph_at = course.now
        course.hear(Status("supervisor", OK, "watching", values=self._shell.matched()))
        lack = course.lack(self._rigs)
        if not lack and (twins := self._shell.senders.conflict()):
            lack = f"the end of a node that is not this test's: {twins}"
        course.machine.peers(lack or self._rehearsal())

    def _rehearsal(self) -> str:
        """Rehearse the loop, and say what a test still needs; empty if nothing."""
        nodes = {name: self._descriptions.get(name, {}) for name in self._course.peers}
        found = check_peers(self._section["rehearsal.duration"], nodes)
        rigs = [nodes[name] for name in self._course.rig_nodes if name in nodes]
        self._rehearsed = found = with_biases(found, rigs)
        if found.warning and found.warning != self._warned:
            self._warned = found.warning
            self._shell.log("warning", found.warning)
        if found.asked:
            return RUNS
        return f"{UNFIT}{found.refusal}" if found.refusal else ""

    def _reset(self) -> ServiceAnswer:
        """Allow a new test to start; if a rehearsal prevents it, request another one."""
        course = self._course
        is_unfit = course.machine.state is State.IDLE and self._rehearsed.refusal
        if is_unfit and self._descriptions[outcome.RIG].pop(outcome.REHEARSED, None) is not None:
            return ServiceAnswer(True, "the loop is rehearsed again")
        moving = any(course.phase(node) == RUNNING for node in course.rig_nodes)
        return course.machine.reset(moving=moving)

    def _serve(self, name: str, request: Callable[[], ServiceAnswer]) -> tuple[bool, str]:
        found = self._shell.attempt("a service", self._answer, name, request) or FAULTY
        return found.accepted, found.text

    def _answer(self, name: str, request: Callable[[], ServiceAnswer]) -> ServiceAnswer:
        """Act on a request, unless it may have waited while this process stalled; a stop may."""
        with self._lock:
            now = self._clock.monotonic()
            stalled = now - self._looked_at > STOOD_STILL or now - self._woke_at < STOOD_STILL
            if stalled and name in ("start", "reset"):
                return ServiceAnswer(False, f"can't {name}: {outcome.STALLED}")
            found = request()
            self._publish_if_due()
        return found

    def _publish_if_due(self) -> None:
        """Publish the state when it has changed, and as a heartbeat."""
        self._follow_state()
        course, machine = self._course, self._course.machine
        step, timebase = machine.step, self._shell.experiment.timebase
        asked = self._rehearsed.asked if machine.state is State.IDLE else 0.0
        several = len(self._rigs) > 1 and machine.state in outcome.MOVING
        test = ExperimentState(
            machine.state,
            machine.detail,
            steps=course.ground_motion_steps() if "ground_motion" in course.statuses else None,
            step=step,
            time_s=None if step is None else timebase.stamp_ns(step) / 1e9,
            pace=str(course.parameters(course.rig_nodes[0]).get("pace", "")),
            silent=None if course.silent is None else tuple(course.silent),
            start_ns=self._start_ns if several else None,
            rehearse=asked,
            zeroing=self._section["calibration.zeroing"] if asked else 0.0,
        )
        if test == self._published and course.now - self._published_at < _HEARTBEAT:
            return
        self._published, self._published_at = test, course.now
        self._publish(encode_state(test))
        self._log(test.level)

    def _log(self, level: int) -> None:
        """Log the state if it is new."""
        if (line := self._course.machine.log_line) != self._logged:
            self._logged = line
            self._shell.log(LOG_LEVELS[level], line)

    def _on_diagnostics(self, raw: bytes, _: int) -> None:
        for status in messages.decode_diagnostics(raw)[1]:
            self._course.now = self._awake.time()
            self._course.hear(status)
            with self._lock:
                self._course.act(status)
                self._publish_if_due()

    def _on_description(self, raw: bytes, _: int) -> None:
        node, description = messages.decode_description(raw)
        self._descriptions[node] = description

    def _on_clock(self, raw: bytes, _: int) -> None:
        self._course.test_s = messages.decode_clock(raw) / topics.NANOSECONDS_PER_SECOND


SUPERVISOR_NODE = NodeKind(SUPERVISOR_TABLE, TABLES, SupervisorNode)
main = SUPERVISOR_NODE.main


if __name__ == "__main__":
    raise SystemExit(main())
