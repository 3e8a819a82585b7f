"""Commands missed in real time for a minute each, and how many of them were the machine's doing.

In every run a bare process sleeps to deadlines on the loop's core (`seft_ros.test_run.
stall_watch`): what it is late by, no loop could have met. Peak memory of each node comes with it.
"""

import argparse
import sys
from dataclasses import dataclass

from _runs import recorded_run, use_own_domain
from seft_ros.analysis.timing import stalls_of, timing_of
from seft_ros.test_run.processes import ProcessLayout

PRIORITY = 50
MISSED = 0.005  # wanted: at most this share, without real-time priority
MEMORY = 150  # MB, of a process with one node
FACTOR = 2.0  # most that a rehearsal's median round trip may be off, as a factor


@dataclass(frozen=True)
class Case:
    """One way of running."""

    rate: float
    layout: ProcessLayout

    def __str__(self) -> str:
        how = "one process" if self.layout.composed else "separate processes"
        priority = ", real-time priority" if self.layout.priority else ""
        return f"{self.rate:g} Hz, {how}{priority}"


CASES = [
    Case(rate, ProcessLayout(composed=composed, priority=priority))
    for rate, composed in ((500.0, False), (1000.0, False), (4096.0, True))
    for priority in (0, PRIORITY)
]


def run(case: Case, seconds: float) -> bool:
    """Run a case and print what it missed; tell whether that is as wanted."""
    overrides = (
        ("ground_motion", "synthetic.duration", 2 * (seconds - 2.0)),
        ("rig", "pace", "realtime"),
        ("/**", "rate", case.rate),
        # a busy machine must not end what is to be measured
        ("rig", "watchdog.command_timeout", 5.0),
        ("reference_force", "instability.ratio", 0.0),
    )
    with recorded_run(*overrides, layout=case.layout) as (recording, statuses):
        steps = len(recording.series["rig/state"].steps)
        missed, stalls, timing = recording.missed or 0, stalls_of(recording), timing_of(recording)
    at_the_rig = timing.numbers["round_trip_at_the_rig_s"]
    shown = ", ".join(f"{key} {1e6 * trip:.0f}" for key, trip in at_the_rig.items())
    print(f"{case}: {missed} of {steps:,} commands missed, {missed / steps:.3%}")
    print(f"    round trip, µs: {shown}; the rig's clock held up {recording.overruns} times")
    rehearsal = timing.numbers["rehearsal"]
    rehearsed = rehearsal["round_trip_s"]
    ratios = {key: rehearsed[key] / at_the_rig[key] for key in ("p50", "p99")}
    print(
        f"    rehearsal: {rehearsal['missed']} of {rehearsal['steps']} missed; round trip, times "
        f"the test's: p50 {ratios['p50']:.2f}, p99 {ratios['p99']:.2f}"
    )
    met = 1 / FACTOR <= ratios["p50"] <= FACTOR
    if stalls is not None:
        listed, blamed = stalls["missed_listed"], stalls["missed_in_a_stall"]
        print(
            f"    machine: {stalls['count']} of {stalls['beats']:,} bare wake-ups late by more "
            f"than {1e3 * stalls['late_s']:g} ms, the worst by {1e3 * stalls['longest_s']:.1f} ms; "
            f"in them {blamed} of {listed} listed misses"
        )
        own = missed * (1.0 - blamed / listed) if listed else 0.0
        wanted = 0.0 if case.layout.priority else MISSED
        met &= own <= max(wanted * steps, 0.5)
    if not case.layout.composed:
        memory = {n: int(s.values.get("peak_memory_mb", -1)) for n, s in statuses.items()}
        print("    peak memory, MB: " + ", ".join(f"{n} {m}" for n, m in sorted(memory.items())))
        met &= case.layout.priority > 0 or max(memory.values()) < MEMORY
    return met


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each case")
    seconds = parser.parse_args().seconds
    use_own_domain()
    met = True
    for case in CASES:
        met &= run(case, seconds)
    print(
        f"wanted: no miss beyond the machine's stalls with priority, {MISSED:.1%} without; "
        f"memory below {MEMORY} MB; a rehearsal's median within a factor of {FACTOR:g}"
    )
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
