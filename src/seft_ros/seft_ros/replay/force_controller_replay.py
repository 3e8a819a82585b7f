"""A recorded test as ``force_controller`` saw it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE, VALVE_COMMAND, LoopTopic, Topic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.names import VELOCITY_FEEDFORWARD
from seft_ros.recording.record import Estimates, Series
from seft_ros.recording.samples import until
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.replay_step import Replay, ReplayStep

BY_TIME = "force_controller: no "
"""Start of a trip's reason that a clock made, not a sample."""


class ForceControllerReplay(Replay):
    """What rig and reference force told force_controller; over a link, no bag says which came."""

    node = "force_controller"
    answer: LoopTopic = VALVE_COMMAND

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        section, trip = self.experiment["force_controller"], recorded.record.trip
        if section["loop_delay"]:
            raise InputError(
                "force_controller answered over a link (loop_delay): which force was the newest "
                "when a state came is not in a bag; replay reference_force or rig"
            )
        self._asks = reference_force_topic(self.experiment["reference_force"])
        self.sends = (RIG_STATE, self._asks)
        self.expected = recorded.series(VALVE_COMMAND)
        if trip is not None and trip.reason.startswith(BY_TIME):
            self.expected = until(self.expected, trip.step)
            self.notes.append(f"replayed until step {trip.step}, where a clock tripped it")
        states, self._points = recorded.series(RIG_STATE), recorded.points
        looks_ahead = section["method"] == VELOCITY_FEEDFORWARD
        if looks_ahead and all(len(points) == 1 for points in self._points.values()):
            raise InputError(
                "force_controller needs the coming motion of the target, which is not in a bag of "
                "seft simulate; replay reference_force or rig"
            )
        commanded = self.expected.steps
        sent = until(states, int(commanded[-1]) if len(commanded) else -1)
        self.note_unanswered(sent.steps, commanded)
        self._states = dict(states.samples())
        forceless = np.setdiff1d(commanded, list(self._points))
        if len(forceless) and trip is None:  # tripped, it waits for none
            raise InputError(
                f"the bag lacks reference_force of step {forceless[0]}, which force_controller "
                "has answered; record that topic from the start on"
            )

    def replay_steps(self) -> Iterator[ReplayStep]:
        """Give what the node is told, step by step."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        states, points = (TrajectoryCodec(t, axes, timebase) for t in self.sends)
        for step in self.expected.steps.tolist():
            messages: list[tuple[Topic, bytes]] = []
            messages.append((RIG_STATE, states.encode(step, self._states[step])))
            if step in self._points:
                messages.append((self._asks, points.encode_points(step, self._points[step])))
            yield ReplayStep(step, messages)

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the answers of the block without ROS, with a node's parameters."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        block = force_control(dict(section), axes, timebase)
        interlock = Interlock.from_parameters(block, dict(section), axes, timebase)
        steps, commands, none = [], [], np.zeros((1, 1, len(axes)))
        for step in self.expected.steps.tolist():
            if step not in self._points and not interlock.reason:
                break  # the node would wait for it
            steps.append(step)
            points = self._points.get(step, none)
            commands.append(interlock.step(step, points, self._states[step]).copy())
        values = np.array(commands).reshape(len(steps), 1, len(axes))
        return Series(np.array(steps, np.int64), values), None
