"""Messages of an mcap file, whole chunks at a time.

rosbags takes 4 us for each message. Here the index that stands behind a chunk tells where its
messages are, and arrays do the rest. The index is only a hint: what it leaves out, or where it
does not fit the chunk, is found from record to record. Messages and their order are those of
rosbags: log time and, where times are equal, the file.
"""

import struct
from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, decompress

from seft_ros.recording.message_block import PLACES, Bytes, MessageBlock, gathered

Offsets = npt.NDArray[np.int64]

BATCH = 1 << 20
"""Bytes of chunks that are worked on together: enough for arrays to pay, and few for the cache."""

_MESSAGE, _INDEX = 0x05, 0x07
_RECORD = struct.Struct("<BQ")  # opcode, length
_INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length, channel, bytes of (log time, offset)
_CHUNK_HEAD = struct.Struct("<QQQI")  # start, end, uncompressed size, checksum
_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_IN_HEAD = _HEAD.itemsize - _RECORD.size  # bytes of the head that the length counts
_LOGGED = np.dtype([*((name, PLACES[name]) for name in PLACES.names or ()), ("chunk", "<i8")])


def read_chunks(reader: McapReader, sources: Mapping[int, int]) -> Iterator[MessageBlock]:
    """Read the messages of some channels.

    Parameters
    ----------
    reader : McapReader
        Open, of a file with chunks.
    sources : mapping of int to int
        Channel -> number of the connection in the blocks.

    Raises
    ------
    ReaderError
        If a chunk is damaged.
    """
    numbers = np.full(1 << 16, -1, np.int64)  # by channel
    numbers[list(sources)] = list(sources.values())
    chunks = [c for c in reader.chunks if any(c.channel_count.get(i, 0) for i in sources)]
    chunks.sort(key=_start)
    datas: list[Bytes] = []
    places: list[npt.NDArray[np.void]] = []
    size = 0
    for index, chunk in enumerate(chunks):
        data, hint = _read(reader, chunk)
        datas.append(data)
        places.append(_logged(data, hint, chunk, numbers))
        places[-1]["start"] += size
        size += len(data)
        following = chunks[index + 1] if index + 1 < len(chunks) else None
        if following and size < BATCH:
            continue
        block = MessageBlock(np.concatenate(datas), _in_order(np.concatenate(places)))
        ready = _before(block.places, following)
        yield block.only(ready)
        held = block.only(~ready)  # chunks may overlap in time
        datas = [np.frombuffer(b"".join(raw for *_, raw in held.messages()), np.uint8)]
        places, size = [held.places], len(datas[0])
        places[0]["start"] = np.cumsum(held.places["length"]) - held.places["length"]


def message_starts(data: Bytes, hint: Offsets) -> Offsets:
    """Find where the message records of a chunk start, in the order of the chunk.

    Parameters
    ----------
    data : ndarray of uint8
        The chunk, uncompressed.
    hint : ndarray of int64
        Where some of them are said to start; what is wrong with it makes this slow, no more.

    Raises
    ------
    ReaderError
        If the chunk is damaged.
    """
    starts = np.sort(hint)
    if not len(starts) or starts[0] < 0 or starts[-1] > len(data) - _HEAD.itemsize:
        return _scanned(data, 0, len(data))
    heads = _heads(data, starts)
    lengths = np.minimum(heads["length"], len(data)).astype(np.int64)
    ends = starts + _RECORD.size + lengths
    if (heads["opcode"] != _MESSAGE).any() or lengths.min() < _IN_HEAD:
        return _scanned(data, 0, len(data))
    gap_starts, gap_ends = np.append(0, ends), np.append(starts, len(data))
    gaps = np.flatnonzero(gap_starts != gap_ends)
    try:
        found = [_scanned(data, int(gap_starts[at]), int(gap_ends[at])) for at in gaps]
    except ReaderError:
        return _scanned(data, 0, len(data))
    return np.sort(np.concatenate([starts, *found]))


def _scanned(data: Bytes, at: int, end: int) -> Offsets:
    """Find messages by going from record to record, which must end where they should."""
    raw, found = memoryview(data), []
    while at + _RECORD.size <= end:
        opcode, length = _RECORD.unpack_from(raw, at)
        if opcode == _MESSAGE:
            if length < _IN_HEAD:
                raise ReaderError(f"a message record of {length} bytes is none")
            found.append(at)
        at += _RECORD.size + length
    if at != end:
        raise ReaderError("the records of a chunk do not fit it")
    return np.array(found, np.int64)


def _logged(data: Bytes, hint: Offsets, chunk: ChunkInfo, numbers: Offsets) -> npt.NDArray[np.void]:
    """Messages of a chunk that are wanted, in the order of the chunk."""
    starts = message_starts(data, hint)
    heads = _heads(data, starts)
    found = np.empty(len(starts), _LOGGED)
    found["time"], found["source"] = heads["log_time"], numbers[heads["channel"]]
    found["start"] = starts + _HEAD.itemsize
    found["length"] = heads["length"].astype(np.int64) - _IN_HEAD
    found["chunk"] = chunk.chunk_start_offset
    first, last = chunk.message_start_time, chunk.message_end_time
    wanted = (found["source"] >= 0) & (first <= heads["log_time"]) & (heads["log_time"] <= last)
    return found[wanted]


def _heads(data: Bytes, starts: Offsets) -> npt.NDArray[np.void]:
    return gathered(data, starts, _HEAD.itemsize).view(_HEAD)[:, 0]


def _in_order(places: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    times = places["time"]
    if (times[1:] >= times[:-1]).all() and (np.diff(places["chunk"]) >= 0).all():
        return places
    return places[np.lexsort((places["chunk"], times))]


def _before(places: npt.NDArray[np.void], chunk: ChunkInfo | None) -> npt.NDArray[np.bool_]:
    """Which messages come before all of a chunk; those of the same time by place in the file."""
    if chunk is None:
        return np.ones(len(places), bool)
    time, place = _start(chunk)
    return (places["time"] < time) | ((places["time"] == time) & (places["chunk"] < place))


def _read(reader: McapReader, chunk: ChunkInfo) -> tuple[Bytes, Offsets]:
    """Bytes of a chunk, and where the index behind it says that messages start."""
    assert reader.bio
    reader.bio.seek(chunk.chunk_start_offset)
    record = reader.bio.read(chunk.chunk_length + chunk.message_index_length)
    *_, checksum = _CHUNK_HEAD.unpack_from(record, _RECORD.size)
    # a text and a size, as in the summary's index of chunks, stand before the data
    at = _RECORD.size + _CHUNK_HEAD.size + 4 + len(chunk.compression) + 8
    packed = record[at : at + chunk.compressed_size]
    data = decompress(packed, chunk.compression, chunk.uncompressed_size, checksum)
    return np.frombuffer(data, np.uint8), _indexed(record, chunk.chunk_length)


def _indexed(record: bytes, at: int) -> Offsets:
    """Offsets in all the index records that follow a chunk."""
    found = [np.empty(0, np.int64)]
    while at + _INDEX_HEAD.size <= len(record):
        opcode, length, _, size = _INDEX_HEAD.unpack_from(record, at)
        start = at + _INDEX_HEAD.size
        at += _RECORD.size + length
        if opcode != _INDEX or size % 16 or start + size != at or at > len(record):
            break
        found.append(np.frombuffer(record, "<i8", size // 8, start)[1::2])
    return np.concatenate(found)


def _start(chunk: ChunkInfo) -> tuple[int, int]:
    return chunk.message_start_time, chunk.chunk_start_offset
