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
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.wire.messages import typestore
from seft_msgs_py.wire.topics import Topic

_MAGIC_SIZE = 8
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError, RuntimeError)
"""What parsers raise at the end of a file, or for garbage; RuntimeError is lz4's."""
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
    """Read complete records in their order, also those inside a chunk that is cut off."""
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
    """Decompress the records of a chunk that may be cut off."""
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
    except (sqlite3.DatabaseError, UnicodeDecodeError, IndexError, TypeError):
        return  # a damaged file has any names, and values of any type


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
    """Decompress a message where the recorder compressed each one."""
    if data[:4] != zstandard.FRAME_HEADER:
        return data
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    except zstandard.ZstdError:
        return data


def source_of(topic: Topic) -> Source:
    """Describe a topic of a test, with the quality of service of its publisher."""
    durability = "transient_local" if topic.latched else "volatile"
    qos = _QOS.format(depth=topic.depth, durability=durability)
    return Source("/" + topic.name.lstrip("/"), topic.type, "", "cdr", qos)


def add_source(writer: Writer, source: Source) -> Connection:
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
    qos: Any = source.qos
    try:
        qos = parse_qos(qos)
    except Exception:  # likewise
        qos = []
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


class _Storage:
    """The open file of a rosbags writer."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._storage: Any = writer.storage

    def _forget_connections(self, kept: int, counts: dict[int, int]) -> None:
        writer = self._writer
        del writer.connections[kept:]
        writer.counts = dict(counts)
        writer.added_types = {connection.msgtype for connection in writer.connections}


class McapStorage(_Storage):
    """An mcap file: closed chunks in the file, an open one in memory."""

    def __init__(self, writer: Writer) -> None:
        super().__init__(writer)
        self._storage.bio.flush()

    def mark(self) -> tuple[Any, ...]:
        """Give the present state of the file, for `undo`."""
        storage, writer = self._storage, self._writer
        chunk = storage.chunk
        return (
            chunk,
            chunk.bio.tell(),
            storage.bio.tell(),
            len(storage.chunks),
            len(writer.connections),
            dict(writer.counts),
        )

    def undo(self, mark: tuple[Any, ...]) -> bool:
        """Remove all that was written after the mark; returns True, for nothing else is lost."""
        chunk, chunk_size, file_size, chunks, connections, counts = mark
        storage, writer = self._storage, self._writer
        if storage.bio.tell() != file_size:
            storage.bio.seek(file_size)
            storage.bio.truncate()
        del storage.chunks[chunks:]
        chunk.bio.seek(chunk_size)
        chunk.bio.truncate()
        for identifier, messages in chunk.msgs.items():
            chunk.msgs[identifier] = [item for item in messages if item[1] < chunk_size]
        storage.chunk = chunk
        storage.channel_stats = dict(counts)
        self._forget_connections(connections, counts)
        storage.schemas[:] = [s for s in storage.schemas if s.name in writer.added_types]
        del storage.channels[connections:]
        return True

    def flush(self) -> None:
        """Give everything to the operating system, in a form that can be recovered."""
        if self._storage.chunk.bio.tell():
            mark = self.mark()
            try:
                self._storage.close_chunk()
            except OSError:
                raise
            except BaseException:
                self.undo(mark)
                raise
        self._storage.bio.flush()


class SqliteStorage(_Storage):
    """An sqlite3 file: committed messages survive."""

    def __init__(self, writer: Writer) -> None:
        super().__init__(writer)
        self.flush()

    def mark(self) -> tuple[int, dict[int, int]]:
        """Give the present state of the file, for `undo`."""
        return len(self._writer.connections), dict(self._writer.counts)

    def undo(self, mark: tuple[int, dict[int, int]]) -> bool:
        """Remove all that was written after the mark.

        Returns False if all that was not committed is lost, too.
        """
        # on a full disk sqlite itself has rolled back what was not committed
        holds = self._storage.conn.in_transaction or mark == self._committed
        connections, counts = mark if holds else self._committed
        execute = self._storage.cursor.execute
        execute("DELETE FROM messages WHERE id > ?", (sum(counts.values()),))
        execute("DELETE FROM topics WHERE id > ?", (connections,))
        execute("DELETE FROM message_definitions WHERE topic_type NOT IN (SELECT type FROM topics)")
        self._forget_connections(connections, counts)
        return bool(holds)

    def flush(self) -> None:
        """Give everything to the operating system, in a form that can be recovered."""
        self._storage.conn.commit()
        self._committed = self.mark()


class Reserve:
    """Reserved room on a disk, bytes, in which a bag on a full disk can still be closed.

    It is a file without a name: a process that is killed leaves none. Raises OSError without
    enough room.
    """

    def __init__(self, folder: Path, size: int) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  it is kept open
        try:
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError:
            self._file.close()
            raise

    def beside(self) -> int:
        """Free room on the same disk, bytes."""
        system = os.fstatvfs(self._file.fileno())
        return system.f_bavail * system.f_frsize

    def release(self) -> None:
        """Free the room."""
        self._file.close()


class BagPlace:
    """Open handles of the folder and file of a bag that is being written.

    A deleted file exists as long as it is open, and a moved folder is found.

    Parameters
    ----------
    path : Path
        The folder, as it was named.
    writer : Writer
        Open; it will write its metadata into the folder wherever that is by then.
    """

    def __init__(self, path: Path, writer: Writer) -> None:
        assert writer.storage is not None
        self._path, self._name = path, writer.storage.path.name
        self._folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        weakref.finalize(self, os.close, self._folder)
        self._file = os.open(writer.storage.path, os.O_RDONLY)
        weakref.finalize(self, os.close, self._file)
        writer.metapath = _HANDLES / str(self._folder) / writer.metapath.name

    def size(self) -> int:
        """Size of the file, bytes."""
        return os.fstat(self._file).st_size

    def folder(self) -> Path:
        """Where the folder is now: where it was made, or where it was moved."""
        try:
            if os.path.samestat(self._path.stat(), os.fstat(self._folder)):
                return self._path
        except OSError:
            pass
        return (_HANDLES / str(self._folder)).readlink()

    def has_file(self) -> bool:
        """Tell whether the file is still in the folder under its name."""
        try:
            there = os.stat(self._name, dir_fd=self._folder)
        except OSError:
            return False
        return os.path.samestat(there, os.fstat(self._file))

    def displaced(self) -> str:
        """Say whether folder or file was deleted or moved; empty if both are in place."""
        if not self.has_file():
            is_gone = os.fstat(self._file).st_nlink == 0
            what = "was deleted" if is_gone else "is not in its folder any more"
            return f"{self._path}: the bag {what}"
        folder = self.folder()
        return "" if folder == self._path else f"{self._path}: the bag was moved to {folder}"

    def messages(self) -> Iterator[Found]:
        """Read the messages of the file, in the order in which they were written.

        Raises OSError if the disk fails.
        """
        return file_messages(_HANDLES / str(self._file), self._name)
