"""The recording of a test as a bag: read, and written in the form of a recorded one."""

import heapq
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire import messages, topics
from seft_msgs_py.wire.outcome import FINISHED, RIG, TRIPPED, Outcome, rig_status
from seft_msgs_py.wire.topics import LoopTopic, RigAxes, Topic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.bag_files import Bag
from seft_ros.bags.bag_writer import BagWriter
from seft_ros.bags.gathering import (
    EstimatesGatherer,
    ReportGatherer,
    SeriesGatherer,
    trip_of_messages,
)
from seft_ros.bags.message_blocks import MessageBlock
from seft_ros.bags.recording import (
    Description,
    Estimates,
    Recording,
    Series,
    of_all_rigs,
    read_description,
    write_description,
)
from seft_ros.reference_force.reference_force_parameters import reference_force_topic

UNDECODABLE = "undecodable"
"""Key of a recording's environment: number of messages that can't be decoded and were left out."""

_LOOP = (topics.RIG_STATE, topics.REFERENCE_FORCE, topics.VALVE_COMMAND, topics.GROUND_MOTION)
"""Topics that give a test's namespace, the most reliable first."""
_AHEAD = topics.GROUND_MOTION.name, topics.REFERENCE_FORCE.name  # which are sent ahead
_MOST_GAPS = 5


def read_bag(path: str | Path, *, damaged: bool = False) -> Recording:
    """Read the recording of a test from a bag (mcap or sqlite3), whoever recorded it.

    Samples are ordered by step; of duplicates the first counts. Topics may be in a namespace.
    Messages that can't be decoded are left out and counted in ``environment["undecodable"]``;
    other topics are ignored.

    Parameters
    ----------
    path : path
        A bag's folder, or a single mcap or sqlite3 file.
    damaged : bool
        Whether a damaged bag is read, too; what is wrong with it is the recording's ``damage``.

    Raises
    ------
    InputError
        If there is no bag, it is damaged or cut off, or no test is described in it.
    """
    with Bag(path) as file:
        if file.damage and not damaged:
            raise InputError(
                f"{path}: the bag is damaged: {file.fault}; seft report shows what there is, and a "
                f"whole bag of that makes: seft recover {path}"
            )
        bag = _TestBag(file)
        description = bag.description()
        experiment = bag.experiment(description)
        parts = _loop_of(experiment)
        loop: dict[Topic, SeriesGatherer] = {
            topic.of(rig): SeriesGatherer(topic, experiment, rig, bag.count(topic.of(rig)))
            for topic, rigs in parts
            for rig in rigs
        }
        estimates, reports = EstimatesGatherer(experiment), ReportGatherer(experiment.timebase)
        told = {topics.ESTIMATES: estimates.take, topics.DIAGNOSTICS: reports.take_diagnostics}
        bag.gather(loop, {**told, topics.EXPERIMENT_STATE: reports.take_state})
        damage, checked, start_ns = file.recovered + file.damage, file.checked, bag.start_ns
    series = {  # given out once, for memory
        topic.name: of_all_rigs([loop.pop(topic.of(rig)).series() for rig in rigs], rigs)
        for topic, rigs in parts
    }
    outcome = reports.outcome(len(experiment.rigs))
    trip = trip_of_messages(outcome, reports.ending, experiment.timebase)
    _cut(series, outcome)
    received = series[topics.RIG_STATE.name].received_ns
    if received is not None and len(received):
        start_ns = int(received[0])
    end: dict[str, Any] = {"missed": None, "overruns": None, "complete": False}
    if outcome is not None:
        others = ("phase", "steps", "trip", "most_missed")
        end = {name: value for name, value in vars(outcome).items() if name not in others}
    return Recording(
        experiment=experiment,
        series=series,
        estimates=estimates.series(),
        trip=trip,
        stopped=trip is None and reports.stopped(),
        ramp_step=reports.ramp_step,
        link=reports.link(),
        events=reports.events(start_ns),
        facts=description.facts,
        damage=damage and [*damage, *_gaps(series, outcome)],
        checked=checked,
        environment={**description.environment, UNDECODABLE: bag.undecodable},
        **end,
    )


