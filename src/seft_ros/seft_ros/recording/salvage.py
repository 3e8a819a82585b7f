"""Every message that is whole in a bag's file, wherever the file ends."""

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader

_MAGIC_SIZE = 8
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError)
"""What parsers raise where a file ends, or holds anything at all; RuntimeError is lz4's."""


@dataclass(frozen=True)
class Source:
    """What a bag's file says of a topic.

    Attributes
    ----------
    topic, type : str
        Name with leading slash, message type.
    definition : str
        Text that defines the type; may be empty.
    serialization : str
        ``cdr``.
    qos : str
        Offered quality of service, YAML; may be empty.
    """

    topic: str
    type: str
    definition: str
    serialization: str
    qos: str


Found = tuple[Source, int, bytes]  # log time in ns, message bytes


def mcap_messages(path: Path) -> Iterator[Found]:
    """Whole messages of an mcap file that may end anywhere, as in mid-record."""
    schemas: dict[int, Schema] = {}
    sources: dict[int, Source] = {}
    with path.open("rb") as file:
        for record in _records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                schema = schemas.get(record.schema_id)
                sources[record.id] = Source(
                    topic=record.topic,
                    type=schema.name if schema else "",
                    definition=schema.data.decode(errors="replace") if schema else "",
                    serialization=record.message_encoding,
                    qos=record.metadata.get("offered_qos_profiles", ""),
                )
            elif isinstance(record, Message) and record.channel_id in sources:
                yield sources[record.channel_id], record.log_time, _plain(record.data)


def sqlite_messages(path: Path) -> Iterator[Found]:
    """Messages of an sqlite3 file that can be reached.

    The file is changed: sqlite has to roll back what was not committed, and half a page is
    cut off, which it would fill with zeros. Give it a copy, with the journal beside it.
    """
    try:
        with path.open("r+b") as file:
            page_size = int.from_bytes(file.read(18)[16:], "big") or 1
            page_size = 65536 if page_size == 1 else page_size
            file.truncate(path.stat().st_size // page_size * page_size)
        with closing(sqlite3.connect(path)) as database:
            database.row_factory = sqlite3.Row
            # the only switch by which sqlite reads a file that is shorter than it should be
            database.execute("PRAGMA writable_schema = ON")
            sources = _sqlite_sources(database)
            rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id")
            for topic, time_ns, data in rows:
                if topic in sources and isinstance(time_ns, int) and isinstance(data, bytes):
                    yield sources[topic], time_ns, _plain(data)
    except (sqlite3.DatabaseError, UnicodeDecodeError, IndexError, TypeError):
        return  # of a damaged file sqlite gives any names, and values of any type


def _plain(data: bytes) -> bytes:
    """Message bytes, unpacked where the recorder packed each message."""
    if data[:4] != zstandard.FRAME_HEADER:
        return data
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    except zstandard.ZstdError:
        return data


def _sqlite_sources(database: sqlite3.Connection) -> dict[int, Source]:
    definitions: dict[str, str] = {}
    if database.execute("PRAGMA table_info(message_definitions)").fetchall():
        rows = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        definitions = dict(database.execute(rows).fetchall())
    return {
        row["id"]: Source(
            topic=row["name"],
            type=row["type"],
            definition=definitions.get(row["type"], ""),
            serialization=row["serialization_format"],
            qos=row["offered_qos_profiles"] if "offered_qos_profiles" in row.keys() else "",  # noqa: SIM118
        )
        for row in database.execute("SELECT * FROM topics")
    }


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """Whole records in their order, those inside chunks too; of the last chunk what is there."""
    whole = _MAGIC_SIZE
    try:
        for record in StreamReader(_WholeReads(file), emit_chunks=True).records:  # type: ignore[arg-type]
            whole = file.tell()
            if isinstance(record, Chunk):
                yield from _records_inside(record)
            else:
                yield record
    except _DAMAGE:
        file.seek(whole)
        yield from _records_of_cut_chunk(file.read())


def _records_of_cut_chunk(tail: bytes) -> Iterator[McapRecord]:
    if len(tail) < _HEAD.size or tail[0] != Opcode.CHUNK:
        return
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(tail[_HEAD.size :])))  # its data may be short
    except _DAMAGE:
        return
    yield from _records_inside(chunk)


def _records_inside(chunk: Chunk) -> Iterator[McapRecord]:
    try:
        data = chunk.data
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        elif chunk.compression == "lz4":
            data = LZ4FrameDecompressor().decompress(data)
        stream = _WholeReads(BytesIO(data))
        yield from StreamReader(stream, skip_magic=True).records  # type: ignore[arg-type]
    except (*_DAMAGE, zstandard.ZstdError):
        return  # the end of a chunk's data is always met this way


class _WholeReads:
    """A stream that gives what is asked for or, unlike a file, nothing."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        start = stream.tell()
        self._most = stream.seek(0, 2)
        stream.seek(start)

    def read(self, size: int) -> bytes:
        if not 0 <= size <= self._most:  # a garbled length would reserve that much memory
            raise EndOfFile
        data = self._stream.read(size)
        if len(data) != size:
            raise EndOfFile
        return data
