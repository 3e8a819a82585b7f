"""When to look at what a compensation method identifies on line."""

from typing import Protocol

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND, Timebase

Floats = npt.NDArray[np.float64]

PERIOD_NS = NANOSECONDS_PER_SECOND // 10
"""Experiment time between two samples."""


class Estimating(Protocol):
    """A reference force, protected or not."""

    def estimates(self) -> dict[str, Floats]:
        """Estimate of each quantity, shape (n,) each."""


def sampling_period(timebase: Timebase) -> int:
    """Count the steps from one sample to the next."""
    return max(1, round(PERIOD_NS / timebase.period_ns))


class EstimateSampler:
    """Samples the estimates of a reference force at step 0 and every `PERIOD_NS` from there.

    Where the step that is due was lost, the next one counts. Sampling is left to the caller,
    for whom it must cost nothing to ask at every step: ``if step >= sampler.due``.

    Parameters
    ----------
    reference_force : Estimating
        Whose estimates.
    timebase : Timebase
        Sampling clock of the test.

    Attributes
    ----------
    due : int
        Step at which, or after which, to call `sample`.
    """

    def __init__(self, reference_force: Estimating, timebase: Timebase) -> None:
        self.due = 0
        self._estimates = reference_force.estimates
        self._every = sampling_period(timebase)

    def reset(self) -> None:
        """Begin a new test."""
        self.due = 0

    def sample(self, step: int) -> dict[str, Floats]:
        """Copy the estimates as they are after a step.

        Parameters
        ----------
        step : int
            Step of the last reference force.

        Returns
        -------
        dict of str to ndarray
            Name -> estimate of each axis, shape (n,), SI units; empty where the method
            identifies nothing.
        """
        self.due = step - step % self._every + self._every
        return {name: np.array(value) for name, value in self._estimates().items()}
