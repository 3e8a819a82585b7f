"""A recorded test as ``rig`` saw it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import (
    REFERENCE_FORCE,
    RIG_STATE,
    TARGET,
    VALVE_COMMAND,
    LoopTopic,
    Topic,
)
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec
from seft_plant_sim.rig import Rig

from seft_ros.recording.record import Estimates, Series
from seft_ros.recording.samples import until
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.replay_step import Replay, ReplayStep

PATIENCE = 60.0  # s that the rig waits for a replay that its machine holds up


class RigReplay(Replay):
    """What force controller and supervisor told the rig.

    The rig goes in lockstep, whatever its pace was; where it missed a command, it is sent the
    one that it held.
    """

    node = "rig"
    answer: LoopTopic = RIG_STATE

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        record, section = recorded.record, self.experiment["rig"]
        self.expected = recorded.series(RIG_STATE)
        self.fixed = {
            "pace": "lockstep",
            "lockstep_timeout": PATIENCE,
            "watchdog.supervisor_timeout": PATIENCE,
        }
        rig = Rig.from_parameters(section, self.experiment.axes, self.experiment.timebase)
        self._driven_by = VALVE_COMMAND if rig.drive == VALVE_COMMAND.name else REFERENCE_FORCE
        self.sends = (VALVE_COMMAND,)
        if self._driven_by is REFERENCE_FORCE:
            self.sends = (VALVE_COMMAND, REFERENCE_FORCE)
            told = reference_force_topic(self.experiment.sections.get("reference_force", {}))
            if section["loop_delay"] and told == TARGET:
                raise InputError(
                    "the rig was driven by the coming motion of a target over a link (loop_delay): "
                    "which message was the newest is not in a bag; replay reference_force"
                )
        listed = record.missed_steps
        if record.missed is None:
            self.notes.append("the bag does not say which commands the rig missed")
        elif record.missed and not listed:
            raise InputError(
                f"the rig missed {record.missed} commands, but the bag does not say which"
            )
        elif record.missed > len(listed):
            self.expected = until(self.expected, listed[-1] + 1)
            self.notes.append(
                f"replayed until step {listed[-1] + 1}: the bag lists only the first "
                f"{len(listed)} of the {record.missed} steps that the rig missed"
            )
        if len(record.held_steps) < len(listed):
            self.notes.append(
                "the bag does not say which commands the rig held: it is sent the last before"
            )
        last = int(self.expected.steps[-1])
        self.steps = last + 1
        self._applied = self._commands(recorded, last)

    def _commands(self, recorded: Recorded, steps: int) -> list[Floats]:
        """Give what was applied after each sample but the last, shape (n,), in the drive's unit."""
        series, record = recorded.series(self._driven_by), recorded.record
        known = {step: values[-1] for step, values in series.samples()}
        known[-1] = np.zeros(len(self.experiment.axes))
        missed = set(record.missed_steps)
        held = dict(zip(record.missed_steps, record.held_steps, strict=False))
        applied, newest = [], -1
        for step in range(steps):
            if step in missed or (record.missed is None and step not in known):
                newest = held.get(step, newest)
            else:
                newest = step
            if newest not in known:
                raise InputError(
                    f"the bag lacks {self._driven_by.name} of step {newest}, which the rig did "
                    "not miss: what it applied is not known"
                )
            applied.append(known[newest])
        return applied

    def replay_steps(self) -> Iterator[ReplayStep]:
        """Give what the node is told, step by step."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        codecs = {topic: TrajectoryCodec(topic, axes, timebase) for topic in self.sends}
        none = np.zeros(len(axes))
        yield ReplayStep(0)
        for step, applied in enumerate(self._applied):
            messages: list[tuple[Topic, bytes]] = []
            for topic, codec in codecs.items():
                value = applied if topic is self._driven_by else none
                messages.append((topic, codec.encode(step, value)))
            yield ReplayStep(step + 1, messages)

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the states of the simulated rig without ROS, with a node's parameters."""
        rig = Rig.from_parameters(dict(section), self.experiment.axes, self.experiment.timebase)
        states = [np.array(rig.reset())]
        for applied in self._applied:
            if rig.violation is not None:
                break
            states.append(np.array(rig.step(applied)))
        return Series(np.arange(len(states), dtype=np.int64), np.array(states)), None
