"""Compensation of the actuator's delay in the acceleration feedback.

A method estimates the acceleration that belongs to the force which is asked for now. It is an
object with a `Compensator`'s two methods, listed by name in `METHODS`.
"""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


class Compensator(Protocol):
    """What the reference force asks of a compensation method."""

    def reset(self) -> None:
        """Forget the test so far."""

    def acceleration(self, state: Floats) -> Floats:
        """Estimate the acceleration that goes into the reference force.

        Parameters
        ----------
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        ndarray
            Shape (n,), m/s^2.
        """


class NoCompensation:
    """The measured acceleration as it is (paper Eq. 5.3)."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        del parameters

    def reset(self) -> None:
        """Nothing is remembered."""

    def acceleration(self, state: Floats) -> Floats:
        """Return the measured acceleration, shape (n,), m/s^2."""
        return state[2]


METHODS: dict[str, type[NoCompensation]] = {"none": NoCompensation}
