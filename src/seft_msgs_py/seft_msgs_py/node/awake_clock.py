"""How long others have been silent, as far as one can tell who may have slept oneself."""

import time
from collections.abc import Callable

LONGEST_LOOK = 0.25  # s


class AwakeClock:
    """Monotonic time in which a gap between two looks counts for `LONGEST_LOOK` at most.

    A process that was held up, with its whole machine as a rule, finds the messages of that time
    in its queues only later: it must not take its own sleep for the silence of others. Look at
    the clock often.

    Parameters
    ----------
    monotonic : callable, optional
        Source of the time, s.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._looked_at = monotonic()
        self._now = 0.0

    def time(self) -> float:
        """Time awake, s, from when the clock was made."""
        now = self._monotonic()
        self._now += min(now - self._looked_at, LONGEST_LOOK)
        self._looked_at = now
        return self._now
