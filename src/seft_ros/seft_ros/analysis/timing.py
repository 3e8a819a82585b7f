"""Timing of a test's messages: round trips, stalls of the host, the link.

Times are those at which the recorder received the messages, as in a bag: on one host some tens of
microseconds after the nodes did, and more where the recorder had to wait for its core, so that
the longest round trips seem longer than they are. The rig's own measurements are beside them. A
test of the offline loop has no times.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.outcome import REHEARSED, RIG
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.analysis.metrics import common_steps
from seft_ros.bags.recording import Recording

_Floats = npt.NDArray[np.floating[Any]]

_PERCENTILES = (50, 90, 99, 99.9)


@dataclass(frozen=True)
class Timing:
    """Timing of a test.

    Attributes
    ----------
    round_trip_s : ndarray
        From a step's state to the command that answers it, shape (M,), s; of the steps that
        have both.
    numbers : dict
        JSON values: ``paced`` (whether the rig kept a pace: not in lockstep), ``period_s`` of the
        loop, ``round_trip_s`` (percentiles, largest, how many of the steps over_a_period),
        ``round_trip_at_the_rig_s`` (the same as measured by the rig, by the keys of `ROUND_TRIPS`;
        empty without), ``rehearsal`` (as of `seft_plant_sim.rig_rest.Rehearsal`; None without),
        ``stalls`` (see `stalls_of`).
    """

    round_trip_s: _Floats
    numbers: dict[str, Any]


def timing_of(recording: Recording) -> Timing | None:
    """Find round trips; None if messages were not received one by one (offline loop)."""
    if recording.environment.get("mode") == "simulate":
        return None
    states, commands = (recording.series[topic.name] for topic in (RIG_STATE, VALVE_COMMAND))
    if not len(commands.steps):  # an idealised actuator obeys the reference force itself
        commands = recording.series[REFERENCE_FORCE.name]
    if states.received_ns is None or commands.received_ns is None:
        return None
    _, at_state, at_command = common_steps(states.steps, commands.steps)
    trips = (commands.received_ns[at_command] - states.received_ns[at_state]) * 1e-9
    dt = recording.experiment.timebase.dt
    percentiles = np.percentile(trips, _PERCENTILES).tolist() if len(trips) else []
    numbers = {
        "paced": recording.experiment.sections.get("rig", {}).get("pace") != "lockstep",
        "period_s": dt,
        "round_trip_s": {
            **{f"p{p:g}": v for p, v in zip(_PERCENTILES, percentiles, strict=False)},
            "largest": float(trips.max()) if len(trips) else None,
            "over_a_period": int((trips > dt).sum()),
            "steps": len(trips),
        },
        "round_trip_at_the_rig_s": recording.round_trips,
        "rehearsal": recording.facts.get(RIG, {}).get(REHEARSED),
        "stalls": stalls_of(recording),
    }
    return Timing(trips, numbers)


def stalls_of(recording: Recording) -> dict[str, Any] | None:
    """Compare a test's missed steps with the scheduling stalls of its host.

    Returns
    -------
    dict or None
        From a bare process that slept on the loop's core during the test: ``beats`` (deadlines it
        slept to), ``count`` (those that it met late), ``late_s`` (what counts as late) and
        ``longest_s``; ``missed_listed`` (listed steps that missed the command deadline and are in
        the recording) and ``missed_in_a_stall`` (those in whose period it was late; a period begins
        when the state was due, a period after the one before). None where no such process ran:
        the offline loop, lockstep, a rig on another host.
    """
    seen = recording.environment.get("stalls")
    if not isinstance(seen, dict):
        return None
    states = recording.states
    intervals = np.array(seen["intervals_ns"], dtype=np.int64).reshape(-1, 2)
    listed = attributed = 0
    if states.received_ns is not None:
        period_ns, received = recording.experiment.timebase.stamp_ns(1), states.received_ns
        steps = np.array(recording.missed_steps, dtype=np.int64)
        steps = steps[np.isin(steps, states.steps)]
        at = np.searchsorted(states.steps, steps)
        end = received[at] + period_ns
        follows = (at > 0) & (states.steps[at - 1] == steps - 1)
        begin = np.where(follows, received[at - 1] + period_ns, received[at])
        begin = np.minimum(begin, received[at])
        overlaps = (intervals[:, 0] < end[:, np.newaxis]) & (intervals[:, 1] > begin[:, np.newaxis])
        listed, attributed = len(steps), int(overlaps.any(axis=1).sum())
    shown = {name: seen[name] for name in ("beats", "count", "late_s", "longest_s")}
    return shown | {"missed_listed": listed, "missed_in_a_stall": attributed}


def link_numbers(recording: Recording) -> dict[str, Any] | None:
    """Summarise what the force controller counted on the link of a test on several hosts.

    ``loop_delay`` (steps), ``age`` of the messages in steps (p50, p99, largest), ``late`` (forces
    whose message was older than the loop's delay: they are predictions), ``held`` (forces that no
    message reached: the one before was held), ``forces`` (all of them). None where no link is
    between reference force and force controller, or it counted nothing.
    """
    link, section = recording.link, recording.experiment.sections.get("reference_force", {})
    loop_delay = section.get("loop_delay", 0)
    if link is None or not loop_delay or not (total := sum(link.ages.values())):
        return None
    every = np.repeat(list(link.ages), list(link.ages.values()))
    median, late = np.percentile(every, (50, 99), method="inverted_cdf").tolist()
    return {
        "loop_delay": loop_delay,
        "age": {"p50": median, "p99": late, "largest": int(every.max())},
        "late": link.older_than(loop_delay),
        "held": link.held,
        "forces": total,
    }
