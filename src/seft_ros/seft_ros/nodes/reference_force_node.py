"""Node ``reference_force``: answers each rig/state with the reference force of its step.

It ramps the force down on request of the supervisor, or after a fault of the force. Phases: ready,
ramping_down, at_rest, ended.
"""

from functools import partial

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import WireError
from seft_msgs_py.node.node_shell import IDLE_WAIT, WARM_UP_STEPS, NodeBody, NodeKind, NodeShell
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import ERROR, OK, EstimatesCodec
from seft_msgs_py.wire.outcome import ENDED, REHEARSES, State, tripped_status
from seft_msgs_py.wire.topics import rehearsed
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.protection.protected_force import ProtectedForce
from seft_ros.reference_force import reference_force_block as block
from seft_ros.reference_force import reference_force_parameters as parameters
from seft_ros.test_run.parameter_tables import TABLES
from seft_ros.test_run.peers import ALL_ANSWERED, AT_REST_KEY, RAMPING_DOWN
from seft_ros.test_run.state_machine import SampleOrder, check_magnitude

RIG_POLL = 0.002  # s between polls for the state of a late rig


class ReferenceForceNode(NodeBody):
    """Matches states and ground motion by step and moves them through a `ProtectedForce`."""

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        experiment = shell.experiment
        section = experiment["reference_force"]
        axes, timebase = experiment.axes, experiment.timebase
        self._block = self._protected_force()
        self._window = 1 + self._block.preview
        self._delay = max(section["loop_delay"], 0)
        topic = parameters.reference_force_topic(section)
        self._motion_codec = TrajectoryCodec(topics.GROUND_MOTION, axes, timebase)
        self._force_codec = TrajectoryCodec(topic, axes, timebase)
        self._state_codecs = [
            TrajectoryCodec(topics.RIG_STATE.of(rig), rig.axes, timebase) for rig in experiment.rigs
        ]
        self._gathering: block.StateGathering | None = None
        if len(experiment.rigs) > 1:
            self._gathering = block.StateGathering(experiment.rigs, section["watchdog.rig_timeout"])
        self._sampler = block.EstimateSampler(self._block.reference_force, timebase)
        self._estimates_codec = EstimatesCodec(axes, timebase)
        self._publish = shell.publisher(topic)
        self._publish_estimates = shell.publisher(topics.ESTIMATES)
        self._motion = block.MotionBuffer(len(axes))
        self._waiting: dict[int, Floats] = {}
        self._order = SampleOrder(timebase, self._delay)
        self._conflict = ""  # why this test is not answered
        self._test = ""  # state of the test, from the supervisor
        self._phase = ""
        self._cause_step = self._ramp_step = -1
        self._warm_up()
        if self._gathering is None and not self._delay:
            # a separate block, so that a rehearsal does not influence a test
            self._rehearsing: ProtectedForce | None = None
            self.facts = {REHEARSES: True}
            self._publish_rehearsed = shell.publisher(rehearsed(topic))
            shell.subscribe(rehearsed(topics.RIG_STATE), self._on_rehearsed_state, reliable=False)
        shell.subscribe(topics.EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        shell.subscribe(topics.GROUND_MOTION, self._on_ground_motion)
        # behind a link, a late node bridges old states instead of answering them
        depth = 2 * (2 + self._delay) if self._delay else None
        for number, codec in enumerate(self._state_codecs):
            receive = partial(self._on_rig_state, number)
            shell.subscribe(codec.topic, receive, depth=depth, reliable=False)

    def begin(self) -> None:
        """Report that the node is ready."""
        self._report("ready")

    def poll(self) -> None:
        """Trip if the states of one of several rigs are missing."""
        running = self._order.steps and not self._order.in_lockstep
        if self._gathering is not None and running and not self._conflict:
            lost = self._gathering.lost(self._clock.monotonic())
            waited = self._shell.experiment["reference_force"]["watchdog.rig_timeout"]
            self._trip_for(lost, max(self._order.last, 0), waited)

    def fault(self, reason: str) -> None:
        """End the test: no more states are answered."""
        self._trip_for(reason, max(self._order.last, 0))

    def period(self) -> float:
        """Poll soon while the state of a rig is late."""
        waiting = self._gathering is not None and self._gathering.is_waiting
        return RIG_POLL if waiting else IDLE_WAIT

    def _protected_force(self) -> ProtectedForce:
        experiment = self._shell.experiment
        section = experiment["reference_force"]
        return ProtectedForce.from_parameters(section, experiment.axes, experiment.timebase)

    def _warm_up(self) -> None:
        axes = len(self._shell.experiment.axes)
        motion = np.zeros((self._window, axes))
        state = np.zeros((len(topics.RIG_STATE.quantities), axes))
        for step in range(WARM_UP_STEPS):
            for codec in self._state_codecs:
                codec.decode(codec.encode(step, state[:, : len(codec.axes)]))
            self._message(step, motion, state[:4])
            self._order.last = step
            if step >= self._sampler.due and (estimates := self._sampler.sample(step)):
                self._estimates_codec.decode(self._estimates_codec.encode(step, estimates))
        self._order.last = -1
        self._reset()

    def _reset(self) -> None:
        self._cause_step = self._ramp_step = -1
        self._waiting.clear()
        if self._gathering is not None:
            self._gathering.reset()
        self._block.reset()
        self._sampler.reset()
        self._follow_test()

    def _on_ground_motion(self, raw: bytes, _: int) -> None:
        first, values = self._motion_codec.decode(raw)
        check_magnitude("ground_motion from step", first, values)
        if first == 0:  # a new motion, from its beginning
            in_flight = self._order.steps and not self._order.may_begin
            if in_flight and self._order.last >= 0:  # before, a state overtook its motion
                raise WireError("a new ground_motion in the middle of a test")
            self._order.last = -1
        self._motion.drop_before(self._order.last)
        if not self._motion.add(first, values[:, 0]):
            raise WireError(f"ground_motion from step {first} on: steps before it are missing")
        self._answer_waiting()

    def _on_rig_state(self, rig: int, raw: bytes, _: int) -> None:
        step, values = self._state_codecs[rig].decode(raw)
        sample = values[0, : len(CHANNELS)]
        check_magnitude("rig/state of step", step, sample)
        if step == 0:
            self._shell.catch_up(topics.EXPERIMENT_STATE)  # earlier messages do not end this test
        if self._test in ENDED:
            raise WireError(f"rig/state of step {step}: the test is {self._test}")
        if self._order.begins(step):
            self._reset()
            self._trip_for(self._shell.senders.conflict(), step)
        elif false_start := self._order.false_start(topics.RIG_STATE.name, step):
            self._trip_for(self._conflict or false_start, step)
        self._order.check(topics.RIG_STATE.name, step)
        if step in self._waiting:
            raise WireError(f"rig/state of step {step} a second time")
        state: Floats | None = sample
        if self._gathering is not None:
            state = self._gathering.take(rig, step, sample, self._clock.monotonic())
        if state is not None and not self._conflict:
            self._answer(step, state)

    def _on_rehearsed_state(self, raw: bytes, _: int) -> None:
        """Answer a state of a rehearsal, with the ground at rest; it can't trip."""
        step, values = self._state_codecs[0].decode(raw)
        if self._rehearsing is None:
            self._rehearsing = self._protected_force()
        elif step == 0:
            self._rehearsing.reset()
        ground = np.zeros((self._window, values.shape[-1]))
        points = self._rehearsing.step(ground, values[0, : len(CHANNELS)])
        self._publish_rehearsed(self._force_codec.encode_points(step, points))

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        test = decode_state(raw)
        if test.state == self._test:
            return  # a heartbeat
        if test.state == State.DONE:  # a link's rig does not wait for the last answers
            for codec in self._state_codecs:
                self._shell.catch_up(codec.topic)
        self._test = test.state
        self._order.follow(test)
        self._follow_test()

    def _follow_test(self) -> None:
        """Act on the state of the test, also at the beginning of a test."""
        if self._test == State.RAMPING_DOWN:
            self._block.ramp.begin()
            self._answer_waiting()
        elif self._test in ENDED:
            self._waiting.clear()
            self._report(ALL_ANSWERED)
        elif self._test in (State.IDLE, State.READY) and self._phase != "ready":
            self._conflict = ""
            self._block.reset()
            self._report("ready")

    def _trip_for(self, reason: str, step: int, waited: float = 0.0) -> None:
        """End the test for a reason, if there is one: no more states are answered."""
        self._conflict = reason
        if reason:
            self._shell.report(tripped_status("reference_force", reason, step, waited))

    def _answer_waiting(self) -> None:
        for step in sorted(self._waiting):
            self._answer(step, self._waiting[step])

    def _answer(self, step: int, state: Floats) -> None:
        """Answer a state, or keep it until its ground motion arrives."""
        motion = self._motion.window(step, self._window)
        if motion is None and self._test != State.RAMPING_DOWN:  # in a ramp it may never arrive
            self._waiting[step] = state
            return
        self._waiting.pop(step, None)
        self._publish(self._message(step, motion, state))
        self._ask_model(step)
        self._order.last = step
        if self._block.ramp.begun:
            if self._ramp_step < 0 and self._block.cause is None:
                self._ramp_step = step
            self._report_ramp(step)
        if step >= self._sampler.due:
            self._send_estimates(step)

    def _ask_model(self, step: int) -> None:
        """Step a computed model, after the answer to the sample; trip if it takes far too long."""
        if not self._block.reference_force.is_modelled:
            return  # a stall of the host is no fault here
        begun = self._clock.monotonic()
        self._block.ask_model()
        took = self._clock.monotonic() - begun
        if took > parameters.LONGEST_MODEL_STEP and not self._order.in_lockstep:
            name = self._shell.experiment["reference_force"]["computed.model"]
            why = f"took {took:.3g} s for a step; seft preflight measures it"
            self._trip_for(f"computed.model {name} {why}", step)

    def _message(self, step: int, motion: Floats | None, state: Floats) -> bytes:
        """Message that answers a state; lost states before it are interpolated."""
        if self._delay and step > self._order.last + 1:
            lost = range(self._order.last + 1, step)
            self._block.bridge([self._motion.window(s, self._window) for s in lost], state)
        return self._force_codec.encode_points(step, self._block.step(motion, state))

    def _report_ramp(self, step: int) -> None:
        """Report at once that the force ramps down by itself, and that it is at rest."""
        if self._block.cause is not None and self._cause_step < 0:
            self._cause_step = step
            self._report(RAMPING_DOWN)
        if self._block.ramp.finished and self._phase != AT_REST_KEY:
            self._report(AT_REST_KEY)

    def _report(self, phase: str) -> None:
        self._phase, cause, values = phase, self._block.cause, {}
        if cause is not None and self._cause_step >= 0:
            values = {"reason": cause, "step": str(self._cause_step)}
        if self._block.ramp.begun and self._ramp_step >= 0:
            values["ramp_step"] = str(self._ramp_step)
        self.report(phase, values, OK if cause is None else ERROR, cause or phase)

    def _send_estimates(self, step: int) -> None:
        """Publish the method's estimates; if they can't be sent, the test continues."""
        estimates = self._sampler.sample(step)
        try:
            if estimates:
                self._publish_estimates(self._estimates_codec.encode(step, estimates))
        except WireError as error:
            self._shell.refuse(str(error))


REFERENCE_FORCE_NODE = NodeKind(parameters.REFERENCE_FORCE_TABLE, TABLES, ReferenceForceNode)
main = REFERENCE_FORCE_NODE.main


if __name__ == "__main__":
    raise SystemExit(main())
