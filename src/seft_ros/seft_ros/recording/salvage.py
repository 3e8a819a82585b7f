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
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

_MAGIC_SIZE = 8
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError)
"""What parsers raise where a file ends, or holds anything at all; RuntimeError is lz4's."""


@dataclass(frozen=True)
class Source:
    """What a bag's file says of a topic."""

    topic: str  # with leading slash
    type: str
    definition: str  # text that defines the type; may be empty
    serialization: str  # ``cdr``
    qos: str  # offered, YAML; may be empty


Found = tuple[Source, int, bytes]  # log time in ns, message bytes


def mcap_messages(path: Path) -> Iterator[Found]:
    """Whole messages of an mcap file that may end anywhere, as in mid-record."""
    schemas: dict[int, Schema] = {}
    sources: dict[int, Source] = {}
    with path.open("rb") as file:
        file.seek(_MAGIC_SIZE)
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
            elif record.channel_id in sources:
                yield sources[record.channel_id], record.log_time, _plain(record.data)


def _records(stream: IO[bytes]) -> Iterator[Schema | Channel | Message]:
    """Whole records in their order; of a chunk, also of one that is cut off, those inside."""
    start = stream.tell()
    left = stream.seek(0, 2) - start
    stream.seek(start)
    while len(head := stream.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
        left -= _HEAD.size
        body = stream.read(min(length, left))  # a garbled length would reserve that much memory
        left -= len(body)
        if opcode == Opcode.CHUNK:
            yield from _records(BytesIO(_chunk_data(body)))
        elif len(body) < length:
            return
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            try:
                record = _parsed(opcode, body)
            except _DAMAGE:
                return
            yield record


def _parsed(opcode: int, body: bytes) -> Schema | Channel | Message:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.MESSAGE:
        return Message.read(stream, len(body))
    return Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)


def _chunk_data(body: bytes) -> bytes:
    """Unpack the records of a chunk; of one that is cut off, as far as they go."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))  # its data may be short
        if chunk.compression == "zstd":
            return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
        if chunk.compression == "lz4":
            return LZ4FrameDecompressor().decompress(chunk.data)
        return chunk.data
    except (*_DAMAGE, zstandard.ZstdError):
        return b""


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


def _plain(data: bytes) -> bytes:
    """Message bytes, unpacked where the recorder packed each message."""
    if data[:4] != zstandard.FRAME_HEADER:
        return data
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    except zstandard.ZstdError:
        return data
