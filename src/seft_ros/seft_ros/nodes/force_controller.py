"""Node ``force_controller``: answers state and reference force with the valve command."""

import sys

import numpy as np
from seft_msgs_py.messages import Status
from seft_msgs_py.node_shell import (
    IDLE_WAIT,
    WARM_UP_STEPS,
    Handler,
    NodeShell,
    run_node,
)
from seft_msgs_py.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND, LoopTopic
from seft_msgs_py.trajectory import Floats, TrajectoryCodec

from seft_ros.experiment.tables import TABLES
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.parameters import TABLE

PENDING = 256  # steps kept while their other half has not come
STATE_WAIT = 0.0005  # s between looks for a state that comes after its reference force


class ForceControllerNode:
    """Matches states and reference forces by step and moves them through a `ForceController`."""

    def __init__(self, shell: NodeShell) -> None:
        experiment = shell.experiment
        self._shell = shell
        self._block = ForceController.from_parameters(
            experiment["force_controller"], experiment.axes, experiment.timebase
        )
        self._command_codec = TrajectoryCodec(VALVE_COMMAND, experiment.axes, experiment.timebase)
        self._publish = shell.publisher(VALVE_COMMAND)
        self._states: dict[int, Floats] = {}
        self._forces: dict[int, Floats] = {}
        self._last = -1
        self._warm_up()
        # the state of a step is nearly always there before the force that answers it: only the
        # force is worth waking up for
        for topic, pending, other, wake in (
            (REFERENCE_FORCE, self._forces, self._states, True),
            (RIG_STATE, self._states, self._forces, False),
        ):
            receiver = self._receiver(topic, pending, other)
            shell.subscribe(topic, receiver, depth=64, wake=wake, reliable=False)

    def _warm_up(self) -> None:
        axes = len(self._shell.experiment.axes)
        force, state = np.zeros(axes), np.zeros((4, axes))
        for step in range(WARM_UP_STEPS):
            raw = self._command_codec.encode(step, self._block.step(force, state))
            self._command_codec.decode(raw)
        self._block.reset()

    def run(self) -> None:
        """Answer until told to stop."""
        while not self._shell.stopping:
            self._shell.spin_once(STATE_WAIT if self._forces else IDLE_WAIT)

    def _receiver(
        self, topic: LoopTopic, pending: dict[int, Floats], other: dict[int, Floats]
    ) -> Handler:
        experiment = self._shell.experiment
        codec = TrajectoryCodec(topic, experiment.axes, experiment.timebase)

        def receive(raw: bytes, _: int) -> None:
            step, values = codec.decode(raw)
            if step == 0 and self._last != 0:  # a new test
                self._last = -1
                pending.clear()
                self._block.reset()
            if step <= self._last:
                self._shell.refuse(f"{topic.name} of step {step} after step {self._last}")
                return
            pending[step] = values[0]
            if step in other:
                self._answer(step)
            elif len(pending) > PENDING:
                pending.pop(min(pending))

        return receive

    def _answer(self, step: int) -> None:
        command = self._block.step(self._forces.pop(step)[0], self._states.pop(step))
        self._publish(self._command_codec.encode(step, command))
        self._last = step
        for pending in (self._states, self._forces):
            for passed in [other for other in pending if other < step]:
                del pending[passed]


def _serve(shell: NodeShell) -> None:
    node = ForceControllerNode(shell)
    shell.start()
    shell.report(Status("force_controller", 0, "ready", values={"phase": "ready"}))
    node.run()


def main() -> int:
    """Entry point of ``ros2 run seft_ros force_controller``."""
    return run_node(TABLE, TABLES, _serve)


if __name__ == "__main__":
    sys.exit(main())
