"""Watches the machine while a test runs in real time, so that a miss has a cause."""

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from seft_msgs_py.node.realtime import take_precedence

PROBE = Path(__file__).with_name("jitter_probe.py")
LATE = 0.5  # of the loop's period; a deadline met later than that is a stall
BEATS = 4  # a period: so a stall of three quarters of a period can't fall between two of them
SHORTEST_BEAT = 0.00025  # s: a shorter one would be a load of its own
PATIENCE = 2.0  # s


class StallWatch:
    """A bare process that sleeps on the loop's core, and tells how late it was woken.

    It is started before a test, as starting a process takes longer than many steps. It ends with
    the process that made it.
    """

    def __init__(self) -> None:
        self._probe = subprocess.Popen(
            [sys.executable, "-I", "-S", str(PROBE)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Of the process that sleeps."""
        return self._probe.pid

    def begin(self, cores: list[int], period: float, priority: int, *, first: bool = False) -> None:
        """Watch a loop of these cores, period (s) and real-time priority (0: none) from now on.

        The watch takes the next higher priority, else it would take the loop's work for a stall.
        ``first`` says that the loop goes before all others without priority; so does the watch.
        """
        if first:
            take_precedence(self.pid)
        wanted = {
            "cores": cores,
            "period": max(period / BEATS, SHORTEST_BEAT),
            "late_s": LATE * period,
            "priority": priority and priority + 1,
        }
        self._write(json.dumps(wanted))

    def end(self) -> dict[str, Any] | None:
        """Stop, and give what the probe printed; None if it watched nothing, or has died."""
        self._write("")
        try:
            told, _ = self._probe.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self._probe.kill()
            self._probe.communicate()
            return None
        return json.loads(told) if told else None

    def _write(self, line: str) -> None:
        assert self._probe.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._probe.stdin.write(line + "\n")
            self._probe.stdin.flush()
