"""Many messages of one loop topic decoded at once, as a bag holds them.

Messages of equal length that all have the layout which the first of them claims differ in
stamp and doubles alone: that is checked, and these are read, for all of them by a few array
operations. Every other message goes through `TrajectoryCodec.decode`, one by one.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from seft_msgs_py.errors import WireError
from seft_msgs_py.timebase import NANOSECONDS_PER_SECOND
from seft_msgs_py.trajectory import TrajectoryCodec
from seft_msgs_py.trajectory_message import ENCAPSULATION

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Samples = tuple[Steps, Floats]


class Batch(NamedTuple):
    """What many messages hold.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,): steps of all points of all messages that are understood, in their order.
    values : ndarray
        Shape (N, q, n): points, quantities, axes. All finite.
    messages : ndarray of int64
        Shape (N,): index of the message that each point is of.
    refused : int
        Messages that are not understood.
    """

    steps: Steps
    values: Floats
    messages: Steps
    refused: int


def decode_batch(codec: TrajectoryCodec, raws: Sequence[bytes]) -> Batch:
    """Read messages as `TrajectoryCodec.decode` does each of them.

    Parameters
    ----------
    codec : TrajectoryCodec
        Of their topic.
    raws : sequence of bytes
        The messages; memory is a small multiple of theirs.
    """
    steps = [np.empty(0, np.int64)]
    values = [np.empty((0, len(codec.topic.quantities), len(codec.axes)))]
    messages = [np.empty(0, np.int64)]
    done = refused = 0
    for _, alike in groupby(raws, len):
        for count, part in _decode_alike(codec, list(alike)):
            if part is None:
                refused += 1
            elif count:
                steps.append(part[0])
                values.append(part[1])
                messages.append(np.repeat(np.arange(done, done + count), len(part[0]) // count))
            done += count
    return Batch(np.concatenate(steps), np.concatenate(values), np.concatenate(messages), refused)


def _decode_alike(
    codec: TrajectoryCodec, raws: list[bytes]
) -> Iterator[tuple[int, Samples | None]]:
    """Decode messages of equal length, in order, some at a time: their number, and what they hold.

    None for each that is not understood.
    """
    layout = codec.layout_of(raws[0])
    length, points = len(raws[0]), len(layout.values)
    if length < layout.size:
        yield from ((1, _decode_one(codec, raw)) for raw in raws)
        return
    joined = b"".join(raws)
    rows = np.frombuffer(joined, np.uint8).reshape(len(raws), length)
    words = np.ndarray((len(raws), layout.words), "<u8", joined, 4, (length, 8))
    first, stamped = _steps(codec, rows)
    values = words[:, layout.values.ravel()].view(np.float64)
    fits = (
        stamped
        & ~((words & layout.mask) ^ layout.fixed).any(axis=1)
        & np.isfinite(values).all(axis=1)
        & (rows[:, :4] == np.frombuffer(ENCAPSULATION, np.uint8)).all(axis=1)
        & (rows[:, layout.size - len(layout.tail) : layout.size] == list(layout.tail)).all(axis=1)
    )
    steps = first[:, np.newaxis] + np.arange(points)
    start = 0
    for end in [*np.flatnonzero(~fits).tolist(), len(raws)]:
        part = values[start:end].reshape(-1, *layout.values.shape[1:])
        yield end - start, (steps[start:end].ravel(), part)
        if end < len(raws):
            yield 1, _decode_one(codec, raws[end])
        start = end + 1


def _steps(
    codec: TrajectoryCodec, rows: npt.NDArray[np.uint8]
) -> tuple[Steps, npt.NDArray[np.bool_]]:
    """Read the stamps of messages: the steps they name, and which of them are on the grid."""
    seconds = rows[:, 4:8].copy().view("<i4")[:, 0].astype(np.int64)
    nanoseconds = rows[:, 8:12].copy().view("<u4")[:, 0]
    steps, rest = np.divmod(
        seconds * NANOSECONDS_PER_SECOND + nanoseconds, codec.timebase.period_ns
    )
    return steps, (rest == 0) & (steps >= 0)


def _decode_one(codec: TrajectoryCodec, raw: bytes) -> Samples | None:
    try:
        step, values = codec.decode(raw)
    except WireError:
        return None
    return step + np.arange(len(values)), values
