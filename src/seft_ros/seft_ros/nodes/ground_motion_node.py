"""Node ``ground_motion``: publishes the ground motion ahead of the rig's time, by a timer."""

from seft_msgs_py.node.node_shell import NodeBody, NodeKind, NodeShell
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import decode_clock
from seft_msgs_py.wire.outcome import ENDED, MOVING
from seft_msgs_py.wire.topics import CLOCK_TOPIC, EXPERIMENT_STATE, GROUND_MOTION
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.ground_motion.ground_motion_block import GROUND_MOTION_TABLE, MOTION, GroundMotion
from seft_ros.test_run.parameter_tables import TABLES

TIMER_PERIOD = 0.02  # s


class GroundMotionNode(NodeBody):
    """Publishes chunks of a `GroundMotion`, a lead ahead of the rig's time.

    It reads that time from /clock, every 0.1 s of the test: reading every rig/state would wake one
    more process in each step.
    """

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        experiment = shell.experiment
        section = experiment["ground_motion"]
        self.motion = GroundMotion(section, experiment.axes, experiment.timebase)
        self.facts = {"steps": self.motion.steps, MOTION: self.motion.facts}
        self._lead_steps = max(1, round(section["lead"] * experiment.timebase.rate))
        self._codec = TrajectoryCodec(GROUND_MOTION, experiment.axes, experiment.timebase)
        self._timebase = experiment.timebase
        self._publish = shell.publisher(GROUND_MOTION)
        self._next_chunk = self._published_until = self._rig_step = 0
        self._phase = "idle"
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        shell.subscribe(CLOCK_TOPIC, self._on_clock)

    def period(self) -> float:
        """Time between two polls, s."""
        return TIMER_PERIOD

    def poll(self) -> None:
        """Publish the chunks within the lead; the first one before the test starts."""
        if self._phase in ENDED:
            return
        for first, values in self.motion.chunks[self._next_chunk :]:
            if self._published_until > self._rig_step + self._lead_steps:
                break
            self._publish(self._codec.encode_points(first, values))
            self._next_chunk += 1
            self._published_until = first + len(values)
            if first == 0:
                self._report("primed")

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        phase = decode_state(raw).state
        if self._phase not in ENDED and phase in ENDED:
            self._report("ended")
        elif self._phase in ENDED and phase not in ENDED:
            self._next_chunk = self._published_until = self._rig_step = 0  # for the next test
        self._phase = phase

    def _on_clock(self, raw: bytes, _: int) -> None:
        if self._phase in MOVING:
            self._rig_step, _ = self._timebase.nearest(decode_clock(raw))

    def _report(self, phase: str) -> None:
        self.report(phase, {"steps": str(self.motion.steps)})


GROUND_MOTION_NODE = NodeKind(GROUND_MOTION_TABLE, TABLES, GroundMotionNode)
main = GROUND_MOTION_NODE.main


if __name__ == "__main__":
    raise SystemExit(main())