def _cut(series: dict[str, Series], outcome: Outcome | None) -> None:
    """Cut what is not of the test, and hold equal steps once for all topics."""
    if outcome is not None and outcome.steps > 0:  # the rig never sampled later stamps
        series |= {name: one.until(outcome.steps - 1) for name, one in series.items()}
    states = series[topics.RIG_STATE.name].steps
    last_step = int(states[-1]) if len(states) else -1
    for name in _AHEAD:
        series[name] = series[name].until(last_step)
    for name, one in series.items():
        steps = states[: len(one.steps)]
        if np.array_equal(steps, one.steps):
            series[name] = replace(one, steps=steps)


def _gaps(series: Mapping[str, Series], outcome: Outcome | None) -> Iterator[str]:
    """Say which steps of a test are not in its bag."""
    states = series[topics.RIG_STATE.name].steps
    last = max(int(one.steps[-1]) if len(one.steps) else -1 for one in series.values())
    for name, one in series.items():
        of_states = name in _AHEAD and len(states)  # they end with the states
        end = int(states[-1]) if of_states else outcome.steps - 1 if outcome else last
        missing = np.setdiff1d(np.arange(end + 1), one.steps)
        if not len(missing):
            continue
        parts = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1)
        texts = [f"{part[0]} to {part[-1]}" for part in parts[:_MOST_GAPS]]
        more = f" and in {len(parts) - _MOST_GAPS} more places" if parts[_MOST_GAPS:] else ""
        yield f"{name}: {len(missing)} of {end + 1} steps are missing, {', '.join(texts)}{more}"


