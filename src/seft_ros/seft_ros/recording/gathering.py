"""What the topics of a test hold, gathered message by message while a bag goes by.

Each object takes the messages of one topic, and counts those that it can't understand.
"""

from sys import getsizeof
from typing import Protocol

from seft_msgs_py.errors import WireError
from seft_msgs_py.estimates import EstimatesCodec
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.messages import decode_diagnostics
from seft_msgs_py.outcome import Outcome, read_outcome
from seft_msgs_py.timebase import Timebase
from seft_msgs_py.topics import LoopTopic
from seft_msgs_py.trajectory import TrajectoryCodec
from seft_msgs_py.trajectory_batch import decode_batch

from seft_ros.recording.record import Estimates, Series
from seft_ros.recording.samples import EstimateBuffer, SampleBuffer

_BATCH = 1 << 20  # bytes of messages: enough for arrays to pay, little enough for the cache


class Gatherer(Protocol):
    """What takes the messages of a topic."""

    undecodable: int

    def take(self, raw: bytes) -> None:
        """Take the next message."""


class SeriesGatherer:
    """Samples of a topic of the loop.

    Parameters
    ----------
    topic : LoopTopic
        The topic.
    experiment : Experiment
        Tells axes and rate.
    expected : int
        Number of messages.
    """

    def __init__(self, topic: LoopTopic, experiment: Experiment, expected: int) -> None:
        self.undecodable = 0
        self._codec = TrajectoryCodec(topic, experiment.axes, experiment.timebase)
        self._samples = SampleBuffer(len(topic.quantities), len(experiment.axes), expected)
        self._batch: list[bytes] = []
        self._size = 0

    def take(self, raw: bytes) -> None:
        """Take the next message; it is decoded later, with others."""
        self._batch.append(raw)
        self._size += getsizeof(raw)
        if self._size >= _BATCH:
            self._decode()

    def series(self) -> Series:
        """Give what was gathered, once."""
        self._decode()
        return self._samples.series()

    def _decode(self) -> None:
        steps, values, refused = decode_batch(self._codec, self._batch)
        self._samples.append(steps, values)
        self.undecodable += refused
        self._batch, self._size = [], 0


class EstimatesGatherer:
    """Estimates of a compensation method."""

    def __init__(self, experiment: Experiment) -> None:
        self.undecodable = 0
        self._codec = EstimatesCodec(experiment.axes, experiment.timebase)
        self._estimates = EstimateBuffer()

    def take(self, raw: bytes) -> None:
        """Take the next message."""
        try:
            self._estimates.append(*self._codec.decode(raw))
        except WireError:
            self.undecodable += 1

    def series(self) -> Estimates | None:
        """Give what was gathered; None if that is nothing."""
        return self._estimates.series()


class OutcomeGatherer:
    """How the test ended: what the rig said last of it in its diagnostics.

    Attributes
    ----------
    outcome : Outcome or None
        None as long as the rig said nothing of an end.
    """

    def __init__(self, timebase: Timebase) -> None:
        self.undecodable = 0
        self.outcome: Outcome | None = None
        self._timebase = timebase

    def take(self, raw: bytes) -> None:
        """Take the next message."""
        try:
            for status in decode_diagnostics(raw)[1]:
                self.outcome = read_outcome(status, self._timebase) or self.outcome
        except WireError:
            self.undecodable += 1
