"""What may ask for a soft end of a test."""

from typing import Protocol

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class Guard(Protocol):
    """Looks at every step of a test, and says why it must come down, if it must."""

    def reset(self) -> None:
        """Begin a new test."""

    def step(self, ground_motion: Floats, state: Floats) -> str | None:
        """Look at one step.

        Parameters
        ----------
        ground_motion : ndarray
            Ground acceleration of each axis at this step, shape (n,), m/s^2.
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        str or None
            One line with what was seen on which axis, and its limit.
        """
