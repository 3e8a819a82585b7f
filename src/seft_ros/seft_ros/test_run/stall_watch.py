"""Timing jitter of the machine itself, watched while a test runs, to explain missed deadlines.

A bare process sleeps to deadlines on the loop's core and reports how late it was woken. It is this
file, run as a program with nothing but the standard library. On stdin it takes one line of JSON,
``{"cores": [0], "period": 0.0005, "late_s": 0.001, "priority": 0}``, and sleeps to absolute
deadlines of that period (s) until the next line comes or stdin ends. Then it prints that line with
``beats`` (deadlines), ``count`` (of those met more than ``late_s`` late), ``longest_s`` and
``intervals_ns`` (wall clock, of the first late ones).
"""

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from typing import Any

STALL_SHARE = 0.5  # of the loop's period; a deadline met later than that is a stall
BEATS = 4  # a period: so a stall of three quarters of a period can't fall between two of them
SHORTEST_BEAT = 0.00025  # s: a shorter one would be a load of its own
_PROBE_TIMEOUT_S = 2.0  # s
KEPT = 10_000  # stalls


class StallWatch:
    """The process that sleeps on the loop's core.

    It is started before a test, as starting a process takes longer than many steps. It ends with
    the process that made it.

    Attributes
    ----------
    pid : int
        Id of the process that sleeps.
    """

    def __init__(self) -> None:
        self._probe = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.pid = self._probe.pid

    def begin(self, cores: list[int], period: float, priority: int, *, first: bool = False) -> None:
        """Watch a loop of these cores, period (s) and real-time priority (0: none) from now on.

        The watch takes the next higher priority, else it would count the loop's work as a stall.
        ``first`` says that the loop precedes all others without priority; so does the watch.
        """
        if first:
            from seft_msgs_py.node.host import take_precedence  # the process itself lacks it

            take_precedence(self.pid)
        wanted = {
            "cores": cores,
            "period": max(period / BEATS, SHORTEST_BEAT),
            "late_s": STALL_SHARE * period,
            "priority": priority and priority + 1,
        }
        self._write(json.dumps(wanted))

    def end(self) -> dict[str, Any] | None:
        """Stop, and give what the process printed; None if it watched nothing, or has died."""
        self._write("")
        try:
            printed, _ = self._probe.communicate(timeout=_PROBE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._probe.kill()
            self._probe.communicate()
            return None
        return json.loads(printed) if printed else None

    def _write(self, line: str) -> None:
        assert self._probe.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._probe.stdin.write(line + "\n")
            self._probe.stdin.flush()


def watch(period: float, most: float) -> dict[str, object]:
    """Sleep to deadlines until stdin has input; list those met more than ``most`` s late."""
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
    """Watch as asked on stdin, and print what was seen."""
    wanted = json.loads(sys.stdin.readline().strip() or "null")
    if wanted is None:
        return 0
    os.sched_setaffinity(0, wanted["cores"])
    if wanted["priority"]:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(wanted["priority"]))
        except OSError:
            wanted["priority"] = 0
    seen = json.dumps({**wanted, **watch(wanted["period"], wanted["late_s"])}).encode()
    with contextlib.suppress(BrokenPipeError):  # the parent may have been killed
        while seen:
            seen = seen[os.write(sys.stdout.fileno(), seen) :]
    return 0


if __name__ == "__main__":
    sys.exit(main())
