"""The parts of the other nodes, played for ``rig``."""

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
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.rig.rig import Rig

from seft_ros.recording.record import Estimates, Series
from seft_ros.recording.samples import until
from seft_ros.reference_force.topic import reference_force_topic
from seft_ros.replay.cue import Cue
from seft_ros.replay.held_commands import HeldCommands
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.words import listed

PATIENCE = 60.0  # s that the rig waits for a replay that its machine holds up


class RigPart:
    """Force controller and supervisor of a recorded test, see `seft_ros.replay.cue.Part`.

    The rig goes in lockstep, whatever its pace was; where it missed a command, it is sent the
    one that it held.

    Parameters
    ----------
    recorded : Recorded
        The test.

    Raises
    ------
    InputError
        If a command that the rig did not miss is not in the bag.
    """

    node = "rig"
    answer: LoopTopic = RIG_STATE

    def __init__(self, recorded: Recorded) -> None:
        record = recorded.record
        self._experiment = experiment = record.experiment
        self._states = recorded.series(RIG_STATE)
        self.notes: list[str] = []
        self.fixed: dict[str, object] = {
            "pace": "lockstep",
            "lockstep_timeout": PATIENCE,
            "watchdog.supervisor_timeout": PATIENCE,
        }
        rig = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
        self._driven_by = VALVE_COMMAND if rig.drive == VALVE_COMMAND.name else REFERENCE_FORCE
        self.sends: tuple[LoopTopic, ...] = (VALVE_COMMAND,)
        if self._driven_by is REFERENCE_FORCE:
            self.sends = (VALVE_COMMAND, REFERENCE_FORCE)
            told = reference_force_topic(experiment.sections.get("reference_force", {}))
            if experiment["rig"]["loop_delay"] and told == TARGET:
                raise InputError(
                    "the rig was driven by the coming motion of a target over a link (loop_delay): "
                    "which message was the newest is not in a bag; replay reference_force"
                )
        if record.missed is not None and record.missed > len(record.missed_steps):
            last = record.missed_steps[-1] if record.missed_steps else -1
            if last < 0:
                raise InputError(
                    f"the rig missed {record.missed} commands, but the bag does not say which"
                )
            self._states = until(self._states, last + 1)
            self.notes.append(
                f"replayed until step {last + 1}: the bag lists only the first "
                f"{len(record.missed_steps)} of the {record.missed} steps that the rig missed"
            )
        if record.missed is None:
            self.notes.append("the bag does not say which commands the rig missed")
        held = HeldCommands(recorded, rig, self._states)
        if held.unsure:
            self.notes.append(listed("which command was held, the states do not tell", held.unsure))
        self.steps: int | None = int(self._states.steps[-1]) + 1
        self._applied = held.values[: int(self._states.steps[-1])]

    def cues(self) -> Iterator[Cue]:
        """Give what the node is told, step by step."""
        axes, timebase = self._experiment.axes, self._experiment.timebase
        codecs = {topic: TrajectoryCodec(topic, axes, timebase) for topic in self.sends}
        none = np.zeros(len(axes))
        yield Cue(0, [])
        for step, applied in enumerate(self._applied):
            messages: list[tuple[Topic, bytes]] = []
            for topic, codec in codecs.items():
                value = applied if topic is self._driven_by else none
                messages.append((topic, codec.encode(step, value)))
            yield Cue(step + 1, messages)

    def expected(self) -> Series:
        """Give the recorded answers that replayed ones are held against."""
        return self._states

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the states of the simulated rig without ROS, with a node's parameters."""
        rig = Rig.from_parameters(dict(section), self._experiment.axes, self._experiment.timebase)
        states = [rig.reset()]
        for applied in self._applied:
            if rig.violation is not None:
                break
            states.append(rig.step(applied))
        kept = [np.array(state) for state in states]
        return Series(np.arange(len(kept), dtype=np.int64), np.array(kept)), None
