"""The open file of a bag: flush it, undo an interrupted write, read it wherever it ends.

rosbags keeps up to 1 MiB of messages in memory and appends to it piece by piece: a process
that is killed loses them all, and a KeyboardInterrupt between two pieces leaves half a record
that makes all that follows unreadable. All use of rosbags' storage objects for that is in this
file.
"""

import os
import shutil
import sqlite3
import struct
import tempfile
import weakref
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.config.registered import reason_of
from seft_msgs_py.wire.messages import typestore
from seft_msgs_py.wire.topics import Topic

_MAGIC_SIZE = 8
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError)
"""What parsers raise at the end of a file, or for garbage; RuntimeError is lz4's."""
_NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")
_QOS = """
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: &forever {{sec: 9223372036, nsec: 854775807}}
  lifespan: *forever
  liveliness: automatic
  liveliness_lease_duration: *forever
  avoid_ros_namespace_conventions: false
"""
_UNKNOWN_HASH = "RIHS01_" + "0" * 64


@dataclass(frozen=True)
class Source:
    """A topic as a bag's file describes it."""

    topic: str  # with leading slash
    type: str
    definition: str  # text that defines the type; may be empty
    serialization: str  # ``cdr``
    qos: str  # offered, YAML; may be empty


Found = tuple[Source, int, bytes]  # log time in ns, message bytes


def file_messages(file: Path, name: str, scratch: Path | None = None) -> Iterator[Found]:
    """Read the complete messages of a bag's file.

    Parameters
    ----------
    file : Path
        The file; it is only read.
    name : str
        Its name, whose suffix gives the format.
    scratch : Path, optional
        Folder for copies; default: that for temporary files.
    """
    if name.endswith(".mcap"):
        yield from mcap_messages(file)
        return
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        if name.endswith(".zstd"):
            unpacked = Path(folder) / name.removesuffix(".zstd")
            with file.open("rb") as packed, unpacked.open("wb") as plain:
                for block in zstandard.ZstdDecompressor().read_to_iter(packed):
                    plain.write(block)
            yield from file_messages(unpacked, unpacked.name, scratch)
            return
        for part in ("", "-journal", "-wal", "-shm"):
            if (source := file.with_name(file.name + part)).exists():
                shutil.copyfile(source, Path(folder) / (name + part))
        yield from sqlite_messages(Path(folder) / name)


def mcap_messages(path: Path) -> Iterator[Found]:
    """Read the complete messages of an mcap file that may end anywhere, as in mid-record."""
    with path.open("rb") as file:
        file.seek(_MAGIC_SIZE)
        yield from _record_messages(file, path.stat().st_size, {}, {})


