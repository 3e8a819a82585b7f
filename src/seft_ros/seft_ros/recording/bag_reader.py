"""Read a bag back as the record of a test."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.messages import decode_string
from seft_msgs_py.wire.outcome import Saturation
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    DIAGNOSTICS,
    ESTIMATES,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    RIG_TOPICS,
    VALVE_COMMAND,
    Topic,
)

from seft_ros.recording.bag_files import open_bag, read_blocks
from seft_ros.recording.description import Description, infer_experiment, read_description
from seft_ros.recording.gathering import (
    EstimatesGatherer,
    EventLog,
    Gatherer,
    SeriesGatherer,
    StateGatherer,
    StatusGatherer,
    trip_of,
)
from seft_ros.recording.record import Record
from seft_ros.recording.samples import of_all_rigs, on_steps_of, until
from seft_ros.reference_force.reference_force_parameters import reference_force_topic

UNDECODABLE = "undecodable"
"""Key of a record's environment: messages that could not be understood, and were left out."""

_TELLING = (RIG_STATE, REFERENCE_FORCE, VALVE_COMMAND, GROUND_MOTION)
"""Topics that tell where a test stands in a bag, and its axes and rate; the first says most."""


def read_bag(path: str | Path, *, described: bool = True) -> Record:
    """Read the record of a test from a bag (mcap or sqlite3), whoever recorded it.

    Samples are ordered by step; of a step that came twice the first counts. Topics may
    stand in a namespace. Messages that can't be decoded are left out and counted in
    ``environment["undecodable"]``; other topics are not looked at.

    Parameters
    ----------
    path : path
        A bag's folder, or a single mcap or sqlite3 file.
    described : bool
        Whether the bag must hold the configuration. If not, and it does not, axes and rate are
        told from the samples.

    Raises
    ------
    InputError
        If there is no bag, it is damaged or cut off, no test is described in it, or there are
        no samples that tell axes and rate.
    """
    with closing(open_bag(path)) as reader:
        bag = _Bag(Path(path), reader)
        description = bag.description()
        known = described or bool(description.sections)
        experiment = bag.experiment(description) if known else bag.inferred_experiment()
        loop: dict[Topic, SeriesGatherer] = {
            topic.of(rig): SeriesGatherer(topic, experiment, bag.count(topic.of(rig)), rig)
            for topic in RIG_TOPICS
            for rig in experiment.rigs
        }
        forces = reference_force_topic(experiment.sections.get("reference_force", {}))
        for topic in (GROUND_MOTION, forces):
            loop[topic] = SeriesGatherer(topic, experiment, bag.count(topic))
        log = EventLog()
        estimates = EstimatesGatherer(experiment)
        statuses, test = StatusGatherer(experiment.timebase, log), StateGatherer(log)
        bag.gather(loop, {ESTIMATES: estimates, DIAGNOSTICS: statuses, EXPERIMENT_STATE: test})
        start_ns = reader.start_time
    series = {
        topic.name: of_all_rigs(
            [loop[topic.of(rig)].series() for rig in experiment.rigs], experiment.rigs
        )
        for topic in RIG_TOPICS
    }
    series |= {t.name: loop[t].series() for t in (GROUND_MOTION, forces)}
    outcome = statuses.outcome(len(experiment.rigs))
    if outcome is not None and outcome.steps > 0:  # what is stamped later, the rig never sampled
        series = {name: until(one, outcome.steps - 1) for name, one in series.items()}
    states = series[RIG_STATE.name].steps
    received = series[RIG_STATE.name].received_ns
    if received is not None and len(received):
        start_ns = int(received[0])
    if known or len(states):
        last_step = int(states[-1]) if len(states) else -1
        for topic in (GROUND_MOTION, REFERENCE_FORCE):  # which go ahead
            series[topic.name] = until(series[topic.name], last_step)
    series = {name: on_steps_of(series[RIG_STATE.name], one) for name, one in series.items()}
    undecodable = bag.undecodable + sum(one.undecodable for one in loop.values())
    undecodable += estimates.undecodable + statuses.undecodable + test.undecodable
    return Record(
        experiment=experiment,
        series=series,
        estimates=estimates.series(),
        trip=trip_of(outcome, test.ending, experiment.timebase),
        missed=outcome.missed if outcome else None,
        missed_steps=outcome.missed_steps if outcome else [],
        held_steps=outcome.held_steps if outcome else [],
        overruns=outcome.overruns if outcome else None,
        saturation=outcome.saturation if outcome else Saturation(),
        round_trips=outcome.round_trips if outcome else {},
        link=statuses.link(),
        events=log.events(start_ns),
        wall_s=outcome.wall_s if outcome else None,
        complete=outcome is not None,
        described=known,
        environment={**description.environment, UNDECODABLE: undecodable},
    )


