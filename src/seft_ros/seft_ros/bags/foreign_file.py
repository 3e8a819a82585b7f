"""A file of a bag that another program wrote, which rosbags reads.

An mcap file is scanned from its beginning, as it was written: with chunks or without, with or
without an index, and up to where it is cut off. Of an sqlite3 file a copy is read.
"""

import json
import os
import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from itertools import batched
from pathlib import Path

import zstandard
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from seft_msgs_py.config.registered import reason_of

from seft_ros.bags.mcap_file import MAGIC, BagSource
from seft_ros.bags.message_blocks import MAX_SIZE, DamageError, MessageBlock, inflated

_ROWS = 2048  # messages that are joined to a block
_ENDING = 37  # bytes of the footer of an mcap file, and of what is behind it
_ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


class ForeignFile:
    """A file of another program, read once when it is opened; attributes as of an `McapFile`.

    Not all messages have checksums: one that was changed may not be noticed.

    Parameters
    ----------
    path : Path
        The file, which is not changed.
    scratch : Path
        Folder for a copy.
    """

    checked = False
    claimed: dict[int, int] | None = None
    recovered: tuple[str, ...] = ()
    metadata = ""

    def __init__(self, path: Path, scratch: Path) -> None:
        self.damage: list[str] = []
        self._reader: McapReader | Sqlite3Reader
        if path.suffix == ".mcap":
            self._reader = McapReader(path)
        else:
            self._reader = Sqlite3Reader(_settled(path, scratch))
        try:
            if isinstance(self._reader, McapReader):
                self._scan(self._reader)
            else:
                self._reader.open()
                self.claimed = {each.id: each.msgcount for each in self._reader.connections}
        except Exception as error:  # rosbags raises what garbage makes it raise
            self._note(error)
        self.sources = {each.id: _source(each) for each in self._reader.connections}
        blocks = self.blocks({number: number for number in self.sources})
        self.counts = Counter(n for block in blocks for n in block.places["source"].tolist())

    def blocks(self, numbers: Mapping[int, int]) -> Iterator[MessageBlock]:
        """Give the messages of some sources; ``numbers`` are what blocks have as their sources."""
        for rows in batched(self._rows(numbers), _ROWS):
            sources, times, raws = zip(*rows, strict=True)
            yield _unpacked(MessageBlock.of(times, sources, raws))

    def close(self) -> None:
        """Close the file."""
        with suppress(AssertionError):  # it could not be opened
            self._reader.close()

    def _scan(self, reader: McapReader) -> None:
        """Find the topics of a file, whatever stands at its ends."""
        reader.bio = reader.path.open("rb")
        size, is_whole = reader.path.stat().st_size, False
        if reader.bio.read(len(MAGIC)) != MAGIC:
            raise DamageError("it does not begin as an mcap file" if size else "it is empty")
        if size > _ENDING:
            reader.bio.seek(-len(MAGIC), os.SEEK_END)
            is_whole = reader.bio.read() == MAGIC
        reader.data_start, reader.data_end = len(MAGIC), size - _ENDING * is_whole
        reader.meta_scan()
        if not is_whole:
            raise DamageError("it is cut off")

    def _rows(self, numbers: Mapping[int, int]) -> Iterator[tuple[int, int, bytes]]:
        """Give number, time in ns and message, up to the first damage."""
        reader = self._reader
        wanted = [each for each in reader.connections if each.id in numbers]
        read = reader.messages_scan if isinstance(reader, McapReader) else reader.messages
        try:
            for each, time_ns, raw in read(wanted) if wanted else ():
                if type(time_ns) is int and type(raw) is bytes:
                    yield numbers[each.id], time_ns, raw
        except Exception as error:
            self._note(error)

    def _note(self, error: Exception) -> None:
        reason = reason_of(error).replace(str(self._reader.path), "it")
        if not isinstance(error, DamageError):
            reason = f"rosbags can't read it: {reason}"
        if isinstance(self._reader, Sqlite3Reader):
            reason += "; mend it by sqlite3 FILE .recover | sqlite3 NEW"
        if not self.damage:  # later passes end at the same place
            self.damage.append(reason)


def _source(connection: Connection) -> BagSource:
    definition, ext = connection.msgdef, connection.ext
    assert isinstance(ext, ConnectionExtRosbag2)
    return BagSource(
        connection.topic,
        connection.msgtype,
        definition.data,
        _ENCODINGS.get(definition.format, ""),
        ext.serialization_format,
        json.dumps(dump_qos_v9(ext.offered_qos_profiles)),
    )


def _settled(path: Path, scratch: Path) -> Path:
    """Copy an sqlite3 file; in the copy sqlite takes back what its writer did not finish."""
    copy = scratch / "bag.db3"
    for end in ("", "-journal", "-wal"):
        if (part := path.with_name(path.name + end)).is_file():
            shutil.copyfile(part, scratch / f"bag.db3{end}")
    with suppress(sqlite3.Error), closing(sqlite3.connect(copy)) as database:
        database.execute("SELECT count(*) FROM sqlite_master")
        database.execute("PRAGMA journal_mode = DELETE")
    return copy


def _unpacked(block: MessageBlock) -> MessageBlock:
    """Decompress messages where the recorder compressed each one; damaged ones are left out."""
    heads = [raw[:4] for *_, raw in MessageBlock(block.data, block.places[:1]).messages()]
    if heads != [zstandard.FRAME_HEADER]:  # a recorder compresses all messages, or none
        return block
    kept, raws, room = [], [], MAX_SIZE
    for index, (_, _, raw) in enumerate(block.messages()):
        with suppress(ValueError, zstandard.ZstdError):
            size = zstandard.frame_content_size(raw)
            plain = b"".join(inflated(raw, room if size < 0 else min(size, room)))
            if size in (-1, len(plain)):
                kept.append(index)
                raws.append(plain)
                room -= len(plain)
    places = block.places[kept]
    return MessageBlock.of(places["time"], places["source"], raws)
