"""Lockstep steps per second over DDS with five processes, beside a bare ring of three."""

import sys

from _ring import laps_per_second
from _runs import recorded_run, use_own_domain

WANTED = 2_000  # steps/s


def main() -> int:
    use_own_domain()
    ring = laps_per_second(5_000)
    overrides = (
        ("rig", "pace", "lockstep"),
        ("ground_motion", "synthetic.duration", 80.0),
    )
    with recorded_run(*overrides) as (record, _):
        steps = len(record.series["rig/state"].steps)
        speed = steps / (record.wall_s or float("nan"))
    print(f"lockstep over DDS  {speed:8,.0f} steps/s over {steps:,} (wanted: {WANTED:,})")
    print(f"bare ring of three {ring:8,.0f} laps/s, {ring / speed:.2f} times as fast")
    return 0 if speed >= WANTED else 1


if __name__ == "__main__":
    sys.exit(main())
