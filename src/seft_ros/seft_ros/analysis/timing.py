"""When the messages of a test came: round trips, and gaps on each topic.

Times are those at which the recorder received them, which is what a bag holds: on one host some
tens of microseconds after the nodes did, and more where the recorder had to wait for its core, so
that the longest round trips are rather shorter than they seem. What the rig itself measured comes
with them. A test of the offline loop has no times.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.analysis.common_steps import common_steps
from seft_ros.analysis.stalls import Stalls, stalls_of
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.floating[Any]]

PERCENTILES = (50, 90, 99, 99.9)
GAP = 2.0
"""Periods between two messages of a topic that count as a gap."""


@dataclass(frozen=True)
class Gaps:
    """Intervals between the messages of one topic.

    Attributes
    ----------
    topic : str
        Its name.
    median_s, largest_s : float
        Of all intervals, s.
    largest_step : int
        Step after which the largest was.
    count : int
        Intervals longer than `GAP` periods.
    """

    topic: str
    median_s: float
    largest_s: float
    largest_step: int
    count: int


@dataclass(frozen=True)
class Timing:
    """Timing of a test.

    Attributes
    ----------
    paced : bool
        Whether the rig kept a pace: in lockstep gaps mean nothing.
    period_s : float
        Of the loop.
    round_trip_s : ndarray
        From a step's state to the command that answers it, shape (M,), s; of the steps that
        have both.
    at_the_rig_s : dict
        The same as the rig measured it, s, by the keys of `ROUND_TRIPS`; empty where it did not.
    gaps : list of Gaps
        By topic.
    stalls : Stalls or None
        Of the machine, meanwhile; None where nobody watched.
    """

    paced: bool
    period_s: float
    round_trip_s: Floats
    at_the_rig_s: dict[str, float]
    gaps: list[Gaps]
    stalls: Stalls | None

    def numbers(self) -> dict[str, Any]:
        """Give JSON values: percentiles of the round trip, the share over a period, gaps."""
        trips = self.round_trip_s
        percentiles = np.percentile(trips, PERCENTILES).tolist() if len(trips) else []
        return {
            "paced": self.paced,
            "period_s": self.period_s,
            "round_trip_s": {
                **{f"p{p:g}": v for p, v in zip(PERCENTILES, percentiles, strict=False)},
                "largest": float(trips.max()) if len(trips) else None,
                "over_a_period": int((trips > self.period_s).sum()),
                "steps": len(trips),
            },
            "round_trip_at_the_rig_s": self.at_the_rig_s,
            "gaps": {
                row.topic: {
                    "median_s": row.median_s,
                    "largest_s": row.largest_s,
                    "largest_step": row.largest_step,
                    "count": row.count,
                }
                for row in self.gaps
            },
            "stalls": self.stalls and self.stalls.numbers(),
        }


def timing_of(record: Record) -> Timing | None:
    """Find round trips and gaps of a recorded test.

    Returns
    -------
    Timing or None
        None if the messages were not received one by one (offline loop).
    """
    if record.environment.get("mode") == "simulate":
        return None
    states, commands = (record.series[topic.name] for topic in (RIG_STATE, VALVE_COMMAND))
    if not len(commands.steps):  # an idealised actuator obeys the reference force itself
        commands = record.series[REFERENCE_FORCE.name]
    if states.received_ns is None or commands.received_ns is None:
        return None
    _, at_state, at_command = common_steps(states.steps, commands.steps)
    trips = (commands.received_ns[at_command] - states.received_ns[at_state]) * 1e-9
    dt = record.experiment.timebase.dt
    pace = record.experiment.sections.get("rig", {}).get("pace")
    gaps, stalls = _gaps(record, dt), stalls_of(record)
    return Timing(pace != "lockstep", dt, trips, record.round_trips, gaps, stalls)


def _gaps(record: Record, dt: float) -> list[Gaps]:
    found = []
    for topic in (RIG_STATE, REFERENCE_FORCE, VALVE_COMMAND):
        series = record.series[topic.name]
        if series.received_ns is None or len(series.steps) < 2:
            continue
        intervals = np.diff(series.received_ns) * 1e-9
        at = int(intervals.argmax())
        found.append(
            Gaps(
                topic.name,
                float(np.median(intervals)),
                float(intervals[at]),
                int(series.steps[at]),
                int((intervals > GAP * dt).sum()),
            )
        )
    return found
