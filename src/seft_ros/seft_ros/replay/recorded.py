"""What a bag has of a test for a node to be fed with it once more."""

from dataclasses import dataclass
from pathlib import Path

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.messages import decode_status
from seft_msgs_py.wire.topics import (
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    LoopTopic,
    Topic,
)
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec

from seft_ros.experiment.state_machine import State
from seft_ros.recording.bag_reader import read_bag, read_messages
from seft_ros.recording.record import Record, Series
from seft_ros.reference_force.topic import reference_force_topic


@dataclass(frozen=True)
class Recorded:
    """A recorded test.

    Attributes
    ----------
    record : Record
        Its samples and configuration.
    chunks : list of (int, ndarray)
        The messages of ground motion in their order: first step, and accelerations of shape
        (p, n), m/s^2. They go beyond the test's end, as far as the motion was sent ahead.
    points : dict
        Step -> points of the message of reference_force that answers its state, shape (p, q, n).
    ramped_ns : int or None
        When the supervisor's word to bring the force down was received, ns of the wall clock;
        None where it said no such thing.
    """

    record: Record
    chunks: list[tuple[int, Floats]]
    points: dict[int, Floats]
    ramped_ns: int | None

    def series(self, topic: LoopTopic) -> Series:
        """Give the samples of a topic, by step."""
        return self.record.series[topic.name]


def read_recorded(path: str | Path) -> Recorded:
    """Read a test to be replayed.

    Raises
    ------
    InputError
        If the bag can't be read, does not have the test's beginning, or has several tests.
    """
    record = read_bag(path)
    if len(record.experiment.rigs) > 1:
        raise InputError(f"{path}: a test of several rigs; only tests of one can be replayed")
    states = record.series[RIG_STATE.name].steps
    if not len(states):
        raise InputError(f"{path}: the bag has no rig/state; record that topic, too")
    if states[0] != 0:
        raise InputError(
            f"{path}: the bag begins at step {states[0]}: what the nodes remember of the steps "
            "before is not in it; record from before the start on"
        )
    gatherer = _Gatherer(record.experiment)
    topics: list[Topic] = [EXPERIMENT_STATE, GROUND_MOTION, REFERENCE_FORCE]
    for topic, received_ns, raw in read_messages(path, topics):
        gatherer.take(topic, received_ns, raw)
    if gatherer.tests > 1:
        raise InputError(f"{path}: the bag holds {gatherer.tests} tests; record one in a bag")
    points = {step: told for step, told in sorted(gatherer.points.items()) if step <= states[-1]}
    return Recorded(record, gatherer.chunks, points, gatherer.ramped_ns)


class _Gatherer:
    def __init__(self, experiment: Experiment) -> None:
        self.tests = 0
        self.ramped_ns: int | None = None
        self.chunks: list[tuple[int, Floats]] = []
        self.points: dict[int, Floats] = {}
        self._state = ""
        forces = reference_force_topic(experiment.sections.get("reference_force", {}))
        self._motion, self._force = (
            TrajectoryCodec(topic, experiment.axes, experiment.timebase)
            for topic in (GROUND_MOTION, forces)
        )

    def take(self, topic: Topic, received_ns: int, raw: bytes) -> None:
        """Take a message; what can't be understood is left out, as the nodes do."""
        try:
            if topic is GROUND_MOTION:
                first, values = self._motion.decode(raw)
                self.chunks.append((first, values[:, 0]))
            elif topic is REFERENCE_FORCE:
                self.points.setdefault(*self._force.decode(raw))
            else:
                self._follow(decode_status(raw).message, received_ns)
        except WireError:
            return

    def _follow(self, state: str, received_ns: int) -> None:
        if state == self._state:
            return
        self._state = state
        self.tests += state == State.RUNNING
        if state == State.RAMPING_DOWN and self.ramped_ns is None:
            self.ramped_ns = received_ns