def read_messages(path: str | Path, topics: Sequence[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
    """Give the messages of some topics as they were recorded, in the order of time.

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
        If there is no bag, or it is damaged or cut off.
    """
    with closing(open_bag(path)) as reader:
        bag = _Bag(Path(path), reader)
        found = [(topic, item) for topic in topics for item in bag.connections_of(topic)]
        for block in read_blocks(reader, [item for _, item in found], path):
            for source, received_ns, raw in block.messages():
                yield found[source][0], received_ns, raw


class _Bag:
    """An open bag, of which the topics of one test are read."""

    def __init__(self, path: Path, reader: Reader) -> None:
        self.path = path
        self.reader = reader
        self.undecodable = 0
        prefixes: set[str] = set()
        for topic in (DESCRIPTION, *_TELLING):
            found = {item.topic for item in reader.connections if _is(topic, item)}
            prefixes = prefixes or {name.removesuffix(topic.name) for name in found}
        if len(prefixes) > 1:
            raise InputError(
                f"{path}: the bag holds several tests, in {', '.join(sorted(prefixes))}; "
                "record one namespace in a bag"
            )
        self.prefix = prefixes.pop() if prefixes else "/"

    def connections_of(self, topic: Topic) -> list[Connection]:
        """List the connections of a topic that carry its type."""
        named = self.prefix + topic.name, topic.type
        return [item for item in self.reader.connections if (item.topic, item.msgtype) == named]

    def description(self) -> Description:
        texts = []
        for raw in self._raws(self.connections_of(DESCRIPTION)):
            try:
                texts.append(decode_string(raw))
            except WireError:
                self.undecodable += 1
        description, refused = read_description(texts)
        self.undecodable += refused
        return description

    def experiment(self, description: Description) -> Experiment:
        try:
            return description.experiment()
        except InputError as error:
            raise InputError(
                f"{self.path}: the bag holds no test: {error} on {DESCRIPTION.name}; record tests "
                "with seft run or seft simulate, or that topic too (seft compare does without)"
            ) from None

    def inferred_experiment(self) -> Experiment:
        for topic in _TELLING:
            connections = self.connections_of(topic)
            if not sum(connection.msgcount for connection in connections):
                continue
            try:
                return infer_experiment(self._raws(connections))
            except InputError as error:
                raise InputError(
                    f"{self.path}: the bag holds no test that can be read: {error} on {topic.name}"
                ) from None
        names = ", ".join(topic.name for topic in _TELLING)
        raise InputError(f"{self.path}: the bag holds no test, for it has nothing on {names}")

    def count(self, topic: Topic) -> int:
        """Count the messages of a topic, as the bag claims."""
        return sum(connection.msgcount for connection in self.connections_of(topic))

    def gather(
        self, loop: Mapping[Topic, SeriesGatherer], others: Mapping[Topic, Gatherer]
    ) -> None:
        """Let all messages of some topics go by, once, in the order of time.

        Those of the loop are many and go block by block, the others one by one.
        """
        found = [(n, c) for n, t in enumerate([*loop, *others]) for c in self.connections_of(t)]
        number = np.array([n for n, _ in found], np.int64)  # of the gatherer, by connection
        singly = list(others.values())
        for block in read_blocks(self.reader, [c for _, c in found], self.path):
            taker = number[block.places["source"]]
            for at, gatherer in enumerate(loop.values()):
                gatherer.take(block.only(taker == at))
            for source, received_ns, raw in block.only(taker >= len(loop)).messages():
                singly[number[source] - len(loop)].take(raw, received_ns)

    def _raws(self, connections: list[Connection]) -> Iterator[bytes]:
        for block in read_blocks(self.reader, connections, self.path):
            for _, _, raw in block.messages():
                yield raw


def _is(topic: Topic, connection: Connection) -> bool:
    return connection.msgtype == topic.type and connection.topic.endswith("/" + topic.name)
