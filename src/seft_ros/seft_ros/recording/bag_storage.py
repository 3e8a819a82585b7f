"""The open file of a bag: flush it, and undo a write that was interrupted half-way.

rosbags keeps up to 1 MiB of messages in memory and appends to it piece by piece: a process
that is killed loses them all, and a KeyboardInterrupt between two pieces leaves half a record
that makes all that follows unreadable. Everything that reaches into rosbags' storage objects
for that is in this file.
"""

from typing import Any, Protocol

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer


class _UnsyncedSqlite(Sqlite3Writer):
    """Leaves it to the operating system when the file gets to the disk, as for an mcap file.

    What is committed survives this process. Waiting for a busy disk takes seconds, in which
    nothing would be committed.
    """

    SQLITE_SCHEMA = f"PRAGMA synchronous = OFF;{Sqlite3Writer.SQLITE_SCHEMA}"


class UnsyncedWriter(Writer):
    """A `rosbags` writer that waits for no disk."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.SQLITE3: _UnsyncedSqlite}  # noqa: RUF012


class BagStorage(Protocol):
    """What `BagWriter` needs of a file format."""

    def mark(self) -> Any:
        """Where the file stands now, for `undo`."""

    def undo(self, mark: Any) -> None:
        """Take back all that was written after the mark."""

    def flush(self) -> None:
        """Hand everything to the operating system, in a form that can be recovered."""


class McapStorage:
    """An mcap file: closed chunks in the file, an open one in memory."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        storage: Any = writer.storage
        storage.bio.flush()
        self._storage = storage

    def mark(self) -> tuple[Any, ...]:
        """Where the file stands now, for `undo`."""
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

    def undo(self, mark: tuple[Any, ...]) -> None:
        """Take back all that was written after the mark."""
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
        _forget_connections(writer, connections, counts)
        storage.schemas[:] = [s for s in storage.schemas if s.name in writer.added_types]
        del storage.channels[connections:]

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system."""
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


class SqliteStorage:
    """An sqlite3 file: what is committed survives."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        storage: Any = writer.storage
        storage.conn.commit()
        self._storage = storage
        self._committed = self.mark()

    def mark(self) -> tuple[int, dict[int, int]]:
        """Where the file stands now, for `undo`."""
        return len(self._writer.connections), dict(self._writer.counts)

    def undo(self, mark: tuple[int, dict[int, int]]) -> None:
        """Take back all that was written after the mark.

        On a full disk sqlite has taken back by itself what was not committed.
        """
        connections, counts = mark if self._storage.conn.in_transaction else self._committed
        execute = self._storage.cursor.execute
        execute("DELETE FROM messages WHERE id > ?", (sum(counts.values()),))
        execute("DELETE FROM topics WHERE id > ?", (connections,))
        execute("DELETE FROM message_definitions WHERE topic_type NOT IN (SELECT type FROM topics)")
        _forget_connections(self._writer, connections, counts)

    def flush(self) -> None:
        """Commit."""
        self._storage.conn.commit()
        self._committed = self.mark()


def _forget_connections(writer: Writer, kept: int, counts: dict[int, int]) -> None:
    del writer.connections[kept:]
    writer.counts = dict(counts)
    writer.added_types = {connection.msgtype for connection in writer.connections}
