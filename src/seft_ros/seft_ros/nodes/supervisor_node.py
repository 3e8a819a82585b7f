"""Node ``supervisor``: starts, watches and ends a test.

It has the state machine, publishes the state latched on experiment/state, and serves start, stop,
estop and reset.
"""

import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from seft_msgs_py.node.clock import AwakeClock
from seft_msgs_py.node.node_kind import NodeKind
from seft_msgs_py.node.node_shell import NodeBody, NodeShell
from seft_msgs_py.node.transport import Level
from seft_msgs_py.wire.experiment_state import ExperimentState, encode_state
from seft_msgs_py.wire.messages import (
    ERROR,
    OK,
    WARN,
    Status,
    decode_clock,
    decode_description,
    decode_diagnostics,
)
from seft_msgs_py.wire.outcome import (
    FINISHED,
    MOVING,
    REHEARSED,
    RIG,
    STALLED,
    STOOD_STILL_KEY,
    STOPPED,
    TRIPPED,
    WAITED_KEY,
    State,
    seconds,
)
from seft_msgs_py.wire.topics import (
    CLOCK_TOPIC,
    DESCRIPTION,
    DIAGNOSTICS,
    EXPERIMENT_STATE,
    NANOSECONDS_PER_SECOND,
    with_rigs,
)

from seft_ros.test_run.parameter_tables import SUPERVISOR_TABLE, TABLES
from seft_ros.test_run.peers import (
    AT_REST_KEY,
    RAMPING_DOWN,
    RUNS,
    UNFIT,
    LastStatus,
    Rehearsed,
    check_peers,
    missing,
    silence,
    silent,
    with_biases,
)
from seft_ros.test_run.state_machine import LOCKSTEP, ServiceAnswer, StateMachine

_HEARTBEAT = 0.2  # s between two publications of the state
GRAPH_PERIOD = 0.2  # s between two polls of the graph
STOOD_STILL = 1.0  # s without a poll; requests to start or reset expire after that time
_MAX_AT_ONCE = 1000  # messages between two polls, in a flood
LOG_LEVELS: dict[int, Level] = {OK: "info", WARN: "warning", ERROR: "error"}
SOFT_PEERS = ("ground_motion", "recorder")
"""Nodes without which the loop can still ramp the force down."""
START_AHEAD_NS = 200_000_000  # in this time the start reaches all rigs
MISSED_SHARE = "watchdog.missed_share"
RUNNING = "running"  # phase of a rig
STALL_TOLD = 0.1  # s within which a node that has stood still says so
LOCKSTEP_TIMEOUT_FACTOR = 10.0  # times the margin of realtime
FAULTY = ServiceAnswer(
    False, "a fault of the program; the supervisor's log has it, and a test is ended"
)


