"""The open file of a bag: flush it, undo an interrupted write, find it wherever it is moved.

rosbags keeps up to 1 MiB of messages in memory and appends to it piece by piece: a process
that is killed loses them all, and a KeyboardInterrupt between two pieces leaves half a record
that makes all that follows unreadable. All use of rosbags' storage objects for that is in this
file.
"""

import os
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from seft_ros.bags.salvage import Found, file_messages

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
