"""Messages of a bag, many at a time: one by one they take 4 us each, in arrays 0.2 us."""

from collections.abc import Iterator, Sequence
from typing import IO, NamedTuple

import numpy as np
import numpy.typing as npt
import zstandard

MAX_SIZE = 1 << 28
"""Bytes of the largest record that is read; recorders write chunks of 1 to 4 MiB. What declares
more could take all memory of the machine."""

_Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]

PLACES = np.dtype([(name, "<i8") for name in ("time", "source", "start", "length")])
"""Of a message: log time in ns, number of its topic, position and number of its bytes."""


class MessageBlock(NamedTuple):
    """Messages in the order in which they were written.

    Attributes
    ----------
    data : ndarray of uint8
        Bytes that contain them.
    places : ndarray of PLACES
        Shape (M,).
    """

    data: _Bytes
    places: npt.NDArray[np.void]

    @classmethod
    def of(
        cls, times: npt.ArrayLike, sources: npt.ArrayLike, raws: Sequence[bytes]
    ) -> "MessageBlock":
        """Join single messages."""
        places = np.zeros(len(raws), PLACES)
        places["time"], places["source"] = times, sources
        places["length"] = np.fromiter(map(len, raws), np.int64, len(raws))
        places["start"] = np.cumsum(places["length"]) - places["length"]
        return cls(np.frombuffer(b"".join(raws), np.uint8), places)

    @classmethod
    def joined(cls, parts: Sequence["MessageBlock"]) -> "MessageBlock":
        """Join blocks to one."""
        if len(parts) == 1:
            return parts[0]
        places = np.concatenate([part.places for part in parts])
        starts = np.cumsum([0, *(len(part.data) for part in parts[:-1])])
        places["start"] += np.repeat(starts, [len(part.places) for part in parts])
        return cls(np.concatenate([part.data for part in parts]), places)

    def only(self, which: npt.NDArray[np.bool_]) -> "MessageBlock":
        """Keep some of the messages, in their order; the bytes are not copied."""
        return self if which.all() else MessageBlock(self.data, self.places[which])

    def renumbered(self, numbers: Integers) -> "MessageBlock":
        """Replace the sources by ``numbers[source]``; messages with -1 there are left out."""
        sources = numbers[self.places["source"]]
        block = self.only(sources >= 0)
        places = block.places.copy()
        places["source"] = sources[sources >= 0]
        return MessageBlock(block.data, places)

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Give them one by one: number of the topic, log time in ns, bytes."""
        columns = (self.places[name].tolist() for name in ("time", "source", "start", "length"))
        for time, source, start, length in zip(*columns, strict=True):
            yield source, time, self.data[start : start + length].tobytes()

    def alike(self) -> Iterator[tuple[_Bytes, Integers]]:
        """Give runs of equal length: bytes, shape (M, length), and log times (M,)."""
        ends = np.flatnonzero(np.diff(self.places["length"])) + 1
        for run in np.split(self.places, ends):
            if not len(run):
                continue
            length = int(run["length"][0])
            rows = np.empty((len(run), 0), np.uint8)
            if length:
                # a view of every piece of this length, of which an index takes each as one item
                count = max(0, len(self.data) - length + 1)
                pieces = np.ndarray((count,), f"V{length}", self.data, 0, (1,))
                rows = pieces[run["start"]].view(np.uint8).reshape(-1, length)
            yield rows, run["time"]


def records_of(raw: bytes) -> tuple[MessageBlock, Iterator[tuple[int, bytes]]]:
    """Find the records of an uncompressed chunk, or of what stands behind all chunks.

    Returns
    -------
    block : MessageBlock
        The messages, with their channels as sources.
    definitions : iterator of (int, bytes)
        Opcode and content of the records of types, channels and numbers of messages.

    Raises
    ------
    ValueError
        If they do not fit it.
    """
    from seft_ros.bags.record_scan import IN_RECORD, scan  # who only writes bags compiles nothing

    data = np.frombuffer(raw, np.uint8)
    table = np.empty((len(data) // IN_RECORD + 1, 4), np.int64)
    count = scan(data, table)
    if count < 0:
        raise ValueError("its records do not fit it")
    places = table[:count].view(PLACES)[:, 0]
    are_messages = places["source"] >= 0
    definitions = (
        (-int(place["source"]), raw[place["start"] : place["start"] + place["length"]])
        for place in places[~are_messages]
    )
    return MessageBlock(data, places[are_messages]), definitions


class DamageError(ValueError):
    """What is wrong at a place of a file."""


def inflated(packed: bytes | IO[bytes], limit: int) -> Iterator[bytes]:
    """Decompress a zstd frame part by part; more than ``limit`` bytes are a `DamageError`."""
    size = 0
    for part in zstandard.ZstdDecompressor().read_to_iter(packed):
        size += len(part)
        if size > limit:
            raise DamageError("it is packed, and larger than it can be")
        yield part
