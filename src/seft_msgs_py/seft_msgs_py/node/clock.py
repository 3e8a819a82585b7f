"""What nodes read the time from and wait by: the machine's clock, or a virtual one."""

import time
from collections.abc import Callable
from typing import Protocol

LONGEST_GAP = 0.25  # s


class Clock(Protocol):
    """Time as a node sees it."""

    def monotonic(self) -> float:
        """Time since some moment, s."""

    def elapsed(self) -> float:
        """Time that also runs while the process is stopped or its machine sleeps, s."""

    def time_ns(self) -> int:
        """Wall-clock time in ns, for labels, and for the common start of several hosts."""

    def sleep(self, seconds: float) -> None:
        """Wait."""


class MachineClock:
    """The `Clock` of this machine."""

    monotonic = staticmethod(time.monotonic)
    time_ns = staticmethod(time.time_ns)
    sleep = staticmethod(time.sleep)

    @staticmethod
    def elapsed() -> float:
        """Time that also runs while the process is stopped or its machine sleeps, s."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)


MACHINE = MachineClock()


class AwakeClock:
    """Monotonic time in which a gap between two polls counts as at most ``longest_gap`` seconds.

    A process that stalls, usually with its whole machine, reads the messages of that time only
    later: it must not mistake its own stall for the silence of others. Poll the clock often.
    """

    def __init__(
        self, monotonic: Callable[[], float] = MACHINE.monotonic, longest_gap: float = LONGEST_GAP
    ) -> None:
        self._monotonic, self._longest_gap = monotonic, longest_gap
        self._polled_at = monotonic()
        self._now = 0.0

    def time(self) -> float:
        """Time awake since the clock was made, s."""
        now = self._monotonic()
        self._now += min(now - self._polled_at, self._longest_gap)
        self._polled_at = now
        return self._now
