"""Timing jitter of the machine itself: a process that only sleeps to deadlines.

Run as a program, with nothing but the standard library. On stdin it takes one line of JSON,
``{"cores": [0], "period": 0.0005, "late_s": 0.001, "priority": 0}``, and sleeps to absolute
deadlines of that period (s) until the next line comes or stdin ends. Then it prints that line with
``beats`` (deadlines), ``count`` (of those met more than ``late_s`` late), ``longest_s`` and
``intervals_ns`` (wall clock, of the first late ones).
"""

import contextlib
import json
import os
import select
import sys
import time

KEPT = 10_000  # stalls


def watch(period: float, most: float) -> dict[str, object]:
    """Sleep to deadlines until there is something on stdin; tell of those met ``most`` s late."""
    stalls: list[tuple[int, int]] = []
    beats = count = 0
    longest = 0.0
    deadline = time.monotonic() + period
    while not select.select([0], [], [], max(0.0, deadline - time.monotonic()))[0]:
        late = time.monotonic() - deadline
        beats += 1
        if late > most:
            count += 1
            longest = max(longest, late)
            if len(stalls) < KEPT:
                now = time.time_ns()
                stalls.append((now - round(late * 1e9), now))
        deadline += period * (1 + int(max(0.0, late) / period))
    return {"beats": beats, "count": count, "longest_s": longest, "intervals_ns": stalls}


def main() -> int:
    """Watch as told on stdin, and tell what was seen."""
    wanted = json.loads(sys.stdin.readline().strip() or "null")
    if wanted is None:
        return 0
    os.sched_setaffinity(0, wanted["cores"])
    if wanted["priority"]:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(wanted["priority"]))
        except OSError:
            wanted["priority"] = 0
    seen = watch(wanted["period"], wanted["late_s"])
    told = json.dumps({**wanted, **seen}).encode()
    with contextlib.suppress(BrokenPipeError):  # who asked may have been killed
        while told:
            told = told[os.write(sys.stdout.fileno(), told) :]
    return 0


if __name__ == "__main__":
    sys.exit(main())
