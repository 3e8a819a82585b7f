"""Node ``reference_force``: answers each rig/state with the reference force of its step."""

import sys

import numpy as np
from seft_msgs_py.messages import Status
from seft_msgs_py.node_shell import IDLE_WAIT, WARM_UP_STEPS, NodeShell, run_node
from seft_msgs_py.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE
from seft_msgs_py.trajectory import Floats, TrajectoryCodec

from seft_ros.experiment.tables import TABLES
from seft_ros.reference_force.block import ReferenceForce
from seft_ros.reference_force.parameters import TABLE

MOTION_WAIT = 0.0005  # s between looks for a ground motion that is late for its state


class ReferenceForceNode:
    """Matches states and ground motion by step and moves them through a `ReferenceForce`."""

    def __init__(self, shell: NodeShell) -> None:
        experiment = shell.experiment
        self._shell = shell
        self._block = ReferenceForce.from_parameters(experiment["reference_force"], experiment.axes)
        self._motion_codec, self._state_codec, self._force_codec = (
            TrajectoryCodec(topic, experiment.axes, experiment.timebase)
            for topic in (GROUND_MOTION, RIG_STATE, REFERENCE_FORCE)
        )
        self._publish = shell.publisher(REFERENCE_FORCE)
        self._motion: dict[int, Floats] = {}
        self._waiting: dict[int, Floats] = {}
        self._last = -1
        self._warm_up()
        shell.subscribe(GROUND_MOTION, self._on_ground_motion, wake=False)
        shell.subscribe(RIG_STATE, self._on_rig_state, depth=64, reliable=False)

    def run(self) -> None:
        """Answer until told to stop."""
        while not self._shell.stopping:
            self._shell.spin_once(MOTION_WAIT if self._waiting else IDLE_WAIT)

    def _warm_up(self) -> None:
        axes = len(self._shell.experiment.axes)
        motion, state = np.zeros(axes), np.zeros((4, axes))
        for step in range(WARM_UP_STEPS):
            self._state_codec.decode(self._state_codec.encode(step, state))
            self._force_codec.encode(step, self._block.step(motion, state))
        self._block.reset()

    def _on_ground_motion(self, raw: bytes, _: int) -> None:
        first, values = self._motion_codec.decode(raw)
        if first == 0:
            self._motion.clear()
        self._motion.update(zip(range(first, first + len(values)), values[:, 0], strict=True))
        for step in sorted(self._waiting):
            if step in self._motion:
                self._answer(step, self._waiting.pop(step))

    def _on_rig_state(self, raw: bytes, _: int) -> None:
        step, values = self._state_codec.decode(raw)
        if step == 0 and self._last != 0:  # a new test
            self._last = -1
            self._waiting.clear()
            self._block.reset()
        if step <= self._last:
            self._shell.refuse(f"rig/state of step {step} after that of step {self._last}")
        elif step in self._motion:
            self._answer(step, values[0])
        else:
            self._waiting[step] = values[0]

    def _answer(self, step: int, state: Floats) -> None:
        force = self._block.step(self._motion[step], state)
        self._publish(self._force_codec.encode(step, force))
        for passed in range(max(self._last, 0), step):
            self._motion.pop(passed, None)
        self._last = step


def _serve(shell: NodeShell) -> None:
    node = ReferenceForceNode(shell)
    shell.start()
    shell.report(Status("reference_force", 0, "ready", values={"phase": "ready"}))
    node.run()


def main() -> int:
    """Entry point of ``ros2 run seft_ros reference_force``."""
    return run_node(TABLE, TABLES, _serve)


if __name__ == "__main__":
    sys.exit(main())
