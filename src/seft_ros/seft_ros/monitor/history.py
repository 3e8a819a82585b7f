"""What a test has done so far: the last stretch sample by sample, the whole as an envelope."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from seft_ros.monitor.envelope import Envelope, Samples

LENGTH = 2**15
"""Samples that are kept as they came: a minute at 500 Hz."""


class Stretch(NamedTuple):
    """Samples of consecutive steps, from ``first`` on; values of shape (N, columns)."""

    first: int
    values: Samples


class History:
    """Signals of a test by step, from topics that come one after another.

    What belongs to a step is written in any order; when no more of it is to be expected, it is
    released, and then no longer changed.

    Parameters
    ----------
    columns : int
        Number of signals.
    length : int
        Samples that are kept, a power of two.

    Attributes
    ----------
    envelope : Envelope
        Of all that was released.
    head : int
        One beyond the last step written.
    released : int
        One beyond the last step released.
    """

    def __init__(self, columns: int, length: int = LENGTH) -> None:
        self._ring = np.full((length, columns), np.nan, np.float32)
        self._mask = length - 1
        self._begin: int | None = None
        self.envelope = Envelope(columns)
        self.head = self.released = 0

    def write(self, steps: npt.NDArray[np.int64], columns: slice, values: Samples) -> None:
        """Write values of some steps; those released already or far away are left out.

        Parameters
        ----------
        steps : ndarray of int64
            Shape (N,).
        columns : slice
            Which signals.
        values : ndarray
            Shape (N, number of these).
        """
        if self._begin is None:
            return
        fits = (steps >= self.released) & (steps < self.released + len(self._ring))
        if not fits.all():
            steps, values = steps[fits], values[fits]
        if not len(steps):
            return
        self._extend(int(steps.max()) + 1)
        self._ring[steps & self._mask, columns] = values

    def begin(self, step: int) -> None:
        """Begin at a step, or go on there, far beyond what was written."""
        if self._begin is None or step >= self.head:
            self._begin = self.head = self.released = step

    def release(self, until: int) -> Stretch | None:
        """Take what was written of the steps before ``until`` into the history; give it."""
        first, until = self.released, min(until, self.head)
        if until <= first:
            return None
        values = self._ring[np.arange(first, until) & self._mask]
        self.envelope.add(first, values)
        self.released = until
        return Stretch(first, values)

    def recent(self) -> Stretch:
        """Give the last of what was released, as much as is kept."""
        first = max(self._begin or 0, self.head - len(self._ring))
        return Stretch(first, self._ring[np.arange(first, self.released) & self._mask])

    def _extend(self, head: int) -> None:
        if head > self.head:
            self._ring[np.arange(self.head, head) & self._mask] = np.nan
            self.head = head
