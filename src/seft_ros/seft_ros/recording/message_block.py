"""Many messages of a bag in the bytes they stand in, for arrays to work on."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]
Times = npt.NDArray[np.int64]

PLACES = np.dtype([(name, "<i8") for name in ("time", "source", "start", "length", "chunk")])
"""Of a message: log time in ns, number of its connection, where its bytes start, how many they
are, and where in the file its chunk starts."""


class MessageBlock(NamedTuple):
    """Messages in the order in which they are to be read.

    Attributes
    ----------
    data : ndarray of uint8
        Bytes that hold them, and other things.
    places : ndarray of PLACES
        Shape (M,).
    """

    data: Bytes
    places: npt.NDArray[np.void]

    @classmethod
    def of(
        cls, times: Sequence[int], sources: Sequence[int], raws: Sequence[bytes]
    ) -> "MessageBlock":
        """Join messages that stand apart."""
        places = np.zeros(len(raws), PLACES)
        places["time"], places["source"] = times, sources
        places["length"] = np.fromiter(map(len, raws), np.int64, len(raws))
        places["start"] = np.cumsum(places["length"]) - places["length"]
        return cls(np.frombuffer(b"".join(raws), np.uint8), places)

    def only(self, which: Flags) -> "MessageBlock":
        """Keep some of the messages, in their order; the bytes are not copied."""
        return self if which.all() else MessageBlock(self.data, self.places[which])

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Give them one by one: number of the connection, log time in ns, bytes."""
        columns = (self.places[name].tolist() for name in ("time", "source", "start", "length"))
        for time, source, start, length in zip(*columns, strict=True):
            yield source, time, self.data[start : start + length].tobytes()

    def alike(self) -> Iterator[tuple[Bytes, Times]]:
        """Give those of equal length together: bytes, shape (M, length), and log times (M,)."""
        ends = np.flatnonzero(np.diff(self.places["length"])) + 1
        for run in np.split(self.places, ends):
            if len(run):
                yield gathered(self.data, run["start"], int(run["length"][0])), run["time"]


def gathered(data: Bytes, starts: Times, length: int) -> Bytes:
    """Copy equally long pieces of some bytes, shape (M, length)."""
    if not length:
        return np.empty((len(starts), 0), np.uint8)
    # all pieces there are, of which an index takes each as one item
    pieces = np.ndarray((max(0, len(data) - length + 1),), f"V{length}", data, 0, (1,))
    return pieces[starts].view(np.uint8).reshape(-1, length)
