"""Watches the machine while a test runs in real time, so that a miss has a cause."""

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from seft_msgs_py.node.realtime import take_precedence

SLEEPER = Path(__file__).with_name("bare_sleeper.py")
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
        self._sleeper = subprocess.Popen(
            [sys.executable, "-I", "-S", str(SLEEPER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Of the process that sleeps."""
        return self._sleeper.pid

    def begin(self, cores: list[int], period: float, priority: int, *, first: bool = False) -> None:
        """Watch from now on.

        Parameters
        ----------
        cores : list of int
            Of the loop.
        period : float
            Of the loop, s.
        priority : int
            Real-time priority of the loop; the watch takes the next higher one, else it would
            take the loop's work for a stall. 0: none.
        first : bool
            Whether the loop goes before all others without priority; so does the watch then.
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
        """Stop, and tell what was seen.

        Returns
        -------
        dict or None
            ``period`` of the deadlines and ``late_s`` (s), ``priority``, ``cores``, ``beats``
            (deadlines), ``count`` (of those met more than ``late_s`` late), ``longest_s`` and
            ``intervals_ns`` (wall clock, of the first stalls). None if it watched nothing, or
            has died.
        """
        self._write("")
        try:
            told, _ = self._sleeper.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            self._sleeper.kill()
            self._sleeper.communicate()
            return None
        return json.loads(told) if told else None

    def _write(self, line: str) -> None:
        assert self._sleeper.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._sleeper.stdin.write(line + "\n")
            self._sleeper.stdin.flush()
