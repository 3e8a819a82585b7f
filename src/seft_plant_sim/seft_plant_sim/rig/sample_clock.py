"""When a simulated rig takes its samples in realtime."""

HELD_UP = 0.5  # of a period, by which a deadline is missed: what is left is too short for an answer
HURRY = 0.05  # of a period, by which steps are shorter while a rig makes up for what it is late


class SampleClock:
    """Absolute deadlines, one a period.

    A rig that was held up for more than half a period goes on from there: hurrying through the
    steps it is late for would leave the others no time to answer them.

    Parameters
    ----------
    period : float
        Of the samples, s.
    start : float
        Time of step 0, s, monotonic.
    makes_up : bool
        Whether the rig goes back to its time since the start, by steps that are a little shorter.

    Attributes
    ----------
    overruns : int
        Times it was held up for more than half a period.
    """

    def __init__(self, period: float, start: float, *, makes_up: bool) -> None:
        self._period, self._makes_up = period, makes_up
        self._start = self._on_time = start
        self.overruns = 0

    def deadline(self, step: int) -> float:
        """Time of a step, s, monotonic."""
        return self._start + step * self._period

    def awake(self, late: float) -> None:
        """Take in by how many s a deadline was missed."""
        if late > HELD_UP * self._period:
            self.overruns += 1
            self.fall_back(late)
        if self._makes_up and self._start > self._on_time:
            self._start -= min(HURRY * self._period, self._start - self._on_time)

    def fall_back(self, time: float) -> None:
        """Put off all that is to come, by a time in s."""
        self._start += time
