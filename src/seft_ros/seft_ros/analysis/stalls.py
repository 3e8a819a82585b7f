"""Whether steps without a command were the machine's doing or the loop's own."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from seft_msgs_py.wire.topics import RIG_STATE

from seft_ros.recording.record import Record


@dataclass(frozen=True)
class Stalls:
    """What a bare process saw that slept on the loop's core while the test ran.

    Attributes
    ----------
    beats, count : int
        Deadlines it slept to, and those that it met late.
    late_s, longest_s : float
        What counts as late, and the largest, s.
    attributed : int
        Of the listed steps without a command in time, those in whose period it was late; that
        begins when the state was due, a period after the one before.
    listed : int
        Steps that could be looked at.
    """

    beats: int
    count: int
    late_s: float
    longest_s: float
    attributed: int
    listed: int

    def numbers(self) -> dict[str, Any]:
        """Give JSON values."""
        return {
            "beats": self.beats,
            "count": self.count,
            "late_s": self.late_s,
            "longest_s": self.longest_s,
            "missed_listed": self.listed,
            "missed_in_a_stall": self.attributed,
        }


def stalls_of(record: Record) -> Stalls | None:
    """Hold a test's missed steps against the stalls of its machine.

    Returns
    -------
    Stalls or None
        None where nobody watched: the offline loop, lockstep, a rig on another host.
    """
    seen = record.environment.get("stalls")
    if not isinstance(seen, dict):
        return None
    states = record.series[RIG_STATE.name]
    intervals = np.array(seen["intervals_ns"], dtype=np.int64).reshape(-1, 2)
    attributed = listed = 0
    if states.received_ns is not None:
        period_ns = record.experiment.timebase.period_ns
        known = np.isin(record.missed_steps, states.steps)
        steps = np.asarray(record.missed_steps, dtype=np.int64)[known]
        received = np.asarray(states.received_ns)
        at = np.searchsorted(states.steps, steps)
        end = received[at] + period_ns
        follows = (at > 0) & (states.steps[at - 1] == steps - 1)
        due = np.where(follows, received[at - 1] + period_ns, received[at])
        begin = np.minimum(due, received[at])
        overlaps = (intervals[:, 0] < end[:, np.newaxis]) & (intervals[:, 1] > begin[:, np.newaxis])
        listed, attributed = len(steps), int(overlaps.any(axis=1).sum())
    return Stalls(
        int(seen["beats"]),
        int(seen["count"]),
        float(seen["late_s"]),
        float(seen["longest_s"]),
        attributed,
        listed,
    )
