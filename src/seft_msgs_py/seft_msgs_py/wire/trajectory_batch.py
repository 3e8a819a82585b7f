"""Many messages of one loop topic decoded at once, as a bag holds them.

Messages of equal length with the layout of the first one differ only in stamp and doubles: a few
array operations check this and read these values of all messages. Every other message goes through
`TrajectoryCodec.decode`.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND
from seft_msgs_py.wire.trajectory import Floats, TrajectoryCodec
from seft_msgs_py.wire.trajectory_layout import ENCAPSULATION, Layout

Steps = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
Part = tuple[Steps, Floats, Steps]  # of a batch, as in `Batch`


class Batch(NamedTuple):
    """Content of many messages.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,): steps of all points of all valid messages, in their order.
    values : ndarray
        Shape (N, q, n): points, quantities, axes. All finite.
    messages : ndarray of int64
        Shape (N,): index of each point's message.
    refused : int
        Number of invalid messages.
    """

    steps: Steps
    values: Floats
    messages: Steps
    refused: int

    def up_to(self, ahead: float) -> "Batch":
        """Leave out points that are more than ``ahead`` steps after the first of their message."""
        first = np.searchsorted(self.messages, self.messages)
        near = np.arange(len(self.steps)) - first <= ahead
        if near.all():
            return self
        return Batch(self.steps[near], self.values[near], self.messages[near], self.refused)


def decode_batch(codec: TrajectoryCodec, rows: Bytes) -> Batch:
    """Read M messages of equal length, shape (M, length), as `TrajectoryCodec.decode` does each.

    Memory is a small multiple of theirs.
    """
    count, length = rows.shape
    layout = codec.layout_of(rows[0].tobytes() if count else b"")
    points, *shape = layout.values.shape
    values = np.empty((count, layout.values.size))
    steps, fits = np.zeros(count, np.int64), np.zeros(count, bool)
    if length >= layout.size and count:
        steps, fits = _steps(codec, rows)
        words = np.ndarray((count, layout.words), "<u8", rows, 4, (length, 8))
        values = words[:, layout.values.ravel()].view(np.float64)
        fits &= np.isfinite(values).all(axis=1) & _as_laid_out(rows, words, layout)
    every = steps[:, np.newaxis] + np.arange(points)
    nothing = np.empty((0, len(codec.topic.quantities), len(codec.axes)))
    parts: list[Part] = [(np.empty(0, np.int64), nothing, np.empty(0, np.int64))]
    refused, start = 0, 0
    for end in [*np.flatnonzero(~fits).tolist(), count]:
        if start < end:
            messages = np.repeat(np.arange(start, end), points)
            parts.append(
                (every[start:end].ravel(), values[start:end].reshape(-1, *shape), messages)
            )
        if end < count:
            try:
                step, single = codec.decode(rows[end].tobytes())
            except WireError:
                refused += 1
            else:
                of_single = step + np.arange(len(single)), single, np.full(len(single), end)
                parts.append(of_single)
        start = end + 1
    if len(parts) == 2:  # the usual case: all messages have the layout
        return Batch(*parts[1], refused)
    found, points_of, messages_of = zip(*parts, strict=True)
    together = np.concatenate(found), np.concatenate(points_of), np.concatenate(messages_of)
    return Batch(*together, refused)


def _as_laid_out(rows: Bytes, words: npt.NDArray[np.uint64], layout: Layout) -> Flags:
    """Whether each message has the constant bits of a layout."""
    checked = np.flatnonzero(layout.mask)
    differing = words[:, checked]
    differing &= layout.mask[checked]
    differing ^= layout.fixed[checked]
    headed = rows[:, : len(ENCAPSULATION)] == np.frombuffer(ENCAPSULATION, np.uint8)
    tail = rows[:, layout.size - len(layout.tail) : layout.size] == list(layout.tail)
    found: Flags = np.bitwise_or.reduce(differing, axis=1) == 0
    return found & headed.all(axis=1) & tail.all(axis=1)


def _steps(codec: TrajectoryCodec, rows: Bytes) -> tuple[Steps, Flags]:
    """Read the stamps of messages: their steps, and which of them are on the grid."""
    seconds = rows[:, 4:8].copy().view("<i4")[:, 0].astype(np.int64)
    nanoseconds = rows[:, 8:12].copy().view("<u4")[:, 0]
    steps, rest = np.divmod(
        seconds * NANOSECONDS_PER_SECOND + nanoseconds, codec.timebase.period_ns
    )
    return steps, (rest == 0) & (steps >= 0)
