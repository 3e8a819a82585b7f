"""The parts of the other nodes, played for ``force_controller``."""

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
from seft_ros.reference_force.topic import reference_force_topic
from seft_ros.replay.answered import note_unanswered
from seft_ros.replay.cue import Cue
from seft_ros.replay.recorded import Recorded

BY_TIME = "force_controller: no "
"""Start of a trip's reason that a clock made, not a sample."""


class ForceControllerPart:
    """Rig, reference force and supervisor of a recorded test, see `seft_ros.replay.cue.Part`.

    Parameters
    ----------
    recorded : Recorded
        The test.

    Raises
    ------
    InputError
        If it was over a link, or a state that was answered is not in the bag.
    """

    node = "force_controller"
    answer: LoopTopic = VALVE_COMMAND
    sends: tuple[LoopTopic, ...]
    steps: int | None = None  # without that number the node keeps no time

    def __init__(self, recorded: Recorded) -> None:
        self._experiment = recorded.record.experiment
        self.fixed: dict[str, object] = {}
        self.notes: list[str] = []
        if self._experiment["force_controller"]["loop_delay"]:
            raise InputError(
                "force_controller answered over a link (loop_delay): which force was the newest "
                "when a state came is not in a bag; replay reference_force or rig"
            )
        self._asks = reference_force_topic(self._experiment["reference_force"])
        self.sends = (RIG_STATE, self._asks)
        self._commands = recorded.series(VALVE_COMMAND)
        trip = recorded.record.trip
        if trip is not None and trip.reason.startswith(BY_TIME):
            self._commands = until(self._commands, trip.step)
            self.notes.append(f"replayed until step {trip.step}, where a clock tripped it")
        states, self._points = recorded.series(RIG_STATE), recorded.points
        if self._lacks_the_coming():
            raise InputError(
                "force_controller needs the coming motion of the target, which is not in a bag of "
                "seft simulate; replay reference_force or rig"
            )
        sent = until(states, _last(self._commands))
        self.notes += note_unanswered(self.node, sent.steps, self._commands.steps)
        self._states = dict(zip(states.steps.tolist(), states.values, strict=True))
        forceless = np.setdiff1d(self._commands.steps, list(self._points))
        if len(forceless) and trip is None:  # tripped, it waits for none
            raise InputError(
                f"the bag lacks reference_force of step {forceless[0]}, which force_controller "
                "has answered; record that topic from the start on"
            )

    def _lacks_the_coming(self) -> bool:
        used = self._experiment["force_controller"]["method"] == VELOCITY_FEEDFORWARD
        return used and all(len(points) == 1 for points in self._points.values())

    def cues(self) -> Iterator[Cue]:
        """Give what the node is told, step by step."""
        axes, timebase = self._experiment.axes, self._experiment.timebase
        states, points = (TrajectoryCodec(t, axes, timebase) for t in self.sends)
        for step in self._commands.steps.tolist():
            messages: list[tuple[Topic, bytes]] = []
            messages.append((RIG_STATE, states.encode(step, self._states[step])))
            if step in self._points:
                messages.append((self._asks, points.encode_points(step, self._points[step])))
            yield Cue(step, messages)

    def expected(self) -> Series:
        """Give the recorded answers that replayed ones are held against."""
        return self._commands

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the answers of the block without ROS, with a node's parameters."""
        axes, timebase = self._experiment.axes, self._experiment.timebase
        block = force_control(dict(section), axes, timebase)
        interlock = Interlock.from_parameters(block, dict(section), axes, timebase)
        steps, commands, none = [], [], np.zeros((1, 1, len(axes)))
        for step in self._commands.steps.tolist():
            if step not in self._points and not interlock.reason:
                break  # the node would wait for it
            steps.append(step)
            points = self._points.get(step, none)
            commands.append(interlock.step(step, points, self._states[step]).copy())
        values = np.array(commands).reshape(len(steps), 1, len(axes))
        return Series(np.array(steps, np.int64), values), None


def _last(series: Series) -> int:
    return int(series.steps[-1]) if len(series.steps) else -1
