"""Collect what the topics of a test hold while the messages of its bag are read.

Collectors raise `WireError` or ValueError for a message that they can't decode.
"""

from collections.abc import Mapping
from functools import lru_cache
from math import inf

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import EXPERIMENT, ExperimentState, decode_state
from seft_msgs_py.wire.messages import ERROR, OK, STALE, WARN, EstimatesCodec, decode_diagnostics
from seft_msgs_py.wire.outcome import (
    BY_OPERATOR,
    ENDED,
    STOPPED,
    LinkReport,
    Outcome,
    State,
    Trip,
    read_outcome,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec, decode_batch

from seft_ros.bags.message_blocks import MessageBlock
from seft_ros.bags.recording import Estimates, Event, Series, require_names, series_of

_MOST_EVENTS = 1000
_LEVELS = {OK: "ok", WARN: "warn", ERROR: "error", STALE: "stale"}


class SeriesGatherer:
    """Samples of a topic of the loop, in arrays that grow in place; memory is that of the samples.

    Parameters
    ----------
    topic : LoopTopic
        The topic.
    experiment : Experiment
        The test's.
    rig : RigAxes
        The axes of the messages.
    expected : int
        Number of samples to expect; the part that is not filled takes no memory.
    """

    def __init__(
        self, topic: topics.LoopTopic, experiment: Experiment, rig: topics.RigAxes, expected: int
    ) -> None:
        self._codec = TrajectoryCodec(topic, rig.axes, experiment.timebase)
        # of a target and a stop, revised from step to step, the first point of a message counts
        self._ahead = inf if topic.every_point else 0
        if topic == topics.REFERENCE_FORCE:  # over a link it holds the forces of later steps, too
            delay = experiment.sections.get("reference_force", {}).get("loop_delay", 0)
            self._ahead = max(delay, 0)
        self._times_count = topic is not topics.GROUND_MOTION  # which is sent ahead
        size = max(1, expected)
        self._steps, self._received = np.empty(size, np.int64), np.empty(size, np.int64)
        self._values = np.empty((size, len(topic.quantities), len(rig.axes)))
        self._count = 0

    def take(self, block: MessageBlock) -> int:
        """Take the next messages of the topic; give the number of those that can't be decoded."""
        refused = 0
        for rows, received in block.alike():
            batch = decode_batch(self._codec, rows).up_to(self._ahead)
            end = self._count + len(batch.steps)
            if end > len(self._steps):
                self._resize(max(end, 2 * len(self._steps)))
            new = slice(self._count, end)
            self._steps[new], self._values[new] = batch.steps, batch.values
            self._received[new] = received[batch.messages]
            self._count = end
            refused += batch.refused
        return refused

    def series(self) -> Series:
        """Give them ordered by step, of duplicates the first; nothing may be added any more.

        Samples that came in order, as they mostly do, are not copied.
        """
        self._resize(self._count)
        steps, received = self._steps, self._received if self._times_count else None
        series = Series(steps, self._values, received_ns=received)
        if (steps[1:] > steps[:-1]).all():
            return series
        return series.rows(np.unique(steps, return_index=True)[1])

    def _resize(self, count: int) -> None:
        # nobody else has seen the arrays; the check takes a debugger's frames for references
        for array in (self._steps, self._received, self._values):
            array.resize((count, *array.shape[1:]), refcheck=False)


class EstimatesGatherer:
    """Estimates of a compensation method, all with the names of the first."""

    def __init__(self, experiment: Experiment) -> None:
        self._codec = EstimatesCodec(experiment.axes, experiment.timebase)
        self._names: tuple[str, ...] = ()
        self._samples: dict[int, Floats] = {}

    def take(self, raw: bytes, _received_ns: int) -> None:
        """Take the next message."""
        self.append(*self._codec.decode(raw))

    def append(self, step: int, estimates: Mapping[str, Floats]) -> None:
        """Add the estimates of a step, name -> shape (n,); an empty mapping adds nothing.

        Raises
        ------
        WireError
            If their names differ from those of the first step.
        """
        if estimates:
            self._names = self._names or tuple(estimates)
            require_names(step, estimates, self._names)
            self._samples.setdefault(step, np.stack(list(estimates.values())))

    def series(self) -> Estimates | None:
        """Give them ordered by step, of duplicates the first; None if there are none."""
        if not self._samples:
            return None
        series = series_of(self._samples, len(self._names), axes=-1)
        return Estimates(series.steps, series.values, self._names)


class ReportGatherer:
    """What the nodes report in diagnostics, and the supervisor of the test's state.

    Attributes
    ----------
    ending : ExperimentState or None
        The supervisor's last ``done`` or ``tripped``.
    ramp_step : int or None
        First step whose reference force the supervisor had ramped down; None if it had not.
    """

    def __init__(self, timebase: topics.Timebase) -> None:
        self.ending: ExperimentState | None = None
        self.ramp_step: int | None = None
        self._outcomes: dict[str, Outcome] = {}  # of the rigs
        self._links: dict[str, LinkReport] = {}  # of the force controllers
        self._last: dict[str, tuple[int, str]] = {}  # level and text, by node
        self._events: list[tuple[int, str, int, str]] = []
        self._timebase = timebase
        self._decode = lru_cache(64)(decode_diagnostics)  # nodes repeat themselves

    def take_diagnostics(self, raw: bytes, received_ns: int) -> None:
        """Take the next message of diagnostics."""
        _, statuses = self._decode(raw[:4] + bytes(8) + raw[12:])  # without the stamp
        for status in statuses:
            self._log(received_ns, status.name, status.level, status.message)
            if (outcome := read_outcome(status, self._timebase)) is not None:
                self._outcomes[status.name] = outcome
            if topics.bare(status.name) == "force_controller" and "link" in status.values:
                self._links[status.name] = LinkReport.from_json(status.values["link"])
            if status.name == "reference_force" and "ramp_step" in status.values:
                self.ramp_step = int(status.values["ramp_step"])

    def take_state(self, raw: bytes, received_ns: int) -> None:
        """Take the next message of the supervisor."""
        test = decode_state(raw)
        if test.state in ENDED:
            self.ending = test
        detail, text = test.detail, str(test.state)
        text = text if detail in ("", text) else f"{text}: {detail}"
        self._log(received_ns, EXPERIMENT, test.level, text)

    def _log(self, received_ns: int, source: str, level: int, text: str) -> None:
        """Log each report once until the node's next, differing one; not without bound."""
        report = (level, text)
        if self._last.get(source) != report and len(self._events) < _MOST_EVENTS:
            self._events.append((received_ns, source, *report))
        self._last[source] = report

    def events(self, start_ns: int) -> list[Event]:
        """Give the log, with times after a moment of the wall clock."""
        return [
            Event((at - start_ns) / 1e9, source, _LEVELS.get(level, "?"), text)
            for at, source, level, text in self._events
        ]

    def outcome(self, rigs: int) -> Outcome | None:
        """How the test ended, once all of so many rigs have reported it; else None."""
        found = list(self._outcomes.values())
        return Outcome.of_all(found) if len(found) >= rigs else None

    def stopped(self) -> bool:
        """Whether the operator stopped the test."""
        end = self.ending
        return end is not None and (end.state, end.detail) == (State.DONE, BY_OPERATOR)

    def link(self) -> LinkReport | None:
        """How messages arrived over links; None if no force controller reported it."""
        return LinkReport.of_all(self._links.values()) if self._links else None


def trip_of_messages(
    outcome: Outcome | None, ending: ExperimentState | None, timebase: topics.Timebase
) -> Trip | None:
    """Give the cause of a trip: the rig knows its own limits, the supervisor all others.

    ``outcome`` is the end as the rig saw it, ``ending`` the supervisor's last ``done`` or
    ``tripped``. None if the test ran to the end of its record, the operator stopped it, or the
    cause is not recorded.
    """
    trip = outcome.trip if outcome else None
    if ending is None:
        return trip
    if ending.state != State.TRIPPED:
        return None if trip is None or trip.reason == STOPPED else trip
    step = ending.step
    if step is None and trip is not None:
        step = trip.step
    elif step is None:
        step = max(0, outcome.steps - 1) if outcome else 0
    return Trip(ending.detail, step, timebase.stamp_ns(step) / 1e9)
