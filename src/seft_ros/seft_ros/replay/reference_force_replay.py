"""A recorded test as ``reference_force`` saw it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, RIG_STATE, VALVE_COMMAND, LoopTopic, Topic
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec

from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.recording.record import Estimates, Series
from seft_ros.recording.samples import EstimateBuffer, of_steps
from seft_ros.reference_force.loop_inputs import MotionBuffer
from seft_ros.reference_force.reference_force_block import EstimateSampler
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.replay_step import Replay, ReplayStep

FAR = 20.0  # s that ground motion is sent ahead of its step


class ReferenceForceReplay(Replay):
    """What rig, ground motion and supervisor told reference_force.

    States that the node did not answer are not sent: they did not reach it, or came after its
    test had ended.
    """

    node = "reference_force"
    sends: tuple[LoopTopic, ...] = (GROUND_MOTION, RIG_STATE)

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        section = self.experiment["reference_force"]
        self.answer = reference_force_topic(section)
        self.expected = recorded.series(self.answer)
        self._ramp_step = recorded.ramp_step
        if not recorded.ramp_told:
            self.notes.append(
                f"the supervisor's ramp begins at step {self._ramp_step} by the times of "
                "recording; reference_force does not tell it exactly"
            )
        self._motion, self._moved = MotionBuffer(len(self.experiment.axes)), 0
        self._pieces: list[tuple[int, Floats]] = []  # of the motion, without what came twice
        for first, values in recorded.chunks:
            if first <= self._moved < first + len(values):
                self._pieces.append((self._moved, values[self._moved - first :]))
                self._moved = first + len(values)
        if self._pieces:
            self._motion.add(0, np.concatenate([values for _, values in self._pieces]))
        answered = np.array(list(recorded.points), np.int64)
        if not section["loop_delay"]:  # who was commanded had a reference force, recorded or not
            commanded = recorded.series(VALVE_COMMAND).steps
            unrecorded = np.setdiff1d(commanded, answered)
            if recorded.record.trip is None:
                self.note_steps("the bag lacks the recorded answer", unrecorded)
                answered = np.union1d(answered, unrecorded)
        states = recorded.series(RIG_STATE)
        self.note_unanswered(states.steps, answered)
        self._states = of_steps(states, answered)
        unmoved = answered[answered >= self._moved]
        if len(unmoved) and not (self._ramp_step is not None and unmoved[0] >= self._ramp_step):
            raise InputError(
                f"the bag lacks ground_motion of step {unmoved[0]}, which reference_force has "
                "answered; record that topic from the start on"
            )

    def replay_steps(self) -> Iterator[ReplayStep]:
        """Give what the node is told, step by step."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        motions, states = (TrajectoryCodec(t, axes, timebase) for t in self.sends)
        far, sent = round(FAR * timebase.rate), 0
        for step, state in self._states.samples():
            messages: list[tuple[Topic, bytes]] = []
            while sent < len(self._pieces) and self._pieces[sent][0] <= step + far:
                messages.append((GROUND_MOTION, motions.encode_points(*self._pieces[sent])))
                sent += 1
            messages.append((RIG_STATE, states.encode(step, state)))
            yield ReplayStep(step, messages, ramps=step == self._ramp_step)

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the answers of the block without ROS, with a node's parameters."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        block = ProtectedForce.from_parameters(section, axes, timebase)
        delay = max(section["loop_delay"], 0)
        settled = 1 if block.reference_force.tells_motion else 1 + delay
        window, last = 1 + block.preview, -1
        sampler, estimates = EstimateSampler(block, timebase), EstimateBuffer()
        told: dict[int, Floats] = {}
        for step, state in self._states.samples():
            if step == self._ramp_step:
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
