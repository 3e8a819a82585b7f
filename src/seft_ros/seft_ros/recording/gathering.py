"""What the topics of a test hold, gathered while a bag goes by.

Each object takes the messages of one topic, and counts those that it can't understand.
"""

from functools import lru_cache
from math import inf

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import (
    ERROR,
    OK,
    STALE,
    WARN,
    EstimatesCodec,
    Status,
    decode_diagnostics,
    decode_status,
)
from seft_msgs_py.wire.outcome import ENDED, STOPPED, Outcome, State, Trip, read_outcome
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND, Timebase
from seft_msgs_py.wire.topics import (
    GROUND_MOTION,
    REFERENCE_FORCE,
    TARGET,
    LoopTopic,
    RigAxes,
    bare,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec, decode_batch

from seft_ros.force_controller.link_record import LinkRecord
from seft_ros.recording.message_block import MessageBlock
from seft_ros.recording.record import Estimates, Event, Series
from seft_ros.recording.samples import EstimateBuffer, SampleBuffer

_MOST_EVENTS = 1000
_LEVELS = {OK: "ok", WARN: "warn", ERROR: "error", STALE: "stale"}


class SeriesGatherer:
    """Samples of a topic of the loop, with all axes or those of one rig.

    Over a link, a message tells the reference force of later steps, too. Of a target, which goes
    on changing, the first point of each message counts.
    """

    def __init__(
        self,
        topic: LoopTopic,
        experiment: Experiment,
        expected: int,
        rig: RigAxes | None = None,
    ) -> None:
        self.undecodable = 0
        axes = rig.axes if rig else experiment.axes
        self._codec = TrajectoryCodec(topic, axes, experiment.timebase)
        self._samples = SampleBuffer(len(topic.quantities), len(axes), expected)
        self._timed = topic is not GROUND_MOTION  # which goes ahead, sooner or later
        self._ahead = inf
        if topic == REFERENCE_FORCE:
            section = experiment.sections.get("reference_force", {})
            self._ahead = max(section.get("loop_delay", 0), 0)
        elif topic == TARGET:
            self._ahead = 0

    def take(self, block: MessageBlock) -> None:
        """Take the next messages of the topic."""
        for rows, received in block.alike():
            batch = decode_batch(self._codec, rows).up_to(self._ahead)
            times = received[batch.messages] if self._timed else None
            self._samples.append(batch.steps, batch.values, times)
            self.undecodable += batch.refused

    def series(self) -> Series:
        """Give what was gathered, once."""
        return self._samples.series()


class EstimatesGatherer:
    """Estimates of a compensation method."""

    def __init__(self, experiment: Experiment) -> None:
        self.undecodable = 0
        self._codec = EstimatesCodec(experiment.axes, experiment.timebase)
        self._estimates = EstimateBuffer()

    def take(self, raw: bytes, received_ns: int) -> None:
        """Take the next message."""
        del received_ns  # the step says when
        try:
            self._estimates.append(*self._codec.decode(raw))
        except WireError:
            self.undecodable += 1

    def series(self) -> Estimates | None:
        """Give what was gathered; None if that is nothing."""
        return self._estimates.series()


class StatusGatherer:
    """What the nodes told in their diagnostics: how the test ended, and what changed."""

    def __init__(self, timebase: Timebase, log: "EventLog") -> None:
        self.undecodable = 0
        self._outcomes: dict[str, Outcome] = {}  # of the rigs
        self._links: dict[str, LinkRecord] = {}  # of the force controllers
        self._timebase, self._log = timebase, log
        self._decode = lru_cache(64)(decode_diagnostics)  # nodes repeat themselves

    def take(self, raw: bytes, received_ns: int) -> None:
        """Take the next message."""
        try:
            _, statuses = self._decode(raw[:4] + bytes(8) + raw[12:])  # but for the stamp
        except WireError:
            self.undecodable += 1
            return
        for status in statuses:
            if (outcome := read_outcome(status, self._timebase)) is not None:
                self._outcomes[status.name] = outcome
            if bare(status.name) == "force_controller" and "link" in status.values:
                self._take_link(status.name, status.values["link"])
            self._log.add(received_ns, status, status.message)

    def outcome(self, rigs: int) -> Outcome | None:
        """How the test ended, once as many rigs as it has have said so; else None."""
        if len(self._outcomes) < rigs:
            return None
        return Outcome.of_all(list(self._outcomes.values()))

    def link(self) -> LinkRecord | None:
        """How messages came over links; None as long as no force controller told of one."""
        return LinkRecord.of_all(self._links.values()) if self._links else None

    def _take_link(self, node: str, text: str) -> None:
        try:
            self._links[node] = LinkRecord.from_json(text)
        except ValueError:
            self.undecodable += 1


class StateGatherer:
    """What the supervisor told of the test's state."""

    def __init__(self, log: "EventLog") -> None:
        self.undecodable = 0
        self.ending: Status | None = None  # the last that says how the test ended
        self._log = log

    def take(self, raw: bytes, received_ns: int) -> None:
        """Take the next message."""
        try:
            status = decode_status(raw)
        except WireError:
            self.undecodable += 1
            return
        if status.message in ENDED:
            self.ending = status
        detail, text = status.values.get("detail", ""), status.message
        self._log.add(received_ns, status, text if detail in ("", text) else f"{text}: {detail}")


class EventLog:
    """What nodes told, each thing once until that node tells another; not without bound."""

    def __init__(self) -> None:
        self._told: dict[str, tuple[int, str]] = {}
        self._events: list[tuple[int, str, int, str]] = []

    def add(self, received_ns: int, status: Status, text: str) -> None:
        """Take in what a node tells."""
        told = (status.level, text)
        if self._told.get(status.name) != told and len(self._events) < _MOST_EVENTS:
            self._events.append((received_ns, status.name, *told))
        self._told[status.name] = told

    def events(self, start_ns: int) -> list[Event]:
        """Give the events with their times after a moment of the wall clock."""
        return [
            Event((at - start_ns) / NANOSECONDS_PER_SECOND, source, _LEVELS.get(level, "?"), text)
            for at, source, level, text in self._events
        ]


Gatherer = EstimatesGatherer | StatusGatherer | StateGatherer
"""Takes messages one by one."""


def trip_of(outcome: Outcome | None, ending: Status | None, timebase: Timebase) -> Trip | None:
    """Say why a test ended: the rig knows its own limits, the supervisor all else.

    ``outcome`` is the end as the rig saw it, ``ending`` the supervisor's last ``done`` or
    ``tripped``. None if the test ran to the end of its record, or nobody says why it did not.
    """
    trip = outcome.trip if outcome else None
    if ending is None or (trip is None and ending.message != State.TRIPPED):
        return trip
    if ending.message != State.TRIPPED and trip is not None and trip.reason != STOPPED:
        return trip
    told = ending.values.get("step", "")
    if told.isdecimal():
        step = int(told)
    elif trip is not None:
        step = trip.step
    else:
        step = max(0, outcome.steps - 1) if outcome else 0
    return Trip(ending.values.get("detail", ""), step, timebase.stamp_ns(step) / 1e9)
