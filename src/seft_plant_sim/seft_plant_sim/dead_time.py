"""Dead time of a drive that is held between samples."""

from collections import deque

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]

MAX_STEPS = 1_000_000


class DeadTime:
    """Delays a drive by any time, whole samples or not.

    Between two samples the delayed drive changes once, ``part`` seconds after the first.

    Parameters
    ----------
    delay : float
        Dead time, s.
    dt : float
        Sampling period, s.
    axes : int
        Number of axes n.

    Attributes
    ----------
    part : float
        Time into the period at which the drive changes, s; 0: at the sample itself.
    whole : int
        Whole sampling periods of the delay.

    Raises
    ------
    InputError
        If the delay is too many samples long.
    """

    def __init__(self, delay: float, dt: float, axes: int) -> None:
        steps = int(delay / dt + 1e-9)
        if steps > MAX_STEPS:
            raise InputError(f"actuator: a delay of {delay:g} s is {steps} samples long")
        self.whole = steps
        rest = delay - steps * dt
        self.part = rest if rest > 1e-9 * dt else 0.0
        self._line: deque[Floats] = deque(maxlen=steps + 2)
        self._axes = axes
        self.reset()

    def reset(self) -> None:
        """Back to no drive."""
        self._line.extend(np.zeros(self._axes) for _ in range(self._line.maxlen or 0))

    def step(self, command: Floats) -> tuple[Floats, Floats, Floats]:
        """Take the drive of the new sample; give the delayed drives that lead there.

        Parameters
        ----------
        command : ndarray
            Drive from the new sample on, shape (n,).

        Returns
        -------
        before, after, now : ndarray
            Shape (n,): the delayed drive before and after its change on the way to the new
            sample, and at the new sample.
        """
        line = self._line
        before, after = line[0], line[1]
        line.append(command)  # the oldest falls out
        return before, after, line[0] if self.part else line[1]
