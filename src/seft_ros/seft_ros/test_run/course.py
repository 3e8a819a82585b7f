"""The course of a test, by the reports of its nodes and their silence."""

from collections.abc import Mapping, Sequence
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire import outcome
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.outcome import State, seconds
from seft_msgs_py.wire.topics import RigAxes, with_rigs

from seft_ros.test_run.peers import AT_REST_KEY, RAMPING_DOWN, LastStatus, missing, silence, silent
from seft_ros.test_run.state_machine import LOCKSTEP, StateMachine

SOFT_PEERS = ("ground_motion", "recorder")
"""Nodes without which the loop can still ramp the force down."""
MISSED_SHARE = "watchdog.missed_share"
RUNNING = "running"  # phase of a rig
STALL_TOLD = 0.1  # s within which a node that has stood still says so
LOCKSTEP_TIMEOUT_FACTOR = 10.0  # times the margin of realtime


class Course:
    """Drives a `StateMachine` by what nodes report, and by those that fall silent.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    descriptions : mapping
        Node name -> its description; others fill it.

    Attributes
    ----------
    machine : StateMachine
        The state of the test.
    peers, rig_nodes : list of str
        Nodes that the test needs, and the rigs among all.
    statuses : dict of str to LastStatus
        Node name -> last status.
    now : float
        Time of an `AwakeClock`, s, as whoever calls has set it.
    test_s : float
        Time of the test, s, likewise.
    state : State
        At the last `follow_state`.
    silent : list of str or None
        Nodes that were silent before a trip, once they are known.
    """

    def __init__(
        self, experiment: Experiment, descriptions: Mapping[str, Mapping[str, Any]], now: float
    ) -> None:
        self._section, self._rate = experiment["supervisor"], experiment.timebase.rate
        self._descriptions, self.now, self.test_s = descriptions, now, 0.0
        self.peers = with_rigs(self._section["peers"], experiment.rigs)
        self.rig_nodes = with_rigs([outcome.RIG], experiment.rigs)
        self._steps = 0  # of the running test
        self._timeout: float = self._section["watchdog.peer_timeout"]
        self.machine = StateMachine()
        self.statuses: dict[str, LastStatus] = {}
        self.state, self._since = State.IDLE, now
        self.silent: list[str] | None = None
        self._lost: set[str] = set()  # nodes that have become silent in this test
        self._took_part: set[str] = set()  # rigs that have run in it

    def hear(self, status: Status) -> None:
        """Take a node's status."""
        self.statuses[status.name] = LastStatus(status, self.now, self.test_s)

    def lack(self, rigs: Sequence[RigAxes]) -> str:
        """Say what a test of these rigs still lacks before it can start, see `missing`."""
        known = self.statuses, self._descriptions
        return missing(self.peers, *known, self.now, self._timeout, rigs)

    def look(self) -> None:
        """Look for nodes that are silent, and for a ramp that does not end."""
        if self.state in outcome.MOVING:
            self._watch_peers()
        elif self.state is State.TRIPPED and self.silent is None:
            self._find_the_silent()

    def follow_state(self) -> bool:
        """Say whether a state began; skip a ramp if there is no node for it."""
        machine = self.machine
        if machine.state is State.RAMPING_DOWN and "reference_force" not in self.peers:
            machine.at_rest()  # there is no node that ramps the force down
        if machine.state is self.state:
            return False
        self.state, self._since, self.silent = machine.state, self.now, None
        if self.state is State.RUNNING:
            self._lost.clear()
            self._took_part.clear()
            self.test_s = 0.0
            self._steps = self.ground_motion_steps()
        return True

    def _watch_peers(self) -> None:
        """Trip if a peer becomes silent, or if a ramp does not end."""
        gone = silent(self.peers, self.statuses, self.now, self._timeout)
        self._lost.update(gone)
        for node in sorted(gone, key=SOFT_PEERS.__contains__):
            self._trip(node, silence(node, self.statuses), self.step(), self._timeout)
        ramped_for = self.now - self._since if self.state is State.RAMPING_DOWN else 0.0
        if self.machine.state is State.RAMPING_DOWN and ramped_for > self._ramp_patience():
            why = f"the reference force has not become zero within {self._ramp_patience():g} s"
            self.machine.hard_trip(why, self.step())

    def _trip(self, node: str, reason: str, step: int | None, waited: float = 0.0) -> None:
        """Trip because of a node: softly, if the loop can continue without it."""
        if node in SOFT_PEERS:
            self.machine.soft_trip(reason, step, waited)
        else:
            by_rig = node in self.rig_nodes and reason != outcome.STOPPED
            self.machine.hard_trip(reason, step, waited, by_rig=by_rig)

    def _ramp_patience(self) -> float:
        margin = self._section["watchdog.ramp_margin"]
        if self.parameters(self.rig_nodes[0]).get("pace") == LOCKSTEP:
            margin *= LOCKSTEP_TIMEOUT_FACTOR
        return float(self.parameters("reference_force").get("ramp_down_time", 0.0)) + margin

    def _find_the_silent(self) -> None:
        """Find the nodes that were silent when the test tripped: they send nothing after that.

        A rig that was heard has still to say how the test ended.
        """
        known = [n for n in self.peers if n in self.statuses]
        old = {n for n in known if self.statuses[n].at < self._since}
        unheard = [n for n in known if n in old or self.phase(n) == RUNNING]
        gone = silent(unheard, self.statuses, self.now, self._timeout)
        if unheard == gone:
            self.silent = gone
            self._lost.update(gone)
            for node in gone:
                said = silence(node, self.statuses)
                if node in SOFT_PEERS or not self.machine.explain(said):
                    self.machine.note(said)

    def _explain(self, status: Status) -> None:
        """Note that a node had stood still when others waited for it: that is why they tripped.

        A trip is never delayed for that: who stands still can tell it only later. What the loop
        does not wait for explains its own silence alone; a rig that has ended only comes to rest.
        """
        stood = seconds(status, outcome.STOOD_STILL_KEY)
        name, machine = status.name, self.machine
        if not stood or self.phase(name) in (outcome.TRIPPED, outcome.FINISHED):
            return
        waited_for = name not in SOFT_PEERS or f"node {name} has been silent" in machine.detail
        if waited_for and self.now - stood <= self._since + STALL_TOLD:
            machine.explain(f"the {name} stood still for {stood:.3g} s", stood)

    def act(self, status: Status) -> None:
        """Act on a node's status."""
        self._explain(status)
        phase, reason = status.values.get("phase"), status.values.get("reason")
        is_rig = status.name in self.rig_nodes
        if phase == outcome.TRIPPED:
            reason, step = reason or status.message, status.number("step")
            cause = reason if is_rig else f"{status.name}: {reason}"
            if reason == outcome.STOPPED and self.machine.state in outcome.MOVING:
                cause = f"node {status.name} stopped at step {step}, and gives no reason"
            waited = seconds(status, outcome.WAITED_KEY)
            self._trip(status.name, cause, step, waited)
            if reason != outcome.STOPPED and not waited and (step or 0) <= (self.machine.step or 0):
                self.machine.explain(cause)
            if status.name in self._lost and reason != outcome.STOPPED:
                self.machine.note(cause)  # its trip while the link was cut
        elif is_rig:
            self._watch_missed(status)
            if phase == outcome.FINISHED:
                self._finish(status)
            elif phase == RUNNING:
                self._took_part.add(status.name)
            elif phase == State.IDLE and status.name in self._took_part:
                self.machine.hard_trip(f"node {status.name} has left the test", self.step())
        elif status.name == "recorder" and reason:
            self.machine.soft_trip(reason, self.step())
        elif status.name == "reference_force" and phase in (RAMPING_DOWN, AT_REST_KEY):
            if reason:
                self.machine.soft_trip(reason, status.number("step"))
            if phase == AT_REST_KEY:
                self.machine.at_rest()

    def _watch_missed(self, rig: Status) -> None:
        """Trip if a rig missed too large a share of a second's commands, by its count of steps.

        Softly: most commands still come, and the rig bridges the others.
        """
        most, allowed = rig.number("most_missed") or 0, self._section[MISSED_SHARE]
        second = round(self._rate)
        if most / second > allowed and MISSED_SHARE not in self.machine.detail:
            share = f"({most / second * 100:.1f} %; {MISSED_SHARE} allows {allowed * 100:.1f} %)"
            why = f"node {rig.name} missed {most} of {second} commands within a second {share}"
            self.machine.soft_trip(why, max((rig.number("steps") or 0) - 1, 0))

    def _finish(self, rig: Status) -> None:
        """Note that a rig has finished; trip if it has not taken all steps of the test."""
        steps = rig.number("steps") or 0
        if steps != self._steps:
            why = f"node {rig.name} finished after {steps} of {self._steps} steps"
            self.machine.hard_trip(why, max(steps - 1, 0))
        elif all(self.phase(name) == outcome.FINISHED for name in self.rig_nodes):
            self.machine.finish(f"{steps} steps done")

    def ground_motion_steps(self) -> int:
        """Give the steps of the next test; 0: not known."""
        motion = self.statuses.get("ground_motion")
        return (motion.status.number("steps") or 0) if motion else 0

    def phase(self, node: str) -> str:
        """Phase that a node has reported; empty if none."""
        return self.statuses[node].phase if node in self.statuses else ""

    def parameters(self, node: str) -> dict[str, Any]:
        """Parameters of a node, as it has described them."""
        parameters: dict[str, Any] = self._descriptions.get(node, {}).get("parameters", {})
        return parameters

    def step(self) -> int:
        """Step of the test by /clock, which is published every 0.1 s of the test."""
        return round(self.test_s * self._rate)
