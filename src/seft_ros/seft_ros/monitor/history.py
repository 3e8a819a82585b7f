"""History of a test: its signals, the last stretch sample by sample, the whole as an envelope.

A page gets both as frames: a header, and float32 values signal by signal.
"""

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.wire.topics import RigAxes

from seft_ros.analysis.summary import COMPARED
from seft_ros.bags.recording import Series, of_all_rigs

HistoryBatch = tuple[Ints, Floats, Ints]
"""Steps, values of shape (N, 4, axes), and the time of sending of each, ns."""
MAX_WAITING = 2**14
"""Number of steps of a rig that are kept while another is silent."""
_FOLLOWED = ("displacement", "force")
"""Quantities with a displayed error."""


class Signals:
    """Columns of a history over n axes: measured, reference, their error, the answer's time.

    Attributes
    ----------
    axes : tuple of str
        Names of the n axes.
    measured, reference : dict of str to slice
        Columns of a quantity in `COMPARED`, one for each axis; m, m/s^2, N.
    error : dict of str to slice
        Columns of measured minus reference, of the quantities in `_FOLLOWED`.
    answer : slice
        Time from a state's publication to that of its reference force, ms.
    count : int
        Number of columns.
    """

    def __init__(self, axes: tuple[str, ...]) -> None:
        n, self.axes = len(axes), axes
        columns = [slice(start, start + n) for start in range(0, n * (2 * len(COMPARED) + 2), n)]
        self.measured = dict(zip(COMPARED, columns[0:-2:2], strict=True))
        self.reference = dict(zip(COMPARED, columns[1:-2:2], strict=True))
        self.error = dict(zip(_FOLLOWED, columns[-2:], strict=True))
        self.count = columns[-1].stop + 1
        self.answer = slice(self.count - 1, self.count)

    def layout(self) -> dict[str, Any]:
        """Give the first column of each signal, for the page."""
        parts = {"measured": self.measured, "reference": self.reference, "error": self.error}
        starts = {part: {name: own[name].start for name in own} for part, own in parts.items()}
        return {"axes": list(self.axes), **starts, "answer": self.answer.start}


class RigBatches:
    """Keeps the states of rigs until all have sent the same step.

    Parameters
    ----------
    rigs : sequence of RigAxes
        The rigs of the test.
    """

    def __init__(self, rigs: Sequence[RigAxes]) -> None:
        self._rigs = tuple(rigs)
        none, empty = np.empty(0, np.int64), [np.empty((0, 4, len(rig.axes))) for rig in rigs]
        self._waiting = [Series(none, values, received_ns=none) for values in empty]

    def take(self, rig: int, batch: HistoryBatch) -> None:
        """Add states of a rig; a step that is not after the last one begins a new test for it."""
        one = self._waiting[rig]
        assert one.received_ns is not None
        before = one.steps, one.values, one.received_ns
        steps, values, sent = (np.concatenate(pair) for pair in zip(before, batch, strict=True))
        begins = np.flatnonzero(np.diff(steps, prepend=-1) <= 0)
        newest = slice(max([*begins, len(steps) - MAX_WAITING, 0]), None)
        self._waiting[rig] = Series(steps, values, received_ns=sent).rows(newest)

    def complete(self) -> HistoryBatch:
        """Give the steps that all rigs have sent; each step once."""
        found = of_all_rigs(self._waiting, self._rigs)
        assert found.received_ns is not None
        if len(found.steps):
            self._waiting = [one.rows(one.steps > found.steps[-1]) for one in self._waiting]
        return found.steps, found.values, found.received_ns


_Samples = npt.NDArray[np.float32]
_AnyFloats = npt.NDArray[np.floating[Any]]
BUCKETS = 4096
"""Twice the columns of pixels of a page."""
LENGTH = 2**15
"""Samples that are kept individually: a minute at 500 Hz."""
SAMPLES, ENVELOPE, RECENT_FRAME = range(3)
"""Frames: new samples; the whole test so far; its last part, which the envelope contains."""
Frame = str | bytes
"""What a page receives: JSON text, or a frame of samples."""
_HEADER = struct.Struct("<4I2d")


