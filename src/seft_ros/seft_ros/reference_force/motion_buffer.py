"""Ground motion that has arrived, in one piece."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class MotionBuffer:
    """Ground accelerations of n axes by step, from the first that is still wanted on.

    Parameters
    ----------
    axes : int
        n.
    """

    def __init__(self, axes: int) -> None:
        self._values = np.empty((0, axes))
        self._first = 0

    def add(self, first: int, values: Floats) -> bool:
        """Append a piece of the motion; a piece that begins at step 0 begins a new motion.

        Parameters
        ----------
        first : int
            Step of its first sample.
        values : ndarray
            Shape (p, n), m/s^2.

        Returns
        -------
        bool
            False where steps before it are missing; then it is left out.
        """
        if first == 0 or not len(self._values):
            self._first, self._values = first, values.copy()
            return True
        known = self._first + len(self._values) - first
        if known < 0:
            return False
        self._values = np.concatenate([self._values, values[known:]])
        return True

    def window(self, step: int, count: int) -> Floats | None:
        """Accelerations of ``count`` steps from ``step`` on, shape (count, n), if all are there."""
        start = step - self._first
        if start < 0 or start + count > len(self._values):
            return None
        return self._values[start : start + count]

    def drop_before(self, step: int) -> None:
        """Forget the steps before one."""
        passed = min(max(step - self._first, 0), len(self._values))
        self._values = self._values[passed:]
        self._first += passed
