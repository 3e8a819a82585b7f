"""How long something has been at the end of its range within the last second."""

from collections import deque
from collections.abc import Sequence


class TimeWithinSecond:
    """Steps of the last second at which something was so, against the longest time allowed.

    Parameters
    ----------
    longest : float
        Time that is still allowed, s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    allowed, window : int
        Steps that are still allowed, and steps of a second.
    """

    def __init__(self, longest: float, dt: float) -> None:
        self.allowed = int(longest / dt * (1 + 1e-9))
        self.window = round(1.0 / dt)
        self._steps: deque[int] = deque()

    def reset(self) -> None:
        """Forget the test so far."""
        self._steps.clear()

    def is_exceeded(self, step: int) -> bool:
        """Count a step at which it is so; say whether that is more than is allowed."""
        steps = self._steps
        steps.append(step)
        while steps[0] <= step - self.window:
            steps.popleft()
        return len(steps) > self.allowed


class SaturatedTime:
    """How long sensors have been at the end of their range within the last second.

    Parameters
    ----------
    longest : float
        Time beyond which it is a violation, s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    time : TimeWithinSecond
        Counts it.
    """

    def __init__(self, longest: float, dt: float) -> None:
        self._longest = longest
        self.time = TimeWithinSecond(longest, dt)

    def reset(self) -> None:
        """Forget the test so far."""
        self.time.reset()

    def violation(self, step: int, sensors: Sequence[str]) -> str | None:
        """Say whether sensors have been blind for too long.

        Parameters
        ----------
        step : int
            Step of the sample.
        sensors : sequence of str
            Which are at the end of their range, one at least.

        Returns
        -------
        str or None
            One line with the sensors and the time.
        """
        return self.describe(sensors) if self.time.is_exceeded(step) else None

    def describe(self, sensors: Sequence[str]) -> str:
        """Say that sensors, one at least, have been blind for too long."""
        names = " and ".join(sorted(set(sensors))).replace("_range", "")
        return (
            f"{names} at the end of the sensor's range for more than {self._longest:g} s within "
            "one second: the test is blind"
        )
