"""What is left of a test: its samples by step, its configuration, and how it ended."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.outcome import Saturation, Trip
from seft_msgs_py.wire.topics import LOOP_TOPICS

from seft_ros.force_controller.link_record import LinkRecord

__all__ = ["Estimates", "Event", "Record", "Series", "Trip"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """Samples of one topic, in the order of their steps.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), strictly increasing; steps that were lost are not there.
    values : ndarray
        Shape (N, q, n): samples, quantities as on the topic, axes; SI units.
    received_ns : ndarray of int64 or None
        Shape (N,): when each was received, ns of the wall clock; None if no message was, and
        of ground motion, which is sent ahead.
    """

    steps: npt.NDArray[np.int64]
    values: Floats
    received_ns: npt.NDArray[np.int64] | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Estimates(Series):
    """What the compensation method identified on line, sampled now and then.

    Attributes
    ----------
    names : tuple of str
        The q quantities: ``delay`` (s), ``stiffness`` (N/m), ``damping`` (N s/m)...
    """

    names: tuple[str, ...]


@dataclass(frozen=True)
class Event:
    """What a node told while a test ran: a state, a warning, a trip.

    Attributes
    ----------
    time_s : float
        When it was received, s after the rig's first sample was received.
    source : str
        Who told.
    level : str
        ``ok``, ``warn``, ``error`` or ``stale``.
    text : str
        What.
    """

    time_s: float
    source: str
    level: str
    text: str


@dataclass(frozen=True)
class Record:
    """One test, from a bag or from the offline loop.

    Attributes
    ----------
    experiment : Experiment
        The resolved configuration of every node.
    series : dict
        Topic name (relative, as in `seft_msgs_py.wire.topics`) -> `Series`. ``ground_motion`` is
        cut at the last step of ``rig/state``: what was published ahead is not part of the
        test.
    estimates : Estimates or None
        None if the compensation method identified nothing.
    trip : Trip or None
        None if the test ran to its end.
    missed : int or None
        Steps at which the rig had no new command and held the last; None if unknown (the
        recorder was cut off before the rig said).
    missed_steps : list of int
        The first of these steps (the rig lists a bounded number).
    overruns : int or None
        Times the rig's own clock was held up for more than half a period, and went on from there;
        None if unknown.
    saturation : Saturation
        What the rig says was at the end of its range.
    round_trips : dict
        From a sample to its command as the rig measured it, s, by the keys of `ROUND_TRIPS`;
        empty where it did not.
    link : LinkRecord or None
        How reference forces came over a link, as the force controller told; None if it told
        nothing.
    events : list of Event
        What the nodes told, in the order of time; each once until it changes.
    wall_s : float or None
        Wall-clock duration of the test; None if unknown.
    complete : bool
        Whether the rig reported the end of the test in this record.
    described : bool
        Whether the configuration is known; if not, ``experiment`` has axes and rate alone.
    environment : dict
        Wall-clock start, git revision, package versions, mode, as recorded.
    """

    experiment: Experiment
    series: dict[str, Series]
    estimates: Estimates | None = None
    trip: Trip | None = None
    missed: int | None = 0
    missed_steps: list[int] = field(default_factory=list)
    overruns: int | None = 0
    saturation: Saturation = field(default_factory=Saturation)
    round_trips: dict[str, float] = field(default_factory=dict)
    link: LinkRecord | None = None
    events: list[Event] = field(default_factory=list)
    wall_s: float | None = None
    complete: bool = True
    described: bool = True
    environment: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        missing = {topic.name for topic in LOOP_TOPICS} - set(self.series)
        if missing:
            raise ValueError(f"a record needs a series for each loop topic; missing {missing}")
