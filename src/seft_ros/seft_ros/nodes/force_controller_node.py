"""Node ``force_controller``: answers each state and its reference force with the valve command."""

import math
from dataclasses import replace

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import WireError
from seft_msgs_py.node.node_shell import IDLE_WAIT, WARM_UP_STEPS, NodeBody, NodeKind, NodeShell
from seft_msgs_py.node.transport import AwakeClock
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import OK, WARN, Status
from seft_msgs_py.wire.outcome import MOVING, REHEARSES, tripped_status
from seft_msgs_py.wire.topics import rehearsed
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.command import stop_period
from seft_plant_sim.judge.detector_list import TRACKING, WARNING

from seft_ros.force_controller import force_controller_parameters as parameters
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.received_forces import PENDING, MatchedForces, NewestPreview
from seft_ros.test_run.parameter_tables import TABLES
from seft_ros.test_run.state_machine import SampleOrder, check_magnitude

_REPORT_PERIOD = 1.0  # s between two reports of link and valves while a test runs


class ForceControllerNode(NodeBody):
    """Matches states with reference forces by step, and answers both.

    If the reference force comes over a link, it answers each state at once with the force that the
    newest message has for its step.

    After a trip it answers every further state with the commands of a stop, from that step until
    rest. Before, it sends the fallback stop, which would begin now. It sends nothing without a
    state: if the rig's states are missing, 0 V for its last step would be stale.
    """

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        experiment = shell.experiment
        section, timebase = experiment["force_controller"], experiment.timebase
        self._timebase = timebase
        rig, axes = shell.rig, shell.rig.axes
        self._controller = self._interlock()
        self._estimates = getattr(self._controller.controller, "estimates", None)
        self._command_codec = TrajectoryCodec(topics.VALVE_COMMAND.of(rig), axes, timebase)
        self._publish = shell.publisher(self._command_codec.topic)
        self._stop_codec = TrajectoryCodec(topics.STOP_COMMAND.of(rig), axes, timebase)
        self._publish_stop = shell.publisher(self._stop_codec.topic)
        self._stop_steps = stop_period(timebase.dt)
        self._states: dict[int, Floats] = {}
        is_linked = bool(section["loop_delay"])
        self._previews = NewestPreview(section, len(axes), timebase) if is_linked else None
        self._forces = self._previews or MatchedForces()
        self._reported_at = self._waited = 0.0
        self._moving = False  # by the supervisor's state
        self._order = SampleOrder(timebase)
        self._timeout: float = section["watchdog.command_timeout"]
        self._awake = AwakeClock(self._clock.monotonic, longest_gap=self._timeout / 4)
        self._heard_at = math.inf  # time of the last state, s; no more are expected
        self._refused_before = 0  # messages, until the last state arrived
        self._warm_up()
        shell.subscribe(topics.EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        if self._previews is not None:
            send_back = shell.publisher(topics.LINK_PONG.of(rig))
            shell.subscribe(topics.LINK_PING.of(rig), lambda raw, _: send_back(raw), reliable=False)
        follows = section["method"] in parameters.FOLLOW_TARGETS
        topic = topics.TARGET if follows else topics.REFERENCE_FORCE
        self._force_codec = TrajectoryCodec(topic, experiment.axes, timebase)
        self._settled = 1 + max(section["loop_delay"], 0)
        self._state_codec = TrajectoryCodec(topics.RIG_STATE.of(rig), axes, timebase)
        # the reference force is one message for all rigs
        self._places = list(rig.places) if rig.name else slice(None)
        shell.subscribe(topic, self._on_force, reliable=False)
        if len(experiment.rigs) == 1 and self._previews is None:
            # a separate controller, so that a rehearsal does not influence a test
            self._rehearsing: Interlock | None = None
            self._rehearsed: dict[int, Floats] = {}  # samples by step
            self.facts = {REHEARSES: True}
            self._publish_rehearsed = shell.publisher(rehearsed(topics.VALVE_COMMAND))
            shell.subscribe(rehearsed(topics.RIG_STATE), self._on_rehearsed_state, reliable=False)
            shell.subscribe(rehearsed(topic), self._on_rehearsed_force, reliable=False)
        shell.subscribe(self._state_codec.topic, self._on_state, reliable=False)

    def _interlock(self) -> Interlock:
        experiment, rig = self._shell.experiment, self._shell.rig
        section, timebase = experiment["force_controller"], experiment.timebase
        return Interlock.from_parameters(section, experiment.axes, timebase, rig)

    def _warm_up(self) -> None:
        axes = len(self._shell.rig.axes)
        points, state = np.zeros((1, 1, axes)), np.zeros((len(topics.RIG_STATE.quantities), axes))
        for step in range(WARM_UP_STEPS):
            raw = self._command_codec.encode(step, self._controller.step(step, points, state))
            self._command_codec.decode(raw)
        self._controller.reset()

    def begin(self) -> None:
        """Report that the node is ready."""
        self._report()

    def poll(self) -> None:
        """Trip if states are missing."""
        if self._awake.time() - self._heard_at > self._timeout:
            unexpected = self._shell.name_unexpected_publishers(self._refused_before)
            last = f"(the last is of step {self._order.last}); is rig running?{unexpected}"
            self._trip(f"no rig/state for {self._timeout:g} s {last}", self._timeout)

    def fault(self, reason: str) -> None:
        """Answer with 0 V from now on."""
        self._trip(reason)

    def period(self) -> float:
        """Poll in time for the watchdog."""
        return min(IDLE_WAIT, self._timeout / 8) if self._heard_at < math.inf else IDLE_WAIT

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        test = decode_state(raw)
        self._order.follow(test)
        moving, self._moving = self._moving, test.state in MOVING
        if not self._moving:
            self._heard_at = math.inf
            if moving:
                self._report()  # the complete result
        if test.state == "idle" and self._controller.reason:  # after a reset by the operator
            self._controller.reset()
            self._report()

    def _on_state(self, raw: bytes, _: int) -> None:
        step, values = self._state_codec.decode(raw)
        state = values[0]
        self._begin_with(step)
        name, newest = topics.RIG_STATE.name, max(self._states, default=-1)
        self._order.check(name, step)
        if step in self._states:
            raise WireError(f"{name} of step {step} a second time")
        if step < newest:
            raise WireError(f"{name} of step {step} after that of {newest}")
        was_tripped = bool(self._controller.reason)
        self._controller.look(step, state)
        if self._controller.reason and not was_tripped:
            self._report_trip()
        if step + 1 < self._order.steps and not self._order.in_lockstep:
            self._heard_at = self._awake.time()
            self._refused_before = self._shell.refused
        else:
            self._heard_at = math.inf  # the test is over, not known to run, or in lockstep
        if self._controller.reason:  # after a trip no reference force is needed
            self._answer(step, np.zeros((1, 1, state.shape[1])), state)
            return
        self._states[step] = state
        self._answer_complete()
        if len(self._states) > PENDING:
            self._states.pop(min(self._states))

    def _on_force(self, raw: bytes, _: int) -> None:
        step, values = self._force_codec.decode(raw)
        points, name = values[:, :, self._places], topics.REFERENCE_FORCE.name
        if self._controller.reason and step <= self._order.last:
            return
        check_magnitude(f"{name} of step", step, points[: self._settled, -1])
        self._begin_with(step)  # it may be read before its state
        if self._previews is None:
            self._order.check(name, step)
        elif step > self._order.last + 1:  # that step has not begun
            raise WireError(f"{name} of step {step} after step {self._order.last}: in the future")
        self._forces.take(step, points)
        self._answer_complete()

    def _on_rehearsed_state(self, raw: bytes, _: int) -> None:
        """Take a state of a rehearsal. The rig does not obey, so that nothing must trip."""
        step, values = self._state_codec.decode(raw)
        if self._rehearsing is None:
            self._rehearsing = self._interlock()
        if step == 0 or self._rehearsing.reason:
            self._rehearsing.reset()
            self._rehearsed.clear()
        self._rehearsed[step] = values[0]
        self._rehearsed = _after(self._rehearsed, step - PENDING)

    def _on_rehearsed_force(self, raw: bytes, _: int) -> None:
        """Answer a step of a rehearsal."""
        step, points = self._force_codec.decode(raw)
        if self._rehearsing is None or step not in self._rehearsed:
            return
        command = self._rehearsing.step(step, points, self._rehearsed[step])
        self._publish_rehearsed(self._command_codec.encode(step, command))
        self._rehearsed = _after(self._rehearsed, step)

    def _begin_with(self, step: int) -> None:
        """Begin a test, if a sample of this step is its first."""
        if step == 0:
            self._shell.catch_up(topics.EXPERIMENT_STATE)  # earlier messages do not end this test
        if not self._order.begins(step):
            return
        self._states.clear()
        self._forces.reset(self._order.in_lockstep)
        was_tripped, self._waited = bool(self._controller.reason), 0.0
        self._controller.reset()
        conflict = self._shell.senders.conflict()
        if conflict:
            self._trip(conflict)
        elif was_tripped:
            self._report()

    def _answer_complete(self) -> None:
        """Answer the steps, in their order, of which state and force have arrived."""
        for step in sorted(self._states):
            points = self._forces.points(step)
            if points is not None:
                self._answer(step, points, self._states[step])

    def _answer(self, step: int, points: Floats, state: Floats) -> None:
        controller = self._controller
        was_tripped = bool(controller.reason)
        command = controller.step(step, points, state)
        if controller.reason:
            self._publish(self._command_codec.encode_points(step, controller.stop(step)))
        else:
            self._publish(self._command_codec.encode(step, command))
            if controller.parameters.has_stop and step % self._stop_steps == 0:
                stop = controller.stop(step)  # after the answer there is time
                self._publish_stop(self._stop_codec.encode_points(step, stop))
        self._order.last = step
        self._states = _after(self._states, step)
        if controller.reason and not was_tripped:
            self._report_trip()
        previews = self._previews
        if previews is not None and previews.is_lost and not controller.reason:
            ago = step - previews.newest
            why = f"no {topics.REFERENCE_FORCE.name} for {ago} steps (the last is of step "
            why += f"{previews.newest}); is the link to the reference_force node cut?"
            self._trip(why, ago * self._timebase.dt)
        elif self._clock.monotonic() - self._reported_at >= _REPORT_PERIOD:
            self._report()  # after the answer there is time

    def _trip(self, reason: str, waited: float = 0.0) -> None:
        self._heard_at, self._waited = math.inf, waited
        self._controller.trip(max(self._order.last, 0), reason)
        self._report_trip()

    def _report_trip(self) -> None:
        self._shell.log("error", self._controller.reason)  # to read at this host
        self._report()

    def _report(self) -> None:
        self._reported_at = self._clock.monotonic()
        reason, step = self._controller.reason, self._controller.step_index
        share, watched = self._controller.off_target, f"detector {TRACKING.name}"
        status = Status("force_controller", OK, "ready", values={"phase": "ready"})
        if share >= WARNING:
            text = f"{watched} came to {share * 100:.0f} % of its threshold"
            status = replace(status, level=WARN, message=text)
        if reason:
            status = tripped_status("force_controller", reason, step, self._waited)
        values = {watched: f"{share:.2f} of its threshold"}
        if self._previews is not None:
            values["link"] = self._previews.report().to_json()
        for name, estimate in (self._estimates() if self._estimates else {}).items():
            for axis, value in zip(self._shell.rig.axes, estimate.tolist(), strict=True):
                values[f"{name} {axis}"] = f"{value:.4g}"
        self._shell.report(replace(status, values={**status.values, **values}))


def _after(kept: dict[int, Floats], step: int) -> dict[int, Floats]:
    """Forget the samples of steps that have passed."""
    return {other: sample for other, sample in kept.items() if other > step}


FORCE_CONTROLLER_NODE = NodeKind(parameters.FORCE_CONTROLLER_TABLE, TABLES, ForceControllerNode)
main = FORCE_CONTROLLER_NODE.main


if __name__ == "__main__":
    raise SystemExit(main())
