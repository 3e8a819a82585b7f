"""The open file of a bag: flush it, and undo a write that was interrupted half-way.

rosbags keeps up to 1 MiB of messages in memory and appends to it piece by piece: a process
that is killed loses them all, and a KeyboardInterrupt between two pieces leaves half a record
that makes all that follows unreadable. Everything that reaches into rosbags' storage objects
for that is in this file.
"""

import os
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, override

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

RESERVED = 4 << 20
"""Bytes: an open chunk, and the index of a bag of hours."""
SPARE = 8 << 20
"""Bytes in which a test can be brought down when a disk is suddenly full."""


class _UnsyncedSqlite(Sqlite3Writer):
    """Leaves it to the operating system when the file gets to the disk, as for an mcap file.

    What is committed survives this process. Waiting for a busy disk takes seconds, in which
    nothing would be committed.
    """

    SQLITE_SCHEMA = f"PRAGMA synchronous = OFF;{Sqlite3Writer.SQLITE_SCHEMA}"


class UnsyncedWriter(Writer):
    """A `rosbags` writer that waits for no disk."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.SQLITE3: _UnsyncedSqlite}  # noqa: RUF012


class BagStorage(ABC):
    """An open file of a bag.

    Parameters
    ----------
    writer : Writer
        Whose file it is.
    """

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._storage: Any = writer.storage

    @abstractmethod
    def mark(self) -> Any:
        """Where the file stands now, for `undo`."""

    @abstractmethod
    def undo(self, mark: Any) -> bool:
        """Take back all that was written after the mark.

        Tells whether nothing else is lost: of a database, all that was not committed can be.
        """

    @abstractmethod
    def flush(self) -> None:
        """Hand everything to the operating system, in a form that can be recovered."""

    def _forget_connections(self, kept: int, counts: dict[int, int]) -> None:
        writer = self._writer
        del writer.connections[kept:]
        writer.counts = dict(counts)
        writer.added_types = {connection.msgtype for connection in writer.connections}


class McapStorage(BagStorage):
    """An mcap file: closed chunks in the file, an open one in memory."""

    def __init__(self, writer: Writer) -> None:
        super().__init__(writer)
        self._storage.bio.flush()

    @override
    def mark(self) -> tuple[Any, ...]:
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

    @override
    def undo(self, mark: tuple[Any, ...]) -> bool:
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

    @override
    def flush(self) -> None:
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


class SqliteStorage(BagStorage):
    """An sqlite3 file: what is committed survives."""

    def __init__(self, writer: Writer) -> None:
        super().__init__(writer)
        self.flush()

    @override
    def mark(self) -> tuple[int, dict[int, int]]:
        return len(self._writer.connections), dict(self._writer.counts)

    @override
    def undo(self, mark: tuple[int, dict[int, int]]) -> bool:
        # on a full disk sqlite has taken back by itself what was not committed
        holds = self._storage.conn.in_transaction or mark == self._committed
        connections, counts = mark if holds else self._committed
        execute = self._storage.cursor.execute
        execute("DELETE FROM messages WHERE id > ?", (sum(counts.values()),))
        execute("DELETE FROM topics WHERE id > ?", (connections,))
        execute("DELETE FROM message_definitions WHERE topic_type NOT IN (SELECT type FROM topics)")
        self._forget_connections(connections, counts)
        return bool(holds)

    @override
    def flush(self) -> None:
        self._storage.conn.commit()
        self._committed = self.mark()


class Reserve:
    """Room on a disk that is kept, bytes: a bag on a full disk can still be closed.

    It belongs to a file without a name: a process that is killed leaves none. Raises OSError if
    there is not so much room.
    """

    def __init__(self, folder: Path, size: int) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  it is kept open
        try:
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError:
            self._file.close()
            raise

    def beside(self) -> int:
        """Room that is left on the disk beside it, bytes."""
        system = os.fstatvfs(self._file.fileno())
        return system.f_bavail * system.f_frsize

    def release(self) -> None:
        """Give the room away."""
        self._file.close()
