"""The record of a test: its samples by step, its configuration, and how it ended."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.outcome import LinkRecord, Saturation, Trip
from seft_msgs_py.wire.topics import LOOP_TOPICS, RigAxes

__all__ = ["Estimates", "Event", "Record", "Series", "Trip"]

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Series:
    """Samples of one topic, in the order of their steps.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), strictly increasing; lost steps are missing.
    values : ndarray
        Shape (N, q, n): samples, quantities as on the topic, axes; SI units.
    received_ns : ndarray of int64 or None
        Shape (N,): when each was received, ns of the wall clock; None if no message was, and
        for ground motion, which is sent ahead.
    """

    steps: Steps
    values: Floats
    received_ns: Steps | None = field(default=None, kw_only=True)

    def samples(self) -> Iterator[tuple[int, Floats]]:
        """Give the samples one by one: step, and values of shape (q, n)."""
        return zip(self.steps.tolist(), self.values, strict=True)

    def rows(self, which: Any) -> Self:
        """Keep some samples: an index, mask or slice of the first axis."""
        received = None if self.received_ns is None else self.received_ns[which]
        return replace(
            self, steps=self.steps[which], values=self.values[which], received_ns=received
        )

    def until(self, last_step: int) -> Self:
        """Cut the series after a step."""
        return self.rows(slice(int(np.searchsorted(self.steps, last_step, side="right"))))

    def of_steps(self, steps: Steps) -> Self:
        """Keep the samples of some steps."""
        return self.rows(np.isin(self.steps, steps))


@dataclass(frozen=True)
class Estimates(Series):
    """What the compensation method identified on line, sampled every few steps.

    Attributes
    ----------
    names : tuple of str
        The q quantities: ``delay`` (s), ``stiffness`` (N/m), ``damping`` (N s/m)...
    """

    names: tuple[str, ...]


@dataclass(frozen=True)
class Event:
    """What a node reported while a test ran: a state, a warning, a trip.

    Attributes
    ----------
    time_s : float
        When it was received, s after the rig's first sample was received.
    source : str
        The node.
    level : str
        ``ok``, ``warn``, ``error`` or ``stale``.
    text : str
        The report.
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
        recorder was cut off before the rig reported it).
    missed_steps : list of int
        The first of these steps (the rig lists a bounded number).
    held_steps : list of int
        Step of the command that was applied at each of them, -1 for none; empty if unknown.
    overruns : int or None
        Sampling overruns: the rig's own clock was late by more than half a period, and went on
        from there; None if unknown.
    saturation : Saturation
        What the rig reported as saturated.
    round_trips : dict
        From a sample to its command as the rig measured it, s, by the keys of `ROUND_TRIPS`;
        empty where it did not.
    link : LinkRecord or None
        How reference forces arrived over a link, as the force controller reported; None without
        a report.
    events : list of Event
        What the nodes reported, in the order of time; each once until it changes.
    wall_s : float or None
        Wall-clock duration of the test; None if unknown.
    complete : bool
        Whether the rig reported the end of the test in this record.
    described : bool
        Whether the configuration is known; if not, ``experiment`` has axes and rate alone.
    environment : dict
        Wall-clock start, git revision, package versions, mode, as recorded.
    facts : dict
        Node -> what it says of itself beside its parameters.
    """

    experiment: Experiment
    series: dict[str, Series]
    estimates: Estimates | None = None
    trip: Trip | None = None
    missed: int | None = 0
    missed_steps: list[int] = field(default_factory=list)
    held_steps: list[int] = field(default_factory=list)
    overruns: int | None = 0
    saturation: Saturation = field(default_factory=Saturation)
    round_trips: dict[str, float] = field(default_factory=dict)
    link: LinkRecord | None = None
    events: list[Event] = field(default_factory=list)
    wall_s: float | None = None
    complete: bool = True
    described: bool = True
    environment: dict[str, Any] = field(default_factory=dict)
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        missing = {topic.name for topic in LOOP_TOPICS} - set(self.series)
        if missing:
            raise ValueError(f"a record needs a series for each loop topic; missing {missing}")


def of_all_rigs(parts: Sequence[Series], rigs: Sequence[RigAxes]) -> Series:
    """Join the series of several rigs: the steps that all have, received when all were."""
    if len(parts) == 1:
        return parts[0]
    steps = parts[0].steps
    for part in parts[1:]:
        steps = np.intersect1d(steps, part.steps, assume_unique=True)
    kept = [part.rows(np.searchsorted(part.steps, steps)) for part in parts]
    axes = sum(len(rig.axes) for rig in rigs)
    values = np.empty((len(steps), parts[0].values.shape[1], axes))
    for part, rig in zip(kept, rigs, strict=True):
        values[:, :, list(rig.places)] = part.values
    times = [part.received_ns for part in kept if part.received_ns is not None]
    received = np.max(times, axis=0) if len(times) == len(parts) else None
    return Series(steps, values, received_ns=received)


def consecutive_runs(series: Series, longest: int) -> list[tuple[int, Floats]]:
    """Cut a series where steps are missing, and every ``longest`` steps: first step, values."""
    ends = (np.flatnonzero(np.diff(series.steps) != 1) + 1).tolist()
    runs = zip([0, *ends], [*ends, len(series.steps)], strict=True)
    return [
        (int(series.steps[at]), series.values[at : min(at + longest, end)])
        for start, end in runs
        for at in range(start, end, longest)
    ]


def require_names(step: int, estimates: Iterable[str], names: Sequence[str]) -> None:
    """Refuse, as WireError, estimates of a step with other names than those of the first."""
    if tuple(estimates) != tuple(names):
        raise WireError(
            f"estimates of step {step} are {', '.join(estimates)}, but were {', '.join(names)}"
        )
