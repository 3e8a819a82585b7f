"""The loop over DDS beside bare rings, all on one core: round trips and steps per second.

In turn, several times over, as the machine's speed drifts: a ring of datagrams, a ring of raw
DDS messages, the loop in lockstep as separate processes and in one, and the offline loop. What a
loop computes is in its round trip, and not in that of a ring.
"""

import os
import statistics
import sys
from collections import defaultdict

import _ring
import _udp_ring
from _runs import CONFIG, recorded_run, use_own_domain
from seft_msgs_py.config.experiment import Experiment
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES
from seft_ros.test_run.processes import ProcessLayout

ROUNDS = 3
LAPS = 3_000
DURATION = 30.0  # s of ground motion, at twice the speed
WANTED = {"separate processes": 4_000, "one process": 10_000}  # steps/s
RING_WANTED = 1.5  # round trip of the loop over a lap of the ring that has the loop's readers
SWIFT_LAP = 86e-6
"""s: lap of the ring on the machine on which those numbers of steps were set as targets."""


def main() -> int:
    use_own_domain()
    cores = os.sched_getaffinity(0)
    laps: dict[str, list[float]] = defaultdict(list)
    speeds: dict[str, list[float]] = defaultdict(list)
    overrides = (
        ("rig", "pace", "lockstep"),
        ("ground_motion", "synthetic.duration", DURATION),
    )
    layouts = {
        "separate processes": ProcessLayout(),
        "one process": ProcessLayout(composed=True),
    }
    offline = Experiment.load(TABLES, [CONFIG], overrides)
    for _ in range(ROUNDS):
        os.sched_setaffinity(0, {min(cores)})
        laps["ring of datagrams"].append(statistics.median(_udp_ring.lap_times(LAPS)))
        laps["ring of raw DDS messages"].append(statistics.median(_ring.lap_times(LAPS)))
        readers = statistics.median(_ring.lap_times(LAPS, with_readers=True))
        laps["the same, loop's readers"].append(readers)
        laps["the same, shared memory"].append(_ring.median_over_shared_memory(LAPS))
        simulated = simulate_test(offline, build_blocks(offline))
        speeds["offline"].append(len(simulated.series["rig/state"].steps) / simulated.wall_s)
        os.sched_setaffinity(0, cores)
        for name, layout in layouts.items():
            with recorded_run(*overrides, layout=layout) as (recording, statuses):
                speeds[name].append(len(recording.series["rig/state"].steps) / recording.wall_s)
                trip = float(statuses["rig"].values["round trip median (ms)"]) * 1e-3
                laps[f"loop, {name}"].append(trip)
    ring = statistics.median(laps["ring of raw DDS messages"])
    print("round trip or lap, median of each round, µs")
    for name, times in laps.items():
        middle = statistics.median(times)
        each = " ".join(f"{1e6 * time:6.0f}" for time in times)
        print(f"  {name:26s} {each}   {middle / ring:5.2f} of the ring of DDS messages")
    print("steps per second in lockstep")
    met = True
    for name, found in speeds.items():
        wanted = WANTED.get(name)
        goal = f"   wanted: {wanted:,}, or as many laps of this ring" if wanted else ""
        print(f"  {name:26s} " + " ".join(f"{speed:6,.0f}" for speed in found) + goal)
        if wanted:
            met &= max(found) >= wanted * min(1.0, SWIFT_LAP / ring)
    floor = statistics.median(laps["the same, loop's readers"])
    ratio = statistics.median(laps["loop, separate processes"]) / floor
    print(
        f"round trip in separate processes: {ratio:.2f} laps with readers (wanted: {RING_WANTED})"
    )
    return 0 if met and ratio <= RING_WANTED else 1


if __name__ == "__main__":
    sys.exit(main())
