"""All messages of some connections of a bag, block by block, whatever its storage."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice

import zstandard
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from seft_ros.recording.chunk_reader import read_chunks
from seft_ros.recording.message_block import MessageBlock

_ROWS = 2048  # messages that are joined to a block
_UNPACKER = zstandard.ZstdDecompressor()
Row = tuple[int, int, bytes]  # connection, log time in ns, message


def bag_blocks(reader: Reader, connections: Sequence[Connection]) -> Iterator[MessageBlock]:
    """Read messages file by file, each in the order of log time, as rosbags does.

    A file's topics are known by name and type. rosbags looks at the quality of service too, and
    leaves out, without a word, topics of which metadata and file tell different things.

    Parameters
    ----------
    reader : Reader
        An open bag.
    connections : sequence of Connection
        Some of the bag's; messages carry their numbers in it.
    """
    numbers = {(item.topic, item.msgtype): k for k, item in reversed([*enumerate(connections)])}
    unpack = reader.compression_mode == "message"
    for storage in getattr(reader.storage, "storages", [reader.storage]):
        sources = {
            item.id: numbers[item.topic, item.msgtype]
            for item in storage.connections
            if (item.topic, item.msgtype) in numbers
        }
        if not sources:
            continue
        if isinstance(storage, McapReader) and storage.chunks and not unpack:
            yield from read_chunks(storage, sources)
        elif isinstance(storage, Sqlite3Reader) and not unpack:
            yield from _joined(_rows(storage, sources), sources)
        else:
            wanted = [item for item in storage.connections if item.id in sources]
            messages = ((item.id, time, raw) for item, time, raw in storage.messages(wanted))
            if unpack:
                messages = ((item, time, _unpacked(raw)) for item, time, raw in messages)
            yield from _joined(messages, sources)


def _unpacked(raw: bytes) -> bytes:
    """Message that the recorder packed; its frame need not tell the size."""
    unpacking = _UNPACKER.decompressobj()
    message: bytes = unpacking.decompress(raw)
    if not unpacking.eof:
        raise zstandard.ZstdError("a packed message ends early")
    return message


def _rows(storage: Sqlite3Reader, sources: Mapping[int, int]) -> Iterator[Row]:
    """Rows of the table of messages, each an object of its own only here."""
    assert storage.dbconn
    marks = ",".join("?" * len(sources))
    query = (
        "SELECT topic_id, timestamp, data FROM messages "
        f"WHERE topic_id IN ({marks}) ORDER BY timestamp"
    )
    return iter(storage.dbconn.execute(query, tuple(sources)))


def _joined(rows: Iterable[Row], sources: Mapping[int, int]) -> Iterator[MessageBlock]:
    rows = iter(rows)
    while some := list(islice(rows, _ROWS)):
        items, times, raws = zip(*some, strict=True)
        yield MessageBlock.of(times, [sources[item] for item in items], raws)