class SupervisorNode(NodeBody):
    """Drives a `StateMachine` by the nodes' reports and the operator's requests."""

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        self._section = shell.experiment["supervisor"]
        self._rigs = shell.experiment.rigs
        self._peers = with_rigs(self._section["peers"], self._rigs)
        self._rig_nodes = with_rigs([RIG], self._rigs)
        self._steps = 0  # of the running test
        self._start_ns = 0  # at which several rigs begin together
        self._timeout: float = self._section["watchdog.peer_timeout"]
        self._machine = StateMachine()
        self._lock = threading.Lock()
        self._awake = AwakeClock(self._clock.monotonic)
        self._now = self._awake.time()
        self._looked_at, self._woke_at = self._clock.monotonic(), -STOOD_STILL
        self._test_s = 0.0
        self._statuses: dict[str, LastStatus] = {}
        self._descriptions: dict[str, dict[str, Any]] = {}
        self._publish = shell.publisher(EXPERIMENT_STATE)
        self._state, self._since = State.IDLE, self._now  # at the last poll
        self._silent: list[str] | None = None  # nodes silent before a trip, once known
        self._lost: set[str] = set()  # nodes that have become silent in this test
        self._took_part: set[str] = set()  # rigs that have run in it
        self._published: ExperimentState | None = None
        self._logged = self._warned = ""  # the last line of the log, and of a rehearsal
        self._rehearsed = Rehearsed()
        self._published_at = self._polled_graph_at = self._now - GRAPH_PERIOD
        shell.subscribe(DIAGNOSTICS, self._on_diagnostics)
        shell.subscribe(DESCRIPTION, self._on_description, depth=64)
        shell.subscribe(CLOCK_TOPIC, self._on_clock, wake=False)
        machine = self._machine
        requests = {"start": machine.start, "stop": machine.stop, "estop": machine.estop}
        for name, request in {**requests, "reset": self._reset}.items():
            shell.serve(name, partial(self._serve, name, request))

    def begin(self) -> None:
        """Report that it watches."""
        self.report("watching")

    def run(self) -> None:
        """Supervise until the process ends."""
        while not self._shell.stopping:
            self._shell.spin_once()
            for _ in range(_MAX_AT_ONCE):
                if not self._shell.spin_once(0.0):
                    break  # a node is silent only if none of these messages is its own
            self._shell.attempt("a poll", self.poll)

    def fault(self, reason: str) -> None:
        """End a test at once; the services still answer."""
        with self._lock:
            self._machine.hard_trip(reason, self._step())
            self._publish_if_due()

    def poll(self) -> None:
        """Watch the peers, and publish the state if it has changed or is due."""
        with self._lock:
            before, self._looked_at = self._looked_at, self._clock.monotonic()
            if self._looked_at - before > STOOD_STILL:
                self._woke_at = self._looked_at
            self._now = self._awake.time()
            self._follow_state()
            if self._state in (State.IDLE, State.READY):
                self._poll_graph()
            elif self._state in MOVING:
                self._watch_peers()
            elif self._state is State.TRIPPED and self._silent is None:
                self._find_the_silent()
            self._publish_if_due()

    def _follow_state(self) -> None:
        """Note when a state began; skip a ramp if there is no node for it."""
        machine = self._machine
        if machine.state is State.RAMPING_DOWN and "reference_force" not in self._peers:
            machine.at_rest()  # there is no node that ramps the force down
        if machine.state is not self._state:
            self._state, self._since, self._silent = machine.state, self._now, None
            self._shell.senders.follow(machine.state)
            if self._state is State.RUNNING:
                self._lost.clear()
                self._took_part.clear()
                self._test_s = 0.0
                self._steps = self._ground_motion_steps()
                self._start_ns = self._clock.time_ns() + START_AHEAD_NS

    def _poll_graph(self) -> None:
        if self._now - self._polled_graph_at < GRAPH_PERIOD:  # it takes a millisecond
            return
        self._polled_graph_at = self._now
        own = Status("supervisor", OK, "watching", values=self._shell.matched())
        self._statuses["supervisor"] = LastStatus(own, self._now)
        statuses, described = self._statuses, self._descriptions
        lack = missing(self._peers, statuses, described, self._now, self._timeout, self._rigs)
        if not lack and (twins := self._shell.senders.conflict()):
            lack = f"the end of a node that is not this test's: {twins}"
        self._machine.peers(lack or self._rehearsal())

    def _rehearsal(self) -> str:
        """Rehearse the loop, and say what a test still needs; empty if nothing."""
        nodes = {name: self._descriptions.get(name, {}) for name in self._peers}
        found = check_peers(self._section["rehearsal.duration"], nodes)
        rigs = [nodes[name] for name in self._rig_nodes if name in nodes]
        self._rehearsed = found = with_biases(found, rigs)
        if found.warning and found.warning != self._warned:
            self._warned = found.warning
            self._shell.log("warning", found.warning)
        if found.asked:
            return RUNS
        return f"{UNFIT}{found.refusal}" if found.refusal else ""

    def _watch_peers(self) -> None:
        """Trip if a peer becomes silent, or if a ramp does not end."""
        gone = silent(self._peers, self._statuses, self._now, self._timeout)
        self._lost.update(gone)
        for node in sorted(gone, key=SOFT_PEERS.__contains__):
            self._trip(node, silence(node, self._statuses), self._step(), self._timeout)
        ramped_for = self._now - self._since if self._state is State.RAMPING_DOWN else 0.0
        if self._machine.state is State.RAMPING_DOWN and ramped_for > self._ramp_patience():
            self._machine.hard_trip(
                f"the reference force has not become zero within {self._ramp_patience():g} s",
                self._step(),
            )

    def _trip(self, node: str, reason: str, step: int | None, waited: float = 0.0) -> None:
        """Trip because of a node: softly, if the loop can continue without it."""
        trip = self._machine.soft_trip if node in SOFT_PEERS else self._machine.hard_trip
        trip(reason, step, waited)

    def _ramp_patience(self) -> float:
        margin = self._section["watchdog.ramp_margin"]
        if self._parameters(self._rig_nodes[0]).get("pace") == LOCKSTEP:
            margin *= LOCKSTEP_TIMEOUT_FACTOR
        return float(self._parameters("reference_force").get("ramp_down_time", 0.0)) + margin

    def _find_the_silent(self) -> None:
        """Find the nodes that were silent when the test tripped: they send nothing after that.

        A rig that was heard has still to say how the test ended.
        """
        known = [n for n in self._peers if n in self._statuses]
        unheard = [
            n for n in known if self._statuses[n].at < self._since or self._phase(n) == RUNNING
        ]
        gone = silent(unheard, self._statuses, self._now, self._timeout)
        if unheard == gone:
            self._silent = gone
            self._lost.update(gone)
            for node in gone:
                said = silence(node, self._statuses)
                if node in SOFT_PEERS or not self._machine.explain(said):
                    self._machine.note(said)

    def _reset(self) -> ServiceAnswer:
        """Allow a new test to start; if a rehearsal prevents it, request another one."""
        is_unfit = self._machine.state is State.IDLE and self._rehearsed.refusal
        if is_unfit and self._descriptions[RIG].pop(REHEARSED, None) is not None:
            return ServiceAnswer(True, "the loop is rehearsed again")
        return self._machine.reset(moving=any(self._phase(n) == "running" for n in self._rig_nodes))

    def _serve(self, name: str, request: Callable[[], ServiceAnswer]) -> tuple[bool, str]:
        found = self._shell.attempt("a service", self._answer, name, request) or FAULTY
        return found.accepted, found.text

    def _answer(self, name: str, request: Callable[[], ServiceAnswer]) -> ServiceAnswer:
        """Act on a request, unless it may have waited while this process stalled; a stop may."""
        with self._lock:
            now = self._clock.monotonic()
            stalled = now - self._looked_at > STOOD_STILL or now - self._woke_at < STOOD_STILL
            if stalled and name in ("start", "reset"):
                return ServiceAnswer(False, f"can't {name}: {STALLED}")
            found = request()
            self._publish_if_due()
        return found

    def _publish_if_due(self) -> None:
        """Publish the state when it has changed, and as a heartbeat."""
        self._follow_state()
        machine = self._machine
        step, timebase = machine.step, self._shell.experiment.timebase
        asked = self._rehearsed.asked if machine.state is State.IDLE else 0.0
        several = len(self._rigs) > 1 and machine.state in MOVING
        test = ExperimentState(
            machine.state,
            machine.detail,
            steps=self._ground_motion_steps() if "ground_motion" in self._statuses else None,
            step=step,
            time_s=None if step is None else timebase.stamp_ns(step) / 1e9,
            pace=str(self._parameters(self._rig_nodes[0]).get("pace", "")),
            silent=None if self._silent is None else tuple(self._silent),
            start_ns=self._start_ns if several else None,
            rehearse=asked,
            zeroing=self._section["calibration.zeroing"] if asked else 0.0,
        )
        if test == self._published and self._now - self._published_at < _HEARTBEAT:
            return
        self._published, self._published_at = test, self._now
        self._publish(encode_state(test))
        self._log(test.level)

    def _log(self, level: int) -> None:
        """Log the state if it is new."""
        line = self._machine.log_line
        if line != self._logged:
            self._logged = line
            self._shell.log(LOG_LEVELS[level], line)

    def _on_diagnostics(self, raw: bytes, _: int) -> None:
        for status in decode_diagnostics(raw)[1]:
            self._now = self._awake.time()
            self._statuses[status.name] = LastStatus(status, self._now, self._test_s)
            with self._lock:
                self._explain(status)
                self._follow(status)
                self._publish_if_due()

    def _follow(self, status: Status) -> None:
        """Act on a node's status."""
        phase, reason = status.values.get("phase"), status.values.get("reason")
        is_rig = status.name in self._rig_nodes
        if phase == TRIPPED:
            reason, step = reason or status.message, status.number("step")
            cause = reason if is_rig else f"{status.name}: {reason}"
            if reason == STOPPED and self._machine.state in MOVING:
                cause = f"node {status.name} stopped at step {step}, and gives no reason"
            waited = seconds(status, WAITED_KEY)
            self._trip(status.name, cause, step, waited)
            if reason != STOPPED and not waited and (step or 0) <= (self._machine.step or 0):
                self._machine.explain(cause)
            if status.name in self._lost and reason != STOPPED:
                self._machine.note(cause)  # its trip while the link was cut
        elif is_rig:
            self._watch_missed(status)
            if phase == FINISHED:
                self._finish(status)
            elif phase == RUNNING:
                self._took_part.add(status.name)
            elif phase == State.IDLE and status.name in self._took_part:
                self._machine.hard_trip(f"node {status.name} has left the test", self._step())
        elif status.name == "recorder" and reason:
            self._machine.soft_trip(reason, self._step())
        elif status.name == "reference_force" and phase in (RAMPING_DOWN, AT_REST_KEY):
            if reason:
                self._machine.soft_trip(reason, status.number("step"))
            if phase == AT_REST_KEY:
                self._machine.at_rest()

    def _explain(self, status: Status) -> None:
        """Note that a node had stood still when others waited for it: that is why they tripped.

        A trip is never delayed for that: who stands still can tell it only later. What the loop
        does not wait for explains its own silence alone; a rig that has ended only comes to rest.
        """
        stood = seconds(status, STOOD_STILL_KEY)
        name, machine = status.name, self._machine
        if not stood or self._phase(name) in (TRIPPED, FINISHED):
            return
        waited_for = name not in SOFT_PEERS or f"node {name} has been silent" in machine.detail
        if waited_for and self._now - stood <= self._since + STALL_TOLD:
            machine.explain(f"the {name} stood still for {stood:.3g} s", stood)

    def _watch_missed(self, rig: Status) -> None:
        """Trip if a rig missed too large a share of a second's commands, by its count of steps.

        Softly: most commands still come, and the rig bridges the others.
        """
        most, allowed = rig.number("most_missed") or 0, self._section[MISSED_SHARE]
        second = round(self._shell.experiment.timebase.rate)
        if most / second > allowed and MISSED_SHARE not in self._machine.detail:
            self._machine.soft_trip(
                f"node {rig.name} missed {most} of {second} commands within a second "
                f"({most / second:.1%}; {MISSED_SHARE} allows {allowed:.1%})",
                max((rig.number("steps") or 0) - 1, 0),
            )

    def _finish(self, rig: Status) -> None:
        """Note that a rig has finished; trip if it has not taken all steps of the test."""
        steps = rig.number("steps") or 0
        if steps != self._steps:
            self._machine.hard_trip(
                f"node {rig.name} finished after {steps} of {self._steps} steps",
                max(steps - 1, 0),
            )
        elif all(self._phase(name) == FINISHED for name in self._rig_nodes):
            self._machine.finish(f"{steps} steps done")

    def _on_description(self, raw: bytes, _: int) -> None:
        node, description = decode_description(raw)
        self._descriptions[node] = description

    def _on_clock(self, raw: bytes, _: int) -> None:
        self._test_s = decode_clock(raw) / NANOSECONDS_PER_SECOND

    def _ground_motion_steps(self) -> int:
        motion = self._statuses.get("ground_motion")
        return (motion.status.number("steps") or 0) if motion else 0

    def _phase(self, node: str) -> str:
        return self._statuses[node].phase if node in self._statuses else ""

    def _parameters(self, node: str) -> dict[str, Any]:
        parameters: dict[str, Any] = self._descriptions.get(node, {}).get("parameters", {})
        return parameters

    def _step(self) -> int:
        """Step of the test by /clock, which is published every 0.1 s of the test."""
        return round(self._test_s * self._shell.experiment.timebase.rate)


SUPERVISOR_NODE = NodeKind(SUPERVISOR_TABLE, TABLES, SupervisorNode)
main = SUPERVISOR_NODE.main


if __name__ == "__main__":
    sys.exit(main())
