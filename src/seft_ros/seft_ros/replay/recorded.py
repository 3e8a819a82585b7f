"""What a bag has of a test for a node to be fed with it once more."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.messages import decode_diagnostics, decode_status
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import (
    DIAGNOSTICS,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    LoopTopic,
    Topic,
)
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec

from seft_ros.recording.bag_reader import read_bag, read_messages
from seft_ros.recording.record import Record, Series
from seft_ros.reference_force.reference_force_parameters import reference_force_topic


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
    ramp_step : int or None
        First step whose force was brought down at the supervisor's word; None where it said no
        such thing.
    ramp_told : bool
        False where reference_force did not tell that step: it is by the times of recording.
    """

    record: Record
    chunks: list[tuple[int, Floats]]
    points: dict[int, Floats]
    ramp_step: int | None = None
    ramp_told: bool = True

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
    topics: list[Topic] = [EXPERIMENT_STATE, GROUND_MOTION, REFERENCE_FORCE, DIAGNOSTICS]
    for topic, received_ns, raw in read_messages(path, topics):
        try:
            gatherer.take(topic, received_ns, raw)
        except (WireError, ValueError):
            continue  # as the nodes do
    if gatherer.tests > 1:
        raise InputError(f"{path}: the bag holds {gatherer.tests} tests; record one in a bag")
    points = {step: told for step, told in sorted(gatherer.points.items()) if step <= states[-1]}
    if gatherer.ramped_ns is None:
        return Recorded(record, gatherer.chunks, points)
    if gatherer.ramp_step is not None:
        return Recorded(record, gatherer.chunks, points, gatherer.ramp_step)
    forces = record.series[REFERENCE_FORCE.name]
    after = np.empty(0, np.int64)  # steps whose forces came after the supervisor's word
    if forces.received_ns is not None:
        after = forces.steps[forces.received_ns > gatherer.ramped_ns]
    ramp_step = int(after[0]) if len(after) else None
    return Recorded(record, gatherer.chunks, points, ramp_step, ramp_told=ramp_step is None)


class _Gatherer:
    def __init__(self, experiment: Experiment) -> None:
        self.tests = 0
        self.ramped_ns: int | None = None
        self.ramp_step: int | None = None
        self.chunks: list[tuple[int, Floats]] = []
        self.points: dict[int, Floats] = {}
        self._state = ""
        forces = reference_force_topic(experiment.sections.get("reference_force", {}))
        self._motion, self._force = (
            TrajectoryCodec(topic, experiment.axes, experiment.timebase)
            for topic in (GROUND_MOTION, forces)
        )

    def take(self, topic: Topic, received_ns: int, raw: bytes) -> None:
        """Take a message, which raises WireError or ValueError if it can't be understood."""
        if topic is GROUND_MOTION:
            first, values = self._motion.decode(raw)
            self.chunks.append((first, values[:, 0]))
        elif topic is REFERENCE_FORCE:
            self.points.setdefault(*self._force.decode(raw))
        elif topic is EXPERIMENT_STATE:
            state = decode_status(raw).message
            self.tests += state == State.RUNNING and state != self._state
            self._state = state
            if state == State.RAMPING_DOWN and self.ramped_ns is None:
                self.ramped_ns = received_ns
        else:
            for status in decode_diagnostics(raw)[1]:
                if status.name == "reference_force":  # its last word counts
                    told = status.values.get("ramp_step")
                    self.ramp_step = None if told is None else int(told)
