"""The parts of the other nodes, played for ``reference_force``."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import (
    GROUND_MOTION,
    RIG_STATE,
    VALVE_COMMAND,
    LoopTopic,
    Topic,
)
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec

from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.recording.record import Estimates, Series
from seft_ros.recording.samples import EstimateBuffer
from seft_ros.reference_force.estimate_sampler import EstimateSampler
from seft_ros.reference_force.topic import reference_force_topic
from seft_ros.replay.answered import note_unanswered
from seft_ros.replay.cue import FAR, Cue
from seft_ros.replay.motion import Motion
from seft_ros.replay.ramp import ramp_step
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.words import listed


class ReferenceForcePart:
    """Rig, ground motion and supervisor of a recorded test, see `seft_ros.replay.cue.Part`.

    States that the node did not answer are not sent: they did not reach it, or came after its
    test had ended.

    Parameters
    ----------
    recorded : Recorded
        The test.

    Raises
    ------
    InputError
        If a state or ground motion that was answered is not in the bag.
    """

    node = "reference_force"
    answer: LoopTopic
    sends: tuple[LoopTopic, ...] = (GROUND_MOTION, RIG_STATE)
    steps: int | None = None  # without that number the node keeps no time

    def __init__(self, recorded: Recorded) -> None:
        self._recorded = recorded
        self._experiment = experiment = recorded.record.experiment
        self.fixed: dict[str, object] = {}
        self.notes: list[str] = []
        self.answer = reference_force_topic(experiment["reference_force"])
        self._delay = int(experiment["reference_force"]["loop_delay"])
        self._motion = Motion(recorded.chunks, len(experiment.axes))
        self._ramp, exact = ramp_step(recorded)
        if not exact:
            self.notes.append(
                f"the supervisor's ramp begins at step {self._ramp} by the times of recording; "
                "the forces do not tell it exactly"
            )
        states = recorded.series(RIG_STATE)
        answered = np.array(list(recorded.points), np.int64)
        if not self._delay:  # who was commanded had a reference force, recorded or not
            commanded = recorded.series(VALVE_COMMAND).steps
            unrecorded = np.setdiff1d(commanded, answered)
            if recorded.record.trip is None and len(unrecorded):
                self.notes.append(listed("the bag lacks the recorded answer", unrecorded))
                answered = np.union1d(answered, unrecorded)
        self.notes += note_unanswered(self.node, states.steps, answered)
        self._states = _only(states, answered)
        unmoved = answered[answered >= self._motion.steps]
        if len(unmoved) and not (self._ramp is not None and unmoved[0] >= self._ramp):
            raise InputError(
                f"the bag lacks ground_motion of step {unmoved[0]}, which reference_force has "
                "answered; record that topic from the start on"
            )

    def cues(self) -> Iterator[Cue]:
        """Give what the node is told, step by step."""
        axes, timebase = self._experiment.axes, self._experiment.timebase
        motions, states = (TrajectoryCodec(t, axes, timebase) for t in self.sends)
        far, sent = round(FAR * timebase.rate), 0
        pieces = self._motion.pieces
        for step, state in _rows(self._states):
            messages: list[tuple[Topic, bytes]] = []
            while sent < len(pieces) and pieces[sent][0] <= step + far:
                messages.append((GROUND_MOTION, motions.encode_points(*pieces[sent])))
                sent += 1
            messages.append((RIG_STATE, states.encode(step, state)))
            yield Cue(step, messages, ramps=step == self._ramp)

    def expected(self) -> Series:
        """Give the recorded answers that replayed ones are held against."""
        return self._recorded.series(self.answer)

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the answers of the block without ROS, with a node's parameters."""
        axes, timebase = self._experiment.axes, self._experiment.timebase
        block = ProtectedForce.from_parameters(section, axes, timebase)
        delay = max(section["loop_delay"], 0)
        settled = 1 if block.reference_force.tells_motion else 1 + delay
        window, last = 1 + block.preview, -1
        sampler, estimates = EstimateSampler(block, timebase), EstimateBuffer()
        told: dict[int, Floats] = {}
        for step, state in _rows(self._states):
            if step == self._ramp:
                block.ramp_down()
            motion = self._motion.window(step, window)
            if motion is None and not block.ramping:
                break  # the node would wait for it
            if delay and step > last + 1:
                lost = [self._motion.window(at, window) for at in range(last + 1, step)]
                block.bridge(lost, state)
            for ahead, point in enumerate(block.step(motion, state)[:settled]):
                told.setdefault(step + ahead, point)
            last = step
            if step >= sampler.due:
                estimates.append(step, sampler.sample(step))
        values = np.array(list(told.values())).reshape(len(told), -1, len(axes))
        return Series(np.array(list(told), np.int64), values), estimates.series()


def _rows(series: Series) -> Iterator[tuple[int, Any]]:
    return zip(series.steps.tolist(), series.values, strict=True)


def _only(series: Series, steps: Any) -> Series:
    (kept,) = np.nonzero(np.isin(series.steps, steps))
    return Series(series.steps[kept], series.values[kept])