def read_messages(path: str | Path, of: Sequence[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
    """Give the messages of some topics as they were recorded, those that can be read.

    Yields
    ------
    topic : Topic
        One of them.
    received_ns : int
        When the message was received, ns of the wall clock.
    raw : bytes
        The message.

    Raises
    ------
    InputError
        If there is no bag, or nothing of it can be read.
    """
    with Bag(path) as file:
        yield from _TestBag(file).messages(of)


def _loop_of(experiment: Experiment) -> list[tuple[LoopTopic, tuple[RigAxes, ...]]]:
    """List the topics of the loop, each with the rigs that have their own, or one for all."""
    forces = reference_force_topic(experiment.sections.get("reference_force", {}))
    whole = (RigAxes.whole(experiment.axes),)
    loop = (topics.GROUND_MOTION, topics.RIG_STATE, topics.MEASURED, forces, topics.VALVE_COMMAND)
    return [(topic, experiment.rigs if topic in topics.RIG_TOPICS else whole) for topic in loop]


class _TestBag:
    """An open bag, of which the topics of one test are read."""

    def __init__(self, file: Bag) -> None:
        self.path = file.path
        self.start_ns = 0  # of what `gather` has read
        self.undecodable = 0
        self._file = file
        prefixes: set[str] = set()
        for topic in (topics.DESCRIPTION, *_LOOP):
            ending = "/" + topic.name
            named = (name for name, kind in file.counts if kind == topic.type)
            found = {name.removesuffix(topic.name) for name in named if name.endswith(ending)}
            prefixes = prefixes or found
        if len(prefixes) > 1:
            raise InputError(
                f"{file.path}: the bag holds several tests, in {', '.join(sorted(prefixes))}; "
                "record one namespace in a bag"
            )
        self.prefix = prefixes.pop() if prefixes else "/"

    def description(self) -> Description:
        texts = []
        for *_, raw in self.messages([topics.DESCRIPTION]):
            try:
                texts.append(messages.decode_string(raw))
            except WireError:
                self.undecodable += 1
        description, refused = read_description(texts)
        self.undecodable += refused
        return description

    def experiment(self, description: Description) -> Experiment:
        try:
            return description.experiment()
        except InputError as error:
            fault = f"the bag is damaged: {self._file.fault}; " if self._file.damage else ""
            why = f"{fault}the bag holds no test: {error} on {topics.DESCRIPTION.name}"
            mend = "record tests with seft run or seft simulate, or that topic, too"
            raise InputError(f"{self.path}: {why}; {mend}") from None

    def count(self, topic: Topic) -> int:
        """Count the messages of a topic."""
        return self._file.counts[self._name(topic)]

    def gather(
        self,
        loop: Mapping[Topic, SeriesGatherer],
        others: Mapping[Topic, Callable[[bytes, int], None]],
    ) -> None:
        """Read all messages of some topics, once, in the order in which they were written.

        Those of the loop are many and go block by block, the others one by one.
        """
        takers, firsts = list(others.values()), []
        for block in self._blocks([*loop, *others]):
            firsts.append(int(block.places["time"].min()))
            numbers = block.places["source"]
            for number, gatherer in enumerate(loop.values()):
                self.undecodable += gatherer.take(block.only(numbers == number))
            for number, received_ns, raw in block.only(numbers >= len(loop)).messages():
                try:
                    takers[number - len(loop)](raw, received_ns)
                except (WireError, ValueError):
                    self.undecodable += 1
        self.start_ns = min(firsts, default=0)

    def messages(self, of: Sequence[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
        """Read the messages of some topics, see `read_messages`."""
        for block in self._blocks(of):
            for number, received_ns, raw in block.messages():
                yield of[number], received_ns, raw

    def _blocks(self, of: Sequence[Topic]) -> Iterator[MessageBlock]:
        numbers = {self._name(topic): number for number, topic in enumerate(of)}
        return self._file.blocks(numbers)

    def _name(self, topic: Topic) -> tuple[str, str]:
        return self.prefix + topic.name, topic.type


NOT_FINITE = "not_finite"
"""Key of the environment: number of samples that are NaN or infinite, and fit in no message."""

Chunk = tuple[int, Floats]  # first step, values (p, n)


def write_recording(
    recording: Recording, path: str | Path, ground_motion: Iterable[Chunk] | None = None
) -> None:
    """Write a bag that `read_bag` reads as this recording.

    The messages are those of a test over DDS, in the order of time: the description, then
    each step's rig state, reference force, valve command and estimates, with ground motion one
    message ahead, and the end. The log time of step k is the wall-clock start plus k periods.
    The future motion of a target is not in a recording, and therefore not in the bag.
    Samples that are not finite are left out, as no node sends them, and counted in the
    environment.

    Parameters
    ----------
    recording : Recording
        A test; series may have gaps.
    path : path
        Folder to be made.
    ground_motion : iterable of (first step, ndarray), optional
        Messages of ground motion, each of shape (p, n), m/s^2; they may go beyond the
        recording's end. Default: a message for each of the recording's steps.

    Raises
    ------
    InputError
        If the path exists or can't be written.
    ExperimentError
        If the disk is full.
    """
    timebase, start_ns = recording.experiment.timebase, _start_ns(recording)
    motion = [(first, np.ascontiguousarray(v)[:, np.newaxis]) for first, v in ground_motion or ()]
    sent, not_finite = _messages(recording, motion)
    environment = {k: v for k, v in recording.environment.items() if k != UNDECODABLE}
    if not_finite:
        environment[NOT_FINITE] = not_finite
    described = write_description(recording.experiment.sections, environment, recording.facts)
    texts = [messages.encode_string(text) for text in described]
    with BagWriter(path) as bag:
        for text in texts:
            bag.write(topics.DESCRIPTION, text, start_ns)
        time_ns = start_ns
        for step, topic, raw in sent:
            time_ns = start_ns + timebase.stamp_ns(step)
            bag.write(topic, raw, time_ns)
        if recording.complete and recording.missed is not None:
            statuses = _ending(recording, recording.missed)
            bag.write(topics.DIAGNOSTICS, messages.encode_diagnostics(time_ns, statuses), time_ns)
        for text in texts:  # again, for one of the two places may be damaged
            bag.write(topics.DESCRIPTION, text, time_ns)


_Messages = Iterator[tuple[int, Topic, bytes]]  # with the step at which each is sent


def _messages(recording: Recording, motion: Sequence[Chunk]) -> tuple[_Messages, int]:
    """Give what is sent in a test, in its order, and count samples that are left out.

    Each message of ``motion`` is sent when the one before it begins.
    """
    axes, timebase = recording.experiment.axes, recording.experiment.timebase
    lines, kept, not_finite = list[_Messages](), list[Series](), 0
    for topic, rigs in _loop_of(recording.experiment):
        if topic is topics.GROUND_MOTION and motion:
            continue
        series = recording.series[topic.name]
        kept.append(series if topic is topics.MEASURED else _finite(series))
        not_finite += len(series.steps) - len(kept[-1].steps)
        codecs = [TrajectoryCodec(topic.of(rig), rig.axes, timebase) for rig in rigs]
        lines += map(_of_samples, codecs, rigs, repeat(kept[-1]))
    if (estimates := recording.estimates) is not None:
        kept.append(finite := _finite(estimates))
        not_finite += len(estimates.steps) - len(finite.steps)
        lines.append(_of_estimates(messages.EstimatesCodec(axes, timebase), finite))
    if motion:
        steps = np.unique(np.concatenate([series.steps for series in kept]))
        codec = TrajectoryCodec(topics.GROUND_MOTION, axes, timebase)
        lines.insert(0, _of_chunks(codec, motion, steps))
    return heapq.merge(*lines, key=itemgetter(0)), not_finite


def _finite[Samples: Series](series: Samples) -> Samples:
    """Leave out samples that fit in no message."""
    finite = np.isfinite(series.values).all(axis=(1, 2))
    return series if finite.all() else series.rows(finite)


def _of_samples(codec: TrajectoryCodec, rig: RigAxes, series: Series) -> _Messages:
    for step, values in zip(series.steps.tolist(), series.values[:, :, rig.places], strict=True):
        yield step, codec.topic, codec.encode(step, values)


def _of_chunks(codec: TrajectoryCodec, motion: Sequence[Chunk], steps: Ints) -> _Messages:
    firsts = [first for first, _ in motion]
    sent_at = np.searchsorted(steps, [firsts[0], *firsts[:-1]])
    for step, chunk in zip(steps[sent_at[sent_at < len(steps)]].tolist(), motion, strict=False):
        yield step, codec.topic, codec.encode_points(*chunk)


def _of_estimates(codec: messages.EstimatesCodec, series: Estimates) -> _Messages:
    for step, values in series.samples():
        known = dict(zip(series.names, values, strict=True))
        yield step, topics.ESTIMATES, codec.encode(step, known)


_OF_THE_END = ("missed_steps", "wall_s", "trip", "saturation", "round_trips", "simulated")


def _ending(recording: Recording, missed: int) -> list[messages.Status]:
    """Give the last statuses of the rigs; totals of all are reported by the first."""
    sampled = recording.series[topics.RIG_STATE.name].steps
    known = {name: getattr(recording, name) for name in _OF_THE_END}
    steps, overruns = int(sampled[-1]) + 1 if len(sampled) else 0, recording.overruns or 0
    phase = TRIPPED if recording.trip else FINISHED
    status = rig_status(Outcome(phase, steps, missed, overruns=overruns, **known))
    first, *others = (replace(status, name=rig.node(RIG)) for rig in recording.experiment.rigs)
    quiet = {"missed": "0", "missed_steps": "", "overruns": "0", "saturated": "{}"}
    return [first, *(replace(other, values=other.values | quiet) for other in others)]


def _start_ns(recording: Recording) -> int:
    """Wall-clock start of the test; now, where it is not known."""
    try:
        start = datetime.fromisoformat(recording.environment["start"])
    except (KeyError, TypeError, ValueError):
        return time.time_ns()
    return round(start.timestamp() * 1e6) * 1000