def _record_messages(
    stream: IO[bytes], size: int, schemas: dict[int, Schema], sources: dict[int, Source]
) -> Iterator[Found]:
    """Read complete messages in their order, also those inside a chunk that is cut off.

    ``schemas`` and ``sources`` are those of the records before, by their numbers.
    """
    while len(head := stream.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
        body = stream.read(min(length, size))  # a garbled length would reserve that much memory
        record = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            chunk = _chunk_data(record)
            yield from _record_messages(BytesIO(chunk), len(chunk), schemas, sources)
            continue
        if len(body) < length:
            return
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(record)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(record)
                schema = schemas.get(channel.schema_id, _NO_SCHEMA)
                sources[channel.id] = Source(
                    topic=channel.topic,
                    type=schema.name,
                    definition=schema.data.decode(errors="replace"),
                    serialization=channel.message_encoding,
                    qos=channel.metadata.get("offered_qos_profiles", ""),
                )
            elif opcode == Opcode.MESSAGE:
                message = Message.read(record, length)
                if message.channel_id in sources:
                    yield sources[message.channel_id], message.log_time, _plain(message.data)
        except _DAMAGE:
            return


def _chunk_data(record: ReadDataStream) -> bytes:
    """Decompress the records of a chunk that may be cut off."""
    try:
        chunk = Chunk.read(record)  # its data may be short
        if chunk.compression == "zstd":
            return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
        if chunk.compression == "lz4":
            return LZ4FrameDecompressor().decompress(chunk.data)
        return chunk.data
    except (*_DAMAGE, zstandard.ZstdError):
        return b""


def sqlite_messages(path: Path) -> Iterator[Found]:
    """Read the messages of an sqlite3 file that can be reached.

    The file is changed: sqlite rolls back what was not committed, and half a page is removed,
    which sqlite would fill with zeros. Give it a copy, with the journal beside it.
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
    except (sqlite3.DatabaseError, UnicodeDecodeError, KeyError, TypeError):
        return  # a damaged file has any names, and values of any type


def _sqlite_sources(database: sqlite3.Connection) -> dict[int, Source]:
    definitions: dict[str, str] = {}
    rows = "SELECT topic_type, encoded_message_definition FROM message_definitions"
    with suppress(sqlite3.OperationalError):  # old recorders have no such table
        definitions = dict(database.execute(rows).fetchall())
    sources = {}
    for row in map(dict, database.execute("SELECT * FROM topics")):
        sources[row["id"]] = Source(
            topic=row["name"],
            type=row["type"],
            definition=definitions.get(row["type"], ""),
            serialization=row["serialization_format"],
            qos=row.get("offered_qos_profiles", ""),
        )
    return sources


def _plain(data: bytes) -> bytes:
    """Decompress a message where the recorder compressed each one."""
    if data[:4] != zstandard.FRAME_HEADER:
        return data
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    except zstandard.ZstdError:
        return data


@lru_cache
def source_of(topic: Topic) -> Source:
    """Describe a topic of a test, with the quality of service of its publisher."""
    durability = "transient_local" if topic.latched else "volatile"
    qos = _QOS.format(depth=topic.depth, durability=durability)
    return Source("/" + topic.name.lstrip("/"), topic.type, "", "cdr", qos)


Connections = dict[tuple[str, str], Connection]  # topic, type


def append(writer: Writer, connections: Connections, found: Found) -> None:
    """Write a message; ``connections`` are those that were made so, and gets a new one."""
    source, time_ns, data = found
    name = source.topic, source.type
    if name not in connections:
        connections[name] = _add_source(writer, source)
    writer.write(connections[name], time_ns, data)


def _add_source(writer: Writer, source: Source) -> Connection:
    """Add a topic to a bag, of whatever type."""
    definition = source.definition
    if source.type in typestore().fielddefs:
        digest = typestore().hash_rihs01(source.type)
        definition = definition or typestore().generate_msgdef(source.type, ros_version=2)[0]
    else:
        store, digest = get_typestore(Stores.EMPTY), _UNKNOWN_HASH
        with suppress(Exception):  # the definition is foreign text, and its hash dispensable
            store.register(get_types_from_msg(definition, source.type))
            digest = store.hash_rihs01(source.type)
    qos: list[Qos] = []
    with suppress(Exception):  # likewise
        qos = parse_qos(source.qos)
    return writer.add_connection(
        source.topic,
        source.type,
        msgdef=definition,
        rihs01=digest,
        serialization_format=source.serialization,
        offered_qos_profiles=qos,
    )


RESERVED = 4 << 20
"""Bytes: an open chunk, and the index of a bag of hours."""
SPARE = 8 << 20
"""Bytes for the end of a test when a disk is suddenly full."""
_HANDLES = Path("/proc/self/fd")


class _UnsyncedSqlite(Sqlite3Writer):
    """Lets the operating system choose when the file reaches the disk, as for an mcap file.

    Committed messages survive this process. Waiting for a busy disk takes seconds, in which
    nothing would be committed.
    """

    SQLITE_SCHEMA = f"PRAGMA synchronous = OFF;{Sqlite3Writer.SQLITE_SCHEMA}"


class UnsyncedWriter(Writer):
    """A `rosbags` writer that does not wait for the disk."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.SQLITE3: _UnsyncedSqlite}  # noqa: RUF012


class Flushed(NamedTuple):
    """State of a writer when all that it had written was flushed."""

    connections: int
    counts: dict[int, int]
    chunks: int = 0  # of an mcap file
    size: int = 0  # of it, bytes


def flush_file(writer: Writer) -> Flushed:
    """Give everything to the operating system, in a form that can be recovered."""
    storage: Any = writer.storage
    state = len(writer.connections), dict(writer.counts)
    if isinstance(storage, Sqlite3Writer):
        storage.conn.commit()
        return Flushed(*state)
    if storage.chunk.bio.tell():
        storage.close_chunk()
    storage.bio.flush()
    return Flushed(*state, len(storage.chunks), storage.bio.tell())


def undo(writer: Writer, last: Flushed) -> None:
    """Remove all that was written after a flush."""
    storage: Any = writer.storage
    del writer.connections[last.connections :]
    writer.counts = dict(last.counts)
    writer.added_types = {connection.msgtype for connection in writer.connections}
    if isinstance(storage, Sqlite3Writer):
        storage.conn.rollback()  # and undo what was committed, too
        execute = storage.cursor.execute
        execute("DELETE FROM messages WHERE id > ?", (sum(last.counts.values()),))
        execute("DELETE FROM topics WHERE id > ?", (last.connections,))
        execute("DELETE FROM message_definitions WHERE topic_type NOT IN (SELECT type FROM topics)")
        return
    storage.bio.seek(last.size)
    storage.bio.truncate()
    del storage.chunks[last.chunks :]
    del storage.channels[last.connections :]
    storage.schemas[:] = [item for item in storage.schemas if item.name in writer.added_types]
    storage.channel_stats = dict(last.counts)
    storage.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), defaultdict(list))


def reserved_room(folder: Path, size: int) -> IO[bytes]:
    """Reserve room on a disk, bytes, in which a bag on a full disk can still be closed.

    It is a file without a name, which frees the room when it is closed: a process that is killed
    leaves none. Raises OSError without enough room.
    """
    file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  it is kept open
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except OSError:
        file.close()
        raise
    return file


def file_reason(error: Exception) -> str:
    """Say in one line why a file can't be read or written."""
    text: str = getattr(error, "strerror", None) or reason_of(error)
    return text.splitlines()[0].rstrip(".")


class OpenFile:
    """An open handle of the file of a bag that is being written.

    A file that was deleted or moved can be read as long as it is open.

    Parameters
    ----------
    path : Path
        The file, in the bag's folder.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle = os.open(path, os.O_RDONLY)
        weakref.finalize(self, os.close, self._handle)

    def size(self) -> int:
        """Size of the file, bytes."""
        return os.fstat(self._handle).st_size

    def displaced(self) -> str:
        """Say whether the file was deleted or moved; empty if it is in its place."""
        status = os.fstat(self._handle)
        with suppress(OSError):
            if os.path.samestat(self._path.stat(), status):
                return ""
        place = (_HANDLES / str(self._handle)).readlink()
        what = f"moved: its file is {place}" if status.st_nlink else "deleted"
        return f"{self._path.parent}: the bag was {what}"

    def messages(self) -> Iterator[Found]:
        """Read the messages of the file, in the order in which they were written.

        Raises OSError if the disk fails.
        """
        return file_messages(_HANDLES / str(self._handle), self._path.name)