class Envelope:
    """Extremes of some signals over equal pieces of time, from the first sample to the last.

    When all buckets are used, each two become one: the whole test is always there, as finely as
    memory allows, and no peak is lost.

    Parameters
    ----------
    columns : int
        Number of signals.
    buckets : int
        Largest number of pieces, even.

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
    def low(self) -> _Samples:
        """Smallest values, shape (count, columns); NaN where there is no sample."""
        return self._low[: self.count]

    @property
    def high(self) -> _Samples:
        """Largest values, see `low`."""
        return self._high[: self.count]

    def add(self, first: int, values: _Samples) -> None:
        """Add samples (N, columns), NaN if missing, of consecutive steps from ``first`` on.

        No step may be before earlier ones.
        """
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


class Stretch(NamedTuple):
    """Samples of consecutive steps, from ``first`` on; values of shape (N, columns)."""

    first: int
    values: _Samples


class History:
    """Signals of a test by step, from topics that are read in turn.

    Signals of a step are written in any order; a step is released when no more signals are
    expected, and does not change after that.

    Parameters
    ----------
    columns : int
        Number of signals.
    length : int
        Number of samples kept, a power of two.

    Attributes
    ----------
    envelope : Envelope
        Of all released steps.
    head : int
        One beyond the last step written.
    released : int
        One beyond the last step released.
    """

    def __init__(self, columns: int, length: int = LENGTH) -> None:
        self._ring = np.full((length, columns), np.nan, np.float32)
        self._mask = length - 1
        self.envelope = Envelope(columns)
        self._begin = self.head = self.released = 0

    def write(self, steps: npt.NDArray[np.int64], columns: slice, values: _AnyFloats) -> None:
        """Write values (N, number of columns) of steps (N,).

        Steps that are already released or far away are left out.
        """
        fits = (steps >= self.released) & (steps < self.released + len(self._ring))
        steps, values = steps[fits], values[fits]
        if not len(steps):
            return
        head = int(steps.max()) + 1
        self._ring[np.arange(self.head, head) & self._mask] = np.nan
        self.head = max(self.head, head)
        self._ring[steps & self._mask, columns] = values

    def begin(self, step: int) -> None:
        """Begin at a step, or continue there, far beyond the written steps."""
        if step >= self.head:
            self._begin = self.head = self.released = step

    def subtract(self, until: int, target: slice, minuend: slice, subtrahend: slice) -> None:
        """Write differences of signals, of the unreleased steps before ``until``."""
        slots = np.arange(self.released, min(until, self.head)) & self._mask
        self._ring[slots, target] = self._ring[slots, minuend] - self._ring[slots, subtrahend]

    def release(self, until: int) -> Stretch | None:
        """Release the steps before ``until``, and give them."""
        first, until = self.released, min(until, self.head)
        if until <= first:
            return None
        values = self._ring[np.arange(first, until) & self._mask]
        self.envelope.add(first, values)
        self.released = until
        return Stretch(first, values)

    def recent(self) -> Stretch:
        """Give the last released steps that are kept."""
        first = max(self._begin, self.head - len(self._ring))
        return Stretch(first, self._ring[np.arange(first, self.released) & self._mask])


def samples_frame(test: int, stretch: Stretch, kind: int = SAMPLES) -> bytes:
    """Make a frame, `SAMPLES` or `RECENT_FRAME`, of samples of a test by its number."""
    return _frame(kind, test, stretch.first, 1, stretch.values)


def envelope_frame(test: int, envelope: Envelope) -> bytes:
    """Make a frame of an envelope: all the lows, then all the highs."""
    return _frame(ENVELOPE, test, envelope.origin, envelope.size, envelope.low, envelope.high)


def _frame(kind: int, test: int, first: int, size: int, *parts: _Samples) -> bytes:
    count, columns = parts[0].shape
    header = _HEADER.pack(kind, test, columns, count, first, size)
    return header + b"".join(np.ascontiguousarray(part.T, "<f4").tobytes() for part in parts)
