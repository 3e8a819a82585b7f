"""Replay a recorded test to the block of one node, and compare its answers with the recorded."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment, Override
from seft_msgs_py.config.facts import EVERY_NODE, place_of
from seft_msgs_py.config.parameter_table import Section, nearest
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import LoopTopic
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.judge.guard import DRIVE_ROW
from seft_plant_sim.rig import Rig

from seft_ros.analysis.comparison import compare_recordings
from seft_ros.analysis.result_text import comparison_texts
from seft_ros.bags.gathering import EstimatesGatherer
from seft_ros.bags.recording import Estimates, Recording, Series, series_of
from seft_ros.bags.recording_bag import read_bag, read_messages
from seft_ros.drawing.style import Texts
from seft_ros.force_controller.force_controller_parameters import FOLLOW_TARGETS
from seft_ros.force_controller.interlock import Interlock
from seft_ros.protection.protected_force import ProtectedForce
from seft_ros.reference_force.reference_force_block import EstimateSampler, MotionBuffer
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.test_run.parameter_tables import TABLES


@dataclass(frozen=True)
class Recorded:
    """A recorded test.

    Attributes
    ----------
    recording : Recording
        Its samples and configuration.
    chunks : list of (int, ndarray)
        The messages of ground motion in their order: first step, and accelerations of shape
        (p, n), m/s^2. They reach beyond the test's end, as far as the motion was sent ahead.
    points : dict
        Step -> points of the message of reference_force that answers its state, shape (p, q, n).
    ramp_unknown : bool
        Whether the supervisor commanded a ramp, but reference_force did not report that step.
    """

    recording: Recording
    chunks: list[tuple[int, Floats]]
    points: dict[int, Floats]
    ramp_unknown: bool = False

    def series(self, topic: LoopTopic) -> Series:
        """Give the samples of a topic, by step."""
        return self.recording.series[topic.name]


def read_recorded(path: str | Path) -> Recorded:
    """Read a test to be replayed.

    Raises
    ------
    InputError
        If the bag can't be read, lacks the test's beginning, or has several tests.
    """
    recording = read_bag(path)
    experiment = recording.experiment
    if len(experiment.rigs) > 1:
        raise InputError(f"{path}: a test of several rigs; only tests of one can be replayed")
    states = recording.series[topics.RIG_STATE.name].steps
    if not len(states):
        raise InputError(f"{path}: the bag has no rig/state; record that topic, too")
    if states[0] != 0:
        mend = "the nodes depend on the steps before; start recording before the test"
        raise InputError(f"{path}: the bag begins at step {states[0]}: {mend}")
    forces = reference_force_topic(experiment.sections.get("reference_force", {}))
    motion_codec, force_codec = (
        TrajectoryCodec(topic, experiment.axes, experiment.timebase)
        for topic in (topics.GROUND_MOTION, forces)
    )
    chunks, points = list[tuple[int, Floats]](), dict[int, Floats]()
    tests, state, is_ramped = 0, "", False
    read = [topics.EXPERIMENT_STATE, topics.GROUND_MOTION, topics.REFERENCE_FORCE]
    for topic, _, raw in read_messages(path, read):
        with suppress(WireError, ValueError):  # the nodes skip such messages, too
            if topic is topics.GROUND_MOTION:
                first, values = motion_codec.decode(raw)
                chunks.append((first, values[:, 0]))
            elif topic is topics.REFERENCE_FORCE:
                points.setdefault(*force_codec.decode(raw))
            else:
                last, state = state, decode_state(raw).state
                tests += state == State.RUNNING and state != last
                is_ramped |= state == State.RAMPING_DOWN
    if tests > 1:
        raise InputError(f"{path}: the bag holds {tests} tests; record one in a bag")
    points = {step: points[step] for step in sorted(points) if step <= states[-1]}
    return Recorded(recording, chunks, points, is_ramped and recording.ramp_step is None)


class Replay(ABC):
    """A recorded test as one node received it.

    Parameters
    ----------
    recorded : Recorded
        The test.

    Attributes
    ----------
    node : str
        Name of the node.
    answer : LoopTopic
        Topic of its answers.
    expected : Series
        The recorded answers.
    notes : list of str
        What the replay can't do as the test did.

    Raises
    ------
    InputError
        If the bag lacks what the node was sent.
    """

    node: ClassVar[str]
    answer: LoopTopic
    expected: Series

    def __init__(self, recorded: Recorded) -> None:
        self.experiment = recorded.recording.experiment
        self.notes: list[str] = []

    @abstractmethod
    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Compute the answers of the node's block, with a node's parameters."""

    def note_steps(self, what: str, steps: npt.ArrayLike) -> None:
        """Note for how many steps something holds, and name the first; nothing if for none."""
        if len(listed := np.asarray(steps).tolist()):
            more = f" and {len(listed) - 1} more" if len(listed) > 1 else ""
            self.notes.append(f"{what}: step {listed[0]}{more}")

    def note_unanswered(self, states: Ints, answered: Ints) -> None:
        """Note which recorded states the node did not answer: these are left out.

        Raises
        ------
        InputError
            If a state that was answered is not in the bag.
        """
        if len(lost := np.setdiff1d(answered, states)):
            why = f"which {self.node} has answered: what it remembers of it can't be replayed"
            raise InputError(f"the bag lacks rig/state of step {lost[0]}, {why}")
        self.note_steps("not answered when recorded, and left out", np.setdiff1d(states, answered))
        unknown = np.setdiff1d(np.arange(answered[-1] if len(answered) else 0), states)
        what = "neither rig/state nor its answer is in the bag, and whether the node had them"
        self.note_steps(f"{what} is not known", unknown)


