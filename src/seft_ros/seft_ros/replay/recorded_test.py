"""Replay a recorded test to one node, and compare its answers with the recorded ones."""

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
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import decode_diagnostics
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import (
    DIAGNOSTICS,
    ESTIMATES,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    LoopTopic,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.analysis.comparison import compare_recordings
from seft_ros.analysis.result_text import FIELD_UNITS
from seft_ros.bags.recording import Estimates, Recording, Series
from seft_ros.bags.recording_bag import read_bag, read_messages
from seft_ros.drawing.style import Cell, Mark, Texts, TextTable, number, small_percent
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
    ramp_step : int or None
        First step whose force was ramped down on the supervisor's command; None without one.
    ramp_unknown : bool
        Whether the supervisor commanded a ramp, but reference_force did not report that step.
    """

    recording: Recording
    chunks: list[tuple[int, Floats]]
    points: dict[int, Floats]
    ramp_step: int | None = None
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
    states = recording.series[RIG_STATE.name].steps
    if not len(states):
        raise InputError(f"{path}: the bag has no rig/state; record that topic, too")
    if states[0] != 0:
        raise InputError(
            f"{path}: the bag begins at step {states[0]}: it lacks the steps before, which the "
            "nodes depend on; start recording before the test"
        )
    forces = reference_force_topic(experiment.sections.get("reference_force", {}))
    motion_codec, force_codec = (
        TrajectoryCodec(topic, experiment.axes, experiment.timebase)
        for topic in (GROUND_MOTION, forces)
    )
    chunks: list[tuple[int, Floats]] = []
    points: dict[int, Floats] = {}
    tests, state = 0, ""
    is_ramped = False
    ramp_step: int | None = None
    topics = [EXPERIMENT_STATE, GROUND_MOTION, REFERENCE_FORCE, DIAGNOSTICS]
    for topic, _, raw in read_messages(path, topics):
        with suppress(WireError, ValueError):  # the nodes skip such messages, too
            if topic is GROUND_MOTION:
                first, values = motion_codec.decode(raw)
                chunks.append((first, values[:, 0]))
            elif topic is REFERENCE_FORCE:
                points.setdefault(*force_codec.decode(raw))
            elif topic is EXPERIMENT_STATE:
                last, state = state, decode_state(raw).state
                tests += state == State.RUNNING and state != last
                is_ramped |= state == State.RAMPING_DOWN
            else:
                for status in decode_diagnostics(raw)[1]:
                    if status.name == "reference_force":  # its last report counts
                        text = status.values.get("ramp_step")
                        ramp_step = None if text is None else int(text)
    if tests > 1:
        raise InputError(f"{path}: the bag holds {tests} tests; record one in a bag")
    points = {step: points[step] for step in sorted(points) if step <= states[-1]}
    return Recorded(recording, chunks, points, ramp_step, is_ramped and ramp_step is None)


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
        lost = np.setdiff1d(answered, states)
        if len(lost):
            raise InputError(
                f"the bag lacks rig/state of step {lost[0]}, which {self.node} has answered: "
                "what the node remembers of it can't be replayed"
            )
        unanswered = np.setdiff1d(states, answered)
        self.note_steps("not answered when recorded, and left out", unanswered)
        self.note_steps(
            "neither rig/state nor its answer is in the bag, and whether the node had them is not "
            "known",
            np.setdiff1d(np.arange(answered[-1] if len(answered) else 0), states),
        )


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
        JSON values: ``node``, ``topic``, ``identical``, ``first_difference`` (None, or topic,
        step, field, axis, time_s, recorded, replayed), ``steps`` (of the recorded answers),
        ``answered``, ``max_abs``, ``nrmse``, ``fields``, ``estimates`` (likewise; None where there
        are none), ``notes``.
    """
    recording, topic = recorded.recording, replay.answer.name
    # answers beyond the recorded steps have no counterpart
    given = answers.of_steps(replay.expected.steps)
    theirs = recording.estimates if replay.node == "reference_force" else None
    if mine is not None and theirs is not None:
        mine = mine.until(int(theirs.steps[-1]))
    one, other = (
        replace(recording, series={**recording.series, topic: series}, estimates=some)
        for series, some in ((replay.expected, theirs), (given, mine))
    )
    found = compare_recordings(one, other)
    first = found["first_difference"]
    if first is not None:
        stamp_ns = recording.experiment.timebase.stamp_ns(first["step"])
        first["time_s"] = stamp_ns / 1e9
        first["recorded"], first["replayed"] = first.pop("a"), first.pop("b")
    of_estimates = found["topics"].get(ESTIMATES.name)
    keys = ("max_abs", "nrmse", "fields")
    return {
        "node": replay.node,
        "topic": topic,
        "identical": found["identical"],
        "first_difference": first,
        "steps": len(replay.expected.steps),
        "answered": len(given.steps),
        **{key: found["topics"][topic][key] for key in keys},
        "estimates": None if of_estimates is None else {key: of_estimates[key] for key in keys},
        "notes": list(replay.notes),
    }


def verdict_text(result: dict[str, Any]) -> str:
    """Say in one line whether a node answered as recorded, see `replay_verdict`."""
    node, first = result["node"], result["first_difference"]
    if first is None:
        return f"{node}: {result['steps']} answers identical, bit for bit"
    where = f"{node}: first difference at step {first['step']} ({first['time_s']:g} s)"
    if first["field"] is None:
        return f"{where}: {first['topic']} is {first['replayed']}, but was {first['recorded']}"
    return (
        f"{where}, {first['topic']}, {first['field']} of axis {first['axis']}: recorded "
        f"{first['recorded']!r}, replayed {first['replayed']!r}"
    )


def replay_texts(result: dict[str, Any]) -> Texts:
    """Tabulate how the answers of a node differ from the recorded ones; the verdict below."""
    groups = {result["topic"]: result["fields"]}
    if result["estimates"] is not None:
        groups["estimates"] = result["estimates"]["fields"]
    rows = [
        [
            f"{topic} {name}",
            f"{number(row['max_abs'], form='.3g')} {FIELD_UNITS.get((topic, name), '')}".strip(),
            small_percent(row["nrmse"]),
        ]
        for topic, fields in groups.items()
        for name, row in fields.items()
    ]
    title = f"{result['node']}: {result['answered']} of {result['steps']} answers"
    table = TextTable(("answers", "largest\ndifference", "NRMSE"), rows)
    mark = Mark.GOOD if result["identical"] else Mark.BAD
    return [title, table, Cell(verdict_text(result), mark)]
