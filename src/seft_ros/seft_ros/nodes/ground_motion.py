"""Node ``ground_motion``: publishes the ground motion ahead of the rig's time, by a timer."""

import sys

from seft_msgs_py.node.node_main import NodeKind, run_node
from seft_msgs_py.node.node_shell import NodeShell
from seft_msgs_py.wire.messages import Status, decode_clock, decode_status
from seft_msgs_py.wire.topics import CLOCK_TOPIC, EXPERIMENT_STATE, GROUND_MOTION
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.experiment.state_machine import ENDED, MOVING
from seft_ros.experiment.tables import TABLES
from seft_ros.ground_motion.block import GroundMotion
from seft_ros.ground_motion.parameters import TABLE

TIMER_PERIOD = 0.02  # s


class GroundMotionNode:
    """Moves chunks of a `GroundMotion` to its topic, a lead ahead of the rig's time.

    That time is read from /clock, every 0.1 s of the test: following every rig/state would wake
    one more process in each step.
    """

    def __init__(self, shell: NodeShell) -> None:
        experiment = shell.experiment
        section = experiment["ground_motion"]
        self._shell = shell
        self.motion = GroundMotion.from_parameters(section, experiment.axes, experiment.timebase)
        self._lead_steps = max(1, round(section["lead"] * experiment.timebase.rate))
        self._codec = TrajectoryCodec(GROUND_MOTION, experiment.axes, experiment.timebase)
        self._period_ns = experiment.timebase.period_ns
        self._publish = shell.publisher(GROUND_MOTION)
        self._next_chunk = 0
        self._published_until = 0
        self._rig_step = 0
        self._phase = "idle"
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        shell.subscribe(CLOCK_TOPIC, self._on_clock)

    def run(self) -> None:
        """Publish until told to stop."""
        self._shell.spin(self.look, TIMER_PERIOD)

    def look(self) -> None:
        """Publish what the lead asks for; the first of it before the test starts."""
        if self._phase in ENDED:
            return
        while (
            self._next_chunk < self.motion.chunks
            and self._published_until <= self._rig_step + self._lead_steps
        ):
            first, values = self.motion.chunk(self._next_chunk)
            self._publish(self._codec.encode_points(first, values))
            self._next_chunk += 1
            self._published_until = first + len(values)
            if first == 0:
                self._report("primed")

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        phase = decode_status(raw).message
        if self._phase not in ENDED and phase in ENDED:
            self._report("ended")
        elif self._phase in ENDED and phase not in ENDED:
            self._next_chunk = self._published_until = self._rig_step = 0  # for the next test
        self._phase = phase

    def _on_clock(self, raw: bytes, _: int) -> None:
        if self._phase in MOVING:
            self._rig_step = decode_clock(raw) // self._period_ns

    def _report(self, phase: str) -> None:
        values = {"phase": phase, "steps": str(self.motion.steps)}
        self._shell.report(Status("ground_motion", 0, phase, values=values))


def _build(shell: NodeShell) -> GroundMotionNode:
    node = GroundMotionNode(shell)
    shell.start({"steps": node.motion.steps})
    return node


KIND = NodeKind(TABLE, TABLES, _build)


def main() -> int:
    """Entry point of ``ros2 run seft_ros ground_motion``."""
    return run_node(KIND)


if __name__ == "__main__":
    sys.exit(main())
