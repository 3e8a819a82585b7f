"""Node ``reference_force``: answers each rig/state with the reference force of its step."""

import sys

import numpy as np
from seft_msgs_py.errors import WireError
from seft_msgs_py.estimates import EstimatesCodec
from seft_msgs_py.messages import Status, decode_status
from seft_msgs_py.node_shell import IDLE_WAIT, WARM_UP_STEPS, NodeShell, run_node
from seft_msgs_py.outcome import tripped_status
from seft_msgs_py.topics import (
    ESTIMATES,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
)
from seft_msgs_py.trajectory import Floats, TrajectoryCodec

from seft_ros.experiment.sample_order import ABSURD, SampleOrder
from seft_ros.experiment.tables import TABLES
from seft_ros.reference_force.block import ReferenceForce
from seft_ros.reference_force.estimate_sampler import EstimateSampler
from seft_ros.reference_force.motion_buffer import MotionBuffer
from seft_ros.reference_force.parameters import TABLE

MOTION_WAIT = 0.0005  # s between looks for a ground motion that is late for its state


class ReferenceForceNode:
    """Matches states and ground motion by step and moves them through a `ReferenceForce`."""

    def __init__(self, shell: NodeShell) -> None:
        experiment = shell.experiment
        self._shell = shell
        self._block = ReferenceForce.from_parameters(
            experiment["reference_force"], experiment.axes, experiment.timebase
        )
        self._window = 1 + self._block.preview
        self._motion_codec, self._state_codec, self._force_codec = (
            TrajectoryCodec(topic, experiment.axes, experiment.timebase)
            for topic in (GROUND_MOTION, RIG_STATE, REFERENCE_FORCE)
        )
        self._sampler = EstimateSampler(self._block, experiment.timebase)
        self._estimates_codec = EstimatesCodec(experiment.axes, experiment.timebase)
        self._publish = shell.publisher(REFERENCE_FORCE)
        self._publish_estimates = shell.publisher(ESTIMATES)
        self._motion = MotionBuffer(len(experiment.axes))
        self._waiting: dict[int, Floats] = {}
        self._order = SampleOrder(experiment["reference_force"]["pace"], experiment.timebase)
        self._conflict = ""  # why this test is not answered
        self._warm_up()
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16, wake=False)
        shell.subscribe(GROUND_MOTION, self._on_ground_motion, wake=False)
        shell.subscribe(RIG_STATE, self._on_rig_state, depth=64, reliable=False)

    def run(self) -> None:
        """Answer until told to stop."""
        self._tell_ready()
        while not self._shell.stopping:
            self._shell.spin_once(MOTION_WAIT if self._waiting else IDLE_WAIT)

    def _warm_up(self) -> None:
        axes = len(self._shell.experiment.axes)
        motion, state = np.zeros((self._window, axes)), np.zeros((4, axes))
        for step in range(WARM_UP_STEPS):
            self._state_codec.decode(self._state_codec.encode(step, state))
            self._force_codec.encode(step, self._block.step(motion, state))
            if step >= self._sampler.due and (estimates := self._sampler.sample(step)):
                self._estimates_codec.decode(self._estimates_codec.encode(step, estimates))
        self._reset()

    def _reset(self) -> None:
        self._waiting.clear()
        self._block.reset()
        self._sampler.reset()

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        status = decode_status(raw)
        self._order.follow(status)
        if status.message == "idle" and self._conflict:  # the operator knows
            self._conflict = ""
            self._tell_ready()

    def _on_ground_motion(self, raw: bytes, _: int) -> None:
        first, values = self._motion_codec.decode(raw)
        if np.abs(values).max() > ABSURD:
            raise WireError(f"ground_motion from step {first} on has a value beyond {ABSURD:g}")
        if first == 0:  # a new motion, of which nothing has passed
            if self._order.steps and not self._order.may_begin:
                raise WireError("a new ground_motion in the middle of a test")
            self._order.last = -1
        self._motion.drop_before(self._order.last)
        if not self._motion.add(first, values[:, 0]):
            self._shell.refuse(f"ground_motion from step {first} on: steps before it are missing")
        for step in sorted(self._waiting):
            self._answer(step, self._waiting[step])

    def _on_rig_state(self, raw: bytes, _: int) -> None:
        step, values = self._state_codec.decode(raw)
        if np.abs(values).max() > ABSURD:
            raise WireError(f"rig/state of step {step} has a value beyond {ABSURD:g}")
        if self._order.begins(step):
            self._reset()
            self._conflict = self._shell.several_senders()
            if self._conflict:
                self._shell.report(tripped_status("reference_force", self._conflict, step))
        self._order.check("rig/state", step)
        if step in self._waiting:
            raise WireError(f"rig/state of step {step} a second time")
        if not self._conflict:
            self._answer(step, values[0])

    def _tell_ready(self) -> None:
        status = Status("reference_force", 0, "ready", values={"phase": "ready"})
        self._shell.report(status)

    def _answer(self, step: int, state: Floats) -> None:
        """Answer a state, or let it wait for the ground motion it needs."""
        motion = self._motion.window(step, self._window)
        if motion is None:
            self._waiting[step] = state
            return
        self._waiting.pop(step, None)
        self._publish(self._force_codec.encode(step, self._block.step(motion, state)))
        self._order.last = step
        if step >= self._sampler.due:  # the answer is out: what comes now holds nobody up
            self._tell_estimates(step)

    def _tell_estimates(self, step: int) -> None:
        """Publish what the method has identified; if that can't be sent, the test goes on."""
        estimates = self._sampler.sample(step)
        try:
            if estimates:
                self._publish_estimates(self._estimates_codec.encode(step, estimates))
        except WireError as error:
            self._shell.refuse(str(error))


def _serve(shell: NodeShell) -> None:
    node = ReferenceForceNode(shell)
    shell.start()
    node.run()


def main() -> int:
    """Entry point of ``ros2 run seft_ros reference_force``."""
    return run_node(TABLE, TABLES, _serve)


if __name__ == "__main__":
    sys.exit(main())
