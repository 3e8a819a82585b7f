"""How long something has been at the end of its range within the last second."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from seft_plant_sim.compiled import compiled

Ints = npt.NDArray[np.int64]


@compiled
def is_exceeded(times: Ints, count: int, step: int, window: int) -> bool:
    """Count a step at which something is so; tell whether more are within a second than allowed.

    Parameters
    ----------
    times : ndarray
        The last of such steps in turn, shape (allowed + 1,): brought up to date.
    count : int
        How many there have been before.
    step, window : int
        The step, and the steps of a second.
    """
    times[count % len(times)] = step
    return count + 1 >= len(times) and times[(count + 1) % len(times)] > step - window


class SaturatedTime:
    """How long sensors may be at the end of their range within the last second.

    Parameters
    ----------
    longest : float
        Time beyond which it is a violation, s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    window : int
        Steps of a second.
    """

    def __init__(self, longest: float, dt: float) -> None:
        self._longest = longest
        self._allowed = int(longest / dt * (1 + 1e-9))
        self.window = round(1.0 / dt)

    def times(self) -> Ints:
        """Room for the steps that `is_exceeded` counts."""
        return np.zeros(min(self._allowed, self.window) + 1, dtype=np.int64)

    def describe(self, sensors: Sequence[str]) -> str:
        """Say that sensors, one at least, have been blind for too long."""
        names = " and ".join(sorted(sensors))
        return (
            f"{names} at the end of the sensor's range for more than {self._longest:g} s within "
            "one second: the test is blind"
        )
