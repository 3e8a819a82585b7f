"""The blocks that a recorded test can be replayed to."""

from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import (
    RIG_STATE,
    VALVE_COMMAND,
    LoopTopic,
)
from seft_plant_sim.judge.guard import DRIVE_ROW
from seft_plant_sim.rig import Rig

from seft_ros.bags.gathering import EstimatesGatherer
from seft_ros.bags.recording import Estimates, Series, series_of
from seft_ros.force_controller.force_controller_parameters import FOLLOW_TARGETS
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.methods import force_control
from seft_ros.protection.protected_force import ProtectedForce
from seft_ros.reference_force.reference_force_block import EstimateSampler, MotionBuffer
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.recorded_test import Recorded, Replay

BY_TIME = "force_controller: no "
"""In the reason of a trip that a timeout caused, not a sample."""


class ReferenceForceReplay(Replay):
    """What rig, ground motion and supervisor sent to reference_force.

    States that the node did not answer are left out: they did not reach it, or came after its
    test had ended.
    """

    node = "reference_force"

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        section = self.experiment["reference_force"]
        self.answer = reference_force_topic(section)
        self.expected = recorded.series(self.answer)
        self._ramp_step = recorded.ramp_step
        if recorded.ramp_unknown:
            self.notes.append(
                "reference_force does not report the step at which the supervisor ramped it down: "
                "it is replayed without that ramp"
            )
        self._motion, moved = MotionBuffer(len(self.experiment.axes)), 0
        parts: list[Floats] = []  # of the motion, without duplicates
        for first, values in recorded.chunks:
            if first <= moved < first + len(values):
                parts.append(values[moved - first :])
                moved = first + len(values)
        if moved:
            self._motion.add(0, np.concatenate(parts))
        answered = np.array(list(recorded.points), np.int64)
        if not section["loop_delay"]:  # each command follows a reference force, recorded or not
            unrecorded = np.setdiff1d(recorded.series(VALVE_COMMAND).steps, answered)
            if recorded.recording.trip is None:
                self.note_steps("the bag lacks the recorded answer", unrecorded)
                answered = np.union1d(answered, unrecorded)
        states = recorded.recording.states
        self.note_unanswered(states.steps, answered)
        self._states = states.of_steps(answered)
        unmoved = answered[answered >= moved]
        if len(unmoved) and not (self._ramp_step is not None and unmoved[0] >= self._ramp_step):
            raise InputError(
                f"the bag lacks ground_motion of step {unmoved[0]}, which reference_force has "
                "answered; record that topic from the start on"
            )

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Compute forces and estimates."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        block = ProtectedForce.from_parameters(section, axes, timebase)
        delay = max(section["loop_delay"], 0)
        settled = 1 if block.reference_force.provides_target else 1 + delay
        window, last = 1 + block.preview, -1
        sampler = EstimateSampler(block.reference_force, timebase)
        estimates = EstimatesGatherer(self.experiment)
        forces: dict[int, Floats] = {}
        for step, state in self._states.samples():
            if step == self._ramp_step:
                block.ramp.begin()
            motion = self._motion.window(step, window)
            if motion is None and not block.ramp.begun:
                break  # the node would wait for it
            if delay and step > last + 1:
                lost = [self._motion.window(at, window) for at in range(last + 1, step)]
                block.bridge(lost, state)
            for ahead, point in enumerate(block.step(motion, state)[:settled]):
                forces.setdefault(step + ahead, point)
            last = step
            if step >= sampler.due:
                estimates.append(step, sampler.sample(step))
        quantities = reference_force_topic(section).quantities
        return series_of(forces, len(quantities), len(axes)), estimates.series()


class ForceControllerReplay(Replay):
    """What rig and reference_force sent to force_controller.

    Not over a link: which messages arrived there is in no bag.
    """

    node = "force_controller"
    answer: LoopTopic = VALVE_COMMAND

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        section, trip = self.experiment["force_controller"], recorded.recording.trip
        if section["loop_delay"]:
            raise InputError(
                "force_controller answered over a link (loop_delay): which force was the newest "
                "when a state came is not in a bag; replay reference_force or rig"
            )
        self.expected = recorded.series(VALVE_COMMAND)
        if trip is not None and BY_TIME in trip.reason:
            self.expected = self.expected.until(trip.step)
            self.notes.append(f"replayed until step {trip.step}, where a timeout tripped it")
        states, self._points = recorded.series(RIG_STATE), recorded.points
        looks_ahead = section["method"] in FOLLOW_TARGETS
        if looks_ahead and all(len(points) == 1 for points in self._points.values()):
            raise InputError(
                "force_controller needs the future motion of the target, which is not in a bag of "
                "seft simulate; replay reference_force or rig"
            )
        commanded = self.expected.steps
        sent = states.until(int(commanded[-1]) if len(commanded) else -1)
        self.note_unanswered(sent.steps, commanded)
        self._states = dict(states.samples())
        forceless = np.setdiff1d(commanded, list(self._points))
        if len(forceless) and trip is None:  # a tripped one waits for no force
            raise InputError(
                f"the bag lacks reference_force of step {forceless[0]}, which force_controller "
                "has answered; record that topic from the start on"
            )

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Compute the commands."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        block = force_control(dict(section), axes, timebase)
        interlock = Interlock.from_parameters(block, dict(section), axes, timebase)
        commands: dict[int, Floats] = {}
        none = np.zeros((1, 1, len(axes)))
        for step in self.expected.steps.tolist():
            if step not in self._points and not interlock.reason:
                break  # the node would wait for it
            points = self._points.get(step, none)
            interlock.look(step, self._states[step])
            commands[step] = interlock.step(step, points, self._states[step]).copy()
        return series_of(commands, 1, len(axes)), None


class RigReplay(Replay):
    """What the rig applied, as it has reported with each sample."""

    node = "rig"
    answer: LoopTopic = RIG_STATE

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        states = recorded.series(RIG_STATE)
        whole = int((states.steps == np.arange(len(states.steps))).sum())
        self.expected = states.until(whole - 1)
        if whole < len(states.steps):
            self.notes.append(
                f"replayed until step {whole - 1}: rig/state of the next is not in the bag"
            )

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Compute the states of the simulated rig."""
        rig = Rig.from_parameters(dict(section), self.experiment.axes, self.experiment.timebase)
        drives = self.expected.values[:, DRIVE_ROW]
        states = [rig.reset()]
        for drive in drives[1:]:
            if rig.violation is not None:
                break
            states.append(rig.step(drive))
        return Series(np.arange(len(states), dtype=np.int64), np.array(states)), None


REPLAYS: dict[str, type[Replay]] = {
    kind.node: kind for kind in (ReferenceForceReplay, ForceControllerReplay, RigReplay)
}


def replay_to(node: str, recorded: Recorded) -> Replay:
    """Make the replay of a test to a node's block.

    Raises
    ------
    InputError
        If the bag lacks what the node was sent, or the node is none of `REPLAYS`.
    """
    if node not in REPLAYS:
        known = ", ".join(REPLAYS)
        raise InputError(f"--node {node}: must be one of {known}{nearest(node, REPLAYS)}")
    if node not in recorded.recording.experiment.sections:
        raise InputError(f"the bag lacks the parameters of {node}")
    return REPLAYS[node](recorded)
