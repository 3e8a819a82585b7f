"""What the messages that were sent over a link and back tell of it."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

PERCENTILES = (50, 90, 99, 99.9)
MARGIN = 1
"""Steps beyond the percentile that a loop is given: for its computation, and for a rare delay."""
COUNTED = 99.0
"""Percentile of the round trips that a loop's delay covers; what is later is predicted."""


@dataclass(frozen=True)
class RoundTrips:
    """Round trips of messages sent at a steady rate.

    Attributes
    ----------
    rate : float
        Messages a second.
    sent : int
        Their number.
    times : ndarray
        Round trips of those that came back, in the order in which they came, shape (M,), s.
    numbers : ndarray of int
        Which ones they are, shape (M,), from 0.
    """

    rate: float
    sent: int
    times: Floats
    numbers: npt.NDArray[np.int64]

    @property
    def lost(self) -> int:
        """Messages that did not come back."""
        return self.sent - len(np.unique(self.numbers))

    @property
    def longest_burst(self) -> int:
        """Most messages that were lost in a row."""
        there = np.union1d(self.numbers, [-1, self.sent])
        return int(np.diff(there).max()) - 1

    @property
    def reordered(self) -> int:
        """Messages that came back after one that was sent later."""
        if not len(self.numbers):
            return 0
        return int((self.numbers < np.maximum.accumulate(self.numbers)).sum())

    @property
    def loop_delay(self) -> int:
        """Delay that a loop over this link needs, in steps at this rate."""
        return math.ceil(self._percentile(COUNTED) * self.rate - 1e-9) + MARGIN

    @property
    def rate_within_a_step(self) -> float:
        """Rate up to which an answer comes within its own step, so that no delay is needed, Hz."""
        return 1.0 / self._percentile(COUNTED)

    def numbers_by_name(self) -> dict[str, Any]:
        """Give JSON values."""
        return {
            "rate_hz": self.rate,
            "sent": self.sent,
            "lost": self.lost,
            "longest_burst": self.longest_burst,
            "reordered": self.reordered,
            "round_trip_s": {
                **{f"p{p:g}": self._percentile(p) for p in PERCENTILES},
                "least": float(self.times.min()),
                "largest": float(self.times.max()),
            },
            "loop_delay": self.loop_delay,
            "rate_within_a_step_hz": self.rate_within_a_step,
        }

    def _percentile(self, percent: float) -> float:
        return float(np.percentile(self.times, percent))
