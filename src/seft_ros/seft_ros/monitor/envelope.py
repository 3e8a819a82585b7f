"""Smallest and largest values of a long signal, in bounded memory."""

import numpy as np
import numpy.typing as npt

Samples = npt.NDArray[np.float32]

BUCKETS = 4096
"""Twice as many as a page has columns of pixels."""


class Envelope:
    """Extremes of some signals over equal pieces of time, from the first sample to the last.

    When the buckets are used up, each two become one: the whole of a test is always there, as
    finely as memory allows, and no peak is lost.

    Parameters
    ----------
    columns : int
        Number of signals.
    buckets : int
        Most pieces, even.

    Attributes
    ----------
    origin : int
        Step at which the first bucket begins.
    size : int
        Steps in a bucket.
    count : int
        Buckets in use.
    """

    def __init__(self, columns: int, buckets: int = BUCKETS) -> None:
        self._low = np.full((buckets, columns), np.nan, np.float32)
        self._high = self._low.copy()
        self.origin = self.count = 0
        self.size = 1

    @property
    def low(self) -> Samples:
        """Smallest values, shape (count, columns); NaN where there is no sample."""
        return self._low[: self.count]

    @property
    def high(self) -> Samples:
        """Largest values, as `low`."""
        return self._high[: self.count]

    def add(self, first: int, values: Samples) -> None:
        """Take in samples of consecutive steps, not before those that were taken in.

        Parameters
        ----------
        first : int
            Step of the first.
        values : ndarray
            Shape (N, columns); NaN where there is none.
        """
        if not len(values):
            return
        if not self.count:
            self.origin = first
        last = first + len(values) - 1 - self.origin
        while last // self.size >= len(self._low):
            self._halve()
        buckets = (np.arange(len(values)) + (first - self.origin)) // self.size
        starts = np.flatnonzero(np.diff(buckets, prepend=-1))
        at = buckets[starts]
        self._low[at] = np.fmin(self._low[at], np.fmin.reduceat(values, starts))
        self._high[at] = np.fmax(self._high[at], np.fmax.reduceat(values, starts))
        self.count = int(at[-1]) + 1

    def _halve(self) -> None:
        half = len(self._low) // 2
        for extremes, choose in ((self._low, np.fmin), (self._high, np.fmax)):
            extremes[:half] = choose(extremes[0::2], extremes[1::2])
            extremes[half:] = np.nan
        self.size *= 2
        self.count = -(-self.count // 2)