def section_of(replay: Replay, overrides: Sequence[Override]) -> Section:
    """Give the parameters of the node: the recorded ones with overrides.

    Raises
    ------
    InputError
        If a parameter is none of the node's, or one on which the samples depend.
    """
    section = replay.experiment[replay.node]
    given = [(place_of(name, replay.node), name, value) for name, value in section.items()]
    for node, name, _ in overrides:
        if name in ("rate", "axes"):
            raise InputError(f"-p {name}: the recorded samples have their own {name}")
        if node not in (replay.node, EVERY_NODE, place_of(name, replay.node)):
            raise InputError(f"-p {node}:{name}: the replay is to {replay.node} alone")
    return Experiment.load(TABLES, [], [*given, *overrides], nodes=[replay.node])[replay.node]


def replay_verdict(
    replay: Replay, recorded: Recorded, answers: Series, mine: Estimates | None
) -> dict[str, Any]:
    """Compare the answers of a node with the recorded ones, by step, bit for bit.

    Returns
    -------
    dict
        What `compare_recordings` says of the answers and the estimates, a as recorded, b replayed;
        and ``node``, ``steps`` (of the recorded answers), ``notes``.
    """
    recording, topic = recorded.recording, replay.answer.name
    shown = topic, topics.ESTIMATES.name
    # answers beyond the recorded steps have no counterpart
    given = answers.of_steps(replay.expected.steps)
    theirs = recording.estimates if replay.node == "reference_force" else None
    if mine is not None and theirs is not None:
        mine = mine.until(int(theirs.steps[-1]))
    one, other = (
        replace(recording, series={**recording.series, topic: series}, estimates=some, missed=0)
        for series, some in ((replay.expected, theirs), (given, mine))
    )
    found = compare_recordings(one, other)
    kept = {name: found["topics"][name] for name in found["topics"] if name in shown}
    own = {"node": replay.node, "steps": len(replay.expected.steps), "notes": list(replay.notes)}
    return found | own | {"topics": kept}


def replay_texts(result: dict[str, Any]) -> Texts:
    """Show how the answers of a node differ from the recorded ones."""
    title = f"{result['node']}: {result['steps']} answers, a as recorded, b replayed"
    return [title, *comparison_texts(result)]


def _lacks(topic: str, step: int, node: str) -> InputError:
    mend = "record that topic from the start on"
    return InputError(f"the bag lacks {topic} of step {step}, which {node} has answered; {mend}")


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
        self._ramp_step = recorded.recording.ramp_step
        if recorded.ramp_unknown:
            what = "the step at which the supervisor ramped it down"
            self.notes.append(f"reference_force does not report {what}: replayed without that ramp")
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
            unrecorded = np.setdiff1d(recorded.series(topics.VALVE_COMMAND).steps, answered)
            if recorded.recording.trip is None:
                self.note_steps("the bag lacks the recorded answer", unrecorded)
                answered = np.union1d(answered, unrecorded)
        states = recorded.recording.states
        self.note_unanswered(states.steps, answered)
        self._states = states.of_steps(answered)
        unmoved = answered[answered >= moved]
        if len(unmoved) and not (self._ramp_step is not None and unmoved[0] >= self._ramp_step):
            raise _lacks("ground_motion", unmoved[0], self.node)

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
    answer: LoopTopic = topics.VALVE_COMMAND

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        section, trip = self.experiment["force_controller"], recorded.recording.trip
        if section["loop_delay"]:
            raise InputError(
                "force_controller answered over a link (loop_delay): which force was the newest "
                "when a state came is not in a bag; replay reference_force or rig"
            )
        self.expected = recorded.series(topics.VALVE_COMMAND)
        if trip is not None and BY_TIME in trip.reason:
            self.expected = self.expected.until(trip.step)
            self.notes.append(f"replayed until step {trip.step}, where a timeout tripped it")
        states, self._points = recorded.series(topics.RIG_STATE), recorded.points
        looks_ahead = section["method"] in FOLLOW_TARGETS
        if looks_ahead and all(len(points) == 1 for points in self._points.values()):
            lacks = "the future motion of the target, which is not in a bag of seft simulate"
            raise InputError(f"force_controller needs {lacks}; replay reference_force or rig")
        commanded = self.expected.steps
        sent = states.until(int(commanded[-1]) if len(commanded) else -1)
        self.note_unanswered(sent.steps, commanded)
        self._states = dict(states.samples())
        forceless = np.setdiff1d(commanded, list(self._points))
        if len(forceless) and trip is None:  # a tripped one waits for no force
            raise _lacks("reference_force", forceless[0], self.node)

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Compute the commands."""
        axes, timebase = self.experiment.axes, self.experiment.timebase
        interlock = Interlock.from_parameters(dict(section), axes, timebase)
        commands, none = dict[int, Floats](), np.zeros((1, 1, len(axes)))
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
    answer: LoopTopic = topics.RIG_STATE

    def __init__(self, recorded: Recorded) -> None:
        super().__init__(recorded)
        states = recorded.series(topics.RIG_STATE)
        whole = int((states.steps == np.arange(len(states.steps))).sum())
        self.expected = states.until(whole - 1)
        if whole < len(states.steps):
            why = "rig/state of the next is not in the bag"
            self.notes.append(f"replayed until step {whole - 1}: {why}")

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Compute the states of the simulated rig."""
        rig = Rig(dict(section), self.experiment.axes, self.experiment.timebase)
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
